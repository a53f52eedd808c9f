//! Snapping (Serby, Harders & Szekely 2001): where a settled crossing lies near a node, the node moves onto the sheet instead.

use crate::cutter::Cutter;
use crate::stroke::CrossingState;
use keyhole_tetmesh::quality::{is_positive, min_altitude};
use keyhole_tetmesh::{EdgeKey, NodeId, TetId, TetMesh};
use smallvec::{SmallVec, smallvec};

/// A snap must leave every altitude of the tetrahedra around the node at least this part of what it was.
const ALTITUDE_KEPT: f64 = 0.3;

/// A node that would move onto the sheet.
struct Candidate {
    node: NodeId,
    other: NodeId,
    /// Distance to the crossing as a part of the edge.
    distance: f64,
    length_squared: f64,
}

impl Cutter {
    /// Weighs the nodes whose crossings are final. Nearest to the sheet first; per node, so that neighbours agree.
    pub(crate) fn snap(&mut self, mesh: &mut TetMesh, left: &[EdgeKey], affected: &mut Vec<TetId>) {
        let mut nodes: Vec<NodeId> = left.iter().flat_map(|e| e.nodes()).collect();
        nodes.sort_unstable();
        nodes.dedup();
        nodes.retain(|n| self.stroke.weighed.insert(*n));
        let mut order: Vec<Candidate> = nodes.into_iter().filter_map(|n| self.nearest_crossing(mesh, n)).collect();
        order.sort_by(|a, b| {
            a.distance.total_cmp(&b.distance).then(a.length_squared.total_cmp(&b.length_squared)).then(a.node.cmp(&b.node))
        });
        for candidate in order {
            self.snap_node(mesh, &candidate, affected);
        }
    }

    /// The nearest crossing on the edges of a node, when it is within the threshold and none of them is released.
    fn nearest_crossing(&self, mesh: &TetMesh, node: NodeId) -> Option<Candidate> {
        // A surface node may move only within the surface: it stays.
        if self.is_surface_node(node) || self.stroke.on_sheet.contains_key(&node) {
            return None;
        }
        let mut nearest: Option<Candidate> = None;
        for other in self.neighbours(mesh, node) {
            let edge = EdgeKey::new(node, other);
            let Some(c) = self.stroke.crossings.get(&edge) else { continue };
            match c.state {
                CrossingState::Released => return None,
                CrossingState::Dropped => continue,
                CrossingState::Recorded => {}
            }
            let distance = if edge.nodes()[0] == node { c.exact } else { 1.0 - c.exact };
            let length_squared = mesh.rest(node).distance_squared(mesh.rest(other));
            if distance < self.settings.snap && nearest.as_ref().is_none_or(|n| distance < n.distance) {
                nearest = Some(Candidate { node, other, distance, length_squared });
            }
        }
        nearest
    }

    fn snap_node(&mut self, mesh: &mut TetMesh, candidate: &Candidate, affected: &mut Vec<TetId>) {
        let Candidate { node, other, .. } = *candidate;
        let edge = EdgeKey::new(node, other);
        let Some(crossing) = self.stroke.crossings.get(&edge).filter(|c| c.state == CrossingState::Recorded).copied() else { return };
        // The other end may have moved since the crossing was found; its crossings were dropped then, this one with them.
        let part = if edge.nodes()[0] == node { crossing.exact } else { 1.0 - crossing.exact };
        let place = mesh.rest(node).lerp(mesh.rest(other), part);
        let around: Vec<TetId> = self.before.around_node(mesh.topology(), node).collect();
        let allowed = around.iter().all(|&t| {
            let corners = self.before.corners(mesh.topology(), t);
            let now = corners.map(|n| mesh.rest(n));
            let then = corners.map(|n| if n == node { place } else { mesh.rest(n) });
            is_positive(then) && min_altitude(then) >= ALTITUDE_KEPT * min_altitude(now)
        });
        let has_face_point = around.iter().any(|&t| {
            (0..4).any(|f| {
                self.stroke.face_points.contains_key(&self.before.face_key(mesh.topology(), t, f))
                    && self.before.corners(mesh.topology(), t)[f] != node
            })
        });
        if !allowed || has_face_point {
            return;
        }
        let side =
            self.stroke.node_sides.get(&node).copied().unwrap_or(if edge.nodes()[0] == node { crossing.side } else { -crossing.side });
        for &tet in &around {
            let corners = self.before.corners(mesh.topology(), tet);
            self.grid.remove(tet, corners.map(|n| mesh.rest(n)));
            self.grid.insert(tet, corners.map(|n| if n == node { place } else { mesh.rest(n) }));
        }
        mesh.move_node(node, place, smallvec![(node, 1.0 - part), (other, part)]);
        let neighbours = self.neighbours(mesh, node);
        self.put_on_sheet(mesh, node, side, &neighbours, affected);
    }

    /// The nodes that share an edge with a node, ascending.
    pub(crate) fn neighbours(&self, mesh: &TetMesh, node: NodeId) -> SmallVec<[NodeId; 32]> {
        let topology = mesh.topology();
        let around = self.before.around_node(topology, node);
        let mut nodes: SmallVec<[NodeId; 32]> = SmallVec::new();
        for other in around.flat_map(|t| self.before.corners(topology, t)) {
            if other != node && !nodes.contains(&other) {
                nodes.push(other);
            }
        }
        nodes.sort_unstable();
        nodes
    }
}
