//! Which boundary faces show the organ's own skin and which show the inside that a cut has opened.
//!
//! A tetrahedron carries the index of the original tetrahedron that it is a part of. When an organ comes, the planes of the original
//! boundary faces are kept by that index; a boundary face is skin when it lies in one of the planes of its own original tetrahedron.
//! Both looks are local, and a fragment uses the table of the organ that it was freed from.

use crate::ids::TetId;
use crate::mesh::TetMesh;
use crate::topology::FACES;
use glam::DVec3;
use rustc_hash::FxHashMap;
use smallvec::SmallVec;

/// How far from the plane of an original face a face of skin may lie, as a fraction of the original face's longest edge: a node of the
/// surface that was snapped onto a sheet moves in a surface that is not flat.
const DISTANCE_PER_EDGE: f64 = 0.05;

/// Smallest cosine between the normals of a face of skin and of its original face, for the same reason.
const MIN_COSINE: f64 = 0.9;

/// The plane of an original boundary face.
#[derive(Clone, Copy, Debug)]
struct FacePlane {
    point: DVec3,
    normal: DVec3,
    edge: f64,
}

/// The planes of the original boundary faces by original tetrahedron, in the rest shape (m).
#[derive(Clone, Debug, Default)]
pub struct OuterPlanes(FxHashMap<u32, SmallVec<[FacePlane; 2]>>);

impl OuterPlanes {
    /// The planes of an organ as it is now: every boundary face is skin.
    #[must_use]
    pub fn of(mesh: &TetMesh) -> Self {
        let mut planes: FxHashMap<u32, SmallVec<[FacePlane; 2]>> = FxHashMap::default();
        for (tet, _) in mesh.iter() {
            for face in 0..4 {
                if mesh.topology().neighbour(tet, face).is_none()
                    && let Some(plane) = FacePlane::of(face_points(mesh, tet, face))
                {
                    planes.entry(mesh.tet(tet).source).or_default().push(plane);
                }
            }
        }
        Self(planes)
    }

    /// Whether a boundary face is skin.
    #[must_use]
    pub fn is_outer(&self, mesh: &TetMesh, tet: TetId, face: usize) -> bool {
        let Some(planes) = self.0.get(&mesh.tet(tet).source) else { return false };
        let points = face_points(mesh, tet, face);
        let Some(own) = FacePlane::of(points) else { return false };
        planes.iter().any(|plane| {
            own.normal.dot(plane.normal) > MIN_COSINE
                && points.iter().all(|p| (*p - plane.point).dot(plane.normal).abs() <= DISTANCE_PER_EDGE * plane.edge)
        })
    }
}

impl FacePlane {
    /// `None` when the triangle has no area.
    fn of([a, b, c]: [DVec3; 3]) -> Option<Self> {
        let normal = (b - a).cross(c - a).try_normalize()?;
        let edge = (b - a).length().max((c - b).length()).max((a - c).length());
        Some(Self { point: a, normal, edge })
    }
}

fn face_points(mesh: &TetMesh, tet: TetId, face: usize) -> [DVec3; 3] {
    let corners = mesh.corners(tet);
    FACES[face].map(|i| mesh.rest(corners[i]))
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;
    use crate::{NodeId, Tet};
    use smallvec::smallvec;

    /// A cube of cubes with five tetrahedra each, edges of `edge` m; odd cubes are mirrored so that the diagonals of shared faces agree.
    fn block(cells: usize, edge: f64) -> TetMesh {
        let n = cells + 1;
        let id = |[i, j, k]: [usize; 3]| (i + n * (j + n * k)) as u32;
        let nodes: Vec<DVec3> = (0..n * n * n).map(|c| DVec3::new((c % n) as f64, (c / n % n) as f64, (c / n / n) as f64) * edge).collect();
        let mut tets = Vec::new();
        for [i, j, k] in (0..cells.pow(3)).map(|c| [c % cells, c / cells % cells, c / cells / cells]) {
            for five in [[0, 1, 2, 4], [3, 1, 7, 2], [5, 1, 4, 7], [6, 2, 7, 4], [1, 2, 4, 7]] {
                let mirrored: [usize; 4] = if (i + j + k) % 2 == 0 { five } else { five.map(|b| b ^ 1) };
                let mut tet = mirrored.map(|b| id([i + (b & 1), j + (b >> 1 & 1), k + (b >> 2 & 1)]));
                let [a, b, c, d] = tet.map(|n| nodes[n as usize]);
                if (b - a).dot((c - a).cross(d - a)) < 0.0 {
                    tet.swap(2, 3);
                }
                tets.push(tet);
            }
        }
        TetMesh::new(nodes, &tets, &[])
    }

    #[test]
    fn every_boundary_face_of_a_new_organ_is_skin() {
        let mesh = block(2, 0.01);
        let planes = OuterPlanes::of(&mesh);
        for (tet, _) in mesh.iter() {
            for face in 0..4 {
                assert_eq!(planes.is_outer(&mesh, tet, face), mesh.topology().neighbour(tet, face).is_none());
            }
        }
    }

    /// A tetrahedron with a single original boundary face is cut through an inner edge that joins two surface nodes: the half's face in the cut
    /// plane has only surface nodes and points on such edges, yet is not skin.
    #[test]
    fn a_cut_between_surface_nodes_is_inside() {
        let mut mesh = block(1, 0.01);
        let planes = OuterPlanes::of(&mesh);
        // The middle tetrahedron of a block of five has four surface nodes and no boundary face.
        let middle = mesh.iter().find(|(t, _)| (0..4).all(|f| mesh.topology().neighbour(*t, f).is_some())).unwrap().0;
        let corner = mesh.topology().neighbour(middle, 0).unwrap();
        for (tet, skin) in [(middle, 0), (corner, 3)] {
            let mut open = mesh.clone();
            let others: Vec<_> = open.iter().map(|(t, _)| t).filter(|t| *t != tet).collect();
            others.into_iter().for_each(|t| open.remove_tet(t));
            assert_eq!((0..4).filter(|f| planes.is_outer(&open, tet, *f)).count(), skin);
        }
        // Halving a corner tetrahedron keeps the skin on both halves and gives each one inner face besides the old one.
        let [a, b, c, d] = mesh.corners(corner);
        let attributes = mesh.tet(corner);
        let m = mesh.add_node((mesh.rest(a) + mesh.rest(b)) / 2.0, smallvec![(a, 0.5), (b, 0.5)]);
        mesh.remove_tet(corner);
        let halves = [[a, m, c, d], [m, b, c, d]].map(|t: [NodeId; 4]| mesh.add_tet(t, Tet { ..attributes }));
        let area = |m: &TetMesh, t, f| {
            let [p, q, r] = face_points(m, t, f);
            (q - p).cross(r - p).length() / 2.0
        };
        let skin: f64 = halves
            .iter()
            .flat_map(|t| (0..4).map(move |f| (*t, f)))
            .filter(|(t, f)| planes.is_outer(&mesh, *t, *f))
            .map(|(t, f)| area(&mesh, t, f))
            .sum();
        let expected = 3.0 * 0.01 * 0.01 / 2.0;
        assert!((skin - expected).abs() < 1e-9 * expected, "{skin} against {expected}");
    }
}
