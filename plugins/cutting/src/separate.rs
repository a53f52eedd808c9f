//! Separation: at each vertex of the sheet the children are grouped by faces that are not marked; one node a group.
//!
//! Vertices at the front have one group and stay whole: that is the tip of the crack. A node is known by its vertex and the corners of
//! its side, so that its position and velocity survive the next subdivision.

use crate::cutter::Cutter;
use crate::kernel::Vertex;
use crate::stroke::SideNode;
use keyhole_tetmesh::{NodeId, TetId, TetMesh};
use rustc_hash::FxBuildHasher;
use smallvec::{SmallVec, smallvec};
use std::hash::BuildHasher;

/// A child at a vertex.
#[derive(Clone, Copy)]
struct Incident {
    base: TetId,
    place: u32,
    child: u32,
    label: i8,
    /// Which of its vertices it is.
    at: u8,
}

/// Children at a vertex that hang together.
#[derive(Clone, Debug, Default)]
struct Group {
    /// The first of them.
    root: usize,
    /// Corners that tell its side of the sheet.
    tags: SmallVec<[NodeId; 4]>,
}

/// Lists that are used again for each vertex.
#[derive(Default)]
struct Scratch {
    incident: Vec<Incident>,
    /// By incident child: another of its group, or itself.
    parent: Vec<usize>,
    pairs: FacePairs,
    groups: Vec<Group>,
}

/// A face of a child at a vertex.
#[derive(Clone, Copy)]
struct FaceAt {
    /// The sum of the hashes of its two other vertices.
    hash: u32,
    /// Whose it is among the children at the vertex.
    incident: u32,
    /// Which of the child's vertices the two others are.
    others: [u8; 2],
}

/// Finds the two children at each face of a vertex: a table with open places.
#[derive(Default)]
struct FacePairs {
    faces: Vec<FaceAt>,
    /// By hash: a place among the faces, or [`FacePairs::NONE`].
    table: Vec<u32>,
}

impl FacePairs {
    const NONE: u32 = u32::MAX;

    /// Empties it, with room for the faces of so many children.
    fn reset(&mut self, children: usize) {
        self.faces.clear();
        self.table.clear();
        self.table.resize((6 * children).next_power_of_two(), Self::NONE);
    }

    /// The same face of another child, if there was one before.
    fn pair(&mut self, face: FaceAt, same: impl Fn(&FaceAt) -> bool) -> Option<FaceAt> {
        let mask = self.table.len() - 1;
        let mut at = face.hash as usize & mask;
        while let Some(known) = self.faces.get(self.table[at] as usize) {
            if known.hash == face.hash && same(known) {
                return Some(*known);
            }
            at = (at + 1) & mask;
        }
        self.table[at] = self.faces.len() as u32;
        self.faces.push(face);
        None
    }
}

/// A hash of a vertex, for quick comparison.
pub(crate) fn hash_of(vertex: Vertex) -> u32 {
    let hash = FxBuildHasher.hash_one(vertex);
    (hash ^ (hash >> 32)) as u32
}

impl Cutter {
    /// Names the nodes of all children at the given vertices. `added` are the first nodes of vertices that are new, ascending by vertex;
    /// `concerned` gains the base tetrahedra of which a child's node was renamed. Returns the nodes that nothing uses any more.
    pub(crate) fn separate(
        &mut self,
        mesh: &mut TetMesh,
        vertices: &[Vertex],
        added: &[(Vertex, NodeId)],
        concerned: &mut Vec<TetId>,
    ) -> Vec<NodeId> {
        let mut unused = Vec::new();
        let mut scratch = Scratch::default();
        for &vertex in vertices {
            self.find_incident(vertex, &mut scratch.incident);
            self.find_groups(vertex, &mut scratch);
            let mut known: SmallVec<[SideNode; 2]> = self.stroke.sides.remove(&vertex).unwrap_or_default();
            if known.is_empty() {
                let first = match vertex {
                    Vertex::Corner(n) => Some(n),
                    Vertex::Edge(_) | Vertex::Face(_) => added.binary_search_by_key(&vertex, |a| a.0).ok().map(|i| added[i].1),
                };
                known.extend(first.map(|node| SideNode { node, tags: SmallVec::new() }));
            }
            let sides = self.assign(mesh, vertex, &scratch.groups, &mut known);
            unused.extend(known.into_iter().map(|s| s.node));
            for (i, member) in scratch.incident.iter().enumerate() {
                let root = root(&mut scratch.parent, i);
                if let Some(group) = scratch.groups.iter().position(|g| g.root == root) {
                    self.name(*member, sides[group].node, concerned);
                }
            }
            if !sides.is_empty() {
                self.stroke.sides.insert(vertex, sides);
            }
        }
        unused
    }

    /// The children at a vertex, in order of base tetrahedron.
    fn find_incident(&self, vertex: Vertex, incident: &mut Vec<Incident>) {
        incident.clear();
        let (first, others): (NodeId, SmallVec<[NodeId; 2]>) = match vertex {
            Vertex::Corner(n) => (n, SmallVec::new()),
            Vertex::Edge(e) => (e.nodes()[0], smallvec![e.nodes()[1]]),
            Vertex::Face(f) => (f.nodes()[0], smallvec![f.nodes()[1], f.nodes()[2]]),
        };
        let touched = self.before.touched_around(first);
        let has_all = |t: &TetId| self.before.place(*t).is_some_and(|p| others.iter().all(|n| self.before.place_corners(p).contains(n)));
        let mut bases: SmallVec<[TetId; 32]> = touched.filter(has_all).collect();
        bases.sort_unstable();
        let hash = hash_of(vertex);
        for base in bases {
            let Some(place) = self.before.place(base) else { continue };
            for (child, placed) in self.stroke.touched[place].children.iter().enumerate() {
                if let Some(at) = (0..4).find(|&k| placed.hashes[k] == hash && placed.key[k] == vertex) {
                    incident.push(Incident { base, place: place as u32, child: child as u32, label: placed.label, at: at as u8 });
                }
            }
        }
    }

    /// Groups children that share an unmarked face at the vertex.
    fn find_groups(&self, vertex: Vertex, scratch: &mut Scratch) {
        let Scratch { incident, parent, pairs, groups } = scratch;
        parent.clear();
        parent.extend(0..incident.len());
        pairs.reset(incident.len());
        let child = |m: &Incident| &self.stroke.touched[m.place as usize].children[m.child as usize];
        for (i, member) in incident.iter().enumerate() {
            let placed = child(member);
            let [a, b, c] = [1, 2, 3].map(|k| (member.at + k) % 4);
            for others in [[a, b], [a, c], [b, c]] {
                let [a, b] = others.map(|k| placed.key[usize::from(k)]);
                let [ha, hb] = others.map(|k| placed.hashes[usize::from(k)]);
                let face = FaceAt { hash: ha.wrapping_add(hb), incident: i as u32, others };
                let pair = pairs.pair(face, |known| {
                    let key = &child(&incident[known.incident as usize]).key;
                    let [c, d] = known.others.map(|k| key[usize::from(k)]);
                    (a == c && b == d) || (a == d && b == c)
                });
                let Some(j) = pair.map(|p| p.incident as usize) else { continue };
                if !self.stroke.is_marked(&[vertex, a, b], [member.label, incident[j].label]) {
                    let (a, b) = (root(parent, i), root(parent, j));
                    parent[a.max(b)] = a.min(b);
                }
            }
        }
        groups.clear();
        for (i, member) in incident.iter().enumerate() {
            let root = root(parent, i);
            let at = groups.iter().position(|g| g.root == root).unwrap_or_else(|| {
                groups.push(Group { root, tags: SmallVec::new() });
                groups.len() - 1
            });
            for v in child(member).key {
                if let Vertex::Corner(n) = v
                    && is_tag(vertex, n)
                    && !groups[at].tags.contains(&n)
                    && !self.stroke.on_sheet.contains_key(&n)
                {
                    groups[at].tags.push(n);
                }
            }
        }
        for group in groups.iter_mut() {
            group.tags.sort_unstable();
        }
        groups.sort_by_key(|g| (g.tags.is_empty(), g.tags.first().copied()));
    }

    /// A node for each group: the one its side had, or a double.
    fn assign(
        &mut self,
        mesh: &mut TetMesh,
        vertex: Vertex,
        groups: &[Group],
        known: &mut SmallVec<[SideNode; 2]>,
    ) -> SmallVec<[SideNode; 2]> {
        let mut nodes: SmallVec<[Option<NodeId>; 4]> = smallvec![None; groups.len()];
        for (group, node) in groups.iter().zip(&mut nodes) {
            if let Some(i) = known.iter().position(|s| s.tags.iter().any(|t| group.tags.contains(t))) {
                *node = Some(known.remove(i).node);
            }
        }
        for node in nodes.iter_mut().filter(|n| n.is_none()) {
            if !known.is_empty() {
                *node = Some(known.remove(0).node);
            }
        }
        // A corner's own node stays: the base tetrahedra are known by it.
        if let Vertex::Corner(own) = vertex
            && let Some(i) = known.iter().position(|s| s.node == own)
            && let Some(Some(other)) = nodes.first_mut()
        {
            std::mem::swap(other, &mut known[i].node);
        }
        let first = nodes.iter().copied().flatten().next();
        groups
            .iter()
            .zip(nodes)
            .map(|(group, node)| {
                let node = node.or_else(|| first.map(|of| mesh.split_node(of))).unwrap_or_else(|| {
                    let rest = self.vertex_rest(mesh, vertex);
                    let from = match vertex {
                        Vertex::Corner(n) => smallvec![(n, 1.0)],
                        Vertex::Edge(e) => e.nodes().iter().map(|n| (*n, 0.5)).collect(),
                        Vertex::Face(f) => f.nodes().iter().map(|n| (*n, 1.0 / 3.0)).collect(),
                    };
                    mesh.add_node(rest, from)
                });
                SideNode { node, tags: group.tags.clone() }
            })
            .collect()
    }

    fn name(&mut self, member: Incident, node: NodeId, concerned: &mut Vec<TetId>) {
        let named = &mut self.stroke.touched[member.place as usize].children[member.child as usize].nodes[usize::from(member.at)];
        if *named != node {
            *named = node;
            concerned.push(member.base);
        }
    }
}

/// Whether a corner tells the sides of a vertex apart.
fn is_tag(vertex: Vertex, corner: NodeId) -> bool {
    match vertex {
        Vertex::Corner(_) => true,
        Vertex::Edge(e) => e.nodes().contains(&corner),
        Vertex::Face(f) => f.nodes().contains(&corner),
    }
}

fn root(parent: &mut [usize], mut i: usize) -> usize {
    while parent[i] != i {
        parent[i] = parent[parent[i]];
        i = parent[i];
    }
    i
}
