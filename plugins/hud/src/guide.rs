//! What the trainee is to do, how long it has taken and what has gone wrong so far; and what the app has to say while it plays.

use crate::start::StartScreen;
use bevy::prelude::*;
use bevy_egui::egui::{self, Align2, Color32, RichText};
use bevy_egui::{EguiContexts, PrimaryEguiContext};

/// What is done.
const DONE: Color32 = Color32::from_rgb(90, 210, 130);

/// The task. Filled in by the app.
#[derive(Resource, Clone, Debug, Default, PartialEq)]
pub struct Guide {
    /// What is to be done, step by step. Page Down and Page Up go through them.
    pub steps: Vec<String>,
    /// Which step the trainee is at.
    pub step: usize,
    /// Of each step whether its goals are met; `None` for one without goals. Steps beyond the end have none.
    pub done: Vec<Option<bool>>,
    /// Since when the whole task is done, s since the scene began.
    pub finished_s: Option<f64>,
    /// Simulated time since the scene began, s.
    pub time_s: f64,
    /// What has gone wrong: what it is, and how much of it with its unit. Only what is not nothing.
    pub errors: Vec<(String, String)>,
    /// Whether it is hidden. F3.
    pub hidden: bool,
    /// How much of the window's lower edge has something else on it, from the right, pixels.
    pub taken_px: u32,
}

impl Guide {
    /// Takes which steps are done. When the one that the trainee is at comes to be done, or one after it with nothing undone between, the next that is not is shown.
    pub fn tick_off(&mut self, done: Vec<Option<bool>>) {
        let is = |done: &[Option<bool>], step: usize| done.get(step).copied().flatten() == Some(true);
        let within_reach = (self.step..self.steps.len()).take_while(|step| done.get(*step).copied().flatten() != Some(false));
        if let Some(came) = within_reach.filter(|step| is(&done, *step) && !is(&self.done, *step)).last() {
            let next = (came + 1..self.steps.len()).find(|step| !is(&done, *step));
            self.step = next.unwrap_or(came);
        }
        self.done = done;
    }

    /// How many steps are done, of how many that have goals; `None` where none has.
    #[must_use]
    pub fn progress(&self) -> Option<(usize, usize)> {
        let with_goals = self.done.iter().flatten();
        let all = with_goals.clone().count();
        (all > 0).then(|| (with_goals.filter(|done| **done).count(), all))
    }
}

/// What the app has to say: problems of a scene's file that was changed, for one. Empty: nothing.
#[derive(Resource, Clone, Debug, Default, PartialEq)]
pub struct Notices(pub Vec<String>);

/// F3 hides the guide, Page Down and Page Up go through its steps.
pub fn guide_keys(keys: Res<ButtonInput<KeyCode>>, mut guide: ResMut<Guide>) {
    for key in keys.get_just_pressed() {
        match key {
            KeyCode::F3 => guide.hidden = !guide.hidden,
            KeyCode::PageDown => guide.step = (guide.step + 1).min(guide.steps.len().saturating_sub(1)),
            KeyCode::PageUp => guide.step = guide.step.saturating_sub(1),
            _ => {}
        }
    }
}

/// Minutes, seconds and tenths.
#[must_use]
pub fn clock(seconds: f64) -> String {
    let tenths = (seconds.max(0.0) * 10.0).floor() as u64;
    format!("{}:{:02}.{}", tenths / 600, tenths / 10 % 60, tenths % 10)
}

/// Draws both.
pub fn draw_guide(
    mut contexts: EguiContexts,
    present: Query<(), With<PrimaryEguiContext>>,
    guide: Res<Guide>,
    notices: Res<Notices>,
    start: Res<StartScreen>,
) -> Result {
    if present.is_empty() {
        return Ok(());
    }
    let context = contexts.ctx_mut()?;
    let back = egui::Frame::new().fill(Color32::from_black_alpha(170)).inner_margin(8.0).corner_radius(4.0);
    if !guide.hidden && !start.open {
        let taken = guide.taken_px as f32 / context.pixels_per_point();
        let room = context.content_rect().width() - taken - 36.0;
        egui::Area::new("guide".into()).anchor(Align2::CENTER_BOTTOM, [-0.5 * taken, -10.0]).show(context, |ui| {
            ui.set_max_width(room);
            back.show(ui, |ui| {
                ui.horizontal_wrapped(|ui| {
                    ui.label(RichText::new(clock(guide.time_s)).monospace().size(18.0).color(Color32::WHITE));
                    if let Some(step) = guide.steps.get(guide.step) {
                        let place = format!("{} of {}:", guide.step + 1, guide.steps.len());
                        ui.label(RichText::new(place).color(Color32::from_gray(160)));
                        ui.label(RichText::new(step).color(Color32::WHITE));
                        if guide.done.get(guide.step) == Some(&Some(true)) {
                            ui.label(RichText::new("done").strong().color(DONE));
                        }
                    }
                    if let Some(finished_s) = guide.finished_s {
                        ui.label(RichText::new(format!("The task is done: {}", clock(finished_s))).strong().color(DONE));
                    } else if let Some((done, all)) = guide.progress() {
                        ui.label(RichText::new(format!("{done}/{all} done")).color(DONE));
                    }
                    for (what, amount) in &guide.errors {
                        ui.label(RichText::new(format!("{what} {amount}")).color(Color32::from_rgb(255, 160, 60)));
                    }
                });
            });
        });
    }
    if !notices.0.is_empty() {
        egui::Area::new("notices".into()).anchor(Align2::LEFT_BOTTOM, [10.0, -60.0]).show(context, |ui| {
            ui.set_max_width(640.0);
            back.show(ui, |ui| {
                notices.0.iter().for_each(|notice| {
                    ui.label(RichText::new(notice).color(Color32::from_rgb(255, 190, 110)));
                });
            });
        });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A step that comes to be done gives way to the next that is not; one that the trainee went back to stays.
    #[test]
    fn steps_are_ticked_off() {
        let mut guide = Guide { steps: ["a", "b", "c"].map(String::from).into(), ..Guide::default() };
        guide.tick_off(vec![Some(false), Some(true), None]);
        assert_eq!((guide.step, guide.progress()), (0, Some((1, 2))));
        guide.tick_off(vec![Some(true), Some(true), None]);
        assert_eq!((guide.step, guide.progress()), (2, Some((2, 2))));
        guide.step = 1;
        guide.tick_off(vec![Some(true), Some(true), None]);
        assert_eq!(guide.step, 1);
        guide.tick_off(vec![Some(false), Some(false), None]);
        assert_eq!((guide.step, guide.progress()), (1, Some((0, 2))));
        // A step without goals is done with what comes after it.
        let mut guide = Guide { steps: ["a", "b", "c"].map(String::from).into(), ..Guide::default() };
        guide.tick_off(vec![None, Some(false), Some(false)]);
        guide.tick_off(vec![None, Some(true), Some(false)]);
        assert_eq!(guide.step, 2);
    }

    #[test]
    fn clocks() {
        let times = [(0.0, "0:00.0"), (9.99, "0:09.9"), (61.25, "1:01.2"), (3600.0, "60:00.0"), (-1.0, "0:00.0")];
        times.into_iter().for_each(|(s, text)| assert_eq!(clock(s), text));
    }
}
