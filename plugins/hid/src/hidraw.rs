//! Real devices, by hidapi: hidraw on Linux, without any system library.

use crate::error::TransportError;
use crate::transport::{Bus, DeviceInfo, Transport};
use hidapi::{HidApi, HidDevice, HidError, MAX_REPORT_DESCRIPTOR_SIZE};
use std::ffi::CString;
use std::io::ErrorKind;
use std::sync::LazyLock;
use std::time::{Duration, Instant};

/// The clock of all real devices.
static EPOCH: LazyLock<Instant> = LazyLock::new(Instant::now);

/// The devices of this machine.
pub struct HidBus {
    api: HidApi,
}

impl HidBus {
    /// Asks the system for its devices.
    ///
    /// # Errors
    /// When it has no HID at all.
    pub fn new() -> Result<Self, TransportError> {
        LazyLock::force(&EPOCH);
        let api = HidApi::new().map_err(|e| TransportError::Fault(format!("the system's HID devices cannot be listed: {e}")))?;
        Ok(Self { api })
    }
}

impl Bus for HidBus {
    fn list(&mut self, _now: Duration) -> Result<Vec<DeviceInfo>, TransportError> {
        self.api.refresh_devices().map_err(|e| TransportError::Fault(e.to_string()))?;
        let mut devices: Vec<DeviceInfo> = Vec::new();
        // One entry an application collection: those of one path are one device.
        for entry in self.api.device_list() {
            let path = entry.path().to_string_lossy().into_owned();
            let usage = (entry.usage_page(), entry.usage());
            if let Some(known) = devices.iter_mut().find(|d| d.path == path) {
                known.usages.push(usage);
                continue;
            }
            devices.push(DeviceInfo {
                path,
                vendor: entry.vendor_id(),
                product: entry.product_id(),
                name: entry.product_string().unwrap_or_default().trim().to_owned(),
                serial: entry.serial_number().unwrap_or_default().to_owned(),
                usages: vec![usage],
            });
        }
        devices.sort_by(|a, b| a.path.cmp(&b.path));
        Ok(devices)
    }

    fn open(&mut self, device: &DeviceInfo, _now: Duration) -> Result<Box<dyn Transport>, TransportError> {
        let gone = |what: String| TransportError::Gone(what);
        let path = CString::new(device.path.as_str()).map_err(|e| gone(e.to_string()))?;
        match self.api.open_path(&path) {
            Ok(open) => Ok(Box::new(HidTransport { device: open })),
            Err(error) => Err(match std::fs::OpenOptions::new().read(true).write(true).open(&device.path) {
                Err(e) if cfg!(unix) && e.kind() == ErrorKind::PermissionDenied => {
                    TransportError::Denied { path: device.path.clone(), rule: device.udev_rule() }
                }
                Err(e) if cfg!(unix) && e.kind() == ErrorKind::NotFound => gone(error.to_string()),
                _ => TransportError::Fault(error.to_string()),
            }),
        }
    }
}

struct HidTransport {
    device: HidDevice,
}

/// A signal that interrupts a wait is no fault of the device.
fn interrupted(error: &HidError) -> bool {
    matches!(error, HidError::IoError { error } if matches!(error.kind(), ErrorKind::Interrupted | ErrorKind::WouldBlock))
}

impl Transport for HidTransport {
    fn now(&self) -> Duration {
        EPOCH.elapsed()
    }

    fn descriptor(&mut self) -> Result<Vec<u8>, TransportError> {
        let mut buffer = vec![0; MAX_REPORT_DESCRIPTOR_SIZE];
        let length = self.device.get_report_descriptor(&mut buffer).map_err(|e| TransportError::Fault(e.to_string()))?;
        buffer.truncate(length);
        Ok(buffer)
    }

    fn read(&mut self, buffer: &mut [u8], wait: Duration) -> Result<usize, TransportError> {
        // Waits are counted in whole milliseconds; rounded up, for 0 would spin.
        let wait_ms = i32::try_from(wait.as_micros().div_ceil(1000)).unwrap_or(i32::MAX);
        match self.device.read_timeout(buffer, wait_ms) {
            Ok(length) => Ok(length),
            Err(error) if interrupted(&error) => Ok(0),
            Err(error) => Err(TransportError::Gone(error.to_string())),
        }
    }

    fn write(&mut self, report: &[u8]) -> Result<(), TransportError> {
        match self.device.write(report) {
            Ok(sent) if sent == report.len() => Ok(()),
            Ok(sent) => Err(TransportError::Fault(format!("took {sent} of {} bytes", report.len()))),
            Err(error) => Err(TransportError::Fault(error.to_string())),
        }
    }
}
