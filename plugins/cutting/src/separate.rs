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
    /// Faces at the vertex: a hash that orders them fast, their two other vertices, and whose they are.
    faces: Vec<(u64, [Vertex; 2], u32)>,
    groups: Vec<Group>,
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
                    self.name(*member, vertex, sides[group].node, concerned);
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
        for base in bases {
            let Some(place) = self.before.place(base) else { continue };
            for (child, placed) in self.stroke.touched[place].children.iter().enumerate() {
                if placed.key.contains(&vertex) {
                    incident.push(Incident { base, place: place as u32, child: child as u32, label: placed.label });
                }
            }
        }
    }

    /// Groups children that share an unmarked face at the vertex.
    fn find_groups(&self, vertex: Vertex, scratch: &mut Scratch) {
        let Scratch { incident, parent, faces, groups } = scratch;
        parent.clear();
        parent.extend(0..incident.len());
        faces.clear();
        let key = |m: &Incident| self.stroke.touched[m.place as usize].children[m.child as usize].key;
        for (i, member) in incident.iter().enumerate() {
            let key = key(member);
            let mut others = key.into_iter().filter(|v| *v != vertex);
            if let (Some(a), Some(b), Some(c)) = (others.next(), others.next(), others.next()) {
                let [ha, hb, hc] = [a, b, c].map(|v| FxBuildHasher.hash_one(v));
                let face = |a: Vertex, b: Vertex, hash: u64| (hash, if a < b { [a, b] } else { [b, a] }, i as u32);
                faces.extend([face(a, b, ha.wrapping_add(hb)), face(a, c, ha.wrapping_add(hc)), face(b, c, hb.wrapping_add(hc))]);
            }
        }
        faces.sort_unstable();
        for pair in faces.windows(2) {
            let [(face, i), (other, j)] = [pair[0], pair[1]].map(|(_, f, i)| (f, i as usize));
            if face == other && !self.stroke.is_marked(&[vertex, face[0], face[1]], [incident[i].label, incident[j].label]) {
                let (a, b) = (root(parent, i), root(parent, j));
                parent[a.max(b)] = a.min(b);
            }
        }
        groups.clear();
        for (i, member) in incident.iter().enumerate() {
            let root = root(parent, i);
            let at = groups.iter().position(|g| g.root == root).unwrap_or_else(|| {
                groups.push(Group { root, tags: SmallVec::new() });
                groups.len() - 1
            });
            for v in key(member) {
                if let Vertex::Corner(n) = v
                    && is_tag(vertex, n)
                    && !self.stroke.on_sheet.contains_key(&n)
                    && !groups[at].tags.contains(&n)
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

    fn name(&mut self, member: Incident, vertex: Vertex, node: NodeId, concerned: &mut Vec<TetId>) {
        let child = &mut self.stroke.touched[member.place as usize].children[member.child as usize];
        if let Some(i) = child.key.iter().position(|v| *v == vertex)
            && child.nodes[i] != node
        {
            child.nodes[i] = node;
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
