//! The start screen: the scenes that there are, with their pictures, and the settings that a scene is begun with. By mouse or by keyboard alone.

use crate::costs::{Choice, choices};
use bevy::asset::RenderAssetUsages;
use bevy::image::{CompressedImageFormats, Image, ImageSampler, ImageType};
use bevy::prelude::*;
use bevy_egui::egui::{self, Align2, Color32, RichText, Ui};
use bevy_egui::{EguiContexts, EguiTextureHandle, PrimaryEguiContext};
use keyhole_whiteboard::{CutMethod, SimulationControl};
use std::path::PathBuf;

/// A scene on the start screen.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SceneCard {
    /// Its file.
    pub path: PathBuf,
    /// Its name.
    pub name: String,
    /// What it is for.
    pub description: String,
    /// A picture of it, as the bytes of a PNG.
    pub picture: Option<Vec<u8>>,
    /// Why it cannot be played.
    pub problem: Option<String>,
}

/// The start screen. The app fills in the scenes, and takes [`StartScreen::wanted`].
#[derive(Resource, Clone, Debug, Default)]
pub struct StartScreen {
    /// Whether it is shown. Meanwhile the simulation is paused.
    pub open: bool,
    /// Whether it may be opened at all: not while a recording is made or played, which is of one scene.
    pub locked: bool,
    /// The scenes.
    pub scenes: Vec<SceneCard>,
    /// Which of them is chosen.
    pub chosen: usize,
    /// The method of cutting; `None`: the scene's.
    pub method: Option<CutMethod>,
    /// The quality, by its place in the file of costs; 0: as the scene says.
    pub quality: usize,
    /// The scene to begin, by its place. Set here, taken by the app.
    pub wanted: Option<usize>,
    /// Whether the simulation stood when the screen was opened.
    was_paused: bool,
    /// Whether a key has moved the choice, which is to be brought into sight.
    moved: bool,
}

/// The pictures of the scenes as egui has them.
#[derive(Resource, Default)]
pub struct Thumbnails(Vec<Option<(egui::TextureId, Handle<Image>)>>);

impl StartScreen {
    /// Opens it, and pauses the simulation.
    pub fn show(&mut self, control: &mut SimulationControl) {
        if !self.open && !self.locked {
            (self.open, self.was_paused) = (true, control.paused);
            control.paused = true;
        }
    }

    /// Shuts it, and goes on where the simulation stood.
    pub fn hide(&mut self, control: &mut SimulationControl) {
        if self.open {
            self.open = false;
            control.paused = self.was_paused;
        }
    }

    /// The method that comes after this one.
    fn next_method(&self) -> Option<CutMethod> {
        match self.method {
            None => Some(CutMethod::Hybrid),
            Some(CutMethod::Hybrid) => Some(CutMethod::Progressive),
            Some(CutMethod::Progressive) => Some(CutMethod::NonProgressive),
            Some(CutMethod::NonProgressive) => None,
        }
    }

    /// What a key does while the screen is shown.
    fn press(&mut self, key: KeyCode, control: &mut SimulationControl) {
        let last = self.scenes.len().saturating_sub(1);
        self.moved |= matches!(key, KeyCode::ArrowDown | KeyCode::ArrowUp);
        match key {
            KeyCode::ArrowDown => self.chosen = (self.chosen + 1).min(last),
            KeyCode::ArrowUp => self.chosen = self.chosen.saturating_sub(1),
            KeyCode::KeyM => self.method = self.next_method(),
            KeyCode::KeyQ => self.quality = (self.quality + 1) % choices("quality").count().max(1),
            KeyCode::Enter | KeyCode::NumpadEnter => self.wanted = Some(self.chosen).filter(|i| *i < self.scenes.len()),
            KeyCode::Escape => self.hide(control),
            _ => {}
        }
    }
}

/// Escape opens the screen; while it is shown the keys are its own.
pub fn start_keys(keys: Res<ButtonInput<KeyCode>>, mut start: ResMut<StartScreen>, mut control: ResMut<SimulationControl>) {
    for key in keys.get_just_pressed() {
        if start.open {
            start.press(*key, &mut control);
        } else if *key == KeyCode::Escape {
            start.show(&mut control);
        }
    }
}

/// Draws the screen.
pub fn draw_start(
    mut contexts: EguiContexts,
    present: Query<(), With<PrimaryEguiContext>>,
    mut start: ResMut<StartScreen>,
    mut thumbnails: ResMut<Thumbnails>,
    mut images: ResMut<Assets<Image>>,
    mut control: ResMut<SimulationControl>,
) -> Result {
    if present.is_empty() || !start.open {
        return Ok(());
    }
    for card in start.scenes.iter().skip(thumbnails.0.len()) {
        let image = card.picture.as_deref().and_then(decode).map(|image| images.add(image));
        thumbnails.0.push(image.map(|handle| (contexts.add_image(EguiTextureHandle::Strong(handle.clone())), handle)));
    }
    let context = contexts.ctx_mut()?;
    let moved = std::mem::take(&mut start.moved);
    let screen = context.content_rect();
    let window = egui::Window::new("Scenes").anchor(Align2::CENTER_CENTER, [0.0, 0.0]).resizable(false).collapsible(false);
    let size = egui::vec2((screen.width() - 60.0).min(860.0), (screen.height() - 90.0).min(590.0));
    window.fixed_size(size).show(context, |ui| {
        ui.set_min_size(size);
        let list = size.y - 190.0;
        egui::ScrollArea::vertical().max_height(list).min_scrolled_height(list).auto_shrink([false, false]).show(ui, |ui| {
            for i in 0..start.scenes.len() {
                let picture = thumbnails.0.get(i).and_then(|t| t.as_ref().map(|(id, _)| *id));
                let response = show_card(ui, &start.scenes[i], i == start.chosen, picture);
                if moved && i == start.chosen {
                    response.scroll_to_me(None);
                }
                if response.clicked() {
                    if start.chosen == i {
                        start.wanted = Some(i);
                    }
                    start.chosen = i;
                }
            }
        });
        ui.separator();
        show_settings(ui, &mut start);
        ui.separator();
        ui.horizontal(|ui| {
            if ui.button(RichText::new("Begin (Enter)").strong()).clicked() {
                start.wanted = Some(start.chosen).filter(|i| *i < start.scenes.len());
            }
            if ui.button("Back (Esc)").clicked() {
                start.hide(&mut control);
            }
            ui.label(RichText::new("Up, Down: scene   M: method   Q: quality   F1: every key").color(Color32::from_gray(160)));
        });
    });
    Ok(())
}

fn show_card(ui: &mut Ui, card: &SceneCard, chosen: bool, picture: Option<egui::TextureId>) -> egui::Response {
    let fill = if chosen { Color32::from_rgb(0, 62, 92) } else { Color32::from_gray(34) };
    let frame = egui::Frame::new().fill(fill).inner_margin(8.0).corner_radius(4.0);
    let shown = frame.show(ui, |ui| {
        ui.set_min_width(ui.available_width());
        ui.horizontal(|ui| {
            let size = egui::vec2(160.0, 90.0);
            match picture {
                Some(id) => {
                    ui.image((id, size));
                }
                None => {
                    ui.allocate_exact_size(size, egui::Sense::hover());
                }
            }
            ui.vertical(|ui| {
                ui.label(RichText::new(&card.name).size(18.0).strong().color(Color32::WHITE));
                ui.label(RichText::new(&card.description).color(Color32::from_gray(205)));
                if let Some(problem) = &card.problem {
                    ui.label(RichText::new(problem).color(Color32::from_rgb(255, 160, 60)));
                }
            });
        });
    });
    shown.response.interact(egui::Sense::click())
}

fn show_settings(ui: &mut Ui, start: &mut StartScreen) {
    let by_scene =
        Choice { kind: "method", name: "as the scene says", accuracy: "the scene's own method", cost: "its own", source: "the scene" };
    let methods: Vec<Choice> = std::iter::once(by_scene).chain(choices("method")).collect();
    let qualities: Vec<Choice> = choices("quality").collect();
    let now = match start.method {
        None => 0,
        Some(CutMethod::Hybrid) => 1,
        Some(CutMethod::Progressive) => 2,
        Some(CutMethod::NonProgressive) => 3,
    };
    if let Some(chosen) = show_choice(ui, "Cutting", &methods, now) {
        start.method = [None, Some(CutMethod::Hybrid), Some(CutMethod::Progressive), Some(CutMethod::NonProgressive)][chosen];
    }
    if let Some(chosen) = show_choice(ui, "Tissue", &qualities, start.quality) {
        start.quality = chosen;
    }
}

fn show_choice(ui: &mut Ui, title: &str, all: &[Choice], now: usize) -> Option<usize> {
    let mut chosen = None;
    ui.horizontal(|ui| {
        ui.label(RichText::new(title).strong());
        for (i, choice) in all.iter().enumerate() {
            if ui.selectable_label(i == now, choice.name).clicked() {
                chosen = Some(i);
            }
        }
    });
    if let Some(choice) = all.get(now) {
        ui.label(format!("Accuracy: {}. Cost: {}.", choice.accuracy, choice.cost));
        ui.label(RichText::new(format!("From: {}", choice.source)).small().color(Color32::from_gray(150)));
    }
    chosen
}

fn decode(png: &[u8]) -> Option<Image> {
    let (kind, formats) = (ImageType::Extension("png"), CompressedImageFormats::NONE);
    Image::from_buffer(png, kind, formats, true, ImageSampler::Default, RenderAssetUsages::default()).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The whole screen by keyboard: opened, another scene and other settings chosen, begun; and shut again without a change of the pause.
    #[test]
    fn the_screen_is_worked_by_keys_alone() {
        let mut app = App::new();
        let cards = ["one", "two"].map(|name| SceneCard { name: name.into(), ..default() });
        app.insert_resource(StartScreen { scenes: cards.into(), ..default() })
            .init_resource::<ButtonInput<KeyCode>>()
            .init_resource::<SimulationControl>()
            .add_systems(Update, start_keys);
        let mut press = |key| {
            app.world_mut().resource_mut::<ButtonInput<KeyCode>>().reset_all();
            app.world_mut().resource_mut::<ButtonInput<KeyCode>>().press(key);
            app.update();
            (app.world().resource::<StartScreen>().clone(), app.world().resource::<SimulationControl>().paused)
        };
        let (start, paused) = press(KeyCode::Escape);
        assert!(start.open && paused);
        for _ in 0..3 {
            press(KeyCode::ArrowDown);
        }
        press(KeyCode::KeyM);
        press(KeyCode::KeyQ);
        let (start, _) = press(KeyCode::Enter);
        assert_eq!((start.wanted, start.method, start.quality), (Some(1), Some(CutMethod::Hybrid), 1));
        let (start, paused) = press(KeyCode::Escape);
        assert!(!start.open && !paused);
        let mut locked = StartScreen { locked: true, ..default() };
        locked.show(&mut SimulationControl::default());
        assert!(!locked.open);
    }
}
