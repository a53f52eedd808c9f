//! How devices are found and talked to. The rest of the crate does not know whether they are real.

use crate::error::TransportError;
use std::time::Duration;

/// An open device. One thread owns it.
pub trait Transport: Send {
    /// Time on the device's clock, which never goes back.
    fn now(&self) -> Duration;

    /// The report descriptor.
    ///
    /// # Errors
    /// When the device is gone or does not tell.
    fn descriptor(&mut self) -> Result<Vec<u8>, TransportError>;

    /// Waits for a report for at most `wait`, and gives its length; 0 when none came. A report longer than the buffer is cut off.
    ///
    /// # Errors
    /// When the device is gone.
    fn read(&mut self, buffer: &mut [u8], wait: Duration) -> Result<usize, TransportError>;

    /// Sends an output report. Its first byte is its identifier, 0 where reports have none.
    ///
    /// # Errors
    /// When the device is gone or refuses it.
    fn write(&mut self, report: &[u8]) -> Result<(), TransportError>;
}

/// Where devices are plugged in.
pub trait Bus: Send {
    /// Everything that is plugged in at `now`; a real bus has its own clock and does not look at it.
    ///
    /// # Errors
    /// When the system does not tell.
    fn list(&mut self, now: Duration) -> Result<Vec<DeviceInfo>, TransportError>;

    /// Opens a device at `now`.
    ///
    /// # Errors
    /// When it may not be opened, or is gone.
    fn open(&mut self, device: &DeviceInfo, now: Duration) -> Result<Box<dyn Transport>, TransportError>;
}

/// What is known of a device before it is opened.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DeviceInfo {
    /// Names it while it is plugged in; on Linux its file.
    pub path: String,
    /// Vendor identifier.
    pub vendor: u16,
    /// Product identifier.
    pub product: u16,
    /// What it calls itself.
    pub name: String,
    /// Tells it from others of its kind; often empty.
    pub serial: String,
    /// Usage page and usage of its application collections.
    pub usages: Vec<(u16, u16)>,
}

impl DeviceInfo {
    /// Whether this is the device that was at another path, or in another port, before.
    #[must_use]
    pub fn is_same(&self, before: &Self) -> bool {
        (self.vendor, self.product, &self.serial, &self.name) == (before.vendor, before.product, &before.serial, &before.name)
    }

    /// The rule that lets the person at the screen open this device on Linux, and how to set it.
    #[must_use]
    pub fn udev_rule(&self) -> String {
        let (vendor, product) = (self.vendor, self.product);
        format!(
            "put this line into /etc/udev/rules.d/70-keyhole.rules\n  KERNEL==\"hidraw*\", ATTRS{{idVendor}}==\"{vendor:04x}\", \
             ATTRS{{idProduct}}==\"{product:04x}\", TAG+=\"uaccess\", MODE=\"0660\"\nthen run `sudo udevadm control --reload && sudo udevadm trigger` \
             and plug the device in again"
        )
    }
}
