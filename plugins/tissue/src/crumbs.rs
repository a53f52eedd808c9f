//! Crumbs: what of a body hangs together by tetrahedra and is too small to be solved with the rest, such as what a stroke has cut out before the tool has left.
//!
//! A stage of the implicit solver ends when what is left of the residual is small beside all that the bodies of a system do. To an organ that is nothing; a scrap of some micrograms it
//! throws across the theatre. And what a crumb does to an organ is nothing, too. So crumbs are moved one by one, as rigid bodies to which everything else is an obstacle
//! ([`crate::tumble`]), and the rest is solved without them.

use crate::rows::Rows;
use bevy_ecs::prelude::Entity;
use keyhole_tetmesh::NodeId;
use keyhole_whiteboard::{Contact, Obstacle};
use rustc_hash::FxHashSet;

/// Most nodes of a crumb.
const FEW: usize = 64;

/// How many times as many nodes the body has that it comes from: what is left of the residual, a fifteenth of what the body does, is then less than what the crumb does.
const LIGHTER: usize = 50;

/// Whether so few nodes are a crumb of a body of so many.
#[must_use]
pub(crate) fn is_crumb(nodes: usize, of: usize) -> bool {
    nodes <= FEW && nodes * LIGHTER <= of
}

/// The crumbs of a body.
#[derive(Clone, Debug, Default)]
pub(crate) struct Crumbs {
    /// The number of the crumb that each node belongs to, counted from one; zero for nodes of what is larger.
    of_node: Vec<u32>,
    /// The nodes of each, ascending.
    all: Vec<Vec<u32>>,
    /// How many slots of nodes the body had when it came: what is a crumb of it does not change by its being cut.
    of: usize,
}

impl Crumbs {
    /// The crumbs of a body with these nodes in so many slots.
    pub(crate) fn new(rows: &Rows, slots: usize, nodes: &[NodeId]) -> Self {
        let mut crumbs = Self { of: slots, ..Self::default() };
        crumbs.adopt(rows, slots, nodes);
        crumbs
    }

    /// The nodes of each.
    pub(crate) fn all(&self) -> &[Vec<u32>] {
        &self.all
    }

    /// Whether a node belongs to one.
    pub(crate) fn contains(&self, node: usize) -> bool {
        self.of_node.get(node).is_some_and(|number| *number > 0)
    }

    /// Bytes of all arrays.
    pub(crate) fn bytes(&self) -> usize {
        4 * self.of_node.capacity() + self.all.iter().map(|c| 4 * c.capacity() + size_of::<Vec<u32>>()).sum::<usize>()
    }

    /// Looks anew around the nodes that a topology change touched; the body has so many slots of nodes after it. What has become a crumb has touched nodes, for it was cut off.
    pub(crate) fn adopt(&mut self, rows: &Rows, slots: usize, touched: &[NodeId]) {
        self.of_node.resize(slots, 0);
        let mut doubtful: Vec<u32> = touched.iter().map(|n| n.0).collect();
        let number = |of_node: &[u32], node: &NodeId| of_node.get(node.index()).copied().unwrap_or(0);
        let mut stale: Vec<u32> = touched.iter().map(|n| number(&self.of_node, n)).filter(|number| *number > 0).collect();
        stale.sort_unstable();
        stale.dedup();
        for number in stale.into_iter().rev() {
            doubtful.extend(self.all.swap_remove(number as usize - 1));
        }
        doubtful.sort_unstable();
        doubtful.dedup();
        doubtful.iter().for_each(|n| self.of_node[*n as usize] = 0);
        let mut larger = FxHashSet::default();
        let mut known = FxHashSet::default();
        for node in doubtful {
            if known.contains(&node) || larger.contains(&node) || rows.neighbours(node as usize).is_empty() {
                continue;
            }
            let (nodes, is_small) = hanging_together(rows, node, |n| larger.contains(&n), self.of);
            if is_small {
                known.extend(nodes.iter().copied());
                self.all.push(nodes);
            } else {
                larger.extend(nodes);
            }
        }
        for (at, crumb) in self.all.iter().enumerate() {
            crumb.iter().for_each(|n| self.of_node[*n as usize] = at as u32 + 1);
        }
    }
}

/// The nodes that hang together with this one, ascending, and whether they are a crumb of a body of so many nodes; if not, some of them.
fn hanging_together(rows: &Rows, node: u32, is_larger: impl Fn(u32) -> bool, of: usize) -> (Vec<u32>, bool) {
    let mut nodes = vec![node];
    let mut at = 0;
    while let Some(next) = nodes.get(at).copied() {
        for n in rows.neighbours(next as usize) {
            if is_larger(*n) {
                return (nodes, false);
            }
            if !nodes.contains(n) {
                nodes.push(*n);
            }
        }
        if !is_crumb(nodes.len(), of) {
            return (nodes, false);
        }
        at += 1;
    }
    nodes.sort_unstable();
    (nodes, true)
}

/// The nodes of all crumbs of some organs.
#[derive(Clone, Debug, Default)]
pub(crate) struct Light {
    organs: Vec<Entity>,
    nodes: Vec<(Entity, u32)>,
}

impl Light {
    /// Adds an organ: all of it, or its crumbs.
    pub(crate) fn add(&mut self, organ: Entity, whole: bool, crumbs: &Crumbs) {
        if whole {
            self.organs.push(organ);
        } else {
            self.nodes.extend(crumbs.all().iter().flatten().map(|n| (organ, *n)));
        }
    }

    /// Makes it ready to be asked.
    pub(crate) fn sort(&mut self) {
        self.organs.sort_unstable();
        self.nodes.sort_unstable();
    }

    /// Whether there are none.
    pub(crate) fn is_empty(&self) -> bool {
        self.organs.is_empty() && self.nodes.is_empty()
    }

    /// Whether one of the sides of a contact of an organ is a crumb.
    pub(crate) fn touches(&self, organ: Entity, contact: &Contact) -> bool {
        let has = |organ: Entity, node: Option<&(NodeId, f32)>| {
            let is = |(n, _): &(NodeId, f32)| self.nodes.binary_search(&(organ, n.0)).is_ok();
            self.organs.binary_search(&organ).is_ok() || node.is_some_and(is)
        };
        has(organ, contact.point.first())
            || match &contact.against {
                Obstacle::Own(point) => has(organ, point.first()),
                Obstacle::Organ { organ, point } => has(*organ, point.first()),
                Obstacle::Anatomy(_) | Obstacle::Instrument(_) => false,
            }
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;
    use crate::adopt::adopt;
    use crate::beam::{beam_material, block};
    use crate::{Body, Momentum};
    use keyhole_tetmesh::{DVec3, TetId, TetMesh};
    use keyhole_whiteboard::TissueState;
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    /// Cuts out what is nearer to a point than so much, m.
    fn cut_out(mesh: &mut TetMesh, around: DVec3, radius: f64) {
        let is_in =
            |t: &TetId| (mesh.points(*t).into_iter().map(|p| DVec3::new(p.x, p.y, p.z)).sum::<DVec3>() / 4.0).distance(around) < radius;
        let inside: Vec<TetId> = mesh.iter().map(|(t, _)| t).filter(is_in).collect();
        let outer: std::collections::BTreeSet<NodeId> =
            mesh.iter().filter(|(t, _)| !inside.contains(t)).flat_map(|(_, corners)| corners).collect();
        let mut twins = BTreeMap::new();
        for tet in inside {
            let (corners, attributes) = (mesh.corners(tet), mesh.tet(tet));
            mesh.remove_tet(tet);
            let own = corners.map(|n| if outer.contains(&n) { *twins.entry(n).or_insert_with(|| mesh.split_node(n)) } else { n });
            mesh.add_tet(own, attributes);
        }
    }

    /// What hangs together by tetrahedra and is a crumb, by a look at all of the mesh.
    fn by_looking_at_all(mesh: &TetMesh, slots: usize) -> Vec<Vec<u32>> {
        let mut least: BTreeMap<u32, u32> = mesh.nodes().map(|n| (n.0, n.0)).collect();
        loop {
            let mut changed = false;
            for (_, corners) in mesh.iter() {
                let lowest = corners.iter().map(|n| least[&n.0]).min().unwrap();
                for n in corners {
                    changed |= least.insert(n.0, lowest) != Some(lowest);
                }
            }
            if !changed {
                break;
            }
        }
        let mut parts: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
        least.iter().for_each(|(n, part)| parts.entry(*part).or_default().push(*n));
        parts.into_values().filter(|p| is_crumb(p.len(), slots)).collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        /// After any cuts, also through crumbs, they are those that a look at all of the mesh finds.
        #[test]
        fn they_are_found_where_the_mesh_was_touched(cuts in prop::collection::vec(([0.0..1.0, 0.0..1.0, 0.0..1.0], 0.08..0.35), 1..12)) {
            let mut mesh = block([14; 3], [0.02; 3]);
            let slots = mesh.node_slots();
            let corners = || mesh.nodes().map(|n| mesh.rest(n));
            let (low, high) = corners().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), p| (l.min(p), h.max(p)));
            let mut body = Body::new(&mesh, &beam_material()).unwrap();
            let mut state = TissueState::at_rest(&mesh);
            for (at, radius) in cuts {
                cut_out(&mut mesh, low + (high - low) * DVec3::from_array(at), radius * 0.01);
                let delta = mesh.take_delta();
                adopt(&mut body, &mut state, &mesh, &delta, |_| Momentum::default());
                let crumbs = &body.implicit.newton.crumbs;
                let mut found = crumbs.all().to_vec();
                found.sort();
                prop_assert_eq!(&found, &by_looking_at_all(&mesh, slots));
                for node in mesh.nodes() {
                    prop_assert_eq!(crumbs.contains(node.index()), found.iter().any(|c| c.contains(&node.0)));
                }
            }
        }
    }
}
