//! Cost of a tick of 1/60 s of the reference beam, and beside it what the answer is worth: where the tip comes to rest against static
//! Newton on the same mesh, and when it is lowest after the load is dropped on it, against 64 substeps.

#![expect(clippy::unwrap_used, reason = "the beam is known to be sound")]

use divan::Bencher;
use keyhole_tetmesh::TetMesh;
use keyhole_tissue::beam::{GRAVITY, REFERENCE, beam, beam_material, clamp, tip_mm};
use keyhole_tissue::{Body, Hold, Solver, TissueSettings};
use keyhole_whiteboard::TissueState;
use std::fmt;
use std::sync::OnceLock;

const DT: f32 = 1.0 / 60.0;

fn main() {
    divan::main();
}

struct Case {
    size: usize,
    settings: TissueSettings,
    tip: f64,
    swing: f64,
}

impl fmt::Display for Case {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [n, m] = REFERENCE[self.size].0;
        let Case { settings, tip, swing, .. } = self;
        let text = format!("{} tets, {:?} x {}: tip {tip:+.2} %, swing {swing:+.0} %", 5 * n * m * m, settings.solver, settings.substeps);
        f.pad(&text)
    }
}

struct Beam {
    mesh: TetMesh,
    body: Body,
    holds: Vec<Hold>,
}

impl Beam {
    fn new(size: usize) -> Self {
        let [n, m] = REFERENCE[size].0;
        let mesh = beam(n, m);
        Self { body: Body::new(&mesh, &beam_material()).unwrap(), holds: clamp(&mesh), mesh }
    }

    fn tips(&self, settings: &TissueSettings, ticks: u32) -> Vec<f64> {
        let mut state = TissueState::at_rest(&self.mesh);
        let tick = |_| {
            self.body.step(&mut state, &self.holds, GRAVITY, DT, settings);
            tip_mm(&self.mesh, &state)
        };
        (0..ticks).map(tick).collect()
    }

    /// Time of the lowest tip, in ticks, by the parabola through it and its neighbours.
    fn swing(&self, settings: &TissueSettings) -> f64 {
        let tips = self.tips(settings, 30);
        let at = (1..tips.len() - 1).min_by(|a, b| tips[*a].total_cmp(&tips[*b])).unwrap();
        let (a, b, c) = (tips[at - 1], tips[at], tips[at + 1]);
        (at + 1) as f64 + (a - c) / (2.0 * (a - 2.0 * b + c))
    }
}

fn cases() -> &'static [Case] {
    static CASES: OnceLock<Vec<Case>> = OnceLock::new();
    CASES.get_or_init(|| {
        let mut cases = Vec::new();
        for (size, (_, reference)) in REFERENCE.into_iter().enumerate() {
            let beam = Beam::new(size);
            let truth = beam.swing(&TissueSettings { substeps: 64, viscosity_s: 0.0, ..Default::default() });
            for (solver, steps) in [(Solver::Implicit, [1, 2, 3, 4, 8].as_slice()), (Solver::Xpbd, &[10, 20, 40, 80])] {
                for &substeps in steps {
                    let settings = TissueSettings { solver, substeps, ..Default::default() };
                    let settled = beam.tips(&TissueSettings { drag_1_s: 6.0, ..settings }, 180);
                    let tip = (settled[179] / reference - 1.0) * 100.0;
                    let swing = (beam.swing(&settings) / truth - 1.0) * 100.0;
                    cases.push(Case { size, settings, tip, swing });
                }
            }
        }
        cases
    })
}

#[divan::bench(args = cases(), sample_count = 30, sample_size = 1)]
fn tick(bencher: Bencher, case: &Case) {
    let beam = Beam::new(case.size);
    let mut state = TissueState::at_rest(&beam.mesh);
    bencher.bench_local(|| beam.body.step(&mut state, &beam.holds, GRAVITY, DT, &case.settings));
}

/// A cut's share of the tick: the same edge split on beams of different sizes.
#[divan::bench(args = [0, 1, 2], sample_count = 30, sample_size = 1)]
fn adopt_one_split_edge(bencher: Bencher, size: usize) {
    let beam = Beam::new(size);
    let mut mesh = beam.mesh.clone();
    let (_, c) = mesh.iter().nth(600).unwrap();
    let around: Vec<_> = mesh.topology().around_edge(c[0], c[1]).collect();
    let middle = mesh.add_node((mesh.rest(c[0]) + mesh.rest(c[1])) * 0.5, [(c[0], 0.5), (c[1], 0.5)].into_iter().collect());
    for t in around {
        let (corners, attributes) = (mesh.corners(t), mesh.tet(t));
        mesh.remove_tet(t);
        for end in [c[0], c[1]] {
            mesh.add_tet(corners.map(|n| if n == end { middle } else { n }), attributes);
        }
    }
    let delta = mesh.take_delta();
    let fresh = || {
        let mut state = TissueState::at_rest(&beam.mesh);
        state.positions.reserve(1);
        state.velocities.reserve(1);
        (Body::new(&beam.mesh, &beam_material()).unwrap(), state)
    };
    bencher
        .with_inputs(fresh)
        .bench_local_refs(|(body, state)| keyhole_tissue::adopt::adopt(body, state, &mesh, &delta, |_| Default::default()));
}
