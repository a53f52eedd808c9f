//! The panel.

use crate::devices::show_devices;
use crate::figures::{MeshFigures, milliseconds, stages};
use crate::help::show_help;
use crate::intent::{HudState, Intent};
use crate::start::StartScreen;
use crate::tools::{Tool, show_tools};
use bevy::prelude::*;
use bevy_egui::egui::{self, Align2, Color32, RichText, Ui};
use bevy_egui::{EguiContexts, PrimaryEguiContext};
use keyhole_whiteboard::{
    CutMethod, CutPattern, CutSettings, CutStatus, DeviceStatus, HandInput, KeyMap, SimulationControl, TickCost, ViewMode,
};

pub(crate) const ACTIVE: Color32 = Color32::from_rgb(255, 160, 60);
pub(crate) const QUIET: Color32 = Color32::from_gray(150);

/// Length of a tick at 60 Hz, ms: what a tick may cost.
const TICK_MS: f64 = 1000.0 / 60.0;

/// Draws the HUD. While there is no context (no window yet), nothing.
pub fn draw_hud(
    mut contexts: EguiContexts,
    present: Query<(), With<PrimaryEguiContext>>,
    state: Res<HudState>,
    mut intent: ResMut<Intent>,
    view: Res<ViewMode>,
    control: Res<SimulationControl>,
    cutting: Res<CutSettings>,
    status: Res<CutStatus>,
    cost: Res<TickCost>,
    meshes: Res<MeshFigures>,
    keys: Res<KeyMap>,
    devices: Res<DeviceStatus>,
    start: Res<StartScreen>,
    (time, mut frame_s): (Res<Time<Real>>, Local<f32>),
    instruments: Query<Tool>,
    input: Option<Res<HandInput>>,
) -> Result {
    // A mean over the last frames: half of it is of the last fourteen.
    *frame_s += 0.05 * (time.delta_secs() - *frame_s);
    if present.is_empty() {
        return Ok(());
    }
    let context = contexts.ctx_mut()?;
    if state.panel && !start.open {
        egui::Window::new("Keyhole").anchor(Align2::LEFT_TOP, [10.0, 10.0]).resizable(false).default_width(258.0).show(context, |ui| {
            show_control(ui, &mut intent, *view, &control);
            ui.separator();
            show_cutting(ui, &mut intent, &cutting, &status);
            ui.separator();
            show_meshes(ui, &meshes, &status);
            ui.separator();
            show_cost(ui, &cost, *frame_s);
            if !instruments.is_empty() {
                ui.separator();
                show_tools(ui, instruments.iter(), input.as_ref().map(|input| input.active));
            }
            ui.label(RichText::new("F1 hands and keys   F2 hide").color(QUIET).small());
        });
    }
    show_devices(context, &devices, state.panel);
    if state.keys {
        show_help(context, &keys);
    }
    if control.paused && !start.open {
        egui::Area::new("paused".into()).anchor(Align2::CENTER_TOP, [0.0, 12.0]).show(context, |ui| {
            ui.label(RichText::new("PAUSED").size(22.0).strong().color(ACTIVE).background_color(Color32::from_black_alpha(160)));
        });
    }
    Ok(())
}

fn show_control(ui: &mut Ui, intent: &mut Intent, view: ViewMode, control: &SimulationControl) {
    ui.horizontal(|ui| {
        for (mode, name) in [(ViewMode::Global, "Global"), (ViewMode::Laparoscopic, "Laparoscopic")] {
            if ui.selectable_label(view == mode, name).clicked() {
                intent.view = Some(mode);
            }
        }
    });
    ui.horizontal(|ui| {
        if ui.button(if control.paused { "Go on" } else { "Pause" }).clicked() {
            intent.paused = Some(!control.paused);
        }
        if ui.button("Step").clicked() {
            intent.step = true;
        }
        if ui.button("Reset").clicked() {
            intent.reset = true;
        }
    });
    ui.horizontal(|ui| {
        for (demonstration, name) in [(true, "Demonstration"), (false, "Own hands")] {
            if ui.selectable_label(control.demonstration == demonstration, name).clicked() {
                intent.demonstration = Some(demonstration);
            }
        }
    });
}

fn show_cutting(ui: &mut Ui, intent: &mut Intent, now: &CutSettings, status: &CutStatus) {
    let mut wanted = intent.cutting.unwrap_or(*now);
    egui::Grid::new("cutting").num_columns(2).spacing([10.0, 4.0]).show(ui, |ui| {
        ui.label("Method");
        let method = |m| match m {
            CutMethod::Hybrid => "hybrid",
            CutMethod::Progressive => "progressive",
            CutMethod::NonProgressive => "non-progressive",
        };
        egui::ComboBox::from_id_salt("method").selected_text(method(wanted.method)).show_ui(ui, |ui| {
            for m in [CutMethod::Hybrid, CutMethod::Progressive, CutMethod::NonProgressive] {
                ui.selectable_value(&mut wanted.method, m, method(m));
            }
        });
        ui.end_row();
        for (name, pattern) in [("Hull pattern", &mut wanted.hull), ("Core pattern", &mut wanted.core)] {
            ui.label(name);
            ui.horizontal(|ui| {
                ui.selectable_value(pattern, CutPattern::Minimal, "minimal");
                ui.selectable_value(pattern, CutPattern::Symmetric, "symmetric");
            });
            ui.end_row();
        }
        ui.label("Snap");
        ui.add(egui::Slider::new(&mut wanted.snap, 0.0..=0.4).fixed_decimals(2));
        ui.end_row();
    });
    if wanted != *now {
        intent.cutting = Some(wanted);
    }
    if status.cutting {
        ui.label(RichText::new("cutting").color(ACTIVE));
    } else {
        ui.label(RichText::new(format!("{} strokes; settings hold from the next one", status.strokes)).color(QUIET).small());
    }
}

fn show_meshes(ui: &mut Ui, meshes: &MeshFigures, status: &CutStatus) {
    egui::Grid::new("meshes").num_columns(4).spacing([10.0, 2.0]).show(ui, |ui| {
        let rows = [
            [("tets", meshes.tets as u64), ("nodes", meshes.nodes as u64)],
            [("organs", meshes.organs as u64), ("fragments", meshes.fragments as u64)],
            [("deleted", status.deleted), ("created", status.created)],
            [("updated", status.updated), ("deferred", status.deferred)],
        ];
        for row in rows {
            for (name, value) in row {
                ui.label(RichText::new(name).color(QUIET));
                ui.monospace(format!("{value:>7}"));
            }
            ui.end_row();
        }
    });
}

fn show_cost(ui: &mut Ui, cost: &TickCost, frame_s: f32) {
    let last = milliseconds(cost.last_tick());
    let colour = if last > TICK_MS { ACTIVE } else { Color32::from_gray(210) };
    ui.label(RichText::new(format!("tick {last:6.2} ms of {TICK_MS:.1}, {} ticks", cost.ticks)).color(colour));
    if frame_s > 0.0 {
        ui.label(RichText::new(format!("frame {:6.1} ms, {:.1} a second", 1e3 * frame_s, frame_s.recip())).color(QUIET));
    }
    egui::Grid::new("cost").num_columns(4).spacing([10.0, 1.0]).show(ui, |ui| {
        ui.label("");
        for head in ["last", "mean", "max ms"] {
            ui.label(RichText::new(head).color(QUIET).small());
        }
        ui.end_row();
        for stage in stages(cost) {
            ui.label(format!("{:?}", stage.stage));
            for value in [stage.last_ms, stage.mean_ms, stage.max_ms] {
                ui.monospace(format!("{value:6.2}"));
            }
            ui.end_row();
        }
    });
}
