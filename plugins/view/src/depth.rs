//! How deep under the skin an opened surface is, for its colour: a section through an organ is paler under the skin than in its depth, and
//! that is what tells a section from a skin.

use crate::fairing::Fairing;
use bevy::math::DVec3;
use keyhole_tetmesh::NodeId;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Distances from the rim along the edges of an opened surface, in the rest shape, by node.
#[derive(Clone, Debug, Default)]
pub struct Depths(Vec<(NodeId, f32)>);

impl Depths {
    /// The distances of all nodes (Dijkstra 1959). A node that no rim leads to is as deep as can be.
    #[must_use]
    pub fn of(surface: &Fairing, rest: impl Fn(NodeId) -> DVec3) -> Self {
        let nodes = surface.nodes();
        let mut depths = vec![f32::INFINITY; nodes.len()];
        // Distances are not negative, so their bits are in the order of their values.
        let mut open = BinaryHeap::new();
        for i in (0..nodes.len()).filter(|i| surface.is_rim(*i)) {
            depths[i] = 0.0;
            open.push(Reverse((0_u32, i)));
        }
        while let Some(Reverse((bits, i))) = open.pop() {
            let depth = f32::from_bits(bits);
            if depth > depths[i] {
                continue;
            }
            for &j in surface.around(i) {
                let j = j as usize;
                let further = depth + rest(nodes[i]).distance(rest(nodes[j])) as f32;
                if further < depths[j] {
                    depths[j] = further;
                    open.push(Reverse((further.to_bits(), j)));
                }
            }
        }
        Self(nodes.iter().copied().zip(depths).collect())
    }

    /// The depth of a node, m; infinite for one that is not of the surface.
    #[must_use]
    pub fn at(&self, node: NodeId) -> f32 {
        self.0.binary_search_by_key(&node, |(n, _)| *n).map_or(f32::INFINITY, |i| self.0[i].1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::outer::OuterPlanes;
    use crate::sheet::{Side, Surface};
    use crate::testing::{block, parted};

    /// In a flat cut through a block the depth is that under the nearest side, give or take the detours along edges.
    #[test]
    fn depth_is_the_distance_from_the_skin() {
        let edge = 0.004;
        let mut mesh = block([4, 8, 6], edge);
        let planes = OuterPlanes::of(&mesh);
        let mut surface = Surface::of(&mesh, &planes);
        let pairs = parted(&mut mesh, DVec3::new(2.0, 4.0, 3.0) * edge, DVec3::X);
        let delta = mesh.take_delta();
        surface.apply(&mesh, &planes, &delta);
        let depths = Depths::of(&Fairing::of(surface.sheet(Side::Inside), surface.sheet(Side::Skin)), |n| mesh.rest(n));
        assert_eq!(pairs.len(), 9 * 7);
        for node in pairs.into_iter().flat_map(|(a, b)| [a, b]) {
            let p = mesh.rest(node);
            let under = p.y.min(8.0 * edge - p.y).min(p.z).min(6.0 * edge - p.z);
            assert!((f64::from(depths.at(node)) - under).abs() < 1e-6 * edge, "{p}: {} under the skin", depths.at(node));
        }
        assert_eq!(depths.at(NodeId(0)), f32::INFINITY);
    }
}
