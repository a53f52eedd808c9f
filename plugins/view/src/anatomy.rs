//! Anatomy that is only seen: surfaces read from glTF files.

use crate::framing::bounds;
use crate::layers;
use crate::tools::Draws;
use bevy::asset::RenderAssetUsages;
use bevy::math::Mat4;
use bevy::mesh::{Indices, PrimitiveTopology};
use bevy::prelude::*;
use keyhole_whiteboard::Anatomy;
use std::cell::Cell;
use std::path::{Path, PathBuf};

/// Why a surface cannot be drawn.
#[derive(Debug, thiserror::Error)]
pub enum SurfaceError {
    /// The file cannot be read or is no glTF.
    #[error("{path}: {source}; expected a binary glTF file (.glb)")]
    Gltf {
        /// The file.
        path: PathBuf,
        /// What the reader says.
        source: Box<gltf::Error>,
    },
    /// The file keeps its data elsewhere.
    #[error("{path}: buffer {buffer} is not inside the file; export as a single .glb")]
    OutsideBuffer {
        /// The file.
        path: PathBuf,
        /// Index of the buffer.
        buffer: usize,
    },
    /// There is nothing to draw.
    #[error("{path}: no triangles with positions; expected at least one mesh")]
    Empty {
        /// The file.
        path: PathBuf,
    },
}

/// A surface as plain triangles, m.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SurfaceMesh {
    /// Vertices, m.
    pub points: Vec<Vec3>,
    /// Unit normals, one a vertex; empty when the file has none.
    pub normals: Vec<Vec3>,
    /// Three vertices a triangle.
    pub indices: Vec<u32>,
}

/// The box around all anatomy, m; `None` while there is none.
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq)]
pub struct AnatomyBounds(pub Option<(Vec3, Vec3)>);

/// Reads all triangles of the default scene (or of all scenes when none is the default) of a binary glTF file.
///
/// # Errors
/// When the file cannot be read, keeps its data in other files, or holds no triangles.
pub fn read_surface(path: &Path) -> Result<SurfaceMesh, SurfaceError> {
    let gltf::Gltf { document, blob } =
        gltf::Gltf::open(path).map_err(|e| SurfaceError::Gltf { path: path.to_owned(), source: Box::new(e) })?;
    let mut surface = SurfaceMesh::default();
    let mut nodes: Vec<(gltf::Node, Mat4)> = match document.default_scene() {
        Some(scene) => scene.nodes().map(|n| (n, Mat4::IDENTITY)).collect(),
        None => document.scenes().flat_map(|s| s.nodes()).map(|n| (n, Mat4::IDENTITY)).collect(),
    };
    while let Some((node, parent)) = nodes.pop() {
        let place = parent * Mat4::from_cols_array_2d(&node.transform().matrix());
        nodes.extend(node.children().map(|child| (child, place)));
        for primitive in node.mesh().into_iter().flat_map(|m| m.primitives()) {
            if primitive.mode() == gltf::mesh::Mode::Triangles {
                add_primitive(&mut surface, &primitive, place, blob.as_deref(), path)?;
            }
        }
    }
    if surface.indices.is_empty() {
        return Err(SurfaceError::Empty { path: path.to_owned() });
    }
    Ok(surface)
}

fn add_primitive(
    surface: &mut SurfaceMesh,
    primitive: &gltf::Primitive,
    place: Mat4,
    blob: Option<&[u8]>,
    path: &Path,
) -> Result<(), SurfaceError> {
    let outside = Cell::new(None);
    let reader = primitive.reader(|buffer| match buffer.source() {
        gltf::buffer::Source::Bin => blob,
        gltf::buffer::Source::Uri(_) => {
            outside.set(Some(buffer.index()));
            None
        }
    });
    let (positions, normals, indices) = (reader.read_positions(), reader.read_normals(), reader.read_indices());
    let Some(positions) = positions else {
        return match outside.get() {
            Some(buffer) => Err(SurfaceError::OutsideBuffer { path: path.to_owned(), buffer }),
            None => Ok(()),
        };
    };
    let first = surface.points.len() as u32;
    surface.points.extend(positions.map(|p| place.transform_point3(p.into())));
    let added = surface.points.len() as u32 - first;
    // Normals turn with the inverse transpose; all vertices have one or none has.
    let turn = Mat3::from_mat4(place).inverse().transpose();
    if surface.normals.len() as u32 == first
        && let Some(normals) = normals
    {
        surface.normals.extend(normals.map(|n| (turn * Vec3::from(n)).normalize_or(Vec3::Y)));
    }
    match indices {
        Some(indices) => surface.indices.extend(indices.into_u32().filter(|i| *i < added).map(|i| first + i)),
        None => surface.indices.extend(first..first + added / 3 * 3),
    }
    surface.indices.truncate(surface.indices.len() / 3 * 3);
    Ok(())
}

/// Draws anatomy that has come. A file that cannot be drawn is reported and left out: it takes no part in the simulation.
pub fn draw_anatomy(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
    mut extent: ResMut<AnatomyBounds>,
    come: Query<(Entity, &Anatomy), Added<Anatomy>>,
    mut gone: RemovedComponents<Anatomy>,
) {
    if gone.read().next().is_some() {
        extent.0 = None;
    }
    for (entity, anatomy) in &come {
        let surface = match read_surface(&anatomy.path) {
            Ok(surface) => surface,
            Err(error) => {
                tracing::error!("anatomy '{}' is not drawn: {error}", anatomy.name);
                continue;
            }
        };
        extent.0 = bounds(surface.points.iter().copied().chain(extent.0.into_iter().flat_map(|(low, high)| [low, high])));
        let [r, g, b] = anatomy.colour;
        commands.spawn((
            Name::new(anatomy.name.clone()),
            Draws(entity),
            Mesh3d(meshes.add(mesh_of(surface))),
            MeshMaterial3d(materials.add(StandardMaterial {
                base_color: Color::linear_rgb(r, g, b),
                perceptual_roughness: 0.6,
                reflectance: 0.4,
                clearcoat: 0.4,
                clearcoat_perceptual_roughness: 0.3,
                double_sided: true,
                cull_mode: None,
                ..default()
            })),
            layers::shared(),
        ));
    }
}

fn mesh_of(surface: SurfaceMesh) -> Mesh {
    let has_normals = surface.normals.len() == surface.points.len();
    let arrays = |v: Vec<Vec3>| v.into_iter().map(|p| p.to_array()).collect::<Vec<_>>();
    let mesh = Mesh::new(PrimitiveTopology::TriangleList, RenderAssetUsages::default())
        .with_inserted_attribute(Mesh::ATTRIBUTE_POSITION, arrays(surface.points))
        .with_inserted_indices(Indices::U32(surface.indices));
    if has_normals {
        mesh.with_inserted_attribute(Mesh::ATTRIBUTE_NORMAL, arrays(surface.normals))
    } else {
        mesh.with_computed_smooth_normals()
    }
}
