//! Motion: momentum, free fall, repeatability, recovery.

use crate::common::{random, run, separate, slit, split_edge, split_edges};
use bevy_math::Vec3;
use keyhole_tetmesh::{NodeId, TetMesh};
use keyhole_tissue::adopt::adopt;
use keyhole_tissue::beam::{GRAVITY, beam, beam_material, block, clamp, tip_mm};
use keyhole_tissue::{Body, Guard, Momentum, TimeStepping, TissueSettings};
use keyhole_whiteboard::TissueState;

/// Both ways of stepping, 20 substeps in vacuum.
fn every() -> [TissueSettings; 2] {
    let two_stages = TissueSettings { substeps: 20, drag_1_s: 0.0, ..Default::default() };
    [two_stages, TissueSettings { stepping: TimeStepping::TwoSteps, ..two_stages }]
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

/// The centre of mass of a free body falls by `g t^2 / 2`.
#[test]
fn free_fall() {
    let mesh = beam(6, 3);
    let mut body = Body::new(&mesh, &beam_material()).unwrap();
    for settings in every() {
        let stepping = settings.stepping;
        let mut state = TissueState::at_rest(&mesh);
        let start = centre(&body, &state);
        run(&mut body, &mut state, &[], GRAVITY, &settings, 60);
        let fall = start.y - centre(&body, &state).y;
        assert!((f64::from(fall) / 4.905 - 1.0).abs() < 3e-5, "{stepping:?}: {fall} m");
        assert!(body.elastic_energy(&state).abs() < 1e-6, "nothing is strained by falling");
    }
}

/// A free body in vacuum keeps its linear momentum to rounding and its angular momentum to the order of the step, across cuts as well.
#[test]
fn momentum_stays_across_cuts() {
    for settings in every() {
        let stepping = settings.stepping;
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
            run(&mut body, &mut state, &[], Vec3::ZERO, &settings, 1);
        }
        let end = body.momentum(&state);
        assert!((end.linear - start.linear).length() < 1e-5 * start.scale, "{stepping:?}: linear {} from {}", end.linear, start.linear);
        // About the moving centre of mass.
        let spin = |m: &Momentum, c: Vec3| m.angular - c.as_dvec3().cross(m.linear);
        let begin = spin(&start, centre(&Body::new(&beam(8, 4), &beam_material()).unwrap(), &stirred(&beam(8, 4))));
        let now = spin(&end, centre(&body, &state));
        assert!((now - begin).length() < 0.05 * begin.length(), "{stepping:?}: angular {now} from {begin}");
    }
}

/// The same bits twice, and on one thread as on two, held and free, on a mesh that is large enough to be shared out.
#[test]
fn same_bits_whatever_the_threads() {
    let mesh = beam(16, 8);
    let body = Body::new(&mesh, &beam_material()).unwrap();
    for settings in every() {
        for holds in [clamp(&mesh), Vec::new()] {
            let bits = |threads: usize| -> Vec<[u32; 3]> {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                pool.install(|| {
                    let mut state = stirred(&mesh);
                    let settings = TissueSettings { substeps: 2, ..settings };
                    run(&mut body.clone(), &mut state, &holds, GRAVITY, &settings, 8);
                    state.positions.iter().map(|p| p.to_array().map(f32::to_bits)).collect()
                })
            };
            let one = bits(1);
            assert_eq!(one, bits(1), "{settings:?} twice");
            assert_eq!(one, bits(2), "{settings:?} on 1 and 2 threads");
            assert_eq!(one, bits(3), "{settings:?} on 1 and 3 threads");
        }
    }
}

/// A node pushed through the opposite faces of its tetrahedra comes back, and so does a beam whose free nodes are all scrambled, all in one
/// point, mirrored or pressed flat: with the default settings to where it hangs.
#[test]
fn recovers_from_inversion() {
    let mesh = beam(10, 5);
    let (_, c) = mesh.iter().nth(600).unwrap();
    let rest = TissueState::at_rest(&mesh);
    let through = (rest.position(c[1]) + rest.position(c[2]) + rest.position(c[3])) / 3.0 * 2.0 - rest.position(c[0]);
    let mut r = random();
    let mut scrambled = || Vec3::new(r() * 0.06, r() * 0.03, r() * 0.03);
    let mut broken: Vec<(&str, Box<dyn FnMut(usize, Vec3) -> Vec3>)> = vec![
        ("one node", Box::new(|i, p| if i == c[0].index() { through } else { p })),
        ("scrambled", Box::new(|_, _| scrambled())),
        ("in one point", Box::new(|_, _| Vec3::new(0.03, 0.015, 0.015))),
        ("mirrored", Box::new(|_, p| Vec3::new(-p.x, p.y, p.z))),
        ("flat", Box::new(|_, p| Vec3::new(p.x, p.y, 0.015))),
    ];
    for (name, place) in &mut broken {
        let mut start = TissueState::at_rest(&mesh);
        for (i, p) in start.positions.iter_mut().enumerate().filter(|(_, p)| p.x > 0.0) {
            *p = place(i, *p);
        }
        for stepping in [TimeStepping::TwoStages, TimeStepping::TwoSteps] {
            let (mut body, mut state) = (Body::new(&mesh, &beam_material()).unwrap(), start.clone());
            let settings = TissueSettings { stepping, drag_1_s: 6.0, ..Default::default() };
            run(&mut body, &mut state, &clamp(&mesh), GRAVITY, &settings, 240);
            let turned = |t: usize, c: [NodeId; 4]| body.elements()[t].deformation(c.map(|n| state.position(n))).determinant() <= 0.0;
            assert_eq!(mesh.iter().filter(|(t, c)| turned(t.index(), *c)).count(), 0, "{name}, {stepping:?}");
            let tip = tip_mm(&mesh, &state);
            assert!((tip / -21.763 - 1.0).abs() < 1e-3, "{name}, {stepping:?}: {tip} mm");
        }
    }
}

/// Halving the step quarters the error of the way of the tip: both ways of stepping are of second order, drag and viscosity included, and go the same way.
#[test]
fn second_order_in_time() {
    let mesh = beam(6, 3);
    let body = Body::new(&mesh, &beam_material()).unwrap();
    let way = |stepping: TimeStepping, substeps: u32| {
        let damping = TissueSettings { drag_1_s: 4.0, viscosity_s: 0.004, ..Default::default() };
        let settings = TissueSettings { stepping, substeps, tolerance: 1e-4, iterations: 200, ..damping };
        let (mut body, mut state) = (body.clone(), TissueState::at_rest(&mesh));
        (0..12)
            .map(|_| {
                run(&mut body, &mut state, &clamp(&mesh), GRAVITY, &settings, 1);
                tip_mm(&mesh, &state)
            })
            .collect::<Vec<_>>()
    };
    let exact = way(TimeStepping::TwoStages, 64);
    for (stepping, substeps) in [(TimeStepping::TwoStages, 2), (TimeStepping::TwoSteps, 4)] {
        let error = |substeps: u32| way(stepping, substeps).iter().zip(&exact).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        let (coarse, fine) = (error(substeps), error(2 * substeps));
        assert!(coarse > 3.0 * fine, "{stepping:?}: {coarse} mm with {substeps} substeps, {fine} mm with twice as many");
    }
}

/// A beam that hangs is slit to half its height: the body that adopted the cut goes the way of one built from the slit mesh, and hangs where it does.
#[test]
fn a_slit_beam_goes_on() {
    let mut mesh = beam(10, 5);
    let mut body = Body::new(&mesh, &beam_material()).unwrap();
    let mut state = TissueState::at_rest(&mesh);
    run(&mut body, &mut state, &clamp(&mesh), GRAVITY, &TissueSettings { drag_1_s: 8.0, ..Default::default() }, 120);
    let whole = tip_mm(&mesh, &state);
    slit(&mut mesh, 0.03, 0.015);
    let delta = mesh.take_delta();
    adopt(&mut body, &mut state, &mesh, &delta, |_| Momentum::default());
    let mut fresh = Body::new(&mesh, &beam_material()).unwrap();
    let mut other = state.clone();
    for tick in 0..180 {
        run(&mut body, &mut state, &clamp(&mesh), GRAVITY, &TissueSettings::default(), 1);
        let exact = TissueSettings { tolerance: 1e-3, ..Default::default() };
        run(&mut fresh, &mut other, &clamp(&mesh), GRAVITY, &exact, 1);
        let (adopted, built) = (tip_mm(&mesh, &state), tip_mm(&mesh, &other));
        assert!((adopted - built).abs() < 0.02 * built.abs(), "tick {tick}: {adopted} mm, {built} mm");
    }
    assert!(tip_mm(&mesh, &state) < 1.2 * whole, "it hangs lower than before it was slit");
}

/// Iterations of conjugate gradients do not grow with the mesh, nor by a cut.
#[test]
fn iterations_stay() {
    let iterations = |n: u32, m: u32, cut: bool| {
        let mut mesh = beam(n, m);
        let mut body = Body::new(&mesh, &beam_material()).unwrap();
        let mut state = TissueState::at_rest(&mesh);
        if cut {
            slit(&mut mesh, 0.03, 0.015);
            split_edges(&mut mesh, 9, 0.3);
            let delta = mesh.take_delta();
            adopt(&mut body, &mut state, &mesh, &delta, |_| Momentum::default());
        }
        let settings = TissueSettings { tolerance: 0.01, iterations: 500, ..Default::default() };
        (0..10)
            .map(|_| {
                run(&mut body, &mut state, &clamp(&mesh), GRAVITY, &settings, 1);
                body.solver_report().0
            })
            .sum::<u32>()
    };
    let (coarse, fine, cut) = (iterations(8, 4, false), iterations(16, 8, false), iterations(16, 8, true));
    assert!(fine < 2 * coarse, "{coarse} on 640 tetrahedra, {fine} on 5120");
    assert!(cut < 2 * fine, "{fine} whole, {cut} cut");
}

/// A hundred cuts, slits that deepen and edges that are split, leave about as many clusters and iterations as the body of the final mesh has.
#[test]
fn clusters_stay_by_a_hundred_cuts() {
    let mut mesh = beam(16, 8);
    let mut body = Body::new(&mesh, &beam_material()).unwrap();
    let mut state = TissueState::at_rest(&mesh);
    let mut r = random();
    for cut in 0..100 {
        let (section, depth) = (cut % 14 + 1, cut / 14 + 1);
        if depth < 6 {
            slit(&mut mesh, 0.06 * f64::from(section) / 16.0, 0.03 * (1.0 - f64::from(depth) / 8.0) - 1e-4);
        }
        for _ in 0..4 {
            let (_, c) = mesh.iter().nth((r() * mesh.tet_count() as f32) as usize).unwrap();
            split_edge(&mut mesh, c[0], c[1], 0.4);
        }
        let delta = mesh.take_delta();
        adopt(&mut body, &mut state, &mesh, &delta, |_| Momentum::default());
    }
    let mut fresh = Body::new(&mesh, &beam_material()).unwrap();
    let ((small, large), (few, fewest)) = (body.solver_clusters(), fresh.solver_clusters());
    assert!(2 * small < 3 * few && 2 * large < 3 * fewest, "{small} and {large} clusters, {few} and {fewest} of a fresh body");
    let iterations = |body: &mut Body| {
        let mut state = state.clone();
        let settings = TissueSettings { tolerance: 0.01, iterations: 500, ..Default::default() };
        let mut tick = || {
            run(body, &mut state, &clamp(&mesh), GRAVITY, &settings, 1);
            body.solver_report().0
        };
        (0..10).map(|_| tick()).sum::<u32>()
    };
    let (cut, built) = (iterations(&mut body), iterations(&mut fresh));
    assert!(2 * cut < 3 * built, "{cut} iterations, {built} of a fresh body");
}

/// A body that is still is left alone, to the bit, until something about it changes.
#[test]
fn still_bodies_sleep() {
    let mesh = beam(6, 3);
    let mut body = Body::new(&mesh, &beam_material()).unwrap();
    let mut state = TissueState::at_rest(&mesh);
    let (mut holds, settings) = (clamp(&mesh), TissueSettings { drag_1_s: 8.0, ..Default::default() });
    run(&mut body, &mut state, &holds, GRAVITY, &settings, 20);
    assert!(!body.is_asleep(&state, &holds, GRAVITY), "it swings");
    run(&mut body, &mut state, &holds, GRAVITY, &settings, 400);
    assert!(body.is_asleep(&state, &holds, GRAVITY));
    let asleep = tip_mm(&mesh, &state);
    let before = state.clone();
    run(&mut body, &mut state, &holds, GRAVITY, &settings, 10);
    assert_eq!(state, before);
    // It slept where it would have come to rest.
    let awake = TissueSettings { sleep: false, ..settings };
    body.wake();
    run(&mut body, &mut state, &holds, GRAVITY, &awake, 240);
    assert!((tip_mm(&mesh, &state) / asleep - 1.0).abs() < 1e-3, "{} mm awake, {asleep} mm asleep", tip_mm(&mesh, &state));
    // A hold that goes wakes it.
    run(&mut body, &mut state, &holds, GRAVITY, &settings, 60);
    assert!(body.is_asleep(&state, &holds, GRAVITY));
    holds.pop();
    assert!(!body.is_asleep(&state, &holds, GRAVITY));
    assert!(!body.is_asleep(&state, &clamp(&mesh), -GRAVITY));
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
