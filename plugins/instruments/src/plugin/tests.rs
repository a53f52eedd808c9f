//! The plugin in an app, tick by tick.

use super::*;
use crate::script::{HandKey, HandTrack, ViewKey};
use bevy_math::{Isometry3d, Vec3};
use bevy_time::{TimePlugin, TimeUpdateStrategy};
use keyhole_whiteboard::{Contact, InstrumentKind, Obstacle, TissuePoint, ToolTouch, WhiteboardPlugin};

const HZ: f64 = 60.0;

fn theatre() -> (App, [Entity; 3]) {
    let mut app = App::new();
    app.add_plugins((TimePlugin, WhiteboardPlugin, InstrumentsPlugin))
        .insert_resource(Time::<Fixed>::from_hz(HZ))
        .insert_resource(TimeUpdateStrategy::FixedTimesteps(1))
        .insert_resource(SceneRequirements { instruments: true, ..Default::default() });
    let instrument = |kind| Instrument { kind, name: "tool".into(), shaft_length_m: 0.33, shaft_radius_m: 0.0025 };
    let port = |x| Port { position: Vec3::new(x, 0.1, 0.1), inward: Vec3::new(-x, -0.1, -0.1).normalize() };
    let state = TrocarState { insertion_m: 0.1, ..Default::default() };
    let world = app.world_mut();
    let right = world.spawn((instrument(InstrumentKind::Hook), Hand::Right, port(0.1), state)).id();
    let left = world.spawn((instrument(InstrumentKind::Scissors), Hand::Left, port(-0.1), state)).id();
    let endoscope = Endoscope {
        pose: Isometry3d::IDENTITY,
        direction_of_view_rad: 30f32.to_radians(),
        angle_of_view_rad: 70f32.to_radians(),
        roll_rad: 0.0,
        head_roll_rad: 0.0,
    };
    let scope = world.spawn((endoscope, port(0.0), state)).id();
    // The clock's first update measures no time and runs no tick.
    app.update();
    app.update();
    (app, [right, left, scope])
}

fn pose(app: &App, instrument: Entity) -> InstrumentPose {
    *app.world().get(instrument).unwrap()
}

#[test]
fn the_mouse_moves_the_active_hand_and_tab_the_other() {
    let (mut app, [right, left, _]) = theatre();
    app.init_resource::<ButtonInput<KeyCode>>().insert_resource(AccumulatedMouseMotion { delta: Vec2::new(10.0, 0.0) });
    let at_rest = [right, left].map(|i| pose(&app, i).now);
    app.update();
    assert_ne!(pose(&app, right).now, at_rest[0]);
    assert_eq!(pose(&app, right).before, at_rest[0]);
    assert_eq!(pose(&app, left).now, at_rest[1]);
    app.world_mut().resource_mut::<ButtonInput<KeyCode>>().press(KeyCode::Tab);
    let held = pose(&app, right).now;
    app.update();
    assert_eq!(pose(&app, right).now, held);
    assert_ne!(pose(&app, left).now, at_rest[1]);
}

#[test]
fn a_mouse_that_somebody_else_wants_moves_nothing_and_squeezes_nothing() {
    let (mut app, [right, _, _]) = theatre();
    let mut buttons = ButtonInput::<MouseButton>::default();
    buttons.press(MouseButton::Left);
    app.insert_resource(AccumulatedMouseMotion { delta: Vec2::new(10.0, 5.0) });
    app.insert_resource(PointerClaims { hud: true, camera: false }).insert_resource(buttons);
    let at_rest = pose(&app, right).now;
    app.update();
    assert_eq!(pose(&app, right).now, at_rest);
    assert!(!app.world().get::<Blade>(right).unwrap().active);
}

#[test]
fn the_hook_cuts_while_the_button_is_down_and_scissors_sweep_their_opening_while_closing() {
    let (mut app, [right, left, _]) = theatre();
    let mut buttons = ButtonInput::<MouseButton>::default();
    buttons.press(MouseButton::Left);
    app.insert_resource(buttons);
    app.update();
    assert!(app.world().get::<Blade>(right).unwrap().active);
    assert!(!app.world().get::<Blade>(left).unwrap().active);
    app.world_mut().resource_mut::<HandInput>().switch_hand();
    let mut swept = 0.0;
    let mut last: Option<Blade> = None;
    for _ in 0..30 {
        app.update();
        let blade = *app.world().get::<Blade>(left).unwrap();
        // Half a trapezoid's heights times its sides, in the plane of the jaws.
        let step = |from: Blade| (from.tip.z - blade.tip.z) * (from.tip.y + blade.tip.y);
        swept += last.filter(|l| l.active && blade.active).map_or(0.0, step);
        last = Some(blade);
    }
    assert!(!last.unwrap().active, "closed scissors cut nothing");
    let (length, open) = (tools::SCISSORS_JAW_M, tools::widest_angle_rad(InstrumentKind::Scissors));
    let wedge = length * length * open.sin() * open.cos();
    assert!((swept / wedge - 1.0).abs() < 1e-3, "{swept} against {wedge} m2");
}

#[test]
fn a_demonstration_puts_the_blade_and_the_view_where_its_keyframes_say() {
    let (mut app, [right, _, scope]) = theatre();
    let tips = [Vec3::new(-0.02, 0.0, 0.0), Vec3::new(0.02, -0.01, 0.01)];
    let key = |i: usize| HandKey { time_s: i as f64, tip: tips[i], roll_rad: 0.0, grip: 0.0, active: i == 0 };
    let view = ViewKey { time_s: 0.0, target: tips[1], distance_m: 0.06 };
    let script = Script::new(vec![HandTrack { hand: Hand::Right, keys: vec![key(0), key(1)] }], vec![view]).unwrap();
    app.insert_resource(script);
    app.world_mut().resource_mut::<SimulationControl>().demonstration = true;
    for _ in 0..30 {
        app.update();
    }
    assert!(app.world().get::<Blade>(right).unwrap().active);
    let tip = |app: &App| pose(app, right).now * app.world().get::<Blade>(right).unwrap().tip;
    assert!(tip(&app).distance(tips[0].lerp(tips[1], 0.5)) < 1e-5, "{}", tip(&app));
    for _ in 0..31 {
        app.update();
    }
    let clock = *app.world().resource::<ScriptClock>();
    assert_eq!((clock.ticks, clock.finished()), (61, true));
    assert!(tip(&app).distance(tips[1]) < 1e-5);
    assert!(!app.world().get::<Blade>(right).unwrap().active);
    let scope = app.world().get::<Endoscope>(scope).unwrap();
    let gaze = scope.pose.rotation * bevy_math::Quat::from_rotation_x(-scope.direction_of_view_rad) * Vec3::NEG_Z;
    assert!((Vec3::from(scope.pose.translation) + 0.06 * gaze).distance(tips[1]) < 1e-5);
}

fn contact(tool: Entity, surface_m: Vec3, force_n: Vec3) -> Contact {
    Contact {
        point: TissuePoint::new(),
        normal: Vec3::Y,
        depth_m: 0.0,
        surface_m,
        velocity_m_s: Vec3::ZERO,
        friction: 0.0,
        against: Obstacle::Instrument(tool),
        force_n,
    }
}

#[test]
fn what_tissue_and_grasp_do_is_felt_as_one_force() {
    let (mut app, [right, left, _]) = theatre();
    let (tip, port) = (Vec3::from(pose(&app, left).now.translation), app.world().get::<Port>(left).unwrap().position);
    for (at, force) in [(tip, Vec3::Y), (tip + Vec3::X * 0.01, Vec3::new(1.0, 2.0, 0.0))] {
        app.world_mut().spawn(Contacts(vec![contact(left, at, force), contact(right, at, Vec3::ZERO)]));
    }
    let grasp = Grasp { pinch_n: 3.0, pull_n: Vec3::new(0.0, 0.0, 5.0), ..Default::default() };
    let pads = JawPads { from_m: 0.01, to_m: 0.02, half_width_m: 0.002, closed_gap_m: 0.0003 };
    app.world_mut().entity_mut(left).insert((grasp, pads));
    app.update();
    let felt = *app.world().get::<ToolForce>(left).unwrap();
    assert_eq!((felt.force_n, felt.grip_n), (Vec3::new(-1.0, -3.0, 5.0), 3.0));
    let held = pose(&app, left).now * Vec3::new(0.0, 0.0, -0.015) - port;
    let torque = -(tip - port).cross(Vec3::Y) - (tip + Vec3::X * 0.01 - port).cross(Vec3::new(1.0, 2.0, 0.0)) + held.cross(5.0 * Vec3::Z);
    // A single force has all of the torque but what twists about its own line.
    let line = felt.force_n.normalize();
    assert!(((felt.at - port).cross(felt.force_n) - torque.reject_from_normalized(line)).length() < 1e-5);
    let other = *app.world().get::<ToolForce>(right).unwrap();
    assert_eq!((other.force_n, other.grip_n), (Vec3::ZERO, 0.0));
}

#[test]
fn an_instrument_stops_before_what_it_was_against_and_the_hand_feels_it() {
    let (mut app, [right, _, _]) = theatre();
    let reach = tools::working_reach(InstrumentKind::Hook, tools::cutting_line(InstrumentKind::Hook).as_ref());
    let tip = |app: &App| pose(app, right).now * Vec3::new(0.0, 0.0, -reach);
    let (at, inward) = (tip(&app), app.world().get::<Port>(right).unwrap().inward);
    let wall = app.world_mut().spawn_empty().id();
    for _ in 0..30 {
        app.world_mut().get_mut::<TrocarState>(right).unwrap().insertion_m += 0.001;
        let point = tip(&app);
        let depth_m = (point - at).dot(inward) - 0.004;
        let touch = ToolTouch { point, normal: -inward, depth_m, against: Obstacle::Anatomy(wall) };
        app.world_mut().entity_mut(right).insert(ToolContacts { near: vec![touch], ..Default::default() });
        app.update();
        assert!((tip(&app) - at).dot(inward) < 0.0041);
    }
    let felt = *app.world().get::<ToolForce>(right).unwrap();
    // 26 mm at 500 N/m are more than the largest force.
    assert!((felt.force_n + 3.3 * inward).length() < 0.05, "{felt:?}");
}
