//! Kerf: the thickness of tissue that an edge takes away, as a hook does that burns. When a stroke ends both sides of its cut draw back from the
//! sheet by half of it, in the rest shape: no tetrahedron is made or removed, and the mass that is gone is gone for good.

use crate::cutter::Cutter;
use crate::kernel::Vertex;
use keyhole_tetmesh::quality::{is_positive, min_altitude};
use keyhole_tetmesh::{DVec3, FACES, NodeId, NodeWeights, TetId, TetMesh};
use smallvec::SmallVec;

/// A node draws back only as far as leaves every altitude around it this part of what it was.
const ALTITUDE_KEPT: f64 = 0.3;

/// The outward areas (m2) of the faces at a node: of the cut, and of the skin.
#[derive(Clone, Copy, Debug, Default)]
struct Outward {
    cut: DVec3,
    cut_area: f64,
    skin: DVec3,
}

impl Cutter {
    /// Draws both sides of the stroke's cut back by half of the kerf of the blade that made it. Returns the volume taken away, m3.
    pub(crate) fn draw_back(&self, mesh: &mut TetMesh) -> f64 {
        if self.courses.iter().all(|c| c.kerf_m <= 0.0) {
            return 0.0;
        }
        let mut vertices: Vec<&Vertex> = self.stroke.sides.keys().collect();
        vertices.sort_unstable();
        let nodes: Vec<NodeId> = vertices.into_iter().flat_map(|v| &self.stroke.sides[v]).map(|s| s.node).collect();
        // All directions first: they are those of the sheet, not of what has been drawn back of it.
        let ways: Vec<(NodeId, DVec3)> =
            nodes.into_iter().filter_map(|n| Some((n, self.way_back(mesh, n)? * (self.kerf_at(mesh, n)? / 2.0)))).collect();
        ways.into_iter().map(|(node, way)| draw_back(mesh, node, way)).sum()
    }

    /// The kerf of the blade that was last near the base tetrahedra around a node of the cut, m; `None` when it takes nothing away.
    fn kerf_at(&self, mesh: &TetMesh, node: NodeId) -> Option<f64> {
        let bases = mesh.topology().around_node(node).iter().filter_map(|t| self.before.place(self.before.parent(*t)?));
        let blade = bases.flat_map(|p| self.before.place_corners(p)).find_map(|corner| self.stroke.visits.blade(corner))?;
        self.courses.iter().find(|c| c.blade == blade).map(|c| c.kerf_m).filter(|k| *k > 0.0)
    }

    /// The way by which a node draws back from the cut, its part across the sheet of length one; `None` at the cut's edge.
    fn way_back(&self, mesh: &TetMesh, node: NodeId) -> Option<DVec3> {
        let mut outward = Outward::default();
        for &tet in mesh.topology().around_node(node) {
            let corners = mesh.corners(tet);
            for (face, [i, j, k]) in FACES.into_iter().enumerate() {
                if corners[face] == node || mesh.topology().neighbour(tet, face).is_some() {
                    continue;
                }
                let [a, b, c] = [i, j, k].map(|i| mesh.rest(corners[i]));
                let area = (b - a).cross(c - a) / 2.0;
                if self.is_of_cut(mesh, tet, face) {
                    outward.cut += area;
                    outward.cut_area += area.length();
                } else {
                    outward.skin += area;
                }
            }
        }
        // At its edge both sides of the cut meet in one node.
        let across = (outward.cut.length() > 0.5 * outward.cut_area).then(|| outward.cut.normalize())?;
        let skin = outward.skin.normalize_or_zero();
        let within = across - skin * across.dot(skin);
        // Within the skin, so that it keeps its shape; where the cut runs along the skin there is no such way.
        (within.length_squared() > 0.25).then(|| -within / within.dot(across))
    }

    /// Whether a boundary face of a child is a face of the stroke's cut.
    fn is_of_cut(&self, mesh: &TetMesh, tet: TetId, face: usize) -> bool {
        let Some((base, place)) = self.before.parent(tet).and_then(|b| Some((b, self.before.place(b)?))) else { return false };
        let Some(child) = self.stroke.touched[place].children.iter().find(|c| c.id == Some(tet)) else { return false };
        let key = FACES[face].map(|i| child.key[i]);
        key.iter().all(|v| self.stroke.is_on_sheet(*v)) && !self.was_boundary(mesh, base, key)
    }
}

/// Moves a node by `way` (m), or as far as its tetrahedra allow. Returns the volume that they lose, m3.
fn draw_back(mesh: &mut TetMesh, node: NodeId, way: DVec3) -> f64 {
    let from = mesh.rest(node);
    let around: SmallVec<[TetId; 32]> = mesh.topology().around_node(node).iter().copied().collect();
    let moved = |t: TetId, to: DVec3| {
        let corners = mesh.corners(t);
        (mesh.points(t), std::array::from_fn(|i| if corners[i] == node { to } else { mesh.rest(corners[i]) }))
    };
    let reach = [1.0, 0.75, 0.5, 0.25, 0.125].into_iter().map(|part| from + way * part).find(|to| {
        around.iter().all(|t| {
            let (was, is) = moved(*t, *to);
            is_positive(is) && min_altitude(is) >= ALTITUDE_KEPT * min_altitude(was)
        })
    });
    let Some(to) = reach else { return 0.0 };
    let volume = |p: [DVec3; 4]| keyhole_tetmesh::quality::volume(p);
    let lost = around.iter().map(|t| moved(*t, to)).map(|(was, is)| volume(was) - volume(is)).sum();
    let Some(weights) = tissue_at(mesh, &around, to) else { return 0.0 };
    mesh.move_node(node, to, weights);
    lost
}

/// A point near a node as weights of the nodes of a tetrahedron around it: the largest one that holds the point or nearly so, for in a flat one
/// weights mean little, or else the one that comes nearest to it.
fn tissue_at(mesh: &TetMesh, around: &[TetId], point: DVec3) -> Option<NodeWeights> {
    let weighed = |t: &TetId| {
        let p = mesh.points(*t);
        let parts: [f64; 4] = std::array::from_fn(|i| {
            let mut q = p;
            q[i] = point;
            keyhole_tetmesh::quality::volume(q)
        });
        let whole: f64 = parts.iter().sum();
        let w = parts.map(|v| v / whole);
        let least = w.into_iter().fold(f64::INFINITY, f64::min);
        ((least.min(-0.1), whole), *t, w)
    };
    let best = around.iter().map(weighed).max_by(|a, b| a.0.0.total_cmp(&b.0.0).then(a.0.1.total_cmp(&b.0.1)).then(b.1.cmp(&a.1)))?;
    Some(mesh.corners(best.1).into_iter().zip(best.2).collect())
}
