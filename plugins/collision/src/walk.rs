//! Walks through a body along a straight line, from tetrahedron to tetrahedron, to where the line leaves it.
//!
//! The line's first way out is found without any search, and is the right one also where a body overlaps itself: neighbours are neighbours in the
//! mesh, not in space.

use crate::inside::Weights;
use bevy_math::{Vec3, Vec3A};
use keyhole_tetmesh::{TetId, Topology};

/// A mesh in its deformed shape.
#[derive(Clone, Copy, Debug)]
pub struct Deformed<'a> {
    /// Its adjacency.
    pub topology: &'a Topology,
    /// Deformed positions by node slot, m.
    pub positions: &'a [Vec3],
}

/// Where a line leaves a body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exit {
    /// The part of the line that is inside, 0 to 1.
    pub part: f32,
    /// The point of the surface, m.
    pub point: Vec3,
    /// Unit normal of the surface there, outward.
    pub normal: Vec3,
}

/// Tetrahedra of a walk through a mesh of one, and how many times the number along its edge they may be: what cuts have left thin is small.
const SHORT: usize = 64;
const LONG: usize = 32;

impl Deformed<'_> {
    /// Most tetrahedra of a walk: one that does not turn goes straight through the mesh, one among inverted tetrahedra may go round for ever.
    fn longest(&self) -> usize {
        SHORT + LONG * (self.topology.len() as f64).cbrt() as usize
    }

    /// Where the line from a point in the tetrahedron `tet` to another point leaves the body first. `None` where it ends inside, or where the walk
    /// comes to a tetrahedron that is flat or goes round in inverted ones.
    #[must_use]
    pub fn exit(&self, tet: TetId, from: Vec3, to: Vec3) -> Option<Exit> {
        let (from, to) = (Vec3A::from(from), Vec3A::from(to));
        let (mut tet, mut came_from) = (tet, None);
        for _ in 0..self.longest() {
            let corners = self.topology.corners(tet);
            let weights = Weights::of(corners.map(|n| self.positions[n.index()].into()))?;
            let (begin, end) = (weights.at(from), weights.at(to));
            let mut first: Option<(f32, usize)> = None;
            for face in 0..4 {
                let fall = begin[face] - end[face];
                let part = begin[face] / fall;
                let entered = came_from.is_some() && self.topology.neighbour(tet, face) == came_from;
                if fall > 0.0 && !entered && first.is_none_or(|(least, _)| part < least) {
                    first = Some((part, face));
                }
            }
            let (part, face) = first.filter(|(part, _)| *part <= 1.0)?;
            let Some(next) = self.topology.neighbour(tet, face) else {
                let part = part.max(0.0);
                let normal = Vec3::from(-weights.gradient(face)).try_normalize()?;
                return Some(Exit { part, point: from.lerp(to, part).into(), normal });
            };
            (tet, came_from) = (next, Some(tet));
        }
        None
    }
}
