//! A blade's recorded path cut through a mesh in its rest shape.
//!
//! [`BatchCut::step`] moves the blade and costs what the cut costs. [`BatchCut::sample`] also looks at the whole mesh for a row of figures.

use crate::blade::BladeSample;
use crate::course::BladeId;
use crate::cutter::{Cutter, Operations, StepReport};
use crate::fragment::{Fragment, detach};
use keyhole_tetmesh::components::Components;
use keyhole_tetmesh::quality::{Quality, of_tets};
use keyhole_tetmesh::{DVec3, NodeEdit, NodeId, TetId, TetMesh, TopologyDelta};
use keyhole_whiteboard::CutSettings;
use serde::Serialize;
use std::time::{Duration, Instant};

/// One row of `steps.csv`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct BatchRow {
    /// Index of the blade sample.
    pub step: usize,
    /// Its time, s.
    pub t_s: f64,
    /// Tetrahedra.
    pub tets: usize,
    /// Nodes.
    pub nodes: usize,
    /// Face-connected components.
    pub fragments: usize,
    /// Tetrahedra removed by this sample.
    pub deleted: u64,
    /// Tetrahedra created by this sample.
    pub created: u64,
    /// Children changed in place by this sample.
    pub updated: u64,
    /// Mean edge ratio of the tetrahedra along the cut so far.
    pub mean_edge_ratio: f64,
    /// The smallest.
    pub min_edge_ratio: f64,
    /// Smallest dihedral angle along the cut so far, degrees.
    pub min_dihedral_deg: f64,
    /// Area swept inside the tissue so far, mm2.
    pub swept_area_mm2: f64,
    /// Area opened so far, one side, mm2.
    pub opened_area_mm2: f64,
    /// Distance from where the blade goes through the surface to the nearest point of the wound there, mm.
    pub lag_mm: f64,
    /// Wall-clock time from the sample to the new topology, microseconds.
    pub elapsed_us: u64,
}

/// What a sample did to the mesh.
#[derive(Clone, Debug, Default)]
pub struct Moved {
    /// Operations on tetrahedra.
    pub operations: Operations,
    /// Area that the blade swept inside the tissue, m2.
    pub swept_m2: f64,
    /// Wall-clock time from the sample to the new topology.
    pub elapsed: Duration,
    /// What changed.
    pub delta: TopologyDelta,
}

/// A mesh being cut along a path.
#[derive(Debug)]
pub struct BatchCut {
    /// The mesh.
    pub mesh: TetMesh,
    cutter: Cutter,
    last: Option<BladeSample>,
    row: BatchRow,
    /// Original tetrahedra that the cut has changed: their parts are the tetrahedra along the cut.
    along: Vec<bool>,
    entered: Option<[DVec3; 2]>,
}

impl BatchCut {
    /// Starts on a mesh.
    #[must_use]
    pub fn new(mesh: TetMesh, settings: CutSettings) -> Self {
        let mut cutter = Cutter::new(&mesh);
        cutter.set_settings(settings);
        let sources = mesh.iter().map(|(t, _)| mesh.tet(t).source as usize + 1).max().unwrap_or(0);
        Self { mesh, cutter, last: None, row: BatchRow::default(), along: vec![false; sources], entered: None }
    }

    /// Whether a later sample may still change this tetrahedron.
    #[must_use]
    pub fn is_temporary(&self, tet: TetId) -> bool {
        self.cutter.is_temporary(tet)
    }

    /// Whether the cut has changed the original tetrahedron that this one is a part of: split it, or moved one of its nodes.
    #[must_use]
    pub fn is_along(&self, tet: TetId) -> bool {
        self.along[self.mesh.tet(tet).source as usize]
    }

    /// Mean edge length of the mesh as it was, m.
    #[must_use]
    pub fn mean_edge_m(&self) -> f64 {
        self.cutter.mean_edge_m()
    }

    /// Area opened so far, one side, m2.
    #[must_use]
    pub fn opened_m2(&self) -> f64 {
        self.cutter.opened_m2(&self.mesh)
    }

    /// Points where the blade goes through the outer surface, rest shape, m.
    #[must_use]
    pub fn surface_points(&self) -> Vec<DVec3> {
        self.cutter.surface_points(&self.mesh)
    }

    /// Moves the blade to a sample. Two samples that both cut are joined by steps of less than a quarter of an edge; a sample that does not cut
    /// ends the stroke.
    pub fn step(&mut self, sample: BladeSample) -> Moved {
        let start = Instant::now();
        let mut done = StepReport::default();
        match self.last.filter(|l| l.active) {
            Some(last) if sample.active => self.sweep(last, sample, &mut done),
            Some(_) => self.end(&mut done),
            None if sample.active => self.advance(sample.tip, sample.heel, &mut done),
            None => {}
        }
        self.last = Some(sample);
        self.moved(done, start)
    }

    /// Ends the path: everything settles.
    pub fn finish(&mut self) -> Moved {
        let start = Instant::now();
        let mut done = StepReport::default();
        self.end(&mut done);
        self.moved(done, start)
    }

    /// Takes the pieces that strokes have cut off out of the mesh, all but the one that has most of the nodes `held`. Between strokes.
    pub fn detach(&mut self, held: &[NodeId]) -> (Vec<Fragment>, TopologyDelta) {
        let pieces = detach(&mut self.mesh, &mut self.cutter, held);
        (pieces, self.mesh.take_delta())
    }

    /// Moves the blade to a sample and looks at the whole mesh.
    pub fn sample(&mut self, sample: BladeSample) -> BatchRow {
        let moved = self.step(sample);
        self.report(sample.t_s, &moved)
    }

    /// Moves the blade to the last sample, ends the path and looks at the whole mesh.
    pub fn last_sample(&mut self, sample: BladeSample) -> BatchRow {
        let mut moved = self.step(sample);
        let ended = self.finish();
        moved.operations += ended.operations;
        moved.swept_m2 += ended.swept_m2;
        moved.elapsed += ended.elapsed;
        self.report(sample.t_s, &moved)
    }

    fn end(&mut self, done: &mut StepReport) {
        add(done, self.cutter.end_stroke(&mut self.mesh));
        self.entered = None;
    }

    fn sweep(&mut self, from: BladeSample, to: BladeSample, done: &mut StepReport) {
        let moved = from.tip.distance(to.tip).max(from.heel.distance(to.heel));
        let parts = (moved / (0.25 * self.cutter.mean_edge_m())).ceil().max(1.0) as usize;
        for k in 1..=parts {
            let s = k as f64 / parts as f64;
            self.advance(from.tip.lerp(to.tip, s), from.heel.lerp(to.heel, s), done);
        }
    }

    fn advance(&mut self, tip: DVec3, heel: DVec3, done: &mut StepReport) {
        let last = self.last.map_or((tip, heel), |l| (l.tip, l.heel));
        let length = tip.distance(heel).max(last.0.distance(last.1));
        let count = (length / (0.35 * self.cutter.mean_edge_m())).ceil().clamp(1.0, 255.0) as usize;
        let count = self.cutter.line_points(BladeId(0)).unwrap_or(count + 1);
        let line: Vec<DVec3> = (0..count).map(|i| tip.lerp(heel, i as f64 / (count - 1) as f64)).collect();
        add(done, self.cutter.advance(&mut self.mesh, BladeId(0), &line));
    }

    /// Stops the clock and takes down what the sample changed.
    fn moved(&mut self, done: StepReport, start: Instant) -> Moved {
        let elapsed = start.elapsed();
        let delta = self.mesh.take_delta();
        for added in &delta.added {
            self.along[self.mesh.tet(added.tet).source as usize] = true;
        }
        for edit in &delta.nodes {
            if let NodeEdit::Moved { node, .. } = edit {
                for tet in self.mesh.topology().around_node(*node) {
                    self.along[self.mesh.tet(*tet).source as usize] = true;
                }
            }
        }
        if let (None, Some(last)) = (self.entered, self.last.filter(|l| l.active))
            && !self.surface_points().is_empty()
        {
            self.entered = Some([last.tip, last.heel]);
        }
        Moved { operations: done.operations, swept_m2: done.swept_m2, elapsed, delta }
    }

    fn report(&mut self, t_s: f64, moved: &Moved) -> BatchRow {
        let quality = self.quality_along();
        let Operations { deleted, created, updated, .. } = moved.operations;
        let row = BatchRow {
            t_s,
            tets: self.mesh.tet_count(),
            nodes: self.mesh.node_count(),
            fragments: Components::of(&self.mesh).len(),
            deleted,
            created,
            updated,
            mean_edge_ratio: quality.mean_edge_ratio,
            min_edge_ratio: quality.min_edge_ratio,
            min_dihedral_deg: quality.min_dihedral_deg,
            swept_area_mm2: self.row.swept_area_mm2 + moved.swept_m2 * 1e6,
            opened_area_mm2: self.opened_m2() * 1e6,
            lag_mm: self.lag_m() * 1e3,
            elapsed_us: moved.elapsed.as_micros() as u64,
            step: self.row.step,
        };
        self.row = BatchRow { step: row.step + 1, ..row };
        row
    }

    /// Quality of the tetrahedra along the cut so far.
    #[must_use]
    pub fn quality_along(&self) -> Quality {
        of_tets(self.mesh.iter().filter(|(t, _)| self.is_along(*t)).map(|(t, _)| self.mesh.points(t)))
    }

    /// How far the visible wound trails behind the blade, m: from where the blade goes through the surface to the nearest point of the
    /// wound there; as long as there is no wound, to where the blade entered.
    #[must_use]
    pub fn lag_m(&self) -> f64 {
        let at = self.surface_points();
        if at.is_empty() {
            return 0.0;
        }
        let mut wound = self.cutter.wound_points(&self.mesh);
        // Where the sheet goes through nodes of the surface, the wound does.
        let through = self.cutter.stroke.on_sheet.keys().filter(|n| self.cutter.is_surface_node(**n));
        wound.extend(through.map(|n| self.mesh.rest(*n)));
        if wound.is_empty() {
            let ends = self.last.map(|l| [l.tip, l.heel]).unwrap_or_default();
            let entered = self.entered.unwrap_or(ends);
            return entered[0].distance(ends[0]).max(entered[1].distance(ends[1]));
        }
        let nearest = |p: &DVec3| wound.iter().map(|w| w.distance(*p)).fold(f64::INFINITY, f64::min);
        at.iter().map(nearest).fold(0.0, f64::max)
    }
}

fn add(done: &mut StepReport, step: StepReport) {
    done.operations += step.operations;
    done.swept_m2 += step.swept_m2;
}
