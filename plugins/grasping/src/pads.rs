//! The pads of two jaws and their cells, in the frame of the instrument.
//!
//! The jaws turn about X at the origin, the shaft is along -Z. A point of a pad is `s` along its jaw, `x` across, and the closed gap `g` from the
//! middle plane: with the jaw `a` off the axis it is at `(x, +-(s sin a + g cos a), -(s cos a - g sin a))`, above for the upper jaw, below for the lower.

use bevy_math::Vec3;
use keyhole_whiteboard::JawPads;

/// Cells along a pad.
const ALONG: usize = 6;
/// Cells across a pad.
const ACROSS: usize = 2;
/// Cells of both pads.
pub const CELLS: usize = 2 * ALONG * ACROSS;

/// One of the jaws.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Jaw {
    /// The one on the side of Y.
    Upper,
    /// The other.
    Lower,
}

/// A point of a pad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PadPoint {
    /// On which jaw.
    pub jaw: Jaw,
    /// From the pivot along the jaw, m.
    pub along_m: f32,
    /// Across the jaw, towards X, m.
    pub across_m: f32,
}

impl Jaw {
    fn sign(self) -> f32 {
        match self {
            Self::Upper => 1.0,
            Self::Lower => -1.0,
        }
    }

    /// Unit vector from its pad towards the other jaw, with the jaws `angle_rad` off the axis.
    #[must_use]
    pub fn inward(self, angle_rad: f32) -> Vec3 {
        let (sin, cos) = angle_rad.sin_cos();
        Vec3::new(0.0, -self.sign() * cos, -sin)
    }

    /// Unit vector along it, away from the pivot.
    #[must_use]
    pub fn outward(self, angle_rad: f32) -> Vec3 {
        let (sin, cos) = angle_rad.sin_cos();
        Vec3::new(0.0, self.sign() * sin, -cos)
    }
}

impl PadPoint {
    /// Where it is with the jaws `angle_rad` off the axis, m.
    #[must_use]
    pub fn place(self, pads: &JawPads, angle_rad: f32) -> Vec3 {
        self.across_m * Vec3::X + self.along_m * self.jaw.outward(angle_rad) - pads.closed_gap_m * self.jaw.inward(angle_rad)
    }

    /// The point that is at `local` (m) with the jaws `angle_rad` off the axis.
    #[must_use]
    pub fn at(local: Vec3, angle_rad: f32) -> Self {
        // The gap is above zero: so is the upper jaw's Y.
        let jaw = if local.y > 0.0 { Jaw::Upper } else { Jaw::Lower };
        Self { jaw, along_m: local.dot(jaw.outward(angle_rad)), across_m: local.x }
    }

    /// The cell it is in; `None` off the pad.
    #[must_use]
    pub fn cell(self, pads: &JawPads) -> Option<usize> {
        let along = (self.along_m - pads.from_m) / (pads.to_m - pads.from_m) * ALONG as f32;
        let across = (self.across_m / pads.half_width_m + 1.0) / 2.0 * ACROSS as f32;
        let inside = |at: f32, cells: usize| at >= 0.0 && at < cells as f32;
        (inside(along, ALONG) && inside(across, ACROSS)).then(|| {
            let first = if self.jaw == Jaw::Upper { 0 } else { CELLS / 2 };
            first + along as usize * ACROSS + across as usize
        })
    }
}

/// The centres of all cells, in the order of [`PadPoint::cell`].
pub fn centres(pads: &JawPads) -> impl Iterator<Item = PadPoint> {
    let pads = *pads;
    (0..CELLS).map(move |cell| {
        let jaw = if cell < CELLS / 2 { Jaw::Upper } else { Jaw::Lower };
        let middle = |at: usize, cells: usize| (at as f32 + 0.5) / cells as f32;
        let (along, across) = (middle(cell % (CELLS / 2) / ACROSS, ALONG), middle(cell % ACROSS, ACROSS));
        PadPoint { jaw, along_m: pads.from_m + along * (pads.to_m - pads.from_m), across_m: (2.0 * across - 1.0) * pads.half_width_m }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const PADS: JawPads = JawPads { from_m: 0.003, to_m: 0.019, half_width_m: 0.002, closed_gap_m: 0.0003 };

    #[test]
    fn every_cell_has_its_centre_at_any_angle() {
        for angle in [0.0, 0.2, 0.6] {
            for (cell, point) in centres(&PADS).enumerate() {
                let local = point.place(&PADS, angle);
                let back = PadPoint::at(local, angle);
                assert_eq!((back.cell(&PADS), back.jaw), (Some(cell), point.jaw));
                assert!((back.along_m - point.along_m).abs() < 1e-7 && (back.across_m - point.across_m).abs() < 1e-7);
                assert!((local.dot(-back.jaw.inward(angle)) - PADS.closed_gap_m).abs() < 1e-7);
            }
        }
        assert_eq!(PadPoint { jaw: Jaw::Upper, along_m: 0.0195, across_m: 0.0 }.cell(&PADS), None);
        assert_eq!(PadPoint { jaw: Jaw::Upper, along_m: 0.01, across_m: -0.0021 }.cell(&PADS), None);
    }

    #[test]
    fn the_jaws_of_a_closed_grasper_press_against_each_other() {
        assert_eq!(Jaw::Upper.inward(0.0), Vec3::NEG_Y);
        assert_eq!(Jaw::Lower.inward(0.0), Vec3::Y);
        for angle in [0.1, 0.5] {
            assert!(Jaw::Upper.inward(angle).dot(Jaw::Upper.outward(angle)).abs() < 1e-6);
            assert!(Jaw::Upper.outward(angle).y > 0.0);
        }
    }
}
