//! One tick of the simulator: the order of its sets, and what each cost.

use crate::{
    BleedReport, ClipReport, CutSettings, CutStatus, DeviceHands, DeviceStatus, Gravity, KeyMap, PointerClaims, RigidFragments,
    RigidReport, SceneRequirements, SimulationControl, SimulationIds, TopologyChanged, ViewMode,
};
use bevy_app::prelude::*;
use bevy_ecs::prelude::*;
use bevy_ecs::schedule::{LogLevel, ScheduleBuildSettings};
use std::time::{Duration, Instant};

/// The sets of one tick, in `FixedUpdate`, chained.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum TickSystems {
    /// Devices, mouse and script to instrument poses.
    Sense,
    /// Grasping, clipping, suturing.
    Gesture,
    /// Blades cut; topology changes are sent.
    Cut,
    /// Tissue applies the topology delta.
    Adopt,
    /// Contacts.
    Collide,
    /// Time stepping of the tissue.
    Tissue,
    /// Rigid bodies.
    Rigid,
    /// Metrics.
    Assess,
    /// What the renderer needs.
    Publish,
}

impl TickSystems {
    /// All sets in order.
    pub const ALL: [Self; 9] =
        [Self::Sense, Self::Gesture, Self::Cut, Self::Adopt, Self::Collide, Self::Tissue, Self::Rigid, Self::Assess, Self::Publish];
}

/// The order within [`TickSystems::Sense`].
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum SenseSystems {
    /// What the devices say is put up.
    Devices,
    /// Everything from outside is known: it is recorded, or replaced by a recording.
    Inputs,
    /// Hands and script move the instruments.
    Hands,
}

/// Wall-clock cost of the stages of a tick. Never read by the simulation.
#[derive(Resource, Clone, Debug)]
pub struct TickCost {
    mark: Instant,
    /// The last tick.
    pub last: [Duration; 9],
    /// Sum over all ticks.
    pub total: [Duration; 9],
    /// Largest of any tick.
    pub max: [Duration; 9],
    /// Ticks so far.
    pub ticks: u64,
}

impl Default for TickCost {
    fn default() -> Self {
        let zero = [Duration::ZERO; 9];
        Self { mark: Instant::now(), last: zero, total: zero, max: zero, ticks: 0 }
    }
}

impl TickCost {
    /// Whole cost of the last tick.
    #[must_use]
    pub fn last_tick(&self) -> Duration {
        self.last.iter().sum()
    }
}

/// Puts the whiteboard up: resources, messages, and the chained sets of `FixedUpdate` with ambiguity an error.
pub struct WhiteboardPlugin;

impl Plugin for WhiteboardPlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<Gravity>()
            .init_resource::<SceneRequirements>()
            .init_resource::<CutSettings>()
            .init_resource::<CutStatus>()
            .init_resource::<SimulationControl>()
            .init_resource::<ViewMode>()
            .init_resource::<KeyMap>()
            .init_resource::<PointerClaims>()
            .init_resource::<TickCost>()
            .init_resource::<DeviceStatus>()
            .init_resource::<DeviceHands>()
            .init_resource::<RigidFragments>()
            .init_resource::<RigidReport>()
            .init_resource::<BleedReport>()
            .init_resource::<ClipReport>()
            .add_message::<TopologyChanged>()
            .edit_schedule(FixedUpdate, |schedule| {
                schedule.set_build_settings(ScheduleBuildSettings { ambiguity_detection: LogLevel::Error, ..Default::default() });
                use TickSystems::{Adopt, Assess, Collide, Cut, Gesture, Publish, Rigid, Sense, Tissue};
                schedule.configure_sets((Sense, Gesture, Cut, Adopt, Collide, Tissue, Rigid, Assess, Publish).chain().run_if(running));
                schedule.configure_sets((SenseSystems::Devices, SenseSystems::Inputs, SenseSystems::Hands).chain().in_set(Sense));
                crate::gesture::order(schedule);
            })
            .add_systems(FixedUpdate, start_tick.before(TickSystems::Sense).run_if(running))
            .add_systems(FixedUpdate, end_tick.after(TickSystems::Publish).run_if(running));
        crate::checkpoint::register_whiteboard(app);
        SimulationIds::set_aside(app.world_mut());
        app.add_systems(FixedFirst, SimulationIds::set_aside);
        for (i, set) in TickSystems::ALL.into_iter().enumerate() {
            let mark = move |mut cost: ResMut<TickCost>| close_stage(&mut cost, i);
            match TickSystems::ALL.get(i + 1) {
                Some(next) => app.add_systems(FixedUpdate, mark.after(set).before(*next).run_if(running)),
                None => app.add_systems(FixedUpdate, mark.after(set).before(end_tick).run_if(running)),
            };
        }
    }
}

/// Run condition: a tick runs unless paused, and while paused for each step asked for.
#[must_use]
pub fn running(control: Res<SimulationControl>) -> bool {
    !control.paused || control.steps > 0
}

fn start_tick(mut cost: ResMut<TickCost>) {
    cost.mark = Instant::now();
    cost.last = [Duration::ZERO; 9];
}

fn close_stage(cost: &mut TickCost, stage: usize) {
    let now = Instant::now();
    let spent = now - cost.mark;
    cost.mark = now;
    cost.last[stage] = spent;
    cost.total[stage] += spent;
    cost.max[stage] = cost.max[stage].max(spent);
}

fn end_tick(mut cost: ResMut<TickCost>, mut control: ResMut<SimulationControl>) {
    cost.ticks += 1;
    if control.paused {
        control.steps = control.steps.saturating_sub(1);
    }
}
