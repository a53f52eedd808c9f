//! What a scene performs by itself, and from where it is looked at.

use super::{SceneHand, Triple};
use serde::{Deserialize, Serialize};

/// Keyframes that the scene performs by itself.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Demonstration {
    /// How long it lasts, s; above 0.
    pub seconds: f64,
    /// What each hand does. Default nothing.
    #[serde(default)]
    pub hands: Vec<HandScript>,
    /// What the endoscope looks at. Default: it stays.
    #[serde(default)]
    pub view: Vec<ViewKeyframe>,
}

/// Keyframes of a hand.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HandScript {
    /// Which hand; it must hold an instrument.
    pub hand: SceneHand,
    /// In order of time, each after the one before.
    pub keys: Vec<HandKeyframe>,
}

/// Where a hand has the tip of its tool at a time. Between keyframes the tip follows a smooth curve; the shaft always passes its port.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HandKeyframe {
    /// Seconds from the start.
    pub time_s: f64,
    /// The tip of the blade, or the middle of the jaws, m.
    pub tip: Triple,
    /// Roll about the shaft, degrees. Default 0.
    #[serde(default)]
    pub roll_deg: f32,
    /// Jaws, 0 open to 1 closed. Default 0.
    #[serde(default)]
    pub grip: f32,
    /// Whether the pedal is down from here to the next keyframe. Default false.
    #[serde(default)]
    pub active: bool,
}

/// What the endoscope looks at, from how far.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ViewKeyframe {
    /// Seconds from the start.
    pub time_s: f64,
    /// The middle of the picture, m.
    pub target: Triple,
    /// From the tip of the endoscope to the target, m; above 0.
    pub distance_m: f32,
}

/// Cameras outside the body.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Views {
    /// The whole theatre, as it is seen at first. Default: from the front and above, so far away that all organs are in the picture.
    pub global: Option<Camera>,
}

/// A camera.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Camera {
    /// Where it is, m.
    pub eye: Triple,
    /// What it looks at, m.
    pub target: Triple,
}
