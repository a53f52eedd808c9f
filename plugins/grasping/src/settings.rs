//! How jaws hold.

use bevy_ecs::prelude::*;

/// How jaws hold.
#[derive(Resource, Clone, Copy, Debug, PartialEq)]
pub struct GraspSettings {
    /// Coulomb's coefficient between pads and tissue. Default 0.83: a pinch of 3.0 N holds a pull of 5 N (PMID 15108104).
    pub friction: f32,
    /// Stiffness of the pads against the tissue, both jaws together and all cells holding, N/m. Default 20 000: a pull of 5 N moves the tissue a quarter of a
    /// millimetre against the jaws.
    pub stiffness_n_m: f32,
    /// Part of its thickness to which tissue can be squeezed between the jaws. Default 0.25.
    pub least_thickness: f32,
    /// Force of each jaw at which the hand presses no harder, N. Default 20.
    pub most_pinch_n: f32,
    /// How many times as long as at rest the tissue at a point of a pad can be drawn before it gives out there and the jaws lose it. Default 3: tissue tears far
    /// sooner, but an element that is held at one point is drawn more than the tissue around it.
    pub most_stretch: f32,
    /// Pressure of a part of a pad beyond which tissue is bruised that says nothing else, Pa. Default 250 000: the least pinch that damaged the cecum of pigs was
    /// 15 N (Heijnsdijk et al. 2004, PMID 15108111), here on the 59 mm2 of a grasper's pad; the paper's own areas are not in its abstract. Organs that bear less say so.
    pub bruise_pa: f32,
}

impl Default for GraspSettings {
    fn default() -> Self {
        Self { friction: 0.83, stiffness_n_m: 20_000.0, least_thickness: 0.25, most_pinch_n: 20.0, most_stretch: 3.0, bruise_pa: 250_000.0 }
    }
}
