//! Strokes whose outcome is known beforehand: shallow, halfway, back and forth, a second one, a closed loop, renumbered nodes, and tissue
//! pulled across a blade at rest.

mod common;

use common::{block, line, settings, step, verdict};
use keyhole_cutting::fragment::detach;
use keyhole_cutting::material_map::{MaterialMap, Tissue, WorldLine};
use keyhole_cutting::{BladeId, Cutter};
use keyhole_tetmesh::{DVec3, TetMesh};
use keyhole_whiteboard::{CutMethod, CutPattern};

const H: f64 = 0.004;
const SIZE: DVec3 = DVec3::new(6.0 * H, 4.0 * H, 4.0 * H);

/// Lines of a blade that moves along x from `from` to `to` (parts of the block's length), from depth `low` (part of its height) to above it.
fn along_x(from: f64, to: f64, low: f64) -> Vec<Vec<DVec3>> {
    let steps = ((to - from).abs() * SIZE.x / (0.2 * H)).ceil() as usize;
    (0..=steps)
        .map(|i| {
            let x = SIZE.x * (from + (to - from) * i as f64 / steps as f64);
            line(DVec3::new(x, low * SIZE.y, 0.52 * SIZE.z), DVec3::new(x, 1.2 * SIZE.y, 0.52 * SIZE.z), H)
        })
        .collect()
}

fn cutter(mesh: &TetMesh, method: CutMethod, snap: f64) -> Cutter {
    let mut cutter = Cutter::new(mesh);
    cutter.set_settings(settings(method, CutPattern::Minimal, snap));
    cutter
}

fn sweep(cutter: &mut Cutter, mesh: &mut TetMesh, path: &[Vec<DVec3>]) -> f64 {
    path.iter().map(|points| step(cutter, mesh, points).swept_m2).sum()
}

#[test]
fn a_shallow_stroke_stays_open_behind_the_blade() {
    let mut mesh = block([6, 4, 4], H, 0.2);
    let mut cutter = cutter(&mesh, CutMethod::Hybrid, 0.2);
    let swept = sweep(&mut cutter, &mut mesh, &along_x(-0.1, 1.1, 0.6));
    cutter.end_stroke(&mut mesh);
    let end = verdict(&mesh);
    assert_eq!(end.fragments, 1);
    let opened = (end.boundary_area - verdict(&block([6, 4, 4], H, 0.2)).boundary_area) / 2.0;
    assert!((opened - cutter.opened_m2(&mesh)).abs() < 1e-9 * opened, "the boundary grew by {opened} on each side");
    let expected = 0.4 * SIZE.y * SIZE.x;
    assert!((swept - expected).abs() < 0.01 * expected, "swept {swept}, expected {expected}");
    assert!((cutter.opened_m2(&mesh) - expected).abs() < 0.1 * expected, "opened {}, expected {expected}", cutter.opened_m2(&mesh));
}

#[test]
fn a_stroke_that_stops_halfway_stays_open() {
    for method in [CutMethod::Progressive, CutMethod::NonProgressive, CutMethod::Hybrid] {
        let mut mesh = block([6, 4, 4], H, 0.2);
        let mut cutter = cutter(&mesh, method, 0.0);
        sweep(&mut cutter, &mut mesh, &along_x(-0.1, 0.5, -0.2));
        cutter.end_stroke(&mut mesh);
        assert_eq!(verdict(&mesh).fragments, 1, "{method:?}");
        let expected = 0.5 * SIZE.x * SIZE.y;
        let opened = cutter.opened_m2(&mesh);
        assert!((opened - expected).abs() < 0.1 * expected, "{method:?}: opened {opened}, expected {expected}");
    }
}

#[test]
fn a_blade_that_goes_back_and_forth_in_its_cut_cuts_nothing_more() {
    let there = along_x(-0.1, 0.6, -0.2);
    let mut once = block([6, 4, 4], H, 0.2);
    let mut single = cutter(&once, CutMethod::Progressive, 0.0);
    sweep(&mut single, &mut once, &there);
    let mut twice = block([6, 4, 4], H, 0.2);
    let mut trembling = cutter(&twice, CutMethod::Progressive, 0.0);
    sweep(&mut trembling, &mut twice, &there);
    let back: Vec<_> = there.iter().rev().take(8).cloned().collect();
    sweep(&mut trembling, &mut twice, &back);
    let forth: Vec<_> = back.iter().rev().cloned().collect();
    sweep(&mut trembling, &mut twice, &forth);
    assert_eq!(once.tet_count(), twice.tet_count());
    let (a, b) = (single.opened_m2(&once), trembling.opened_m2(&twice));
    assert!((a - b).abs() < 1e-6 * a, "opened {a} once, {b} with trembling");
    verdict(&twice);
}

#[test]
fn a_second_stroke_cuts_the_children_of_the_first() {
    let mut mesh = block([6, 4, 4], H, 0.2);
    let before = verdict(&mesh);
    let volume = before.volume;
    let mut cutter = cutter(&mesh, CutMethod::Hybrid, 0.2);
    sweep(&mut cutter, &mut mesh, &along_x(-0.1, 1.1, -0.2));
    cutter.end_stroke(&mut mesh);
    // Across the first: the blade moves along z, through both halves.
    let across: Vec<Vec<DVec3>> = (0..=40)
        .map(|i| {
            let z = SIZE.z * (-0.1 + 1.2 * f64::from(i) / 40.0);
            line(DVec3::new(0.47 * SIZE.x, -0.2 * SIZE.y, z), DVec3::new(0.47 * SIZE.x, 1.2 * SIZE.y, z), H)
        })
        .collect();
    sweep(&mut cutter, &mut mesh, &across);
    cutter.end_stroke(&mut mesh);
    let end = verdict(&mesh);
    assert!((end.volume - volume).abs() < 1e-12 * volume);
    end.check_lips(before.boundary_area);
    assert_eq!(end.fragments, 4, "{:?}", end.volumes);
    let pieces = detach(&mut mesh, &mut cutter, &[]);
    assert_eq!((pieces.len(), verdict(&mesh).fragments), (3, 1));
    let rest: f64 = pieces.iter().map(|p| verdict(&p.mesh).volume).sum();
    assert!((rest + verdict(&mesh).volume - volume).abs() < 1e-12 * volume);
}

#[test]
fn a_closed_loop_frees_the_core_it_goes_around() {
    for method in [CutMethod::Progressive, CutMethod::Hybrid] {
        let mut mesh = block([8, 8, 4], H, 0.2);
        let mut cutter = cutter(&mesh, method, 0.0);
        let (centre, radius, height) = (DVec3::new(4.05 * H, 3.97 * H, 0.0), 2.2 * H, 4.0 * H);
        let steps = 90;
        for i in 0..=steps + 4 {
            let angle = std::f64::consts::TAU * f64::from(i) / f64::from(steps);
            let at = centre + DVec3::new(angle.cos(), angle.sin(), 0.0) * radius;
            let points = line(at - DVec3::Z * 0.3 * height, at + DVec3::Z * 1.3 * height, H);
            step(&mut cutter, &mut mesh, &points);
            mesh.take_delta();
        }
        cutter.end_stroke(&mut mesh);
        let end = verdict(&mesh);
        assert_eq!(end.fragments, 2, "{method:?}: {:?}", end.volumes);
        let core = std::f64::consts::PI * radius * radius * height;
        assert!((end.volumes[1] - core).abs() < 0.05 * core, "{method:?}: core {} of {core}", end.volumes[1]);
    }
}

#[test]
fn the_partition_does_not_depend_on_the_numbering_of_nodes() {
    let mesh = block([6, 4, 4], H, 0.2);
    let count = mesh.node_count() as u32;
    // A permutation without fixed structure: multiplication by a number that shares no factor with the count.
    let stride = (2..count).find(|s| gcd(*s, count) == 1).unwrap_or(1) * 7 % count;
    let stride = if gcd(stride, count) == 1 { stride } else { count - 1 };
    let place = |i: u32| (u64::from(i) * u64::from(stride) % u64::from(count)) as u32;
    let mut nodes = vec![DVec3::ZERO; count as usize];
    for i in 0..count {
        nodes[place(i) as usize] = mesh.rest_positions()[i as usize];
    }
    let tets: Vec<[u32; 4]> = mesh.iter().map(|(_, c)| c.map(|n| place(n.0))).collect();
    let mut volumes = Vec::new();
    for mut mesh in [mesh.clone(), TetMesh::new(nodes, &tets, &[])] {
        let mut cutter = cutter(&mesh, CutMethod::Hybrid, 0.2);
        sweep(&mut cutter, &mut mesh, &along_x(-0.1, 1.1, -0.2));
        cutter.end_stroke(&mut mesh);
        let end = verdict(&mesh);
        assert_eq!(end.fragments, 2);
        volumes.push((end.volumes, mesh.tet_count()));
    }
    assert!((volumes[0].0[1] - volumes[1].0[1]).abs() < 1e-9 * volumes[0].0[0], "{volumes:?}");
    assert_eq!(volumes[0].1, volumes[1].1);
}

fn gcd(a: u32, b: u32) -> u32 {
    if b == 0 { a } else { gcd(b, a % b) }
}

/// Far from the origin the coordinates are too coarse for some children: their events are taken back, and everything stays sound.
#[test]
fn events_that_rounding_would_turn_over_are_taken_back() {
    let near = block([6, 4, 4], H, 0.2);
    let far = DVec3::splat(1.0e11);
    let nodes: Vec<DVec3> = near.rest_positions().iter().map(|p| *p + far).collect();
    let tets: Vec<[u32; 4]> = near.iter().map(|(_, c)| c.map(|n| n.0)).collect();
    let mut mesh = keyhole_tetmesh::check::checked(&nodes, &tets, &[]).expect("the block is sound at this distance");
    let mut cutter = cutter(&mesh, CutMethod::Progressive, 0.0);
    for points in along_x(-0.1, 1.1, -0.2) {
        let points: Vec<DVec3> = points.iter().map(|p| *p + far).collect();
        step(&mut cutter, &mut mesh, &points);
        for (t, _) in mesh.iter() {
            assert!(keyhole_tetmesh::quality::is_positive(mesh.points(t)), "{t:?} is turned over");
        }
    }
    cutter.end_stroke(&mut mesh);
    assert!(cutter.operations().deferred > 0, "this distance is not coarse enough to test anything");
}

/// A blade at rest with the tissue pulled across it makes the partition of the blade moved the other way through tissue at rest.
#[test]
fn tissue_pulled_across_a_blade_at_rest_is_cut_like_tissue_at_rest_under_a_moving_blade() {
    let blade = |x: f64| WorldLine { tip: DVec3::new(x, -0.2 * SIZE.y, 0.52 * SIZE.z), heel: DVec3::new(x, 1.2 * SIZE.y, 0.52 * SIZE.z) };
    let mut ends = Vec::new();
    for pulled in [false, true] {
        let mut mesh = block([6, 4, 4], H, 0.2);
        let mut cutter = cutter(&mesh, CutMethod::Hybrid, 0.0);
        let mut map = MaterialMap::default();
        let (start, stop, ticks) = (-0.3 * SIZE.x, 1.3 * SIZE.x, 120);
        for i in 0..=ticks {
            let moved = (stop - start) * f64::from(i) / f64::from(ticks);
            let shift = if pulled { DVec3::X * -moved } else { DVec3::ZERO };
            let positions: Vec<_> = mesh.rest_positions().iter().map(|p| (*p + shift).as_vec3()).collect();
            let speed = if pulled { DVec3::X * (start - stop) / f64::from(ticks) * 60.0 } else { DVec3::ZERO };
            let velocities = vec![speed.as_vec3(); positions.len()];
            let tissue = Tissue { positions: &positions, velocities: &velocities, dt_s: 1.0 / 60.0 };
            let (steps, left) = map.steps(&mesh, &cutter, tissue, blade(if pulled { start } else { start + moved }));
            for s in steps {
                cutter.advance(&mut mesh, BladeId(0), &s);
            }
            if left {
                cutter.end_stroke(&mut mesh);
            }
            mesh.take_delta();
        }
        assert!(!cutter.is_cutting(), "pulled {pulled}: the stroke did not end");
        let end = verdict(&mesh);
        assert_eq!(end.fragments, 2, "pulled {pulled}: {:?}", end.volumes);
        ends.push((end.volumes[1], mesh.tet_count()));
    }
    assert!((ends[0].0 - ends[1].0).abs() < 1e-4 * ends[0].0, "{ends:?}");
}
