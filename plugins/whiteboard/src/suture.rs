//! Needle, thread, bites and knots: what a suture is at any moment. One entity is one suture.

use crate::TissuePoint;
use bevy_ecs::prelude::*;
use bevy_math::{Isometry3d, Vec3};
use smallvec::SmallVec;

/// A curved needle at the end of its thread. The scene writes what it is and where it lies at first; everything else is written by suturing.
///
/// Its frame: the centre of its circle is the origin, the wire lies in the plane of X and Y, from the swage, where the thread is, at angle 0 on
/// X, right-handed about Z to the tip. Turning about Z drives it.
#[derive(Component, Clone, Debug, PartialEq)]
#[require(Thread, Bites, Knots)]
pub struct Needle {
    /// Radius of the circle, m.
    pub radius_m: f32,
    /// Angle from swage to tip, rad: half a circle is pi.
    pub arc_rad: f32,
    /// Radius of the wire, m.
    pub wire_radius_m: f32,
    /// Mass, kg.
    pub mass_kg: f32,
    /// Where it is.
    pub pose: Isometry3d,
    /// The jaws that hold it; it follows the first.
    pub grips: SmallVec<[NeedleGrip; 2]>,
}

/// Jaws on a needle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NeedleGrip {
    /// The instrument.
    pub instrument: Entity,
    /// The needle's pose in the instrument's frame.
    pub local: Isometry3d,
}

impl Needle {
    /// A half circle of 26 mm of wire, 0.66 mm thick, of steel.
    #[must_use]
    pub fn half_circle_26mm(pose: Isometry3d) -> Self {
        use std::f32::consts::PI;
        let (length_m, wire_radius_m) = (0.026, 0.000_33);
        let mass_kg = 7900.0 * PI * wire_radius_m * wire_radius_m * length_m;
        Self { radius_m: length_m / PI, arc_rad: PI, wire_radius_m, mass_kg, pose, grips: SmallVec::new() }
    }

    /// Length of the wire, m.
    #[must_use]
    pub fn length_m(&self) -> f32 {
        self.radius_m * self.arc_rad
    }

    /// The point of its centre line at an angle from the swage (rad), in the world with this pose of the needle, m.
    #[must_use]
    pub fn point(&self, pose: &Isometry3d, angle_rad: f32) -> Vec3 {
        let (sin, cos) = angle_rad.sin_cos();
        pose.transform_point(self.radius_m * Vec3::new(cos, sin, 0.0)).into()
    }

    /// Unit vector along its centre line towards the tip at an angle from the swage (rad), in the world with this pose of the needle.
    #[must_use]
    pub fn forward(&self, pose: &Isometry3d, angle_rad: f32) -> Vec3 {
        let (sin, cos) = angle_rad.sin_cos();
        pose.rotation * Vec3::new(-sin, cos, 0.0)
    }
}

/// A thread. Where along it something is, is told by the length from its tail; the needle goes on where the thread ends, at the swage.
#[derive(Component, Clone, Debug, Default, PartialEq)]
pub struct Thread {
    /// Its centre line from the tail to the swage, m. Written by the scene at first, then by suturing. Fewer than two points: no thread.
    pub points: Vec<Vec3>,
    /// Its radius, m.
    pub radius_m: f32,
    /// Its length, m. Written by suturing from the first points.
    pub length_m: f32,
    /// Largest tension in it, N.
    pub tension_n: f32,
    /// Tension at its tail and at its swage, N: what pulls at it there.
    pub end_tension_n: [f32; 2],
    /// The jaws that hold it, in the order in which they took hold.
    pub grips: SmallVec<[ThreadGrip; 2]>,
}

/// Jaws on a thread.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThreadGrip {
    /// The instrument.
    pub instrument: Entity,
    /// Where along the thread, m.
    pub at_m: f32,
    /// Where in the instrument's frame, m.
    pub local: Vec3,
}

/// What a hole in the tissue is to the needle that made it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum HoleKind {
    /// Where it went in.
    Entry,
    /// The middle of its way through the tissue.
    Channel,
    /// Where it came out.
    Exit,
}

/// A place of the tissue that a needle and its thread run through.
#[derive(Clone, Debug, PartialEq)]
pub struct Hole {
    /// What it is.
    pub kind: HoleKind,
    /// The point of the tissue.
    pub point: TissuePoint,
    /// The same point in the rest shape, m.
    pub rest: Vec3,
    /// What of thread and needle is there: length from the tail, m.
    pub at_m: f32,
    /// Where thread or needle is held there, m.
    pub anchor: Vec3,
    /// What it does to the tissue, N.
    pub force_n: Vec3,
}

/// One way of the needle through tissue: in, and out again unless the tip is still inside.
#[derive(Clone, Debug, PartialEq)]
pub struct Bite {
    /// The organ.
    pub organ: Entity,
    /// Entry, channel, exit: in the order in which the needle made them.
    pub holes: SmallVec<[Hole; 3]>,
    /// Force of needle and thread on the tissue, all holes together, N.
    pub load_n: f32,
    /// Force at which they tear out, in the direction of the load, N.
    pub strength_n: f32,
}

/// A bite that was torn out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TornBite {
    /// The organ.
    pub organ: Entity,
    /// Where it was, m.
    pub place: Vec3,
    /// The force that tore it, N.
    pub load_n: f32,
    /// The force that it would have borne, N.
    pub strength_n: f32,
    /// Tissue between it and the surface in the direction of the force, m.
    pub depth_m: f32,
}

/// The bites of a suture in the order in which the needle made them, from the tail to the needle. Written by suturing.
#[derive(Component, Clone, Debug, Default, PartialEq)]
pub struct Bites {
    /// What it runs through.
    pub held: Vec<Bite>,
    /// What was torn.
    pub torn: Vec<TornBite>,
}

/// Force at which a bite tears out of an organ per length of tissue ahead of it, N/m; an organ without it is as the settings of suturing say. Written by the scene.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
pub struct TearResistance(pub f32);

/// Throws that lie on each other: the two strands of the thread go around each other here.
#[derive(Clone, Debug, PartialEq)]
pub struct Knot {
    /// Where it is on the strand that ends in the tail and on the one that ends in the needle: lengths from the tail, m.
    pub at_m: [f32; 2],
    /// Turns of each throw, from the tissue outwards: positive right-handed. A square knot is `[1, -1]`, a surgeon's first throw `[2]`.
    pub throws: SmallVec<[i8; 4]>,
    /// The difference of tension between loop and end that it holds, of each strand, N: as hard as it was pulled tight, and no more than so many turns can hold.
    pub hold_n: f32,
    /// Where it is, m.
    pub place: Vec3,
}

impl Knot {
    /// Turns of all throws together.
    #[must_use]
    pub fn turns(&self) -> u32 {
        self.throws.iter().map(|t| u32::from(t.unsigned_abs())).sum()
    }
}

/// The knots of a suture, from the tissue outwards. Written by suturing.
#[derive(Component, Clone, Debug, Default, PartialEq)]
pub struct Knots {
    /// The knots.
    pub tied: Vec<Knot>,
    /// How often the strands beyond the outermost knot go around each other now, as if they could not go through each other: a crossing is about a half, a loop about one. Signed as
    /// [`Knot::throws`].
    pub winding: f32,
    /// Knots that came undone.
    pub undone: u32,
}

/// What suturing has to report since the scene started. Written by suturing.
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SutureReport {
    /// Substeps of threads that were not taken, because their result was not finite or farther away than the thread is long: the thread stood still.
    pub refused: u64,
    /// Bites that tore out.
    pub torn: u64,
}
