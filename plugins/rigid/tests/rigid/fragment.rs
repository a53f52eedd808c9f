//! Soft to rigid to soft: what is kept, to rounding.

use crate::meshes::block;
use bevy_math::{DVec3, Isometry3d, Quat, Vec3};
use keyhole_rigid::fragment::{follow, freeze, node_masses};
use keyhole_whiteboard::{OrganMaterials, TissueState};
use proptest::prelude::*;

/// Mass, centre, momentum and angular momentum about the centre.
fn sums(masses: &[f64], state: &TissueState) -> (f64, DVec3, DVec3, DVec3) {
    let nodes = || masses.iter().zip(&state.positions).zip(&state.velocities).map(|((m, x), v)| (*m, x.as_dvec3(), v.as_dvec3()));
    let mass: f64 = nodes().map(|n| n.0).sum();
    let centre = nodes().map(|(m, x, _)| x * m).sum::<DVec3>() / mass;
    let linear: DVec3 = nodes().map(|(m, _, v)| v * m).sum();
    let angular: DVec3 = nodes().map(|(m, x, v)| (x - centre).cross(v * m)).sum();
    (mass, centre, linear, angular)
}

fn vectors(count: usize) -> impl Strategy<Value = Vec<Vec3>> {
    proptest::collection::vec((-1f32..1.0, -1f32..1.0, -1f32..1.0).prop_map(Vec3::from), count)
}

proptest! {
    /// A deformed fragment of 2 cm anywhere in a theatre, that spins, flies and quivers.
    #[test]
    fn momentum_goes_with_a_fragment_there_and_back(
        noise in vectors(27), quiver in vectors(27), spin in vectors(1), fly in vectors(1), at in vectors(1), turn in 0f32..3.0,
    ) {
        let mesh = block([2; 3], [0.02, 0.012, 0.017]);
        let masses = node_masses(&mesh, &OrganMaterials::default());
        let mut state = TissueState::at_rest(&mesh);
        let (spin, fly, at) = (spin[0] * 20.0, fly[0] * 2.0, at[0] * 0.5);
        for ((x, v), (n, q)) in state.positions.iter_mut().zip(&mut state.velocities).zip(noise.iter().zip(&quiver)) {
            *x += *n * 0.002;
            *v = fly + spin.cross(*x) + *q * 0.05;
            *x = at + Quat::from_rotation_x(turn) * *x;
        }
        let before = sums(&masses, &state);
        let frozen = freeze(&masses, &state).unwrap();
        let shape = state.clone();
        let mut back = state.clone();
        follow(&frozen.local, &frozen.pose, &mut back);
        let after = sums(&masses, &back);
        // Rounding of what moves at most at this speed, at this distance.
        let speed = f64::from(back.velocities.iter().chain(&state.velocities).map(|v| v.length()).fold(0.0, f32::max));
        let linear = (after.2 - before.2).length() / (before.0 * speed);
        let angular = (after.3 - before.3).length() / (before.0 * speed * 0.02);
        let centre = (after.1 - before.1).length();
        let place = f64::from(at.length() + 0.03);
        prop_assert!(linear < 4e-7, "linear {linear}");
        prop_assert!(angular < 4e-6 * (1.0 + place / 0.02 / 10.0), "angular {angular}");
        prop_assert!(centre < 1e-7 * place, "centre {centre} m");
        prop_assert!((f64::from(frozen.mass.mass_kg) - before.0).abs() < 1e-7 * before.0);
        // The deformed shape is the shape.
        for (x, y) in shape.positions.iter().zip(&back.positions) {
            prop_assert!(x.distance(*y) < 2e-7 * place as f32 + 2e-9);
        }
        // What it had in energy against its rigid motion is lost; none is gained.
        let energy = |s: &TissueState| masses.iter().zip(&s.velocities).map(|(m, v)| m * v.as_dvec3().length_squared()).sum::<f64>();
        prop_assert!(energy(&back) <= energy(&state) * (1.0 + 1e-6));
        // Turned as a rigid body it has the shape it had.
        let mut turned = state;
        let moved = keyhole_whiteboard::RigidPose { now: Isometry3d::new(Vec3::ONE, Quat::from_rotation_y(1.0)), ..frozen.pose };
        follow(&frozen.local, &moved, &mut turned);
        let (far, was) = (turned.positions[0].distance(turned.positions[26]), shape.positions[0].distance(shape.positions[26]));
        prop_assert!((far - was).abs() < 1e-6);
    }
}

/// The figures for the record: worst of a thousand.
#[test]
fn what_rounding_makes_of_momentum() {
    let mesh = block([2; 3], [0.02, 0.012, 0.017]);
    let masses = node_masses(&mesh, &OrganMaterials::default());
    let rest = TissueState::at_rest(&mesh);
    let (mut linear, mut angular) = (0.0f64, 0.0f64);
    for case in 0..1000u16 {
        let c = f32::from(case);
        let wave = |a: f32| Vec3::new((c * 0.37 + a).sin(), (c * 0.73 + 2.0 * a).sin(), (c * 1.13 + 3.0 * a).cos());
        let mut state = rest.clone();
        for (i, (x, v)) in state.positions.iter_mut().zip(&mut state.velocities).enumerate() {
            *v = wave(0.0) + 10.0 * wave(1.0).cross(*x) + 0.05 * wave(i as f32);
            *x += 0.2 * wave(2.0) + 0.001 * wave(-(i as f32));
        }
        let before = sums(&masses, &state);
        let frozen = freeze(&masses, &state).unwrap();
        follow(&frozen.local, &frozen.pose, &mut state);
        let after = sums(&masses, &state);
        linear = linear.max((after.2 - before.2).length() / before.2.length());
        angular = angular.max((after.3 - before.3).length() / before.3.length());
    }
    println!("worst of 1000: linear momentum {linear:.1e}, angular momentum {angular:.1e} of what it was");
    assert!(linear < 1e-6 && angular < 1e-3);
}

/// Nodes in a plane, without mass, or nowhere, are no rigid body.
#[test]
fn what_has_no_inertia_stays_soft() {
    let mut state = TissueState { positions: vec![Vec3::ZERO, Vec3::X, Vec3::X * 2.0], velocities: vec![Vec3::ZERO; 3] };
    assert_eq!(freeze(&[1.0, 1.0, 1.0], &state), None);
    state.positions[1] = Vec3::Y;
    assert!(freeze(&[1.0, 1.0, 1.0], &state).is_some());
    assert_eq!(freeze(&[0.0, 0.0, 0.0], &state), None);
    state.positions[1] = Vec3::NAN;
    assert_eq!(freeze(&[1.0, 1.0, 1.0], &state), None);
}
