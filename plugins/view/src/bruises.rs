//! Bruises: skin that a grasper pressed too hard is darker, and bluish.

use crate::sheet::Sheet;
use bevy::mesh::VertexAttributeValues;
use bevy::prelude::*;
use keyhole_whiteboard::Bruises;

/// Linear RGB of blood under the skin.
const BLOOD: Vec3 = Vec3::new(0.10, 0.012, 0.035);
/// How much of it is seen where a bruise is worst.
const COVERS: f32 = 0.85;

/// Darkens vertices by the bruises of their nodes, once their colours have been written.
pub fn tint(mesh: &mut Mesh, sheet: &Sheet, bruises: &Bruises) {
    if bruises.by_node.is_empty() {
        return;
    }
    if let Some(VertexAttributeValues::Float32x4(colours)) = mesh.attribute_mut(Mesh::ATTRIBUTE_COLOR) {
        for (colour, vertex) in colours.iter_mut().zip(sheet.vertices()) {
            let bad = bruises.by_node.get(vertex.node.index()).copied().unwrap_or(0.0);
            // A light bruise is seen too.
            *colour = Vec4::from_array(*colour).truncate().lerp(BLOOD, COVERS * bad.sqrt()).extend(1.0).to_array();
        }
    }
}
