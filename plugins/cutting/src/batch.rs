//! A blade's recorded path cut through a mesh in its rest shape, with a row of figures for each sample.

use crate::blade::BladeSample;
use crate::cutter::{Cutter, Operations, StepReport};
use keyhole_tetmesh::components::Components;
use keyhole_tetmesh::quality::{Quality, of_tets};
use keyhole_tetmesh::{DVec3, TetId, TetMesh};
use keyhole_whiteboard::CutSettings;
use serde::Serialize;
use std::time::Instant;

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

/// A mesh being cut along a path.
#[derive(Debug)]
pub struct BatchCut {
    /// The mesh.
    pub mesh: TetMesh,
    cutter: Cutter,
    last: Option<BladeSample>,
    row: BatchRow,
    /// Original tetrahedra that the cut has touched: their parts are the tetrahedra along the cut.
    along: Vec<bool>,
    entered: Option<[DVec3; 2]>,
}

impl BatchCut {
    /// Starts on a mesh.
    #[must_use]
    pub fn new(mesh: TetMesh, settings: CutSettings) -> Self {
        let mut cutter = Cutter::new(&mesh);
        cutter.set_settings(settings);
        let along = vec![false; mesh.tet_slots()];
        Self { mesh, cutter, last: None, row: BatchRow::default(), along, entered: None }
    }

    /// Whether a later sample may still change this tetrahedron.
    #[must_use]
    pub fn is_temporary(&self, tet: TetId) -> bool {
        self.cutter.is_temporary(tet)
    }

    /// Moves the blade to a sample. Two samples that both cut are joined by steps of less than a quarter of an edge; a sample that does not cut
    /// ends the stroke.
    pub fn sample(&mut self, sample: BladeSample) -> BatchRow {
        let start = Instant::now();
        let mut done = StepReport::default();
        match self.last.filter(|l| l.active) {
            Some(last) if sample.active => self.sweep(last, sample, &mut done),
            Some(_) => self.end(&mut done),
            None if sample.active => self.advance(sample.tip, sample.heel, &mut done),
            None => {}
        }
        self.last = Some(sample);
        self.report(sample.t_s, done, start)
    }

    /// Moves the blade to the last sample and ends the path: everything settles.
    pub fn last_sample(&mut self, sample: BladeSample) -> BatchRow {
        let moved = self.sample(sample);
        let start = Instant::now();
        let mut done = StepReport::default();
        self.end(&mut done);
        let ended = self.report(sample.t_s, done, start);
        BatchRow {
            step: moved.step,
            deleted: moved.deleted + ended.deleted,
            created: moved.created + ended.created,
            updated: moved.updated + ended.updated,
            elapsed_us: moved.elapsed_us + ended.elapsed_us,
            ..ended
        }
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
        let count = self.cutter.line_points().unwrap_or(count + 1);
        let line: Vec<DVec3> = (0..count).map(|i| tip.lerp(heel, i as f64 / (count - 1) as f64)).collect();
        let seeds = self.cutter.tets_at(&self.mesh, &line);
        add(done, self.cutter.advance(&mut self.mesh, &line, &seeds));
        for tet in self.cutter.children() {
            self.along[self.mesh.tet(tet).source as usize] = true;
        }
    }

    fn report(&mut self, t_s: f64, done: StepReport, start: Instant) -> BatchRow {
        let elapsed_us = start.elapsed().as_micros() as u64;
        let _ = self.mesh.take_delta();
        let quality = self.quality_along();
        let Operations { deleted, created, updated, .. } = done.operations;
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
            swept_area_mm2: self.row.swept_area_mm2 + done.swept_m2 * 1e6,
            opened_area_mm2: self.cutter.opened_m2(&self.mesh) * 1e6,
            lag_mm: self.lag_m() * 1e3,
            elapsed_us,
            step: self.row.step,
        };
        self.row = BatchRow { step: row.step + 1, ..row };
        row
    }

    /// Quality of the tetrahedra along the cut so far.
    #[must_use]
    pub fn quality_along(&self) -> Quality {
        of_tets(self.mesh.iter().filter(|(t, _)| self.along[self.mesh.tet(*t).source as usize]).map(|(t, _)| self.mesh.points(t)))
    }

    /// How far the visible wound trails behind the blade, m.
    fn lag_m(&mut self) -> f64 {
        let at = self.cutter.surface_points(&self.mesh);
        if at.is_empty() {
            return 0.0;
        }
        let wound = self.cutter.wound_points(&self.mesh);
        if wound.is_empty() {
            let ends = self.last.map(|l| [l.tip, l.heel]).unwrap_or_default();
            let entered = *self.entered.get_or_insert(ends);
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
