//! A replay in a window: keys that go to another time, and where it is.

use crate::perform::in_ticks;
use crate::seek::Timeline;
use crate::simulation::TICKS_PER_SECOND;
use bevy::prelude::*;
use keyhole_assessment::recording::{Player, Recorder};
use keyhole_hud::{Guide, ReplayBar, StartScreen};
use keyhole_whiteboard::{KeyMap, SimulationControl, StateRestored};

/// How far an arrow key goes, and how far with Shift, s.
const STEPS_S: [f64; 2] = [5.0, 30.0];

/// The keys of a replay.
const KEYS: [(&str, &str); 2] =
    [("left, right arrow", "replay: 5 s back or forward; with Shift: 30 s"), ("Home, End", "replay: to its start, to its end")];

/// Goes to other times of a recording by keys, and shows where it is.
pub struct ReplayPlugin;

impl Plugin for ReplayPlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<Timeline>()
            .init_resource::<ReplayBar>()
            .add_observer(|_: On<StateRestored>, mut guide: ResMut<Guide>| {
                // What is done by then is ticked off anew.
                guide.step = 0;
                guide.done.clear();
            })
            .add_systems(Update, (read_keys.run_if(not(resource_exists::<Recorder>)), show_time).chain());
        app.world_mut().get_resource_or_init::<KeyMap>().push_all(&KEYS);
    }
}

/// Where a key goes from a time, in ticks; `None` for other keys.
fn goes_to(key: KeyCode, far: bool, now: u64, end: u64) -> Option<u64> {
    let step = in_ticks(STEPS_S[usize::from(far)]);
    match key {
        KeyCode::ArrowLeft => Some(now.saturating_sub(step)),
        KeyCode::ArrowRight => Some((now + step).min(end)),
        KeyCode::Home => Some(0),
        KeyCode::End => Some(end),
        _ => None,
    }
}

fn read_keys(
    keys: Res<ButtonInput<KeyCode>>,
    start: Option<Res<StartScreen>>,
    player: Res<Player>,
    control: Res<SimulationControl>,
    mut timeline: ResMut<Timeline>,
) {
    if start.is_some_and(|start| start.open) {
        return;
    }
    let far = keys.any_pressed([KeyCode::ShiftLeft, KeyCode::ShiftRight]);
    let (play, end) = (&player.play, player.play.recording().ticks());
    for key in keys.get_just_pressed() {
        // Pressed again on the way, it goes on from where it is wanted.
        let now = timeline.wanted().unwrap_or(play.ticks());
        if let Some(to) = goes_to(*key, far, now, end) {
            timeline.go_to(to, &control, play.finished());
        }
    }
}

fn show_time(player: Res<Player>, timeline: Res<Timeline>, mut bar: ResMut<ReplayBar>) {
    let seconds = |ticks: u64| ticks as f64 / TICKS_PER_SECOND;
    let play = &player.play;
    bar.set_if_neq(ReplayBar {
        time_s: seconds(play.ticks()),
        length_s: seconds(play.recording().ticks()),
        goes_to_s: timeline.wanted().map(seconds),
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_stay_within_the_recording() {
        let to = |key, far, now| goes_to(key, far, now, 1000);
        assert_eq!(to(KeyCode::ArrowLeft, false, 700), Some(400));
        assert_eq!(to(KeyCode::ArrowLeft, true, 700), Some(0));
        assert_eq!(to(KeyCode::ArrowRight, false, 650), Some(950));
        assert_eq!(to(KeyCode::ArrowRight, true, 650), Some(1000));
        assert_eq!([to(KeyCode::Home, false, 9), to(KeyCode::End, true, 9), to(KeyCode::KeyR, false, 9)], [Some(0), Some(1000), None]);
    }
}
