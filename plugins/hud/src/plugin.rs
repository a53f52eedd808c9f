//! The plugin of the HUD.

use crate::bleeding::draw_bleeding;
use crate::figures::{MeshFigures, count};
use crate::guide::{Guide, Notices, draw_guide, guide_keys};
use crate::intent::{HudState, Intent, KEYS, carry_out, read_keys};
use crate::panel::draw_hud;
use crate::replay::draw_replay;
use crate::results::{ResultsScreen, draw_results, result_keys};
use crate::start::{StartScreen, Thumbnails, draw_start, start_keys};
use bevy::camera::CameraOutputMode;
use bevy::camera::visibility::RenderLayers;
use bevy::input::InputSystems;
use bevy::prelude::*;
use bevy::render::render_resource::BlendState;
use bevy::window::PrimaryWindow;
use bevy_egui::input::EguiWantsInput;
use bevy_egui::{EguiContexts, EguiGlobalSettings, EguiPlugin, EguiPrimaryContextPass, PrimaryEguiContext};
use keyhole_whiteboard::{KeyMap, PointerClaims};

/// The HUD of the window. Needs `DefaultPlugins` with a window, and the whiteboard before it.
pub struct HudPlugin;

impl Plugin for HudPlugin {
    fn build(&self, app: &mut App) {
        if !app.is_plugin_added::<EguiPlugin>() {
            app.add_plugins(EguiPlugin::default());
        }
        // The first camera of all is the one that takes pictures; the HUD has its own.
        app.insert_resource(EguiGlobalSettings { auto_create_primary_context: false, ..default() });
        app.init_resource::<KeyMap>().world_mut().resource_mut::<KeyMap>().push_all(&KEYS);
        app.init_resource::<HudState>()
            .init_resource::<Intent>()
            .init_resource::<MeshFigures>()
            .init_resource::<PointerClaims>()
            .add_systems(Startup, open_hud_eye)
            .add_systems(PreUpdate, (read_keys, carry_out, claim_pointer).chain().after(InputSystems))
            .add_systems(Update, count)
            .add_systems(
                EguiPrimaryContextPass,
                (suit_window, draw_hud, draw_bleeding, draw_guide, draw_replay, draw_results, draw_start).chain(),
            );
        app.init_resource::<StartScreen>()
            .init_resource::<Thumbnails>()
            .init_resource::<ResultsScreen>()
            .init_resource::<Guide>()
            .init_resource::<Notices>()
            .add_systems(PreUpdate, (guide_keys, result_keys, start_keys).chain().after(InputSystems).before(read_keys));
    }
}

/// The camera of the HUD.
#[derive(Component, Clone, Copy, Debug)]
pub struct HudEye;

/// A camera for the HUD alone, over all others of the window: each of them may have but a part of it.
fn open_hud_eye(mut commands: Commands, windows: Query<(), With<PrimaryWindow>>) {
    if windows.is_empty() {
        return;
    }
    let camera = Camera { order: 100, clear_color: ClearColorConfig::Custom(Color::NONE), output_mode: hud_over_others(), ..default() };
    // It sees nothing but the HUD.
    commands.spawn((Name::new("HUD eye"), HudEye, Camera2d, camera, Msaa::Off, RenderLayers::none(), PrimaryEguiContext));
}

/// How what the HUD's camera has drawn comes over what the others have.
#[must_use]
pub fn hud_over_others() -> CameraOutputMode {
    CameraOutputMode::Write { blend_state: Some(BlendState::PREMULTIPLIED_ALPHA_BLENDING), clear_color: ClearColorConfig::None }
}

/// Height of a window in which the HUD has its own size, pixels: in a larger one it is drawn larger, so that it is as readable.
const WINDOW_HEIGHT: f32 = 720.0;

/// How many times its own size the HUD is drawn in a window of that height, pixels: in eighths, so that letters stay sharp.
fn size_in(window_height: f32) -> f32 {
    ((window_height / WINDOW_HEIGHT * 8.0).round() / 8.0).clamp(0.75, 6.0)
}

/// Draws the HUD as large as the window is high.
fn suit_window(mut contexts: EguiContexts, windows: Query<&Window, With<PrimaryWindow>>) -> Result {
    let Ok(window) = windows.single() else { return Ok(()) };
    let Ok(context) = contexts.ctx_mut() else { return Ok(()) };
    let wanted = size_in(window.height());
    if context.zoom_factor() != wanted {
        context.set_zoom_factor(wanted);
    }
    Ok(())
}

fn claim_pointer(wants: Option<Res<EguiWantsInput>>, start: Res<StartScreen>, mut claims: ResMut<PointerClaims>) {
    claims.hud = start.open || wants.is_some_and(|w| w.wants_any_pointer_input());
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As large on every screen: an own size at 720 lines, three times that at 2160; and never too small to be read.
    #[test]
    fn the_hud_is_as_large_as_its_window() {
        let sizes =
            [(720.0, 1.0), (800.0, 1.125), (1080.0, 1.5), (1440.0, 2.0), (2160.0, 3.0), (4320.0, 6.0), (240.0, 0.75), (9000.0, 6.0)];
        sizes.into_iter().for_each(|(height, size)| assert_eq!(size_in(height), size, "{height}"));
    }
}
