//! Blood that lies, and what takes it up.

use bevy_ecs::prelude::*;
use bevy_math::Vec3;

/// Thickness of a pool, m: of water with gravity and surface tension about as much.
const DEEP_M: f32 = 0.0016;
/// Largest radius of a pool, m: then it rises.
const MOST_M: f32 = 0.03;

/// Blood that lies on anatomy: half of a flat ellipsoid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BloodPool {
    /// The middle of what it lies on, in the world, m.
    pub at: Vec3,
    /// Unit normal of what it lies on, outward.
    pub normal: Vec3,
    /// Its volume, ml; above zero.
    pub ml: f64,
}

impl BloodPool {
    /// Radius and thickness, m: half of a flat ellipsoid has 2/3 pi r2 h.
    #[must_use]
    pub fn size_m(&self) -> (f32, f32) {
        let (area, volume_m3) = (2.0 / 3.0 * std::f32::consts::PI, self.ml as f32 * 1e-6);
        let radius = (volume_m3 / (area * DEEP_M)).sqrt();
        if radius <= MOST_M { (radius, DEEP_M) } else { (MOST_M, volume_m3 / (area * MOST_M * MOST_M)) }
    }

    /// From a point to the disc from which the pool rises, less the thickness of the pool, m: zero in the pool, or nearly, for it is thinner at its rim.
    #[must_use]
    pub fn distance_m(&self, point: Vec3) -> f32 {
        let (radius, deep) = self.size_m();
        let above = (point - self.at).dot(self.normal);
        let beside = ((point - self.at) - above * self.normal).length() - radius;
        (above.abs() - deep).max(0.0).hypot(beside.max(0.0))
    }
}

/// On an instrument: a tube that aspirates blood. Written by the scene, or by instruments from the kind where the scene says nothing.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
#[require(SuctionValve)]
pub struct Suction {
    /// Blood that it takes up at most, ml/s.
    pub most_ml_s: f32,
    /// How far from its mouth blood may be, m.
    pub reach_m: f32,
    /// From the frame's origin along the shaft to its mouth, m.
    pub mouth_m: f32,
}

impl Default for Suction {
    /// A litre a minute, which is what irrigation beside it is asked to deliver where something bleeds, so that a suction has to keep up with it; its bore of 3.5 mm would let several
    /// times as much through at a vacuum of 20 kPa (Poiseuille), its valve and hose do not. An assumption, as is its reach: its side holes begin 3 mm from its mouth.
    fn default() -> Self {
        Self { most_ml_s: 1000.0 / 60.0, reach_m: 0.003, mouth_m: 0.012 }
    }
}

/// Whether a suction is open. Written by instruments in each tick, from the pedal.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SuctionValve {
    /// Open.
    pub open: bool,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pool_has_its_volume_however_large() {
        for ml in [0.004, 0.5, 50.0] {
            let (radius, deep) = BloodPool { at: Vec3::ZERO, normal: Vec3::Y, ml }.size_m();
            let volume_ml = f64::from(2.0 / 3.0 * std::f32::consts::PI * radius * radius * deep) * 1e6;
            assert!((volume_ml / ml - 1.0).abs() < 1e-4 && radius <= MOST_M * 1.0001);
        }
    }

    #[test]
    fn a_pool_is_near_at_its_rim_and_above_it() {
        let pool = BloodPool { at: Vec3::X, normal: Vec3::Y, ml: 1.0 };
        let (radius, deep) = pool.size_m();
        for (point, expected) in [
            (Vec3::X, 0.0),
            (Vec3::X + 0.5 * deep * Vec3::Y, 0.0),
            (Vec3::X + (deep + 0.002) * Vec3::Y, 0.002),
            (Vec3::X + (radius + 0.001) * Vec3::Z, 0.001),
        ] {
            assert!((pool.distance_m(point) - expected).abs() < 1e-6, "{point}: {} m", pool.distance_m(point));
        }
    }
}
