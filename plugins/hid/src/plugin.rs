//! Glue: the newest of every device onto the whiteboard at the beginning of a tick, and the forces out at its end.

use crate::advice::advice;
use crate::error::TransportError;
use crate::force::{HandEffort, effort};
use crate::hidraw::HidBus;
use crate::keeper::Event;
use crate::mapping::HandReading;
use crate::profile::Profile;
use crate::service::Service;
use crate::session::{Line, Snapshot};
use crate::transport::{Bus, DeviceInfo};
use bevy_app::prelude::*;
use bevy_ecs::prelude::*;
use bevy_math::Vec3;
use bevy_time::{Fixed, Time};
use keyhole_whiteboard::{
    AxisInput, DeviceCondition, DeviceHand, DeviceHands, DeviceReport, DeviceStatus, Hand, Instrument, InstrumentPose, Port, SenseSystems,
    SimulationControl, TickSystems, ToolForce,
};
use std::sync::{Arc, Mutex, PoisonError};

/// Puts devices on the whiteboard: their status, the hands in them, and what the hands feel.
pub struct HidPlugin {
    service: Mutex<Option<Service>>,
    wanted: Vec<String>,
}

impl HidPlugin {
    /// The devices of this machine that one of the profiles matches, served on threads of their own from now on.
    #[must_use]
    pub fn of_this_machine(profiles: Vec<Profile>) -> Self {
        let bus = || HidBus::new().map(|bus| Box::new(bus) as Box<dyn Bus>);
        Self::new(Service::threads::<TransportError>(bus, profiles))
    }

    /// A bus that is stepped by the ticks, on their clock.
    #[must_use]
    pub fn stepped(bus: impl Bus + 'static, profiles: Vec<Profile>) -> Self {
        Self::new(Service::stepped(Box::new(bus), profiles))
    }

    /// Any service.
    #[must_use]
    pub fn new(service: Service) -> Self {
        Self { service: Mutex::new(Some(service)), wanted: Vec::new() }
    }

    /// Profiles, by name, whose devices are said to be missing until they are there.
    #[must_use]
    pub fn wanting(mut self, profiles: Vec<String>) -> Self {
        self.wanted = profiles;
        self
    }
}

impl Plugin for HidPlugin {
    fn build(&self, app: &mut App) {
        // A plugin is built once.
        let Some(service) = self.service.lock().unwrap_or_else(PoisonError::into_inner).take() else { return };
        let wanted = self.wanted.iter().map(|name| missing(name)).collect();
        app.insert_resource(Devices { service: Mutex::new(service), known: Vec::new(), refused: Vec::new(), wanted, held: false })
            .add_systems(RunFixedMainLoop, hold.in_set(RunFixedMainLoopSystems::BeforeFixedMainLoop))
            .add_systems(FixedUpdate, read_devices.in_set(SenseSystems::Devices))
            .add_systems(FixedUpdate, send_forces.in_set(TickSystems::Publish));
    }
}

fn missing(profile: &str) -> DeviceReport {
    let advice =
        format!("plug it in; `keyhole device list` shows what is there and which profile it gets, and {profile:?} is none of them");
    DeviceReport { name: profile.into(), profile: profile.into(), condition: DeviceCondition::Missing, advice, ..Default::default() }
}

/// A device that is, or was, served.
struct Known {
    id: u64,
    profile: Arc<Profile>,
    hands: Vec<Hand>,
    line: Line,
    /// Numbers that whoever follows the hands has seen, which go on when the device comes back.
    engaged: u64,
    /// The device's own number at that time, and what had moved.
    seen: u64,
    moved: [[f64; 4]; 2],
    report: DeviceReport,
    /// Of the advice in the report.
    told: Option<(DeviceCondition, Option<usize>)>,
}

/// The devices. Only this plugin looks inside.
#[derive(Resource)]
struct Devices {
    /// Never locked: whoever has the resource has it alone.
    service: Mutex<Service>,
    known: Vec<Known>,
    refused: Vec<(String, DeviceReport)>,
    wanted: Vec<DeviceReport>,
    /// Ticks did not run, or a scene has begun: the hands may be anywhere.
    held: bool,
}

impl Devices {
    fn service(&mut self) -> &mut Service {
        self.service.get_mut().unwrap_or_else(PoisonError::into_inner)
    }

    fn hear(&mut self, event: Event) {
        match event {
            Event::Opened { id, info, profile, hands, line } => {
                let report = report(&info, &profile, &hands);
                match self.known.iter_mut().find(|k| k.id == id) {
                    Some(known) => {
                        *known =
                            Known { engaged: known.engaged, hands, line, report, profile, id, seen: 0, moved: [[0.0; 4]; 2], told: None };
                    }
                    None => {
                        self.known.push(Known { id, profile, hands, line, engaged: 0, seen: 0, moved: [[0.0; 4]; 2], report, told: None })
                    }
                }
            }
            Event::Refused { info, profile, condition, advice } => {
                tracing::warn!("{}: {advice}", info.name);
                self.refused.retain(|(path, _)| *path != info.path);
                let report = report(&info, &profile, &[]);
                self.refused.push((info.path, DeviceReport { condition, advice, ..report }));
            }
            Event::Withdrawn { path } => self.refused.retain(|(refused, _)| *refused != path),
        }
    }
}

fn report(info: &DeviceInfo, profile: &Profile, hands: &[Hand]) -> DeviceReport {
    let name = if info.name.is_empty() { format!("{:04x}:{:04x}", info.vendor, info.product) } else { info.name.clone() };
    DeviceReport { name, profile: profile.name.clone(), hands: hands.to_vec(), ..Default::default() }
}

impl Known {
    /// Takes the newest over. Gives the hands with what they did since the tick before.
    fn update(&mut self, held: bool) -> Vec<(Hand, DeviceHand)> {
        self.line.newest.update();
        let newest = *self.line.newest.output_buffer();
        let anew = held || newest.engaged != self.seen;
        if anew {
            self.engaged += 1;
            self.seen = newest.engaged;
        }
        self.tell(&newest);
        let live = newest.condition.moves();
        let mut hands = Vec::with_capacity(self.hands.len());
        for ((hand, reading), moved) in self.hands.iter().zip(&newest.hands).zip(&mut self.moved) {
            let before = if anew { reading.moved } else { *moved };
            *moved = reading.moved;
            hands.push((*hand, device_hand(reading, before, live, self.engaged)));
        }
        hands
    }

    fn tell(&mut self, newest: &Snapshot) {
        let state = (newest.condition, newest.not_homed);
        if self.told != Some(state) {
            self.told = Some(state);
            self.report.condition = newest.condition;
            self.report.advice = advice(newest, &self.profile);
        }
        (self.report.reports, self.report.refused) = (newest.reports, newest.refused);
    }
}

fn device_hand(reading: &HandReading, before: [f64; 4], live: bool, engaged: u64) -> DeviceHand {
    let axis =
        |i: usize| AxisInput { at: reading.at[i].map(|at| at as f32), by: if live { (reading.moved[i] - before[i]) as f32 } else { 0.0 } };
    DeviceHand {
        live,
        engaged,
        yaw: axis(0),
        pitch: axis(1),
        insertion: axis(2),
        roll: axis(3),
        grip: reading.grip.map(|g| g as f32),
        pedal: live && reading.pedal,
    }
}

/// While no tick runs the hands move nothing, and afterwards they go on from where the instruments are.
fn hold(control: Res<SimulationControl>, mut devices: ResMut<Devices>) {
    if control.paused {
        devices.held = true;
    }
    if control.reset {
        devices.held = true;
        devices.known.retain(|k| k.report.condition != DeviceCondition::Unplugged);
        devices.service().forget();
    }
}

fn read_devices(mut devices: ResMut<Devices>, time: Res<Time<Fixed>>, mut hands: ResMut<DeviceHands>, mut status: ResMut<DeviceStatus>) {
    devices.service().advance(time.elapsed());
    for event in devices.service().events() {
        devices.hear(event);
    }
    let held = std::mem::take(&mut devices.held);
    let mut now = DeviceHands::default();
    for known in &mut devices.known {
        for (hand, input) in known.update(held) {
            *now.slot(hand) = Some(input);
        }
    }
    hands.set_if_neq(now);
    let Devices { known, refused, wanted, .. } = &*devices;
    let absent = wanted.iter().filter(|w| !known.iter().any(|k| k.profile.name == w.profile));
    let all = || known.iter().map(|k| &k.report).chain(refused.iter().map(|(_, r)| r)).chain(absent.clone());
    // Compared first: the text is copied only when something has changed.
    if !all().eq(status.0.iter()) {
        status.0.clear();
        status.0.extend(all().cloned());
    }
}

fn send_forces(mut devices: ResMut<Devices>, tools: Query<(&Hand, &Port, &InstrumentPose, &ToolForce), With<Instrument>>) {
    for known in &mut devices.known {
        if known.profile.force.is_none() {
            continue;
        }
        let mut efforts = [HandEffort::default(); 2];
        for (hand, slot) in known.hands.iter().zip(&mut efforts) {
            for (_, port, pose, felt) in tools.iter().filter(|(h, ..)| *h == hand) {
                *slot = effort(port.position, pose.now, Vec3::Y, felt.force_n, felt.at, felt.grip_n);
            }
        }
        known.line.feel.write(efforts);
    }
}
