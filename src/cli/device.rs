//! `keyhole device`: what is plugged in, what it says, and a profile for it.

use crate::cli::device_monitor::{LOOK, monitor, monitor_raw};
use crate::cli::failure::Failure;
use clap::{Args, Subcommand, ValueEnum};
use keyhole_hid::calibrate::{Observer, STAGES, blank, put};
use keyhole_hid::keeper::rank;
use keyhole_hid::profile::HandChoice;
use keyhole_hid::{Bus, DeviceInfo, HidBus, Layout, Profile, Transport, TransportError, shipped};
use std::io::{BufRead, Write};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::time::Duration;

/// Arguments of `keyhole device`.
#[derive(Args, Debug)]
pub struct DeviceArgs {
    #[command(subcommand)]
    command: DeviceCommand,
}

#[derive(Subcommand, Debug)]
enum DeviceCommand {
    /// Print every HID device with the profile that it gets; and for one that may not be opened, what to do.
    List,
    /// Show a device's axes live.
    Monitor {
        #[command(flatten)]
        which: Which,
        /// Profile to read it with; without it the one that matches.
        #[arg(long, value_name = "FILE.ron")]
        profile: Option<PathBuf>,
        /// Every field of the device by its usage, without a profile.
        #[arg(long, conflicts_with = "profile")]
        raw: bool,
        /// Stop after so many seconds; without it at Ctrl+C.
        #[arg(long, value_name = "S")]
        seconds: Option<f64>,
    },
    /// Find out by moving a device what its fields are, and write a profile. An existing file is never overwritten.
    Calibrate {
        #[command(flatten)]
        which: Which,
        /// The profile to write; without it a new file in the folder whose profiles are always read.
        #[arg(short, long, value_name = "FILE.ron")]
        output: Option<PathBuf>,
        /// Which hand it is for.
        #[arg(long, value_enum, default_value_t = HandArg::Any)]
        hand: HandArg,
    },
}

/// Which hand a profile is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum HandArg {
    /// The left one.
    Left,
    /// The right one.
    Right,
    /// Whichever is free.
    Any,
}

impl From<HandArg> for HandChoice {
    fn from(hand: HandArg) -> Self {
        match hand {
            HandArg::Left => Self::Left,
            HandArg::Right => Self::Right,
            HandArg::Any => Self::Any,
        }
    }
}

#[derive(Args, Debug)]
struct Which {
    /// Number in `keyhole device list`, or part of the name or path; without it the first that a profile matches.
    #[arg(value_name = "DEVICE")]
    device: Option<String>,
}

/// Runs `keyhole device`.
///
/// # Errors
/// [`Failure::Input`] for a device that is not there, may not be opened or does not fit its profile; [`Failure::Job`] when the system has no HID,
/// or the device goes away.
pub fn run(args: &DeviceArgs) -> Result<(), Failure> {
    let mut bus = HidBus::new().map_err(Failure::job)?;
    let devices = bus.list(Duration::ZERO).map_err(Failure::job)?;
    match &args.command {
        DeviceCommand::List => {
            let profiles = profiles();
            print!("{}", listed(&devices, &profiles, |device| bus.open(device, Duration::ZERO).err()));
            Ok(())
        }
        DeviceCommand::Monitor { which, profile, raw, seconds } => {
            let seconds =
                seconds.map(|s| Duration::try_from_secs_f64(s).map_err(|_| Failure::input(format!("--seconds {s}: expected 0 or more"))));
            let seconds = seconds.transpose()?;
            if *raw {
                let device = chosen(&devices, which, &[])?;
                return monitor_raw(open(&mut bus, device)?, seconds);
            }
            let profiles = match profile {
                Some(file) => vec![Profile::load(file).map_err(Failure::input)?],
                None => profiles(),
            };
            let device = chosen(&devices, which, &profiles)?;
            let fits = if profile.is_some() { profiles.first() } else { best(device, &profiles) };
            let fits = fits.ok_or_else(|| {
                Failure::input(format!("{}: no profile matches; use --raw, --profile, or `keyhole device calibrate`", titled(device)))
            })?;
            monitor(open(&mut bus, device)?, fits, seconds)
        }
        DeviceCommand::Calibrate { which, output, hand } => {
            let device = chosen(&devices, which, &[])?;
            let output = match output {
                Some(file) => file.clone(),
                None => new_file(device)?,
            };
            if output.exists() {
                return Err(Failure::input(format!(
                    "{}: is there already and is never overwritten: name another file with -o",
                    output.display()
                )));
            }
            let profile = calibrate(open(&mut bus, device)?, device, (*hand).into(), &answers())?;
            write_new(&output, &profile)?;
            println!("wrote {}\nnow: keyhole device monitor --profile {}", output.display(), output.display());
            Ok(())
        }
    }
}

/// Every profile; what is wrong with a file of the user is said and does not matter to the others.
fn profiles() -> Vec<Profile> {
    let (profiles, errors) = shipped::all();
    errors.iter().for_each(|error| eprintln!("keyhole: {error}"));
    profiles
}

fn best<'a>(device: &DeviceInfo, profiles: &'a [Profile]) -> Option<&'a Profile> {
    profiles.iter().filter_map(|p| Some((rank(p, device)?, p))).min_by_key(|(rank, _)| *rank).map(|(_, p)| p)
}

fn titled(device: &DeviceInfo) -> String {
    let name = if device.name.is_empty() { "(no name)" } else { &device.name };
    format!("{name} {:04x}:{:04x} at {}", device.vendor, device.product, device.path)
}

/// The list of devices, `refused` saying what keeps one from being opened.
fn listed(devices: &[DeviceInfo], profiles: &[Profile], mut refused: impl FnMut(&DeviceInfo) -> Option<TransportError>) -> String {
    if devices.is_empty() {
        return "no HID devices are plugged in\n".into();
    }
    let mut text = String::new();
    for (device, number) in devices.iter().zip(1..) {
        let profile = best(device, profiles).map_or("no profile", |p| &p.name);
        let usages: Vec<String> = device.usages.iter().map(|(page, usage)| format!("{page:04x}:{usage:04x}")).collect();
        text += &format!("{number:>2}  {}\n    profile: {profile}; usage {}\n", titled(device), usages.join(", "));
        if let Some(error) = refused(device) {
            let said = match error {
                TransportError::Denied { rule, .. } => format!("may not be opened: {rule}"),
                other => other.to_string(),
            };
            text += &format!("    {}\n", said.replace('\n', "\n    "));
        }
    }
    text
}

fn chosen<'a>(devices: &'a [DeviceInfo], which: &Which, profiles: &[Profile]) -> Result<&'a DeviceInfo, Failure> {
    let found = match &which.device {
        Some(asked) => match asked.parse::<usize>() {
            Ok(number) => number.checked_sub(1).and_then(|i| devices.get(i)),
            Err(_) => devices.iter().find(|d| d.path == *asked || d.name.to_lowercase().contains(&asked.to_lowercase())),
        },
        None if profiles.is_empty() && devices.len() == 1 => devices.first(),
        None => devices.iter().find(|d| best(d, profiles).is_some()),
    };
    found.ok_or_else(|| {
        let asked =
            which.device.as_ref().map_or("no device was named, and none is the obvious one".to_owned(), |d| format!("no device is {d:?}"));
        Failure::input(format!("{asked}: `keyhole device list` shows what is plugged in; name one by its number"))
    })
}

fn open(bus: &mut dyn Bus, device: &DeviceInfo) -> Result<Box<dyn Transport>, Failure> {
    bus.open(device, Duration::ZERO).map_err(Failure::input)
}

/// Lines that are typed, so that the device is heard while the trainee thinks.
fn answers() -> Receiver<String> {
    let (send, receive) = channel();
    std::thread::spawn(move || {
        for line in std::io::stdin().lock().lines().map_while(Result::ok) {
            if send.send(line).is_err() {
                return;
            }
        }
    });
    receive
}

/// Asks, and listens to the device until a line is typed. The line, without blanks around it.
fn ask(question: &str, transport: &mut dyn Transport, observer: &mut Observer, answers: &Receiver<String>) -> Result<String, Failure> {
    print!("{question}: ");
    std::io::stdout().flush().map_err(Failure::job)?;
    let mut buffer = vec![0; 4096];
    let began = transport.now();
    loop {
        let length = transport.read(&mut buffer, LOOK).map_err(Failure::job)?;
        if length > 0 {
            observer.hear(&buffer[..length.min(buffer.len())]);
        }
        // A stream must not starve the question: reports that wait are read first, for a while.
        if length > 0 && transport.now().saturating_sub(began) < LOOK {
            continue;
        }
        match answers.try_recv() {
            Ok(line) => return Ok(line.trim().to_owned()),
            Err(TryRecvError::Empty) => {}
            Err(TryRecvError::Disconnected) => {
                return Err(Failure::input("the answers ended before the calibration: run it on a terminal"));
            }
        }
    }
}

fn calibrate(
    mut transport: Box<dyn Transport>,
    device: &DeviceInfo,
    hand: HandChoice,
    answers: &Receiver<String>,
) -> Result<Profile, Failure> {
    let layout = Layout::read(&transport.descriptor().map_err(Failure::input)?).map_err(Failure::input)?;
    let mut observer = Observer::new(layout);
    println!("{}\nDo what is said, hold still, and press Enter; type s and Enter to skip what the device does not have.", titled(device));
    let mut profile = blank(if device.name.is_empty() { "calibrated" } else { &device.name }, device, hand);
    for stage in STAGES {
        'again: loop {
            let mut positions = Vec::with_capacity(2);
            for end in stage.ends {
                if ask(&format!("{}: {end}", stage.dof), transport.as_mut(), &mut observer, answers)? == "s" {
                    break 'again;
                }
                positions.push(observer.position());
            }
            let Some(found) = observer.moved(&positions[0], &positions[1]) else {
                println!("nothing changed; once more");
                continue;
            };
            println!("  {:?}, {} to {}", found.source, found.counts.0, found.counts.1);
            observer.take(&found);
            put(&mut profile.hands[0], stage.dof, observer.axis(&found, stage.means));
            break;
        }
    }
    if ask("pedal or button: leave it up", transport.as_mut(), &mut observer, answers)? != "s" {
        let up = observer.position();
        if ask("pedal or button: hold it down", transport.as_mut(), &mut observer, answers)? != "s" {
            match observer.moved(&up, &observer.position()) {
                Some(found) => profile.hands[0].pedal.push(Observer::button(&found)),
                None => println!("nothing changed; the profile has no pedal"),
            }
        }
    }
    if profile.hands[0].axes().iter().all(|(_, axis)| axis.is_none()) {
        return Err(Failure::input("no axis was found: nothing is written; `keyhole device monitor --raw` shows what the device sends"));
    }
    Ok(profile)
}

fn new_file(device: &DeviceInfo) -> Result<PathBuf, Failure> {
    let folder = shipped::user_folder().ok_or_else(|| Failure::input("the system names no folder for settings: name a file with -o"))?;
    let stem = format!("{:04x}_{:04x}", device.vendor, device.product);
    let names = std::iter::once(format!("{stem}.ron")).chain((2..1000).map(|n| format!("{stem}_{n}.ron")));
    let free = names.map(|name| folder.join(name)).find(|file| !file.exists());
    free.ok_or_else(|| Failure::input(format!("{}: holds a thousand profiles of this device: name a file with -o", folder.display())))
}

/// Writes a profile under a name that is not there: a file that came meanwhile is left alone.
fn write_new(file: &Path, profile: &Profile) -> Result<(), Failure> {
    let text = profile.to_ron().map_err(Failure::job)?;
    let failed = |error: &dyn std::fmt::Display| Failure::job(format!("{}: {error}", file.display()));
    let folder = file.parent().filter(|f| !f.as_os_str().is_empty()).unwrap_or(Path::new("."));
    std::fs::create_dir_all(folder).map_err(|e| failed(&e))?;
    let mut new = tempfile::NamedTempFile::new_in(folder).map_err(|e| failed(&e))?;
    new.write_all(text.as_bytes()).map_err(|e| failed(&e))?;
    new.persist_noclobber(file).map_err(|e| failed(&format!("{}; an existing profile is never overwritten", e.error)))?;
    Ok(())
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;
    use keyhole_hid::{VirtualBus, VirtualDevice, Wire, WireField};

    fn wire() -> Wire {
        let axis = |usage| WireField { usage: (1, usage), bits: 16, least: 0, most: 1000 };
        Wire { device: (1, 4), fields: vec![axis(0x33), axis(0x34), WireField { usage: (9, 1), bits: 1, least: 0, most: 1 }] }
    }

    fn bus() -> (VirtualBus, DeviceInfo) {
        let info = DeviceInfo {
            path: "virtual".into(),
            vendor: 1,
            product: 2,
            name: "Trainer".into(),
            usages: vec![(1, 4)],
            ..Default::default()
        };
        let feed = Box::new((0u64..).map(|ms| (Duration::from_millis(ms), wire().report(&[(3 * ms % 1000) as i64, 500, 0]))));
        let always = Duration::ZERO..Duration::MAX;
        let device = VirtualDevice { info: info.clone(), descriptor: wire().descriptor(), plugged: vec![always], denied: vec![], feed };
        (VirtualBus::new(vec![device]), info)
    }

    #[test]
    fn a_list_names_the_profile_and_the_rule_of_a_device_that_may_not_be_opened() {
        let (_, info) = bus();
        let denied = |device: &DeviceInfo| Some(TransportError::Denied { path: device.path.clone(), rule: device.udev_rule() });
        let text = listed(&[info], &shipped::shipped().unwrap(), denied);
        assert!(text.starts_with(" 1  Trainer 0001:0002 at virtual\n    profile: Gamepad; usage 0001:0004\n"), "{text}");
        assert!(text.contains("/etc/udev/rules.d/70-keyhole.rules\n      KERNEL==\"hidraw*\""), "{text}");
    }

    #[test]
    fn a_calibration_asks_for_every_axis_and_a_file_is_never_overwritten() {
        let (mut bus, info) = bus();
        let transport = bus.open(&info, Duration::ZERO).unwrap();
        let (send, answers) = channel();
        // Answered before they are asked: yaw moves by itself in the stream, everything else is skipped.
        for answer in ["", "", "s", "s", "s", "s", "s"] {
            send.send(answer.to_owned()).unwrap();
        }
        let profile = calibrate(transport, &info, HandChoice::Left, &answers).unwrap();
        assert!(profile.hands[0].yaw.is_some() && profile.hands[0].pitch.is_none());
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("mine").join("trainer.ron");
        write_new(&file, &profile).unwrap();
        let written = std::fs::read_to_string(&file).unwrap();
        assert_eq!(Profile::load(&file).unwrap(), profile);
        assert!(write_new(&file, &profile).unwrap_err().to_string().contains("never overwritten"));
        assert_eq!(std::fs::read_to_string(&file).unwrap(), written);
    }
}
