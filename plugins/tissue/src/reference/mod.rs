//! The reference: the mesh's own equilibrium and motion in f64, for truth and not for play.
//!
//! The same elements, masses and energy as the models that play, `psi(F) = mu/2 (tr F'F - 3) + lambda/2 (det F - a)^2` (see
//! [`crate::NeoHookean`]), by Newton's method with the exact tangent and a sparse Cholesky factorisation:
//!
//! - [`statics`]: where a loaded body comes to rest; line search on the potential energy, load in as many steps as it takes;
//! - [`dynamics`]: how it gets there; the second order backward differentiation formula;
//! - [`quadratic`]: ten-node elements of the same energy, for what linear ones tend to as they get small, and for nearly incompressible material;
//! - [`modes`]: how slowly it swings about an equilibrium;
//! - [`prestress`]: which rest shape comes to rest at the shape that was scanned.
//!
//! Unlike [`crate::Body`] it takes the material as it is for slivers, too.

pub mod dynamics;
pub mod energy;
pub mod modes;
pub mod prestress;
pub mod quadratic;
pub mod sparse;
pub mod statics;

pub use dynamics::Dynamics;
pub use energy::Tetra;
pub use modes::slowest_mode;
pub use prestress::unloaded;
pub use quadratic::Quadratic;
pub use statics::{Statics, equilibrium};

use crate::material::{MaterialError, NeoHookean};
use crate::membrane::Membrane;
use bevy_math::DVec3;
use keyhole_tetmesh::TetMesh;
use keyhole_whiteboard::OrganMaterials;

/// Why the reference has no answer.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ReferenceError {
    /// A material that no tissue has.
    #[error(transparent)]
    Material(#[from] MaterialError),
    /// Newton's method did not converge.
    #[error(
        "after {iterations} iterations {residual} of the load is out of balance, expected {expected}; load in smaller steps, or hold the body at three nodes or more"
    )]
    NotConverged {
        /// Iterations made.
        iterations: u32,
        /// Norm of the residual over that of the load.
        residual: f64,
        /// The tolerance.
        expected: f64,
    },
    /// The matrix cannot be factorised.
    #[error(
        "the stiffness matrix of {unknowns} unknowns cannot be factorised: {reason}; a body that nothing holds has no equilibrium under a load"
    )]
    Factorisation {
        /// Size of the matrix.
        unknowns: usize,
        /// What the library says.
        reason: String,
    },
}

/// A body as the reference sees it.
#[derive(Clone, Debug)]
pub struct Problem {
    /// Its elements.
    pub tets: Vec<Tetra>,
    /// Its elements of ten nodes.
    pub quadratic: Vec<Quadratic>,
    /// Mass by node slot, kg: a quarter of each linear tetrahedron's; 0 for slots that nothing uses.
    pub masses: Vec<f64>,
    /// Rest position by node slot, m.
    pub rest: Vec<DVec3>,
    /// Whether a node stays where it is put, by node slot. Slots that nothing uses do.
    pub fixed: Vec<bool>,
    /// A membrane on its surface.
    pub membrane: Option<Membrane>,
}

impl Problem {
    /// The body of a mesh with the nodes fixed that `is_fixed` says.
    ///
    /// # Errors
    /// When a material has constants that no material has.
    pub fn new(
        mesh: &TetMesh,
        materials: &OrganMaterials,
        is_fixed: impl Fn(keyhole_tetmesh::NodeId) -> bool,
    ) -> Result<Self, MaterialError> {
        let constants = materials.0.iter().map(NeoHookean::of).collect::<Result<Vec<_>, _>>()?;
        let rest: Vec<DVec3> = mesh.rest_positions().iter().map(|p| DVec3::new(p.x, p.y, p.z)).collect();
        let mut masses = vec![0.0; rest.len()];
        let mut tets = Vec::with_capacity(mesh.tet_count());
        for (tet, corners) in mesh.iter() {
            let id = usize::from(mesh.tet(tet).material.0).min(constants.len() - 1);
            let nodes = corners.map(|n| n.0);
            let element = Tetra::new(nodes, nodes.map(|n| rest[n as usize]), constants[id]);
            for n in nodes {
                masses[n as usize] += f64::from(materials.0[id].density_kg_m3) * element.volume / 4.0;
            }
            tets.push(element);
        }
        let fixed = masses.iter().enumerate().map(|(i, m)| *m <= 0.0 || is_fixed(keyhole_tetmesh::NodeId(i as u32))).collect();
        Ok(Self { tets, quadratic: Vec::new(), masses, rest, fixed, membrane: None })
    }

    /// Elastic energy, J.
    #[must_use]
    pub fn energy(&self, positions: &[DVec3]) -> f64 {
        let bulk: f64 = self.tets.iter().map(|t| t.energy(t.at(positions))).sum();
        let quadratic: f64 = self.quadratic.iter().map(|t| t.energy(t.at(positions))).sum();
        bulk + quadratic + self.membrane.as_ref().map_or(0.0, |m| m.energy(positions))
    }

    /// Elastic forces on the nodes, N.
    #[must_use]
    pub fn forces(&self, positions: &[DVec3]) -> Vec<DVec3> {
        let mut forces = vec![DVec3::ZERO; positions.len()];
        for t in &self.tets {
            for (n, f) in t.nodes.iter().zip(t.forces(t.at(positions))) {
                forces[*n as usize] += f;
            }
        }
        for t in &self.quadratic {
            for (n, f) in t.nodes.iter().zip(t.forces(t.at(positions))) {
                forces[*n as usize] += f;
            }
        }
        if let Some(membrane) = &self.membrane {
            membrane.add_forces(positions, &mut forces);
        }
        forces
    }

    /// The weight of every node, N.
    #[must_use]
    pub fn weights(&self, gravity: DVec3) -> Vec<DVec3> {
        self.masses.iter().map(|m| gravity * *m).collect()
    }
}

/// Norm over the free nodes.
pub(crate) fn norm(values: &[DVec3], fixed: &[bool]) -> f64 {
    values.iter().zip(fixed).filter(|(_, f)| !**f).map(|(v, _)| v.length_squared()).sum::<f64>().sqrt()
}
