//! A blade swept through blocks: every method and pattern, the invariants after every step.

mod common;

use common::{block, line, settings, step, verdict};
use keyhole_cutting::Cutter;
use keyhole_tetmesh::{DVec3, TetMesh};
use keyhole_whiteboard::{CutMethod, CutPattern};

const H: f64 = 0.004;
const METHODS: [CutMethod; 3] = [CutMethod::Progressive, CutMethod::NonProgressive, CutMethod::Hybrid];
const PATTERNS: [CutPattern; 2] = [CutPattern::Minimal, CutPattern::Symmetric];

/// A wavy stroke along x right through a block of the given size, blade along y, longer than the block.
fn wavy(size: DVec3, wave: f64) -> Vec<Vec<DVec3>> {
    let steps = (size.x * 1.3 / (0.2 * H)).ceil() as usize;
    (0..=steps)
        .map(|i| {
            let x = size.x * (-0.15 + 1.3 * i as f64 / steps as f64);
            let z = size.z * 0.5 + wave * (6.0 * x / size.x).sin();
            line(DVec3::new(x, -0.2 * size.y, z), DVec3::new(x + 0.1 * H, 1.2 * size.y, z + 0.4 * H), H)
        })
        .collect()
}

fn cut(mesh: &mut TetMesh, method: CutMethod, pattern: CutPattern, snap: f64, path: &[Vec<DVec3>]) -> Cutter {
    let mut cutter = Cutter::new(mesh);
    cutter.set_settings(settings(method, pattern, snap));
    let before = verdict(mesh);
    let mut opened = 0.0;
    let mut swept = 0.0;
    for points in path {
        swept += step(&mut cutter, mesh, points).swept_m2;
        let now = verdict(mesh);
        assert!((now.volume - before.volume).abs() <= 1e-12 * before.volume, "volume changed: {} to {}", before.volume, now.volume);
        now.check_lips(before.outer_area);
        let area = cutter.opened_m2(mesh);
        assert!(
            (now.boundary_area - before.boundary_area - 2.0 * area).abs() < 1e-9 * before.boundary_area,
            "the opened area {area} is not the boundary's {}",
            (now.boundary_area - before.boundary_area) / 2.0
        );
        assert!(area >= opened * 0.98, "the cut closed: {opened} to {area}");
        opened = area;
        if method == CutMethod::Progressive {
            assert!((swept - opened).abs() < 0.25 * swept + 3.0 * H * H, "swept {swept}, opened {opened}");
        }
    }
    cutter.end_stroke(mesh);
    cutter
}

#[test]
fn a_wavy_stroke_right_through_makes_two_fragments_by_every_method() {
    let size = DVec3::new(6.0, 4.0, 4.0) * H;
    let path = wavy(size, 0.7 * H);
    for pattern in PATTERNS {
        let mut meshes = Vec::new();
        for method in METHODS {
            let mut mesh = block([6, 4, 4], H, 0.2);
            let cutter = cut(&mut mesh, method, pattern, 0.0, &path);
            let end = verdict(&mesh);
            assert_eq!(end.fragments, 2, "{method:?} {pattern:?}: {:?}", end.volumes);
            assert!(!cutter.is_cutting());
            meshes.push(places(&mesh));
        }
        assert_eq!(meshes[0], meshes[1], "{pattern:?}: progressive and non-progressive end in different meshes");
        assert_eq!(meshes[0], meshes[2], "{pattern:?}: progressive and hybrid end in different meshes");
    }
}

#[test]
fn with_snapping_too() {
    let size = DVec3::new(6.0, 4.0, 4.0) * H;
    let path = wavy(size, 0.7 * H);
    for method in METHODS {
        for pattern in PATTERNS {
            for jitter in [0.0, 0.2] {
                let mut mesh = block([6, 4, 4], H, jitter);
                cut(&mut mesh, method, pattern, 0.2, &path);
                let end = verdict(&mesh);
                assert_eq!(end.fragments, 2, "{method:?} {pattern:?} {jitter}: {:?}", end.volumes);
            }
        }
    }
}

/// The tetrahedra by the places of their corners: the same for the same mesh under other ids.
fn places(mesh: &TetMesh) -> Vec<[[u64; 3]; 4]> {
    let mut all: Vec<[[u64; 3]; 4]> = mesh
        .iter()
        .map(|(t, _)| {
            let mut p = mesh.points(t).map(|p| p.to_array().map(f64::to_bits));
            p.sort_unstable();
            p
        })
        .collect();
    all.sort_unstable();
    all
}
