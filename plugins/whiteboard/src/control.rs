//! Pause, step, reset, and which view is shown.

use bevy_ecs::prelude::*;

/// What the trainee asked of the simulation. Written by the HUD and the command line; reset is carried out by the app.
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SimulationControl {
    /// No tick runs while paused.
    pub paused: bool,
    /// Ticks to run although paused.
    pub steps: u32,
    /// Start the scene over.
    pub reset: bool,
    /// Whether the scene's demonstration drives the instruments instead of the trainee.
    pub demonstration: bool,
}

/// Which view is shown. Written by view.
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum ViewMode {
    /// The whole theatre from outside.
    #[default]
    Global,
    /// Through the endoscope.
    Laparoscopic,
}

/// Every key and what it does, for the HUD to list. Each room pushes its own while its plugin is built.
#[derive(Resource, Clone, Debug, Default, PartialEq, Eq)]
pub struct KeyMap(pub Vec<(String, String)>);

impl KeyMap {
    /// Adds keys with what they do.
    pub fn push_all(&mut self, keys: &[(&str, &str)]) {
        self.0.extend(keys.iter().map(|(key, what)| ((*key).to_owned(), (*what).to_owned())));
    }
}

/// Who else wants the mouse at the moment: while anybody does, it moves no instrument.
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PointerClaims {
    /// The pointer is over the HUD. Written by hud.
    pub hud: bool,
    /// The mouse moves the camera of the global view. Written by view.
    pub camera: bool,
}

impl PointerClaims {
    /// Whether anybody wants the mouse.
    #[must_use]
    pub fn any(self) -> bool {
        self.hud || self.camera
    }
}
