//! Jaws on needle and thread.

use bevy_ecs::prelude::Entity;
use bevy_math::{Isometry3d, Vec3};
use keyhole_whiteboard::{JawPads, Needle, NeedleGrip};

/// Points of the needle that are tried.
const SAMPLES: usize = 64;

/// The jaws of an instrument in this tick.
#[derive(Clone, Copy, Debug)]
pub struct Jaw {
    /// The instrument.
    pub instrument: Entity,
    /// Its pads.
    pub pads: JawPads,
    /// Its pose.
    pub pose: Isometry3d,
    /// Angle of each jaw from the shaft's axis, rad.
    pub angle_rad: f32,
    /// The same in the last tick, rad.
    pub before_rad: f32,
    /// From which angle they have been closing, rad.
    pub widest_rad: f32,
}

impl Jaw {
    /// Whether jaws at this angle press on something of this thickness (m) between their pads; the teeth are beside it.
    fn pinches(&self, angle_rad: f32, thickness_m: f32) -> bool {
        self.pads.to_m * angle_rad.sin() <= thickness_m
    }

    /// Whether they hold what is of this thickness (m).
    #[must_use]
    pub fn is_shut(&self, thickness_m: f32) -> bool {
        self.pinches(self.angle_rad, thickness_m)
    }

    /// Whether they began to hold what is of this thickness (m) in this tick.
    #[must_use]
    pub fn has_shut(&self, thickness_m: f32) -> bool {
        self.is_shut(thickness_m) && !self.pinches(self.before_rad, thickness_m)
    }

    /// How far a place (m, in the world) is from the middle of the pads, m, if the jaws swept over it as they closed.
    #[must_use]
    pub fn swept(&self, place: Vec3) -> Option<f32> {
        let local = Vec3::from(self.pose.inverse().transform_point(place));
        let along = -local.z;
        let open = along * self.widest_rad.sin() + self.pads.closed_gap_m;
        let within =
            (self.pads.from_m..=self.pads.to_m).contains(&along) && local.x.abs() <= self.pads.half_width_m && local.y.abs() <= open;
        within.then(|| local.distance(Vec3::new(0.0, 0.0, -0.5 * (self.pads.from_m + self.pads.to_m))))
    }

    /// A place (m, in the world) in the instrument's frame, pushed by the jaws into their middle plane, m.
    #[must_use]
    pub fn pinched(&self, place: Vec3) -> Vec3 {
        let local = Vec3::from(self.pose.inverse().transform_point(place));
        Vec3::new(local.x, 0.0, local.z)
    }

    /// How these jaws hold a needle that they have swept over.
    #[must_use]
    pub fn take_needle(&self, needle: &Needle) -> Option<NeedleGrip> {
        let at = |i: usize| needle.point(&needle.pose, needle.arc_rad * i as f32 / SAMPLES as f32);
        let near = (0..=SAMPLES).filter_map(|i| self.swept(at(i)).map(|d| (d, i))).min_by(|a, b| a.0.total_cmp(&b.0));
        near.map(|(_, i)| {
            let mut local = self.pose.inverse() * needle.pose;
            let shift = self.pinched(at(i)) - Vec3::from(self.pose.inverse().transform_point(at(i)));
            local.translation += bevy_math::Vec3A::from(shift);
            NeedleGrip { instrument: self.instrument, local }
        })
    }
}

/// Lets go of a needle what has opened; the next that holds it does so from where it is now.
pub fn let_go(needle: &mut Needle, jaws: &[Jaw]) {
    let thickness = 2.0 * needle.wire_radius_m;
    let first = needle.grips.first().map(|g| g.instrument);
    needle.grips.retain(|g| jaws.iter().any(|j| j.instrument == g.instrument && j.is_shut(thickness)));
    let Some(grip) = needle.grips.first_mut() else { return };
    if first == Some(grip.instrument) {
        return;
    }
    if let Some(jaw) = jaws.iter().find(|j| j.instrument == grip.instrument) {
        grip.local = jaw.pose.inverse() * needle.pose;
    }
}
