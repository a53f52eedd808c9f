//! Who sees what: render layers.

use bevy::camera::visibility::RenderLayers;

const DEFAULT: usize = 0;
const GLOBAL: usize = 1;
const SCOPE: usize = 2;
const SPECIMEN: usize = 3;

/// Seen in both views and lit by all lights.
#[must_use]
pub fn shared() -> RenderLayers {
    RenderLayers::from_layers(&[DEFAULT, GLOBAL, SCOPE])
}

/// Seen, or shining, in the global view alone.
#[must_use]
pub fn global_only() -> RenderLayers {
    RenderLayers::layer(GLOBAL)
}

/// Seen, or shining, in the laparoscopic view alone.
#[must_use]
pub fn scope_only() -> RenderLayers {
    RenderLayers::layer(SCOPE)
}

/// Seen, or shining, in the specimen's view alone.
#[must_use]
pub fn specimen_only() -> RenderLayers {
    RenderLayers::layer(SPECIMEN)
}
