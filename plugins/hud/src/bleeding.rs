//! Clips and blood on the HUD: a line at the lower edge, where there are vessels or clips.

use bevy::prelude::*;
use bevy_egui::egui::{self, Align2, Color32, RichText};
use bevy_egui::{EguiContexts, PrimaryEguiContext};
use keyhole_whiteboard::{BleedReport, ClipApplier, ClipReport, SceneRequirements};

const WARNING: Color32 = Color32::from_rgb(255, 90, 70);
const QUIET: Color32 = Color32::from_gray(200);

/// The line, and whether something is wrong. `left` are the clips in the cartridge, where there is one.
fn line(left: Option<u32>, clips: &ClipReport, bleeding: &BleedReport) -> (String, bool) {
    let mut parts = Vec::new();
    if let Some(left) = left {
        parts.push(format!("clips: {} set, {left} left", clips.set));
    }
    for (count, what) in [(clips.misplaced, "misplaced"), (clips.dropped, "dropped"), (clips.slipped, "slipped off")] {
        if count > 0 {
            parts.push(format!("{count} {what}"));
        }
    }
    if bleeding.rate_ml_min > 0.0 {
        parts.push(format!("bleeding {:.0} ml/min", bleeding.rate_ml_min));
    }
    parts.push(format!("blood lost {:.1} ml", bleeding.lost_ml));
    if bleeding.aspirated_ml > 0.0 {
        parts.push(format!("aspirated {:.1} ml", bleeding.aspirated_ml));
    }
    let wrong = clips.misplaced + clips.dropped + clips.slipped > 0 || bleeding.rate_ml_min > 0.0;
    (parts.join("   "), wrong)
}

/// Draws the line, above the guide. While there is no context, nothing.
pub fn draw_bleeding(
    mut contexts: EguiContexts,
    present: Query<(), With<PrimaryEguiContext>>,
    requirements: Res<SceneRequirements>,
    clips: Res<ClipReport>,
    bleeding: Res<BleedReport>,
    appliers: Query<&ClipApplier>,
) -> Result {
    if present.is_empty() || !requirements.clipping {
        return Ok(());
    }
    let (text, wrong) = line(appliers.iter().map(|a| a.clips).reduce(|a, b| a + b), &clips, &bleeding);
    egui::Area::new("bleeding".into()).anchor(Align2::CENTER_BOTTOM, [0.0, -84.0]).show(contexts.ctx_mut()?, |ui| {
        let colour = if wrong { WARNING } else { QUIET };
        ui.label(RichText::new(text).size(16.0).color(colour).background_color(Color32::from_black_alpha(160)));
    });
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_wrong_is_said_and_what_is_not_is_left_out() {
        let (clips, bleeding) = (ClipReport { set: 2, ..default() }, BleedReport::default());
        assert_eq!(line(Some(6), &clips, &bleeding), ("clips: 2 set, 6 left   blood lost 0.0 ml".into(), false));
        let (clips, bleeding) = (ClipReport { misplaced: 1, ..clips }, BleedReport { rate_ml_min: 147.6, lost_ml: 3.21, ..default() });
        let wrong = "clips: 2 set, 6 left   1 misplaced   bleeding 148 ml/min   blood lost 3.2 ml";
        assert_eq!(line(Some(6), &clips, &bleeding), (wrong.into(), true));
        assert_eq!(line(None, &ClipReport::default(), &BleedReport::default()).0, "blood lost 0.0 ml");
        let bleeding = BleedReport { lost_ml: 3.21, aspirated_ml: 3.04, ..default() };
        assert_eq!(line(None, &ClipReport::default(), &bleeding), ("blood lost 3.2 ml   aspirated 3.0 ml".into(), false));
    }
}
