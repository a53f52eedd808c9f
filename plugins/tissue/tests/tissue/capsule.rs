//! The capsule: what it does to an organ, and what a cut leaves of it.

use crate::common::{separate, slit, split_edge};
use bevy_math::{DVec3, Vec3};
use keyhole_tetmesh::{Boundary, NodeId, TetMesh};
use keyhole_tissue::adopt::adopt;
use keyhole_tissue::beam::{GRAVITY, beam, beam_material, block, clamp, tip_mm};
use keyhole_tissue::reference::{Problem, Statics, equilibrium};
use keyhole_tissue::{
    Body, Capsule, Membrane, ModelState, Momentum, TeschnerSettings, TissueModel, TissueSettings, VbdSettings, XpbdSettings,
};
use keyhole_whiteboard::TissueState;

/// About as stiff as the beam that it is on.
const SOFT: Capsule = Capsule { young_modulus_pa: 100_000.0, poisson_ratio: 0.45, thickness_m: 5e-4 };

/// Where the tip hangs by the reference, mm.
fn hang(mesh: &TetMesh, membrane: Option<Membrane>) -> f64 {
    let mut problem = Problem::new(mesh, &beam_material(), |n| mesh.rest(n).x == 0.0).unwrap();
    problem.membrane = membrane;
    let x = equilibrium(&problem, &problem.rest, &problem.weights(DVec3::new(0.0, -9.81, 0.0)), Statics::default()).unwrap();
    let state = TissueState { positions: x.iter().map(|x| x.as_vec3()).collect(), velocities: Vec::new() };
    tip_mm(mesh, &state)
}

/// The simulator's own model hangs as the reference says with the renal capsule too, 1500 times as stiff as the tissue, and after both have been
/// slit: what has been cut pulls no more.
#[test]
fn a_capsule_that_is_cut_pulls_no_more() {
    let mut mesh = beam(8, 4);
    let mut body = Body::new(&mesh, &beam_material()).unwrap();
    let mut model = ModelState::new(TissueModel::Implicit, Some(Capsule::default()), &body, &mesh, &beam_material()).unwrap();
    let mut state = TissueState::at_rest(&mesh);
    let settings = TissueSettings { drag_1_s: 20.0, ..Default::default() };
    let settle = |mesh: &TetMesh, body: &mut Body, model: &mut ModelState, state: &mut TissueState| {
        for _ in 0..120 {
            model.step(body, state, &clamp(mesh), GRAVITY, 1.0 / 60.0, &settings);
        }
        let (tip, expected) = (tip_mm(mesh, state), hang(mesh, model.membrane().cloned()));
        assert!((tip / expected - 1.0).abs() < 0.005, "{tip} mm, the reference {expected}");
        tip
    };
    let whole = settle(&mesh, &mut body, &mut model, &mut state);
    slit(&mut mesh, 0.03, 0.016);
    let delta = mesh.take_delta();
    adopt(&mut body, &mut state, &mesh, &delta, |_| Momentum::default());
    model.adopt(&body, &mesh, &delta);
    let cut = settle(&mesh, &mut body, &mut model, &mut state);
    assert!(cut < 1.5 * whole, "{cut} mm cut, {whole} whole");
}

/// With the capsule the beam hangs where the reference says, which is higher than without.
#[test]
fn every_model_hangs_as_the_reference_with_its_capsule() {
    let mesh = beam(6, 3);
    let (bare, expected) = (hang(&mesh, None), hang(&mesh, Some(Membrane::new(&mesh, SOFT))));
    assert!(expected / bare < 0.7, "{expected} mm, without a capsule {bare}");
    for (model, tolerance) in [
        (TissueModel::Implicit, 0.002),
        (TissueModel::Xpbd(XpbdSettings { substeps: 80, ..Default::default() }), 0.02),
        (TissueModel::Vbd(VbdSettings { iterations: 60, ..Default::default() }), 0.005),
        (TissueModel::Teschner(TeschnerSettings::default()), 0.15),
    ] {
        let mut body = Body::new(&mesh, &beam_material()).unwrap();
        let mut model_state = ModelState::new(model, Some(SOFT), &body, &mesh, &beam_material()).unwrap();
        let mut state = TissueState::at_rest(&mesh);
        let settings = TissueSettings { drag_1_s: 20.0, ..Default::default() };
        for _ in 0..90 {
            model_state.step(&mut body, &mut state, &clamp(&mesh), GRAVITY, 1.0 / 60.0, &settings);
        }
        let tip = tip_mm(&mesh, &state);
        assert!((tip / expected - 1.0).abs() < tolerance, "{model:?}: {tip} mm, the reference {expected}");
    }
}

/// A split edge leaves the area of the capsule as it is; a cut in two gives its faces none; a piece takes its part along; what goes takes its own.
#[test]
fn a_cut_divides_it_and_opens_faces_without() {
    let mut mesh = block([6, 2, 2], [0.06, 0.02, 0.02]);
    let mut membrane = Membrane::new(&mesh, SOFT);
    let area = 2.0 * 0.02 * 0.02 + 4.0 * 0.06 * 0.02;
    assert!((membrane.area() / area - 1.0).abs() < 1e-12);
    // An edge of the surface, and one that dips inside.
    let (_, c) = mesh.iter().find(|(_, c)| (0..2).all(|i| mesh.rest(c[i]).y == 0.0)).unwrap();
    split_edge(&mut mesh, c[0], c[1], 0.4);
    let delta = mesh.take_delta();
    membrane.adopt(&mesh, &delta);
    assert!((membrane.area() / area - 1.0).abs() < 1e-9, "{} m2 after an edge was split", membrane.area());
    separate(&mut mesh, 0.03);
    let delta = mesh.take_delta();
    membrane.adopt(&mesh, &delta);
    assert!((membrane.area() / area - 1.0).abs() < 1e-9, "{} m2 after a cut", membrane.area());
    // The faces of the cut are there, and are no part of it.
    assert!(Boundary::of(&mesh).area(&mesh) > area + 1.99 * 0.02 * 0.02);

    // The outer half as a piece of its own.
    let half: Vec<_> = mesh.iter().filter(|(t, _)| mesh.points(*t).iter().map(|p| p.x).sum::<f64>() / 4.0 > 0.03).collect();
    let mut nodes: Vec<NodeId> = half.iter().flat_map(|(_, c)| *c).collect();
    nodes.sort_unstable();
    nodes.dedup();
    let own = |n: NodeId| nodes.binary_search(&n).unwrap() as u32;
    let tets: Vec<[u32; 4]> = half.iter().map(|(_, c)| c.map(own)).collect();
    let piece = TetMesh::new(nodes.iter().map(|n| mesh.rest(*n)).collect(), &tets, &[]);
    let part = Membrane::of_piece(&membrane, &piece);
    for (t, _) in &half {
        mesh.remove_tet(*t);
    }
    let delta = mesh.take_delta();
    membrane.adopt(&mesh, &delta);
    assert!(((part.area() + membrane.area()) / area - 1.0).abs() < 1e-9, "{} and {} m2", part.area(), membrane.area());
    assert!(part.triangles().all(|t| t.rest().iter().any(|p| p.x > 0.03)));
}

/// An encapsulated body that is cut while it flies keeps its linear momentum.
#[test]
fn momentum_stays_when_it_is_cut() {
    let mut mesh = beam(6, 3);
    let mut body = Body::new(&mesh, &beam_material()).unwrap();
    let model = TissueModel::Vbd(VbdSettings::default());
    let mut model = ModelState::new(model, Some(SOFT), &body, &mesh, &beam_material()).unwrap();
    let mut state = TissueState::at_rest(&mesh);
    state.velocities.fill(Vec3::new(0.1, 0.2, -0.1));
    let start = body.momentum(&state);
    let settings = TissueSettings { drag_1_s: 0.0, ..Default::default() };
    for tick in 0..20 {
        if tick == 10 {
            separate(&mut mesh, 0.03);
            let delta = mesh.take_delta();
            adopt(&mut body, &mut state, &mesh, &delta, |_| Momentum::default());
            model.adopt(&body, &mesh, &delta);
        }
        model.step(&mut body, &mut state, &[], Vec3::ZERO, 1.0 / 60.0, &settings);
    }
    assert!((body.momentum(&state).linear - start.linear).length() < 1e-4 * start.scale);
}
