//! What `keyhole device monitor` shows: bars on a terminal, a line now and then elsewhere.

use crate::cli::failure::Failure;
use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};
use keyhole_hid::advice::advice;
use keyhole_hid::calibrate::Observer;
use keyhole_hid::descriptor::Control;
use keyhole_hid::{Dof, Layout, Profile, Session, Snapshot, Transport};
use std::collections::BTreeMap;
use std::io::IsTerminal;
use std::time::Duration;

/// Time between two looks at a device on the terminal.
pub(crate) const LOOK: Duration = Duration::from_millis(50);
/// Time between two lines where nobody sees them change.
const LINE: Duration = Duration::from_millis(500);
/// Range of the bars for angles, degrees, and for insertion, mm.
const BAR_DEG: f64 = 180.0;
const BAR_MM: f64 = 300.0;
/// Cells of a bar.
const BAR: u64 = 200;

/// Bars on a terminal, a line now and then elsewhere.
struct Screen {
    bars: Option<MultiProgress>,
    rows: BTreeMap<String, ProgressBar>,
    shown: Option<Duration>,
}

impl Screen {
    fn new() -> Self {
        let bars = std::io::stdout().is_terminal().then(|| MultiProgress::with_draw_target(ProgressDrawTarget::stdout()));
        Self { bars, rows: BTreeMap::new(), shown: None }
    }

    /// Whether it is time to show something again.
    fn due(&mut self, now: Duration) -> bool {
        let pause = if self.bars.is_some() { LOOK } else { LINE };
        let due = self.shown.is_none_or(|then| now.saturating_sub(then) >= pause);
        if due {
            self.shown = Some(now);
        }
        due
    }

    fn show(&mut self, rows: &[Row]) {
        let Some(bars) = &self.bars else {
            let line: Vec<String> = rows.iter().map(|r| format!("{} {}", r.name, r.text)).collect();
            println!("{}", line.join("  "));
            return;
        };
        for row in rows {
            let bar = self.rows.entry(row.name.clone()).or_insert_with(|| {
                let plain = ProgressStyle::default_bar();
                let style = ProgressStyle::with_template("{prefix:<18} {bar:40} {msg}").unwrap_or(plain);
                bars.add(ProgressBar::new(BAR).with_style(style).with_prefix(row.name.clone()))
            });
            bar.set_position((row.part.clamp(0.0, 1.0) * BAR as f64) as u64);
            bar.set_message(row.text.clone());
        }
    }
}

struct Row {
    name: String,
    part: f64,
    text: String,
}

/// Shows what a profile makes of a device until `seconds` have passed on the device's clock; without them for ever.
///
/// # Errors
/// [`Failure::Input`] when the profile does not fit; [`Failure::Job`] when the device goes away.
pub(crate) fn monitor(transport: Box<dyn Transport>, profile: &Profile, seconds: Option<Duration>) -> Result<(), Failure> {
    let (mut session, _line) = Session::new(transport, profile).map_err(Failure::input)?;
    let began = session.now();
    println!("profile {}", profile.name);
    let mut screen = Screen::new();
    loop {
        session.step(LOOK).map_err(Failure::job)?;
        let elapsed = session.now().saturating_sub(began);
        if screen.due(elapsed) {
            screen.show(&rows(session.snapshot(), profile));
        }
        if seconds.is_some_and(|s| elapsed >= s) {
            return Ok(());
        }
    }
}

/// What is shown of a device: each degree of freedom in degrees and millimetres.
fn rows(snapshot: &Snapshot, profile: &Profile) -> Vec<Row> {
    let advice = advice(snapshot, profile);
    let text = format!("{:?}, {} reports, {} refused  {advice}", snapshot.condition, snapshot.reports, snapshot.refused);
    let mut rows = vec![Row { name: "device".into(), part: f64::from(u8::from(snapshot.condition.moves())), text }];
    for (hand, reading) in profile.hands.iter().zip(&snapshot.hands) {
        let name = |what: &str| format!("{:?} {what}", hand.hand).to_lowercase();
        let has = |dof: Dof| {
            let tilts = hand.direction.is_some() && matches!(dof, Dof::Yaw | Dof::Pitch);
            tilts || hand.axes().iter().any(|(name, axis)| *name == dof.to_string() && axis.is_some())
        };
        for ((dof, at), moved) in Dof::SHAFT.into_iter().zip(reading.at).zip(reading.moved).filter(|((dof, _), _)| has(*dof)) {
            let value = at.unwrap_or(moved) / dof.unit();
            let (part, unit) = match dof {
                Dof::Insertion => (value / BAR_MM, "mm"),
                _ => (0.5 + 0.5 * value / BAR_DEG, "deg"),
            };
            rows.push(Row { name: name(&dof.to_string()), part, text: format!("{value:8.2} {unit}") });
        }
        if let Some(grip) = reading.grip {
            rows.push(Row { name: name("grip"), part: grip, text: format!("{grip:8.3}") });
        }
        rows.push(Row {
            name: name("pedal"),
            part: f64::from(u8::from(reading.pedal)),
            text: if reading.pedal { "down" } else { "up" }.into(),
        });
    }
    rows
}

/// Shows every field of a device, as [`monitor`].
///
/// # Errors
/// [`Failure::Input`] when the descriptor cannot be read; [`Failure::Job`] when the device goes away.
pub(crate) fn monitor_raw(mut transport: Box<dyn Transport>, seconds: Option<Duration>) -> Result<(), Failure> {
    let layout = Layout::read(&transport.descriptor().map_err(Failure::input)?).map_err(Failure::input)?;
    let controls = layout.controls.clone();
    let mut observer = Observer::new(layout);
    let mut screen = Screen::new();
    let began = transport.now();
    let mut buffer = vec![0; 4096];
    loop {
        let length = transport.read(&mut buffer, LOOK).map_err(Failure::job)?;
        observer.hear(&buffer[..length.min(buffer.len())]);
        let elapsed = transport.now().saturating_sub(began);
        if screen.due(elapsed) {
            let mut seen: BTreeMap<(u16, u16), u32> = BTreeMap::new();
            let row = |(control, (usage, value)): (&Control, ((u16, u16), Option<i64>))| {
                let nth = seen.entry(usage).and_modify(|n| *n += 1).or_insert(0);
                let range = (control.most - control.least).max(1) as f64;
                let part = value.map_or(0.0, |v| (v - control.least) as f64 / range);
                let text = value.map_or("not heard of yet".into(), |v| format!("{v:>8} of {} to {}", control.least, control.most));
                Row { name: format!("{:#06x}:{:#06x} {nth}", usage.0, usage.1), part, text }
            };
            screen.show(&controls.iter().zip(observer.values()).map(row).collect::<Vec<_>>());
        }
        if seconds.is_some_and(|s| elapsed >= s) {
            return Ok(());
        }
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;
    use keyhole_hid::{Bus, DeviceInfo, VirtualBus, VirtualDevice, Wire, WireField};

    #[test]
    fn a_monitor_ends_in_time_and_shows_every_axis() {
        let axis = |usage| WireField { usage: (1, usage), bits: 16, least: 0, most: 1000 };
        let wire = Wire { device: (1, 4), fields: vec![axis(0x33), axis(0x34)] };
        let info = DeviceInfo { path: "virtual".into(), name: "Trainer".into(), ..Default::default() };
        let (descriptor, always) = (wire.descriptor(), Duration::ZERO..Duration::MAX);
        let feed = Box::new((0u64..).map(move |ms| (Duration::from_millis(ms), wire.report(&[(ms % 1000) as i64, 500]))));
        let device = VirtualDevice { info: info.clone(), descriptor, plugged: vec![always], denied: vec![], feed };
        let mut bus = VirtualBus::new(vec![device]);
        let text = "(name: \"t\", matches: [Named(\"Trainer\")], hands: [(hand: Any, yaw: (from: Usage(page: 1, usage: 0x34), means: (-60, 60)))])";
        let profile = Profile::parse("t", text).unwrap();
        monitor(bus.open(&info, Duration::ZERO).unwrap(), &profile, Some(Duration::from_secs(1))).unwrap();
        monitor_raw(bus.open(&info, Duration::from_secs(1)).unwrap(), Some(Duration::from_secs(1))).unwrap();
        let (mut session, _line) = Session::new(bus.open(&info, Duration::from_secs(2)).unwrap(), &profile).unwrap();
        session.step(LOOK).unwrap();
        let rows = rows(session.snapshot(), &profile);
        assert_eq!(rows.iter().map(|r| r.name.as_str()).collect::<Vec<_>>(), ["device", "any yaw", "any pedal"]);
        assert_eq!(rows[1].text.trim(), "0.00 deg");
    }
}
