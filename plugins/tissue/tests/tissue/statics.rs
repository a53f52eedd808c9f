//! Equilibria with known answers, by the default model.

use crate::common::{run, split_edges};
use bevy_math::{DMat3, Vec3};
use keyhole_tetmesh::{DVec3, NodeId, TetMesh};
use keyhole_tissue::beam::{GRAVITY, beam, beam_material, block, clamp, fix, tip_mm};
use keyhole_tissue::reference::{Problem, Statics, equilibrium};
use keyhole_tissue::{Body, Hold, TissueSettings};
use keyhole_whiteboard::TissueState;

fn settle(mesh: &TetMesh, settings: &TissueSettings, ticks: u32) -> f64 {
    let mut body = Body::new(mesh, &beam_material()).unwrap();
    let mut state = TissueState::at_rest(mesh);
    run(&mut body, &mut state, &clamp(mesh), GRAVITY, settings, ticks);
    tip_mm(mesh, &state)
}

/// The tip of a cantilever of 1250 tetrahedra hangs 21.763 mm low: static Newton in f64 on the same mesh.
#[test]
fn cantilever_hangs_as_newton_says() {
    let mesh = beam(10, 5);
    for (settings, tolerance) in [
        (TissueSettings { drag_1_s: 6.0, ..Default::default() }, 2e-4),
        (TissueSettings { drag_1_s: 6.0, substeps: 3, ..Default::default() }, 2e-4),
        (TissueSettings { drag_1_s: 6.0, tolerance: 0.01, ..Default::default() }, 2e-4),
    ] {
        let tip = settle(&mesh, &settings, 240);
        assert!((tip / -21.763 - 1.0).abs() < tolerance, "{tip} mm with {settings:?}");
    }
}

/// Slivers of a hundredth of an edge neither shake the beam nor change where it hangs.
#[test]
fn slivers_do_not_matter() {
    let mut mesh = beam(10, 5);
    split_edges(&mut mesh, 5, 0.01);
    let settings = TissueSettings { drag_1_s: 6.0, ..Default::default() };
    let mut body = Body::new(&mesh, &beam_material()).unwrap();
    let mut state = TissueState::at_rest(&mesh);
    run(&mut body, &mut state, &clamp(&mesh), GRAVITY, &settings, 240);
    let tip = tip_mm(&mesh, &state);
    assert!((tip / -21.763 - 1.0).abs() < 0.005, "{tip} mm");
    assert!(body.kinetic_energy(&state) < 1e-8 * body.elastic_energy(&state), "it still moves");
}

/// A thousand times stiffer, the same settings: the load of a small deflection is proportional to its modulus.
#[test]
fn stiff_tissue_is_stable_and_linear() {
    let mesh = beam(10, 5);
    let tip = |young: f32| {
        let mut materials = beam_material();
        materials.0[0].young_modulus_pa = young;
        let mut body = Body::new(&mesh, &materials).unwrap();
        let mut state = TissueState::at_rest(&mesh);
        let settings = TissueSettings { drag_1_s: 6.0, ..Default::default() };
        run(&mut body, &mut state, &clamp(&mesh), GRAVITY, &settings, 240);
        tip_mm(&mesh, &state)
    };
    let ratio = tip(1e6) / tip(1e7);
    assert!((ratio / 10.0 - 1.0).abs() < 0.01, "{ratio}");
}

/// Patch test: nodes of the boundary displaced linearly, the inner ones follow; on a mesh with slivers too.
#[test]
fn patch_test() {
    for slivers in [false, true] {
        let mut mesh = block([3, 3, 3], [0.03, 0.03, 0.03]);
        if slivers {
            split_edges(&mut mesh, 7, 0.2);
        }
        let mut body = Body::new(&mesh, &beam_material()).unwrap();
        let linear = DMat3::from_cols(DVec3::new(1.10, 0.05, 0.0), DVec3::new(-0.08, 0.95, 0.02), DVec3::new(0.03, 0.0, 1.04));
        let holds: Vec<Hold> =
            mesh.nodes().filter(|n| mesh.topology().is_boundary_node(*n)).map(|n| fix(n, (linear * mesh.rest(n)).as_vec3())).collect();
        let mut state = TissueState::at_rest(&mesh);
        let settings = TissueSettings { substeps: 20, drag_1_s: 40.0, ..Default::default() };
        run(&mut body, &mut state, &holds, Vec3::ZERO, &settings, 120);
        assert!(mesh.nodes().count() > holds.len(), "there are inner nodes");
        for n in mesh.nodes() {
            let off = (state.position(n).as_dvec3() - linear * mesh.rest(n)).length();
            assert!(off < 2e-6 * 0.03, "slivers {slivers}: node {} is {off} m off", n.0);
        }
    }
}

/// Uniaxial stretch `s` with free sides: with `a = 1 + mu / lambda`, `q^2 = (a s - mu / lambda) / s^2` and the nominal stress is
/// `mu (s - q^2 / s)`.
#[test]
fn uniaxial_closed_form() {
    let size = 0.02;
    let mesh = block([2, 2, 2], [size, size, size]);
    let body = Body::new(&mesh, &beam_material()).unwrap();
    let constants = body.elements()[0].material;
    let (mu, ratio) = (f64::from(constants.mu), f64::from(constants.mu) / f64::from(constants.lambda));
    for stretch in [0.6, 0.8, 1.25, 1.6, 2.0] {
        let narrow = (((1.0 + ratio) * stretch - ratio) / (stretch * stretch)).sqrt();
        let nominal = mu * (stretch - narrow * narrow / stretch);
        // The ends are held along x by soft springs at every node, pulled until the closed form's force is in them; sideways they slide.
        let mut state = TissueState::at_rest(&mesh);
        for (i, n) in mesh.nodes().enumerate() {
            let p = mesh.rest(n);
            state.positions[i] = DVec3::new(p.x * stretch, p.y * narrow, p.z * narrow).as_vec3();
        }
        // At the closed form every inner and side node is in balance, and the end faces carry the nominal stress.
        let forces = body.forces(&state);
        let end: f64 = mesh.nodes().filter(|n| mesh.rest(*n).x == 0.0).map(|n| f64::from(forces[n.index()].x)).sum();
        assert!((end / (nominal * size * size) - 1.0).abs() < 1e-4, "stretch {stretch}: {end} N, expected {}", nominal * size * size);
        for n in mesh.nodes() {
            let side = f64::from(forces[n.index()].y.abs().max(forces[n.index()].z.abs()));
            assert!(side < 1e-4 * mu * size * size, "stretch {stretch}: {side} N sideways at node {}", n.0);
        }
    }
}

/// Loads that are applied at once, by soft springs to points far away, on a body that takes several steps of Newton's method to follow: it comes to rest
/// where the reference says. The energy that such loads give was once taken for a fault of the step.
#[test]
fn loads_on_nodes_rest_where_the_reference_says() {
    let side = 0.04;
    let mesh = block([12, 6, 12], [2.0 * side, side, 2.0 * side]);
    let (floor, top) = (|n: NodeId| mesh.rest(n).y == 0.0, |n: NodeId| mesh.rest(n).y > side - 1e-9);
    let far = 1e4_f32;
    let middle = |n: NodeId| (mesh.rest(n).x - side).abs() < 0.3 * side && (mesh.rest(n).z - side).abs() < 0.3 * side;
    let loaded: Vec<NodeId> = mesh.nodes().filter(|n| top(*n) && middle(*n)).collect();
    let each = -0.8 / loaded.len() as f64;
    let mut holds: Vec<Hold> = mesh.nodes().filter(|n| floor(*n)).map(|n| fix(n, mesh.rest(n).as_vec3())).collect();
    for n in &loaded {
        let anchor = mesh.rest(*n).as_vec3() + Vec3::Y * (each as f32 * far);
        holds.push(Hold { point: [(*n, 1.0)].into_iter().collect(), from: anchor, to: anchor, compliance_m_n: far });
    }
    let problem = Problem::new(&mesh, &beam_material(), floor).unwrap();
    let mut loads = vec![bevy_math::DVec3::ZERO; problem.rest.len()];
    loaded.iter().for_each(|n| loads[n.index()].y = each);
    let truth = equilibrium(&problem, &problem.rest, &loads, Statics::default()).unwrap();
    let mean =
        |y: &dyn Fn(usize) -> f64| loaded.iter().map(|n| y(n.index()) - problem.rest[n.index()].y).sum::<f64>() / loaded.len() as f64;
    let expected = mean(&|i| truth[i].y);
    for tolerance in [0.5, 0.1] {
        let settings = TissueSettings { drag_1_s: 20.0, sleep: false, tolerance, ..Default::default() };
        let (mut body, mut state) = (Body::new(&mesh, &beam_material()).unwrap(), TissueState::at_rest(&mesh));
        run(&mut body, &mut state, &holds, Vec3::ZERO, &settings, 150);
        let got = mean(&|i| f64::from(state.positions[i].y));
        assert!((got / expected - 1.0).abs() < 2e-3, "tolerance {tolerance}: {} mm, expected {}", got * 1e3, expected * 1e3);
    }
}
