//! A soft body becomes rigid and soft again: mass, centre of mass, linear and angular momentum are those of its nodes, before and after.
//!
//! With nodes of mass `m` at `x` moving at `v`: `M = sum m`, `c = sum m x / M`, `V = sum m v / M`, `I = sum m (r2 1 - r rT)` and `I w = sum m r x v`, where
//! `r = x - c`. What moves in the body against that rigid motion is lost: its energy, never momentum. Back again each node gets `V + w x r`.

use crate::mass::Mass;
use bevy_math::{DMat3, DVec3, Isometry3d, Vec3};
use keyhole_tetmesh::TetMesh;
use keyhole_whiteboard::{OrganMaterials, RigidMass, RigidPose, TissueState};

/// An organ as a rigid body. Its frame has its origin at the centre of mass and the axes of the world.
#[derive(Clone, Debug, PartialEq)]
pub struct Frozen {
    /// Positions by node slot in the body's frame, m.
    pub local: Vec<Vec3>,
    /// Mass and inertia.
    pub mass: RigidMass,
    /// Where it is and how it moves.
    pub pose: RigidPose,
}

/// Masses by node slot, kg: a quarter of each tetrahedron's at each of its corners, as tissue has them.
#[must_use]
pub fn node_masses(mesh: &TetMesh, materials: &OrganMaterials) -> Vec<f64> {
    let mut masses = vec![0.0; mesh.node_slots()];
    for (tet, corners) in mesh.iter() {
        let density = f64::from(materials.get(mesh.tet(tet).material).density_kg_m3);
        for node in corners {
            masses[node.index()] += density * mesh.volume(tet) / 4.0;
        }
    }
    masses
}

/// The rigid body that a state is; `None` of one that is not finite, has no mass, or no inertia about some axis.
#[must_use]
pub fn freeze(masses: &[f64], state: &TissueState) -> Option<Frozen> {
    let nodes = || masses.iter().zip(&state.positions).zip(&state.velocities).map(|((m, x), v)| (*m, x.as_dvec3(), v.as_dvec3()));
    let Mass { mass_kg, centre, inertia } = Mass::of_points(nodes().map(|(m, x, _)| (m, x)));
    let linear = nodes().map(|(m, _, v)| v * m).sum::<DVec3>() / mass_kg;
    let angular_momentum: DVec3 = nodes().map(|(m, x, v)| (x - centre).cross((v - linear) * m)).sum();
    let angular = inverse(inertia)? * angular_momentum;
    let mass = RigidMass { mass_kg: mass_kg as f32, centre: Vec3::ZERO, inertia_kg_m2: inertia.as_mat3() };
    let pose = RigidPose {
        linear_m_s: linear.as_vec3(),
        angular_rad_s: angular.as_vec3(),
        ..RigidPose::at_rest(Isometry3d::from_translation(centre.as_vec3()))
    };
    let finite = mass_kg > 0.0 && pose.linear_m_s.is_finite() && pose.angular_rad_s.is_finite() && centre.is_finite();
    // About the centre itself, not about the place that the frame is rounded to: else a spin would have momentum.
    finite.then(|| Frozen { local: state.positions.iter().map(|x| (x.as_dvec3() - centre).as_vec3()).collect(), mass, pose })
}

/// Puts the nodes of a frozen body where its pose has them, each with the velocity of the rigid motion there.
pub fn follow(local: &[Vec3], pose: &RigidPose, state: &mut TissueState) {
    let (turn, centre) = (pose.now.rotation, Vec3::from(pose.now.translation));
    state.positions.clear();
    state.positions.extend(local.iter().map(|r| centre + turn * *r));
    state.velocities.clear();
    state.velocities.extend(local.iter().map(|r| pose.linear_m_s + pose.angular_rad_s.cross(turn * *r)));
}

/// The inverse of an inertia; `None` where it is zero about some axis, to what doubles tell from the others.
fn inverse(inertia: DMat3) -> Option<DMat3> {
    let size = (inertia.x_axis.x + inertia.y_axis.y + inertia.z_axis.z) / 3.0;
    let unit = inertia * size.recip();
    (unit.determinant() > 1e3 * f64::EPSILON).then(|| unit.inverse() * size.recip())
}
