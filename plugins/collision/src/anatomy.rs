//! Anatomy that cannot deform: a triangle mesh with a tree of its triangles and the normals of its faces, edges and vertices, built once. The distance
//! of a point is that to the nearest triangle, its sign that of the pseudo-normal there (J. A. Baerentzen, H. Aanaes, "Signed distance computation using
//! the angle weighted pseudonormal", 2005), as parry has it.

use crate::convert::{MM, direction_from_parry, from_parry, to_parry};
use bevy_math::Vec3;
use keyhole_whiteboard::StaticSurface;
use parry3d::bounding_volume::Aabb;
use parry3d::query::{PointQueryWithLocation, Ray, RayCullingMode};
use parry3d::shape::{TriMesh, TriMeshFlags, TrianglePointLocation};
use thiserror::Error;

/// Why a surface cannot be collided with.
#[derive(Debug, Error)]
pub enum AnatomyError {
    /// A triangle names a vertex that is not there.
    #[error("triangle {triangle} names vertex {vertex}, but the surface has {vertices}: number vertices from 0")]
    NoVertex {
        /// Place of the triangle in the list.
        triangle: usize,
        /// The vertex that it names.
        vertex: u32,
        /// Number of vertices.
        vertices: usize,
    },
    /// A vertex is not finite.
    #[error("vertex {0} is not a finite point")]
    NotFinite(usize),
    /// The triangles are no surface with two sides.
    #[error(
        "the edge from vertex {0} to vertex {1} is used {2} times that way and {3} times back; a surface uses each once both ways, at its border once"
    )]
    NoSurface(u32, u32, usize, usize),
    /// There is nothing to build a tree of.
    #[error("no tree can be built of the triangles: {0}")]
    NoTree(String),
}

/// A surface that tissue cannot pass.
///
/// What is behind it is inside, up to the reach that a query names. An open surface ends at its border: a point that is nearest to the border is beside it.
pub struct SolidSurface {
    mesh: TriMesh,
    /// By triangle: whether its edges AB, BC and CA are at the border.
    border: Vec<[bool; 3]>,
    border_vertices: Vec<bool>,
}

/// The point of a surface that is nearest to another point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Nearest {
    /// The point of the surface, m.
    pub point: Vec3,
    /// Unit vector from the inside to the outside.
    pub normal: Vec3,
    /// Distance from the surface, m: negative inside.
    pub distance_m: f32,
}

impl SolidSurface {
    /// Builds the tree and the normals.
    ///
    /// # Errors
    /// When the triangles are no surface, closed or open.
    pub fn new(surface: &StaticSurface) -> Result<Self, AnatomyError> {
        let vertices = surface.vertices.len();
        if let Some(broken) = surface.vertices.iter().position(|v| !v.is_finite()) {
            return Err(AnatomyError::NotFinite(broken));
        }
        let missing = |t: &[u32; 3]| t.iter().copied().find(|v| *v as usize >= vertices);
        if let Some((triangle, vertex)) = surface.triangles.iter().enumerate().find_map(|(i, t)| missing(t).map(|v| (i, v))) {
            return Err(AnatomyError::NoVertex { triangle, vertex, vertices });
        }
        let edges = |[a, b, c]: &[u32; 3]| [(*a, *b), (*b, *c), (*c, *a)];
        let mut directed: Vec<(u32, u32)> = surface.triangles.iter().flat_map(edges).collect();
        directed.sort_unstable();
        let uses = |edge: (u32, u32)| directed.partition_point(|e| *e <= edge) - directed.partition_point(|e| *e < edge);
        for (a, b) in &directed {
            let (there, back) = (uses((*a, *b)), uses((*b, *a)));
            if there != 1 || back > 1 {
                return Err(AnatomyError::NoSurface(*a, *b, there, back));
            }
        }
        let at_border = |edge: (u32, u32)| uses((edge.1, edge.0)) == 0;
        let border: Vec<[bool; 3]> = surface.triangles.iter().map(|t| edges(t).map(at_border)).collect();
        let mut border_vertices = vec![false; vertices];
        for (a, b) in directed.iter().filter(|e| at_border(**e)) {
            (border_vertices[*a as usize], border_vertices[*b as usize]) = (true, true);
        }
        let points = surface.vertices.iter().map(|v| to_parry(*v)).collect();
        let mesh = TriMesh::with_flags(points, surface.triangles.clone(), TriMeshFlags::ORIENTED)
            .map_err(|error| AnatomyError::NoTree(error.to_string()))?;
        Ok(Self { mesh, border, border_vertices })
    }

    /// The triangles whose boxes meet a box (m), in an order that depends on the surface alone.
    pub(crate) fn triangles_in(&self, low: Vec3, high: Vec3) -> impl Iterator<Item = [Vec3; 3]> + '_ {
        let mut found: Vec<u32> = self.mesh.bvh().intersect_aabb(&Aabb::new(to_parry(low), to_parry(high))).collect();
        found.sort_unstable();
        found.into_iter().map(|t| {
            let triangle = self.mesh.triangle(t);
            [triangle.a, triangle.b, triangle.c].map(from_parry)
        })
    }

    /// The nearest point of the surface, if it is not further than `reach_m` and not on its border.
    #[must_use]
    pub fn nearest(&self, point: Vec3, reach_m: f32) -> Option<Nearest> {
        if !point.is_finite() {
            return None;
        }
        let (projected, (triangle, location)) =
            self.mesh.project_local_point_and_get_location_with_max_dist(to_parry(point), false, reach_m * MM)?;
        let beside = match location {
            TrianglePointLocation::OnEdge(edge, _) => self.border[triangle as usize][edge as usize],
            TrianglePointLocation::OnVertex(corner) => {
                let vertex = self.mesh.indices()[triangle as usize][corner as usize];
                self.border_vertices[vertex as usize]
            }
            TrianglePointLocation::OnFace(..) | TrianglePointLocation::OnSolid => false,
        };
        if beside {
            return None;
        }
        let on = from_parry(projected.point);
        let away = point - on;
        let sign = if projected.is_inside { -1.0 } else { 1.0 };
        let face = self.mesh.triangle(triangle).normal().map(direction_from_parry);
        // So near that no direction is left, the face tells it.
        let normal = (sign * away).try_normalize().or(face)?;
        Some(Nearest { point: on, normal, distance_m: sign * away.length() })
    }

    /// Where a point that goes `way` (m) from `point` comes into the surface first, with its distance before that from the plane of the face there.
    #[must_use]
    pub fn entered(&self, point: Vec3, way: Vec3) -> Option<Nearest> {
        if !(point + way).is_finite() {
            return None;
        }
        let ray = Ray::new(to_parry(point), to_parry(way));
        let hit = self.mesh.cast_local_ray_with_culling(&ray, 1.0, RayCullingMode::IgnoreBackfaces)?;
        let normal = direction_from_parry(hit.normal).try_normalize()?;
        Some(Nearest { point: point + way * hit.time_of_impact, normal, distance_m: -(way * hit.time_of_impact).dot(normal) })
    }
}
