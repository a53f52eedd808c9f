//! Motion: momentum, free fall, repeatability, recovery.

use crate::common::{random, run, separate, split_edge, split_edges};
use bevy_math::Vec3;
use keyhole_tetmesh::{NodeId, TetMesh};
use keyhole_tissue::adopt::adopt;
use keyhole_tissue::beam::{GRAVITY, beam, beam_material, block, clamp, tip_mm};
use keyhole_tissue::{Body, Guard, Momentum, Solver, TissueSettings};
use keyhole_whiteboard::TissueState;

const SOLVERS: [Solver; 2] = [Solver::Implicit, Solver::Xpbd];

fn settings(solver: Solver) -> TissueSettings {
    TissueSettings { solver, substeps: 20, drag_1_s: 0.0, ..Default::default() }
}

/// Extended position-based dynamics takes velocities from differences of positions, in f32.
fn rounding(solver: Solver) -> f64 {
    match solver {
        Solver::Implicit => 1e-5,
        Solver::Xpbd => 2e-3,
    }
}

/// Spinning, stretched and flying.
fn stirred(mesh: &TetMesh) -> TissueState {
    let mut state = TissueState::at_rest(mesh);
    for (x, v) in state.positions.iter_mut().zip(&mut state.velocities) {
        *v = Vec3::new(0.0, 0.0, 5.0).cross(*x) + Vec3::new(0.3, 0.2, -0.1) + Vec3::new(4.0 * x.x, 0.0, -2.0 * x.z);
    }
    state
}

fn centre(body: &Body, state: &TissueState) -> Vec3 {
    let weighted = body.masses().iter().zip(&state.positions).map(|(m, x)| x.as_dvec3() * f64::from(*m));
    (weighted.sum::<bevy_math::DVec3>() / body.momentum(state).mass).as_vec3()
}

/// The centre of mass of a free body falls by `g t^2 / 2`; extended position-based dynamics adds the error `g t h / 2` of symplectic Euler.
#[test]
fn free_fall() {
    let mesh = beam(6, 3);
    let mut body = Body::new(&mesh, &beam_material()).unwrap();
    for solver in SOLVERS {
        let mut state = TissueState::at_rest(&mesh);
        let start = centre(&body, &state);
        run(&mut body, &mut state, &[], GRAVITY, &settings(solver), 60);
        let fall = start.y - centre(&body, &state).y;
        let euler = if solver == Solver::Xpbd { 9.81 / 2.0 / (60.0 * 20.0) } else { 0.0 };
        let expected: f64 = 9.81 / 2.0 + euler;
        assert!((f64::from(fall) - expected).abs() < rounding(solver) * expected, "{solver:?}: {fall} m, expected {expected} m");
        assert!(body.elastic_energy(&state).abs() < 1e-6, "nothing is strained by falling");
    }
}

/// A free body in vacuum keeps its linear momentum to rounding and its angular momentum to the order of the step, across cuts as well.
#[test]
fn momentum_stays_across_cuts() {
    for solver in SOLVERS {
        let mut mesh = beam(8, 4);
        let mut body = Body::new(&mesh, &beam_material()).unwrap();
        let mut state = stirred(&mesh);
        let start = body.momentum(&state);
        for tick in 0..30 {
            if tick == 10 {
                let (_, c) = mesh.iter().nth(100).unwrap();
                split_edge(&mut mesh, c[0], c[1], 0.3);
            }
            if tick == 20 {
                separate(&mut mesh, 0.03);
            }
            let delta = mesh.take_delta();
            if !delta.is_empty() {
                let before = body.momentum(&state);
                let adopted = adopt(&mut body, &mut state, &mesh, &delta, |_| Momentum::default());
                let after = body.momentum(&state);
                assert!((after.linear - before.linear).length() < 1e-6 * before.scale, "tick {tick}: linear");
                assert!((after.mass / before.mass - 1.0).abs() < 1e-6, "tick {tick}: mass");
                assert!(adopted.relative_error() < 1e-6, "{adopted:?}");
            }
            run(&mut body, &mut state, &[], Vec3::ZERO, &settings(solver), 1);
        }
        let end = body.momentum(&state);
        assert!(
            (end.linear - start.linear).length() < rounding(solver) * start.scale,
            "{solver:?}: linear {} from {}",
            end.linear,
            start.linear
        );
        // About the moving centre of mass.
        let spin = |m: &Momentum, c: Vec3| m.angular - c.as_dvec3().cross(m.linear);
        let begin = spin(&start, centre(&Body::new(&beam(8, 4), &beam_material()).unwrap(), &stirred(&beam(8, 4))));
        let now = spin(&end, centre(&body, &state));
        assert!((now - begin).length() < 0.05 * begin.length(), "{solver:?}: angular {now} from {begin}");
    }
}

/// The same bits twice, and on one thread as on two.
#[test]
fn same_bits_whatever_the_threads() {
    let mesh = beam(6, 3);
    let mut body = Body::new(&mesh, &beam_material()).unwrap();
    for solver in SOLVERS {
        let bits = |threads: usize| -> Vec<[u32; 3]> {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let mut state = stirred(&mesh);
                run(&mut body.clone(), &mut state, &clamp(&mesh), GRAVITY, &settings(solver), 30);
                state.positions.iter().map(|p| p.to_array().map(f32::to_bits)).collect()
            })
        };
        assert_eq!(bits(1), bits(1), "{solver:?} twice");
        assert_eq!(bits(1), bits(2), "{solver:?} on 1 and 2 threads");
    }
}

/// A node pushed through the opposite faces of its tetrahedra comes back, and so does a beam whose free nodes are all scrambled.
#[test]
fn recovers_from_inversion() {
    for solver in SOLVERS {
        let mesh = beam(10, 5);
        let mut body = Body::new(&mesh, &beam_material()).unwrap();
        for scrambled in [false, true] {
            let mut state = TissueState::at_rest(&mesh);
            if scrambled {
                let mut r = random();
                for p in state.positions.iter_mut().filter(|p| p.x > 0.0) {
                    *p = Vec3::new(r() * 0.06, r() * 0.03, r() * 0.03);
                }
            } else {
                let (_, c) = mesh.iter().nth(600).unwrap();
                state.positions[c[0].index()] =
                    (state.position(c[1]) + state.position(c[2]) + state.position(c[3])) / 3.0 * 2.0 - state.position(c[0]);
            }
            let settings = TissueSettings { drag_1_s: 6.0, ..settings(solver) };
            run(&mut body, &mut state, &clamp(&mesh), GRAVITY, &settings, 240);
            let inverted = mesh
                .iter()
                .filter(|(t, _)| body.elements()[t.index()].deformation(mesh.corners(*t).map(|n| state.position(n))).determinant() <= 0.0);
            assert_eq!(inverted.count(), 0, "{solver:?}, scrambled {scrambled}");
            let tip = tip_mm(&mesh, &state);
            assert!((tip / -21.763 - 1.0).abs() < 0.01, "{solver:?}, scrambled {scrambled}: {tip} mm");
        }
    }
}

/// A state that leaves the finite numbers is put back, at rest, and the node is named.
#[test]
fn non_finite_state_is_put_back() {
    let mesh = block([2, 2, 2], [0.02, 0.02, 0.02]);
    let mut body = Body::new(&mesh, &beam_material()).unwrap();
    let mut state = TissueState::at_rest(&mesh);
    let mut guard = Guard::default();
    assert_eq!(guard.check(&mut state), None);
    let before = state.positions.clone();
    state.velocities[5] = Vec3::new(f32::INFINITY, 0.0, 0.0);
    body.step(&mut state, &[], GRAVITY, 1.0 / 60.0, &TissueSettings::default());
    assert!(guard.check(&mut state).is_some());
    assert_eq!(state.positions, before);
    assert!(state.velocities.iter().all(|v| *v == Vec3::ZERO));
}

/// Adopting deltas one after the other gives the body that the final mesh gives from scratch.
#[test]
fn adopting_equals_rebuilding() {
    let mut mesh = beam(6, 3);
    let mut body = Body::new(&mesh, &beam_material()).unwrap();
    let mut state = stirred(&mesh);
    let survivors: Vec<(NodeId, Vec3)> = mesh.nodes().map(|n| (n, state.position(n))).collect();
    for round in 0..4 {
        match round {
            0 => split_edges(&mut mesh, 9, 0.3),
            1 => separate(&mut mesh, 0.04),
            2 => split_edges(&mut mesh, 11, 0.6),
            _ => {
                // A moved rest node, and a tetrahedron that goes together with the nodes it leaves alone.
                let node = NodeId(40);
                let (_, c) = mesh.iter().find(|(_, c)| c.contains(&node)).unwrap();
                let other = c.into_iter().find(|n| *n != node).unwrap();
                let to = mesh.rest(node) * 0.95 + mesh.rest(other) * 0.05;
                mesh.move_node(node, to, [(node, 0.95), (other, 0.05)].into_iter().collect());
                let (corner, _) =
                    mesh.iter().find(|(t, _)| (0..4).filter(|f| mesh.topology().neighbour(*t, *f).is_none()).count() >= 2).unwrap();
                let nodes = mesh.corners(corner);
                mesh.remove_tet(corner);
                for n in nodes {
                    if mesh.topology().around_node(n).is_empty() {
                        mesh.remove_node(n);
                    }
                }
            }
        }
        let delta = mesh.take_delta();
        adopt(&mut body, &mut state, &mesh, &delta, |_| Momentum::default());
    }
    let rebuilt = Body::new(&mesh, &beam_material()).unwrap();
    assert_eq!(body.elements(), rebuilt.elements());
    assert_eq!(body.masses(), rebuilt.masses());
    let edges = |b: &Body| {
        let mut e: Vec<[u32; 2]> = b.graph().ends().iter().copied().filter(|[i, j]| i != j).collect();
        e.sort_unstable();
        e
    };
    assert_eq!(edges(&body), edges(&rebuilt));
    let mut coloured = 0;
    for colour in body.colouring().colours() {
        let mut nodes: Vec<u32> = colour.iter().flat_map(|t| body.elements()[*t as usize].nodes).collect();
        let all = nodes.len();
        nodes.sort_unstable();
        nodes.dedup();
        assert_eq!(nodes.len(), all, "two elements of a colour share a node");
        coloured += colour.len();
    }
    assert_eq!(coloured, mesh.tet_count());
    for (node, position) in survivors {
        if node != NodeId(40) {
            assert_eq!(state.position(node), position, "node {} stays to the bit", node.0);
        }
    }
}
