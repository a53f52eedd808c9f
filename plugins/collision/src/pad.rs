//! The pads of jaws that grip. What is between them is held by the pads, by their friction and as hard as they press; a contact of the jaw's own steel would take the
//! pressure off them.

use crate::tool::ToolPart;
use bevy_math::Vec3;
use keyhole_whiteboard::JawPads;

/// Least cosine between what lies on a pad and what it faces: 60 degrees.
const FACING: f32 = 0.5;

/// How far beyond a pad's rim what lies on the jaw is still the pad's, as a part of half its width: tissue bulges over the rim.
const RIM: f32 = 0.5;

/// The pad on a jaw, in the frame of the jaw.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pad {
    pads: JawPads,
    /// Unit vector from the pad towards the other jaw.
    inward: Vec3,
}

impl Pad {
    /// The pad of a jaw that lies on one side of the instrument's middle plane.
    #[must_use]
    pub fn of(jaw: &ToolPart, pads: JawPads) -> Self {
        let middle = jaw.spine().iter().map(|p| p.y).sum::<f32>();
        Self { pads, inward: Vec3::NEG_Y * middle.signum() }
    }

    /// Whether tissue at `at` (m) that looks the way `outward` and would be pushed along `push` lies on the pad; unit vectors, all in the jaw's frame. Tissue that
    /// lies flat on a pad looks at it, whichever way the jaw would push it, which at the rim is aside; an edge of tissue looks elsewhere, but is pushed off the pad.
    #[must_use]
    pub fn bears(&self, at: Vec3, outward: Vec3, push: Vec3) -> bool {
        self.is_beside(at) && (outward.dot(self.inward) < -FACING || push.dot(self.inward) > FACING)
    }

    /// Whether a point (m, in the jaw's frame) is above or below the pad.
    #[must_use]
    pub fn is_beside(&self, at: Vec3) -> bool {
        let rim_m = RIM * self.pads.half_width_m;
        (self.pads.from_m - rim_m..=self.pads.to_m + rim_m).contains(&-at.z) && at.x.abs() <= self.pads.half_width_m + rim_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pad_bears_what_looks_at_it_or_is_pushed_off_it() {
        let pads = JawPads { from_m: 0.003, to_m: 0.019, half_width_m: 0.002, closed_gap_m: 0.0003 };
        let upper = ToolPart::capsule(Vec3::new(0.0, 0.001, 0.0), Vec3::new(0.0, 0.001, -0.02), 0.001);
        let pad = Pad::of(&upper, pads);
        let (middle, rim) = (Vec3::new(0.0, 0.0002, -0.01), Vec3::new(0.0024, 0.0002, -0.01));
        assert!(pad.bears(middle, Vec3::Y, Vec3::NEG_Y), "tissue flat on the pad");
        assert!(pad.bears(rim, Vec3::Y, Vec3::X), "at the rim, where the jaw would push it aside");
        assert!(pad.bears(middle, Vec3::Z, Vec3::NEG_Y), "an edge of tissue");
        assert!(!pad.bears(middle, Vec3::NEG_Y, Vec3::Y), "what lies on the jaw's back");
        assert!(!pad.bears(rim, Vec3::NEG_X, Vec3::X), "what its side pushes");
        for beyond in [Vec3::new(0.0035, 0.0, -0.01), Vec3::new(0.0, 0.0, -0.001), Vec3::new(0.0, 0.0, -0.021)] {
            assert!(!pad.bears(beyond, Vec3::Y, Vec3::NEG_Y), "what is beyond the pad at {beyond}");
        }
    }
}
