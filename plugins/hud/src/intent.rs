//! What the trainee asked for with keys and buttons, gathered during a frame and carried out once, at the start of the next: egui may
//! build a frame's panel twice.

use crate::start::StartScreen;
use bevy::prelude::*;
use keyhole_whiteboard::{CutSettings, SimulationControl, ViewMode};

/// Wishes of this frame; asking twice is asking once.
#[derive(Resource, Clone, Debug, Default, PartialEq)]
pub struct Intent {
    /// Pause or go on.
    pub paused: Option<bool>,
    /// One tick, and pause.
    pub step: bool,
    /// Start over.
    pub reset: bool,
    /// Demonstration or hands.
    pub demonstration: Option<bool>,
    /// The view to show.
    pub view: Option<ViewMode>,
    /// How to cut from the next stroke on.
    pub cutting: Option<CutSettings>,
}

/// What of the HUD is shown.
#[derive(Resource, Clone, Copy, Debug, PartialEq, Eq)]
pub struct HudState {
    /// The panel. F2.
    pub panel: bool,
    /// Help with hands and keys. F1.
    pub keys: bool,
}

impl Default for HudState {
    fn default() -> Self {
        Self { panel: true, keys: false }
    }
}

/// The keys of the HUD.
pub const KEYS: [(&str, &str); 10] = [
    ("Space", "pause or go on"),
    (".", "one tick, then pause"),
    ("R", "start the scene over"),
    ("H", "demonstration or own hands"),
    ("F1", "this help"),
    ("F2", "show or hide the panel"),
    ("F3", "show or hide the task; Page Down and Page Up: its steps"),
    ("F4", "the results so far, and back"),
    ("F5", "with the results: save them as a page"),
    ("Esc", "the start screen: scenes and settings; and back"),
];

/// Keys to wishes.
pub fn read_keys(
    keys: Res<ButtonInput<KeyCode>>,
    control: Res<SimulationControl>,
    mut intent: ResMut<Intent>,
    mut state: ResMut<HudState>,
    start: Res<StartScreen>,
) {
    // On the start screen the keys are its own, but for the list of them.
    let ours = |key: &&KeyCode| !start.open || **key == KeyCode::F1;
    for key in keys.get_just_pressed().filter(ours) {
        match key {
            KeyCode::Space => intent.paused = Some(!control.paused),
            KeyCode::Period => intent.step = true,
            KeyCode::KeyR => intent.reset = true,
            KeyCode::KeyH => intent.demonstration = Some(!control.demonstration),
            KeyCode::F1 => state.keys = !state.keys,
            KeyCode::F2 => state.panel = !state.panel,
            _ => {}
        }
    }
}

/// Carries the wishes out.
pub fn carry_out(
    mut intent: ResMut<Intent>,
    mut control: ResMut<SimulationControl>,
    mut view: ResMut<ViewMode>,
    mut cutting: ResMut<CutSettings>,
) {
    let wishes = std::mem::take(&mut *intent);
    control.paused = wishes.paused.unwrap_or(control.paused);
    if wishes.step {
        control.paused = true;
        control.steps += 1;
    }
    control.reset |= wishes.reset;
    control.demonstration = wishes.demonstration.unwrap_or(control.demonstration);
    if let Some(wanted) = wishes.view {
        view.set_if_neq(wanted);
    }
    if let Some(wanted) = wishes.cutting {
        cutting.set_if_neq(wanted);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn app() -> App {
        let mut app = App::new();
        app.init_resource::<ButtonInput<KeyCode>>()
            .init_resource::<SimulationControl>()
            .init_resource::<Intent>()
            .init_resource::<HudState>()
            .init_resource::<StartScreen>()
            .init_resource::<ViewMode>()
            .init_resource::<CutSettings>()
            .add_systems(Update, (read_keys, carry_out).chain());
        app
    }

    fn press(app: &mut App, key: KeyCode) -> SimulationControl {
        app.world_mut().resource_mut::<ButtonInput<KeyCode>>().press(key);
        app.update();
        app.world_mut().resource_mut::<ButtonInput<KeyCode>>().reset_all();
        app.update();
        *app.world().resource::<SimulationControl>()
    }

    #[test]
    fn keys_pause_step_reset_and_hand_over() {
        let mut app = app();
        assert!(press(&mut app, KeyCode::Space).paused);
        assert!(!press(&mut app, KeyCode::Space).paused);
        let stepped = press(&mut app, KeyCode::Period);
        assert!(stepped.paused && stepped.steps == 1);
        assert!(press(&mut app, KeyCode::KeyH).demonstration);
        assert!(!press(&mut app, KeyCode::KeyH).demonstration);
        assert!(press(&mut app, KeyCode::KeyR).reset);
        press(&mut app, KeyCode::F1);
        assert!(app.world().resource::<HudState>().keys);
    }

    /// A panel that is built twice in a frame asks for the same things twice.
    #[test]
    fn asking_twice_is_asking_once() {
        let mut app = app();
        for _ in 0..2 {
            let mut intent = app.world_mut().resource_mut::<Intent>();
            intent.step = true;
            intent.view = Some(ViewMode::Laparoscopic);
        }
        app.update();
        app.update();
        assert_eq!(app.world().resource::<SimulationControl>().steps, 1);
        assert_eq!(*app.world().resource::<ViewMode>(), ViewMode::Laparoscopic);
    }
}
