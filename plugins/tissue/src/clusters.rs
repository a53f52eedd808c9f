//! Clusters of nodes that move nearly as one: the coarse levels of [`crate::multilevel`].
//!
//! Nodes are in small clusters, small clusters in large ones. A topology change looks at the clusters of the nodes it touched and at
//! nothing else: a new node joins the cluster of the node it comes from, a cluster whose nodes no longer hang together is taken apart, so
//! that no coarse motion reaches across a cut, one that grew is halved, and one that has become small joins another that it hangs together with.

use crate::rows::Rows;
use bevy_math::DVec3;
use keyhole_tetmesh::{NodeEdit, NodeId, TetMesh};
use rayon::prelude::*;

/// Nodes of a small cluster: most, when it is made. One that grows beyond twice as many is halved.
const SMALL: usize = 12;

/// Nodes of a large cluster: most, when there are not too many of them.
const LARGE: usize = 192;

/// Most large clusters when a body is made: their tangent is factored as a dense matrix, six rows each.
const MOST_LARGE: usize = 36;

/// Large clusters of fewer small ones than this are not split off a large one when it comes apart.
const LEAST_PIECE: usize = 4;

/// A cluster of less than one in so many of the nodes that one has when it is made joins another.
const FEW: usize = 3;

/// In no cluster.
pub(crate) const NONE: u32 = u32::MAX;

/// Two levels of clusters over the nodes of a body.
#[derive(Clone, Debug, Default)]
pub struct Clusters {
    /// Small cluster of each node.
    pub(crate) of_node: Vec<u32>,
    /// Nodes of each small cluster, ascending; empty when it is not in use.
    pub(crate) nodes: Vec<Vec<u32>>,
    /// Large cluster of each small one.
    pub(crate) parent: Vec<u32>,
    /// Small clusters of each large one, ascending.
    pub(crate) children: Vec<Vec<u32>>,
    /// Small clusters that are not in use.
    unused: Vec<u32>,
}

impl Clusters {
    /// The clusters of a body with these rows.
    pub(crate) fn new(mesh: &TetMesh, rows: &Rows) -> Self {
        let mut clusters = Self { of_node: vec![NONE; mesh.node_slots()], ..Self::default() };
        let mut nodes: Vec<u32> = mesh.nodes().filter(|n| !rows.neighbours(n.index()).is_empty()).map(|n| n.0).collect();
        let large = large_size(nodes.len());
        let at = |n: u32| point(mesh.rest(NodeId(n)));
        let beside = |n: u32| rows.neighbours(n as usize);
        let small = |mut block: Vec<u32>| bisect(&mut block, SMALL, &at).into_iter().flat_map(|small| parts(small, beside)).collect();
        let within = |block: Vec<u32>| parts(block, beside).into_iter().map(small).collect::<Vec<Vec<Vec<u32>>>>();
        let blocks: Vec<Vec<Vec<Vec<u32>>>> = bisect(&mut nodes, large, &at).into_par_iter().map(within).collect();
        for pieces in blocks.into_iter().flatten() {
            let parent = clusters.children.len() as u32;
            clusters.children.push(Vec::new());
            for piece in pieces {
                clusters.add(piece, parent);
            }
        }
        clusters
    }

    /// Number of small and of large clusters.
    pub(crate) fn count(&self) -> (usize, usize) {
        (self.nodes.iter().filter(|n| !n.is_empty()).count(), self.children.iter().filter(|c| !c.is_empty()).count())
    }

    /// Large cluster of a node.
    pub(crate) fn large_of(&self, node: usize) -> u32 {
        let small = self.of_node[node];
        if small == NONE { NONE } else { self.parent[small as usize] }
    }

    /// Carries the clusters over a topology change: `edits` are those of the nodes, `touched` the nodes whose rows changed.
    pub(crate) fn adopt(&mut self, mesh: &TetMesh, rows: &Rows, edits: &[NodeEdit], touched: &[NodeId]) {
        self.of_node.resize(mesh.node_slots().max(self.of_node.len()), NONE);
        for edit in edits {
            let (node, from) = match edit {
                NodeEdit::Split { node, of } => (*node, *of),
                NodeEdit::Added { node, from } => {
                    let Some((nearest, _)) = from.iter().max_by(|a, b| a.1.total_cmp(&b.1)) else { continue };
                    (*node, *nearest)
                }
                NodeEdit::Moved { .. } | NodeEdit::Removed { .. } => continue,
            };
            let cluster = self.of_node[from.index()];
            self.take_out(node.0);
            if cluster != NONE {
                self.put(node.0, cluster);
            }
        }
        let mut smalls = Vec::new();
        for node in touched.iter().map(|n| n.0) {
            let alone = rows.neighbours(node as usize).is_empty();
            if alone {
                smalls.push(self.of_node[node as usize]);
                self.take_out(node);
            } else if self.of_node[node as usize] == NONE {
                // A node whose origin is in no cluster: with a neighbour, or on its own.
                let beside = rows.neighbours(node as usize).iter().map(|n| self.of_node[*n as usize]).find(|c| *c != NONE);
                match beside {
                    Some(cluster) => self.put(node, cluster),
                    None => {
                        let parent = self.empty_large();
                        self.add(vec![node], parent);
                    }
                }
            }
            smalls.push(self.of_node[node as usize]);
        }
        smalls.sort_unstable();
        smalls.dedup();
        smalls.retain(|c| *c != NONE);
        let mut larges: Vec<u32> = smalls.iter().map(|c| self.parent[*c as usize]).collect();
        for at in 0..smalls.len() {
            self.mend_small(smalls[at], mesh, rows, &mut smalls);
        }
        for small in smalls {
            self.join_small(small, rows, &mut larges);
        }
        larges.sort_unstable();
        larges.dedup();
        for at in 0..larges.len() {
            self.mend_large(larges[at], rows, &mut larges);
        }
        let size = large_size(self.of_node.iter().filter(|c| **c != NONE).count());
        for large in larges {
            self.join_large(large, size, rows);
        }
        self.close_up();
    }

    /// Takes a cluster's nodes over by one beside it that has room for them, if they have become few.
    fn join_small(&mut self, small: u32, rows: &Rows, larges: &mut Vec<u32>) {
        let own = self.nodes[small as usize].len();
        if own == 0 || own * FEW >= SMALL {
            return;
        }
        let parent = self.parent[small as usize];
        let fits = |c: &u32| own + self.nodes[*c as usize].len() <= 2 * SMALL;
        let apart = |c: u32| self.parent[c as usize] != parent;
        let best = self.beside(small, rows).into_iter().filter(fits).min_by_key(|c| (apart(*c), self.nodes[*c as usize].len(), *c));
        let Some(to) = best else { return };
        let members = std::mem::take(&mut self.nodes[small as usize]);
        for n in members {
            self.put(n, to);
        }
        self.children[parent as usize].retain(|c| *c != small);
        self.unused.push(small);
        // What hung together by it may not any more.
        larges.extend([parent, self.parent[to as usize]]);
    }

    /// The same for a large cluster, where one has `size` nodes when it is made.
    fn join_large(&mut self, large: u32, size: usize, rows: &Rows) {
        let nodes = |l: u32| self.children[l as usize].iter().map(|c| self.nodes[*c as usize].len()).sum::<usize>();
        let own = nodes(large);
        if own == 0 || own * FEW >= size {
            return;
        }
        let mut near: Vec<u32> = self.children[large as usize].iter().flat_map(|c| self.beside(*c, rows)).collect();
        near.iter_mut().for_each(|c| *c = self.parent[*c as usize]);
        near.sort_unstable();
        near.dedup();
        let best = near.into_iter().filter(|l| *l != large && own + nodes(*l) <= 2 * size).min_by_key(|l| (nodes(*l), *l));
        let Some(to) = best else { return };
        for c in std::mem::take(&mut self.children[large as usize]) {
            self.parent[c as usize] = to;
            self.children[to as usize].push(c);
        }
        self.children[to as usize].sort_unstable();
    }

    /// Leaves no large cluster empty: each has its rows in the dense matrix.
    fn close_up(&mut self) {
        while let Some(at) = self.children.iter().position(Vec::is_empty) {
            self.children.swap_remove(at);
            for c in self.children.get(at).into_iter().flatten() {
                self.parent[*c as usize] = at as u32;
            }
        }
    }

    /// The small clusters that share a tetrahedron with this one, ascending.
    fn beside(&self, small: u32, rows: &Rows) -> Vec<u32> {
        let around = self.nodes[small as usize].iter().flat_map(|n| rows.neighbours(*n as usize));
        let mut found: Vec<u32> = around.map(|n| self.of_node[*n as usize]).filter(|o| *o != small && *o != NONE).collect();
        found.sort_unstable();
        found.dedup();
        found
    }

    /// Halves a small cluster that grew and takes one apart that no longer hangs together; `made` gets what it was made into.
    fn mend_small(&mut self, small: u32, mesh: &TetMesh, rows: &Rows, made: &mut Vec<u32>) {
        let mut members = std::mem::take(&mut self.nodes[small as usize]);
        let parent = self.parent[small as usize];
        let limit = if members.len() > 2 * SMALL { SMALL } else { members.len().max(1) };
        let mut pieces = Vec::new();
        for half in bisect(&mut members, limit, &|n| point(mesh.rest(NodeId(n)))) {
            pieces.extend(parts(half, |n| rows.neighbours(n as usize)));
        }
        let mut pieces = pieces.into_iter();
        match pieces.next() {
            Some(first) => self.fill(small, first),
            None => {
                self.children[parent as usize].retain(|c| *c != small);
                self.unused.push(small);
            }
        }
        for piece in pieces {
            made.push(self.add(piece, parent));
        }
    }

    /// Takes a large cluster apart that no longer hangs together; `made` gets what it was made into.
    fn mend_large(&mut self, large: u32, rows: &Rows, made: &mut Vec<u32>) {
        let members = self.children[large as usize].clone();
        let near: rustc_hash::FxHashMap<u32, Vec<u32>> = members.iter().map(|c| (*c, self.beside(*c, rows))).collect();
        let mut pieces = parts(members, |c| near.get(&c).map_or(&[], Vec::as_slice));
        // The largest stays.
        pieces.sort_by_key(|p| std::cmp::Reverse(p.len()));
        for piece in pieces.into_iter().skip(1) {
            let beyond = piece.iter().flat_map(|c| &near[c]).map(|c| self.parent[*c as usize]).find(|p| *p != large);
            let to = match beyond {
                Some(other) if piece.len() < LEAST_PIECE => other,
                _ => self.empty_large(),
            };
            made.push(to);
            for c in piece {
                self.children[large as usize].retain(|o| *o != c);
                self.parent[c as usize] = to;
                self.children[to as usize].push(c);
            }
            self.children[to as usize].sort_unstable();
        }
    }

    /// A large cluster that is not in use.
    fn empty_large(&mut self) -> u32 {
        let at = self.children.iter().position(Vec::is_empty).unwrap_or(self.children.len());
        if at == self.children.len() {
            self.children.push(Vec::new());
        }
        at as u32
    }

    fn add(&mut self, members: Vec<u32>, parent: u32) -> u32 {
        let small = self.unused.pop().unwrap_or_else(|| {
            self.nodes.push(Vec::new());
            self.parent.push(parent);
            self.nodes.len() as u32 - 1
        });
        self.parent[small as usize] = parent;
        self.children[parent as usize].push(small);
        self.fill(small, members);
        small
    }

    fn fill(&mut self, small: u32, members: Vec<u32>) {
        for n in &members {
            self.of_node[*n as usize] = small;
        }
        self.nodes[small as usize] = members;
    }

    fn put(&mut self, node: u32, small: u32) {
        let list = &mut self.nodes[small as usize];
        let at = list.partition_point(|n| *n < node);
        list.insert(at, node);
        self.of_node[node as usize] = small;
    }

    fn take_out(&mut self, node: u32) {
        let small = std::mem::replace(&mut self.of_node[node as usize], NONE);
        if small != NONE {
            self.nodes[small as usize].retain(|n| *n != node);
        }
    }

    /// Bytes of all arrays.
    #[must_use]
    pub fn bytes(&self) -> usize {
        let lists = |l: &[Vec<u32>]| l.iter().map(|v| v.capacity() * 4 + size_of::<Vec<u32>>()).sum::<usize>();
        4 * (self.of_node.capacity() + self.parent.capacity()) + lists(&self.nodes) + lists(&self.children)
    }
}

/// Nodes of a large cluster of a body of so many: most, when it is made.
fn large_size(nodes: usize) -> usize {
    LARGE.max(nodes.div_ceil(MOST_LARGE))
}

fn point(p: keyhole_tetmesh::DVec3) -> DVec3 {
    DVec3::new(p.x, p.y, p.z)
}

/// Halves a list across its longest extent until no part is longer than `most`; every part ascending.
fn bisect(list: &mut [u32], most: usize, at: &impl Fn(u32) -> DVec3) -> Vec<Vec<u32>> {
    if list.is_empty() {
        return Vec::new();
    }
    let parts = list.len().div_ceil(most);
    if parts == 1 {
        list.sort_unstable();
        return vec![list.to_vec()];
    }
    let (low, high) = list.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), n| (low.min(at(*n)), high.max(at(*n))));
    let size = high - low;
    let axis = if size.x >= size.y && size.x >= size.z {
        0
    } else if size.y >= size.z {
        1
    } else {
        2
    };
    list.sort_unstable_by(|a, b| at(*a)[axis].total_cmp(&at(*b)[axis]).then(a.cmp(b)));
    let (left, right) = list.split_at_mut(list.len() * (parts / 2) / parts);
    let mut all = bisect(left, most, at);
    all.extend(bisect(right, most, at));
    all
}

/// The connected parts of a list, ascending by their first member; every part ascending.
fn parts<'a>(mut list: Vec<u32>, neighbours: impl Fn(u32) -> &'a [u32]) -> Vec<Vec<u32>> {
    list.sort_unstable();
    let mut seen = vec![false; list.len()];
    let mut all = Vec::new();
    for start in 0..list.len() {
        if seen[start] {
            continue;
        }
        seen[start] = true;
        let mut found = vec![start];
        let mut next = 0;
        while let Some(&at) = found.get(next) {
            next += 1;
            for n in neighbours(list[at]) {
                if let Ok(i) = list.binary_search(n)
                    && !seen[i]
                {
                    seen[i] = true;
                    found.push(i);
                }
            }
        }
        found.sort_unstable();
        all.push(found.into_iter().map(|i| list[i]).collect());
    }
    all
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use crate::adopt::adopt;
    use crate::beam::{beam, beam_material};
    use crate::{Body, Momentum};
    use keyhole_tetmesh::TetId;
    use keyhole_whiteboard::TissueState;
    use std::collections::BTreeMap;

    /// After a cut through the beam every node is in one small cluster and that in one large one, every cluster hangs together, and none reaches
    /// across the cut.
    #[test]
    fn no_cluster_reaches_across_a_cut() {
        let mut mesh = beam(13, 6);
        let mut body = Body::new(&mesh, &beam_material()).unwrap();
        let mut state = TissueState::at_rest(&mesh);
        let far: Vec<TetId> =
            mesh.iter().map(|(t, _)| t).filter(|t| mesh.points(*t).iter().map(|p| p.x).sum::<f64>() / 4.0 > 0.031).collect();
        let near: std::collections::BTreeSet<_> = mesh.iter().filter(|(t, _)| !far.contains(t)).flat_map(|(_, c)| c).collect();
        let mut twins = BTreeMap::new();
        for tet in far {
            let (corners, attributes) = (mesh.corners(tet), mesh.tet(tet));
            if corners.iter().any(|n| near.contains(n)) {
                mesh.remove_tet(tet);
                let own = corners.map(|n| if near.contains(&n) { *twins.entry(n).or_insert_with(|| mesh.split_node(n)) } else { n });
                mesh.add_tet(own, attributes);
            }
        }
        let delta = mesh.take_delta();
        adopt(&mut body, &mut state, &mesh, &delta, |_| Momentum::default());

        let clusters = &body.implicit.newton.clusters;
        let rows = &body.implicit.newton.rows;
        let mut seen = vec![0; mesh.node_slots()];
        for (large, children) in clusters.children.iter().enumerate() {
            let mut all = Vec::new();
            for small in children {
                assert_eq!(clusters.parent[*small as usize], large as u32);
                let nodes = &clusters.nodes[*small as usize];
                assert_eq!(super::parts(nodes.clone(), |n| rows.neighbours(n as usize)).len(), 1, "small cluster {small}");
                for n in nodes {
                    assert_eq!(clusters.of_node[*n as usize], *small);
                    seen[*n as usize] += 1;
                }
                all.extend(nodes);
            }
            assert!(super::parts(all, |n| rows.neighbours(n as usize)).len() <= 1, "large cluster {large}");
        }
        assert!(mesh.nodes().all(|n| seen[n.index()] == 1));
    }
}
