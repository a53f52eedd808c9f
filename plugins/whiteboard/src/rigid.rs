//! What is rigid: dropped clips, a needle, fragments that a scene wants rigid.
//!
//! Who wants a rigid body spawns [`RigidBody`] with the [`RigidPose`] that it begins with; from then on the pose is written by rigid alone.

use bevy_ecs::prelude::*;
use bevy_math::{Isometry3d, Mat3, Vec3};

/// The shape of a rigid body, in its own frame.
#[derive(Clone, Debug, PartialEq)]
pub enum RigidShape {
    /// The convex hull of points, m: four or more that are not all in a plane.
    Hull(Vec<Vec3>),
    /// Round bars end to end, as of a bent wire or a curved needle.
    Wire {
        /// The ends of the bars in order, m: two or more.
        points: Vec<Vec3>,
        /// Radius of the wire, m.
        radius_m: f32,
    },
    /// The solid inside of a closed surface.
    Solid {
        /// Vertices, m.
        vertices: Vec<Vec3>,
        /// Triangles, counter-clockwise as seen from outside.
        triangles: Vec<[u32; 3]>,
    },
}

/// A rigid body. Written by who spawns it; what rigid has once seen does not change.
#[derive(Component, Clone, Debug, PartialEq)]
#[require(RigidPose)]
pub struct RigidBody {
    /// Its shape.
    pub shape: RigidShape,
    /// Density, kg/m3: mass and inertia follow from it and the shape, where there is no [`RigidMass`].
    pub density_kg_m3: f32,
}

/// Mass and inertia of a rigid body that are not those of its shape. Written by who spawns it.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
pub struct RigidMass {
    /// Mass, kg.
    pub mass_kg: f32,
    /// Centre of mass in the body's frame, m.
    pub centre: Vec3,
    /// Inertia about the centre of mass along the axes of the body's frame, kg m2.
    pub inertia_kg_m2: Mat3,
}

/// Where a rigid body is and how it moves. Spawned with the body; then written by rigid alone.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct RigidPose {
    /// The body's frame in the world.
    pub now: Isometry3d,
    /// The same at the tick before.
    pub before: Isometry3d,
    /// Velocity of the centre of mass, m/s.
    pub linear_m_s: Vec3,
    /// Angular velocity in the world, rad/s.
    pub angular_rad_s: Vec3,
    /// Whether the body is at rest and is not stepped until something touches it.
    pub asleep: bool,
}

impl RigidPose {
    /// A body that is put somewhere at rest.
    #[must_use]
    pub fn at_rest(now: Isometry3d) -> Self {
        Self { now, before: now, ..Self::default() }
    }
}

/// A rigid body that is held by an instrument and goes where it goes. Written by gestures; who takes it off lets the body go, with the velocity that it
/// has.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
pub struct HeldBy {
    /// The instrument.
    pub instrument: Entity,
    /// The body's frame in the frame of the instrument.
    pub local: Isometry3d,
}

/// On an organ that is rigid for the time being, with its [`RigidBody`], [`RigidMass`] and [`RigidPose`]. While it is there the
/// [`TissueState`](crate::TissueState) is written by rigid alone, from the pose: the one exception to tissue's being its writer. Tissue does not step
/// such an organ. Written by rigid.
#[derive(Component, Clone, Debug, PartialEq)]
pub struct Rigidified {
    /// Positions by node slot in the body's frame, m: the deformed shape of the moment when the organ became rigid.
    pub local: Vec<Vec3>,
}

/// On a rigid body whose state became non-finite: it is back where it was last finite, and is no longer moved. Written by rigid.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
pub struct RigidQuarantined {
    /// Simulated time at which it happened, s.
    pub time_s: f64,
}

/// When a fragment becomes rigid. It becomes soft again as soon as something holds it or cuts it. Written by the scene.
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq)]
pub struct RigidFragments {
    /// Those that are lighter, kg: at once. Default `None`: none of them.
    pub lighter_than_kg: Option<f32>,
    /// Those that have been out of the endoscope's view for so long, s. Default `None`: never.
    pub unseen_for_s: Option<f32>,
}

/// What rigid has to report since the scene started. Written by rigid.
#[derive(Resource, Clone, Debug, Default, PartialEq)]
pub struct RigidReport {
    /// Bodies that are being moved: awake and not held.
    pub awake: u32,
    /// Organs that became rigid.
    pub rigidified: u64,
    /// Organs that became soft again.
    pub softened: u64,
    /// Bodies whose shape could not be used, in the order they came.
    pub refused: Vec<Entity>,
    /// Bodies in quarantine, in the order they went there.
    pub quarantined: Vec<Entity>,
}
