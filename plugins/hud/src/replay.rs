//! Where a recording that is played is.

use crate::guide::clock;
use crate::panel::ACTIVE;
use bevy::prelude::*;
use bevy_egui::egui::{self, Align2, Color32, ProgressBar, RichText};
use bevy_egui::{EguiContexts, PrimaryEguiContext};

/// Where a recording that is played is. There while one is. Filled in by the app.
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq)]
pub struct ReplayBar {
    /// Simulated time since its start, s.
    pub time_s: f64,
    /// How long it is, s.
    pub length_s: f64,
    /// The time that it is on the way to, s.
    pub goes_to_s: Option<f64>,
}

impl ReplayBar {
    /// What it says.
    #[must_use]
    pub fn text(&self) -> String {
        let now = format!("replay {} of {}", clock(self.time_s), clock(self.length_s));
        self.goes_to_s.map_or(now.clone(), |to_s| format!("{now}, on the way to {}", clock(to_s)))
    }

    /// The part of it that is over, 0 to 1.
    #[must_use]
    pub fn part(&self) -> f32 {
        if self.length_s > 0.0 { (self.time_s / self.length_s).clamp(0.0, 1.0) as f32 } else { 0.0 }
    }
}

/// Draws it at the upper edge.
pub fn draw_replay(mut contexts: EguiContexts, present: Query<(), With<PrimaryEguiContext>>, bar: Option<Res<ReplayBar>>) -> Result {
    let Some(bar) = bar.filter(|_| !present.is_empty()) else { return Ok(()) };
    egui::Area::new("replay".into()).anchor(Align2::CENTER_TOP, [0.0, 46.0]).show(contexts.ctx_mut()?, |ui| {
        let text = RichText::new(bar.text()).color(if bar.goes_to_s.is_some() { ACTIVE } else { Color32::WHITE });
        ui.add(ProgressBar::new(bar.part()).desired_width(420.0).fill(Color32::from_gray(90)).text(text));
    });
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_says_where_it_is_and_whereto_it_goes() {
        let bar = ReplayBar { time_s: 65.0, length_s: 130.0, goes_to_s: None };
        assert_eq!((bar.text().as_str(), bar.part()), ("replay 1:05.0 of 2:10.0", 0.5));
        let goes = ReplayBar { goes_to_s: Some(5.0), ..bar };
        assert!(goes.text().ends_with("on the way to 0:05.0"));
        assert_eq!(ReplayBar::default().part(), 0.0);
    }
}
