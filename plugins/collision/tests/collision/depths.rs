//! Penetration depths against closed forms, and walks against the surface's triangles.

use crate::meshes::{Thing, block};
use bevy_math::{Quat, Vec3};
use keyhole_collision::{Deformed, Depths, Detector, Grading, Hit, Penetration};
use keyhole_tetmesh::Boundary;
use proptest::prelude::*;

fn deformed(thing: &Thing) -> Deformed<'_> {
    Deformed { topology: thing.mesh.topology(), positions: &thing.positions }
}

/// The depths of the nodes of one thing in another.
fn depths(nodes: &Thing, tets: &Thing) -> Vec<Penetration> {
    let mut detector = Detector::default();
    let hits = detector.detect(&[nodes.body(false), tets.body(false)], Grading::Hierarchical);
    let hits: Vec<Hit> = hits.iter().filter(|h| h.node_body == 0).copied().collect();
    Depths::default().estimate(deformed(nodes), deformed(tets), &hits).to_vec()
}

/// A block pressed flat into the top of a larger one: every depth is the distance to the top, and every way out is up, wherever all is turned to.
#[test]
fn a_block_pressed_into_another_goes_out_the_way_it_came() {
    let turn = Quat::from_rotation_x(0.7) * Quat::from_rotation_z(-1.1);
    let large = Thing::new(block([6; 3], [0.06; 3]), |p| turn * p);
    for sunk in [0.001_f32, 0.009, 0.017] {
        let small = Thing::new(block([5; 3], [0.025; 3]), |p| turn * (p + Vec3::new(0.0171, 0.06 - sunk, 0.0187)));
        let found = depths(&small, &large);
        // Layers of nodes are 5 mm apart.
        assert_eq!(found.len(), 36 * (1 + (sunk / 0.005) as usize), "sunk {sunk}");
        for p in found {
            let height = (turn.inverse() * small.positions[p.node.index()]).y;
            assert!((p.depth_m - (0.06 - height)).abs() < 1e-6 && (p.direction - turn * Vec3::Y).length() < 1e-5, "{p:?} at {height}");
        }
    }
}

/// A block wholly inside another has no border. All of it goes out the same way, the shortest one.
#[test]
fn a_block_wholly_inside_another_is_led_out_as_one() {
    let small = Thing::new(block([2; 3], [0.01; 3]), |p| p + Vec3::new(0.0203, 0.0391, 0.0307));
    let found = depths(&small, &Thing::new(block([6; 3], [0.06; 3]), |p| p));
    assert_eq!(found.len(), 27, "every node");
    for p in found {
        let height = small.positions[p.node.index()].y;
        assert_eq!(p.direction, Vec3::Y);
        assert!((p.depth_m - (0.06 - height)).abs() < 1e-6, "{p:?} at {height}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Moved by its depths again and again, a block that was wholly inside another comes out, from wherever it was, and takes no detour.
    #[test]
    fn what_is_wholly_inside_gets_out(place in prop::array::uniform3(0.001f32..0.049), angle in 0f32..6.0) {
        let large = Thing::new(block([6; 3], [0.06; 3]), |p| p);
        let middle = Vec3::splat(0.005);
        let turn = Quat::from_rotation_y(angle) * Quat::from_rotation_x(0.5 * angle);
        let mut small = Thing::new(block([2; 3], [0.01; 3]), |p| turn * (p - middle) + middle + Vec3::from_array(place));
        let mut way = 0.0;
        loop {
            let found = depths(&small, &large);
            if found.is_empty() {
                break;
            }
            let direction = found.iter().map(|p| p.direction).sum::<Vec3>().normalize_or(Vec3::Y);
            let depth = found.iter().map(|p| p.depth_m).sum::<f32>() / found.len() as f32;
            let step = direction * depth.clamp(1e-4, 0.002);
            way += step.length();
            prop_assert!(way < 0.06, "still {} nodes inside after {way} m", found.len());
            small.positions.iter_mut().for_each(|x| *x += step);
        }
    }

    /// A walk ends where the line first crosses a triangle of the surface.
    #[test]
    fn a_walk_leaves_where_the_line_crosses_the_surface(seed in prop::collection::vec(-1f32..1.0, 12), begin in 0usize..135, to in prop::array::uniform3(-0.05f32..0.08)) {
        // A block bent and stretched smoothly, so that nothing is inverted.
        let bend = |p: Vec3| {
            let q = p * 60.0;
            p + 0.002 * Vec3::new((q.y + seed[0]).sin(), (q.z + seed[1]).sin(), (q.x + seed[2]).sin())
        };
        let thing = Thing::new(block([3; 3], [0.03; 3]), bend);
        let (tet, corners) = thing.mesh.iter().nth(begin).unwrap();
        let from = corners.iter().map(|n| thing.positions[n.index()]).sum::<Vec3>() / 4.0;
        let to = Vec3::from_array(to);
        let crossing = |t: &[keyhole_tetmesh::NodeId; 3]| {
            let [a, b, c] = t.map(|n| thing.positions[n.index()].as_dvec3());
            let (from, way) = (from.as_dvec3(), (to - from).as_dvec3());
            let normal = (b - a).cross(c - a);
            let s = (a - from).dot(normal) / way.dot(normal);
            let x = from + way * s;
            let within = [(a, b), (b, c), (c, a)].iter().all(|(p, q)| (*q - *p).cross(x - *p).dot(normal) >= -1e-9 * normal.length_squared());
            ((0.0..=1.0).contains(&s) && within).then_some((s, normal.normalize()))
        };
        let first = Boundary::of(&thing.mesh).triangles.iter().filter_map(crossing).min_by(|a, b| a.0.total_cmp(&b.0));
        let exit = deformed(&thing).exit(tet, from, to);
        prop_assert_eq!(exit.is_some(), first.is_some());
        if let (Some(exit), Some((s, normal))) = (exit, first) {
            prop_assert!((f64::from(exit.part) - s).abs() < 1e-4, "{} {s}", exit.part);
            prop_assert!((exit.normal.as_dvec3() - normal).length() < 1e-3 || (s - 1.0).abs() < 1e-5, "{exit:?} {normal}");
        }
    }
}
