//! Shapes of the tetrahedra along a cut, kept up to date by what each sample changed: a look at them costs no pass over the mesh.

use keyhole_cutting::{BatchCut, Moved};
use keyhole_tetmesh::quality::{dihedral_angles, edge_ratio, min_altitude};
use keyhole_tetmesh::{DVec3, TetId};

/// The figures of one tetrahedron.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Shape {
    edge_ratio: f64,
    min_dihedral: f64,
    altitude: f64,
}

impl Shape {
    fn of(p: [DVec3; 4]) -> Self {
        let min_dihedral = dihedral_angles(p).into_iter().fold(f64::INFINITY, f64::min);
        Self { edge_ratio: edge_ratio(p), min_dihedral, altitude: min_altitude(p) }
    }
}

/// Statistics of the tetrahedra along the cut at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Along {
    /// How many.
    pub tets: usize,
    /// Mean of shortest / longest edge.
    pub mean_edge_ratio: f64,
    /// Smallest of shortest / longest edge.
    pub min_edge_ratio: f64,
    /// Smallest dihedral angle, degrees.
    pub min_dihedral_deg: f64,
    /// First percentile of each tetrahedron's smallest dihedral angle, degrees.
    pub p1_dihedral_deg: f64,
    /// Smallest altitude, m.
    pub min_altitude_m: f64,
}

/// Shapes by slot; those that have changed are computed when they are looked at.
#[derive(Clone, Debug, Default)]
pub struct Shapes {
    known: Vec<Option<Shape>>,
}

impl Shapes {
    /// Forgets what a sample changed.
    pub fn forget(&mut self, cut: &BatchCut, moved: &Moved) {
        self.known.resize(cut.mesh.tet_slots(), None);
        let added = moved.delta.added.iter().map(|a| a.tet);
        for tet in added.chain(moved.delta.reshaped(cut.mesh.topology())) {
            self.known[tet.index()] = None;
        }
    }

    /// The tetrahedra along the cut, ascending.
    #[must_use]
    pub fn along(cut: &BatchCut) -> Vec<TetId> {
        cut.mesh.iter().map(|(t, _)| t).filter(|t| cut.is_along(*t)).collect()
    }

    /// Statistics of some tetrahedra; `None` of none.
    pub fn of(&mut self, cut: &BatchCut, tets: &[TetId]) -> Option<Along> {
        self.known.resize(cut.mesh.tet_slots(), None);
        let mut angles = Vec::with_capacity(tets.len());
        let (mut sum, mut ratio, mut altitude) = (0.0, f64::INFINITY, f64::INFINITY);
        for tet in tets {
            let shape = *self.known[tet.index()].get_or_insert_with(|| Shape::of(cut.mesh.points(*tet)));
            angles.push(shape.min_dihedral);
            sum += shape.edge_ratio;
            ratio = ratio.min(shape.edge_ratio);
            altitude = altitude.min(shape.altitude);
        }
        angles.sort_unstable_by(f64::total_cmp);
        Some(Along {
            tets: tets.len(),
            mean_edge_ratio: sum / tets.len() as f64,
            min_edge_ratio: ratio,
            min_dihedral_deg: angles.first()?.to_degrees(),
            p1_dihedral_deg: angles[angles.len() / 100].to_degrees(),
            min_altitude_m: altitude,
        })
    }
}

/// The value below which a part of the values lies, by nearest rank; 0 without values. Sorts them.
pub(crate) fn percentile(values: &mut [u64], part: f64) -> u64 {
    values.sort_unstable();
    let rank = (part * values.len() as f64).ceil().max(1.0) as usize;
    values.get(rank - 1).or(values.last()).copied().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::study::strokes::{Stage, Stroke};
    use keyhole_tetmesh::TetMesh;
    use keyhole_whiteboard::CutSettings;

    #[test]
    fn percentiles_are_by_nearest_rank() {
        let mut values: Vec<u64> = (1..=100).rev().collect();
        assert_eq!([0.0, 0.5, 0.99, 1.0].map(|p| percentile(&mut values, p)), [1, 50, 99, 100]);
        assert_eq!(percentile(&mut [], 0.5), 0);
    }

    #[test]
    fn a_regular_tetrahedron_has_its_closed_forms() {
        let h = 0.5_f64.sqrt() / 2.0;
        let p = [DVec3::new(h, h, h), DVec3::new(-h, h, -h), DVec3::new(h, -h, -h), DVec3::new(-h, -h, h)];
        let shape = Shape::of(p);
        assert!((shape.edge_ratio - 1.0).abs() < 1e-12);
        assert!((shape.min_dihedral - (1.0_f64 / 3.0).acos()).abs() < 1e-12);
        assert!((shape.altitude - (2.0_f64 / 3.0).sqrt()).abs() < 1e-12);
    }

    #[test]
    fn what_is_remembered_is_what_a_pass_over_the_mesh_gives() {
        let mesh: TetMesh = crate::study::plan::tests::ball(6);
        let path = Stage::of(&mesh, 1).path(Stroke::Straight, 0.05);
        let mut cut = BatchCut::new(mesh, CutSettings::default());
        let mut shapes = Shapes::default();
        let mut compared = 0;
        for sample in path {
            let moved = cut.step(sample);
            shapes.forget(&cut, &moved);
            let tets = Shapes::along(&cut);
            let Some(along) = shapes.of(&cut, &tets) else { continue };
            let quality = cut.quality_along();
            assert_eq!(along.min_dihedral_deg, quality.min_dihedral_deg);
            assert_eq!(along.p1_dihedral_deg, quality.p1_dihedral_deg);
            assert!((along.mean_edge_ratio - quality.mean_edge_ratio).abs() < 1e-12);
            compared += 1;
        }
        assert!(compared > 10);
    }
}
