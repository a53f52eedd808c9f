//! Profiles: what the fields of a device's reports mean for a hand. A profile is a RON file; nothing of any device is in the code.

use crate::error::ProfileError;
use ron::Options;
use ron::extensions::Extensions;
use ron::ser::PrettyConfig;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// How a device is read, and what it can be made to feel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Profile {
    /// Its name, for people.
    pub name: String,
    /// The devices that it is for: any of these.
    pub matches: Vec<Match>,
    /// Reports a second that the device always sends; left out when it speaks only when something changes.
    #[serde(default)]
    pub rate_hz: Option<f32>,
    /// What has to be set before the device knows where it is.
    #[serde(default)]
    pub homing: Vec<HomingFlag>,
    /// One or two hands.
    pub hands: Vec<HandProfile>,
    /// The report that makes the device felt.
    #[serde(default)]
    pub force: Option<ForceProfile>,
}

/// Which devices a profile is for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Match {
    /// By vendor, and by product unless that is left out.
    Device {
        /// Vendor identifier.
        vendor: u16,
        /// Product identifier.
        #[serde(default)]
        product: Option<u16>,
    },
    /// By what it calls itself: any device with this in its name, in upper or lower case.
    Named(String),
    /// By what it says it is: the usage of its application collection.
    Usage {
        /// Usage page.
        page: u16,
        /// Usage.
        usage: u16,
    },
}

/// A field that tells when a part of the device has found its zero.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HomingFlag {
    /// Set when it has.
    pub flag: Button,
    /// What the trainee does to set it.
    pub advice: String,
}

/// Which hand.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum HandChoice {
    /// The left one.
    Left,
    /// The right one.
    Right,
    /// Whichever no other device has taken, the right one first.
    Any,
}

/// How one hand is read. What is left out the device does not have.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HandProfile {
    /// Which hand.
    pub hand: HandChoice,
    /// The handle swung to the right: degrees, or degrees a second of a rate.
    #[serde(default)]
    pub yaw: Option<Axis>,
    /// The handle swung up: degrees.
    #[serde(default)]
    pub pitch: Option<Axis>,
    /// Yaw and pitch of a device that tells the direction of the shaft instead.
    #[serde(default)]
    pub direction: Option<Direction>,
    /// Pushed in: millimetres.
    #[serde(default)]
    pub insertion: Option<Axis>,
    /// Turned about the shaft, clockwise as the trainee looks along it: degrees.
    #[serde(default)]
    pub roll: Option<Axis>,
    /// The handle's rings: 0 closed, 1 open.
    #[serde(default)]
    pub opening: Option<Axis>,
    /// Buttons that close the jaws while any of them is held, for a handle without an axis for its rings.
    #[serde(default)]
    pub closes: Vec<Button>,
    /// Buttons of which any is the pedal.
    #[serde(default)]
    pub pedal: Vec<Button>,
}

/// One degree of freedom.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Axis {
    /// Where it is read.
    pub from: Source,
    /// The counts at both ends; left out: what the descriptor says, or all that the bits can hold.
    #[serde(default)]
    pub counts: Option<(f64, f64)>,
    /// What those counts mean, in the unit of the degree of freedom.
    pub means: (f64, f64),
    /// Turns the axis round.
    #[serde(default)]
    pub invert: bool,
    /// What the counts are.
    #[serde(default)]
    pub mode: Mode,
    /// Of a rate: the part of the way from the middle to an end in which nothing moves. Of a position: the play, as a part of the whole
    /// range. Default 0.
    #[serde(default)]
    pub dead_zone: f64,
    /// Whether a position goes on at its beginning when it comes to its end, as a turning encoder does.
    #[serde(default)]
    pub wraps: bool,
    /// Smooths a position.
    #[serde(default)]
    pub filter: Option<Filter>,
}

/// What the counts of an axis are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Mode {
    /// A position.
    #[default]
    Absolute,
    /// A movement since the report before.
    Relative,
    /// A speed, with rest in the middle of the counts.
    Rate,
}

/// Where a number is read.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Source {
    /// A field that the descriptor names.
    Usage {
        /// Usage page.
        page: u16,
        /// Usage.
        usage: u16,
        /// Which of several with this usage, from 0.
        #[serde(default)]
        nth: u8,
    },
    /// Bits of a report, for a device whose descriptor says nothing useful.
    Bits {
        /// Identifier that the report begins with; left out where reports have none.
        #[serde(default)]
        report: Option<u8>,
        /// First bit, counted from the report's first byte, its identifier included.
        start: u16,
        /// Number of bits, 1 to 32.
        bits: u8,
        /// Whether the value is in two's complement.
        #[serde(default)]
        signed: bool,
    },
    /// Two buttons: +1 while the first is held, -1 while the second is.
    Buttons {
        /// Of +1.
        plus: Button,
        /// Of -1.
        minus: Button,
    },
}

/// A field that is on or off.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Button {
    /// Where it is read; not `Buttons`.
    pub from: Box<Source>,
    /// Values that count as on; left out: any but zero.
    #[serde(default)]
    pub values: Option<Vec<i64>>,
}

/// The direction of the shaft from the port into the body, in counts of any one scale.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Direction {
    /// Its part to the trainee's right.
    pub right: Source,
    /// Its part upwards.
    pub up: Source,
    /// Its part inwards.
    pub inward: Source,
}

/// The 1 euro filter (Casiez, Roussel, Vogel: 1 euro filter, CHI 2012, doi 10.1145/2207676.2208639).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Filter {
    /// Cut-off at rest, Hz.
    pub min_cutoff_hz: f64,
    /// Hz that the cut-off rises by for each unit (degree, millimetre) a second of speed.
    pub beta: f64,
}

/// The output report that makes a device felt.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ForceProfile {
    /// Identifier of the output report, 0 where reports have none.
    pub report: u8,
    /// Bytes of the report after its identifier, 1 to 64.
    pub bytes: u8,
    /// How often it is sent, Hz. Default 500: felt like 1000, and better than 250.
    #[serde(default = "five_hundred")]
    pub rate_hz: f32,
    /// The numbers in it.
    pub channels: Vec<ForceChannel>,
}

fn five_hundred() -> f32 {
    500.0
}

/// One number of the output report.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ForceChannel {
    /// Which of the profile's hands, from 0.
    #[serde(default)]
    pub hand: u8,
    /// What it acts on.
    pub effort: Effort,
    /// First bit, counted from the first byte after the identifier.
    pub start: u16,
    /// Number of bits, 2 to 32, in two's complement.
    pub bits: u8,
    /// Counts for a newton, or for a newton metre.
    pub counts_per_unit: f64,
    /// Never more than this, N or N m.
    pub limit: f64,
}

/// What a force acts on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Effort {
    /// Torque that swings the handle to the right, N m.
    Yaw,
    /// Torque that swings the handle up, N m.
    Pitch,
    /// Force that pushes the handle in, N.
    Insertion,
    /// Torque about the shaft, N m.
    Roll,
    /// Force that opens the rings, N.
    Grip,
}

fn options() -> Options {
    Options::default().with_default_extension(Extensions::IMPLICIT_SOME)
}

impl Profile {
    /// Reads a profile. `place` is what errors name: a file, or the name of a shipped profile.
    ///
    /// # Errors
    /// When it is no RON, not a profile, or says what cannot be.
    pub fn parse(place: &str, text: &str) -> Result<Self, ProfileError> {
        let syntax = |line, column, what| ProfileError::Syntax { place: place.into(), line, column, what };
        // RON is read recursively; a profile is shallow.
        if text.len() > 1 << 16 {
            return Err(syntax(1, 1, "a profile has at most 65536 bytes".into()));
        }
        let read: Result<Self, _> = options().from_str(text);
        let profile = read.map_err(|e| syntax(e.span.start.line, e.span.start.col, e.code.to_string()))?;
        profile.check().map_err(|rule| ProfileError::Meaning { place: place.into(), rule })?;
        Ok(profile)
    }

    /// Reads a profile from a file.
    ///
    /// # Errors
    /// As [`Profile::parse`], and when the file cannot be read.
    pub fn load(path: &Path) -> Result<Self, ProfileError> {
        let text = std::fs::read_to_string(path).map_err(|source| ProfileError::Read { path: path.into(), source })?;
        Self::parse(&path.display().to_string(), &text)
    }

    /// The profile as RON.
    ///
    /// # Errors
    /// When RON has no words for it.
    pub fn to_ron(&self) -> Result<String, ProfileError> {
        let pretty = PrettyConfig::new().extensions(Extensions::IMPLICIT_SOME);
        Ok(ron::ser::to_string_pretty(self, pretty)? + "\n")
    }
}

impl HandProfile {
    /// Its axes with their names.
    #[must_use]
    pub fn axes(&self) -> [(&'static str, Option<&Axis>); 5] {
        [
            ("yaw", self.yaw.as_ref()),
            ("pitch", self.pitch.as_ref()),
            ("insertion", self.insertion.as_ref()),
            ("roll", self.roll.as_ref()),
            ("opening", self.opening.as_ref()),
        ]
    }
}
