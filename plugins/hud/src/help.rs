//! What the trainee can do, on screen: mouse and keys for both hands on one side, a gamepad's handles on the other, then every other key.

use crate::panel::QUIET;
use bevy_egui::egui::{self, Align2, RichText, Ui};
use keyhole_whiteboard::KeyMap;

/// How two hands are led with one mouse, in the order in which it is learnt.
const FIRST_STEPS: [&str; 5] = [
    "Move the mouse: the handle follows it, and the tip goes the other way about the port.",
    "Turn the wheel: in and out. The deeper the tip, the farther it goes for the same motion of the hand.",
    "Hold the left button: jaws close and hold, scissors cut as they close, hook and scalpel cut.",
    "Press Tab for the other hand: what the first one holds stays held, jaws closed, until you come back.",
    "Hold the right button: the mouse moves the endoscope instead.",
];

/// What the controls of a gamepad do for the left and for the right hand, as the profile that is shipped has them.
pub const GAMEPAD: [(&str, &str, &str); 5] = [
    ("swing the handle", "left stick", "right stick"),
    ("push in / pull out", "L2 / L1", "R2 / R1"),
    ("close the jaws, while held", "press the left stick", "press the right stick"),
    ("roll", "cross right / left", "button 3 / 1"),
    ("pedal: hook and scalpel cut", "button 4", "button 2"),
];

/// The window of help.
pub fn show_help(context: &egui::Context, keys: &KeyMap) {
    let most = context.content_rect().height() - 80.0;
    egui::Window::new("Hands and keys")
        .anchor(Align2::CENTER_CENTER, [0.0, 0.0])
        .resizable(false)
        .collapsible(false)
        .min_width(880.0)
        .show(context, |ui| {
            egui::ScrollArea::vertical().max_height(most).show(ui, |ui| {
                ui.horizontal_top(|ui| {
                    ui.vertical(show_steps);
                    // A line between them would be as high as the window may become.
                    ui.add_space(20.0);
                    ui.vertical(show_gamepad);
                });
                ui.separator();
                show_keys(ui, keys);
            });
        });
}

fn show_steps(ui: &mut Ui) {
    ui.set_width(330.0);
    ui.label(RichText::new("Mouse and keys").strong());
    for (number, step) in FIRST_STEPS.iter().enumerate() {
        ui.label(format!("{}. {step}", number + 1));
    }
}

fn show_gamepad(ui: &mut Ui) {
    ui.label(RichText::new("Gamepad").strong());
    egui::Grid::new("gamepad").num_columns(3).spacing([12.0, 4.0]).show(ui, |ui| {
        for title in ["", "left hand", "right hand"] {
            ui.label(RichText::new(title).color(QUIET));
        }
        ui.end_row();
        for (what, left, right) in GAMEPAD {
            ui.label(what);
            ui.label(RichText::new(left).strong());
            ui.label(RichText::new(right).strong());
            ui.end_row();
        }
    });
    ui.label(RichText::new("Numbers of buttons differ between pads: `keyhole device monitor`").color(QUIET).small());
}

/// In two columns: one would be higher than a small screen.
fn show_keys(ui: &mut Ui, keys: &KeyMap) {
    let half = keys.0.len().div_ceil(2);
    ui.horizontal_top(|ui| {
        for (side, part) in keys.0.chunks(half.max(1)).enumerate() {
            egui::Grid::new(("keys", side)).num_columns(2).spacing([12.0, 4.0]).max_col_width(300.0).show(ui, |ui| {
                for (key, what) in part {
                    ui.label(RichText::new(key).strong().monospace());
                    ui.add(egui::Label::new(what).wrap());
                    ui.end_row();
                }
            });
        }
    });
}
