//! Separation: at each vertex of the sheet the children are grouped by faces that are not marked; one node a group.
//!
//! Vertices at the front have one group and stay whole: that is the tip of the crack. A node is known by its vertex and the corners of
//! its side, so that its position and velocity survive the next subdivision.

use crate::cutter::Cutter;
use crate::kernel::Vertex;
use crate::refine::child_faces;
use crate::stroke::SideNode;
use keyhole_tetmesh::{NodeId, TetId, TetMesh};
use rustc_hash::FxHashMap;
use smallvec::smallvec;
use std::collections::{BTreeMap, BTreeSet};

/// A child at a vertex.
#[derive(Clone, Copy)]
struct Incident {
    base: TetId,
    child: usize,
    label: i8,
}

impl Cutter {
    /// Names the nodes of all children at the given vertices. Returns the nodes that nothing uses any more.
    pub(crate) fn separate(&mut self, mesh: &mut TetMesh, vertices: &BTreeSet<Vertex>, added: &BTreeMap<Vertex, NodeId>) -> Vec<NodeId> {
        let mut unused = Vec::new();
        for &vertex in vertices {
            let incident = self.incident(vertex);
            let groups = self.groups(vertex, &incident);
            let mut known: Vec<SideNode> = self.stroke.sides.remove(&vertex).unwrap_or_default();
            if known.is_empty() {
                let first = match vertex {
                    Vertex::Corner(n) => Some(n),
                    Vertex::Edge(_) | Vertex::Face(_) => added.get(&vertex).copied(),
                };
                known.extend(first.map(|node| SideNode { node, tags: Vec::new() }));
            }
            let sides = self.assign(mesh, vertex, &groups, &mut known);
            unused.extend(known.into_iter().map(|s| s.node));
            for (group, side) in groups.iter().zip(&sides) {
                for member in &group.members {
                    self.name(*member, vertex, side.node);
                }
            }
            if !sides.is_empty() {
                self.stroke.sides.insert(vertex, sides);
            }
        }
        unused
    }

    /// The children at a vertex, in order of base tetrahedron.
    fn incident(&self, vertex: Vertex) -> Vec<Incident> {
        let mut bases: Vec<TetId> = match vertex {
            Vertex::Corner(n) => self.base.around_node(n).to_vec(),
            Vertex::Edge(e) => {
                let [a, b] = e.nodes();
                self.base.around_edge(a, b).collect()
            }
            Vertex::Face(f) => self.base.around_face(f).collect(),
        };
        bases.sort_unstable();
        let mut incident = Vec::new();
        for base in bases {
            let Some(touched) = self.stroke.touched.get(&base) else { continue };
            let labels = self.stroke.labels(touched.corners);
            for (child, placed) in touched.children.iter().enumerate() {
                if placed.key.contains(&vertex) {
                    let label = self.stroke.child_label(&placed.key, touched.corners, labels);
                    incident.push(Incident { base, child, label });
                }
            }
        }
        incident
    }

    /// Groups children that share an unmarked face at the vertex.
    fn groups(&self, vertex: Vertex, incident: &[Incident]) -> Vec<Group> {
        let mut parent: Vec<usize> = (0..incident.len()).collect();
        let mut faces: FxHashMap<[Vertex; 3], usize> = FxHashMap::default();
        for (i, member) in incident.iter().enumerate() {
            let placed = &self.stroke.touched[&member.base].children[member.child];
            for (face, _) in child_faces(&placed.key, placed.nodes) {
                if !face.contains(&vertex) {
                    continue;
                }
                if let Some(j) = faces.insert(face, i)
                    && !self.stroke.is_marked(&face, [member.label, incident[j].label])
                {
                    let (a, b) = (root(&mut parent, i), root(&mut parent, j));
                    parent[a.max(b)] = a.min(b);
                }
            }
        }
        let mut groups: BTreeMap<usize, Group> = BTreeMap::new();
        for (i, member) in incident.iter().enumerate() {
            let group = groups.entry(root(&mut parent, i)).or_default();
            group.members.push(*member);
            let key = self.stroke.touched[&member.base].children[member.child].key;
            group.tags.extend(key.iter().filter_map(|v| match v {
                Vertex::Corner(n) if is_tag(vertex, *n) && !self.stroke.on_sheet.contains_key(n) => Some(*n),
                _ => None,
            }));
        }
        let mut groups: Vec<Group> = groups.into_values().collect();
        for group in &mut groups {
            group.tags.sort_unstable();
            group.tags.dedup();
        }
        groups.sort_by_key(|g| (g.tags.is_empty(), g.tags.first().copied()));
        groups
    }

    /// A node for each group: the one its side had, or a double.
    fn assign(&mut self, mesh: &mut TetMesh, vertex: Vertex, groups: &[Group], known: &mut Vec<SideNode>) -> Vec<SideNode> {
        let mut nodes: Vec<Option<NodeId>> = vec![None; groups.len()];
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

    fn name(&mut self, member: Incident, vertex: Vertex, node: NodeId) {
        let Some(touched) = self.stroke.touched.get_mut(&member.base) else { return };
        let child = &mut touched.children[member.child];
        if let Some(i) = child.key.iter().position(|v| *v == vertex)
            && child.nodes[i] != node
        {
            child.nodes[i] = node;
            self.relabelled.insert(member.base);
        }
    }
}

/// Children at a vertex that hang together.
#[derive(Default)]
struct Group {
    members: Vec<Incident>,
    tags: Vec<NodeId>,
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
