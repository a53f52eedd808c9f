//! What a stay does, as functions over plain data: no app, no query, no command.

use bevy_math::{DVec3, Vec3};
use keyhole_tetmesh::TetMesh;
use keyhole_whiteboard::TissuePoint;

/// A point of tissue held to a point of space.
#[derive(Clone, Debug, PartialEq)]
pub struct Stay {
    /// The point of the tissue.
    pub point: TissuePoint,
    /// Where it is held, m.
    pub place: Vec3,
    /// Force on the tissue, N.
    pub force_n: Vec3,
}

/// Where a point of tissue is, m; `positions` are by node slot.
pub fn position(point: &TissuePoint, positions: &[Vec3]) -> Vec3 {
    point.iter().map(|(node, weight)| positions[node.index()] * *weight).sum()
}

/// The point of the deformed tissue that is at a place (m), if it is inside.
pub fn tissue_at(mesh: &TetMesh, positions: &[Vec3], place: Vec3) -> Option<TissuePoint> {
    mesh.iter().find_map(|(_, corners)| {
        let [a, b, c, d] = corners.map(|node| positions[node.index()].as_dvec3());
        let p = place.as_dvec3();
        let volume = |a: DVec3, b: DVec3, c: DVec3, d: DVec3| (b - a).dot((c - a).cross(d - a));
        let whole = volume(a, b, c, d);
        let parts = [volume(p, b, c, d), volume(a, p, c, d), volume(a, b, p, d), volume(a, b, c, p)];
        let inside = whole > 0.0 && parts.iter().all(|part| *part >= 0.0);
        inside.then(|| corners.into_iter().zip(parts.map(|part| (part / whole) as f32)).collect())
    })
}

impl Stay {
    /// Reads the force with which it holds the tissue now; whether it holds on: not beyond its strength (N), and not where a cut has taken its tissue away.
    pub fn holds(&mut self, mesh: &TetMesh, positions: &[Vec3], compliance_m_n: f32, strength_n: f32) -> bool {
        let whole = self.point.first().is_some_and(|(first, _)| {
            let has_all = |corners: [_; 4]| self.point.iter().all(|(node, _)| corners.contains(node));
            mesh.contains_node(*first) && mesh.topology().around_node(*first).iter().any(|tet| has_all(mesh.corners(*tet)))
        });
        if !whole {
            return false;
        }
        self.force_n = (self.place - position(&self.point, positions)) / compliance_m_n;
        self.force_n.length() <= strength_n
    }
}
