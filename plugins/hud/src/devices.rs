//! The panel of devices: how each is, whose hand it is, and what to do about it.

use crate::panel::{ACTIVE, QUIET};
use bevy_egui::egui::{self, Align2, Color32, RichText, Ui};
use keyhole_whiteboard::{DeviceCondition, DeviceReport, DeviceStatus};

/// Of a device that moves its instruments as it should.
const SOUND: Color32 = Color32::from_rgb(120, 200, 120);

/// What a device needs is shown even when the panels are hidden: its instruments hold still until it is done.
pub fn show_devices(context: &egui::Context, devices: &DeviceStatus, panels: bool) {
    let mut shown = devices.0.iter().filter(|d| panels || !d.advice.is_empty()).peekable();
    if shown.peek().is_none() {
        return;
    }
    egui::Window::new("Devices").anchor(Align2::RIGHT_TOP, [-10.0, 10.0]).resizable(false).default_width(320.0).show(context, |ui| {
        shown.enumerate().for_each(|(i, device)| {
            if i > 0 {
                ui.separator();
            }
            show_device(ui, device);
        });
    });
}

fn show_device(ui: &mut Ui, device: &DeviceReport) {
    ui.set_max_width(320.0);
    let colour = match (device.condition.moves(), device.advice.is_empty()) {
        (true, true) => SOUND,
        _ => ACTIVE,
    };
    let hands: Vec<String> = device.hands.iter().map(|hand| format!("{hand:?}").to_lowercase()).collect();
    let hands = if hands.is_empty() { String::new() } else { format!(" ({})", hands.join(", ")) };
    ui.label(RichText::new(format!("{}{hands}: {}", device.name, spoken(device.condition))).color(colour));
    if !device.advice.is_empty() {
        ui.add(egui::Label::new(&device.advice).wrap());
    }
    if device.reports > 0 {
        let refused = if device.refused > 0 { format!(", {} refused", device.refused) } else { String::new() };
        ui.label(RichText::new(format!("{} reports{refused}", device.reports)).color(QUIET).small());
    }
}

/// A condition in words.
fn spoken(condition: DeviceCondition) -> String {
    let name = format!("{condition:?}");
    name.chars().enumerate().flat_map(|(i, c)| (i > 0 && c.is_uppercase()).then_some(' ').into_iter().chain(c.to_lowercase())).collect()
}
