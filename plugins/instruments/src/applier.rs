//! The jaws of a clip applier: two rails, each with a leg of the clip along its inner side.

use crate::model::{Profile, Ring};
use bevy_math::Vec3;
use keyhole_whiteboard::{ClipApplier, ClipShape, Joint, ToolPart};

/// Largest angle of each jaw from the shaft's axis, rad: 20 degrees, with which the middles of the legs are 8.6 mm apart.
pub(crate) const WIDEST_RAD: f32 = 0.349;

/// From the pivot to the middle of the clip's legs, m.
pub(crate) const MIDDLE_M: f32 = 0.0125;

/// How far the rails reach beyond the legs, m.
const BEYOND_M: f32 = 0.0008;

const STEEL: [f32; 3] = [0.62, 0.63, 0.65];

/// The jaws on a shaft of this radius (m), around the kind's own clip. Closed they leave room for the closed clip.
pub(crate) fn jaws(r: f32) -> Vec<ToolPart> {
    let ClipApplier { shape: ClipShape { leg_m, wire_m, gap_m, .. }, crown_m, .. } = ClipApplier::default();
    // From the middle plane to the inner side of a rail: a leg is in its groove with two thirds of its thickness.
    let inner = 0.5 * gap_m + 0.33 * wire_m;
    let (tip, width) = (crown_m + leg_m + BEYOND_M, 0.5 * wire_m + 0.22 * r);
    let jaw = |(name, side): (&'static str, f32)| {
        let ring = |along: f32, half_x: f32, inner: f32, thick: f32| Ring {
            z: -along,
            half_x,
            half_y: 0.5 * thick,
            offset: Vec3::new(0.0, side * (inner + 0.5 * thick), 0.0),
        };
        let rings = [
            ring(-0.6 * r, 0.7 * r, 0.02 * r, 0.75 * r),
            ring(0.4 * r, 0.75 * r, 0.02 * r, 0.8 * r),
            // Behind the crown the jaws bend apart around the clip.
            ring(0.6 * crown_m, 0.5 * r, 0.5 * inner, 0.6 * r),
            ring(0.9 * crown_m, width, inner, 0.5 * r),
            ring(0.9 * tip, width, inner, 0.42 * r),
            ring(tip, 0.6 * width, inner, 0.2 * r),
        ];
        let joint = Joint::Hinge { pivot: Vec3::ZERO, axis: Vec3::X, factor: side };
        ToolPart { name, mesh: Profile::Slab.loft(&rings), joint, colour: STEEL, metallic: 1.0 }
    };
    [("jaw_upper", 1.0), ("jaw_lower", -1.0)].map(jaw).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_of_the_clip_is_what_a_hand_steers() {
        let own = ClipApplier::default();
        assert!((own.crown_m + 0.5 * own.shape.leg_m - MIDDLE_M).abs() < 1e-6);
        // Closed jaws do not touch what a closed clip holds.
        let lowest = |part: &ToolPart| part.mesh.vertices.iter().filter(|v| v[2] < -own.crown_m).map(|v| v[1]).fold(f32::MAX, f32::min);
        assert!(lowest(&jaws(0.0025)[0]) > 0.5 * own.shape.gap_m);
    }
}
