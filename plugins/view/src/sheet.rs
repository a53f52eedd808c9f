//! The surface of an organ as two growing and shrinking triangle lists, skin and opened inside, that follow a topology delta face by
//! face and never look at the mesh again.

use crate::outer::OuterPlanes;
use keyhole_tetmesh::{FACES, FaceKey, MaterialId, NodeId, TetId, TetMesh, TopologyDelta};
use rustc_hash::FxHashMap;

const NONE: u32 = u32::MAX;

/// Which of the two lists a face is in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Side {
    /// The organ's own skin.
    Skin,
    /// What a cut has opened.
    Inside,
}

/// A vertex: a node, once for each material that meets there, so that colours change sharply at the border of two materials.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Vertex {
    /// The node.
    pub node: NodeId,
    /// The material of the faces that use the vertex.
    pub material: MaterialId,
}

/// A triangle list. Slots of vertices that no face uses stay until another vertex takes them.
#[derive(Clone, Debug, Default)]
pub struct Sheet {
    /// Vertex slots; those that no index names are stale.
    vertices: Vec<Vertex>,
    /// Three vertex slots a face.
    indices: Vec<u32>,
    faces: Vec<(TetId, u8)>,
    uses: Vec<u32>,
    free: Vec<u32>,
    slot_of: FxHashMap<Vertex, u32>,
    /// How many corners of faces each node is, by node; nodes beyond the end are none.
    node_uses: Vec<u32>,
}

impl Sheet {
    /// The vertex slots. Those that no index names are stale.
    #[must_use]
    pub fn vertices(&self) -> &[Vertex] {
        &self.vertices
    }

    /// Three vertex slots a face, outward.
    #[must_use]
    pub fn indices(&self) -> &[u32] {
        &self.indices
    }

    /// Whether a vertex slot is in use.
    #[must_use]
    pub fn is_used(&self, slot: usize) -> bool {
        self.uses[slot] > 0
    }

    /// Whether a face has this node.
    #[must_use]
    pub fn has_node(&self, node: NodeId) -> bool {
        self.node_uses.get(node.index()).is_some_and(|uses| *uses > 0)
    }

    fn push(&mut self, tet: TetId, face: usize, nodes: [NodeId; 3], material: MaterialId) -> u32 {
        let at = self.faces.len() as u32;
        self.faces.push((tet, face as u8));
        for node in nodes {
            let slot = self.acquire(Vertex { node, material });
            self.indices.push(slot);
        }
        at
    }

    /// Removes a face; the last face moves into its place and is returned.
    fn swap_remove(&mut self, at: u32) -> Option<(TetId, usize)> {
        let (at, last) = (at as usize, self.faces.len() - 1);
        for k in 0..3 {
            self.release(self.indices[3 * at + k]);
            self.indices[3 * at + k] = self.indices[3 * last + k];
        }
        self.indices.truncate(3 * last);
        self.faces.swap_remove(at);
        (at < last).then(|| (self.faces[at].0, usize::from(self.faces[at].1)))
    }

    fn acquire(&mut self, vertex: Vertex) -> u32 {
        if self.node_uses.len() <= vertex.node.index() {
            self.node_uses.resize(vertex.node.index() + 1, 0);
        }
        self.node_uses[vertex.node.index()] += 1;
        if let Some(&slot) = self.slot_of.get(&vertex) {
            self.uses[slot as usize] += 1;
            return slot;
        }
        let slot = self.free.pop().unwrap_or(self.vertices.len() as u32);
        if slot as usize == self.vertices.len() {
            self.vertices.push(vertex);
            self.uses.push(1);
        } else {
            self.vertices[slot as usize] = vertex;
            self.uses[slot as usize] = 1;
        }
        self.slot_of.insert(vertex, slot);
        slot
    }

    fn release(&mut self, slot: u32) {
        self.uses[slot as usize] -= 1;
        self.node_uses[self.vertices[slot as usize].node.index()] -= 1;
        if self.uses[slot as usize] == 0 {
            self.slot_of.remove(&self.vertices[slot as usize]);
            self.free.push(slot);
        }
    }
}

/// Both lists of an organ, and where each face of each tetrahedron is in them.
#[derive(Clone, Debug, Default)]
pub struct Surface {
    skin: Sheet,
    inside: Sheet,
    /// For each tetrahedron slot and face: position in its list, and which list; the nodes it had.
    slots: Vec<Slot>,
}

#[derive(Clone, Copy, Debug)]
struct Slot {
    nodes: [NodeId; 4],
    at: [u32; 4],
    side: [Side; 4],
}

impl Slot {
    const EMPTY: Self = Self { nodes: [NodeId(NONE); 4], at: [NONE; 4], side: [Side::Skin; 4] };
}

impl Surface {
    /// The surface of an organ that has just come, by a look at all of it.
    #[must_use]
    pub fn of(mesh: &TetMesh, planes: &OuterPlanes) -> Self {
        let mut surface = Self { slots: vec![Slot::EMPTY; mesh.tet_slots()], ..Self::default() };
        for (tet, nodes) in mesh.iter() {
            surface.slots[tet.index()].nodes = nodes;
            surface.refresh(mesh, planes, tet);
        }
        surface
    }

    /// One of the lists.
    #[must_use]
    pub fn sheet(&self, side: Side) -> &Sheet {
        match side {
            Side::Skin => &self.skin,
            Side::Inside => &self.inside,
        }
    }

    /// Follows a delta; `mesh` is as it is after it. Looks at what the delta names and at the neighbours of that.
    pub fn apply(&mut self, mesh: &TetMesh, planes: &OuterPlanes, delta: &TopologyDelta) {
        let mut touched = Vec::new();
        for &tet in &delta.removed {
            let Some(slot) = self.slots.get(tet.index()) else { continue };
            for [i, j, k] in FACES {
                let [a, b, c] = [slot.nodes[i], slot.nodes[j], slot.nodes[k]];
                if a.0 != NONE {
                    touched.extend(mesh.topology().around_face(FaceKey::new(a, b, c)));
                }
            }
            self.clear(tet);
        }
        if self.slots.len() < mesh.tet_slots() {
            self.slots.resize(mesh.tet_slots(), Slot::EMPTY);
        }
        for added in &delta.added {
            self.clear(added.tet);
            self.slots[added.tet.index()].nodes = added.nodes;
            touched.push(added.tet);
            touched.extend((0..4).filter_map(|face| mesh.topology().neighbour(added.tet, face)));
        }
        touched.sort_unstable();
        touched.dedup();
        for tet in touched {
            self.refresh(mesh, planes, tet);
        }
    }

    /// Takes all faces of a slot out.
    fn clear(&mut self, tet: TetId) {
        if tet.index() < self.slots.len() {
            (0..4).for_each(|face| self.take_out(tet, face));
            self.slots[tet.index()] = Slot::EMPTY;
        }
    }

    /// Puts the boundary faces of a tetrahedron in and takes the others out. A face that is in keeps its list.
    fn refresh(&mut self, mesh: &TetMesh, planes: &OuterPlanes, tet: TetId) {
        for face in 0..4 {
            let is_in = self.slots[tet.index()].at[face] != NONE;
            match (mesh.topology().neighbour(tet, face).is_none(), is_in) {
                (true, false) => self.put_in(mesh, planes, tet, face),
                (false, true) => self.take_out(tet, face),
                _ => {}
            }
        }
    }

    fn put_in(&mut self, mesh: &TetMesh, planes: &OuterPlanes, tet: TetId, face: usize) {
        let side = if planes.is_outer(mesh, tet, face) { Side::Skin } else { Side::Inside };
        let corners = mesh.corners(tet);
        let nodes = FACES[face].map(|i| corners[i]);
        let at = self.sheet_mut(side).push(tet, face, nodes, mesh.tet(tet).material);
        let slot = &mut self.slots[tet.index()];
        slot.at[face] = at;
        slot.side[face] = side;
    }

    fn take_out(&mut self, tet: TetId, face: usize) {
        let Slot { at, side, .. } = self.slots[tet.index()];
        if at[face] == NONE {
            return;
        }
        if let Some((moved, moved_face)) = self.sheet_mut(side[face]).swap_remove(at[face]) {
            self.slots[moved.index()].at[moved_face] = at[face];
        }
        self.slots[tet.index()].at[face] = NONE;
    }

    fn sheet_mut(&mut self, side: Side) -> &mut Sheet {
        match side {
            Side::Skin => &mut self.skin,
            Side::Inside => &mut self.inside,
        }
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;
    use crate::testing::block;
    use keyhole_tetmesh::Boundary;
    use proptest::prelude::*;
    use smallvec::smallvec;

    /// Triangles of a sheet by their nodes, the smallest node first.
    fn triangles(sheet: &Sheet) -> Vec<[NodeId; 3]> {
        let mut all: Vec<_> = sheet
            .indices()
            .chunks_exact(3)
            .map(|t| {
                let mut n = [0, 1, 2].map(|k| sheet.vertices()[t[k] as usize].node);
                let first = (0..3).min_by_key(|k| n[*k]).unwrap();
                n.rotate_left(first);
                n
            })
            .collect();
        all.sort_unstable();
        all
    }

    fn assert_is_boundary(surface: &Surface, mesh: &TetMesh) {
        let mut both = triangles(surface.sheet(Side::Skin));
        both.extend(triangles(surface.sheet(Side::Inside)));
        both.sort_unstable();
        let mut expected: Vec<_> = Boundary::of(mesh)
            .triangles
            .into_iter()
            .map(|mut n| {
                let first = (0..3).min_by_key(|k| n[*k]).unwrap();
                n.rotate_left(first);
                n
            })
            .collect();
        expected.sort_unstable();
        assert_eq!(both, expected);
        for side in [Side::Skin, Side::Inside] {
            let sheet = surface.sheet(side);
            let mut used = vec![0; sheet.vertices().len()];
            sheet.indices().iter().for_each(|i| used[*i as usize] += 1);
            assert_eq!(used, sheet.uses);
            let mut corners = vec![0; sheet.node_uses.len()];
            sheet.indices().iter().for_each(|i| corners[sheet.vertices()[*i as usize].node.index()] += 1);
            assert_eq!(corners, sheet.node_uses);
            assert_eq!(sheet.slot_of.len(), used.iter().filter(|u| **u > 0).count());
        }
    }

    /// Area in the rest shape, m2.
    fn area(sheet: &Sheet, mesh: &TetMesh) -> f64 {
        triangles(sheet)
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|n| mesh.rest(n));
                (b - a).cross(c - a).length() / 2.0
            })
            .sum()
    }

    /// Splits a block along x = 2 cells by giving the upper half its own nodes there.
    #[test]
    fn a_cut_right_through_opens_two_insides_and_keeps_the_skin() {
        let edge = 0.01;
        let mut mesh = block([4, 2, 2], edge);
        let planes = OuterPlanes::of(&mesh);
        let mut surface = Surface::of(&mesh, &planes);
        let skin = area(surface.sheet(Side::Skin), &mesh);
        let on_sheet = |m: &TetMesh, n: NodeId| (m.rest(n).x - 2.0 * edge).abs() < 1e-9 * edge;
        let upper: Vec<_> = mesh
            .iter()
            .filter(|(t, c)| mesh.points(*t).iter().map(|p| p.x).sum::<f64>() > 8.0 * edge && c.iter().any(|n| on_sheet(&mesh, *n)))
            .collect();
        let mut copies = FxHashMap::default();
        for (tet, corners) in upper {
            let attributes = mesh.tet(tet);
            let nodes = corners.map(|n| if on_sheet(&mesh, n) { *copies.entry(n).or_insert_with(|| mesh.split_node(n)) } else { n });
            mesh.remove_tet(tet);
            mesh.add_tet(nodes, attributes);
        }
        let delta = mesh.take_delta();
        surface.apply(&mesh, &planes, &delta);
        assert_is_boundary(&surface, &mesh);
        let (opened, section) = (area(surface.sheet(Side::Inside), &mesh), 4.0 * edge * edge);
        assert!((opened - 2.0 * section).abs() < 1e-9 * section, "{opened}");
        assert!((area(surface.sheet(Side::Skin), &mesh) - skin).abs() < 1e-9 * skin);
    }

    proptest! {
        /// Random removals, restorations and edge splits, several deltas in a row: the lists are always the boundary.
        #[test]
        fn following_deltas_equals_the_rebuilt_boundary(steps in prop::collection::vec(prop::collection::vec((0_usize..400, 0_u8..3), 1..12), 1..8)) {
            let mut mesh = block([3, 2, 2], 0.01);
            let planes = OuterPlanes::of(&mesh);
            let mut surface = Surface::of(&mesh, &planes);
            for step in steps {
                for (pick, what) in step {
                    let all: Vec<_> = mesh.iter().collect();
                    if all.is_empty() {
                        continue;
                    }
                    let (tet, [a, b, c, d]) = all[pick % all.len()];
                    let attributes = mesh.tet(tet);
                    match what {
                        0 => mesh.remove_tet(tet),
                        1 => {
                            mesh.remove_tet(tet);
                            mesh.add_tet([a, b, c, d], attributes);
                        }
                        _ => {
                            let around: Vec<_> = mesh.topology().around_edge(a, b).collect();
                            let m = mesh.add_node((mesh.rest(a) + mesh.rest(b)) / 2.0, smallvec![(a, 0.5), (b, 0.5)]);
                            for t in around {
                                let (corners, attributes) = (mesh.corners(t), mesh.tet(t));
                                mesh.remove_tet(t);
                                mesh.add_tet(corners.map(|n| if n == a { m } else { n }), attributes);
                                mesh.add_tet(corners.map(|n| if n == b { m } else { n }), attributes);
                            }
                        }
                    }
                }
                let delta = mesh.take_delta();
                surface.apply(&mesh, &planes, &delta);
                assert_is_boundary(&surface, &mesh);
            }
        }
    }
}
