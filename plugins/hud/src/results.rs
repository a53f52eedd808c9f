//! The results of a session: the same tables as on the results page, beside what was resected in the colours of its margin.

use bevy::prelude::*;
use bevy_egui::egui::{self, Align2, Color32, RichText, Ui};
use bevy_egui::{EguiContexts, PrimaryEguiContext};

/// The results. F4 asks for them; the app takes the wish and fills in the sheet.
#[derive(Resource, Clone, Debug, Default, PartialEq)]
pub struct ResultsScreen {
    /// Whether the trainee has asked for them. Taken by the app.
    pub wanted: bool,
    /// What is shown; `None`: nothing. Set to `None` here to go back.
    pub sheet: Option<ResultSheet>,
    /// Whether the trainee has asked for the page to be saved. Taken by the app.
    pub save: bool,
}

/// What is shown.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ResultSheet {
    /// Name of the scene.
    pub scene: String,
    /// The tables.
    pub tables: Vec<ResultTable>,
    /// What the colours on the surface that was cut mean, with each colour in sRGB; empty when there are none.
    pub legend: Vec<([f32; 3], String)>,
    /// Where the page was saved, or why it was not.
    pub saved: Option<String>,
}

/// A table.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ResultTable {
    /// What it is about.
    pub title: String,
    /// Heads of the columns of figures; empty for a single column.
    pub heads: Vec<String>,
    /// Name, figures and unit of each row.
    pub rows: Vec<(String, Vec<String>, String)>,
}

/// F4 asks for the results, F4 or Escape shut them, F5 saves them.
pub fn result_keys(keys: Res<ButtonInput<KeyCode>>, mut results: ResMut<ResultsScreen>) {
    let shown = results.sheet.is_some();
    for key in keys.get_just_pressed() {
        match key {
            KeyCode::F4 if !shown => results.wanted = true,
            KeyCode::F4 if shown => results.sheet = None,
            KeyCode::F5 if shown => results.save = true,
            _ => {}
        }
    }
}

/// Draws the results.
pub fn draw_results(
    mut contexts: EguiContexts,
    present: Query<(), With<PrimaryEguiContext>>,
    mut results: ResMut<ResultsScreen>,
) -> Result {
    if present.is_empty() {
        return Ok(());
    }
    let Some(sheet) = &results.sheet else { return Ok(()) };
    let context = contexts.ctx_mut()?;
    let (mut shut, mut save) = (false, false);
    let tall = context.content_rect().height() - 110.0;
    egui::Window::new(format!("Results: {}", sheet.scene))
        .anchor(Align2::RIGHT_TOP, [-10.0, 10.0])
        .resizable(false)
        .collapsible(false)
        .default_width(400.0)
        .show(context, |ui| {
            ui.horizontal(|ui| {
                shut = ui.button("Back (F4)").clicked();
                save = ui.button("Save the page (F5)").clicked();
            });
            if let Some(saved) = &sheet.saved {
                ui.label(saved);
            }
            ui.separator();
            egui::ScrollArea::vertical().max_height(tall).show(ui, |ui| sheet.tables.iter().for_each(|table| show_table(ui, table)));
            ui.separator();
            for (colour, means) in &sheet.legend {
                let [r, g, b] = colour.map(|c| (c * 255.0) as u8);
                ui.horizontal(|ui| {
                    let (place, _) = ui.allocate_exact_size(egui::vec2(18.0, 12.0), egui::Sense::hover());
                    ui.painter().rect_filled(place, 2.0, Color32::from_rgb(r, g, b));
                    ui.label(means);
                });
            }
        });
    results.save |= save;
    if shut {
        results.sheet = None;
    }
    Ok(())
}

fn show_table(ui: &mut Ui, table: &ResultTable) {
    ui.label(RichText::new(&table.title).strong());
    egui::Grid::new(&table.title).num_columns(2 + table.heads.len().max(1)).spacing([14.0, 3.0]).striped(true).show(ui, |ui| {
        if !table.heads.is_empty() {
            ui.label("");
            table.heads.iter().for_each(|head| {
                ui.label(RichText::new(head).color(Color32::from_gray(150)));
            });
            ui.end_row();
        }
        for (name, figures, unit) in &table.rows {
            ui.label(name);
            figures.iter().for_each(|figure| {
                ui.monospace(figure);
            });
            ui.label(RichText::new(unit).color(Color32::from_gray(150)));
            ui.end_row();
        }
    });
    ui.add_space(6.0);
}
