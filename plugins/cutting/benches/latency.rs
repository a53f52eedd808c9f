//! From a blade's sample to the topology message, against the size of the mesh: the same strokes at the same local edge length in blocks of
//! 5 000, 50 000 and 500 000 tetrahedra, and the memory that mesh, adjacency and cutter take. `cargo bench -p keyhole-cutting`.
//!
//! Every case runs three times from the same mesh, which is the same work to the bit, and the least time of each sample counts: what differs is the
//! other work of the machine.
//!
//! Beside each figure stands what the answer is worth: how far the opened area is from the swept one, and whether rest volume was kept.

#[path = "../tests/common/mod.rs"]
#[expect(dead_code, reason = "the tests use the rest of it")]
mod common;

use common::{block, settings};
use keyhole_cutting::material_map::{MaterialMap, Tissue, WorldLine};
use keyhole_cutting::{BladeId, Cutter};
use keyhole_tetmesh::{DVec3, TetMesh};
use keyhole_whiteboard::{CutMethod, CutPattern};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};
use std::alloc::System;
use std::hint::black_box;
use std::time::Instant;

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

/// Edge of the cubes, m; each is five tetrahedra.
const H: f64 = 0.004;
/// How often each case runs.
const RUNS: usize = 3;
const SIZES: [[usize; 3]; 3] = [[10, 10, 10], [22, 21, 22], [46, 47, 46]];

/// Where the blade is in each sample: strokes half-way through the smallest block, side by side, a quarter of a cube a sample.
fn samples() -> Vec<Option<WorldLine>> {
    let mut path = Vec::new();
    let step = 0.25;
    for stroke in 0..12 {
        let z = 0.73 + 0.77 * f64::from(stroke);
        let place = |x: f64, tip: f64| {
            let z = z + 0.3 * (0.9 * x).sin();
            Some(WorldLine { tip: DVec3::new(x, tip, z) * H, heel: DVec3::new(x + 0.2, tip + 7.0, z + 0.2) * H })
        };
        path.extend((0..=24).map(|i| place(1.3, 11.0 - step * f64::from(i))));
        path.extend((1..=29).map(|i| place(1.3 + step * f64::from(i), 5.0)));
        path.extend((1..=24).map(|i| place(8.55, 5.0 + step * f64::from(i))));
        path.push(None);
    }
    path
}

fn main() {
    println!(
        "| tets | method | p50 / us | p99 / us | max / us | allocations a sample | bytes a tet: mesh | with cutter | opened / swept | volume |"
    );
    println!("|---:|---|---:|---:|---:|---:|---:|---:|---:|---:|");
    for cubes in SIZES {
        for method in [CutMethod::Progressive, CutMethod::NonProgressive, CutMethod::Hybrid] {
            run(cubes, method);
        }
    }
}

fn run(cubes: [usize; 3], method: CutMethod) {
    let memory = Region::new(ALLOCATOR);
    let held = || {
        let change = memory.change();
        change.bytes_allocated as i64 - change.bytes_deallocated as i64 + change.bytes_reallocated as i64
    };
    let mesh = block(cubes, H, 0.2);
    // The block is standing with its top at the same height and the strokes near one corner, whatever its size.
    let top = DVec3::Y * (10.0 - cubes[1] as f64) * H;
    let tets = mesh.tet_count();
    let mesh_bytes = held() / tets as i64;
    let cutter = Cutter::new(&mesh);
    let bytes = held() / tets as i64;
    let volume = mesh.total_volume();
    drop((mesh, cutter));
    let mut least: Vec<f64> = Vec::new();
    let mut last = None;
    for _ in 0..RUNS {
        let run = cut(block(cubes, H, 0.2), method, top);
        least = if least.is_empty() { run.times } else { least.iter().zip(run.times).map(|(a, b)| a.min(b)).collect() };
        last = Some((run.allocations, run.opened / run.swept, run.volume));
    }
    let Some((allocations, opened, end)) = last else { return };
    least.sort_by(f64::total_cmp);
    let at = |q: f64| least[((least.len() - 1) as f64 * q).round() as usize];
    let mean = allocations.iter().sum::<f64>() / allocations.len() as f64;
    println!(
        "| {tets} | {method:?} | {:.0} | {:.0} | {:.0} | {mean:.0} | {mesh_bytes} | {bytes} | {:.3} | {:+.0e} |",
        at(0.5),
        at(0.99),
        at(1.0),
        opened,
        end / volume - 1.0
    );
}

/// What one run measured.
struct Run {
    /// By sample, us.
    times: Vec<f64>,
    /// By sample.
    allocations: Vec<f64>,
    /// Area that the blade swept in the tissue, m2.
    swept: f64,
    /// Area that is open at the end, m2.
    opened: f64,
    /// Rest volume at the end, m3.
    volume: f64,
}

/// Cuts all strokes into a block whose rest shape is moved by `top` (m) and bent a little.
fn cut(mut mesh: TetMesh, method: CutMethod, top: DVec3) -> Run {
    let mut cutter = Cutter::new(&mesh);
    cutter.set_settings(settings(method, CutPattern::Minimal, 0.2));
    let mut map = MaterialMap::default();
    let (mut times, mut allocations, mut swept) = (Vec::new(), Vec::new(), 0.0);
    let bend = |p: DVec3| (p + top + DVec3::new(0.0, 0.0, 0.02 * H * (p.x / H).sin())).as_vec3();
    let mut positions: Vec<_> = mesh.rest_positions().iter().map(|p| bend(*p)).collect();
    let mut velocities = vec![Default::default(); positions.len()];
    for line in samples() {
        let region = Region::new(ALLOCATOR);
        let start = Instant::now();
        if let Some(line) = line {
            let tissue = Tissue { positions: &positions, velocities: &velocities, dt_s: 1.0 / 60.0 };
            let (steps, left) = map.steps(&mesh, &cutter, tissue, line);
            for s in steps {
                swept += cutter.advance(&mut mesh, BladeId(0), &s).swept_m2;
            }
            if left {
                cutter.end_stroke(&mut mesh);
            }
        } else {
            map.reset();
        }
        let delta = black_box(mesh.take_delta());
        times.push(start.elapsed().as_secs_f64() * 1e6);
        allocations.push(region.change().allocations as f64);
        drop(delta);
        positions.clear();
        positions.extend(mesh.rest_positions().iter().map(|p| bend(*p)));
        velocities.resize(positions.len(), Default::default());
    }
    cutter.end_stroke(&mut mesh);
    Run { times, allocations, swept, opened: cutter.opened_m2(&mesh), volume: mesh.total_volume() }
}
