//! Devices that are not there: descriptors and streams of reports, recorded or made up, on a clock that nobody waits for.
//!
//! They go through the same code as real ones. A test plugs them in and out at times of its choosing.

use crate::error::TransportError;
use crate::report::BitField;
use crate::transport::{Bus, DeviceInfo, Transport};
use std::iter::Peekable;
use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Reports with the times at which they come, in order.
pub type Feed = Box<dyn Iterator<Item = (Duration, Vec<u8>)> + Send>;

/// A device that is not there.
pub struct VirtualDevice {
    /// What is known of it before it is opened. The path tells it from others.
    pub info: DeviceInfo,
    /// Its report descriptor.
    pub descriptor: Vec<u8>,
    /// When it is plugged in.
    pub plugged: Vec<Range<Duration>>,
    /// When it may not be opened although it is plugged in.
    pub denied: Vec<Range<Duration>>,
    /// What it sends while it is plugged in.
    pub feed: Feed,
}

struct Slot {
    info: DeviceInfo,
    descriptor: Vec<u8>,
    plugged: Vec<Range<Duration>>,
    denied: Vec<Range<Duration>>,
    feed: Peekable<Feed>,
    written: Vec<(Duration, Vec<u8>)>,
}

impl Slot {
    fn plugged_until(&self, now: Duration) -> Option<Duration> {
        self.plugged.iter().find(|p| p.contains(&now)).map(|p| p.end)
    }
}

/// A bus of devices that are not there. Clones are the same bus.
#[derive(Clone, Default)]
pub struct VirtualBus {
    slots: Arc<Mutex<Vec<Slot>>>,
}

impl VirtualBus {
    /// A bus with these devices.
    #[must_use]
    pub fn new(devices: Vec<VirtualDevice>) -> Self {
        let slot = |d: VirtualDevice| Slot {
            info: d.info,
            descriptor: d.descriptor,
            plugged: d.plugged,
            denied: d.denied,
            feed: d.feed.peekable(),
            written: Vec::new(),
        };
        Self { slots: Arc::new(Mutex::new(devices.into_iter().map(slot).collect())) }
    }

    /// Every output report that a device got, with its time.
    #[must_use]
    pub fn written(&self, path: &str) -> Vec<(Duration, Vec<u8>)> {
        self.lock().iter().find(|s| s.info.path == path).map_or_else(Vec::new, |s| s.written.clone())
    }

    fn lock(&self) -> MutexGuard<'_, Vec<Slot>> {
        self.slots.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Bus for VirtualBus {
    fn list(&mut self, now: Duration) -> Result<Vec<DeviceInfo>, TransportError> {
        Ok(self.lock().iter().filter(|s| s.plugged_until(now).is_some()).map(|s| s.info.clone()).collect())
    }

    fn open(&mut self, device: &DeviceInfo, now: Duration) -> Result<Box<dyn Transport>, TransportError> {
        let mut slots = self.lock();
        let place = slots.iter().position(|s| s.info.path == device.path && s.plugged_until(now).is_some());
        let place = place.ok_or_else(|| TransportError::Gone(device.path.clone()))?;
        let slot = &mut slots[place];
        if slot.denied.iter().any(|d| d.contains(&now)) {
            return Err(TransportError::Denied { path: device.path.clone(), rule: device.udev_rule() });
        }
        // What it said while nobody listened is lost.
        while slot.feed.next_if(|(at, _)| *at < now).is_some() {}
        Ok(Box::new(VirtualTransport { bus: self.clone(), place, now }))
    }
}

struct VirtualTransport {
    bus: VirtualBus,
    place: usize,
    now: Duration,
}

impl Transport for VirtualTransport {
    fn now(&self) -> Duration {
        self.now
    }

    fn descriptor(&mut self) -> Result<Vec<u8>, TransportError> {
        Ok(self.bus.lock()[self.place].descriptor.clone())
    }

    fn read(&mut self, buffer: &mut [u8], wait: Duration) -> Result<usize, TransportError> {
        let mut slots = self.bus.lock();
        let slot = &mut slots[self.place];
        let gone = || TransportError::Gone("it was unplugged".into());
        let end = slot.plugged_until(self.now).ok_or_else(gone)?;
        let until = self.now + wait;
        if let Some((at, report)) = slot.feed.next_if(|(at, _)| *at <= until && *at < end) {
            self.now = self.now.max(at);
            let length = report.len().min(buffer.len());
            buffer[..length].copy_from_slice(&report[..length]);
            return Ok(length);
        }
        self.now = until.min(end);
        if until >= end { Err(gone()) } else { Ok(0) }
    }

    fn write(&mut self, report: &[u8]) -> Result<(), TransportError> {
        let mut slots = self.bus.lock();
        let slot = &mut slots[self.place];
        if slot.plugged_until(self.now).is_none() {
            return Err(TransportError::Gone("it was unplugged".into()));
        }
        slot.written.push((self.now, report.to_vec()));
        Ok(())
    }
}

/// One field of a made-up report.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WireField {
    /// Usage page and usage.
    pub usage: (u16, u16),
    /// Number of bits, 1 to 32.
    pub bits: u8,
    /// Smallest value.
    pub least: i32,
    /// Largest value.
    pub most: i32,
}

/// A made-up report: its descriptor, and its bytes for any values.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Wire {
    /// Usage page and usage of the device.
    pub device: (u16, u16),
    /// Its fields in order, packed without gaps.
    pub fields: Vec<WireField>,
}

impl Wire {
    /// The report descriptor (HID 1.11, 6.2.2), with the bits after the last field filled up to whole bytes.
    #[must_use]
    pub fn descriptor(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut item = |prefix: u8, value: i32| {
            bytes.push(prefix | 3);
            bytes.extend(value.to_le_bytes());
        };
        item(0x04, i32::from(self.device.0));
        item(0x08, i32::from(self.device.1));
        item(0xa0, 1);
        for field in &self.fields {
            item(0x04, i32::from(field.usage.0));
            // Four bytes of usage carry their page (6.2.2.8).
            item(0x08, i32::from(field.usage.0) << 16 | i32::from(field.usage.1));
            item(0x14, field.least);
            item(0x24, field.most);
            item(0x74, i32::from(field.bits));
            item(0x94, 1);
            item(0x80, 2);
        }
        let gap = self.length() * 8 - self.bits();
        if gap > 0 {
            item(0x74, gap as i32);
            item(0x94, 1);
            item(0x80, 3);
        }
        bytes.push(0xc0);
        bytes
    }

    fn bits(&self) -> usize {
        self.fields.iter().map(|f| usize::from(f.bits)).sum()
    }

    /// Bytes of a report.
    #[must_use]
    pub fn length(&self) -> usize {
        self.bits().div_ceil(8)
    }

    /// A report with these values, in the order of the fields; a missing value is 0.
    #[must_use]
    pub fn report(&self, values: &[i64]) -> Vec<u8> {
        let mut report = vec![0; self.length()];
        let mut start = 0;
        for (field, value) in self.fields.iter().zip(values) {
            let bits = usize::from(field.bits);
            BitField { report: None, start, bits, signed: field.least < 0 }.write(&mut report, *value);
            start += bits;
        }
        report
    }
}
