//! What a second of the reference beam costs on one thread and on two, and beside it what the answer is worth: where the tip comes to rest against
//! static Newton on the same mesh, and how far its way in the first second is from that with many small and exact steps. Then a kidney and a slit beam,
//! and the cost of adopting a cut.

#![expect(clippy::unwrap_used, reason = "the meshes are known to be sound")]

use divan::Bencher;
use keyhole_tetmesh::{NodeId, TetId, TetMesh};
use keyhole_tissue::adopt::adopt;
use keyhole_tissue::beam::{GRAVITY, REFERENCE, beam, beam_material, clamp, fix, tip_mm};
use keyhole_tissue::{
    Body, Hold, ModelState, Momentum, TeschnerSettings, TimeStepping, TissueModel, TissueSettings, VbdSettings, XpbdSettings,
};
use keyhole_whiteboard::{OrganMaterials, TissueState};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};
use std::alloc::System;
use std::collections::BTreeMap;
use std::time::Instant;

#[global_allocator]
static MEMORY: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

const DT: f32 = 1.0 / 60.0;

/// Repetitions of which the fastest counts: the machine may be busy.
const REPEATS: usize = 3;

fn main() {
    // The number of cubes along the one beam wanted; 0 for none but what follows the beams.
    let only = std::env::var("BEAM_CELLS").ok().and_then(|c| c.parse::<u32>().ok());
    // The one model of those by iterations wanted, and nothing else.
    let model = std::env::var("BEAM_MODEL").ok();
    if model.is_some() {
        return models(only, model.as_deref());
    }
    println!("cost: seconds a simulated second, the first after the load is dropped; cpu: the same on one thread by the scheduler's clock");
    println!(
        "tip: at rest, with the same settings, against static Newton on the same mesh; way: largest distance from the way of the tip with 16"
    );
    println!("substeps and a tolerance of 1e-5, of the sag at rest; bytes: the body once warm");
    for ([n, m], reference) in REFERENCE.into_iter().filter(|([n, _], _)| only.is_none_or(|o| o == *n)) {
        let scene = Scene::beam(n, m);
        let exact = TissueSettings { substeps: 16, tolerance: 1e-5, iterations: 500, sleep: false, ..Default::default() };
        let way = pool(2).install(|| scene.way(&exact, 60));
        println!("\n{} tets", scene.mesh.tet_count());
        let implicit = |substeps, tolerance| TissueSettings { substeps, tolerance, ..Default::default() };
        let two_steps = |substeps| TissueSettings { stepping: TimeStepping::TwoSteps, ..implicit(substeps, 0.1) };
        let all = [implicit(1, 0.5), implicit(1, 0.1), implicit(1, 0.01), implicit(2, 0.1), implicit(4, 0.01), two_steps(1), two_steps(2)];
        for settings in all {
            scene.report(&settings, reference, &way);
        }
    }
    models(only, None);
    if only.is_none_or(|o| o == 0) {
        kidney();
        slit();
    }
    divan::main();
}

fn pool(threads: usize) -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap()
}

/// Time that this thread has run, s; nothing where the system does not tell.
fn cpu_s() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    text.split(' ').next().and_then(|ns| ns.parse::<f64>().ok()).unwrap_or(f64::NAN) * 1e-9
}

struct Scene {
    mesh: TetMesh,
    body: Body,
    holds: Vec<Hold>,
}

struct Cost {
    wall_s: f64,
    cpu_s: f64,
    worst_ms: f64,
    iterations: u32,
    allocations: usize,
}

impl Scene {
    fn beam(n: u32, m: u32) -> Self {
        let mesh = beam(n, m);
        Self { body: Body::new(&mesh, &beam_material()).unwrap(), holds: clamp(&mesh), mesh }
    }

    fn way(&self, settings: &TissueSettings, ticks: u32) -> Vec<f64> {
        let (mut body, mut state) = (self.body.clone(), TissueState::at_rest(&self.mesh));
        let tick = |_| {
            body.step(&mut state, &self.holds, GRAVITY, DT, settings);
            tip_mm(&self.mesh, &state)
        };
        (0..ticks).map(tick).collect()
    }

    fn rest(&self, settings: &TissueSettings) -> f64 {
        *self.way(&TissueSettings { drag_1_s: 6.0, ..*settings }, 240).last().unwrap()
    }

    /// A second after the load was dropped, the fastest of several.
    fn second(&self, settings: &TissueSettings, threads: usize) -> Cost {
        let run = || {
            let (mut body, mut state) = (self.body.clone(), TissueState::at_rest(&self.mesh));
            let (wall, cpu) = (Instant::now(), cpu_s());
            let (mut worst_ms, mut iterations, mut allocations) = (0.0_f64, 0, 0);
            for tick in 0..60 {
                let (start, memory) = (Instant::now(), Region::new(MEMORY));
                body.step(&mut state, &self.holds, GRAVITY, DT, settings);
                worst_ms = worst_ms.max(start.elapsed().as_secs_f64() * 1e3);
                iterations += body.solver_report().0;
                if tick > 1 {
                    allocations += memory.change().allocations;
                }
            }
            Cost { wall_s: wall.elapsed().as_secs_f64(), cpu_s: cpu_s() - cpu, worst_ms, iterations, allocations }
        };
        let pool = pool(threads);
        let mut runs: Vec<Cost> = (0..REPEATS).map(|_| pool.install(run)).collect();
        runs.sort_by(|a, b| a.wall_s.total_cmp(&b.wall_s));
        runs.swap_remove(0)
    }

    /// Bytes of a body that has been stepped, by a clone of it.
    fn bytes(&self, settings: &TissueSettings) -> usize {
        let (mut body, mut state) = (self.body.clone(), TissueState::at_rest(&self.mesh));
        body.step(&mut state, &self.holds, GRAVITY, DT, settings);
        let memory = Region::new(MEMORY);
        let copy = body.clone();
        let bytes = memory.change().bytes_allocated;
        drop(copy);
        bytes
    }

    fn report(&self, settings: &TissueSettings, reference: f64, exact: &[f64]) {
        let (one, two) = (self.second(settings, 1), self.second(settings, 2));
        let tets = self.mesh.tet_count() as f64;
        let tip = (pool(2).install(|| self.rest(settings)) / reference - 1.0) * 100.0;
        let away = self.way(settings, 60).iter().zip(exact).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / -reference * 100.0;
        let name = match settings.stepping {
            TimeStepping::TwoSteps => format!("two steps x {} to {}", settings.substeps, settings.tolerance),
            TimeStepping::TwoStages => format!("implicit x {} to {}", settings.substeps, settings.tolerance),
        };
        println!(
            "{name:22} cost {:.3} (cpu {:.3}), two threads {:.3}; worst tick {:.1} ms; {:4.1} iterations a tick, {:5.0} ns a tet and tick, {:5.1} ns a \
             tet and iteration; tip {tip:+.3} %, way {away:.2} %; {:.0} bytes a tet; {} allocations in 58 ticks",
            one.wall_s,
            one.cpu_s,
            two.wall_s,
            one.worst_ms,
            f64::from(one.iterations) / 60.0,
            one.cpu_s * 1e9 / tets / 60.0,
            one.cpu_s * 1e9 / tets / f64::from(one.iterations.max(1)),
            self.bytes(settings) as f64 / tets,
            one.allocations,
        );
    }
}

/// The models that go through the elements many times a tick: what one such iteration costs. With `BEAM_CELLS` on
/// that beam alone, with `BEAM_MODEL` that model alone.
fn models(only: Option<u32>, name: Option<&str>) {
    println!(
        "\nmodels by iterations over all elements: ns a tet and iteration by the clock, least of {REPEATS} seconds after the load is dropped"
    );
    let xpbd = |substeps| TissueModel::Xpbd(XpbdSettings { substeps, ..Default::default() });
    let vbd = |substeps, iterations| TissueModel::Vbd(VbdSettings { substeps, iterations, ..Default::default() });
    for ([n, m], reference) in REFERENCE.into_iter().filter(|([n, _], _)| only.is_none_or(|o| o == *n)) {
        let scene = Scene::beam(n, m);
        println!("{} tets", scene.mesh.tet_count());
        for model in [xpbd(10), xpbd(40), vbd(1, 8), vbd(1, 20), vbd(4, 20), TissueModel::Teschner(TeschnerSettings::default())]
            .into_iter()
            .filter(|m| name.is_none_or(|n| n == m.name()))
        {
            scene.model(model, reference);
        }
    }
}

impl Scene {
    fn model(&self, model: TissueModel, reference: f64) {
        let make = || {
            let body = self.body.clone();
            let kept = ModelState::new(model, None, &body, &self.mesh, &beam_material()).unwrap();
            (body, kept, TissueState::at_rest(&self.mesh))
        };
        let per_tick = match model {
            TissueModel::Xpbd(s) => s.substeps,
            TissueModel::Vbd(s) => s.substeps * s.iterations,
            TissueModel::Teschner(s) => (DT / (s.part_of_limit * make().1.step_limit_s().unwrap())).ceil() as u32,
            TissueModel::Implicit => 1,
        };
        let mut allocations = 0;
        let mut ticks = |threads: usize, drag_1_s: f32, ticks: u32| {
            let settings = TissueSettings { drag_1_s, ..Default::default() };
            pool(threads).install(|| {
                let (mut body, mut kept, mut state) = make();
                let start = Instant::now();
                for tick in 0..ticks {
                    let memory = Region::new(MEMORY);
                    kept.step(&mut body, &mut state, &self.holds, GRAVITY, DT, &settings);
                    allocations = if tick > 1 { allocations + memory.change().allocations } else { 0 };
                }
                (start.elapsed().as_secs_f64(), tip_mm(&self.mesh, &state), (body, kept))
            })
        };
        let each = 1e9 / (60.0 * f64::from(per_tick) * self.mesh.tet_count() as f64);
        let mut least = |threads: usize| (0..REPEATS).map(|_| ticks(threads, 4.0, 60).0).fold(f64::MAX, f64::min);
        let (one, two) = (least(1), least(2));
        let (_, tip, kept) = ticks(2, 6.0, 240);
        let memory = Region::new(MEMORY);
        let copy = kept.clone();
        let bytes = memory.change().bytes_allocated as f64 / self.mesh.tet_count() as f64;
        drop(copy);
        println!(
            "{:9} {per_tick:4} a tick: {:6.1} ns a tet and iteration, two threads {:6.1} ({:.2} times faster); a second costs {one:.3} s; tip {:+.2} %; {bytes:.0} \
             bytes a tet; {allocations} allocations in 238 ticks",
            model.name(),
            one * each,
            two * each,
            one / two,
            (tip / reference - 1.0) * 100.0,
        );
    }
}

/// Cuts the upper half of the section at mid-length: the nodes there get twins on the far side.
fn slit_mesh(mesh: &mut TetMesh) {
    let far = |mesh: &TetMesh, t: TetId| mesh.points(t).iter().map(|p| p.x).sum::<f64>() / 4.0 > 0.03;
    let tets: Vec<TetId> = mesh.iter().map(|(t, _)| t).collect();
    let cut = |mesh: &TetMesh, n: NodeId| (mesh.rest(n).x - 0.03).abs() < 1e-6 && mesh.rest(n).y > 0.0151;
    let mut twins: BTreeMap<NodeId, NodeId> = BTreeMap::new();
    for tet in tets.into_iter().filter(|t| far(mesh, *t)).collect::<Vec<_>>() {
        let (corners, attributes) = (mesh.corners(tet), mesh.tet(tet));
        if corners.iter().any(|n| cut(mesh, *n)) {
            mesh.remove_tet(tet);
            let own = corners.map(|n| if cut(mesh, n) { *twins.entry(n).or_insert_with(|| mesh.split_node(n)) } else { n });
            mesh.add_tet(own, attributes);
        }
    }
}

/// The beam at rest is slit to half its height at mid-length: its way in the second after it, against that with many exact steps.
fn slit() {
    println!("\nslit to half its height at mid-length: way in the second after it, and cost of it");
    for ([n, m], _) in REFERENCE {
        let exact = TissueSettings { substeps: 16, tolerance: 1e-5, iterations: 500, sleep: false, ..Default::default() };
        let scene = Scene::beam(n, m);
        let mut hung = (scene.body.clone(), TissueState::at_rest(&scene.mesh));
        let pool = pool(2);
        pool.install(|| {
            for _ in 0..240 {
                hung.0.step(&mut hung.1, &scene.holds, GRAVITY, DT, &TissueSettings { drag_1_s: 8.0, ..Default::default() });
            }
        });
        let mut mesh = scene.mesh.clone();
        slit_mesh(&mut mesh);
        let delta = mesh.take_delta();
        let second = |settings: &TissueSettings, ticks: usize| {
            let (mut body, mut state) = hung.clone();
            let start = Instant::now();
            adopt(&mut body, &mut state, &mesh, &delta, |_| Momentum::default());
            let adopted = start.elapsed().as_secs_f64() * 1e3;
            let start = Instant::now();
            let mut iterations = 0;
            let way: Vec<f64> = (0..ticks)
                .map(|_| {
                    body.step(&mut state, &scene.holds, GRAVITY, DT, settings);
                    iterations += body.solver_report().0;
                    tip_mm(&mesh, &state)
                })
                .collect();
            (way, start.elapsed().as_secs_f64(), adopted, iterations)
        };
        let (truth, ..) = pool.install(|| second(&exact, 60));
        let (settled, ..) = pool.install(|| second(&TissueSettings { drag_1_s: 8.0, ..exact }, 300));
        let rest = *settled.last().unwrap();
        for tolerance in [0.1, 0.03, 0.01] {
            let settings = TissueSettings { tolerance, ..Default::default() };
            let (way, cost, adopted, iterations) = pool.install(|| second(&settings, 60));
            let away = way.iter().zip(&truth).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            println!(
                "{:6} tets, tolerance {tolerance}: way {:.2} % of the sag of {rest:.3} mm; cost {cost:.3}, two threads; {:.1} iterations a tick; adopted in \
                 {adopted:.2} ms",
                mesh.tet_count(),
                -away / rest * 100.0,
                f64::from(iterations) / 60.0
            );
        }
    }
}

/// The kidney of the default scene, held at one end, dropped.
fn kidney() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../assets/kidney.vtu");
    let mesh = keyhole_tetmesh::vtu::read(std::path::Path::new(path)).unwrap();
    let (low, high) = mesh.nodes().map(|n| mesh.rest(n).x).fold((f64::MAX, f64::MIN), |(l, h), x| (l.min(x), h.max(x)));
    let end = low + 0.1 * (high - low);
    let holds: Vec<Hold> = mesh.nodes().filter(|n| mesh.rest(*n).x < end).map(|n| fix(n, mesh.rest(n).as_vec3())).collect();
    let scene = Scene { body: Body::new(&mesh, &OrganMaterials::default()).unwrap(), holds, mesh };
    let settings = TissueSettings::default();
    let (one, two) = (scene.second(&settings, 1), scene.second(&settings, 2));
    println!(
        "\nkidney of {} tets: a tick {:.2} ms on one thread (cpu {:.2}, worst {:.2}), {:.2} ms on two (worst {:.2}); {:.1} iterations a tick; {:.0} bytes a tet",
        scene.mesh.tet_count(),
        one.wall_s * 1e3 / 60.0,
        one.cpu_s * 1e3 / 60.0,
        one.worst_ms,
        two.wall_s * 1e3 / 60.0,
        two.worst_ms,
        f64::from(one.iterations) / 60.0,
        scene.bytes(&settings) as f64 / scene.mesh.tet_count() as f64,
    );
}

/// A cut's share of the tick: the same edge split on beams of different sizes.
#[divan::bench(args = [0, 1, 2], sample_count = 30, sample_size = 1)]
fn adopt_one_split_edge(bencher: Bencher, size: usize) {
    let [n, m] = REFERENCE[size].0;
    let beam = Scene::beam(n, m);
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
    bencher.with_inputs(fresh).bench_local_refs(|(body, state)| adopt(body, state, &mesh, &delta, |_| Momentum::default()));
}
