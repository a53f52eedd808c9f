//! Glue: what a tick knows of the outside is taken down, or comes from a recording instead.

use crate::recording::digest::{StateDigest, state_digest};
use crate::recording::error::RecordingError;
use crate::recording::event::TickInput;
use crate::recording::player::Play;
use crate::recording::writer::RecordingWriter;
use bevy_app::prelude::*;
use bevy_ecs::prelude::*;
use bevy_time::{Fixed, Time};
use keyhole_whiteboard::{
    CutSettings, DeviceHands, Hand, HandInput, Instrument, InstrumentPose, Organ, ScriptClock, SenseSystems, SimulationControl,
    TickSystems, TissueMesh, TissueState,
};

/// Records while there is a [`Recorder`], and plays while there is a [`Player`]; the two may be there at once. Both have to be there before the first tick.
///
/// The app that starts scenes over when [`SimulationControl::reset`] asks for it does so in `First` and in `FixedFirst`, after [`PlayerSystems`].
pub struct RecordingPlugin;

/// Restarts are seen and ordered: in `First` and in `FixedFirst`.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct PlayerSystems;

/// A recording that is being made.
#[derive(Resource)]
pub struct Recorder {
    writer: RecordingWriter,
    tick: Option<TickInput>,
    error: Option<RecordingError>,
}

/// A recording that is being played. At its end the simulation is paused.
#[derive(Resource)]
pub struct Player {
    /// Where it is.
    pub play: Play,
    /// A restart that it has ordered itself.
    ordered: bool,
}

impl Plugin for RecordingPlugin {
    fn build(&self, app: &mut App) {
        let recording = resource_exists::<Recorder>;
        let playing = resource_exists::<Player>;
        app.init_resource::<HandInput>()
            .init_resource::<ScriptClock>()
            .add_systems(First, (rewind.run_if(playing), note_reset.run_if(recording)).chain().in_set(PlayerSystems))
            .add_systems(FixedFirst, (prepare.run_if(playing), note_reset.run_if(recording)).chain().in_set(PlayerSystems))
            .add_systems(FixedUpdate, (give_input.run_if(playing), take_input.run_if(recording)).chain().in_set(SenseSystems::Inputs))
            .add_systems(FixedUpdate, take_state.in_set(TickSystems::Assess).run_if(recording.or_else(playing)))
            .add_systems(Last, write_if_due.run_if(recording));
    }
}

impl Recorder {
    /// Records from now on.
    #[must_use]
    pub fn new(writer: RecordingWriter) -> Self {
        Self { writer, tick: None, error: None }
    }

    /// Ends the recording.
    ///
    /// # Errors
    /// The first error since it began: what was written before it can be played.
    pub fn finish(mut self) -> Result<(), RecordingError> {
        let end = self.writer.finish();
        self.error.take().map_or(end, Err)
    }

    fn note(&mut self, written: Result<(), RecordingError>) {
        if let Err(error) = written {
            tracing::error!("{error}");
            self.error.get_or_insert(error);
        }
    }
}

impl Player {
    /// Plays from now on.
    #[must_use]
    pub fn new(play: Play) -> Self {
        Self { play, ordered: false }
    }
}

/// Ticks on the clock of fixed time.
fn clock(time: &Time<Fixed>) -> u64 {
    (time.elapsed().as_nanos() / time.timestep().as_nanos().max(1)) as u64
}

/// Puts the clock of fixed time where it was in the recording: pauses then and now may have been of different length.
fn set_clock(time: &mut Time<Fixed>, clock: u64) {
    let step = time.timestep();
    let wanted = std::time::Duration::from_nanos((step.as_nanos() as u64).saturating_mul(clock));
    if time.elapsed() != wanted {
        let mut set = Time::<Fixed>::from_duration(step);
        // A tick is as long as every other.
        set.advance_to(wanted.saturating_sub(step));
        set.advance_to(wanted);
        set.accumulate_overstep(time.overstep());
        *time = set;
    }
}

/// Somebody started the scene over that was not the recording: it begins anew.
fn rewind(mut player: ResMut<Player>, mut time: ResMut<Time<Fixed>>, control: Res<SimulationControl>) {
    if control.reset && !player.ordered {
        player.play.rewind();
        set_clock(&mut time, 0);
    }
}

fn note_reset(mut recorder: ResMut<Recorder>, control: Res<SimulationControl>, time: Res<Time<Fixed>>) {
    if control.reset {
        let written = recorder.writer.reset(clock(&time));
        recorder.note(written);
    }
}

/// Before a fixed update: restarts that come next are ordered, and at the end no tick runs any more.
fn prepare(mut player: ResMut<Player>, mut control: ResMut<SimulationControl>, mut time: ResMut<Time<Fixed>>) {
    player.ordered = false;
    while let Some(clock) = player.play.take_reset() {
        set_clock(&mut time, clock);
        control.reset = true;
        player.ordered = true;
    }
    if player.play.finished() {
        control.paused = true;
        control.steps = 0;
    }
}

fn give_input(
    mut player: ResMut<Player>,
    mut time: ResMut<Time<Fixed>>,
    mut control: ResMut<SimulationControl>,
    mut script: ResMut<ScriptClock>,
    mut mouse: ResMut<HandInput>,
    mut devices: ResMut<DeviceHands>,
    mut cutting: ResMut<CutSettings>,
) {
    let Some(input) = player.play.take_tick() else { return };
    set_clock(&mut time, input.clock);
    control.demonstration = input.demonstration.is_some();
    if let Some(ticks) = input.demonstration {
        script.ticks = ticks;
    }
    *mouse = input.mouse;
    *devices = input.devices;
    cutting.set_if_neq(input.cutting);
}

fn take_input(
    mut recorder: ResMut<Recorder>,
    time: Res<Time<Fixed>>,
    control: Res<SimulationControl>,
    script: Res<ScriptClock>,
    mouse: Res<HandInput>,
    devices: Res<DeviceHands>,
    cutting: Res<CutSettings>,
) {
    recorder.tick = Some(TickInput {
        clock: clock(&time),
        demonstration: control.demonstration.then_some(script.ticks),
        mouse: *mouse,
        devices: *devices,
        cutting: *cutting,
    });
}

type Organs<'w, 's> = Query<'w, 's, (&'static Organ, &'static TissueMesh, &'static TissueState)>;
type Instruments<'w, 's> = Query<'w, 's, (&'static Hand, &'static InstrumentPose), With<Instrument>>;

fn digest(organs: &Organs, instruments: &Instruments) -> StateDigest {
    state_digest(
        organs.iter().map(|(organ, mesh, state)| (organ.name.as_str(), &mesh.0, state)),
        instruments.iter().map(|(hand, pose)| (*hand, pose.now)),
    )
}

fn take_state(recorder: Option<ResMut<Recorder>>, player: Option<ResMut<Player>>, organs: Organs, instruments: Instruments) {
    let state = digest(&organs, &instruments);
    if let Some(mut recorder) = recorder
        && let Some(input) = recorder.tick.take()
    {
        let written = recorder.writer.tick(&input, state);
        recorder.note(written);
    }
    if let Some(mut player) = player {
        player.play.compare(state);
    }
}

fn write_if_due(mut recorder: ResMut<Recorder>) {
    let written = recorder.writer.write_if_due();
    recorder.note(written);
}
