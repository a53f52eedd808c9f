//! A body against itself: what is found with a memory is what brute force finds without, tick after tick.

use crate::meshes::{at_rest, block, brute_force};
use bevy_math::{Quat, Vec3};
use keyhole_collision::{Folds, Hit, Shape};
use keyhole_tetmesh::{MaterialId, NodeId, TetId, TetMesh};
use proptest::prelude::*;

fn expected(mesh: &TetMesh, shape: &Shape, positions: &[Vec3]) -> Vec<Hit> {
    let body = keyhole_collision::Body { shape, positions, self_collision: true };
    brute_force(&[body], &[mesh.iter().collect()])
}

/// A number from -1 to 1 that nothing but `n` decides.
fn noise(n: u32) -> f32 {
    let x = n.wrapping_mul(2_654_435_761);
    let x = (x ^ x >> 15).wrapping_mul(2_246_822_519);
    (x ^ x >> 13) as f32 / u32::MAX as f32 * 2.0 - 1.0
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    /// Tetrahedra between random nodes, inverted and flat ones among them, that tremble and jump.
    #[test]
    fn a_soup_that_trembles(
        nodes in prop::collection::vec(prop::array::uniform3((-40i32..40).prop_map(|c| c as f32 / 16.0)).prop_map(Vec3::from_array), 4..60),
        tets in prop::collection::vec(prop::array::uniform4(0u32..1000), 1..90),
        steps in prop::collection::vec((-5i32..1, -1f32..1.0), 1..6),
        broken in prop::option::of(0usize..60),
    ) {
        let count = nodes.len() as u32;
        let tets: Vec<[u32; 4]> = tets.iter().map(|t| t.map(|n| n % count)).filter(|t| (0..4).all(|i| !t[..i].contains(&t[i]))).collect();
        let mesh = TetMesh::new(nodes.iter().map(|p| p.as_dvec3()).collect(), &tets, &[] as &[MaterialId]);
        let (shape, mut positions) = (Shape::of(&mesh), nodes);
        let mut folds = Folds::of(&mesh, &shape);
        for (step, (exponent, turn)) in steps.into_iter().enumerate() {
            prop_assert_eq!(folds.detect(&shape, &positions, 0), expected(&mesh, &shape, &positions));
            for (n, x) in positions.iter_mut().enumerate() {
                let of = |k: usize| noise((n * 3 + k + step * 7919) as u32);
                *x = Quat::from_rotation_y(turn) * *x + 10f32.powi(exponent) * Vec3::new(of(0), of(1), of(2));
            }
            if let Some(n) = broken.filter(|n| step == 2 && *n < positions.len()) {
                positions[n].z = f32::NAN;
            }
        }
    }
}

/// A strip that is rolled up little by little until it lies in itself, with tetrahedra that go and come meanwhile, on several threads.
#[test]
fn a_strip_that_rolls_up_while_it_is_cut() {
    let mut mesh = block([30, 2, 4], [0.1, 0.005, 0.013]);
    let mut shape = Shape::of(&mesh);
    let mut folds = Folds::of(&mesh, &shape);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
    let (mut hits, mut calm) = (0, 0);
    for step in 0..90u32 {
        // A spiral that grows from turn to turn by less than the strip is thick.
        let curl = 0.21 * step.min(50) as f32;
        let positions: Vec<Vec3> = at_rest(&mesh)
            .into_iter()
            .map(|p| {
                let (angle, radius) = (curl * p.x / 0.1, 0.1 / curl.max(1e-3) + 0.0005 * curl * p.x / 0.1 - p.y);
                if step == 0 { p } else { Vec3::new(radius * angle.sin(), -radius * angle.cos(), p.z + 0.02 * p.y * angle.sin()) }
            })
            .collect();
        let found = pool.install(|| folds.detect(&shape, &positions, 0).to_vec());
        let right = expected(&mesh, &shape, &positions);
        let odd: Vec<_> = found.iter().chain(&right).filter(|h| found.contains(h) != right.contains(h)).collect();
        assert!(odd.is_empty(), "step {step}: {odd:?}");
        assert!(step > 0 || found.is_empty(), "a strip at rest lies beside itself");
        hits += found.len();
        calm += folds.restless().1 - folds.restless().0;
        if step % 24 == 1 {
            for k in 0..4u32 {
                let all: Vec<TetId> = mesh.iter().map(|(t, _)| t).collect();
                let tet = all[(step * 7919 + k * 104_729) as usize % all.len()];
                let (corners, attributes) = (mesh.corners(tet), mesh.tet(tet));
                mesh.remove_tet(tet);
                if k % 2 == 0 {
                    let apex = mesh.split_node(corners[3]);
                    mesh.add_tet([corners[0], corners[1], corners[2], apex], attributes);
                }
            }
            let delta = mesh.take_delta();
            let touched = shape.update(&mesh, &delta);
            folds.update(&mesh, &shape, &delta, &touched);
        }
    }
    assert!(hits > 1000 && calm > 300, "{hits} hits, {calm} patches not looked at");
}

/// Every tetrahedron is in one patch, and the lists of nodes are those of the patch's tetrahedra, whatever has been cut.
#[test]
fn patches_are_carried_over_deltas() {
    let mut mesh = block([7, 6, 5], [1.0; 3]);
    let mut shape = Shape::of(&mesh);
    let mut patches = keyhole_collision::Patches::of(&mesh, &shape);
    for round in 0..30u32 {
        for k in 0..25u32 {
            let all: Vec<TetId> = mesh.iter().map(|(t, _)| t).collect();
            let tet = all[(round * 331 + k * 7) as usize % all.len()];
            let (corners, attributes) = (mesh.corners(tet), mesh.tet(tet));
            mesh.remove_tet(tet);
            // Four in the place of one, or none.
            if k % 8 != 0 {
                let middle = mesh.points(all[0]).iter().sum::<keyhole_tetmesh::DVec3>() / 4.0;
                let apex = mesh.add_node(middle, corners.iter().map(|n| (*n, 0.25)).collect());
                for i in 0..4 {
                    let mut part = corners;
                    part[i] = apex;
                    mesh.add_tet(part, attributes);
                }
            }
        }
        let delta = mesh.take_delta();
        let touched = shape.update(&mesh, &delta);
        patches.update(&mesh, &shape, &delta, &touched);
        let mut seen: Vec<TetId> = patches.list().iter().flat_map(|p| p.tets.clone()).collect();
        seen.sort_unstable();
        assert_eq!(seen, mesh.iter().map(|(t, _)| t).collect::<Vec<_>>());
        for patch in patches.list() {
            assert!(patch.tets.len() <= 96, "{} tetrahedra", patch.tets.len());
            let mut nodes: Vec<NodeId> = patch.tets.iter().flat_map(|t| mesh.corners(*t)).collect();
            nodes.sort_unstable();
            nodes.dedup();
            let around = nodes.iter().flat_map(|n| mesh.topology().around_node(*n)).flat_map(|t| mesh.corners(*t));
            let mut near: Vec<NodeId> = around.filter(|n| mesh.topology().is_boundary_node(*n)).collect();
            near.sort_unstable();
            near.dedup();
            assert_eq!(patch.nodes, nodes);
            assert!(near.iter().all(|n| patch.near.contains(n)));
        }
    }
}
