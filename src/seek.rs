//! Going to another time of a recording that is played: from the last checkpoint before it, and on from there tick by tick.
//!
//! Checkpoints are kept in memory while a recording is played, one after the first tick and one every [`SPACING_TICKS`] until there are [`MOST_KEPT`]; then the
//! least missed goes: where the gap would be small beside how far away it is. Near where the playing is they stay dense, and farther away the gaps grow with the distance. Where the
//! scene is started over in the recording no checkpoint is needed: it is put up anew.

use crate::simulation::TICKS_PER_SECOND;
use crate::spawn::reset;
use bevy::app::FixedMain;
use bevy::prelude::*;
use bevy::time::Virtual;
use keyhole_assessment::recording::{Player, PlayerSystems, Position, Recorder};
use keyhole_whiteboard::{Checkpoint, SceneCleared, SimulationControl};
use std::time::{Duration, Instant};

/// Ticks between two checkpoints: five seconds.
pub const SPACING_TICKS: u64 = 5 * TICKS_PER_SECOND as u64;
/// Most checkpoints that are kept.
pub const MOST_KEPT: usize = 24;
/// For how long a frame simulates on the way, s.
const FRAME_S: f64 = 0.25;

/// Keeps checkpoints while a recording is played and there is a [`Timeline`], and goes where [`Timeline::go_to`] says.
pub struct SeekPlugin;

impl Plugin for SeekPlugin {
    fn build(&self, app: &mut App) {
        let playing = resource_exists::<Timeline>.and_then(resource_exists::<Player>).and_then(not(resource_exists::<Recorder>));
        let forget = |_: On<SceneCleared>, timeline: Option<ResMut<Timeline>>| {
            timeline.into_iter().for_each(|mut timeline| timeline.kept.clear());
        };
        app.add_observer(forget)
            .add_systems(First, go.before(PlayerSystems).run_if(playing.clone()))
            .add_systems(FixedLast, keep.run_if(playing));
    }
}

/// The checkpoints of a recording that is played, and where it is to go.
#[derive(Resource)]
pub struct Timeline {
    /// Ticks between two checkpoints. Default [`SPACING_TICKS`].
    pub spacing_ticks: u64,
    /// By ascending time, all of the scene as it was started last.
    kept: Vec<(Position, Checkpoint)>,
    way: Option<Way>,
}

/// On the way to another time.
#[derive(Clone, Copy, Debug)]
struct Way {
    to_ticks: u64,
    /// Whether it has been begun at a checkpoint.
    begun: bool,
    /// Whether it was paused before.
    paused: bool,
}

impl Default for Timeline {
    fn default() -> Self {
        Self { spacing_ticks: SPACING_TICKS, kept: Vec::new(), way: None }
    }
}

impl Timeline {
    /// Goes to the state after `ticks` ticks of the recording (after the first for 0), or to its end, from the next frame on. It does not wait for one way to
    /// end before the next.
    pub fn go_to(&mut self, ticks: u64, control: &SimulationControl, finished: bool) {
        let paused = self.way.map_or(control.paused && !finished, |way| way.paused);
        self.way = Some(Way { to_ticks: ticks.max(1), begun: false, paused });
    }

    /// Where it is to go, in ticks; `None` when it is there.
    #[must_use]
    pub fn wanted(&self) -> Option<u64> {
        self.way.map(|way| way.to_ticks)
    }

    /// The times of the checkpoints that are kept, in ticks of the recording.
    pub fn kept(&self) -> impl ExactSizeIterator<Item = u64> + '_ {
        self.kept.iter().map(|(at, _)| at.ticks)
    }
}

/// Which of the kept is the least missed, of more than two: never the first or the last.
fn least_missed(kept: &[u64], now: u64) -> Option<usize> {
    let missed = |i: &usize| (kept[i + 1] - kept[i - 1]) as f64 / (kept[*i].abs_diff(now) + SPACING_TICKS) as f64;
    (1..kept.len().saturating_sub(1)).min_by(|a, b| missed(a).total_cmp(&missed(b)))
}

/// After a tick: keeps a checkpoint where the last one is long ago.
fn keep(world: &mut World) {
    let at = world.resource::<Player>().play.position();
    let timeline = world.resource::<Timeline>();
    let kept = &timeline.kept;
    let place = kept.partition_point(|(known, _)| known.ticks <= at.ticks);
    let near = |(known, _): &(Position, Checkpoint)| at.ticks.abs_diff(known.ticks) < timeline.spacing_ticks;
    let begun = at.ticks > world.resource::<Player>().play.scene_of(at.ticks).ticks;
    let beside = kept[..place].last().into_iter().chain(kept.get(place));
    if !begun || beside.into_iter().any(near) {
        return;
    }
    let checkpoint = Checkpoint::take(world);
    let kept = &mut world.resource_mut::<Timeline>().kept;
    kept.insert(place, (at, checkpoint));
    if kept.len() > MOST_KEPT {
        let times: Vec<u64> = kept.iter().map(|(at, _)| at.ticks).collect();
        if let Some(i) = least_missed(&times, at.ticks) {
            kept.remove(i);
        }
    }
}

/// Goes some of the way, if there is one to go.
fn go(world: &mut World) {
    let Some(way) = world.resource::<Timeline>().way else { return };
    let recording = world.resource::<Player>().play.recording();
    let to_ticks = way.to_ticks.min(recording.ticks());
    if !way.begun {
        begin(world, to_ticks);
    }
    let until = Instant::now() + Duration::from_secs_f64(FRAME_S);
    let there = |world: &World| {
        let play = &world.resource::<Player>().play;
        play.ticks() >= to_ticks || play.finished()
    };
    while !there(world) && Instant::now() < until {
        tick(world);
    }
    let arrived = there(world);
    let mut control = world.resource_mut::<SimulationControl>();
    // On the way no tick is left to the clock on the wall.
    control.paused = way.paused || !arrived;
    world.resource_mut::<Timeline>().way = (!arrived).then_some(Way { begun: true, ..way });
}

/// Puts the last state before a time there that is known, if it is nearer than the state that is there.
fn begin(world: &mut World, to_ticks: u64) {
    let play = &world.resource::<Player>().play;
    let (now, here, there) = (play.position(), play.scene_of(play.ticks()), play.scene_of(to_ticks));
    let ahead = here == there && now.ticks <= to_ticks;
    let kept = &world.resource::<Timeline>().kept;
    let known = kept[..kept.partition_point(|(at, _)| at.ticks <= to_ticks)].last();
    match known.filter(|_| here == there) {
        Some((at, _)) if ahead && at.ticks <= now.ticks => {}
        Some((at, checkpoint)) => {
            let (at, checkpoint) = (*at, checkpoint.clone());
            checkpoint.restore(world);
            world.resource_mut::<Player>().play.go_to(at);
        }
        None if ahead => {}
        None => {
            let play = &mut world.resource_mut::<Player>().play;
            play.go_to(there);
            // A restart that comes next in the recording puts the scene up itself, at its own time.
            if !play.comes_restart() {
                let mut time = world.resource_mut::<Time<Fixed>>();
                *time = Time::<Fixed>::from_duration(time.timestep());
                world.resource_mut::<SimulationControl>().reset = true;
                reset(world);
            }
        }
    }
}

/// One tick, whatever the clock on the wall says.
fn tick(world: &mut World) {
    world.resource_mut::<SimulationControl>().paused = false;
    let mut time = world.resource_mut::<Time<Fixed>>();
    let step = time.timestep();
    time.advance_by(step);
    let during = time.as_generic();
    *world.resource_mut::<Time>() = during;
    world.run_schedule(FixedMain);
    let frame = world.resource::<Time<Virtual>>().as_generic();
    *world.resource_mut::<Time>() = frame;
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Over an hour there are never more than may be, the start and the last five seconds are within reach, and gaps grow with the distance at the most.
    #[test]
    fn what_is_near_stays_dense() {
        let mut kept: Vec<u64> = Vec::new();
        for ticks in (SPACING_TICKS..=3600 * TICKS_PER_SECOND as u64).step_by(SPACING_TICKS as usize) {
            kept.push(ticks);
            if kept.len() > MOST_KEPT
                && let Some(i) = least_missed(&kept, ticks)
            {
                kept.remove(i);
            }
            assert!(kept.len() <= MOST_KEPT && kept[0] == SPACING_TICKS && kept.is_sorted());
            for pair in kept.windows(2) {
                let (gap, distance) = (pair[1] - pair[0], ticks - pair[1]);
                assert!(gap <= SPACING_TICKS.max((distance + SPACING_TICKS) * 3 / 4), "{gap} at {distance}");
            }
        }
    }
}
