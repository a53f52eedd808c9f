//! Attachments: points of tissue held to space, to a tool or to other tissue by a compliance.

use bevy_ecs::prelude::*;
use bevy_math::Vec3;
use keyhole_tetmesh::{NodeEdit, NodeId, TopologyDelta};
use smallvec::{SmallVec, smallvec};

/// A point of tissue: nodes and weights that sum to one.
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
}
