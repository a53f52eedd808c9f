//! Where a place of the world is in tissue, and how much tissue is ahead of it.

use bevy_ecs::prelude::Entity;
use bevy_math::{DVec3, Vec3};
use keyhole_tetmesh::{NodeId, TetId, TetMesh};
use keyhole_whiteboard::TissuePoint;

/// An organ as it is now.
#[derive(Clone, Copy, Debug)]
pub struct Tissue<'a> {
    /// The organ.
    pub organ: Entity,
    /// Its mesh.
    pub mesh: &'a TetMesh,
    /// Where its nodes are, by slot, m.
    pub positions: &'a [Vec3],
    /// Force per length of tissue ahead at which a bite tears out, N/m.
    pub tear_n_m: f32,
}

impl Tissue<'_> {
    /// Where a point of it is, m.
    #[must_use]
    pub fn place(&self, point: &TissuePoint) -> DVec3 {
        point.iter().map(|(n, w)| self.positions[n.index()].as_dvec3() * f64::from(*w)).sum()
    }

    /// The same in the rest shape, m.
    #[must_use]
    pub fn rest(&self, point: &TissuePoint) -> DVec3 {
        point.iter().map(|(n, w)| self.mesh.rest(*n) * f64::from(*w)).sum()
    }

    /// The tetrahedra that a box may touch, into `found`.
    pub fn near(&self, low: DVec3, high: DVec3, found: &mut Vec<TetId>) {
        found.clear();
        found.extend(self.mesh.iter().filter_map(|(tet, corners)| {
            let at = self.corners(corners);
            let least = at.into_iter().fold(DVec3::INFINITY, DVec3::min);
            let most = at.into_iter().fold(DVec3::NEG_INFINITY, DVec3::max);
            (least.cmple(high).all() && most.cmpge(low).all()).then_some(tet)
        }));
    }

    /// The point of the tissue that is at a place (m): that of the first of some tetrahedra that has it.
    #[must_use]
    pub fn at(&self, place: DVec3, among: &[TetId]) -> Option<TissuePoint> {
        among.iter().find_map(|tet| {
            let corners = self.mesh.corners(*tet);
            let weights = weights(self.corners(corners), place)?;
            weights.iter().all(|w| *w >= 0.0).then(|| corners.into_iter().zip(weights.map(|w| w as f32)).collect())
        })
    }

    /// The point of the tissue whose rest is there (m), wherever the tissue is now.
    #[must_use]
    pub fn at_rest(&self, rest: DVec3) -> Option<TissuePoint> {
        self.mesh.iter().find_map(|(tet, corners)| {
            let weights = weights(self.mesh.points(tet), rest)?;
            weights.iter().all(|w| *w >= 0.0).then(|| corners.into_iter().zip(weights.map(|w| w as f32)).collect())
        })
    }

    /// The tetrahedron whose corners a point's nodes are; none once a cut has gone between them.
    #[must_use]
    pub fn tet_of(&self, point: &TissuePoint) -> Option<TetId> {
        let (first, _) = point.first()?;
        if !self.mesh.contains_node(*first) {
            return None;
        }
        let around = self.mesh.topology().around_node(*first);
        around.iter().copied().find(|t| point.iter().all(|(n, _)| self.mesh.corners(*t).contains(n)))
    }

    /// How far the tissue goes on from a point of it in a direction (a unit vector), m: the way through tetrahedra until the first face that has no other side.
    #[must_use]
    pub fn depth(&self, point: &TissuePoint, direction: DVec3) -> Option<f64> {
        let from = self.place(point);
        let (mut tet, mut gone, mut came) = (self.tet_of(point)?, 0.0, None);
        for _ in 0..self.mesh.tet_count() {
            let at = self.corners(self.mesh.corners(tet));
            let Some(here) = weights(at, from) else { return Some(gone) };
            // Weights are linear in the place.
            let Some(there) = weights(at, from + direction) else { return Some(gone) };
            let leaves = (0..4).filter(|f| Some(*f) != came && there[*f] < here[*f]).map(|f| (f, here[f] / (here[f] - there[f])));
            let Some((face, way)) = leaves.min_by(|a, b| a.1.total_cmp(&b.1)) else { return Some(gone) };
            gone = way.max(gone);
            let Some(next) = self.mesh.topology().neighbour(tet, face) else { return Some(gone) };
            came = (0..4).find(|f| self.mesh.topology().neighbour(next, *f) == Some(tet));
            tet = next;
        }
        Some(gone)
    }

    fn corners(&self, corners: [NodeId; 4]) -> [DVec3; 4] {
        corners.map(|n| self.positions[n.index()].as_dvec3())
    }
}

/// Barycentric coordinates in a tetrahedron; `None` where it is flat or inverted.
fn weights([a, b, c, d]: [DVec3; 4], p: DVec3) -> Option<[f64; 4]> {
    let volume = |a: DVec3, b: DVec3, c: DVec3, d: DVec3| (b - a).dot((c - a).cross(d - a));
    let whole = volume(a, b, c, d);
    (whole > 0.0).then(|| [volume(p, b, c, d), volume(a, p, c, d), volume(a, b, p, d), volume(a, b, c, p)].map(|v| v / whole))
}
