//! What a cut opens and what clips close.

use crate::meshes::block;
use bevy_math::Vec3;
use keyhole_clipping::legs::ALONG;
use keyhole_clipping::lumen::{Closure, End, Lumen};
use keyhole_tetmesh::{DVec3, TetMesh};
use keyhole_whiteboard::{ClipPair, Vessel, VesselEnd};

const RADIUS: f32 = 0.0025;

fn bar() -> TetMesh {
    block([20, 4, 4], [0.04, 0.008, 0.008])
}

fn vessel() -> Vessel {
    let artery = VesselEnd { pressure_pa: 13_332.0, supply_ml_min: 600.0 };
    let line = vec![Vec3::new(0.001, 0.004, 0.004), Vec3::new(0.039, 0.004, 0.004)];
    Vessel { name: "artery".into(), line, radius_m: RADIUS, wall_m: 0.0, near: artery, far: VesselEnd::default() }
}

/// Takes out the tetrahedra whose middle is in a box.
fn take_out(mesh: &mut TetMesh, low: DVec3, high: DVec3) -> keyhole_tetmesh::TopologyDelta {
    let middle = |t| mesh.points(t).into_iter().sum::<DVec3>() / 4.0;
    let gone: Vec<_> = mesh.iter().map(|(t, _)| t).filter(|t| middle(*t).cmpgt(low).all() && middle(*t).cmplt(high).all()).collect();
    gone.into_iter().for_each(|t| mesh.remove_tet(t));
    let unused: Vec<_> = mesh.nodes().filter(|n| mesh.topology().around_node(*n).is_empty()).collect();
    unused.into_iter().for_each(|n| mesh.remove_node(n));
    mesh.take_delta()
}

fn clip(x: f32, from_z: f32, to_z: f32) -> Vec<ClipPair> {
    let count = ALONG as f32;
    let along = |i: usize| (i as f32 + 0.5) / count * 0.009;
    let pieces = (0..ALONG).map(|i| (along(i), 0.0085 - along(i))).filter(|(_, z)| (from_z..to_z).contains(z));
    pieces
        .map(|(along_m, z)| ClipPair {
            upper: Default::default(),
            lower: Default::default(),
            rest: [Vec3::new(x, 0.008, z), Vec3::new(x, 0.0, z)],
            along_m,
            across_m: 0.0,
            apart_m: 0.001,
            pinch_n: 0.0,
        })
        .collect()
}

fn closure(lumen: &Lumen, pairs: &[ClipPair]) -> Closure {
    lumen.closure(pairs, 0.009 / ALONG as f32).unwrap()
}

#[test]
fn a_vessel_is_whole_until_it_is_cut() {
    let mut mesh = bar();
    let mut lumen = Lumen::new(&mesh, &vessel());
    assert_eq!((lumen.severed(), lumen.openings(&[], End::Near)), (0.0, vec![]));
    // A hole beside the vessel does nothing.
    let delta = take_out(&mut mesh, DVec3::ZERO, DVec3::new(0.04, 0.002, 0.002));
    assert!(!delta.removed.is_empty());
    lumen.update(&mesh, &delta);
    assert_eq!(lumen.severed(), 0.0);
    // Half of it is half of it: what is taken out reaches to the middle.
    let delta = take_out(&mut mesh, DVec3::new(0.02, 0.0, 0.0), DVec3::new(0.022, 0.008, 0.004));
    lumen.update(&mesh, &delta);
    println!("cut to the middle: {} of the fibres", lumen.severed());
    assert!((lumen.severed() - 0.5).abs() <= 0.05);
    let delta = take_out(&mut mesh, DVec3::new(0.02, 0.0, 0.0), DVec3::new(0.022, 0.008, 0.008));
    lumen.update(&mesh, &delta);
    assert_eq!(lumen.severed(), 1.0);
    let [opening] = lumen.openings(&[], End::Near)[..] else { panic!("one opening") };
    assert!((opening.area_m2 / (std::f64::consts::PI * f64::from(RADIUS).powi(2)) - 1.0).abs() < 1e-9);
    assert!((opening.along_m - 0.019).abs() < 0.0015, "{}", opening.along_m);
    let [from_far] = lumen.openings(&[], End::Far)[..] else { panic!("one opening") };
    assert!((from_far.along_m - 0.02).abs() < 0.0015, "{}", from_far.along_m);
    // Nothing of it is looked at anew that would change it.
    let before = lumen.clone();
    lumen.update(&mesh, &Default::default());
    assert_eq!(before, lumen);
}

#[test]
fn a_clip_closes_what_it_is_across() {
    let lumen = Lumen::new(&bar(), &vessel());
    let whole = closure(&lumen, &clip(0.01, -1.0, 1.0));
    assert!((whole.closes - 1.0).abs() < 1e-12 && (whole.along_m - 0.009).abs() < 1e-6, "{whole:?}");
    // Six of twelve pieces from the crown at 8.5 mm reach down to 4 mm, the middle of the lumen.
    let half = closure(&lumen, &clip(0.01, 0.004, 1.0));
    assert!((half.closes - 0.5).abs() < 1e-6, "{half:?}");
    // Down to 5.5 mm: the segment of a disc beyond 0.6 of its radius, (acos 0.6 - 0.6 x 0.8) / pi.
    let less = closure(&lumen, &clip(0.01, 0.0055, 1.0));
    assert!((less.closes - (0.6f64.acos() - 0.48) / std::f64::consts::PI).abs() < 1e-5, "{less:?}");
    // Beside the lumen, or with both legs on one side of it, it closes nothing.
    assert_eq!(closure(&lumen, &clip(0.01, 0.007, 1.0)).closes, 0.0);
    let mut fold = clip(0.01, -1.0, 1.0);
    fold.iter_mut().for_each(|p| p.rest[1].y = 0.007);
    assert_eq!(closure(&lumen, &fold).closes, 0.0);
}

#[test]
fn clips_stand_between_a_source_and_the_cut() {
    let mut mesh = bar();
    let mut lumen = Lumen::new(&mesh, &vessel());
    let delta = take_out(&mut mesh, DVec3::new(0.02, 0.0, 0.0), DVec3::new(0.022, 0.008, 0.008));
    lumen.update(&mesh, &delta);
    let (before, behind) = (closure(&lumen, &clip(0.012, -1.0, 1.0)), closure(&lumen, &clip(0.03, -1.0, 1.0)));
    let half = closure(&lumen, &clip(0.012, 0.004, 1.0));
    let area = |clips: &[Closure], end| lumen.openings(clips, end).iter().map(|o| o.area_m2).sum::<f64>() / lumen.area_m2();
    assert_eq!([area(&[before], End::Near), area(&[behind], End::Near)], [0.0, 1.0]);
    assert_eq!([area(&[before], End::Far), area(&[behind], End::Far)], [1.0, 0.0]);
    assert_eq!([area(&[before, behind], End::Near), area(&[before, behind], End::Far)], [0.0, 0.0]);
    assert!((area(&[half], End::Near) - 0.5).abs() < 1e-6);
    assert_eq!(area(&[half, before], End::Near), 0.0);
}
