//! Finding out what a device's fields are by moving it: which field changed, and between which counts.

use crate::descriptor::Layout;
use crate::mapping::Dof;
use crate::profile::{Axis, Button, HandChoice, HandProfile, Match, Mode, Profile, Source};
use crate::transport::DeviceInfo;

/// Part of its range that a field has to change by before it counts as moved.
const MOVED: f64 = 0.05;

/// The newest value of every control of a device.
#[derive(Clone, Debug)]
pub struct Observer {
    layout: Layout,
    values: Vec<Option<i64>>,
    used: Vec<bool>,
}

/// A control that moved from one position to another.
#[derive(Clone, Debug, PartialEq)]
pub struct Found {
    /// Where it is read.
    pub source: Source,
    /// Its counts at both positions.
    pub counts: (i64, i64),
    control: usize,
}

/// The values of all controls at one moment.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Position(Vec<Option<i64>>);

impl Observer {
    /// A device of which nothing has been heard.
    #[must_use]
    pub fn new(layout: Layout) -> Self {
        let count = layout.controls.len();
        Self { layout, values: vec![None; count], used: vec![false; count] }
    }

    /// Takes note of a report. One that the descriptor does not know is passed over.
    pub fn hear(&mut self, report: &[u8]) {
        if !self.layout.admits(report) {
            return;
        }
        for (value, control) in self.values.iter_mut().zip(&self.layout.controls) {
            if let Some(read) = control.field.read(report) {
                // Movements add up.
                *value = Some(if control.relative { value.unwrap_or(0) + read } else { read });
            }
        }
    }

    /// Where everything is now.
    #[must_use]
    pub fn position(&self) -> Position {
        Position(self.values.clone())
    }

    /// Every control with its usage and newest value, in the order of the descriptor.
    pub fn values(&self) -> impl Iterator<Item = ((u16, u16), Option<i64>)> {
        self.layout.controls.iter().zip(&self.values).map(|(c, v)| (c.usage, *v))
    }

    /// The control that has moved most, as a part of its range, between two positions, of those that are not taken yet. `None` when none has.
    #[must_use]
    pub fn moved(&self, from: &Position, to: &Position) -> Option<Found> {
        let mut best: Option<(f64, Found)> = None;
        for (i, control) in self.layout.controls.iter().enumerate().filter(|(i, _)| !self.used[*i]) {
            // A control that was not heard of before it moved was at rest: a button that is up, a sensor that has not moved.
            let Some(after) = to.0.get(i).copied().flatten() else { continue };
            let before = from.0.get(i).copied().flatten().unwrap_or(0);
            let range = (control.most - control.least).max(1) as f64;
            let part = (after - before).abs() as f64 / range;
            if part >= MOVED && best.as_ref().is_none_or(|(most, _)| part > *most) {
                let nth = self.layout.controls[..i].iter().filter(|c| c.usage == control.usage).count();
                let source = Source::Usage { page: control.usage.0, usage: control.usage.1, nth: u8::try_from(nth).unwrap_or(u8::MAX) };
                best = Some((part, Found { source, counts: (before, after), control: i }));
            }
        }
        best.map(|(_, found)| found)
    }

    /// Takes a control: it is not found again.
    pub fn take(&mut self, found: &Found) {
        self.used[found.control] = true;
    }

    /// The axis of a control that read `means` at the two positions.
    #[must_use]
    pub fn axis(&self, found: &Found, means: (f64, f64)) -> Axis {
        let relative = self.layout.controls[found.control].relative;
        let counts = (found.counts.0 as f64, found.counts.1 as f64);
        let counts = if relative { (0.0, counts.1 - counts.0) } else { counts };
        let means = if relative { (0.0, means.1 - means.0) } else { means };
        Axis {
            from: found.source.clone(),
            counts: Some(counts),
            means,
            invert: false,
            mode: if relative { Mode::Relative } else { Mode::Absolute },
            dead_zone: 0.0,
            wraps: false,
            filter: None,
        }
    }

    /// The button of a control that was up at the first position and down at the second.
    #[must_use]
    pub fn button(found: &Found) -> Button {
        Button { from: Box::new(found.source.clone()), values: Some(vec![found.counts.1]) }
    }
}

/// What the trainee is asked to do for a degree of freedom, and what its ends are taken for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stage {
    /// The degree of freedom.
    pub dof: Dof,
    /// Both positions, as the trainee is told.
    pub ends: [&'static str; 2],
    /// What they read, in units of a profile.
    pub means: (f64, f64),
}

/// The stages of a calibration, in order.
pub const STAGES: [Stage; 5] = [
    Stage { dof: Dof::Yaw, ends: ["swing the handle 45 degrees to the left", "swing it 45 degrees to the right"], means: (-45.0, 45.0) },
    Stage { dof: Dof::Pitch, ends: ["swing the handle 45 degrees down", "swing it 45 degrees up"], means: (-45.0, 45.0) },
    Stage { dof: Dof::Insertion, ends: ["pull the instrument 100 mm out", "push it 100 mm in from there"], means: (0.0, 100.0) },
    Stage {
        dof: Dof::Roll,
        ends: ["turn the instrument a quarter to the left", "turn it half round, a quarter to the right"],
        means: (-90.0, 90.0),
    },
    Stage { dof: Dof::Opening, ends: ["close the rings", "open them"], means: (0.0, 1.0) },
];

/// An empty profile for a device, for a calibration to fill.
#[must_use]
pub fn blank(name: &str, device: &DeviceInfo, hand: HandChoice) -> Profile {
    Profile {
        name: name.into(),
        matches: vec![Match::Device { vendor: device.vendor, product: Some(device.product) }],
        rate_hz: None,
        homing: Vec::new(),
        hands: vec![HandProfile {
            hand,
            yaw: None,
            pitch: None,
            direction: None,
            insertion: None,
            roll: None,
            opening: None,
            closes: Vec::new(),
            pedal: Vec::new(),
        }],
        force: None,
    }
}

/// Puts an axis into its place in a hand.
pub fn put(hand: &mut HandProfile, dof: Dof, axis: Axis) {
    let slot = match dof {
        Dof::Yaw => &mut hand.yaw,
        Dof::Pitch => &mut hand.pitch,
        Dof::Insertion => &mut hand.insertion,
        Dof::Roll => &mut hand.roll,
        Dof::Opening => &mut hand.opening,
    };
    *slot = Some(axis);
}
