//! What detection costs in a tick: build and query, nodes in tetrahedra. The same pairs are found by every way that is timed: a check, not a promise.
//!
//! Wall clock, the least of several runs, and the mean processor time of the calling thread by the scheduler's clock.

#![expect(clippy::unwrap_used, reason = "the meshes are known to be sound")]

#[path = "../tests/collision/meshes.rs"]
#[expect(dead_code, reason = "tests use the rest")]
mod meshes;

use bevy_math::{Quat, Vec3};
use keyhole_collision::{Body, Detector, Folds, Grading, Hit, Weights, mean_edge_m};
use keyhole_tetmesh::{DVec3, EDGES, NodeId, TetId, TetMesh};
use meshes::{Thing, block, divided};
use parry3d::bounding_volume::Aabb;
use parry3d::math::Vec3 as ParryVec3;
use parry3d::partitioning::{Bvh, BvhBuildStrategy, BvhWorkspace};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};
use std::alloc::System;
use std::time::Instant;

#[global_allocator]
static MEMORY: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

const REPEATS: usize = 15;

fn main() {
    println!(
        "ms a tick, wall on one thread (mean cpu), wall on two, walls the least of {REPEATS} or more; allocations a tick once warm, one thread\n"
    );
    println!("two blocks, the second turned and through a quarter of the first; hierarchical, with their own surfaces and without");
    // The number of cubes along each edge of the blocks wanted; 0 for none but what follows them.
    let only = std::env::var("DETECT_CELLS").ok().and_then(|c| c.parse::<u32>().ok());
    for cells in [6, 10, 16, 23, 37, 46].into_iter().filter(|c| only.is_none_or(|o| o == *c)) {
        let pair = pair(&block([cells; 3], [0.05; 3]), &block([cells; 3], [0.05; 3]));
        for own in [false, true] {
            report(&pair, own, Grading::Hierarchical, "hierarchical");
        }
    }
    println!(
        "\neach block against itself with a memory, while it sways and a dent of 5 mm goes over it at 5 cm/s, and the two against each other"
    );
    for cells in [16, 46].into_iter().filter(|c| only.is_none_or(|o| o == *c)) {
        report_moving(cells);
    }
    if only.is_some_and(|o| o != 0) {
        return;
    }
    println!("\nthe ways beside each other, two blocks as they are and the first after 20 cuts");
    let whole = block([16; 3], [0.05; 3]);
    let cut = divided(&block([13; 3], [0.05; 3]), &cuts());
    for first in [&whole, &cut] {
        let (mean, least) = edges_m(first);
        println!("edges: mean {:.3} mm, shortest {:.5} mm", mean * 1e3, least * 1e3);
        let pair = pair(first, &whole);
        let bodies = [pair[0].body(false), pair[1].body(false)];
        let mean = mean_edge_m(&bodies).unwrap();
        for own in [false, true] {
            report(&pair, own, Grading::Hierarchical, "hierarchical hash");
            report(&pair, own, Grading::Flat(mean), "flat hash, mean edge");
        }
        report_other(&pair, "uniform grid of tets", uniform_grid);
        report_other(&pair, "parry's BVH of tets", parry_bvh);
        let mut trees = refitted(&pair);
        report_other(&pair, "the same, refitted", |pair| refit(pair, &mut trees));
    }
}

/// Twenty planes through a block of 5 cm, each a little turned against the one before: many that all but meet nodes and each other.
fn cuts() -> Vec<(DVec3, DVec3)> {
    let at = |i: f64| {
        (DVec3::new(0.004 + 0.0021 * i, 0.025, 0.025), DVec3::new(1.0, 0.15 * (i * 1.7).sin(), 0.15 * (i * 2.3).cos()).normalize())
    };
    (0..20).map(|i| at(f64::from(i))).collect()
}

/// Mean and shortest length of the edges of a mesh at rest, m.
fn edges_m(mesh: &TetMesh) -> (f64, f64) {
    let lengths = mesh.iter().flat_map(|(t, _)| {
        let p = mesh.points(t);
        EDGES.map(|[i, j]| p[i].distance(p[j]))
    });
    let (sum, least) = lengths.fold((0.0, f64::INFINITY), |(sum, least), l| (sum + l, l.min(least)));
    (sum / (6.0 * mesh.tet_count() as f64), least)
}

fn pair(first: &TetMesh, second: &TetMesh) -> [Thing; 2] {
    let turned = |p: Vec3| Quat::from_rotation_z(0.3) * p + Vec3::new(0.025, 0.005, 0.013);
    [Thing::new(first.clone(), |p| p), Thing::new(second.clone(), turned)]
}

fn pool(threads: usize) -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap()
}

/// Time that this thread has run, s; nothing where the system does not tell.
fn cpu_s() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    text.split(' ').next().and_then(|ns| ns.parse::<f64>().ok()).unwrap_or(f64::NAN) * 1e-9
}

/// Least wall clock and mean processor time of several runs, ms, and what the last of them gave.
fn least<T>(mut run: impl FnMut() -> T) -> (f64, f64, T) {
    let (mut wall_ms, mut last) = (f64::INFINITY, run());
    let (begin, cpu) = (Instant::now(), cpu_s());
    let mut runs = 0;
    // The scheduler's clock is coarse: many runs where one is short.
    while runs < REPEATS || begin.elapsed().as_secs_f64() < 0.3 {
        let wall = Instant::now();
        last = run();
        wall_ms = wall_ms.min(wall.elapsed().as_secs_f64() * 1e3);
        runs += 1;
    }
    (wall_ms, (cpu_s() - cpu) * 1e3 / runs as f64, last)
}

fn report(pair: &[Thing; 2], own: bool, grading: Grading, name: &str) {
    let bodies = [pair[0].body(own), pair[1].body(own)];
    let tets: usize = pair.iter().map(|t| t.mesh.tet_count()).sum();
    let mut detector = Detector::default();
    let (wall_ms, cpu_ms, hits) = pool(1).install(|| least(|| detector.detect(&bodies, grading).len()));
    let allocations = pool(1).install(|| {
        let memory = Region::new(MEMORY);
        detector.detect(&bodies, grading);
        memory.change().allocations
    });
    let two_ms = pool(2).install(|| least(|| detector.detect(&bodies, grading).len()).0);
    let own = if own { " + own surfaces" } else { "" };
    let a_tet = wall_ms * 1e6 / tets as f64;
    println!(
        "{tets:7} tets, {hits:6} hits: {wall_ms:7.3} ({cpu_ms:7.3}) {two_ms:7.3} ms, {a_tet:5.1} ns a tet, {allocations} allocations; {name}{own}"
    );
}

/// The tick as the plugin does it: each body against itself with a memory, and both against each other.
fn report_moving(cells: u32) {
    const FRAMES: usize = 60;
    let things = pair(&block([cells; 3], [0.05; 3]), &block([cells; 3], [0.05; 3]));
    // There and back, so that it can go on for ever without a jump.
    let there = |f: usize| (1.0 - (f as f32 / FRAMES as f32 * std::f32::consts::TAU).cos()) / 2.0;
    let frames: Vec<[Vec<Vec3>; 2]> =
        (0..FRAMES).map(|f| [0, 1].map(|i| things[i].positions.iter().map(|p| moved(*p, there(f))).collect())).collect();
    let tets = 2 * things[0].mesh.tet_count();
    for between in [false, true] {
        for threads in [1, 2] {
            let mut folds = [0, 1].map(|i| Folds::of(&things[i].mesh, &things[i].shape));
            let mut detector = Detector::default();
            let mut tick = |at: usize| {
                let frame = &frames[at % FRAMES];
                let own: usize = (0..2).map(|i| folds[i].detect(&things[i].shape, &frame[i], i as u16).len()).sum();
                let body = |i: usize| Body { positions: &frame[i], ..things[i].body(false) };
                own + if between { detector.detect(&[body(0), body(1)], Grading::Hierarchical).len() } else { 0 }
            };
            pool(threads).install(|| {
                let first = Instant::now();
                tick(0);
                let first_ms = first.elapsed().as_secs_f64() * 1e3;
                (1..2 * FRAMES).for_each(|at| _ = tick(at));
                let mut at = 0;
                let (wall_ms, cpu_ms, hits) = least(|| {
                    at += 1;
                    tick(at)
                });
                let memory = Region::new(MEMORY);
                (0..FRAMES).for_each(|f| _ = tick(at + f));
                let allocations = memory.change().allocations as f64 / FRAMES as f64;
                let both = if between { " and against each other" } else { "" };
                println!(
                    "{tets:7} tets, {hits:6} hits: {wall_ms:7.3} ({cpu_ms:7.3}) ms on {threads}, the first {first_ms:.1}, {allocations:.1} allocations; each against itself{both}"
                );
            });
            for frame in [&frames[0], &frames[FRAMES / 3]] {
                let anew =
                    Detector::default().detect(&[Body { positions: &frame[0], ..things[0].body(true) }], Grading::Hierarchical).to_vec();
                assert_eq!(folds[0].detect(&things[0].shape, &frame[0], 0), anew, "the same with a memory as without");
            }
            let (restless, all) = folds[0].restless();
            println!("        {restless} of {all} patches not calm, {} bytes a tet", folds[0].bytes() / things[0].mesh.tet_count());
        }
    }
}

/// A block that sways by 5 mm and has a dent of 5 mm at a place that goes 5 cm to and fro in two seconds.
fn moved(p: Vec3, t: f32) -> Vec3 {
    let dent = Vec3::new(0.05 * t, 0.05, 0.02);
    let near = (-(p - dent).length_squared() / (2.0 * 0.008 * 0.008)).exp();
    p + Vec3::new(2.0 * t * p.y * p.y, -0.005 * near, 0.0)
}

fn report_other(pair: &[Thing; 2], name: &str, mut find: impl FnMut(&[Thing; 2]) -> Vec<Hit>) {
    let (wall_ms, cpu_ms, mut hits) = least(|| find(pair));
    hits.sort_unstable_by_key(Hit::key);
    let expected = Detector::default().detect(&[pair[0].body(false), pair[1].body(false)], Grading::Hierarchical).to_vec();
    assert_eq!(hits, expected, "{name} finds the same");
    let tets: usize = pair.iter().map(|t| t.mesh.tet_count()).sum();
    println!("{tets:7} tets, {:6} hits: {wall_ms:7.3} ({cpu_ms:7.3})         ms; {name}", hits.len());
}

/// A body's tetrahedra as boxes.
fn boxes(thing: &Thing) -> Vec<(TetId, [NodeId; 4], Vec3, Vec3)> {
    let of = |(tet, nodes): (TetId, [NodeId; 4])| {
        let p = nodes.map(|n| thing.positions[n.index()]);
        (tet, nodes, p[0].min(p[1]).min(p[2].min(p[3])), p[0].max(p[1]).max(p[2].max(p[3])))
    };
    thing.mesh.iter().map(of).collect()
}

fn test(hits: &mut Vec<Hit>, bodies: [usize; 2], node: usize, point: Vec3, tet: TetId, corners: [NodeId; 4], positions: &[Vec3]) {
    let weights = Weights::of(corners.map(|n| positions[n.index()].into())).and_then(|w| w.inside(point.into()));
    if let Some(weights) = weights {
        let [node_body, tet_body] = bodies.map(|b| b as u16);
        hits.push(Hit { node_body, node: NodeId(node as u32), tet_body, tet, weights });
    }
}

/// The tetrahedra of each body in a dense grid over its box, a cell as long as the longest box of a tetrahedron is on average, built by counting.
fn uniform_grid(pair: &[Thing; 2]) -> Vec<Hit> {
    let mut hits = Vec::new();
    for (b, a) in [(0, 1), (1, 0)] {
        let boxes = boxes(&pair[b]);
        let low = boxes.iter().fold(Vec3::INFINITY, |low, b| low.min(b.2));
        let high = boxes.iter().fold(Vec3::NEG_INFINITY, |high, b| high.max(b.3));
        let size = boxes.iter().map(|b| f64::from((b.3 - b.2).max_element())).sum::<f64>() / boxes.len() as f64;
        let per_m = 1.0 / size as f32;
        let counts = ((high - low) * per_m).as_ivec3() + 1;
        let cell = |p: Vec3| ((p - low) * per_m).as_ivec3().clamp(bevy_math::IVec3::ZERO, counts - 1);
        let place = |i: i32, j: i32, k: i32| ((k * counts.y + j) * counts.x + i) as usize;
        let mut starts = vec![0u32; (counts.x * counts.y * counts.z) as usize + 1];
        let each = |visit: &mut dyn FnMut(usize, u32)| {
            for (t, b) in boxes.iter().enumerate() {
                let (from, to) = (cell(b.2), cell(b.3));
                for k in from.z..=to.z {
                    for j in from.y..=to.y {
                        for i in from.x..=to.x {
                            visit(place(i, j, k), t as u32);
                        }
                    }
                }
            }
        };
        each(&mut |at, _| starts[at] += 1);
        let mut sum = 0;
        for s in &mut starts {
            sum += *s;
            *s = sum;
        }
        let mut list = vec![0u32; sum as usize];
        each(&mut |at, t| {
            starts[at] -= 1;
            list[starts[at] as usize] = t;
        });
        for (node, p) in pair[a].positions.iter().enumerate() {
            if !(p.cmpge(low).all() && p.cmple(high).all()) {
                continue;
            }
            let c = cell(*p);
            let at = place(c.x, c.y, c.z);
            for &t in &list[starts[at] as usize..starts[at + 1] as usize] {
                let (tet, corners, low, high) = boxes[t as usize];
                if p.cmpge(low).all() && p.cmple(high).all() {
                    test(&mut hits, [a, b], node, *p, tet, corners, &pair[b].positions);
                }
            }
        }
    }
    hits
}

fn aabb(low: Vec3, high: Vec3) -> Aabb {
    Aabb::new(ParryVec3::from_array(low.to_array()), ParryVec3::from_array(high.to_array()))
}

fn ask(pair: &[Thing; 2], hits: &mut Vec<Hit>, [a, b]: [usize; 2], bvh: &Bvh, boxes: &[(TetId, [NodeId; 4], Vec3, Vec3)]) {
    for (node, p) in pair[a].positions.iter().enumerate() {
        for t in bvh.intersect_aabb(&aabb(*p, *p)) {
            let (tet, corners, ..) = boxes[t as usize];
            test(hits, [a, b], node, *p, tet, corners, &pair[b].positions);
        }
    }
}

/// A tree of each body's tetrahedra, built anew, asked for each node of the other.
fn parry_bvh(pair: &[Thing; 2]) -> Vec<Hit> {
    let mut hits = Vec::new();
    for (b, a) in [(0, 1), (1, 0)] {
        let boxes = boxes(&pair[b]);
        let leaves: Vec<Aabb> = boxes.iter().map(|b| aabb(b.2, b.3)).collect();
        let bvh = Bvh::from_leaves(BvhBuildStrategy::Binned, &leaves);
        ask(pair, &mut hits, [a, b], &bvh, &boxes);
    }
    hits
}

fn refitted(pair: &[Thing; 2]) -> Vec<(Bvh, BvhWorkspace)> {
    let tree = |thing: &Thing| {
        let leaves: Vec<Aabb> = boxes(thing).iter().map(|b| aabb(b.2, b.3)).collect();
        (Bvh::from_leaves(BvhBuildStrategy::Binned, &leaves), BvhWorkspace::default())
    };
    pair.iter().map(tree).collect()
}

/// Trees that are kept: every box is put in anew and the tree refitted, asked for each node of the other body.
fn refit(pair: &[Thing; 2], trees: &mut [(Bvh, BvhWorkspace)]) -> Vec<Hit> {
    let mut hits = Vec::new();
    for (b, a) in [(0, 1), (1, 0)] {
        let boxes = boxes(&pair[b]);
        let (bvh, workspace) = &mut trees[b];
        for (t, (.., low, high)) in boxes.iter().enumerate() {
            bvh.insert_or_update_partially(aabb(*low, *high), t as u32, 0.0);
        }
        bvh.refit(workspace);
        ask(pair, &mut hits, [a, b], bvh, &boxes);
    }
    hits
}
