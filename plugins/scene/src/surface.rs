//! Surfaces that cannot deform: read from glTF files or made, to be drawn, and closed ones to be touched.

use crate::format::{Placement, SceneAnatomy, SceneSurface};
use bevy_math::{Mat3, Mat4, Vec3};
use keyhole_whiteboard::{PartMesh, StaticSurface};
use parry3d::math::Vector;
use parry3d::shape::{Ball, Cuboid, Cylinder};
use std::cell::Cell;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Parts that a circle of a shape is drawn with.
const AROUND: u32 = 32;

/// Why a surface cannot be used.
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
    /// Neither a file nor a shape, or both.
    #[error("anatomy '{name}': give either `path` or `shape`")]
    Unsaid {
        /// Its name.
        name: String,
    },
    /// Something can be on neither side of it.
    #[error("the surface is not closed at ({:.4}, {:.4}, {:.4}) m: close it, or leave `solid` out so that it is only seen", .at[0], .at[1], .at[2])]
    Open {
        /// The middle of an edge that has not one triangle on each side, m, in the world.
        at: [f32; 3],
    },
}

impl SceneAnatomy {
    /// The surface in its own frame, m.
    ///
    /// # Errors
    /// When the file is not as it should be, or there is neither a file nor a shape.
    pub fn read_surface(&self) -> Result<PartMesh, SurfaceError> {
        match (&self.path, &self.shape) {
            (Some(file), None) => read(Path::new(file)),
            (None, Some(shape)) => Ok(shape.mesh()),
            _ => Err(SurfaceError::Unsaid { name: self.name.clone() }),
        }
    }
}

impl SceneSurface {
    /// The surface as triangles, m, without normals.
    #[must_use]
    pub fn mesh(&self) -> PartMesh {
        let (points, triangles) = match *self {
            Self::Box { size } => Cuboid::new(Vector::from_array(size) / 2.0).to_trimesh(),
            Self::Cylinder { radius, height } => Cylinder::new(height / 2.0, radius).to_trimesh(AROUND),
            Self::Sphere { radius } => Ball::new(radius).to_trimesh(AROUND, AROUND / 2),
        };
        let vertices = points.into_iter().map(|p| [p.x, p.y, p.z]).collect();
        PartMesh { vertices, normals: Vec::new(), indices: triangles.into_iter().flatten().collect() }
    }
}

/// The surface at its place in the world, with one vertex where several are at the same place.
///
/// # Errors
/// [`SurfaceError::Open`] when an edge has not one triangle on each side.
pub fn solid(surface: &PartMesh, place: &Placement) -> Result<StaticSurface, SurfaceError> {
    let mut seen: HashMap<[u32; 3], u32> = HashMap::new();
    let mut vertices: Vec<Vec3> = Vec::new();
    let welded: Vec<u32> = surface
        .vertices
        .iter()
        .map(|v| {
            // Zero has two signs.
            *seen.entry(v.map(|c| (c + 0.0).to_bits())).or_insert_with(|| {
                vertices.push(place.apply(Vec3::from_array(*v).as_dvec3()).as_vec3());
                vertices.len() as u32 - 1
            })
        })
        .collect();
    let corners = surface.indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]].map(|i| welded[i as usize]));
    let triangles: Vec<[u32; 3]> = corners.filter(|[a, b, c]| a != b && b != c && c != a).collect();
    let mut directed: Vec<(u32, u32)> = triangles.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]).collect();
    directed.sort_unstable();
    let twice = directed.windows(2).find(|w| w[0] == w[1]).map(|w| w[0]);
    let alone = directed.iter().copied().find(|(a, b)| directed.binary_search(&(*b, *a)).is_err());
    match twice.or(alone) {
        Some((a, b)) => Err(SurfaceError::Open { at: vertices[a as usize].midpoint(vertices[b as usize]).to_array() }),
        None => Ok(StaticSurface { vertices, triangles }),
    }
}

/// Reads all triangles of the default scene (or of all scenes when none is the default) of a binary glTF file. Normals are those of the file, or none.
///
/// # Errors
/// When the file cannot be read, keeps its data in other files, or holds no triangles.
pub fn read(path: &Path) -> Result<PartMesh, SurfaceError> {
    let gltf::Gltf { document, blob } =
        gltf::Gltf::open(path).map_err(|e| SurfaceError::Gltf { path: path.to_owned(), source: Box::new(e) })?;
    let mut surface = PartMesh::default();
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
    // All vertices have normals or none has.
    if surface.normals.len() != surface.vertices.len() {
        surface.normals.clear();
    }
    Ok(surface)
}

fn add_primitive(
    surface: &mut PartMesh,
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
    let first = surface.vertices.len() as u32;
    surface.vertices.extend(positions.map(|p| place.transform_point3(p.into()).to_array()));
    let added = surface.vertices.len() as u32 - first;
    // Normals turn with the inverse transpose.
    let turn = Mat3::from_mat4(place).inverse().transpose();
    if surface.normals.len() as u32 == first
        && let Some(normals) = normals
    {
        surface.normals.extend(normals.map(|n| (turn * Vec3::from(n)).normalize_or(Vec3::Y).to_array()));
    }
    match indices {
        Some(indices) => {
            let triangles: Vec<u32> = indices.into_u32().collect();
            let whole = triangles.chunks_exact(3).filter(|t| t.iter().all(|i| *i < added));
            surface.indices.extend(whole.flatten().map(|i| first + i));
        }
        None => surface.indices.extend(first..first + added / 3 * 3),
    }
    Ok(())
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;

    /// Volume inside a closed surface by the divergence theorem, m3.
    fn volume(s: &StaticSurface) -> f32 {
        s.triangles.iter().map(|t| t.map(|i| s.vertices[i as usize])).map(|[a, b, c]| a.dot(b.cross(c)) / 6.0).sum()
    }

    #[test]
    fn shapes_are_closed_outward_and_of_their_size() {
        let moved = Placement { translation: [1.0, -2.0, 0.5], rotation_deg: [20.0, 30.0, 40.0] };
        let pi = std::f32::consts::PI;
        for (shape, exact) in [
            (SceneSurface::Box { size: [0.2, 0.3, 0.4] }, 0.024),
            (SceneSurface::Cylinder { radius: 0.1, height: 0.3 }, pi * 0.003),
            (SceneSurface::Sphere { radius: 0.2 }, 4.0 / 3.0 * pi * 0.008),
        ] {
            let found = volume(&solid(&shape.mesh(), &moved).unwrap());
            assert!((found / exact - 1.0).abs() < 0.03, "{shape:?}: {found} for {exact}");
        }
    }

    #[test]
    fn an_open_surface_is_told_where() {
        let mut mesh = SceneSurface::Box { size: [2.0; 3] }.mesh();
        mesh.indices.truncate(mesh.indices.len() - 3);
        let error = solid(&mesh, &Placement::default()).unwrap_err().to_string();
        assert!(error.contains("not closed at") && error.contains("leave `solid` out"), "{error}");
    }
}
