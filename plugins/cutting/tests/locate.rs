//! Where the blade is found in the tissue.
//!
//! Strokes side by side leave slabs that hang on to the block at their feet and their ends. A search for the blade's points that
//! goes from node to node over common tetrahedra, always nearer, stops at the wall of a cut when it comes from the wrong side: in a block of 46
//! cubes an edge, where no landmark was near, all points of later strokes but those at the tip were taken to be outside of the tissue, and the
//! line was led astray.

#[expect(dead_code, reason = "other tests use the rest of it")]
mod common;

use common::{block, settings};
use keyhole_cutting::material_map::{MaterialMap, Tissue, WorldLine};
use keyhole_cutting::{BladeId, Cutter};
use keyhole_tetmesh::{DVec3, NodeEdit};
use keyhole_whiteboard::{CutMethod, CutPattern};

const H: f64 = 0.004;

#[test]
fn a_blade_between_two_cuts_is_found_where_it_is() {
    let size = [46, 10, 46];
    let mut mesh = block(size, H, 0.2);
    let mut cutter = Cutter::new(&mesh);
    cutter.set_settings(settings(CutMethod::Progressive, CutPattern::Minimal, 0.2));
    let mut positions: Vec<_> = mesh.rest_positions().iter().map(|p| p.as_vec3()).collect();
    let mut velocities = vec![Default::default(); positions.len()];
    let mut inside = 0;
    for z in (0..12).map(|i| 0.73 + 0.77 * f64::from(i)) {
        let mut map = MaterialMap::default();
        let place = |x: f64, tip: f64| {
            let z = z + 0.3 * (0.9 * x).sin();
            WorldLine { tip: DVec3::new(x, tip, z) * H, heel: DVec3::new(x + 0.2, tip + 7.1, z + 0.2) * H }
        };
        let down = (0..=24).map(|i| place(1.3, 11.03 - 0.25 * f64::from(i)));
        let along = (1..=29).map(|i| place(1.3 + 0.25 * f64::from(i), 5.03));
        for line in down.chain(along) {
            let tissue = Tissue { positions: &positions, velocities: &velocities, dt_s: 1.0 / 60.0 };
            let (steps, _) = map.steps(&mesh, &cutter, tissue, line);
            if let Some(found) = steps.last() {
                for (i, rest) in found.iter().enumerate() {
                    let point = line.tip.lerp(line.heel, i as f64 / (found.len() - 1) as f64);
                    if cutter.tet_at(&mesh, point).is_some() {
                        inside += 1;
                        assert!(point.distance(*rest) < 1e-4 * H, "z {z} point {i} at {} is taken to be at {}", point / H, *rest / H);
                    }
                }
            }
            for step in steps {
                cutter.advance(&mut mesh, BladeId(0), &step);
            }
            for edit in mesh.take_delta().nodes {
                let (NodeEdit::Added { node, .. } | NodeEdit::Moved { node, .. } | NodeEdit::Split { node, .. }) = edit else { continue };
                positions.resize(mesh.node_slots(), Default::default());
                velocities.resize(mesh.node_slots(), Default::default());
                positions[node.index()] = mesh.rest(node).as_vec3();
            }
        }
        cutter.end_stroke(&mut mesh);
    }
    assert!(inside > 1000, "only {inside} points of the blade were in the tissue");
}
