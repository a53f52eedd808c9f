//! The reference against closed forms, published figures of the same beam, and its own order.

use bevy_math::DVec3;
use keyhole_tetmesh::TetMesh;
use keyhole_tissue::beam::{beam, beam_material, block};
use keyhole_tissue::reference::{Dynamics, Problem, Statics, equilibrium, slowest_mode, unloaded};
use keyhole_whiteboard::{OrganMaterial, OrganMaterials};

const GRAVITY: DVec3 = DVec3::new(0.0, -9.81, 0.0);

fn clamped(mesh: &TetMesh, materials: &OrganMaterials) -> Problem {
    Problem::new(mesh, materials, |n| mesh.rest(n).x == 0.0).unwrap()
}

/// Mean displacement of the free end along y, m.
fn tip(problem: &Problem, x: &[DVec3]) -> f64 {
    let end = problem.rest.iter().map(|p| p.x).fold(0.0, f64::max);
    let there: Vec<usize> = (0..x.len()).filter(|i| problem.rest[*i].x == end).collect();
    there.iter().map(|i| x[*i].y - problem.rest[*i].y).sum::<f64>() / there.len() as f64
}

fn material(young: f32, nu: f32) -> OrganMaterials {
    OrganMaterials(vec![OrganMaterial { young_modulus_pa: young, poisson_ratio: nu, density_kg_m3: 1050.0, ..Default::default() }])
}

/// The beam that engines are compared on: -21.763 and -23.446 mm with 1250 and 5120 tetrahedra, by a program of others.
#[test]
fn the_beam_hangs_where_it_is_known_to() {
    for ([n, m], expected) in [([10, 5], -21.763), ([16, 8], -23.446)] {
        let mesh = beam(n, m);
        let problem = clamped(&mesh, &beam_material());
        let x = equilibrium(&problem, &problem.rest, &problem.weights(GRAVITY), Statics::default()).unwrap();
        let mm = tip(&problem, &x) * 1e3;
        assert!((mm - expected).abs() < 6e-4, "{mm} mm, expected {expected}");
        // How the load is divided does not matter.
        let once =
            equilibrium(&problem, &problem.rest, &problem.weights(GRAVITY), Statics { load_steps: 1, ..Default::default() }).unwrap();
        assert!((tip(&problem, &once) * 1e3 - mm).abs() < 1e-6);
    }
}

/// A slender stiff beam, without Poisson's ratio: Timoshenko's `w L^4 / 8 E I + w L^2 / 2 k G A` the stiffness
/// with second order in the size of the elements.
#[test]
fn small_deflections_converge_to_timoshenko() {
    let (length, side) = (0.08, 0.01);
    let young = 1e6_f32;
    let error = |m: u32| {
        let mesh = block([8 * m, m, m], [length, side, side]);
        let problem = clamped(&mesh, &material(young, 0.0));
        let x = equilibrium(&problem, &problem.rest, &problem.weights(GRAVITY), Statics::default()).unwrap();
        let (e, area) = (f64::from(young), side * side);
        let weight = 1050.0 * 9.81 * area;
        let bending = weight * length.powi(4) / (8.0 * e * side.powi(4) / 12.0);
        let shear = weight * length.powi(2) / (2.0 * 5.0 / 6.0 * e / 2.0 * area);
        // Of the stiffness, for coarse elements make the beam twice too stiff.
        (bending + shear) / -tip(&problem, &x) - 1.0
    };
    let errors = [2, 4, 8].map(error);
    let limit = errors[2] - (errors[1] - errors[2]) / 3.0;
    assert!(limit.abs() < 0.01, "{errors:?}, in the limit {limit}");
    let order = ((errors[0] - errors[1]) / (errors[1] - errors[2])).log2();
    assert!((1.6..2.4).contains(&order), "order {order}, {errors:?}");
}

/// Uniaxial stretch with free sides: `q^2 = (a s - mu / lambda) / s^2`, nominal stress `mu (s - q^2 / s)`.
#[test]
fn uniaxial_closed_form() {
    let side = 0.02;
    let mesh = block([3, 3, 3], [side; 3]);
    for stretch in [0.6, 1.5, 2.0] {
        let mut problem = Problem::new(&mesh, &beam_material(), |n| [0.0, side].contains(&mesh.rest(n).x)).unwrap();
        let (mu, ratio) = (problem.tets[0].mu, problem.tets[0].mu / problem.tets[0].lambda);
        let narrow = (((1.0 + ratio) * stretch - ratio) / (stretch * stretch)).sqrt();
        let exact: Vec<DVec3> = problem.rest.iter().map(|p| DVec3::new(p.x * stretch, p.y * narrow, p.z * narrow)).collect();
        // The ends are where they belong; what is between starts at rest.
        let start: Vec<DVec3> = (0..exact.len()).map(|i| if problem.fixed[i] { exact[i] } else { problem.rest[i] * 1.01 }).collect();
        let none = vec![DVec3::ZERO; exact.len()];
        let x = equilibrium(&problem, &start, &none, Statics::default()).unwrap();
        let off = x.iter().zip(&exact).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
        assert!(off < 1e-9 * side, "stretch {stretch}: {off} m off");
        let pull: f64 = problem.forces(&x).iter().zip(&problem.rest).filter(|(_, p)| p.x == 0.0).map(|(f, _)| f.x).sum();
        let expected = mu * (stretch - narrow * narrow / stretch) * side * side;
        assert!((pull / expected - 1.0).abs() < 1e-9, "stretch {stretch}: {pull} N, expected {expected}");
        problem.fixed.fill(false);
        assert!(matches!(
            equilibrium(&problem, &problem.rest.clone(), &problem.weights(GRAVITY), Statics { iterations: 5, ..Default::default() }),
            Err(keyhole_tissue::reference::ReferenceError::Factorisation { .. }
                | keyhole_tissue::reference::ReferenceError::NotConverged { .. })
        ));
    }
}

/// Ten-node elements: a uniform strain is theirs exactly; a beam of one element over its height bends within 2 % of Timoshenko; and at a Poisson's ratio of 0.499 two of
/// them over the height are softer than four linear ones, which lock.
#[test]
fn ten_nodes_bend_and_lock_less() {
    let side = 0.02;
    let mesh = block([2, 2, 2], [side; 3]);
    let problem = Problem::quadratic(&mesh, &beam_material(), |n| [0.0, side].contains(&mesh.rest(n).x)).unwrap();
    let (mu, ratio) = (problem.quadratic[0].mu, problem.quadratic[0].mu / problem.quadratic[0].lambda);
    let stretch = 1.5;
    let narrow = (((1.0 + ratio) * stretch - ratio) / (stretch * stretch)).sqrt();
    let exact: Vec<DVec3> = problem.rest.iter().map(|p| DVec3::new(p.x * stretch, p.y * narrow, p.z * narrow)).collect();
    let start: Vec<DVec3> = (0..exact.len()).map(|i| if problem.fixed[i] { exact[i] } else { problem.rest[i] * 1.01 }).collect();
    let x = equilibrium(&problem, &start, &vec![DVec3::ZERO; exact.len()], Statics::default()).unwrap();
    let off = x.iter().zip(&exact).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
    assert!(off < 1e-9 * side, "{off} m off");
    let pull: f64 = problem.forces(&x).iter().zip(&problem.rest).filter(|(_, p)| p.x == 0.0).map(|(f, _)| f.x).sum();
    let expected = mu * (stretch - narrow * narrow / stretch) * side * side;
    assert!((pull / expected - 1.0).abs() < 1e-9, "{pull} N, expected {expected}");
    assert!((problem.masses.iter().sum::<f64>() / (1050.0 * side.powi(3)) - 1.0).abs() < 1e-9);

    let (length, side) = (0.08, 0.01);
    let sag = |problem: &Problem| {
        let x = equilibrium(problem, &problem.rest, &problem.weights(GRAVITY), Statics::default()).unwrap();
        -tip(problem, &x)
    };
    let quadratic = |cells: [u32; 3], nu: f32| {
        let mesh = block(cells, [length, side, side]);
        sag(&Problem::quadratic(&mesh, &material(1e6, nu), |n| mesh.rest(n).x == 0.0).unwrap())
    };
    let weight = 1050.0 * 9.81 * side * side;
    let bending = weight * length.powi(4) / (8.0 * 1e6 * side.powi(4) / 12.0);
    let shear = |nu: f64| weight * length.powi(2) / (2.0 * 5.0 / 6.0 * 1e6 / (2.0 * (1.0 + nu)) * side * side);
    let coarse = quadratic([8, 1, 1], 0.0) / (bending + shear(0.0));
    assert!((coarse - 1.0).abs() < 0.02, "{coarse} of Timoshenko");
    let nearly = quadratic([16, 2, 2], 0.499) / (bending + shear(0.499));
    let linear = sag(&clamped(&block([32, 4, 4], [length, side, side]), &material(1e6, 0.499))) / (bending + shear(0.499));
    assert!(linear < 0.8 && nearly > 0.88 && nearly < 1.0, "of Timoshenko: linear {linear}, ten nodes {nearly}");
}

/// A slender beam without Poisson's ratio swings at Euler and Bernoulli's `3.516 sqrt(E I / rho A L^4)`, less what shear and rotation take off: 1.5 % at this slenderness, and with
/// a heavy weight at its end at that of a spring `3 E I / L^3` with its mass.
#[test]
fn the_slowest_mode_is_that_of_a_beam() {
    let (length, side, young) = (0.08, 0.005, 1e6);
    let mesh = block([16, 1, 1], [length, side, side]);
    let problem = Problem::quadratic(&mesh, &material(1e6, 0.0), |n| mesh.rest(n).x == 0.0).unwrap();
    let shape: Vec<DVec3> = problem.rest.iter().map(|p| DVec3::Y * p.x * p.x).collect();
    let inertia = side.powi(4) / 12.0;
    let bare = slowest_mode(&problem, &problem.rest, &shape).unwrap();
    let expected = 3.516 * (young * inertia / (1050.0 * side * side * length.powi(4))).sqrt();
    assert!(bare < expected && bare > 0.98 * expected, "{bare}, Euler and Bernoulli {expected}");
    let mut loaded = problem.clone();
    let end: Vec<usize> = (0..loaded.rest.len()).filter(|i| loaded.rest[*i].x == length).collect();
    let weight = 20.0 * loaded.masses.iter().sum::<f64>();
    for i in &end {
        loaded.masses[*i] += weight / end.len() as f64;
    }
    let slow = slowest_mode(&loaded, &loaded.rest, &shape).unwrap();
    let mass = weight + 33.0 / 140.0 * problem.masses.iter().sum::<f64>();
    let expected = (3.0 * young * inertia / length.powi(3) / mass).sqrt();
    assert!(slow < 1.005 * expected && slow > 0.98 * expected, "{slow}, spring and mass {expected}");
}

/// The motion of the dropped beam converges with the square of the step, keeps nearly all energy, and falls freely when nothing holds it.
#[test]
fn motion_is_of_second_order() {
    let mesh = beam(6, 3);
    let end = |steps: u32| {
        let problem = clamped(&mesh, &beam_material());
        let start = problem.rest.clone();
        let mut body = Dynamics::new(problem, start).unwrap();
        (body.drag_1_s, body.viscosity_s) = (2.0, 0.002);
        for _ in 0..steps {
            body.step(0.1 / f64::from(steps), GRAVITY, |_| None).unwrap();
        }
        tip(body.problem(), &body.positions)
    };
    let tips = [20, 40, 80].map(end);
    let order = ((tips[0] - tips[1]) / (tips[1] - tips[2])).abs().log2();
    assert!((1.7..2.4).contains(&order), "order {order}: {tips:?}");

    let problem = Problem::new(&mesh, &beam_material(), |_| false).unwrap();
    let start = problem.rest.clone();
    let mut body = Dynamics::new(problem, start.clone()).unwrap();
    for _ in 0..10 {
        body.step(0.01, GRAVITY, |_| None).unwrap();
    }
    let fallen = start[0].y - body.positions[0].y;
    assert!((fallen / (9.81 / 2.0 * 0.01) - 1.0).abs() < 0.01, "{fallen} m");
}

/// The rest shape of a beam that was scanned as it hangs: under gravity it comes back to the scan.
#[test]
fn a_scan_is_unloaded() {
    let mesh = beam(10, 5);
    let held = |n| mesh.rest(n).x == 0.0;
    let found = unloaded(&mesh, &beam_material(), held, GRAVITY, 1e-4, 40).unwrap();
    let moved: Vec<keyhole_tetmesh::DVec3> = found.rest.iter().map(|p| keyhole_tetmesh::DVec3::new(p.x, p.y, p.z)).collect();
    let tets: Vec<[u32; 4]> = mesh.iter().map(|(_, c)| c.map(|n| n.0)).collect();
    let free = TetMesh::new(moved, &tets, &[]);
    assert!(free.iter().all(|(t, _)| free.volume(t) > 0.0));
    let scanned = clamped(&mesh, &beam_material());
    let problem = Problem::new(&free, &beam_material(), held).unwrap();
    // The masses of the scan: what was weighed.
    let x = equilibrium(&problem, &problem.rest, &scanned.weights(GRAVITY), Statics::default()).unwrap();
    let off = x.iter().zip(&scanned.rest).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
    assert!(off < 1e-4 * 0.024, "{off} m off after {} rounds", found.rounds);
}
