//! Clips, the vessels that they close, and what bleeds.

use crate::{BloodPool, TissuePoint};
use bevy_ecs::prelude::*;
use bevy_math::{Isometry3d, Vec3};

/// What a clip is like, whether in its cartridge, on tissue or dropped. Its frame: the crown, where the legs meet, at the origin, the legs along -Z, one
/// above the other along Y.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
pub struct ClipShape {
    /// Length of a leg, m.
    pub leg_m: f32,
    /// Thickness of the wire, m.
    pub wire_m: f32,
    /// Between the legs of a closed clip, from face to face, m.
    pub gap_m: f32,
    /// Density, kg/m3.
    pub density_kg_m3: f32,
    /// Force at which the closed legs give, both together over their whole length, N.
    pub most_pinch_n: f32,
    /// Coulomb's coefficient between legs and tissue.
    pub friction: f32,
}

impl Default for ClipShape {
    /// A titanium clip for vessels of up to 8 mm laid flat. What its legs bear and their coefficient are assumptions: a clip across its whole length
    /// holds a pull of 2 x 0.5 x 8 N = 8 N at most.
    fn default() -> Self {
        Self { leg_m: 0.009, wire_m: 0.0008, gap_m: 0.0003, density_kg_m3: 4500.0, most_pinch_n: 8.0, friction: 0.5 }
    }
}

/// On an instrument: its jaws set clips. Written by the scene; the number by clipping.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
pub struct ClipApplier {
    /// Clips that are left in the cartridge.
    pub clips: u32,
    /// What they are like.
    pub shape: ClipShape,
    /// From the pivot of the jaws to the crown of the clip between them, m: the legs point away from the pivot.
    pub crown_m: f32,
    /// Angle of each jaw from the shaft's axis below which the jaws are closed, and the clip with them, rad.
    pub closed_rad: f32,
}

impl Default for ClipApplier {
    /// Twenty clips, 8 mm ahead of the pivot, set below one degree.
    fn default() -> Self {
        Self { clips: 20, shape: ClipShape::default(), crown_m: 0.008, closed_rad: 0.0175 }
    }
}

/// Two points of tissue that a clip holds together: one wall at each leg.
#[derive(Clone, Debug, PartialEq)]
pub struct ClipPair {
    /// The point at the upper leg.
    pub upper: TissuePoint,
    /// The point at the lower leg.
    pub lower: TissuePoint,
    /// Where they are in the organ's rest shape, m.
    pub rest: [Vec3; 2],
    /// From the crown along the legs to the middle of the piece of leg that this pair stands for, m.
    pub along_m: f32,
    /// Across the legs, m.
    pub across_m: f32,
    /// How far apart the legs hold the two now, m.
    pub apart_m: f32,
    /// Force with which each leg presses, N; zero or more.
    pub pinch_n: f32,
}

/// A clip on tissue, with its [`ClipShape`]. Written by clipping.
#[derive(Component, Clone, Debug, PartialEq)]
pub struct Clip {
    /// The organ that it is on.
    pub organ: Entity,
    /// Its frame in the world.
    pub pose: Isometry3d,
    /// What it holds.
    pub pairs: Vec<ClipPair>,
    /// Of the vessel that it is on: the part of the lumen that it closes, in [0, 1]. Zero where there is no vessel.
    pub closes: f32,
    /// The instrument that has hold of it, and the clip's frame in that of the instrument.
    pub held: Option<(Entity, Isometry3d)>,
    /// Pull of what holds it, N.
    pub pull_n: Vec3,
}

impl Clip {
    /// Force with which its legs press, N.
    #[must_use]
    pub fn pinch_n(&self) -> f32 {
        self.pairs.iter().map(|p| p.pinch_n).sum()
    }
}

/// One end of a vessel, as a source.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct VesselEnd {
    /// Pressure behind it, Pa above that of the cavity.
    pub pressure_pa: f32,
    /// What flows out of it when nothing stands in its way, ml/min: what the heart and the vessels before it can give. Zero: nothing comes from there.
    pub supply_ml_min: f32,
}

/// A vessel in an organ. Written by the scene.
#[derive(Component, Clone, Debug, PartialEq)]
pub struct Vessel {
    /// Name for the HUD.
    pub name: String,
    /// Centre line in the organ's rest shape, from the near end to the far one, m: two points or more.
    pub line: Vec<Vec3>,
    /// Radius of the lumen, m.
    pub radius_m: f32,
    /// Thickness of the wall where the organ's mesh is a hollow tube, m: the lumen is then no tissue, and what is cut is its wall. Zero where the lumen runs
    /// through the mesh.
    pub wall_m: f32,
    /// Where the line begins.
    pub near: VesselEnd,
    /// Where it ends: of an artery whose blood comes from one side alone with a supply of zero.
    pub far: VesselEnd,
}

/// A place where blood leaves a vessel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BleedSite {
    /// The organ whose vessel it is.
    pub organ: Entity,
    /// Where it is in the world, m.
    pub at: Vec3,
    /// Unit vector along the vessel, the way the blood leaves it.
    pub towards: Vec3,
    /// Area through which it leaves, m2.
    pub area_m2: f32,
    /// ml/min.
    pub rate_ml_min: f32,
}

/// Contraction of a free jet: see `bleed` of clipping.
const CONTRACTION: f32 = 0.611;
/// Slowest and fastest that blood is seen to leave, m/s: it oozes, or spurts.
const SPEEDS_M_S: (f32, f32) = (0.02, 1.2);

impl BleedSite {
    /// Speed with which blood is seen to leave, m/s: that of a free jet through the opening, within what is seen of oozing and spurting vessels.
    #[must_use]
    pub fn speed_m_s(&self) -> f32 {
        let flow_m3_s = self.rate_ml_min * 1e-6 / 60.0;
        (flow_m3_s / (CONTRACTION * self.area_m2.max(f32::MIN_POSITIVE))).clamp(SPEEDS_M_S.0, SPEEDS_M_S.1)
    }
}

/// What bleeds, and where the blood is: `lost_ml` is what lies in pools, what was aspirated and what is gone together. Written by clipping.
#[derive(Resource, Clone, Debug, Default, PartialEq)]
pub struct BleedReport {
    /// Where, by organ and then along the vessel.
    pub sites: Vec<BleedSite>,
    /// All together, ml/min.
    pub rate_ml_min: f32,
    /// Lost since the scene started, ml.
    pub lost_ml: f64,
    /// What of it lies on solid anatomy.
    pub pools: Vec<BloodPool>,
    /// What of it was aspirated, ml.
    pub aspirated_ml: f64,
    /// What of it came down on nothing that is solid, ml.
    pub gone_ml: f64,
}

/// What has become of clips since the scene started. Written by clipping.
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ClipReport {
    /// Set on tissue.
    pub set: u32,
    /// Of these on no vessel, or not across the whole of one.
    pub misplaced: u32,
    /// Closed with no tissue between the legs.
    pub dropped: u32,
    /// Slipped off tissue.
    pub slipped: u32,
}

impl BleedReport {
    /// What lies in pools, ml.
    #[must_use]
    pub fn pooled_ml(&self) -> f64 {
        self.pools.iter().map(|p| p.ml).sum()
    }
}
