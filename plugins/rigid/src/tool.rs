//! The parts of an instrument that push rigid bodies: the shaft as a bar, and the hulls of what is ahead of it.

use crate::convert::{length_to_rapier, to_rapier};
use crate::world::Motion;
use bevy_math::{Isometry3d, Vec3};
use keyhole_whiteboard::{Instrument, InstrumentPose, Joint, ToolModel};
use rapier3d::geometry::SharedShape;

/// The parts of an instrument.
#[derive(Clone)]
pub struct ToolParts {
    shapes: Vec<SharedShape>,
    joints: Vec<Joint>,
    /// Angle of the jaws one tick ago, rad.
    angle_rad: f32,
}

impl ToolParts {
    /// Of an instrument whose jaws are at this angle (rad).
    #[must_use]
    pub fn of(instrument: &Instrument, model: &ToolModel, angle_rad: f32) -> Self {
        let radius = instrument.shaft_radius_m;
        let end = |z: f32| to_rapier(Vec3::Z * z);
        let shaft = SharedShape::capsule(end(radius), end(instrument.shaft_length_m), length_to_rapier(radius));
        let ahead = model.parts.iter().filter_map(|part| {
            let points: Vec<Vec3> = part.mesh.vertices.iter().map(|v| Vec3::from_array(*v)).collect();
            // What lies along the shaft is in its bar.
            let is_ahead = points.iter().any(|v| v.z < 0.0);
            let points: Vec<_> = points.into_iter().map(to_rapier).collect();
            is_ahead.then(|| SharedShape::convex_hull(&points)).flatten().map(|shape| (shape, part.joint))
        });
        let (shapes, joints) = std::iter::once((shaft, Joint::Fixed)).chain(ahead).unzip();
        Self { shapes, joints, angle_rad }
    }

    /// The shapes, and where they are.
    pub(crate) fn placed(&self, pose: &InstrumentPose) -> Vec<(SharedShape, Isometry3d)> {
        self.shapes.iter().cloned().zip(self.joints.iter().map(|j| pose.now * j.at(self.angle_rad))).collect()
    }

    /// How each part moves in a tick at whose end the jaws are at this angle (rad).
    pub fn moved(&mut self, pose: &InstrumentPose, angle_rad: f32) -> Vec<Motion> {
        let before = std::mem::replace(&mut self.angle_rad, angle_rad);
        let motion = |j: &Joint| Motion { from: pose.before * j.at(before), to: pose.now * j.at(angle_rad) };
        self.joints.iter().map(motion).collect()
    }
}
