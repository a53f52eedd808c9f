//! What the legs catch, how they press and where the clip is.

use crate::meshes::block;
use bevy_math::{EulerRot, Isometry3d, Quat, Vec3};
use keyhole_clipping::legs::{ACROSS, ALONG, catch, fit, press};
use keyhole_clipping::locate::position;
use keyhole_whiteboard::{ClipApplier, ClipShape, TissueState};
use proptest::prelude::*;

/// A bar of 40 x 8 x 8 mm along X, and an applier across it whose crown is at `crown_z_m`.
fn caught(crown_z_m: f32, height_m: f64, moved: Isometry3d) -> Vec<(keyhole_whiteboard::ClipPair, Vec3, Vec3)> {
    let mesh = block([20, 4, 4], [0.04, height_m, 0.008]);
    let applier = ClipApplier::default();
    let mut state = TissueState::at_rest(&mesh);
    let pose = Isometry3d::from_xyz(0.0203, height_m as f32 / 2.0, crown_z_m + applier.crown_m);
    state.positions.iter_mut().for_each(|x| *x = moved * *x);
    let pairs = catch(&mesh, &state.positions, &(moved * pose), &applier, 0.5);
    let at =
        |p: &keyhole_whiteboard::ClipPair| (position(&p.upper, &state.positions).unwrap(), position(&p.lower, &state.positions).unwrap());
    pairs.into_iter().map(|p| (p.clone(), at(&p).0, at(&p).1)).collect()
}

proptest! {
    /// Wherever organ and applier are together, the legs catch the upper and the lower wall.
    #[test]
    fn legs_catch_both_walls(turn in (-3f32..3.0, -1.5f32..1.5, -3f32..3.0), at in (-0.3f32..0.3, -0.3f32..0.3, -0.3f32..0.3)) {
        let moved = Isometry3d::new(Vec3::from(at), Quat::from_euler(EulerRot::XYZ, turn.0, turn.1, turn.2));
        let pairs = caught(0.0084, 0.004, moved);
        // 9 mm of legs from 8.4 mm down to -0.6 mm across tissue from 8 mm down to 0: of twelve pieces the first, at 8.025 mm, and the last are beside it.
        prop_assert_eq!(pairs.len(), 10 * ACROSS);
        for (pair, upper, lower) in &pairs {
            let apart = upper.distance(*lower);
            prop_assert!((apart - 0.004).abs() < 0.0001, "{}", apart);
            prop_assert!((pair.apart_m - apart).abs() < 1e-5);
            prop_assert!((pair.rest[0].y - 0.004).abs() < 1e-4 && pair.rest[1].y.abs() < 1e-4);
            prop_assert!((pair.rest[0].z - (0.0084 - pair.along_m)).abs() < 1e-5);
        }
    }

    /// The frame that fits pieces of a clip is the clip's frame.
    #[test]
    fn the_frame_fits_its_pieces(turn in (-3f32..3.0, -1.5f32..1.5, -3f32..3.0), at in (-0.3f32..0.3, -0.3f32..0.3, -0.3f32..0.3), apart in 1e-4f32..0.01) {
        let frame = Isometry3d::new(Vec3::from(at), Quat::from_euler(EulerRot::XYZ, turn.0, turn.1, turn.2));
        let place = |along: f32, across: f32, side: f32| Vec3::from(frame.transform_point(Vec3::new(across, side * apart / 2.0, -along)));
        let pieces: Vec<_> = keyhole_clipping::legs::pieces(&ClipShape::default())
            .map(|(along, across)| (along, across, place(along, across, 1.0), place(along, across, -1.0)))
            .collect();
        prop_assert_eq!(pieces.len(), ALONG * ACROSS);
        let found = fit(&pieces, &Isometry3d::IDENTITY);
        prop_assert!(found.translation.distance(frame.translation) < 2e-5);
        prop_assert!(found.rotation.angle_between(frame.rotation) < 0.02);
        // With one piece left it keeps the direction that it had.
        let one = fit(&pieces[..1], &frame);
        prop_assert!(one.rotation.angle_between(frame.rotation) < 0.02 && one.translation.distance(frame.translation) < 2e-4);
    }

    /// Legs close to their gap, and give where each piece would press with more than its part.
    #[test]
    fn legs_press_with_no_more_than_they_bear(apart in 0f32..0.01, distance in 0f32..0.01, closes in 0f32..0.001, most in 0.1f32..20.0) {
        let shape = ClipShape { most_pinch_n: most, ..ClipShape::default() };
        let compliance = (ALONG * ACROSS) as f32 / 20_000.0;
        let (now, pinch) = press(apart, distance, closes, &shape, compliance);
        let part = most / (ALONG * ACROSS) as f32;
        prop_assert!(now >= shape.gap_m && now >= apart - closes);
        prop_assert!((0.0..=part * 1.001 + 1e-6).contains(&pinch));
        prop_assert!((pinch - ((distance - now) / compliance).max(0.0)).abs() < 1e-6);
    }
}

#[test]
fn tissue_beyond_the_jaws_is_not_caught() {
    let crown = |z: f32, height: f64| caught(z, height, Isometry3d::IDENTITY).len();
    // Half across: the crown in the middle, the legs from 4 mm on.
    assert_eq!(crown(0.004, 0.004), 5 * ACROSS);
    assert_eq!(crown(-0.001, 0.004), 0);
    // Jaws open by half a radian are 8 mm wide at the crown and 16 at the tips: of a bar of 12 mm only what is near the tips is between them.
    let thick = crown(0.0084, 0.012);
    assert!(thick > 0 && thick < 10 * ACROSS, "{thick}");
}
