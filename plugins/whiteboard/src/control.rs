//! Pause, step, reset, and which view is shown.

use bevy_ecs::prelude::*;
use bevy_math::Vec3;

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

/// Where the global view is seen from at first: eye and target, m; `None` where the scene does not say, and all organs are framed. Written by the scene.
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq)]
pub struct GlobalView(pub Option<(Vec3, Vec3)>);

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
