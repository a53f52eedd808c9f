//! The way out of a cavity that a lattice closed: through the wall where it is thinnest.
//!
//! Cavities of a scan hang together with the outside (those that do not were filled before), often through a channel of a voxel or two
//! that falls between the points of the lattice. Opening it again keeps the cavity's walls where they are.

use crate::lattice::{Lattice, Point};
use glam::DVec3;
use rustc_hash::FxHashMap;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Points of a wall that may be opened: a longer passage is no channel that the lattice missed, it is made up.
const LONGEST: u32 = 4;
/// Depth of tissue, in cells, beyond which a point is wall: beside a channel that falls between lattice points there is less.
const DEEPEST: f64 = 0.5;
/// Points of a cavity below which it is filled: the tetrahedra around a single point are as large as what they would leave out.
const SMALLEST: usize = 2;

/// The points of the wall between a cavity and what is `reached`, those with the least tissue around them; `None` when the cavity is too
/// small or the wall too thick. `field` is positive in tissue and about the distance from its surface, in the lattice's unit.
pub(crate) fn through_wall(lattice: &Lattice, void: &[Point], reached: &[bool], field: impl Fn(DVec3) -> f64) -> Option<Vec<Point>> {
    if void.len() < SMALLEST {
        return None;
    }
    // Dijkstra's shortest path. A point costs the least depth of tissue found around it, and something for its length.
    let cost = |p: Point| {
        let at = lattice.position(p);
        let around = lattice.neighbours(p).map(|(n, _)| field(at.lerp(lattice.position(n), 0.3)));
        let least = around.fold(field(at), f64::min);
        // Thousandths of a cell, so that sums do not depend on their order.
        (least < DEEPEST * lattice.a).then(|| ((least.max(0.0) / lattice.a + 0.1) * 1e3) as u64)
    };
    let mut from: FxHashMap<Point, (u64, Point)> = void.iter().map(|p| (*p, (0, *p))).collect();
    let mut heap: BinaryHeap<Reverse<(u64, u32, Point)>> = void.iter().map(|p| Reverse((0, 0, *p))).collect();
    while let Some(Reverse((so_far, steps, p))) = heap.pop() {
        if from[&p].0 < so_far {
            continue;
        }
        if reached[p as usize] {
            let mut path = Vec::new();
            let mut at = from[&p].1;
            while from[&at].1 != at {
                path.push(at);
                at = from[&at].1;
            }
            return Some(path);
        }
        for (n, _) in lattice.neighbours(p) {
            let out = reached[n as usize];
            if !out && steps == LONGEST {
                continue;
            }
            let Some(price) = (if out { Some(0) } else { cost(n) }) else { continue };
            let total = so_far + price;
            if from.get(&n).is_none_or(|(known, _)| total < *known) {
                from.insert(n, (total, p));
                heap.push(Reverse((total, steps + 1, n)));
            }
        }
    }
    None
}
