//! Attachments: points of tissue held to space, to a tool or to other tissue by a compliance.

use bevy_ecs::prelude::*;
use bevy_math::Vec3;
use keyhole_tetmesh::{NodeEdit, NodeId, TetMesh, TopologyDelta};
use smallvec::{SmallVec, smallvec};

/// A point of tissue: nodes and weights that sum to one. Of a tie ([`Attachment::tie`]) the difference of two: the weights sum to zero.
pub type TissuePoint = SmallVec<[(NodeId, f32); 4]>;

/// What an attachment holds its point to.
#[derive(Clone, Debug, PartialEq)]
pub enum Anchor {
    /// A point of the world, m.
    Space(Vec3),
    /// A point in the frame of an instrument, m.
    Tool {
        /// The instrument.
        instrument: Entity,
        /// In its frame.
        local: Vec3,
    },
}

/// One attachment.
#[derive(Clone, Debug, PartialEq)]
pub struct Attachment {
    /// The point of the tissue.
    pub point: TissuePoint,
    /// What holds it.
    pub anchor: Anchor,
    /// m/N; zero holds rigidly.
    pub compliance_m_n: f32,
    /// Simulated time at which it lets go, s; infinite: never.
    pub until_s: f64,
}

/// The attachments of an organ. Written by the scene and by gestures; after a topology change by [`Attachments::remap`].
#[derive(Component, Clone, Debug, Default, PartialEq)]
pub struct Attachments(pub Vec<Attachment>);

impl Attachment {
    /// A node held to a point of the world.
    #[must_use]
    pub fn node_to_space(node: NodeId, position: Vec3, compliance_m_n: f32) -> Self {
        Self { point: smallvec![(node, 1.0)], anchor: Anchor::Space(position), compliance_m_n, until_s: f64::INFINITY }
    }

    /// Two points of one organ tied together: `upper` is held at `offset` (m, in the world) from `lower`, by a compliance (m/N) that is not zero. What it
    /// does to the one it does to the other in reverse. `None` where both are the same point. A tie is no anchor: it holds nothing to its place.
    #[must_use]
    pub fn tie(upper: &TissuePoint, lower: &TissuePoint, offset: Vec3, compliance_m_n: f32) -> Option<Self> {
        let mut point = upper.clone();
        for (node, weight) in lower {
            match point.iter_mut().find(|(n, _)| n == node) {
                Some((_, sum)) => *sum -= weight,
                None => point.push((*node, -weight)),
            }
        }
        point.retain(|(_, weight)| *weight != 0.0);
        // Not for ever, as what holds an organ in its place does, but for longer than any session.
        (!point.is_empty()).then_some(Self { point, anchor: Anchor::Space(offset), compliance_m_n, until_s: f64::MAX })
    }

    /// Whether it is a tie of two points of the organ: its weights sum to zero, not to one.
    #[must_use]
    pub fn is_tie(&self) -> bool {
        self.point.len() > 1 && self.point.iter().map(|(_, w)| w).sum::<f32>() < 0.5
    }

    fn names(&self, node: NodeId) -> bool {
        self.point.iter().any(|(n, _)| *n == node)
    }
}

impl Attachments {
    /// Lets go of the attachments whose time has come.
    pub fn expire(&mut self, now_s: f64) {
        self.0.retain(|a| a.until_s > now_s);
    }

    /// Carries the attachments over a topology change: an attachment at a node that was split holds both sides, each at its own node;
    /// one at a removed node goes.
    pub fn remap(&mut self, delta: &TopologyDelta) {
        if self.0.is_empty() {
            return;
        }
        for edit in &delta.nodes {
            match edit {
                NodeEdit::Split { node, of } => {
                    let copies: Vec<Attachment> = self
                        .0
                        .iter()
                        .filter(|a| a.point.len() == 1 && a.names(*of))
                        .map(|a| Attachment { point: smallvec![(*node, 1.0)], ..a.clone() })
                        .collect();
                    self.0.extend(copies);
                }
                NodeEdit::Removed { node } => self.0.retain(|a| !a.names(*node)),
                NodeEdit::Added { .. } | NodeEdit::Moved { .. } => {}
            }
        }
    }

    /// Moves the attachments whose nodes all went to a fragment there. `donor_nodes` is the fragment's node list in the donor's ids.
    #[must_use]
    pub fn split_off(&mut self, donor_nodes: &[NodeId]) -> Self {
        let mut moved = Vec::new();
        self.0.retain(|a| {
            let ids: Option<TissuePoint> =
                a.point.iter().map(|(n, w)| donor_nodes.binary_search(n).ok().map(|i| (NodeId(i as u32), *w))).collect();
            match ids {
                Some(point) if !point.is_empty() => {
                    moved.push(Attachment { point, ..a.clone() });
                    false
                }
                _ => true,
            }
        });
        Self(moved)
    }

    /// Lets go of what holds a piece of this mesh to its place, unless it holds a face of it: tissue grows together over an area, and what a cut has left of that in a point or a line
    /// bears nothing.
    pub fn keep_areas(&mut self, mesh: &TetMesh) {
        let place = |a: &Attachment| match (&a.anchor, a.point.as_slice()) {
            (Anchor::Space(_), [(node, _)]) if a.until_s == f64::INFINITY => Some(*node),
            _ => None,
        };
        let mut held: Vec<NodeId> = self.0.iter().filter_map(place).collect();
        held.sort_unstable();
        held.dedup();
        let is_face = |(_, corners): (_, [NodeId; 4])| corners.iter().filter(|n| held.binary_search(n).is_ok()).count() >= 3;
        if !held.is_empty() && !mesh.iter().any(is_face) {
            self.0.retain(|a| place(a).is_none());
        }
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;

    /// A tetrahedron that is held at two nodes falls, with what else holds it; at three it is held.
    #[test]
    fn a_point_or_a_line_bears_nothing() {
        let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(keyhole_tetmesh::DVec3::from_array);
        let mesh = keyhole_tetmesh::check::checked(&corners, &[[0, 1, 2, 3]], &[keyhole_tetmesh::MaterialId(0)]).unwrap();
        let grip = Attachment { until_s: 1.0, ..Attachment::node_to_space(NodeId(3), Vec3::Y, 1e-3) };
        for count in 1..=3 {
            let places = (0..count).map(|n| Attachment::node_to_space(NodeId(n), Vec3::ZERO, 0.0));
            let all = Attachments(places.chain([grip.clone()]).collect());
            let mut kept = all.clone();
            kept.keep_areas(&mesh);
            assert_eq!(kept, if count == 3 { all } else { Attachments(vec![grip.clone()]) });
        }
    }

    /// Points that share a node: of that the weights are subtracted.
    #[test]
    fn a_tie_is_the_difference_of_two_points() {
        let point = |weights: &[(u32, f32)]| weights.iter().map(|(n, w)| (NodeId(*n), *w)).collect::<TissuePoint>();
        let (upper, lower) = (point(&[(1, 0.25), (2, 0.75)]), point(&[(2, 0.5), (3, 0.5)]));
        let tie = Attachment::tie(&upper, &lower, Vec3::Y, 1e-3).unwrap();
        assert_eq!(tie.point, point(&[(1, 0.25), (2, 0.25), (3, -0.5)]));
        assert!(tie.is_tie() && !Attachment::node_to_space(NodeId(1), Vec3::Y, 0.0).is_tie());
        assert_eq!(Attachment::tie(&upper, &upper, Vec3::Y, 1e-3), None);
        let mut held = Attachments(vec![tie]);
        held.expire(1e9);
        assert_eq!(held.0.len(), 1);
    }
}
