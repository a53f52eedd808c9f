//! From a sheet and positions to the vertex buffers of a `Mesh`, in place.

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

/// Writes positions and smooth normals. `positions` and `scratch` have one entry a node slot.
pub fn write_shape(mesh: &mut Mesh, sheet: &Sheet, positions: &[Vec3], scratch: &mut Vec<Vec3>) {
    node_normals(sheet, positions, scratch);
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
            *out = scratch[vertex.node.index()].normalize_or(Vec3::Y).to_array();
        }
    }
}

/// Writes triangles and colours after the topology changed; [`write_shape`] must follow.
pub fn write_topology(mesh: &mut Mesh, sheet: &Sheet, side: Side, organ: &TetMesh, materials: &OrganMaterials) {
    if let Some(Indices::U32(out)) = mesh.indices_mut() {
        out.clear();
        out.extend_from_slice(sheet.indices());
    }
    if let Some(VertexAttributeValues::Float32x4(out)) = mesh.attribute_mut(Mesh::ATTRIBUTE_COLOR) {
        out.resize(sheet.vertices().len(), [0.0; 4]);
        for (slot, (out, vertex)) in out.iter_mut().zip(sheet.vertices()).enumerate() {
            if sheet.is_used(slot) {
                let material = materials.get(vertex.material);
                let [r, g, b] = match side {
                    Side::Skin => material.surface,
                    Side::Inside => material.inside,
                };
                let [dark, pale] = mottle(organ.rest(vertex.node).as_vec3(), side);
                *out = [dark * r + pale, dark * g + 0.7 * pale, dark * b + 0.6 * pale, 1.0];
            }
        }
    }
}

/// Sums of the adjacent faces' area vectors into `scratch` at the nodes of a sheet; the length of the sum weighs by area.
fn node_normals(sheet: &Sheet, positions: &[Vec3], scratch: &mut Vec<Vec3>) {
    scratch.resize(positions.len(), Vec3::ZERO);
    for vertex in sheet.vertices() {
        scratch[vertex.node.index()] = Vec3::ZERO;
    }
    for face in sheet.indices().chunks_exact(3) {
        let nodes = [0, 1, 2].map(|k| sheet.vertices()[face[k] as usize].node.index());
        let [a, b, c] = nodes.map(|n| positions[n]);
        let area = (b - a).cross(c - a);
        nodes.iter().for_each(|n| scratch[*n] += area);
    }
}

/// How tissue varies from place to place: a factor on its colour and a paleness added to it. Waves of 4 to 20 mm in the rest shape.
fn mottle(rest: Vec3, side: Side) -> [f32; 2] {
    let wave = |length_m: f32, along: Vec3, phase: f32| (rest.dot(along) * std::f32::consts::TAU / length_m + phase).sin();
    let slow = wave(0.019, Vec3::new(0.8, 0.5, -0.3), 0.3) * wave(0.023, Vec3::new(-0.4, 0.7, 0.6), 1.1);
    let fast = wave(0.0053, Vec3::new(0.3, -0.6, 0.7), 2.0) * wave(0.0041, Vec3::new(0.7, 0.2, 0.7), 0.7);
    match side {
        Side::Skin => [1.0 + 0.14 * slow + 0.07 * fast, 0.012 * (slow * fast).max(0.0)],
        Side::Inside => [1.0 + 0.10 * slow + 0.16 * fast, 0.02 * fast.max(0.0)],
    }
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
