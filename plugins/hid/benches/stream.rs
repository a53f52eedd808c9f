//! What a stream of 1000 reports a second costs, and how long a report takes to the whiteboard: `cargo bench -p keyhole-hid`.
//!
//! The device is a thread that sends each report into a channel on which the device's thread waits as it would on hidraw. Latency is taken from
//! the moment of sending until the newest state is there to be read, and until a tick that begins then has put it on the whiteboard. A tick
//! begins at most one tick later, so that is the part beyond a tick. The error beside the time: how many of the states that were read were not the newest that had been
//! sent, and by how much the reading differs from what was sent.
//!
//! `STREAM_SECONDS` (default 5) is how long the stream lasts.
#![expect(clippy::unwrap_used, reason = "a bench panics where it fails")]

use bevy_app::prelude::*;
use bevy_time::{Fixed, Time, TimePlugin, TimeUpdateStrategy};
use keyhole_hid::service::Service;
use keyhole_hid::{Bus, DeviceInfo, HidPlugin, Mapping, Profile, Session, Transport, TransportError, Wire, WireField};
use keyhole_whiteboard::{DeviceHands, WhiteboardPlugin};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread;
use std::time::{Duration, Instant};

const COUNTS: i64 = 65_535;

/// How many reports the stream has.
fn reports() -> u32 {
    let seconds = std::env::var("STREAM_SECONDS").ok().map_or(5, |text| text.parse().expect("STREAM_SECONDS is a whole number of seconds"));
    1000 * seconds
}

fn profile() -> Profile {
    let filter = "filter: (min_cutoff_hz: 10.0, beta: 1.0)";
    let axis = |name: &str, usage: u16, means: &str, filter: &str| {
        format!("{name}: (from: Usage(page: 1, usage: {usage}), means: {means}, {filter}),")
    };
    let text = format!(
        "(name: \"bench\", matches: [Device(vendor: 1)], rate_hz: 1000.0, hands: [(hand: Right, {}{}{}{}{} pedal: [(from: Usage(page: 9, usage: 1))])],
          force: (report: 0, bytes: 2, channels: [(effort: Yaw, start: 0, bits: 16, counts_per_unit: 1.0, limit: 1.0)]))",
        axis("yaw", 0x33, "(-60.0, 60.0)", ""),
        axis("pitch", 0x34, "(-60.0, 60.0)", filter),
        axis("insertion", 0x32, "(0.0, 250.0)", filter),
        axis("roll", 0x35, "(-180.0, 180.0)", filter),
        axis("opening", 0x36, "(0.0, 1.0)", filter),
    );
    Profile::parse("bench", &text).unwrap()
}

fn wire() -> Wire {
    let axis = |usage| WireField { usage: (1, usage), bits: 16, least: 0, most: COUNTS as i32 };
    let button = WireField { usage: (9, 1), bits: 1, least: 0, most: 1 };
    Wire { device: (1, 4), fields: vec![axis(0x33), axis(0x34), axis(0x32), axis(0x35), axis(0x36), button] }
}

/// A device at the other end of a channel.
struct Piped {
    reports: Receiver<Vec<u8>>,
    epoch: Instant,
}

impl Transport for Piped {
    fn now(&self) -> Duration {
        self.epoch.elapsed()
    }

    fn descriptor(&mut self) -> Result<Vec<u8>, TransportError> {
        Ok(wire().descriptor())
    }

    fn read(&mut self, buffer: &mut [u8], wait: Duration) -> Result<usize, TransportError> {
        match self.reports.recv_timeout(wait) {
            Ok(report) => {
                buffer[..report.len()].copy_from_slice(&report);
                Ok(report.len())
            }
            Err(RecvTimeoutError::Timeout) => Ok(0),
            Err(RecvTimeoutError::Disconnected) => Err(TransportError::Gone("the bench is over".into())),
        }
    }

    fn write(&mut self, _report: &[u8]) -> Result<(), TransportError> {
        Ok(())
    }
}

struct OneDevice(Option<Piped>);

impl Bus for OneDevice {
    fn list(&mut self, _now: Duration) -> Result<Vec<DeviceInfo>, TransportError> {
        Ok(vec![DeviceInfo { path: "bench".into(), vendor: 1, name: "bench".into(), ..Default::default() }])
    }

    fn open(&mut self, _device: &DeviceInfo, _now: Duration) -> Result<Box<dyn Transport>, TransportError> {
        let piped = self.0.take().ok_or_else(|| TransportError::Gone("it is open already".into()))?;
        Ok(Box::new(piped))
    }
}

fn piped() -> (Sender<Vec<u8>>, Piped) {
    let (send, reports) = channel();
    (send, Piped { reports, epoch: Instant::now() })
}

/// A slow movement up and down: each report differs from the one before.
fn count(i: u32) -> i64 {
    let way = i64::from(i) % 20_000;
    20_000 + way.min(20_000 - way)
}

fn report(i: u32) -> Vec<u8> {
    let c = count(i);
    wire().report(&[c, c, c, c, c, 0])
}

fn percentiles(mut times: Vec<Duration>) -> String {
    times.sort();
    let at = |part: f64| times[((times.len() - 1) as f64 * part) as usize].as_secs_f64() * 1e6;
    format!("median {:.0} us, 99 % {:.0} us, largest {:.0} us", at(0.5), at(0.99), at(1.0))
}

/// Processor time of this process's threads with a name, s. Linux only.
fn cpu_s(name: &str) -> Option<f64> {
    let mut sum = None;
    for task in std::fs::read_dir("/proc/self/task").ok()?.flatten() {
        let read = |file: &str| std::fs::read_to_string(task.path().join(file)).unwrap_or_default();
        if read("comm").trim().starts_with(name) {
            let ran: f64 = read("schedstat").split_whitespace().next()?.parse().ok()?;
            sum = Some(sum.unwrap_or(0.0) + ran * 1e-9);
        }
    }
    sum
}

fn mapping_cost() {
    let mut mapping = Mapping::fit(&profile(), &wire().descriptor()).unwrap();
    let reports: Vec<Vec<u8>> = (0..20_000).map(report).collect();
    let mut least = Duration::MAX;
    for round in 0..5u32 {
        let start = Instant::now();
        for (i, report) in (0..).zip(&reports) {
            let ms = 20_000 * u64::from(round) + i;
            let _ = std::hint::black_box(mapping.take(Duration::from_millis(ms), report));
        }
        least = least.min(start.elapsed());
    }
    println!("a report of five axes read, judged and smoothed: {:.0} ns (least of 5 times 20 000)", least.as_secs_f64() * 1e9 / 20_000.0);
}

fn to_the_newest() {
    let (send, piped) = piped();
    let (mut session, mut line) = Session::new(Box::new(piped), &profile()).unwrap();
    let thread = thread::Builder::new().name("device".into()).spawn(move || while session.step(Duration::MAX).is_ok() {}).unwrap();
    let mut times = Vec::new();
    let began = Instant::now();
    let (mut stale, mut worst) = (0u32, 0f64);
    let reports = reports();
    for i in 0..reports {
        let due = began + Duration::from_millis(u64::from(i));
        thread::sleep(due.saturating_duration_since(Instant::now()));
        let sent = Instant::now();
        send.send(report(i)).unwrap();
        while line.newest.read().reports <= u64::from(i) && sent.elapsed() < Duration::from_millis(50) {
            thread::yield_now();
        }
        times.push(sent.elapsed());
        let newest = *line.newest.output_buffer();
        stale += u32::from(newest.reports != u64::from(i) + 1);
        let expected = (-60.0 + 120.0 * count(i) as f64 / COUNTS as f64).to_radians();
        worst = worst.max((newest.hands[0].at[0].unwrap_or(f64::NAN) - expected).abs());
    }
    let (wall, cpu) = (began.elapsed().as_secs_f64(), cpu_s("device"));
    println!("report in to newest state, {reports} reports at 1000 Hz with force out at 500 Hz: {}", percentiles(times));
    println!("  states that were not the newest: {stale}; largest error of an unfiltered axis: {worst:.1e} rad");
    if let Some(cpu) = cpu {
        println!("  the device's thread: {:.2} % of a core", 100.0 * cpu / wall);
    }
    drop(send);
    thread.join().unwrap();
}

fn to_the_whiteboard() {
    let (send, piped) = piped();
    let service = Service::threads::<TransportError>(move || Ok(Box::new(OneDevice(Some(piped))) as Box<dyn Bus>), vec![profile()]);
    let mut app = App::new();
    app.add_plugins((TimePlugin, WhiteboardPlugin, HidPlugin::new(service)))
        .insert_resource(Time::<Fixed>::from_hz(60.0))
        .insert_resource(TimeUpdateStrategy::FixedTimesteps(1));
    let newest = |app: &App| app.world().resource::<DeviceHands>().right.and_then(|h| h.yaw.at);
    let began = Instant::now();
    let mut sent = 0;
    while newest(&app).is_none() && began.elapsed() < Duration::from_secs(5) {
        send.send(report(sent)).unwrap();
        sent += 1;
        thread::sleep(Duration::from_millis(1));
        app.update();
    }
    let mut times = Vec::new();
    let mut ticks = 0u32;
    for i in sent..sent + 1000 {
        thread::sleep(Duration::from_millis(1));
        let expected = (-60.0 + 120.0 * count(i) as f32 / COUNTS as f32).to_radians();
        let at = Instant::now();
        send.send(report(i)).unwrap();
        // Ticks one after another: as soon as the state is there, the next one has it.
        while newest(&app).is_none_or(|yaw| (yaw - expected).abs() > 1e-5) && at.elapsed() < Duration::from_millis(100) {
            app.update();
            ticks += 1;
        }
        times.push(at.elapsed());
    }
    println!("report in to whiteboard, beyond the tick that is waited for: {} ({ticks} ticks of an empty scene)", percentiles(times));
}

fn main() {
    mapping_cost();
    to_the_newest();
    to_the_whiteboard();
}
