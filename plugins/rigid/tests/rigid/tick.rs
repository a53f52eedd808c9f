//! The plugin in an app, tick by tick.

use crate::meshes::block;
use bevy_app::App;
use bevy_ecs::prelude::*;
use bevy_math::{Isometry3d, Quat, Vec3};
use bevy_time::{Fixed, Time, TimePlugin, TimeUpdateStrategy};
use keyhole_rigid::RigidPlugin;
use keyhole_tetmesh::NodeId;
use keyhole_whiteboard::{
    Attachment, Attachments, FreedFrom, HeldBy, Instrument, InstrumentKind, InstrumentPose, Organ, RigidBody, RigidFragments, RigidPose,
    RigidQuarantined, RigidReport, RigidShape, Rigidified, SceneRequirements, TissueMesh, TissueState, WhiteboardPlugin,
};

fn app() -> App {
    let mut app = App::new();
    app.add_plugins((TimePlugin, WhiteboardPlugin, RigidPlugin));
    app.insert_resource(TimeUpdateStrategy::FixedTimesteps(1));
    app.insert_resource(Time::<Fixed>::from_hz(60.0));
    app.insert_resource(SceneRequirements { rigid: true, ..Default::default() });
    // The first update only starts the clocks.
    app.update();
    app
}

fn clip() -> RigidBody {
    let half = Vec3::new(0.004, 0.0005, 0.00075);
    let corner = |i: u8| half * Vec3::new(f32::from(i & 1), f32::from(i >> 1 & 1), f32::from(i >> 2)) * 2.0 - half;
    RigidBody { shape: RigidShape::Hull((0..8).map(corner).collect()), density_kg_m3: 4500.0 }
}

/// A block of tissue, 4 cm wide and 1 cm thick with its top at zero.
fn organ(app: &mut App) -> Entity {
    let mesh = block([12, 3, 12], [0.04, 0.01, 0.04]);
    let mut state = TissueState::at_rest(&mesh);
    state.positions.iter_mut().for_each(|x| *x -= Vec3::new(0.02, 0.01, 0.02));
    app.world_mut().spawn((Organ { name: "block".into() }, TissueMesh(mesh), state)).id()
}

fn pose(app: &App, body: Entity) -> RigidPose {
    *app.world().get::<RigidPose>(body).unwrap()
}

/// Moves every node of an organ as tissue would.
fn shift(app: &mut App, organ: Entity, velocity: Vec3) {
    let mut state = app.world_mut().get_mut::<TissueState>(organ).unwrap();
    let state = &mut *state;
    for (x, v) in state.positions.iter_mut().zip(&mut state.velocities) {
        *x += velocity / 60.0;
        *v = velocity;
    }
}

#[test]
fn a_clip_lies_on_an_organ_and_goes_with_it() {
    let mut app = app();
    let organ = organ(&mut app);
    let tilted = Isometry3d::new(Vec3::new(0.001, 0.03, 0.002), Quat::from_euler(bevy_math::EulerRot::XYZ, 0.4, 0.3, 0.5));
    let body = app.world_mut().spawn((clip(), RigidPose::at_rest(tilted))).id();
    for _ in 0..120 {
        app.update();
        assert!(pose(&app, body).now.translation.y > 0.0);
    }
    let lies = pose(&app, body);
    assert!(lies.asleep, "{lies:?}");
    assert!((0.0004..0.0009).contains(&lies.now.translation.y), "{lies:?}");
    // The organ is lifted, carried aside and lowered again; the clip stays where it lies on it.
    let ways = [(0.06 * Vec3::Y, 30), (Vec3::ZERO, 60), (0.01 * Vec3::X, 60), (Vec3::ZERO, 60), (-0.06 * Vec3::Y, 30), (Vec3::ZERO, 120)];
    let mut top = Vec3::ZERO;
    for (velocity, ticks) in ways {
        for _ in 0..ticks {
            shift(&mut app, organ, velocity);
            top += velocity / 60.0;
            app.update();
            let above = pose(&app, body).now.translation.y - top.y;
            assert!((0.0..0.006).contains(&above), "{above} above the organ");
        }
    }
    let end = pose(&app, body);
    let slid = Vec3::from(end.now.translation - lies.now.translation) - top;
    println!("slid {slid} m on an organ that was carried about");
    assert!(slid.length() < 0.003 && end.asleep, "{end:?}");
    assert_eq!(app.world().resource::<RigidReport>().awake, 0);
}

/// Thrown at 10 m/s at a slab of tissue, 2 mm thick, from either side.
#[test]
fn a_clip_passes_no_tissue() {
    for from in [1.0f32, -1.0] {
        let mut app = app();
        app.insert_resource(keyhole_whiteboard::Gravity(Vec3::ZERO));
        let mesh = block([12, 1, 12], [0.3, 0.002, 0.3]);
        let mut state = TissueState::at_rest(&mesh);
        state.positions.iter_mut().for_each(|x| *x -= Vec3::new(0.15, 0.001, 0.15));
        app.world_mut().spawn((Organ { name: "slab".into() }, TissueMesh(mesh), state));
        let start = RigidPose { linear_m_s: Vec3::Y * from * -10.0, ..RigidPose::at_rest(Isometry3d::from_xyz(0.003, from * 0.2, 0.007)) };
        let body = app.world_mut().spawn((clip(), start)).id();
        for _ in 0..20 {
            app.update();
            assert!(pose(&app, body).now.translation.y * from > 0.0);
        }
        assert!(pose(&app, body).linear_m_s.length() < 1.0, "of its energy less than a hundredth is left");
    }
}

#[test]
fn a_held_body_goes_with_its_instrument_and_flies_when_let_go() {
    let mut app = app();
    let at = |x: f32| Isometry3d::from_xyz(x, 0.0, 0.0);
    let tool = Instrument { kind: InstrumentKind::Grasper, name: "holder".into(), shaft_length_m: 0.3, shaft_radius_m: 0.0025 };
    let tool = app.world_mut().spawn((tool, InstrumentPose { now: at(0.0), before: at(0.0) })).id();
    let local = Isometry3d::from_xyz(0.0, 0.0, -0.01);
    let body = app.world_mut().spawn((clip(), RigidPose::at_rest(local), HeldBy { instrument: tool, local })).id();
    let mut x = 0.0;
    for _ in 0..30 {
        let before = x;
        x += 0.5 / 60.0;
        *app.world_mut().get_mut::<InstrumentPose>(tool).unwrap() = InstrumentPose { now: at(x), before: at(before) };
        app.update();
        assert!(pose(&app, body).now.translation.distance((at(x) * local).translation) < 1e-6);
    }
    assert!((pose(&app, body).linear_m_s - 0.5 * Vec3::X).length() < 1e-4);
    app.world_mut().entity_mut(body).remove::<HeldBy>();
    *app.world_mut().get_mut::<InstrumentPose>(tool).unwrap() = InstrumentPose { now: at(-1.0), before: at(-1.0) };
    app.update();
    let flies = pose(&app, body).linear_m_s;
    assert!((flies - Vec3::new(0.5, -9.81 / 60.0, 0.0)).length() < 1e-3, "{flies}");
}

/// A fragment becomes rigid, falls, is taken hold of and is soft again, with the momentum that it had as a rigid body.
#[test]
fn a_fragment_becomes_rigid_and_soft_again() {
    let mut app = app();
    app.insert_resource(RigidFragments { lighter_than_kg: Some(0.01), unseen_for_s: None });
    let organ = organ(&mut app);
    let mesh = block([3; 3], [0.01; 3]);
    let mut state = TissueState::at_rest(&mesh);
    state.positions.iter_mut().for_each(|x| *x = *x * Vec3::new(1.0, 0.8, 1.1) + Vec3::Y * 0.05);
    let freed = FreedFrom { donor: organ, time_s: 0.0 };
    let piece = app.world_mut().spawn((Organ { name: "piece".into() }, TissueMesh(mesh), state.clone(), freed)).id();
    for tick in 0.. {
        app.update();
        if app.world().get::<Rigidified>(piece).is_some() {
            println!("rigid after {tick} ticks");
            break;
        }
        assert!(tick < 30);
    }
    for _ in 0..200 {
        app.update();
    }
    let lies = app.world().get::<TissueState>(piece).unwrap().clone();
    let lowest = lies.positions.iter().map(|x| x.y).fold(f32::MAX, f32::min);
    println!("a fragment lies {lowest} m above the organ");
    assert!(lowest.abs() < 2e-4, "{lowest}");
    let height = |s: &TissueState| {
        s.positions.iter().map(|x| x.y).fold(f32::MIN, f32::max) - s.positions.iter().map(|x| x.y).fold(f32::MAX, f32::min)
    };
    assert!((height(&lies) - height(&state)).abs() < 2e-4, "it is frozen as it was deformed");
    app.world_mut().get_mut::<Attachments>(piece).unwrap().0.push(Attachment::node_to_space(NodeId(0), Vec3::ZERO, 1e-3));
    app.update();
    assert!(app.world().get::<Rigidified>(piece).is_none() && app.world().get::<RigidBody>(piece).is_none());
    assert_eq!(app.world().get::<TissueState>(piece).unwrap(), &lies);
    assert_eq!((app.world().resource::<RigidReport>().rigidified, app.world().resource::<RigidReport>().softened), (1, 1));
    // It stays soft while it is held.
    for _ in 0..60 {
        app.update();
    }
    assert!(app.world().get::<Rigidified>(piece).is_none());
}

#[test]
fn what_is_no_number_is_put_back_and_reported() {
    let mut app = app();
    let good = app.world_mut().spawn((clip(), RigidPose::default())).id();
    let start = RigidPose { angular_rad_s: Vec3::splat(f32::NAN), ..RigidPose::at_rest(Isometry3d::from_xyz(0.1, 0.0, 0.0)) };
    let bad = app.world_mut().spawn((clip(), start)).id();
    let flat = RigidBody { shape: RigidShape::Hull(vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::ONE.with_z(0.0)]), density_kg_m3: 1.0 };
    let flat = app.world_mut().spawn(flat).id();
    for _ in 0..10 {
        app.update();
    }
    assert!(app.world().get::<RigidQuarantined>(bad).is_some());
    assert_eq!(pose(&app, bad).now, start.now);
    assert!(pose(&app, good).now.translation.y < 0.0);
    let report = app.world().resource::<RigidReport>();
    assert_eq!((report.quarantined.clone(), report.refused.clone(), report.awake), (vec![bad], vec![flat], 1));
}

/// A heap of clips and needles falls onto an organ: the same bits twice.
#[test]
fn the_same_bits_twice() {
    let run = || {
        let mut app = app();
        organ(&mut app);
        let arc = |i: u8| {
            let (y, x) = (f32::from(i) * 0.3).sin_cos();
            0.005 * Vec3::new(x, y, 0.0)
        };
        let needle = RigidBody { shape: RigidShape::Wire { points: (0..9).map(arc).collect(), radius_m: 0.0004 }, density_kg_m3: 7900.0 };
        let mut bodies = Vec::new();
        for i in 0..10u8 {
            let turn = Quat::from_rotation_z(f32::from(i));
            let at = Isometry3d::new(Vec3::new(0.002 * f32::from(i % 3), 0.01 + 0.004 * f32::from(i), 0.0), turn);
            let body = if i % 3 == 0 { needle.clone() } else { clip() };
            bodies.push(app.world_mut().spawn((body, RigidPose::at_rest(at))).id());
        }
        for _ in 0..240 {
            app.update();
        }
        bodies.iter().map(|b| pose(&app, *b)).collect::<Vec<_>>()
    };
    let (first, second) = (run(), run());
    assert_eq!(first, second);
    for lies in &first {
        println!("{} asleep {}", lies.now.translation, lies.asleep);
        assert!(lies.now.translation.y > 0.0 || lies.now.translation.x.abs() > 0.02 || lies.now.translation.z.abs() > 0.02, "{lies:?}");
    }
}

#[test]
fn where_nothing_rigid_is_required_nothing_moves() {
    let mut app = app();
    app.insert_resource(SceneRequirements { tissue: true, ..Default::default() });
    let body = app.world_mut().spawn((clip(), RigidPose::default())).id();
    app.update();
    assert_eq!(pose(&app, body), RigidPose::default());
}
