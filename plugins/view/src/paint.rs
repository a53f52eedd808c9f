//! Colours that somebody lays over the opened surface of an organ, node by node: the margin of a resection, for one. Nothing is painted by default.

use crate::sheet::Sheet;
use bevy::mesh::VertexAttributeValues;
use bevy::prelude::*;
use keyhole_tetmesh::NodeId;

/// What is painted. Written by the app; whoever is painted is also what the specimen's view shows.
#[derive(Resource, Clone, Debug, Default, PartialEq)]
pub struct Paint(pub Vec<PaintedCut>);

/// The opened surface of an organ in colours.
#[derive(Clone, Debug, PartialEq)]
pub struct PaintedCut {
    /// The organ, or the piece of one.
    pub organ: Entity,
    /// Linear RGB by node, in ascending order of node. Nodes that are not in it keep their tissue's colour.
    pub colours: Vec<(NodeId, [f32; 3])>,
}

impl Paint {
    /// What is painted on an organ.
    #[must_use]
    pub fn of(&self, organ: Entity) -> Option<&PaintedCut> {
        self.0.iter().find(|painted| painted.organ == organ)
    }
}

impl PaintedCut {
    /// Lays the colours over those that the mesh of a sheet has.
    pub fn write(&self, mesh: &mut Mesh, sheet: &Sheet) {
        let Some(VertexAttributeValues::Float32x4(out)) = mesh.attribute_mut(Mesh::ATTRIBUTE_COLOR) else { return };
        for (slot, (out, vertex)) in out.iter_mut().zip(sheet.vertices()).enumerate() {
            let found = self.colours.binary_search_by_key(&vertex.node, |(node, _)| *node);
            if let (true, Ok(i)) = (sheet.is_used(slot), found) {
                let [r, g, b] = self.colours[i].1;
                *out = [r, g, b, 1.0];
            }
        }
    }
}
