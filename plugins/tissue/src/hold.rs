//! Attachments with their anchors resolved to the world, for one tick.

use bevy_math::Vec3;
use keyhole_whiteboard::TissuePoint;

/// A point of tissue held to a point of the world that moves evenly during a tick.
#[derive(Clone, Debug, PartialEq)]
pub struct Hold {
    /// The point of the tissue.
    pub point: TissuePoint,
    /// The anchor at the beginning of the tick, m.
    pub from: Vec3,
    /// The anchor at its end, m.
    pub to: Vec3,
    /// m/N; zero at a single node fixes that node to the anchor: infinite mass while it is held.
    pub compliance_m_n: f32,
}

impl Hold {
    /// The node that this hold fixes.
    pub(crate) fn fixes(&self) -> Option<usize> {
        match self.point.as_slice() {
            [(node, _)] if self.compliance_m_n <= 0.0 => Some(node.index()),
            _ => None,
        }
    }
}
