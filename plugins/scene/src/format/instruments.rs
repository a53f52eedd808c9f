//! Ports, what is in them, and whose hand holds it.

use super::Triple;
use keyhole_whiteboard::ScopeOptics;
use serde::{Deserialize, Serialize};

/// A trocar.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScenePort {
    /// Name, unique among the ports.
    pub name: String,
    /// Where the shaft passes, m.
    pub position: Triple,
    /// Into the body; any length but 0. Yaw and pitch are measured from it.
    pub inward: Triple,
}

/// Which hand.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum SceneHand {
    /// The left one.
    Left,
    /// The right one.
    Right,
}

/// What an instrument is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum SceneInstrumentKind {
    /// Two jaws with blunt pads.
    Grasper,
    /// Cut as they close.
    Scissors,
    /// Cuts along its blade while the pedal is down.
    Hook,
    /// A pointed straight blade; cuts along its edge while the pedal is down.
    Scalpel,
    /// Sets a clip on what is between its jaws when they have closed.
    ClipApplier,
    /// Two short strong jaws for a needle and its thread.
    NeedleHolder,
    /// A tube that takes up blood that lies while the pedal is down.
    Suction,
}

/// When a blade cuts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum SceneTrigger {
    /// While the pedal is down.
    Pedal,
    /// While the jaws close; the cut runs from where the blades cross to their tips.
    Closing,
}

/// What about an instrument cuts. What is left out is as the kind has it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SceneBlade {
    /// Length of the cutting line, mm; from 1 to 200. Default 18 for scissors, 16 for a hook, 14 for a scalpel.
    pub length_mm: Option<f32>,
    /// When it cuts. Default Closing for scissors, which alone can; Pedal for the others. Scissors with Pedal cut along their shut blades.
    pub trigger: Option<SceneTrigger>,
    /// Thickness of tissue that the edge takes away, mm; from 0, a cold blade, to 3. Default 0.
    pub kerf_mm: f32,
}

/// An instrument in a hand and a port.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneInstrument {
    /// What it is.
    pub kind: SceneInstrumentKind,
    /// Which hand holds it; each hand one instrument at most.
    pub hand: SceneHand,
    /// Name of the port that it is in; no two things share one.
    pub port: String,
    /// Initial angle to the port's right, degrees. Default 0.
    #[serde(default)]
    pub yaw_deg: f32,
    /// Initial angle upwards, degrees. Default 0.
    #[serde(default)]
    pub pitch_deg: f32,
    /// Initial distance from the port to the end of the shaft, m. Default 0.08.
    #[serde(default = "default_insertion")]
    pub insertion_m: f32,
    /// What the hand may exchange it for through its trocar, in turn; it goes to the end of the row itself. Default none.
    #[serde(default)]
    pub exchange: Vec<SceneInstrumentKind>,
    /// What about it cuts. Default as the kind has it; a grasper has none.
    #[serde(default)]
    pub blade: Option<SceneBlade>,
    /// The length of `blade` in metres, as scenes said it before `blade` was there; not both.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub blade_length_m: Option<f32>,
    /// The clips of a clip applier. Default twenty of titanium for vessels that are up to 8 mm wide when they are laid flat; no other instrument has any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clips: Option<crate::vessel::SceneClips>,
    /// What a suction takes up; no other instrument takes anything up.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub suction: Option<crate::vessel::SceneSuction>,
    /// Length of the shaft, m. Default 0.33.
    #[serde(default = "default_shaft_length")]
    pub shaft_length_m: f32,
    /// Radius of the shaft, m. Default 0.0025.
    #[serde(default = "default_shaft_radius")]
    pub shaft_radius_m: f32,
    /// Coulomb's coefficient of its surface but for the pads of its jaws, 0 to 2. Default 0.2.
    #[serde(default)]
    pub friction: Option<f32>,
}

/// The endoscope.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneEndoscope {
    /// Name of the port that it is in.
    pub port: String,
    /// Angle between shaft and direction of view, degrees: 0, 30, 45 or 70 are sold. Default 30.
    #[serde(default = "default_direction")]
    pub direction_of_view_deg: f32,
    /// Angle of view across the round picture, degrees. Default 70.
    #[serde(default = "default_angle")]
    pub angle_of_view_deg: f32,
    /// Initial angle to the port's right, degrees. Default 0.
    #[serde(default)]
    pub yaw_deg: f32,
    /// Initial angle upwards, degrees. Default 0.
    #[serde(default)]
    pub pitch_deg: f32,
    /// Initial distance from the port to its tip, m. Default 0.08.
    #[serde(default = "default_insertion")]
    pub insertion_m: f32,
    /// Coefficients k1 and k2 of barrel distortion: what the lens shows at radius r a pinhole shows at r (1 + k1 r^2 + k2 r^4) / (1 + k1 + k2), both as
    /// parts of the radius of the round picture. The rim is drawn in by (k1 + k2) / (1 + k1 + k2), which is 0.07 to 0.23 of laparoscopes. k1 from -0.3 to 1,
    /// k2 from -0.15 to 1, together from 0 to 1. Default (0.1364, 0): 12 %.
    #[serde(default = "default_distortion")]
    pub distortion: [f32; 2],
    /// Time in which a clean lens fogs over, s; above 0. A key cleans it. Default never.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fogs_in_s: Option<f32>,
    /// Distance of the two lenses of a stereo endoscope, mm; above 0, at most 10. Default none: one lens.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stereo_base_mm: Option<f32>,
}

fn default_insertion() -> f32 {
    0.08
}

fn default_shaft_length() -> f32 {
    0.33
}

fn default_shaft_radius() -> f32 {
    0.0025
}

fn default_direction() -> f32 {
    30.0
}

fn default_angle() -> f32 {
    70.0
}

fn default_distortion() -> [f32; 2] {
    ScopeOptics::default().distortion
}
