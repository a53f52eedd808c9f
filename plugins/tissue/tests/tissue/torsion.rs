//! Torsion of a square bar, its ends turned against each other: the couple by the reference against the closed form, the shape by every model against
//! the reference.

use bevy_math::{DVec3, Vec3};
use keyhole_tetmesh::{NodeId, TetMesh};
use keyhole_tissue::beam::{beam_material, block, fix};
use keyhole_tissue::reference::{Problem, Statics, equilibrium};
use keyhole_tissue::{Body, Constraints, Hold, ModelState, TeschnerSettings, TissueModel, TissueSettings, VbdSettings, XpbdSettings};
use keyhole_whiteboard::TissueState;

const LENGTH: f64 = 0.08;
const SIDE: f64 = 0.01;

/// Total angle, rad: the shear on the surface is two in a hundred.
const ANGLE: f64 = 0.3;

fn bar(m: u32) -> TetMesh {
    block([4 * m, m, m], [LENGTH, SIDE, SIDE])
}

fn at_an_end(p: keyhole_tetmesh::DVec3) -> bool {
    p.x < 1e-9 || p.x > LENGTH - 1e-9
}

/// Where a point is when its section is turned about the axis in proportion to its place along it.
fn turned(p: keyhole_tetmesh::DVec3) -> DVec3 {
    let (sin, cos) = (ANGLE * (p.x / LENGTH - 0.5)).sin_cos();
    let (y, z) = (p.y - SIDE / 2.0, p.z - SIDE / 2.0);
    DVec3::new(p.x, SIDE / 2.0 + cos * y - sin * z, SIDE / 2.0 + sin * y + cos * z)
}

/// The reference's shape and its couple at the far end, N m.
fn solved(mesh: &TetMesh) -> (Vec<DVec3>, f64) {
    let problem = Problem::new(mesh, &beam_material(), |n| at_an_end(mesh.rest(n))).unwrap();
    let start: Vec<DVec3> = mesh.nodes().map(|n| turned(mesh.rest(n))).collect();
    let x = equilibrium(&problem, &start, &vec![DVec3::ZERO; start.len()], Statics::default()).unwrap();
    let middle = DVec3::new(0.0, SIDE / 2.0, SIDE / 2.0);
    let forces = problem.forces(&x);
    let far = (0..x.len()).filter(|i| problem.rest[*i].x > LENGTH - 1e-9);
    let couple = far.map(|i| (x[i] - middle).cross(-forces[i]).x).sum();
    (x, couple)
}

/// `T = G J theta / L` with `J = 0.1406 a^4` (Timoshenko, Goodier 1951), approached with second order from above.
#[test]
fn the_couple_converges_to_the_closed_form() {
    let material = &beam_material().0[0];
    let shear = f64::from(material.young_modulus_pa) / (2.0 * (1.0 + f64::from(material.poisson_ratio)));
    let expected = shear * 0.1406 * SIDE.powi(4) * ANGLE / LENGTH;
    let errors = [3, 6, 12].map(|m| solved(&bar(m)).1 / expected - 1.0);
    let order = ((errors[0] - errors[1]) / (errors[1] - errors[2])).log2();
    let limit = errors[2] - (errors[1] - errors[2]) / 3.0;
    assert!((1.5..2.4).contains(&order), "order {order}, {errors:?}");
    assert!(limit.abs() < 0.02, "{errors:?}, in the limit {limit}");
}

/// Every model twists the bar into the reference's shape: the distance of the nodes as a part of the largest way.
#[test]
fn every_model_twists_as_the_reference() {
    let mesh = bar(3);
    let (truth, _) = solved(&mesh);
    let holds: Vec<Hold> = mesh.nodes().filter(|n| at_an_end(mesh.rest(*n))).map(|n| fix(n, turned(mesh.rest(n)).as_vec3())).collect();
    let off = |state: &TissueState| {
        let away = |n: NodeId| state.position(n).as_dvec3().distance(truth[n.index()]);
        mesh.nodes().map(away).fold(0.0, f64::max) / (ANGLE / 2.0 * SIDE / 2.0 * std::f64::consts::SQRT_2)
    };
    let settings = TissueSettings { drag_1_s: 30.0, ..Default::default() };
    for (model, tolerance) in [
        (TissueModel::Implicit, 1e-4),
        (TissueModel::Xpbd(XpbdSettings { substeps: 60, constraints: Constraints::NeoHookean }), 5e-3),
        (TissueModel::Vbd(VbdSettings { substeps: 4, iterations: 60, ..Default::default() }), 1e-4),
        (TissueModel::Teschner(TeschnerSettings::default()), 5e-3),
    ] {
        let mut body = Body::new(&mesh, &beam_material()).unwrap();
        let mut state = TissueState::at_rest(&mesh);
        let mut stepper = ModelState::new(model, None, &body, &mesh, &beam_material()).unwrap();
        for _ in 0..120 {
            stepper.step(&mut body, &mut state, &holds, Vec3::ZERO, 1.0 / 60.0, &settings);
        }
        assert!(off(&state) < tolerance, "{model:?}: {} of the way off", off(&state));
    }
}
