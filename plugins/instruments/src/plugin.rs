//! Glue: gathers the trainee's input at frame rate, and each tick moves every instrument and the endoscope.

use crate::device::{DeviceClutch, device_tick};
use crate::force::Felt;
use crate::hands::{HandSettings, KEYS, hand_tick, scope_tick};
use crate::kinematics::{PortFrame, TrocarLimits, TrocarState};
use crate::line::{Controls, JawStroke, blade_now};
use crate::proxy::{Proxy, ProxySettings};
use crate::script::Script;
use crate::tools;
use bevy_app::prelude::*;
use bevy_ecs::prelude::*;
use bevy_input::ButtonInput;
use bevy_input::keyboard::KeyCode;
use bevy_input::mouse::{AccumulatedMouseMotion, AccumulatedMouseScroll, MouseButton, MouseScrollUnit};
use bevy_math::{Vec2, Vec3};
use bevy_time::{Fixed, Time};
use keyhole_whiteboard::{
    Blade, Contacts, CuttingLine, DeviceHands, Endoscope, Grasp, Hand, HandInput, Instrument, InstrumentPose, JawPads, Jaws, KeyMap, Moved,
    PointerClaims, Port, SceneRequirements, ScriptClock, SenseSystems, SimulationControl, TickSystems, ToolContacts, ToolForce,
};

/// Pixels of a touchpad's scroll that count as one notch of a wheel.
const PIXELS_PER_NOTCH: f32 = 40.0;

/// Moves the instruments. An instrument is an entity with `Instrument`, `Hand`, `Port` and [`TrocarState`]; the endoscope one with
/// `Endoscope`, `Port` and [`TrocarState`].
pub struct InstrumentsPlugin;

impl Plugin for InstrumentsPlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<HandInput>()
            .init_resource::<HandSettings>()
            .init_resource::<ProxySettings>()
            .init_resource::<Script>()
            .init_resource::<ScriptClock>()
            .register_required_components::<TrocarState, TrocarLimits>()
            .register_required_components::<Instrument, DeviceClutch>()
            .register_required_components::<Instrument, Proxy>()
            .register_required_components::<Instrument, ToolForce>()
            .register_required_components::<CuttingLine, JawStroke>()
            .add_observer(equip)
            .add_systems(RunFixedMainLoop, gather_input.in_set(RunFixedMainLoopSystems::BeforeFixedMainLoop))
            .add_systems(
                FixedUpdate,
                (
                    (drop_input, disengage, advance_clock, perform_hands, perform_view).chain().run_if(performing),
                    (move_device_hands, move_active_hand, move_endoscope).chain().run_if(not(performing)),
                    publish_instruments,
                    publish_endoscope,
                )
                    .chain()
                    .in_set(SenseSystems::Hands)
                    .run_if(SceneRequirements::instruments),
            )
            .add_systems(FixedUpdate, sum_forces.in_set(TickSystems::Assess).run_if(SceneRequirements::instruments));
        app.world_mut().get_resource_or_init::<KeyMap>().push_all(KEYS);
    }
}

fn performing(control: Res<SimulationControl>) -> bool {
    control.demonstration
}

/// Gives a new instrument its cutting line and its pads, unless the scene gave them, and its model.
fn equip(added: On<Add, Instrument>, instruments: Query<(&Instrument, Option<&CuttingLine>)>, mut commands: Commands) {
    let Ok((instrument, given)) = instruments.get(added.entity) else { return };
    let line = given.copied().or_else(|| tools::cutting_line(instrument.kind));
    let model = tools::tool_model(instrument.kind, instrument.shaft_length_m, instrument.shaft_radius_m, line.as_ref());
    let mut entity = commands.entity(added.entity);
    entity.insert_if_new(model);
    if let Some(line) = line {
        entity.insert_if_new(line);
    }
    if let Some(pads) = tools::jaw_pads(instrument.kind, instrument.shaft_radius_m) {
        entity.insert_if_new(pads);
    }
}

/// The devices may be missing: a headless run has none.
fn gather_input(
    mut input: ResMut<HandInput>,
    keys: Option<Res<ButtonInput<KeyCode>>>,
    buttons: Option<Res<ButtonInput<MouseButton>>>,
    motion: Option<Res<AccumulatedMouseMotion>>,
    scroll: Option<Res<AccumulatedMouseScroll>>,
    claims: Option<Res<PointerClaims>>,
) {
    let claimed = claims.is_some_and(|c| c.any());
    let key = |k: KeyCode| keys.as_ref().is_some_and(|keys| keys.pressed(k));
    let button = |b: MouseButton| buttons.as_ref().is_some_and(|buttons| buttons.pressed(b));
    if keys.as_ref().is_some_and(|keys| keys.just_pressed(KeyCode::Tab)) {
        input.switch_hand();
    }
    input.moved = match (key(KeyCode::KeyC) || button(MouseButton::Right), key(KeyCode::ShiftLeft) || key(KeyCode::ShiftRight)) {
        (false, _) => Moved::Hand,
        (true, false) => Moved::Endoscope,
        (true, true) => Moved::EndoscopeRoll,
    };
    input.roll = f32::from(u8::from(key(KeyCode::KeyE))) - f32::from(u8::from(key(KeyCode::KeyQ)));
    // A squeeze that began on the tissue goes on over the HUD; one that begins there is a click.
    input.squeezed = button(MouseButton::Left) && (input.squeezed || !claimed);
    if claimed {
        return;
    }
    // The window's y points down.
    let motion = motion.map_or(Vec2::ZERO, |m| Vec2::new(m.delta.x, -m.delta.y));
    let notches = scroll.map_or(0.0, |s| match s.unit {
        MouseScrollUnit::Line => s.delta.y,
        MouseScrollUnit::Pixel => s.delta.y / PIXELS_PER_NOTCH,
    });
    input.gather(motion, notches);
}

/// What the trainee did while the demonstration ran must not move anything once it is over.
fn drop_input(mut input: ResMut<HandInput>) {
    let _ = input.take();
}

fn advance_clock(mut clock: ResMut<ScriptClock>, script: Res<Script>, time: Res<Time<Fixed>>) {
    clock.end_s = script.end_s();
    clock.advance(time.timestep().as_secs_f64());
}

fn perform_hands(
    script: Res<Script>,
    clock: Res<ScriptClock>,
    mut instruments: Query<(&Instrument, &Hand, &Port, &TrocarLimits, Option<&CuttingLine>, &mut TrocarState)>,
) {
    for (instrument, hand, port, limits, line, mut state) in &mut instruments {
        let Some(key) = script.hand(*hand, clock.time_s) else { continue };
        let reach = tools::working_reach(instrument.kind, line);
        let told = TrocarState { roll_rad: key.roll_rad, grip: key.grip, pedal: key.active, ..*state };
        if let Some(wanted) = PortFrame::of(port).reach(key.tip, reach, &told) {
            *state = limits.clamp(wanted);
        }
    }
}

fn perform_view(
    script: Res<Script>,
    clock: Res<ScriptClock>,
    mut endoscopes: Query<(&Endoscope, &Port, &TrocarLimits, &mut TrocarState), Without<Instrument>>,
) {
    let Some(key) = script.view(clock.time_s) else { return };
    for (endoscope, port, limits, mut state) in &mut endoscopes {
        let tilt = endoscope.direction_of_view_rad;
        if let Some(wanted) = PortFrame::of(port).look_at(key.target, key.distance_m, tilt, &state) {
            *state = limits.clamp(wanted);
        }
    }
}

/// When the demonstration is over a device goes on from where the instruments are.
fn disengage(mut clutches: Query<&mut DeviceClutch>) {
    for mut clutch in &mut clutches {
        clutch.set_if_neq(DeviceClutch::default());
    }
}

fn move_device_hands(
    devices: Res<DeviceHands>,
    mut instruments: Query<(&Hand, &TrocarLimits, &mut TrocarState, &mut DeviceClutch), With<Instrument>>,
) {
    for (hand, limits, mut state, mut clutch) in &mut instruments {
        if let Some(input) = devices.get(*hand) {
            *state = device_tick(*state, &mut clutch, input, limits);
        }
    }
}

/// A hand that is in a device is not moved by the mouse as well: what it holds while its device has a fault must not be dropped.
fn move_active_hand(
    input: Res<HandInput>,
    devices: Res<DeviceHands>,
    settings: Res<HandSettings>,
    time: Res<Time<Fixed>>,
    mut instruments: Query<(&Instrument, &Hand, &TrocarLimits, &mut TrocarState)>,
) {
    let dt_s = time.timestep().as_secs_f32();
    for (instrument, hand, limits, mut state) in &mut instruments {
        if *hand == input.active && devices.get(*hand).is_none() {
            *state = hand_tick(*state, &input, &settings, limits, instrument.shaft_length_m, dt_s);
        }
    }
}

fn move_endoscope(
    mut input: ResMut<HandInput>,
    settings: Res<HandSettings>,
    mut endoscopes: Query<(&TrocarLimits, &mut TrocarState), (With<Endoscope>, Without<Instrument>)>,
) {
    let taken = input.take();
    for (limits, mut state) in &mut endoscopes {
        *state = scope_tick(*state, &taken, &settings, limits);
    }
}

type Cuts<'a> = (&'a CuttingLine, &'a mut JawStroke, &'a mut Blade);

type Held<'a> = (&'a mut Proxy, Option<&'a ToolContacts>, Option<&'a Grasp>);

type Published<'a> = (&'a Instrument, &'a Port, Ref<'a, TrocarState>, Held<'a>, &'a mut InstrumentPose, &'a mut Jaws, Option<Cuts<'a>>);

fn publish_instruments(mut instruments: Query<Published>, settings: Res<ProxySettings>, time: Res<Time<Fixed>>) {
    for (instrument, port, state, (mut proxy, contacts, grasp), mut pose, mut jaws, cuts) in &mut instruments {
        // An instrument that has just come has not moved here from anywhere, and its jaws stand as they are.
        let came = state.is_added();
        if came {
            *proxy = Proxy::default();
        }
        let reach = tools::working_reach(instrument.kind, cuts.as_ref().map(|c| c.0));
        let near = contacts.map_or(&[][..], |c| &c.near);
        let frame = PortFrame::of(port);
        let held = proxy.follow(&frame, *state, near, reach, instrument.shaft_radius_m, &settings, time.timestep().as_secs_f32());
        let now = frame.pose(&held);
        // Tissue between the jaws stops them.
        let stop_rad = grasp.map_or(0.0, |g| g.least_angle_rad);
        let now_rad = ((1.0 - state.grip) * tools::widest_angle_rad(instrument.kind)).max(stop_rad);
        let before_rad = if came { now_rad } else { jaws.angle_rad };
        if let Some((line, mut stroke, mut blade)) = cuts {
            let controls = Controls { pedal: state.pedal && !came, before_rad, now_rad };
            blade.set_if_neq(blade_now(line, controls, &mut stroke));
        }
        *pose = InstrumentPose { now, before: if came { now } else { pose.now } };
        jaws.angle_rad = now_rad;
    }
}

type Felts<'a> = (
    Entity,
    &'a Instrument,
    &'a Port,
    &'a InstrumentPose,
    &'a Proxy,
    Option<(&'a Grasp, &'a JawPads)>,
    Option<&'a CuttingLine>,
    &'a mut ToolForce,
);

/// What tissue has done to each instrument in this tick, and what holds it off the hand.
fn sum_forces(mut instruments: Query<Felts>, organs: Query<(Entity, &Contacts)>, settings: Res<ProxySettings>) {
    let mut organs: Vec<_> = organs.iter().collect();
    organs.sort_unstable_by_key(|o| o.0);
    for (entity, instrument, port, pose, proxy, grasp, line, mut force) in &mut instruments {
        let mut felt = Felt::default();
        for (_, contacts) in &organs {
            let (force_n, torque_n_m) = contacts.wrench_on(entity, port.position);
            felt.force_n += force_n;
            felt.torque_n_m += torque_n_m;
        }
        if let Some((grasp, pads)) = grasp {
            let middle = pose.now * Vec3::new(0.0, 0.0, -0.5 * (pads.from_m + pads.to_m));
            felt.add(grasp.pull_n, middle - port.position);
        }
        let reach = tools::working_reach(instrument.kind, line);
        if let Some((force_n, at)) = proxy.coupling(&PortFrame::of(port), reach, &settings) {
            felt.add(force_n, at - port.position);
        }
        let tip = pose.now * Vec3::new(0.0, 0.0, -reach);
        force.set_if_neq(felt.on_a_line(port.position, tip, grasp.map_or(0.0, |(g, _)| g.pinch_n)));
    }
}

fn publish_endoscope(mut endoscopes: Query<(&Port, &TrocarState, &mut Endoscope)>) {
    for (port, state, mut endoscope) in &mut endoscopes {
        // The camera head keeps the horizon; turning the scope only orbits the view.
        endoscope.pose = PortFrame::of(port).pose(&TrocarState { roll_rad: 0.0, ..*state });
        endoscope.roll_rad = state.roll_rad;
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
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
        let torque =
            -(tip - port).cross(Vec3::Y) - (tip + Vec3::X * 0.01 - port).cross(Vec3::new(1.0, 2.0, 0.0)) + held.cross(5.0 * Vec3::Z);
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
}
