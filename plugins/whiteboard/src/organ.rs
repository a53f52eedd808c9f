//! Organs: their mesh, their state, and what happens to them.

use bevy_ecs::prelude::*;
use bevy_math::Vec3;
use keyhole_tetmesh::{MaterialId, NodeId, TetMesh, TopologyDelta};

/// A soft body. Written by the scene, and by cutting for a freed fragment.
#[derive(Component, Clone, Debug, PartialEq)]
#[require(OrganMaterials, crate::Attachments, crate::Contacts)]
pub struct Organ {
    /// Name for the HUD and for reports.
    pub name: String,
}

/// The mesh of an organ in its rest shape (m). Written by the scene, then by cutting alone.
#[derive(Component, Clone, Debug)]
pub struct TissueMesh(pub TetMesh);

/// Deformed positions and velocities of an organ, one entry a node slot. Written by tissue alone.
#[derive(Component, Clone, Debug, Default, PartialEq)]
pub struct TissueState {
    /// Positions in the world, m.
    pub positions: Vec<Vec3>,
    /// Velocities, m/s.
    pub velocities: Vec<Vec3>,
}

impl TissueState {
    /// The rest shape at rest.
    #[must_use]
    pub fn at_rest(mesh: &TetMesh) -> Self {
        let positions: Vec<Vec3> = mesh.rest_positions().iter().map(|p| p.as_vec3()).collect();
        Self { velocities: vec![Vec3::ZERO; positions.len()], positions }
    }

    /// Position of a node, m.
    #[must_use]
    pub fn position(&self, node: NodeId) -> Vec3 {
        self.positions[node.index()]
    }
}

/// Elastic material in physical units.
#[derive(Clone, Debug, PartialEq)]
pub struct OrganMaterial {
    /// Name, as in the scene: `kidney`, `tumour`.
    pub name: String,
    /// Young's modulus, Pa.
    pub young_modulus_pa: f32,
    /// Poisson's ratio, in [0, 0.5).
    pub poisson_ratio: f32,
    /// Density, kg/m3.
    pub density_kg_m3: f32,
    /// Colour inside, linear RGB.
    pub inside: [f32; 3],
    /// Colour of the outer surface, linear RGB.
    pub surface: [f32; 3],
}

impl Default for OrganMaterial {
    /// Kidney: E 14.7 kPa (magnetic resonance elastography of 10 volunteers, doi 10.1002/jmri.22670), nu 0.45, 1050 kg/m3.
    fn default() -> Self {
        Self {
            name: "kidney".into(),
            young_modulus_pa: 14_700.0,
            poisson_ratio: 0.45,
            density_kg_m3: 1050.0,
            inside: [0.55, 0.10, 0.08],
            surface: [0.45, 0.13, 0.10],
        }
    }
}

/// The materials of an organ, by [`MaterialId`]; the last one serves ids beyond the end.
#[derive(Component, Clone, Debug, PartialEq)]
pub struct OrganMaterials(pub Vec<OrganMaterial>);

impl Default for OrganMaterials {
    fn default() -> Self {
        Self(vec![OrganMaterial::default()])
    }
}

impl OrganMaterials {
    /// The material of an id.
    ///
    /// # Panics
    /// When the list is empty.
    #[must_use]
    pub fn get(&self, id: MaterialId) -> &OrganMaterial {
        &self.0[usize::from(id.0).min(self.0.len() - 1)]
    }
}

/// The topology of an organ changed. Written by cutting, at most one an organ a tick; every observer updates what the delta names.
#[derive(Message, Clone, Debug)]
pub struct TopologyChanged {
    /// The organ.
    pub organ: Entity,
    /// What changed.
    pub delta: TopologyDelta,
}

/// A piece of an organ has come free and is now the organ `entity`, with its own [`TissueMesh`]. The donor's message in the same tick
/// lists the nodes and tetrahedra that it lost. Triggered by cutting.
#[derive(EntityEvent, Clone, Debug)]
pub struct FragmentDetached {
    /// The new organ.
    pub entity: Entity,
    /// The organ it came from.
    pub donor: Entity,
    /// For each node of the new organ the donor's node that it was: positions, velocities and attachments go with it.
    pub donor_nodes: Vec<NodeId>,
}

/// On a fragment: the organ it was a part of, and when it came free.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
pub struct FreedFrom {
    /// The organ it came from.
    pub donor: Entity,
    /// Simulated time at which it came free, s.
    pub time_s: f64,
}

/// Anatomy that cannot deform, as it is seen. Written by the scene.
#[derive(Component, Clone, Debug, PartialEq)]
pub struct Anatomy {
    /// Name for the HUD.
    pub name: String,
    /// The surface in the frame of the entity; without normals, edges between flat faces are seen as edges.
    pub surface: crate::PartMesh,
    /// Linear RGB.
    pub colour: [f32; 3],
}
