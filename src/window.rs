//! What the cameras of a window and its HUD have to know of each other.

use bevy::camera::CameraOutputMode;
use bevy::prelude::*;
use bevy::render::render_resource::BlendState;
use keyhole_hud::{Guide, HudEye, hud_over_others};
use keyhole_view::eyes::WindowEye;

/// Lets the HUD keep clear of the inset, and draw where the one open camera has drawn, if it can.
pub struct WindowSharingPlugin;

impl Plugin for WindowSharingPlugin {
    fn build(&self, app: &mut App) {
        app.add_systems(PostUpdate, (leave_room, share_target));
    }
}

/// The guide stays beside the inset.
fn leave_room(mut guide: ResMut<Guide>, eyes: Query<(&Camera, &WindowEye)>) {
    let inset = eyes.iter().find(|(camera, eye)| camera.is_active && **eye == WindowEye::Inset);
    let taken_px = inset.and_then(|(camera, _)| camera.viewport.as_ref()).map_or(0, |v| v.physical_size.x);
    if guide.taken_px != taken_px {
        guide.taken_px = taken_px;
    }
}

/// Cameras of a window that take as many samples draw into one texture. Where that is so and one view is open, the HUD is drawn over it there, and the window is
/// written once. Otherwise each view is written to its part of the window, and the HUD over all of them.
fn share_target(
    mut eyes: Query<(&mut Camera, &Msaa), (With<WindowEye>, Without<HudEye>)>,
    mut hud: Query<(&mut Camera, &Msaa), With<HudEye>>,
) {
    let Ok((mut hud, hud_samples)) = hud.single_mut() else { return };
    let open = eyes.iter().filter(|(camera, _)| camera.is_active).count();
    let shared = open == 1 && eyes.iter().all(|(_, samples)| samples == hud_samples);
    let whole = CameraOutputMode::Write { blend_state: Some(BlendState::REPLACE), clear_color: ClearColorConfig::None };
    let (of_eyes, of_hud) = if shared { (CameraOutputMode::Skip, whole) } else { (CameraOutputMode::default(), hud_over_others()) };
    if matches!(hud.clear_color, ClearColorConfig::None) != shared {
        hud.clear_color = if shared { ClearColorConfig::None } else { ClearColorConfig::Custom(Color::NONE) };
        hud.output_mode = of_hud;
        eyes.iter_mut().for_each(|(mut camera, _)| camera.output_mode = of_eyes);
    }
}
