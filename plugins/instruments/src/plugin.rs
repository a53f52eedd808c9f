//! Glue: gathers the trainee's input at frame rate, and each tick moves every instrument and the endoscope.

use crate::device::{DeviceClutch, device_tick};
use crate::exchange::{ExchangeSettings, Progress, begin, exchange_tick};
use crate::force::Felt;
use crate::hands::{HandSettings, KEYS, hand_tick, head_roll, scope_tick};
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
    Blade, ClipApplier, Contacts, CuttingLine, DeviceHands, Endoscope, Exchange, Grasp, Hand, HandInput, Instrument, InstrumentKind,
    InstrumentPose, JawPads, Jaws, KeyMap, Moved, PointerClaims, Port, SceneRequirements, ScriptClock, SenseSystems, SimulationControl,
    StateOf, Suction, SuctionValve, TickSystems, ToolContacts, ToolForce, Tray,
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
            .init_resource::<ExchangeSettings>()
            .init_resource::<Script>()
            .init_resource::<ScriptClock>()
            .register_required_components::<TrocarState, TrocarLimits>()
            .register_required_components::<Instrument, DeviceClutch>()
            .register_required_components::<Instrument, Proxy>()
            .register_required_components::<Instrument, ToolForce>()
            .register_required_components::<CuttingLine, JawStroke>()
            .watched_state::<TrocarState>()
            .state::<DeviceClutch>()
            .state::<Proxy>()
            .state::<JawStroke>()
            .add_observer(equip)
            .add_systems(
                RunFixedMainLoop,
                gather_input.in_set(RunFixedMainLoopSystems::BeforeFixedMainLoop).run_if(SceneRequirements::instruments),
            )
            .add_systems(
                FixedUpdate,
                (
                    (drop_input, disengage, advance_clock, perform_hands, perform_view).chain().run_if(performing),
                    (begin_exchange, move_device_hands, move_active_hand, exchange, move_endoscope).chain().run_if(not(performing)),
                    publish_instruments,
                    publish_valves,
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

/// Gives a new instrument its cutting line, its pads and what it takes up, unless the scene gave them, and its model.
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
    if let Some(suction) = tools::suction(instrument.kind) {
        entity.insert_if_new(suction);
    }
}

/// Starts the exchange that the active hand asks for.
fn begin_exchange(
    input: Res<HandInput>,
    settings: Res<ExchangeSettings>,
    instruments: Query<(Entity, &Hand, &Tray), (With<Instrument>, Without<Exchange>)>,
    mut commands: Commands,
) {
    for (entity, _, tray) in instruments.iter().filter(|(_, hand, _)| input.exchange && **hand == input.active) {
        if let Some(next) = tray.0.first() {
            commands.entity(entity).insert(begin(*next, &settings));
        }
    }
}

type Exchanged<'a> =
    (Entity, &'a mut Instrument, &'a mut Tray, &'a mut Exchange, &'a TrocarLimits, &'a mut TrocarState, &'a mut DeviceClutch);

/// Goes on with what exchanges are under way.
fn exchange(mut instruments: Query<Exchanged>, settings: Res<ExchangeSettings>, time: Res<Time<Fixed>>, mut commands: Commands) {
    for (entity, mut instrument, mut tray, mut exchange, limits, mut state, mut clutch) in &mut instruments {
        let (now, progress) = exchange_tick(*state, &mut exchange, &settings, limits, time.timestep().as_secs_f32());
        *state = now;
        match progress {
            Progress::GoesOn => {}
            Progress::Swap => {
                if let Some(place) = tray.0.iter().position(|kind| *kind == exchange.to) {
                    tray.0.remove(place);
                }
                tray.0.push(instrument.kind);
                (instrument.kind, instrument.name) = (exchange.to, tools::name(exchange.to).into());
                let mut entity = commands.entity(entity);
                entity.remove::<(CuttingLine, JawStroke, Blade, JawPads, Grasp, ClipApplier, Suction, SuctionValve)>();
                let line = tools::cutting_line(instrument.kind);
                entity.insert(tools::tool_model(instrument.kind, instrument.shaft_length_m, instrument.shaft_radius_m, line.as_ref()));
                if let Some(line) = line {
                    entity.insert(line);
                }
                if let Some(pads) = tools::jaw_pads(instrument.kind, instrument.shaft_radius_m) {
                    entity.insert(pads);
                }
                if let Some(suction) = tools::suction(instrument.kind) {
                    entity.insert(suction);
                }
                if instrument.kind == InstrumentKind::ClipApplier {
                    // One that comes in anew comes with a full cartridge.
                    entity.insert(ClipApplier::default());
                }
            }
            Progress::Done => {
                // A handle is wherever it is: it goes on from here.
                *clutch = DeviceClutch::default();
                commands.entity(entity).remove::<Exchange>();
            }
        }
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
    input.exchange |= keys.as_ref().is_some_and(|keys| keys.just_pressed(KeyCode::KeyX));
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
    mut instruments: Query<(&Hand, &TrocarLimits, &mut TrocarState, &mut DeviceClutch), (With<Instrument>, Without<Exchange>)>,
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
    mut instruments: Query<(&Instrument, &Hand, &TrocarLimits, &mut TrocarState), Without<Exchange>>,
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
    time: Res<Time<Fixed>>,
    mut endoscopes: Query<(&TrocarLimits, &mut TrocarState, &mut Endoscope), Without<Instrument>>,
) {
    let taken = input.take();
    for (limits, mut state, mut endoscope) in &mut endoscopes {
        *state = scope_tick(*state, &taken, &settings, limits);
        endoscope.head_roll_rad += head_roll(&taken, &settings, time.timestep().as_secs_f32());
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

/// The pedal opens a suction.
fn publish_valves(mut suctions: Query<(&TrocarState, &mut SuctionValve)>) {
    for (state, mut valve) in &mut suctions {
        valve.set_if_neq(SuctionValve { open: state.pedal });
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
mod tests;
