//! Anatomy that cannot deform, drawn as it stands on the whiteboard.

use crate::framing::bounds;
use crate::layers;
use crate::shading::{Look, SceneMaterial, Sides};
use crate::tools::Draws;
use bevy::asset::RenderAssetUsages;
use bevy::mesh::{Indices, PrimitiveTopology};
use bevy::prelude::*;
use keyhole_whiteboard::{Anatomy, PartMesh};
use rustc_hash::FxHashMap;

/// Faces that meet at more than this are seen to meet in an edge, rad: 40 degrees.
const CREASE_RAD: f32 = 0.7;

/// The box around all anatomy, m; `None` while there is none.
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq)]
pub struct AnatomyBounds(pub Option<(Vec3, Vec3)>);

/// Draws anatomy that has come, where it lies.
pub fn draw_anatomy(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<SceneMaterial>>,
    mut extent: ResMut<AnatomyBounds>,
    come: Query<(Entity, &Anatomy, &Transform), Added<Anatomy>>,
    mut gone: RemovedComponents<Anatomy>,
) {
    // All are read: what is left over would take the extent of those that come now in the next frame.
    if gone.read().count() > 0 {
        extent.0 = None;
    }
    for (entity, anatomy, place) in &come {
        let surface = &anatomy.surface;
        let corners = surface.vertices.iter().map(|v| place.transform_point(Vec3::from_array(*v)));
        extent.0 = bounds(corners.chain(extent.0.into_iter().flat_map(|(low, high)| [low, high])));
        commands.spawn((
            Name::new(anatomy.name.clone()),
            Draws(entity),
            *place,
            Mesh3d(meshes.add(mesh_of(surface))),
            MeshMaterial3d(materials.add(SceneMaterial {
                // Of what is closed the inside is not seen.
                sides: if is_closed(surface) { Sides::Front } else { Sides::Both },
                ..SceneMaterial::coated(Look {
                    roughness: 0.6,
                    reflectance: 0.4,
                    coat: 0.4,
                    coat_roughness: 0.3,
                    ..Look::of(anatomy.colour)
                })
            })),
            layers::shared(),
        ));
    }
}

fn mesh_of(surface: &PartMesh) -> Mesh {
    let list = |vertices: Vec<[f32; 3]>, normals: Vec<[f32; 3]>, indices: Vec<u32>| {
        Mesh::new(PrimitiveTopology::TriangleList, RenderAssetUsages::default())
            .with_inserted_attribute(Mesh::ATTRIBUTE_POSITION, vertices)
            .with_inserted_attribute(Mesh::ATTRIBUTE_NORMAL, normals)
            .with_inserted_indices(Indices::U32(indices))
    };
    if surface.normals.len() == surface.vertices.len() {
        return list(surface.vertices.clone(), surface.normals.clone(), surface.indices.clone());
    }
    let corners: Vec<[f32; 3]> = surface.indices.iter().map(|i| surface.vertices[*i as usize]).collect();
    let normals = creased_normals(surface);
    let indices = (0..corners.len() as u32).collect();
    list(corners, normals, indices)
}

/// Whether a surface is closed and turned outward: each edge is run through as often one way as the other, and what it encloses is not negative.
fn is_closed(surface: &PartMesh) -> bool {
    let mut open: FxHashMap<(u32, u32), i32> = FxHashMap::default();
    let mut volume = 0.0;
    let at = |i: u32| Vec3::from_array(surface.vertices[i as usize]).as_dvec3();
    for t in surface.indices.chunks_exact(3) {
        for (from, to) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
            *open.entry((from.min(to), from.max(to))).or_default() += if from < to { 1 } else { -1 };
        }
        volume += at(t[0]).dot(at(t[1]).cross(at(t[2])));
    }
    volume > 0.0 && open.values().all(|ways| *ways == 0)
}

/// A normal for each corner of each triangle: the mean, by area, of the faces at its vertex that meet the triangle at less than [`CREASE_RAD`].
fn creased_normals(surface: &PartMesh) -> Vec<[f32; 3]> {
    let at = |i: u32| Vec3::from_array(surface.vertices[i as usize]);
    let triangles: Vec<[u32; 3]> = surface.indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect();
    let areas: Vec<Vec3> = triangles.iter().map(|&[a, b, c]| (at(b) - at(a)).cross(at(c) - at(a))).collect();
    let mut faces: Vec<Vec<usize>> = vec![Vec::new(); surface.vertices.len()];
    for (f, triangle) in triangles.iter().enumerate() {
        triangle.iter().for_each(|v| faces[*v as usize].push(f));
    }
    let corner = |(f, v): (usize, u32)| {
        let alike = faces[v as usize].iter().filter(|g| areas[**g].angle_between(areas[f]) < CREASE_RAD);
        alike.map(|g| areas[*g]).sum::<Vec3>().try_normalize().unwrap_or(Vec3::Y).to_array()
    };
    triangles.iter().enumerate().flat_map(|(f, t)| t.map(|v| (f, v))).map(corner).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::ecs::system::RunSystemOnce;

    /// Anatomy was once drawn in the frame of its file, wherever the scene had put it.
    #[test]
    fn anatomy_is_drawn_where_it_lies() {
        let mut world = World::new();
        world.init_resource::<Assets<Mesh>>();
        world.init_resource::<Assets<SceneMaterial>>();
        world.init_resource::<AnatomyBounds>();
        let vertices = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0]];
        let surface = PartMesh { vertices, normals: Vec::new(), indices: vec![0, 1, 2] };
        let place = Transform::from_xyz(3.0, 0.0, -1.0).with_rotation(Quat::from_rotation_z(std::f32::consts::FRAC_PI_2));
        world.spawn((Anatomy { name: "bone".into(), surface, colour: [1.0; 3] }, place));
        assert!(world.run_system_once(draw_anatomy).is_ok());
        let mut drawn = world.query_filtered::<&Transform, With<Mesh3d>>();
        assert_eq!(drawn.iter(&world).copied().collect::<Vec<_>>(), [place]);
        let Some((low, high)) = world.resource::<AnatomyBounds>().0 else { panic!("there is anatomy") };
        assert!(low.distance(Vec3::new(1.0, 0.0, -1.0)) < 1e-6 && high.distance(Vec3::new(3.0, 1.0, -1.0)) < 1e-6, "{low} {high}");
    }

    /// When a scene of several pieces was started over their extent was once lost in the frame after: the drape was drawn over them.
    #[test]
    fn the_extent_of_anatomy_outlives_a_restart() {
        let mut world = World::new();
        world.init_resource::<Assets<Mesh>>();
        world.init_resource::<Assets<SceneMaterial>>();
        world.init_resource::<AnatomyBounds>();
        let surface = PartMesh { vertices: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0]], normals: Vec::new(), indices: vec![0, 1, 2] };
        let spawn = |world: &mut World| {
            let piece = |_| (Anatomy { name: "bone".into(), surface: surface.clone(), colour: [1.0; 3] }, Transform::IDENTITY);
            (0..3).map(piece).map(|piece| world.spawn(piece).id()).collect::<Vec<_>>()
        };
        let draw = world.register_system(draw_anatomy);
        let old = spawn(&mut world);
        assert!(world.run_system(draw).is_ok());
        for piece in old {
            world.despawn(piece);
        }
        spawn(&mut world);
        for _ in 0..3 {
            assert!(world.run_system(draw).is_ok());
            assert!(world.resource::<AnatomyBounds>().0.is_some());
        }
    }

    #[test]
    fn what_is_closed_is_told_from_what_is_open_or_inside_out() {
        let vertices = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let faces = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
        let of = |indices: Vec<u32>| PartMesh { vertices: vertices.clone(), normals: Vec::new(), indices };
        assert!(is_closed(&of(faces.concat())));
        assert!(!is_closed(&of(faces[1..].concat())));
        assert!(!is_closed(&of(faces.map(|[a, b, c]| [a, c, b]).concat())));
        assert!(!is_closed(&of(Vec::new())));
    }

    #[test]
    fn a_roof_keeps_its_ridge_and_a_shallow_one_is_smooth() {
        let roof = |height: f32| {
            let vertices = vec![[0.0, height, 0.0], [0.0, height, 1.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]];
            creased_normals(&PartMesh { vertices, normals: Vec::new(), indices: vec![0, 1, 2, 0, 3, 1] })
        };
        let steep = roof(1.0);
        assert!(steep[0][0] > 0.7 && steep[3][0] < -0.7, "{steep:?}");
        let shallow = roof(0.1);
        assert!(shallow[0][0].abs() < 1e-6 && shallow[3][0].abs() < 1e-6, "{shallow:?}");
    }
}
