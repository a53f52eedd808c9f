//! The parts of an instrument that touch tissue, and each of them in a tick.

use crate::contacts::MovedPart;
use crate::detect::Body;
use crate::pad::Pad;
use crate::shape::Shape;
use crate::tool::{Motion, ToolPart};
use bevy_ecs::prelude::*;
use bevy_math::Vec3;
use keyhole_whiteboard::{Instrument, InstrumentPose, JawPads, Joint, ToolModel};

/// The parts of an instrument that touch tissue.
#[derive(Component, Clone)]
pub(crate) struct ToolParts {
    pub(crate) parts: Vec<MovingPart>,
    /// Angle of the jaws one tick ago, rad.
    pub(crate) angle_rad: f32,
}

/// One of them.
#[derive(Clone)]
pub(crate) struct MovingPart {
    pub(crate) part: ToolPart,
    joint: Joint,
    /// Whether tissue gives way to it by being cut, while the blade cuts.
    pub(crate) cuts: bool,
    /// By organ that its middle is in: the way out, in its frame.
    ways: Vec<(Entity, Vec3)>,
    /// Its middle when the tick begins, m.
    middle: Vec<Vec3>,
    points: Shape,
}

impl MovingPart {
    fn new(part: ToolPart, joint: Joint, cuts: bool) -> Self {
        let points = Shape::of_points(part.spine().len());
        Self { part, joint, cuts, ways: Vec::new(), middle: Vec::new(), points }
    }

    /// How it moves in a tick, with the jaws at these angles at the beginning and at the end.
    pub(crate) fn motion(&self, pose: &InstrumentPose, angles_rad: [f32; 2], dt_s: f32) -> Motion {
        Motion { from: pose.before * self.joint.at(angles_rad[0]), to: pose.now * self.joint.at(angles_rad[1]), dt_s }
    }

    /// It in this tick; `pads` of jaws that grip, to which what lies on them is left.
    pub(crate) fn in_tick(&mut self, tool: Entity, motion: Motion, friction: f32, pads: Option<JawPads>) -> Moving<'_> {
        let Self { part, joint, middle, points, ways, .. } = self;
        let pad = pads.filter(|_| matches!(joint, Joint::Hinge { .. })).map(|pads| Pad::of(part, pads));
        middle.clear();
        middle.extend(part.spine().iter().map(|p| motion.from * *p));
        let middle = Body { shape: points, positions: middle, self_collision: false };
        Moving { tool, part, motion, friction, pad, ways, middle }
    }
}

impl ToolParts {
    /// The shaft as a capsule, and the hulls of what is ahead of it.
    pub(crate) fn new(instrument: &Instrument, model: &ToolModel, angle_rad: f32) -> Self {
        let radius = instrument.shaft_radius_m;
        let shaft = ToolPart::capsule(Vec3::Z * radius, Vec3::Z * instrument.shaft_length_m, radius);
        let ahead = model.parts.iter().filter_map(|p| {
            let points: Vec<Vec3> = p.mesh.vertices.iter().map(|v| Vec3::from_array(*v)).collect();
            // What lies along the shaft is in its capsule.
            points.iter().any(|v| v.z < 0.0).then(|| ToolPart::hull(&points)).flatten().map(|part| MovingPart::new(part, p.joint, true))
        });
        let parts = std::iter::once(MovingPart::new(shaft, Joint::Fixed, false)).chain(ahead).collect();
        Self { parts, angle_rad }
    }
}

/// A part of an instrument in a tick.
pub(crate) struct Moving<'a> {
    pub(crate) tool: Entity,
    pub(crate) part: &'a ToolPart,
    pub(crate) motion: Motion,
    pub(crate) friction: f32,
    pub(crate) pad: Option<Pad>,
    pub(crate) ways: &'a mut Vec<(Entity, Vec3)>,
    /// Its middle, as a body of points.
    pub(crate) middle: Body<'a>,
}

impl Moving<'_> {
    /// As contacts see it.
    pub(crate) fn moved(&self) -> MovedPart<'_> {
        MovedPart { tool: self.tool, part: self.part, motion: &self.motion, friction: self.friction, pad: self.pad }
    }

    /// Whether a point of its middle is beside a pad that holds what is there.
    pub(crate) fn is_padded(&self, point: usize) -> bool {
        self.pad.is_some_and(|pad| self.part.spine().get(point).is_some_and(|at| pad.is_beside(*at)))
    }
}
