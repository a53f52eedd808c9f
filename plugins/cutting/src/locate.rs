//! Where a point of the world is in the deformed mesh: by walking from where it was, from a node near by, or over a grid of the rest shape.
//! Never by a look at the whole mesh.

use crate::cutter::Cutter;
use bevy_math::{DMat3, Vec3};
use keyhole_tetmesh::{DVec3, NodeId, TetId, TetMesh};

/// Most tetrahedra that a walk goes through before it gives up: a blade's point moves by a quarter of an edge a step.
const LONGEST_WALK: usize = 32;

/// A point of tissue, and the map there.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Anchor {
    pub tet: TetId,
    pub nodes: [NodeId; 4],
    pub weights: [f64; 4],
    /// Its place in the rest shape, m.
    pub rest: DVec3,
    /// From a vector in the world to one in the rest shape.
    pub to_rest: DMat3,
}

/// Where to begin the next search for a point.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Hint {
    pub tet: Option<TetId>,
    pub node: Option<NodeId>,
}

/// What a step of a walk finds.
enum Found {
    Here(Anchor),
    /// Beyond this face.
    Beyond(usize),
    /// The tetrahedron is flat or turned over.
    Nowhere,
}

/// A mesh as the tissue has deformed it.
#[derive(Clone, Copy)]
pub(crate) struct Deformed<'a> {
    pub mesh: &'a TetMesh,
    pub cutter: &'a Cutter,
    pub positions: &'a [Vec3],
}

impl Deformed<'_> {
    /// Where a node is, m.
    fn at(&self, node: NodeId) -> DVec3 {
        self.positions.get(node.index()).map_or(DVec3::NAN, |p| p.as_dvec3())
    }

    /// The point of tissue at `x` (m), if there is any, and where to begin next time.
    pub fn find(&self, x: DVec3, hint: &mut Hint) -> Option<Anchor> {
        let anchor = hint.tet.and_then(|t| self.walk(t, x)).or_else(|| {
            let node = self.nearest_node(x, hint.node)?;
            hint.node = Some(node);
            if self.at(node).distance(x) > 2.0 * self.cutter.longest_edge_m() {
                return None;
            }
            let star = self.mesh.topology().around_node(node);
            star.iter()
                .find_map(|t| self.inside(*t, x))
                .or_else(|| self.walk(*star.first()?, x))
                .or_else(|| self.by_grid(node, *star.first()?, x))
        });
        hint.tet = anchor.map(|a| a.tet);
        hint.node = anchor.map(|a| a.nodes[0]).or(hint.node);
        anchor
    }

    /// Distance from `x` to a node near by, m; infinite when there is none.
    pub fn distance(&self, x: DVec3, hint: &mut Hint) -> f64 {
        hint.node = self.nearest_node(x, hint.node);
        hint.node.map_or(f64::INFINITY, |n| self.at(n).distance(x))
    }

    /// A node that is nearer to `x` than all of its neighbours and than those across a cut, from the better of a start and the nearest landmark.
    fn nearest_node(&self, x: DVec3, start: Option<NodeId>) -> Option<NodeId> {
        let mut best = (f64::INFINITY, NodeId(u32::MAX));
        for node in start.into_iter().chain(self.cutter.landmarks().iter().copied()) {
            let distance = self.at(node).distance_squared(x);
            if distance < best.0 && !self.mesh.topology().around_node(node).is_empty() {
                best = (distance, node);
            }
        }
        if best.0.is_infinite() {
            return None;
        }
        loop {
            let around = self.mesh.topology().around_node(best.1);
            let next = self.nearest_of(x, around.iter().flat_map(|t| self.mesh.corners(*t)));
            match next.filter(|n| n.0 < best.0).or_else(|| self.across(best.1, x).filter(|n| n.0 < best.0)) {
                Some(nearer) => best = nearer,
                None => return Some(best.1),
            }
        }
    }

    /// The nearest of some nodes, with its squared distance from `x`, m2.
    fn nearest_of(&self, x: DVec3, nodes: impl Iterator<Item = NodeId>) -> Option<(f64, NodeId)> {
        let mut best = (f64::INFINITY, NodeId(u32::MAX));
        for node in nodes {
            let distance = self.at(node).distance_squared(x);
            if distance < best.0 || (distance == best.0 && node < best.1) {
                best = (distance, node);
            }
        }
        best.0.is_finite().then_some(best)
    }

    /// The nearest node between a node and `x` in the rest shape, where no cut stands in the way; of each tetrahedron there one node is looked
    /// at, for the search goes on from it.
    fn across(&self, node: NodeId, x: DVec3) -> Option<(f64, NodeId)> {
        let from = self.mesh.rest(node);
        let offset = self.map_of(*self.mesh.topology().around_node(node).first()?)? * (x - self.at(node));
        let parts = (offset.length() / self.cutter.mean_edge_m()).ceil().clamp(1.0, LONGEST_WALK as f64) as usize;
        let places = (1..=parts).map(|i| from + offset * (i as f64 / parts as f64));
        self.nearest_of(x, places.flat_map(|p| self.cutter.tets_near(p)).map(|t| self.mesh.corners(t)[0]))
    }

    fn walk(&self, start: TetId, x: DVec3) -> Option<Anchor> {
        let mut tet = start;
        for _ in 0..LONGEST_WALK {
            if !self.mesh.contains(tet) {
                return None;
            }
            match self.look(tet, x) {
                Found::Here(anchor) => return Some(anchor),
                Found::Beyond(face) => tet = self.mesh.topology().neighbour(tet, face)?,
                Found::Nowhere => return None,
            }
        }
        None
    }

    /// Looks where the rest shape has its tetrahedra around the place that `x` would have there if it moved with the tetrahedron `from`.
    fn by_grid(&self, node: NodeId, from: TetId, x: DVec3) -> Option<Anchor> {
        let offset = self.map_of(from)? * (x - self.at(node));
        self.cutter.tets_near(self.mesh.rest(node) + offset).find_map(|t| self.inside(t, x))
    }

    fn inside(&self, tet: TetId, x: DVec3) -> Option<Anchor> {
        let p = self.mesh.corners(tet).map(|n| self.at(n));
        let (low, high) = (p[0].min(p[1]).min(p[2]).min(p[3]), p[0].max(p[1]).max(p[2]).max(p[3]));
        if !(low.cmple(x).all() && x.cmple(high).all()) {
            return None;
        }
        match self.look(tet, x) {
            Found::Here(anchor) => Some(anchor),
            Found::Beyond(_) | Found::Nowhere => None,
        }
    }

    fn map_of(&self, tet: TetId) -> Option<DMat3> {
        let [a, b, c, d] = self.mesh.corners(tet).map(|n| self.at(n));
        let deformed = DMat3::from_cols(b - a, c - a, d - a);
        let [ra, rb, rc, rd] = self.mesh.points(tet);
        (deformed.determinant() > 0.0).then(|| DMat3::from_cols(rb - ra, rc - ra, rd - ra) * deformed.inverse())
    }

    fn look(&self, tet: TetId, x: DVec3) -> Found {
        let nodes = self.mesh.corners(tet);
        let [a, b, c, d] = nodes.map(|n| self.at(n));
        let deformed = DMat3::from_cols(b - a, c - a, d - a);
        if deformed.determinant().is_nan() || deformed.determinant() <= 0.0 {
            return Found::Nowhere;
        }
        let inverse = deformed.inverse();
        let w = inverse * (x - a);
        let weights = [1.0 - w.element_sum(), w.x, w.y, w.z];
        let (face, least) = weights.iter().copied().enumerate().fold((0, f64::INFINITY), |m, (i, w)| if w < m.1 { (i, w) } else { m });
        if least < 0.0 {
            return Found::Beyond(face);
        }
        let [ra, rb, rc, rd] = self.mesh.points(tet);
        let to_rest = DMat3::from_cols(rb - ra, rc - ra, rd - ra) * inverse;
        Found::Here(Anchor { tet, nodes, weights, rest: ra + to_rest * (x - a), to_rest })
    }
}
