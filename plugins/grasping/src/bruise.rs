//! Pads that press too hard bruise what is between them.

use crate::pads::CELLS;
use keyhole_tetmesh::{NodeEdit, TopologyDelta};
use keyhole_whiteboard::{Bruises, JawPads, TissuePoint};

/// Area of one cell of a pad, m2.
#[must_use]
pub fn cell_area_m2(pads: &JawPads) -> f32 {
    2.0 * (2.0 * pads.half_width_m) * (pads.to_m - pads.from_m) / CELLS as f32
}

/// How badly a pressure bruises tissue that bears `limit_pa`: 0 up to the limit, 1 from its double on.
#[must_use]
pub fn severity(pressure_pa: f32, limit_pa: f32) -> f32 {
    (pressure_pa / limit_pa - 1.0).clamp(0.0, 1.0)
}

/// Whether [`mark`] would change anything.
#[must_use]
pub fn worsens(bruises: &Bruises, point: &TissuePoint, severity: f32) -> bool {
    let most = point.iter().map(|(_, w)| *w).fold(0.0, f32::max);
    point.iter().any(|(n, w)| bruises.by_node.get(n.index()).copied().unwrap_or(0.0) * most < severity * w)
}

/// Marks the nodes around a point of tissue, the nearer the more.
pub fn mark(bruises: &mut Bruises, point: &TissuePoint, severity: f32) {
    let most = point.iter().map(|(_, w)| *w).fold(0.0, f32::max);
    for (node, weight) in point.iter().filter(|_| most > 0.0) {
        if bruises.by_node.len() <= node.index() {
            bruises.by_node.resize(node.index() + 1, 0.0);
        }
        let here = &mut bruises.by_node[node.index()];
        *here = here.max(severity * weight / most);
    }
}

/// Bruises go with the tissue: nodes that a change of topology made are bruised as what they were made of, and those that are gone are not.
pub fn follow(bruises: &mut Bruises, delta: &TopologyDelta) {
    let was = |bruises: &Bruises, n: keyhole_tetmesh::NodeId| bruises.by_node.get(n.index()).copied().unwrap_or(0.0);
    for edit in &delta.nodes {
        let (node, value) = match edit {
            NodeEdit::Added { node, from } | NodeEdit::Moved { node, from } => {
                (*node, from.iter().map(|(n, w)| was(bruises, *n) * *w as f32).sum::<f32>().clamp(0.0, 1.0))
            }
            NodeEdit::Split { node, of } => (*node, was(bruises, *of)),
            NodeEdit::Removed { node } => (*node, 0.0),
        };
        if value > 0.0 && bruises.by_node.len() <= node.index() {
            bruises.by_node.resize(node.index() + 1, 0.0);
        }
        if let Some(here) = bruises.by_node.get_mut(node.index()) {
            *here = value;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use keyhole_tetmesh::{NodeId, NodeWeights};

    #[test]
    fn a_bruise_is_worst_where_the_pad_is_and_goes_with_a_cut() {
        let mut bruises = Bruises::default();
        let at = |weights: [f32; 3]| weights.into_iter().enumerate().map(|(n, w)| (NodeId(n as u32), w)).collect::<TissuePoint>();
        mark(&mut bruises, &at([0.5, 0.25, 0.25]), severity(30e3, 20e3));
        mark(&mut bruises, &at([0.5, 0.5, 0.0]), severity(25e3, 20e3));
        assert_eq!(bruises.by_node, [0.5, 0.25, 0.25]);
        let from: NodeWeights = [(NodeId(0), 0.5), (NodeId(1), 0.5)].into_iter().collect();
        let nodes = vec![
            NodeEdit::Added { node: NodeId(5), from },
            NodeEdit::Split { node: NodeId(3), of: NodeId(0) },
            NodeEdit::Removed { node: NodeId(2) },
        ];
        follow(&mut bruises, &TopologyDelta { nodes, ..Default::default() });
        assert_eq!(bruises.by_node, [0.5, 0.25, 0.0, 0.5, 0.0, 0.375]);
    }

    #[test]
    fn what_tissue_bears_leaves_no_mark() {
        assert_eq!([10e3, 20e3, 30e3, 40e3, 90e3].map(|p| severity(p, 20e3)), [0.0, 0.0, 0.5, 1.0, 1.0]);
    }
}
