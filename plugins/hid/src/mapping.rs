//! From reports to hands: a profile fitted to a device.

use crate::descriptor::Layout;
use crate::error::FitError;
use crate::filter::{OneEuro, dead_zone, follow, unwrapped};
use crate::profile::{Axis, HandProfile, Mode, Profile};
use crate::source::{Number, Switch};
use crate::watch::AxisWatch;
use std::fmt;
use std::time::Duration;

/// A degree of freedom of a hand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Dof {
    /// The handle swung to the right.
    Yaw,
    /// The handle swung up.
    Pitch,
    /// Pushed in.
    Insertion,
    /// Turned about the shaft.
    Roll,
    /// The handle's rings.
    Opening,
}

impl Dof {
    /// The four that move the shaft.
    pub const SHAFT: [Self; 4] = [Self::Yaw, Self::Pitch, Self::Insertion, Self::Roll];

    /// Unit of a profile (degree, millimetre, part) in rad, m, part.
    #[must_use]
    pub fn unit(self) -> f64 {
        match self {
            Self::Yaw | Self::Pitch | Self::Roll => 1f64.to_radians(),
            Self::Insertion => 1e-3,
            Self::Opening => 1.0,
        }
    }

    /// Speed that no hand reaches, in units of a profile a second.
    fn fastest(self) -> f64 {
        match self {
            Self::Yaw | Self::Pitch => 1200.0,
            Self::Insertion => 3000.0,
            Self::Roll => 2500.0,
            Self::Opening => 100.0,
        }
    }
}

impl fmt::Display for Dof {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Yaw => "yaw",
            Self::Pitch => "pitch",
            Self::Insertion => "insertion",
            Self::Roll => "roll",
            Self::Opening => "opening",
        })
    }
}

/// Where a hand is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HandReading {
    /// Positions in the order of [`Dof::SHAFT`], rad and m; `None` for an axis that has none, or has not been heard of.
    pub at: [Option<f64>; 4],
    /// Sum of all movements in the same order, rad and m.
    pub moved: [f64; 4],
    /// 0 open to 1 closed.
    pub grip: Option<f64>,
    /// Whether the pedal is down.
    pub pedal: bool,
}

/// Why a report is not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// It is shorter than the descriptor says, or unknown to it.
    Shape,
    /// An axis is outside of its range.
    Range,
    /// A hand cannot have got there.
    Jump,
}

/// What a report that is taken means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Taken {
    /// The hand moved on.
    Moved,
    /// The hand is somewhere else, and stays there: what follows it has to take over anew.
    Elsewhere,
}

/// Shortest time between two reports for the judgement of speeds, s: they may arrive in bunches.
const BUNCH_S: f64 = 0.008;
/// Reports that have to agree before a jump is believed.
const AGREEING: u32 = 8;
/// Longest time that a speed is followed without being looked at, s.
const LONGEST_STEP_S: f64 = 0.1;

#[derive(Clone, Debug)]
struct Channel {
    hand: usize,
    dof: Dof,
    number: Number,
    counts: (f64, f64),
    means: (f64, f64),
    mode: Mode,
    zone: f64,
    wraps: bool,
    filter: Option<OneEuro>,
    watch: AxisWatch,
    /// Position before filter and play, in units of the profile.
    raw: Option<f64>,
    /// Position that was put up.
    at: Option<f64>,
    moved: f64,
    speed: f64,
    /// A position that the hand has jumped to, if it did.
    doubted: Option<f64>,
    /// Of the report in hand.
    new: Option<f64>,
}

impl Channel {
    fn bind(hand: usize, dof: Dof, axis: &Axis, layout: &Layout) -> Result<Self, FitError> {
        let name = dof.to_string();
        let (mut number, range) = Number::find(&name, &axis.from, layout)?;
        // A profile that says other counts knows the device better than its descriptor.
        if let (Number::Counts { strict, .. }, Some(_)) = (&mut number, axis.counts) {
            *strict = false;
        }
        let counts = match (axis.counts, range) {
            (Some(counts), _) => counts,
            (None, Some((least, most))) if least < most => (least as f64, most as f64),
            (None, range) => return Err(FitError::NoRange { axis: name, at: range.map_or(0, |r| r.0) }),
        };
        let means = if axis.invert { (axis.means.1, axis.means.0) } else { axis.means };
        let filter = axis.filter.map(OneEuro::new);
        let channel = Self::new(hand, dof, number, counts, means);
        Ok(Self { mode: axis.mode, zone: axis.dead_zone, wraps: axis.wraps, filter, ..channel })
    }

    fn new(hand: usize, dof: Dof, number: Number, counts: (f64, f64), means: (f64, f64)) -> Self {
        Self {
            hand,
            dof,
            number,
            counts,
            means,
            mode: Mode::Absolute,
            zone: 0.0,
            wraps: false,
            filter: None,
            watch: AxisWatch::default(),
            raw: None,
            at: None,
            moved: 0.0,
            speed: 0.0,
            doubted: None,
            new: None,
        }
    }

    fn slope(&self) -> f64 {
        (self.means.1 - self.means.0) / (self.counts.1 - self.counts.0)
    }

    fn span(&self) -> f64 {
        (self.means.1 - self.means.0).abs()
    }

    /// Reads the report and keeps what it says for [`Channel::commit`].
    fn hear(&mut self, report: &[u8]) -> Result<(), Refusal> {
        self.new = None;
        let Some(count) = self.number.hear(report).map_err(|_| Refusal::Range)? else { return Ok(()) };
        self.new = Some(match self.mode {
            Mode::Relative => count * self.slope(),
            Mode::Rate => {
                let rest = 0.5 * (self.counts.0 + self.counts.1);
                dead_zone((count - rest) * self.slope(), 0.5 * self.span(), self.zone)
            }
            Mode::Absolute => {
                let at = self.means.0 + (count - self.counts.0) * self.slope();
                match self.doubted.or(self.raw) {
                    Some(before) if self.wraps => unwrapped(before, at, self.span()),
                    _ => at,
                }
            }
        });
        Ok(())
    }

    fn absolute_news(&self) -> bool {
        self.mode == Mode::Absolute && self.new.is_some()
    }

    fn jumps(&self, from: Option<f64>, dt_s: f64) -> bool {
        let (Mode::Absolute, Some(from), Some(to)) = (self.mode, from, self.new) else { return false };
        // One step of a coarse axis is no jump.
        (to - from).abs() > (self.dof.fastest() * dt_s.max(BUNCH_S)).max(2.0 * self.slope().abs())
    }

    /// Makes what was heard true; gives how far the axis travelled, in ranges.
    fn commit(&mut self, at_s: f64) -> f64 {
        let Some(new) = self.new.take() else { return 0.0 };
        match self.mode {
            Mode::Relative => self.moved += new,
            Mode::Rate => self.speed = new,
            Mode::Absolute => {
                self.raw = Some(new);
                let smooth = self.filter.as_mut().map_or(new, |f| f.take(at_s, new));
                let play = self.zone * self.span();
                self.at = Some(follow(self.at.unwrap_or(smooth), smooth, play));
                return self.watch.hear(new / self.span());
            }
        }
        0.0
    }

    fn settle(&mut self) {
        self.raw = None;
        self.at = None;
        self.doubted = None;
        self.watch.settle();
        if let Some(filter) = &mut self.filter {
            filter.reset();
        }
    }
}

#[derive(Clone, Debug, Default)]
struct Buttons {
    closes: Vec<Switch>,
    pedal: Vec<Switch>,
}

/// A profile fitted to a device, with where its hands are.
#[derive(Clone, Debug)]
pub struct Mapping {
    layout: Option<Layout>,
    channels: Vec<Channel>,
    buttons: Vec<Buttons>,
    homing: Vec<Switch>,
    taken: Option<Duration>,
    integrated: Option<Duration>,
    doubts: u32,
}

impl Mapping {
    /// Fits a profile to a device with this report descriptor. A descriptor that cannot be read is an error only for a profile that asks for
    /// usages.
    ///
    /// # Errors
    /// When the device does not have what the profile asks for.
    pub fn fit(profile: &Profile, descriptor: &[u8]) -> Result<Self, FitError> {
        let read = Layout::read(descriptor);
        let layout = read.clone().unwrap_or_default();
        let fitted = Self::fit_layout(profile, &layout);
        match (fitted, read) {
            (Ok(fitted), read) => Ok(Self { layout: read.ok(), ..fitted }),
            (Err(FitError::NoUsage { .. }), Err(descriptor)) => Err(descriptor.into()),
            (Err(error), _) => Err(error),
        }
    }

    fn fit_layout(profile: &Profile, layout: &Layout) -> Result<Self, FitError> {
        let mut mapping = Self {
            layout: None,
            channels: Vec::new(),
            buttons: Vec::new(),
            homing: profile.homing.iter().map(|h| Switch::find("homing", &h.flag, layout)).collect::<Result<_, _>>()?,
            taken: None,
            integrated: None,
            doubts: 0,
        };
        for (index, hand) in profile.hands.iter().enumerate() {
            mapping.bind(index, hand, layout)?;
        }
        Ok(mapping)
    }

    fn bind(&mut self, index: usize, hand: &HandProfile, layout: &Layout) -> Result<(), FitError> {
        if let Some(direction) = &hand.direction {
            let numbers = Number::find_direction(direction, layout)?;
            // Degrees already; half a turn is the range that noise and travel are judged by.
            let channel = |(dof, number)| Channel::new(index, dof, number, (-90.0, 90.0), (-90.0, 90.0));
            self.channels.extend([Dof::Yaw, Dof::Pitch].into_iter().zip(numbers).map(channel));
        }
        let dofs = [Dof::Yaw, Dof::Pitch, Dof::Insertion, Dof::Roll, Dof::Opening];
        for (dof, (_, axis)) in dofs.into_iter().zip(hand.axes()) {
            if let Some(axis) = axis {
                self.channels.push(Channel::bind(index, dof, axis, layout)?);
            }
        }
        let find = |name: &str, buttons: &[_]| buttons.iter().map(|b| Switch::find(name, b, layout)).collect::<Result<_, _>>();
        self.buttons.push(Buttons { closes: find("closes", &hand.closes)?, pedal: find("pedal", &hand.pedal)? });
        Ok(())
    }

    /// Takes a report that came at `now`. A report that is refused moves nothing.
    ///
    /// # Errors
    /// When the report cannot be believed.
    pub fn take(&mut self, now: Duration, report: &[u8]) -> Result<Taken, Refusal> {
        if self.layout.as_ref().is_some_and(|layout| !layout.admits(report)) {
            return Err(Refusal::Shape);
        }
        self.integrate(now);
        for channel in &mut self.channels {
            channel.hear(report)?;
        }
        let dt_s = self.taken.map_or(f64::INFINITY, |then| now.saturating_sub(then).as_secs_f64());
        let mut taken = Taken::Moved;
        if self.channels.iter().any(|c| c.jumps(c.raw, dt_s)) {
            let agree = self.channels.iter().all(|c| !c.absolute_news() || (c.doubted.is_some() && !c.jumps(c.doubted, BUNCH_S)));
            self.doubts = if agree { self.doubts + 1 } else { 1 };
            for channel in self.channels.iter_mut().filter(|c| c.mode == Mode::Absolute) {
                channel.doubted = channel.new.or(channel.doubted);
            }
            if self.doubts < AGREEING {
                return Err(Refusal::Jump);
            }
            self.settle();
            taken = Taken::Elsewhere;
        }
        self.doubts = 0;
        self.taken = Some(now);
        self.commit(now.as_secs_f64());
        for switch in self.buttons.iter_mut().flat_map(|b| b.closes.iter_mut().chain(&mut b.pedal)).chain(&mut self.homing) {
            switch.hear(report);
        }
        Ok(taken)
    }

    fn commit(&mut self, at_s: f64) {
        for i in 0..self.channels.len() {
            let channel = &mut self.channels[i];
            channel.doubted = None;
            let ranges = channel.commit(at_s);
            let hand = channel.hand;
            if ranges > 0.0 {
                let others = self.channels.iter_mut().enumerate().filter(|(j, c)| *j != i && c.hand == hand);
                others.for_each(|(_, c)| c.watch.others_travelled(ranges));
            }
        }
    }

    /// Lets speeds act until `now`.
    pub fn integrate(&mut self, now: Duration) {
        let dt_s = self.integrated.map_or(0.0, |then| now.saturating_sub(then).as_secs_f64()).min(LONGEST_STEP_S);
        self.integrated = Some(now);
        for channel in &mut self.channels {
            channel.moved += channel.speed * dt_s;
        }
    }

    /// Whether any speed acts.
    #[must_use]
    pub fn drifts(&self) -> bool {
        self.channels.iter().any(|c| c.speed != 0.0)
    }

    /// Forgets where the hands are and lets no speed act: after a silence or garbage they may be anywhere.
    pub fn settle(&mut self) {
        self.channels.iter_mut().for_each(Channel::settle);
        self.taken = None;
        self.doubts = 0;
    }

    /// Lets no speed act and no button be held until they are heard of again.
    pub fn let_go(&mut self) {
        self.channels.iter_mut().for_each(|c| c.speed = 0.0);
        self.buttons.iter_mut().flat_map(|b| &mut b.pedal).for_each(|s| s.held = false);
    }

    /// The first flag of homing that is not set.
    #[must_use]
    pub fn not_homed(&self) -> Option<usize> {
        self.homing.iter().position(|flag| !flag.held)
    }

    /// The first axis that trembles, with its hand.
    #[must_use]
    pub fn noisy(&self) -> Option<(usize, Dof)> {
        self.channels.iter().find(|c| c.watch.noisy()).map(|c| (c.hand, c.dof))
    }

    /// The first axis that stays where it is while the others move, with its hand.
    #[must_use]
    pub fn stuck(&self) -> Option<(usize, Dof)> {
        self.channels.iter().find(|c| c.mode == Mode::Absolute && c.dof != Dof::Opening && c.watch.stuck()).map(|c| (c.hand, c.dof))
    }

    /// Where a hand of the profile is.
    #[must_use]
    pub fn reading(&self, hand: usize) -> HandReading {
        let mut reading = HandReading::default();
        for channel in self.channels.iter().filter(|c| c.hand == hand) {
            let unit = channel.dof.unit();
            match Dof::SHAFT.iter().position(|d| *d == channel.dof) {
                Some(i) => {
                    reading.at[i] = channel.at.map(|at| at * unit);
                    reading.moved[i] = channel.moved * unit;
                }
                None => reading.grip = channel.at.map(|open| 1.0 - open.clamp(0.0, 1.0)),
            }
        }
        if let Some(buttons) = self.buttons.get(hand) {
            if !buttons.closes.is_empty() {
                let held = buttons.closes.iter().any(|b| b.held);
                reading.grip = Some(reading.grip.unwrap_or(0.0).max(f64::from(u8::from(held))));
            }
            reading.pedal = buttons.pedal.iter().any(|b| b.held);
        }
        reading
    }
}
