//! Fresh cuts: the two faces of a cut start in contact, and rounding puts each a little into the other. A pair of nodes that a cut has split does not
//! collide with what is around the other one until the two have parted; then they collide like any other.

use bevy_ecs::prelude::Entity;
use keyhole_tetmesh::{NodeEdit, NodeId, TopologyDelta};

/// How far the nodes of a pair are from each other when they have parted, as a part of the mean length of the edges at them.
pub const PARTED: f32 = 0.1;

/// A node of an organ.
pub type NodeOf = (Entity, NodeId);

/// Pairs of nodes that a cut split and that have not parted.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FreshCuts {
    /// Both ways round, sorted.
    pairs: Vec<[NodeOf; 2]>,
}

impl FreshCuts {
    /// Takes over what a cut did to an organ.
    pub fn adopt(&mut self, organ: Entity, delta: &TopologyDelta) {
        for edit in &delta.nodes {
            match edit {
                NodeEdit::Split { node, of } => {
                    let (node, of) = ((organ, *node), (organ, *of));
                    self.forget(node);
                    let others: Vec<NodeOf> = self.partners(of).chain([of]).collect();
                    self.pairs.extend(others.into_iter().flat_map(|other| [[node, other], [other, node]]));
                    self.pairs.sort_unstable();
                }
                NodeEdit::Added { node, .. } | NodeEdit::Removed { node } => self.forget((organ, *node)),
                NodeEdit::Moved { .. } => {}
            }
        }
    }

    /// The nodes `donor_nodes` of an organ, ascending, have become those of a fragment, in this order.
    pub fn move_to_fragment(&mut self, donor: Entity, fragment: Entity, donor_nodes: &[NodeId]) {
        for node in self.pairs.iter_mut().flatten().filter(|(organ, _)| *organ == donor) {
            if let Ok(i) = donor_nodes.binary_search(&node.1) {
                *node = (fragment, NodeId(i as u32));
            }
        }
        self.pairs.sort_unstable();
    }

    /// The nodes that were split from this one and have not parted from it.
    pub fn partners(&self, node: NodeOf) -> impl Iterator<Item = NodeOf> + '_ {
        let from = self.pairs.partition_point(|[a, _]| *a < node);
        self.pairs[from..].iter().take_while(move |[a, _]| *a == node).map(|[_, b]| *b)
    }

    /// Whether there is no pair.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.pairs.is_empty()
    }

    /// Lets the pairs go that have parted. `parted` is asked for each pair once, in ascending order.
    pub fn part(&mut self, mut parted: impl FnMut(NodeOf, NodeOf) -> bool) {
        let gone: Vec<[NodeOf; 2]> = self.pairs.iter().copied().filter(|[a, b]| a < b && parted(*a, *b)).collect();
        self.pairs.retain(|[a, b]| gone.binary_search(&[*a.min(b), *a.max(b)]).is_err());
    }

    fn forget(&mut self, node: NodeOf) {
        self.pairs.retain(|pair| !pair.contains(&node));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy_ecs::world::World;
    use std::collections::BTreeSet;

    #[test]
    fn pairs_of_a_cut_follow_a_fragment_and_part() {
        let mut world = World::new();
        let (organ, fragment) = (world.spawn_empty().id(), world.spawn_empty().id());
        let mut fresh = FreshCuts::default();
        let split = |node, of| NodeEdit::Split { node: NodeId(node), of: NodeId(of) };
        fresh.adopt(organ, &TopologyDelta { nodes: vec![split(8, 1), split(9, 1), split(7, 2)], ..Default::default() });
        // Which of two entities comes first is their own affair.
        let of = |fresh: &FreshCuts, organ, n| fresh.partners((organ, NodeId(n))).map(|(e, n)| (e == fragment, n)).collect::<BTreeSet<_>>();
        assert_eq!(
            of(&fresh, organ, 8),
            BTreeSet::from([(false, NodeId(1)), (false, NodeId(9))]),
            "each of three sides knows the other two"
        );
        fresh.move_to_fragment(organ, fragment, &[NodeId(3), NodeId(7), NodeId(8)]);
        assert_eq!(of(&fresh, fragment, 1), BTreeSet::from([(false, NodeId(2))]));
        assert_eq!(of(&fresh, organ, 9), BTreeSet::from([(false, NodeId(1)), (true, NodeId(2))]));
        fresh.adopt(organ, &TopologyDelta { nodes: vec![NodeEdit::Removed { node: NodeId(9) }], ..Default::default() });
        assert_eq!(of(&fresh, fragment, 2), BTreeSet::from([(false, NodeId(1))]));
        fresh.part(|a, b| (a, b) == ((organ, NodeId(1)), (fragment, NodeId(2))).min(((fragment, NodeId(2)), (organ, NodeId(1)))));
        assert!(of(&fresh, organ, 1).is_empty() && !fresh.is_empty());
    }
}
