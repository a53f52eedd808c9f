//! From a sheet and positions to the vertex buffers of a `Mesh`, in place.

use crate::depth::Depths;
use crate::sheet::{Sheet, Side};
use bevy::asset::RenderAssetUsages;
use bevy::mesh::{Indices, PrimitiveTopology, VertexAttributeValues};
use bevy::prelude::*;
use keyhole_tetmesh::TetMesh;
use keyhole_whiteboard::OrganMaterials;

/// An empty mesh with the buffers of an organ.
#[must_use]
pub fn empty_mesh() -> Mesh {
    Mesh::new(PrimitiveTopology::TriangleList, RenderAssetUsages::default())
        .with_inserted_attribute(Mesh::ATTRIBUTE_POSITION, Vec::<[f32; 3]>::new())
        .with_inserted_attribute(Mesh::ATTRIBUTE_NORMAL, Vec::<[f32; 3]>::new())
        .with_inserted_attribute(Mesh::ATTRIBUTE_COLOR, Vec::<[f32; 4]>::new())
        .with_inserted_indices(Indices::U32(Vec::new()))
}

/// Writes positions and normals, which have one entry a node slot; normals may have any length.
pub fn write_shape(mesh: &mut Mesh, sheet: &Sheet, positions: &[Vec3], normals: &[Vec3]) {
    let count = sheet.vertices().len();
    if let Some(VertexAttributeValues::Float32x3(out)) = mesh.attribute_mut(Mesh::ATTRIBUTE_POSITION) {
        out.resize(count, [0.0; 3]);
        for (out, vertex) in out.iter_mut().zip(sheet.vertices()) {
            *out = positions[vertex.node.index()].to_array();
        }
    }
    if let Some(VertexAttributeValues::Float32x3(out)) = mesh.attribute_mut(Mesh::ATTRIBUTE_NORMAL) {
        out.resize(count, [0.0; 3]);
        for (out, vertex) in out.iter_mut().zip(sheet.vertices()) {
            *out = normals[vertex.node.index()].normalize_or(Vec3::Y).to_array();
        }
    }
}

/// Writes triangles and colours after the topology changed; [`write_shape`] must follow. `depths` are those of the opened inside.
pub fn write_topology(mesh: &mut Mesh, sheet: &Sheet, side: Side, organ: &TetMesh, materials: &OrganMaterials, depths: &Depths) {
    if let Some(Indices::U32(out)) = mesh.indices_mut() {
        out.clear();
        out.extend_from_slice(sheet.indices());
    }
    if let Some(VertexAttributeValues::Float32x4(out)) = mesh.attribute_mut(Mesh::ATTRIBUTE_COLOR) {
        out.resize(sheet.vertices().len(), [0.0; 4]);
        for (slot, (out, vertex)) in out.iter_mut().zip(sheet.vertices()).enumerate() {
            if sheet.is_used(slot) {
                let (material, rest) = (materials.get(vertex.material), organ.rest(vertex.node).as_vec3());
                let colour = match side {
                    Side::Skin => skin_colour(material.surface.into(), rest),
                    Side::Inside => inside_colour(material.inside.into(), rest, depths.at(vertex.node)),
                };
                *out = colour.extend(1.0).to_array();
            }
        }
    }
}

/// Normals at the nodes of a sheet: sums of the adjacent faces' area vectors, so that the larger face counts for more. `normals` has one
/// entry a node slot; the others stay.
pub fn node_normals(sheet: &Sheet, positions: &[Vec3], normals: &mut Vec<Vec3>) {
    normals.resize(positions.len(), Vec3::ZERO);
    for vertex in sheet.vertices() {
        normals[vertex.node.index()] = Vec3::ZERO;
    }
    for face in sheet.indices().chunks_exact(3) {
        let nodes = [0, 1, 2].map(|k| sheet.vertices()[face[k] as usize].node.index());
        let [a, b, c] = nodes.map(|n| positions[n]);
        let area = (b - a).cross(c - a);
        nodes.iter().for_each(|n| normals[*n] += area);
    }
}

/// A wave of that length (m) in the rest shape.
fn wave(rest: Vec3, length_m: f32, along: Vec3, phase: f32) -> f32 {
    (rest.dot(along) * std::f32::consts::TAU / length_m + phase).sin()
}

/// Skin varies a little from place to place, in waves of 4 to 20 mm.
fn skin_colour(colour: Vec3, rest: Vec3) -> Vec3 {
    let slow = wave(rest, 0.019, Vec3::new(0.8, 0.5, -0.3), 0.3) * wave(rest, 0.023, Vec3::new(-0.4, 0.7, 0.6), 1.1);
    let fast = wave(rest, 0.0053, Vec3::new(0.3, -0.6, 0.7), 2.0) * wave(rest, 0.0041, Vec3::new(0.7, 0.2, 0.7), 0.7);
    (1.0 + 0.14 * slow + 0.07 * fast) * colour + 0.012 * (slow * fast).max(0.0) * Vec3::new(1.0, 0.7, 0.6)
}

/// A section: pale where it meets the skin, dark in the depth, with lobes of 9 to 16 mm between: shorter ones the vertices could not show.
fn inside_colour(colour: Vec3, rest: Vec3, depth_m: f32) -> Vec3 {
    let lobes = wave(rest, 0.0125, Vec3::new(0.8, 0.5, -0.3), 0.3) * wave(rest, 0.0155, Vec3::new(-0.4, 0.7, 0.6), 1.1)
        + 0.5 * wave(rest, 0.0093, Vec3::new(0.3, -0.6, 0.7), 2.0);
    // The border between bark and marrow waves with the lobes.
    let marrow = ((depth_m - 0.007 - 0.002 * lobes) / 0.005).clamp(0.0, 1.0);
    let marrow = marrow * marrow * (3.0 - 2.0 * marrow);
    let bark = (1.08 + 0.06 * lobes) * colour.lerp(Vec3::new(0.75, 0.45, 0.36), 0.10 * (-depth_m / 0.003).exp() + 0.06);
    bark.lerp((0.74 + 0.10 * lobes) * colour * Vec3::new(1.0, 0.85, 1.05), marrow)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::outer::OuterPlanes;
    use crate::sheet::Surface;
    use crate::testing::block;

    /// The area vectors of a closed surface sum to zero, and the summed normals at the nodes to three times that; at the middle of a flat
    /// side the normal is the side's.
    #[test]
    fn normals_close_and_are_flat_on_flat_sides() {
        let mesh = block([4, 4, 4], 0.01);
        let surface = Surface::of(&mesh, &OuterPlanes::of(&mesh));
        let positions: Vec<Vec3> = mesh.rest_positions().iter().map(|p| p.as_vec3()).collect();
        let mut normals = Vec::new();
        let sheet = surface.sheet(Side::Skin);
        node_normals(sheet, &positions, &mut normals);
        let sum: Vec3 = sheet.vertices().iter().map(|v| normals[v.node.index()]).sum();
        assert!(sum.length() < 1e-6 * 6.0 * 0.04 * 0.04);
        let top = sheet.vertices().iter().find(|v| positions[v.node.index()].distance(Vec3::new(0.02, 0.04, 0.02)) < 1e-6).map(|v| v.node);
        assert!(top.is_some_and(|n| normals[n.index()].normalize().distance(Vec3::Y) < 1e-6));
    }
}
