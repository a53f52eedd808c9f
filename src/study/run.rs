//! One cut with its figures as functions of its progress.

use crate::study::measure::{Along, Shapes, percentile};
use crate::study::plan::{Combination, Plan};
use crate::study::stable_step::{Elastic, Resonance};
use crate::study::strokes::Stage;
use keyhole_cutting::{BatchCut, Moved, Operations};
use keyhole_tetmesh::TetMesh;
use keyhole_tetmesh::components::Components;
use keyhole_whiteboard::OrganMaterial;
use std::time::Duration;

/// The figures at one moment of a cut. Those of the tetrahedra along the cut are missing as long as there are none.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Figures {
    /// Part of the blade's samples that are done.
    pub progress: f64,
    /// Tetrahedra.
    pub tets: usize,
    /// Tetrahedra / tetrahedra at the start.
    pub growth: f64,
    /// Operations since the start.
    pub operations: Operations,
    /// Tetrahedra along the cut: parts of original ones that the cut has changed.
    pub along: usize,
    /// Mean of shortest / longest edge along the cut.
    pub mean_edge_ratio: Option<f64>,
    /// Smallest of them.
    pub min_edge_ratio: Option<f64>,
    /// Smallest dihedral angle along the cut, degrees.
    pub min_dihedral_deg: Option<f64>,
    /// First percentile of each tetrahedron's smallest dihedral angle along the cut, degrees.
    pub p1_dihedral_deg: Option<f64>,
    /// Smallest altitude along the cut, mm.
    pub min_altitude_mm: Option<f64>,
    /// Largest stable step of the explicit model, microseconds; taken at every [`STEP_EVERY`]th moment and at the end.
    pub stable_step_us: Option<f64>,
    /// Area swept inside the tissue, mm2.
    pub swept_mm2: f64,
    /// Area opened, one side, mm2.
    pub opened_mm2: f64,
    /// How far the visible wound trails behind the blade, mm.
    pub lag_mm: f64,
}

/// The stable step is taken at every so many moments.
pub const STEP_EVERY: usize = 8;

/// What the wall clock says, microseconds from a sample to the new topology, over the samples that changed something.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Latency {
    /// Samples that changed something.
    pub events: usize,
    /// Median.
    pub p50_us: u64,
    /// 99th percentile.
    pub p99_us: u64,
    /// Largest.
    pub max_us: u64,
}

/// A cut that is done.
#[derive(Clone, Debug)]
pub struct Run {
    /// What it was.
    pub combination: Combination,
    /// Mean edge length of the mesh, mm.
    pub mean_edge_mm: f64,
    /// Tetrahedra at the start.
    pub tets_before: usize,
    /// Samples of the blade.
    pub samples: usize,
    /// Figures in order of progress; the last are those of the end, when everything has settled.
    pub figures: Vec<Figures>,
    /// Original tetrahedra that were cut in parts.
    pub cut_tets: usize,
    /// Those of them that are core.
    pub cut_core: usize,
    /// Parts that they were cut in.
    pub parts: usize,
    /// At the end, of what was core at the start: hybrid releases it late, so that only there it can snap.
    pub core: Option<Along>,
    /// Face-connected pieces at the end.
    pub fragments: usize,
    /// Largest lag of all moments, mm.
    pub max_lag_mm: f64,
    /// A number made of the places of all nodes and the corners of all tetrahedra at the end, whatever their order.
    pub fingerprint: u64,
    /// What the wall clock says: the only figures that another run does not repeat.
    pub latency: Latency,
}

impl Run {
    /// The figures of the end.
    #[must_use]
    pub fn end(&self) -> Figures {
        self.figures.last().copied().unwrap_or_default()
    }

    /// Part of the cut tetrahedra that are core.
    #[must_use]
    pub fn core_share(&self) -> f64 {
        self.cut_core as f64 / self.cut_tets.max(1) as f64
    }

    /// Part of the original tetrahedra that were cut.
    #[must_use]
    pub fn cut_share(&self) -> f64 {
        self.cut_tets as f64 / self.tets_before.max(1) as f64
    }

    /// Parts a cut tetrahedron.
    #[must_use]
    pub fn parts_a_tet(&self) -> f64 {
        self.parts as f64 / self.cut_tets.max(1) as f64
    }

    /// Smallest mean edge ratio of all moments, with its progress.
    #[must_use]
    pub fn lowest_edge_ratio(&self) -> Option<(f64, f64)> {
        self.figures.iter().filter_map(|f| Some((f.mean_edge_ratio?, f.progress))).min_by(|a, b| a.0.total_cmp(&b.0))
    }

    /// Smallest stable step of all moments, microseconds.
    #[must_use]
    pub fn smallest_step_us(&self) -> Option<f64> {
        self.figures.iter().filter_map(|f| f.stable_step_us).min_by(f64::total_cmp)
    }
}

/// The material of the stable step: kidney.
#[must_use]
pub fn elastic() -> Elastic {
    Elastic::from(&OrganMaterial::default())
}

/// A cut in progress.
struct Watched<'p> {
    plan: &'p Plan,
    cut: BatchCut,
    shapes: Shapes,
    resonance: Resonance,
    tets_before: usize,
    operations: Operations,
    swept_m2: f64,
    latencies: Vec<u64>,
    figures: Vec<Figures>,
}

impl<'p> Watched<'p> {
    fn new(plan: &'p Plan, combination: &Combination) -> Self {
        let mesh = plan.meshes[combination.mesh].mesh.clone();
        Self {
            plan,
            tets_before: mesh.tet_count(),
            cut: BatchCut::new(mesh, combination.settings()),
            shapes: Shapes::default(),
            resonance: Resonance::new(elastic(), plan.seed),
            operations: Operations::default(),
            swept_m2: 0.0,
            latencies: Vec::new(),
            figures: Vec::new(),
        }
    }

    /// Takes down what one sample did.
    fn record(&mut self, moved: &Moved) {
        self.operations += moved.operations;
        self.swept_m2 += moved.swept_m2;
        if !moved.delta.is_empty() {
            self.latencies.push(Duration::as_micros(&moved.elapsed) as u64);
        }
        self.shapes.forget(&self.cut, moved);
    }

    /// Takes the figures of this moment.
    fn look(&mut self, progress: f64, is_last: bool) {
        let tets = Shapes::along(&self.cut);
        let along = self.shapes.of(&self.cut, &tets);
        let with_step = is_last || (self.figures.len() + 1).is_multiple_of(STEP_EVERY);
        let step = if with_step { self.resonance.stable_step_s(&self.cut.mesh, &tets) } else { None };
        self.figures.push(Figures {
            progress,
            tets: self.cut.mesh.tet_count(),
            growth: self.cut.mesh.tet_count() as f64 / self.tets_before as f64,
            operations: self.operations,
            along: tets.len(),
            mean_edge_ratio: along.map(|a| a.mean_edge_ratio),
            min_edge_ratio: along.map(|a| a.min_edge_ratio),
            min_dihedral_deg: along.map(|a| a.min_dihedral_deg),
            p1_dihedral_deg: along.map(|a| a.p1_dihedral_deg),
            min_altitude_mm: along.map(|a| a.min_altitude_m * 1e3),
            stable_step_us: step.map(|s| s * 1e6),
            swept_mm2: self.swept_m2 * 1e6,
            opened_mm2: self.cut.opened_m2() * 1e6,
            lag_mm: self.cut.lag_m() * 1e3,
        });
    }

    /// Cuts along the whole path.
    fn finish(mut self, combination: &Combination) -> Run {
        let stage = Stage::of(&self.cut.mesh, self.plan.seed);
        let mean_edge_m = self.cut.mean_edge_m();
        let was_hull: Vec<bool> = self.cut.mesh.iter().map(|(t, _)| self.cut.mesh.tet(t).hull).collect();
        let path = stage.path(combination.stroke, combination.rate * mean_edge_m);
        let moments = self.plan.moments.max(1);
        let mut due = 1;
        for (i, sample) in path.iter().enumerate() {
            let mut moved = self.cut.step(*sample);
            let progress = (i + 1) as f64 / path.len() as f64;
            let is_last = i + 1 == path.len();
            if is_last {
                self.record(&moved);
                moved = self.cut.finish();
            }
            self.record(&moved);
            if is_last || (progress * moments as f64) >= due as f64 {
                self.look(progress, is_last);
                due = (progress * moments as f64).floor() as usize + 1;
            }
        }
        let mesh = &self.cut.mesh;
        let mut core = Shapes::along(&self.cut);
        core.retain(|t| !was_hull[mesh.tet(*t).source as usize]);
        let mut parts = vec![0_usize; was_hull.len()];
        for (t, _) in mesh.iter() {
            parts[mesh.tet(t).source as usize] += 1;
        }
        let cut: Vec<usize> = (0..parts.len()).filter(|s| parts[*s] > 1).collect();
        let events = self.latencies.len();
        let [p50_us, p99_us, max_us] = [0.5, 0.99, 1.0].map(|p| percentile(&mut self.latencies, p));
        Run {
            combination: *combination,
            mean_edge_mm: mean_edge_m * 1e3,
            tets_before: self.tets_before,
            samples: path.len(),
            cut_tets: cut.len(),
            cut_core: cut.iter().filter(|s| !was_hull[**s]).count(),
            parts: cut.iter().map(|s| parts[*s]).sum(),
            core: self.shapes.of(&self.cut, &core),
            fragments: Components::of(mesh).len(),
            max_lag_mm: self.figures.iter().map(|f| f.lag_mm).fold(0.0, f64::max),
            fingerprint: fingerprint(mesh),
            latency: Latency { events, p50_us, p99_us, max_us },
            figures: self.figures,
        }
    }
}

/// Cuts one combination and takes its figures.
#[must_use]
pub fn run(plan: &Plan, combination: &Combination) -> Run {
    Watched::new(plan, combination).finish(combination)
}

/// Equal for equal sets of tetrahedra, whatever their ids: the wrapping sum of a hash of each one's corner places.
fn fingerprint(mesh: &TetMesh) -> u64 {
    use std::hash::{Hash, Hasher};
    let mut sum = 0_u64;
    for (tet, _) in mesh.iter() {
        let mut places = mesh.points(tet).map(|p| p.to_array().map(f64::to_bits));
        places.sort_unstable();
        let mut hasher = rustc_hash::FxHasher::default();
        places.hash(&mut hasher);
        sum = sum.wrapping_add(hasher.finish());
    }
    sum
}
