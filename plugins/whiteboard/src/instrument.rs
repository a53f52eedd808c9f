//! Instruments and the endoscope. All written by instruments, but for what the scene spawns.
//!
//! The frame of an instrument: origin at the tip's pivot (where the jaws meet the shaft), -Z along the shaft towards what is worked on,
//! +Z back to the handle, Y up when the roll is zero.

use bevy_ecs::prelude::*;
use bevy_math::{Isometry3d, Quat, Vec3};

/// A trocar: the point that the shaft always passes through.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
pub struct Port {
    /// The pivot in the world, m.
    pub position: Vec3,
    /// Unit vector from the pivot into the body: yaw and pitch zero.
    pub inward: Vec3,
}

/// Which hand an instrument is in.
#[derive(Component, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Hand {
    /// The trainee's left hand.
    Left,
    /// The trainee's right hand.
    Right,
}

/// What an instrument is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum InstrumentKind {
    /// Two jaws with blunt pads.
    Grasper,
    /// Two blades that cut as they close.
    Scissors,
    /// A hook that cuts along its edge while it is active.
    Hook,
    /// A pointed straight blade that cuts along its edge while it is active.
    Scalpel,
    /// Two jaws with a clip between them, which they close.
    ClipApplier,
    /// Two short strong jaws that hold a needle and its thread.
    NeedleHolder,
    /// A tube that takes up blood while it is open.
    Suction,
}

/// An instrument. Written by the scene.
#[derive(Component, Clone, Debug, PartialEq)]
#[require(InstrumentPose, Jaws)]
pub struct Instrument {
    /// What it is.
    pub kind: InstrumentKind,
    /// Name for the HUD.
    pub name: String,
    /// Length of the shaft from the pivot of the jaws to the handle, m.
    pub shaft_length_m: f32,
    /// Radius of the shaft, m.
    pub shaft_radius_m: f32,
}

/// Where an instrument is, now and one tick ago.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct InstrumentPose {
    /// Frame of the instrument in the world.
    pub now: Isometry3d,
    /// The same at the tick before.
    pub before: Isometry3d,
}

/// How far the jaws are open.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct Jaws {
    /// Angle of each jaw from the shaft's axis, rad.
    pub angle_rad: f32,
}

/// What about an instrument cuts: where its line is, when it cuts, and how much tissue it takes away. Written by the scene, or by
/// instruments from the kind where the scene says nothing; an instrument without one never cuts.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
#[require(Blade)]
pub struct CuttingLine {
    /// Where the line is.
    pub line: LineShape,
    /// When it cuts.
    pub trigger: CutTrigger,
    /// Thickness of tissue that the edge takes away, m; 0 for a cold blade.
    pub kerf_m: f32,
}

/// Where a cutting line is in the frame of its instrument.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LineShape {
    /// An edge that stays where it is.
    Edge {
        /// End towards the tissue, m. On the shaft's axis: it is the point that a hand steers.
        tip: Vec3,
        /// The other end, m.
        heel: Vec3,
    },
    /// Two blades that turn about X at the frame's origin: the line is where they meet, and runs from there to their tips as they close.
    JawLine {
        /// From the pivot to the tips, m.
        length_m: f32,
    },
}

impl LineShape {
    /// From the frame's origin to the end towards the tissue, along the shaft's axis, m.
    #[must_use]
    pub fn reach_m(self) -> f32 {
        match self {
            Self::Edge { tip, .. } => -tip.z,
            Self::JawLine { length_m } => length_m,
        }
    }

    /// The same shape made longer or shorter, its thickness across the shaft kept; `length_m` is that of [`LineShape::reach_m`].
    #[must_use]
    pub fn with_reach(self, length_m: f32) -> Self {
        match self {
            Self::Edge { tip, heel } => Self::Edge { tip: tip.with_z(-length_m), heel },
            Self::JawLine { .. } => Self::JawLine { length_m },
        }
    }
}

/// When a cutting line cuts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum CutTrigger {
    /// While the pedal is down.
    Pedal,
    /// While the jaws close.
    Closing,
}

/// The cutting line as it is now. Written by instruments in each tick, from [`CuttingLine`].
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct Blade {
    /// End towards the tissue, in the frame of the instrument, m.
    pub tip: Vec3,
    /// The other end, m.
    pub heel: Vec3,
    /// Whether it cuts now.
    pub active: bool,
    /// Thickness of tissue that the edge takes away, m; 0 for a cold blade. Default 0.
    pub kerf_m: f32,
}

/// The endoscope: moved by mouse, in a port of its own.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
pub struct Endoscope {
    /// Frame of the shaft in the world: origin at the tip, -Z along the shaft.
    pub pose: Isometry3d,
    /// Angle between the shaft's axis and the direction of view, rad: towards -Y of the frame (down) while `roll_rad` is zero.
    pub direction_of_view_rad: f32,
    /// Angle of view across the round picture, rad.
    pub angle_of_view_rad: f32,
    /// Rotation of the scope about its shaft against the camera head, rad: orbits the view and keeps the horizon.
    pub roll_rad: f32,
    /// Rotation of the camera head about the direction of view, rad, anticlockwise as seen from behind it: the picture turns the other way, and
    /// the horizon is lost.
    pub head_roll_rad: f32,
}

impl Endoscope {
    /// Where the endoscope looks from and to: origin at the tip, -Z along the direction of view, Y up in the picture.
    ///
    /// The prism bends the view by the direction of view towards -Y of the shaft's frame; rolling the scope by `roll` turns the prism about
    /// the shaft, and with it the picture, which the camera head turns back by the same angle: `Rz(roll) Rx(-view) Rz(-roll)`. Hence the view
    /// orbits and the horizon stays: exactly at quarter turns, and in between within an angle of tangent `(1 - cos view) / (2 sqrt(cos view))`,
    /// 4.1 degrees for a scope of 30. Rolling the camera head turns the picture about its middle.
    #[must_use]
    pub fn eye_pose(&self) -> Isometry3d {
        let roll = Quat::from_rotation_z(self.roll_rad);
        let bend = Quat::from_rotation_x(-self.direction_of_view_rad);
        let head = Quat::from_rotation_z(self.head_roll_rad);
        Isometry3d::new(self.pose.translation, self.pose.rotation * roll * bend * roll.inverse() * head)
    }
}

/// A triangle mesh as plain data, in the frame of an instrument, m.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PartMesh {
    /// Vertices, m.
    pub vertices: Vec<[f32; 3]>,
    /// Unit normals, one a vertex, outward.
    pub normals: Vec<[f32; 3]>,
    /// Triangles, three indices each, counter-clockwise as seen from outside.
    pub indices: Vec<u32>,
}

/// How a part moves in the frame of its instrument.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Joint {
    /// Not at all.
    #[default]
    Fixed,
    /// Turns about an axis by `factor` times [`Jaws::angle_rad`], right-handed; the mesh is that of closed jaws.
    Hinge {
        /// A point of the axis, m.
        pivot: Vec3,
        /// Unit vector along the axis.
        axis: Vec3,
        /// Angle of the part per angle of the jaws.
        factor: f32,
    },
}

impl Joint {
    /// Where the joint puts its part, in the frame of the instrument, at this angle of the jaws (rad).
    #[must_use]
    pub fn at(self, angle_rad: f32) -> Isometry3d {
        match self {
            Self::Fixed => Isometry3d::IDENTITY,
            Self::Hinge { pivot, axis, factor } => {
                let turn = Quat::from_axis_angle(axis, factor * angle_rad);
                Isometry3d::new(pivot - turn * pivot, turn)
            }
        }
    }
}

/// A rigid part of a tool.
#[derive(Clone, Debug, PartialEq)]
pub struct ToolPart {
    /// `shaft`, `jaw_left`, `blade`...
    pub name: &'static str,
    /// Its surface, in the frame of the instrument with closed jaws.
    pub mesh: PartMesh,
    /// How it moves.
    pub joint: Joint,
    /// Linear RGB.
    pub colour: [f32; 3],
    /// 0 for plastic and ceramics, 1 for bare metal.
    pub metallic: f32,
}

/// What an instrument looks like, part by part. Written by instruments once the instrument is there.
#[derive(Component, Clone, Debug, Default, PartialEq)]
pub struct ToolModel {
    /// The parts.
    pub parts: Vec<ToolPart>,
}
