//! The plugin of the HUD.

use crate::bleeding::draw_bleeding;
use crate::figures::{MeshFigures, count};
use crate::intent::{HudState, Intent, KEYS, carry_out, read_keys};
use crate::panel::draw_hud;
use bevy::camera::RenderTarget;
use bevy::input::InputSystems;
use bevy::prelude::*;
use bevy_egui::input::EguiWantsInput;
use bevy_egui::{EguiGlobalSettings, EguiPlugin, EguiPrimaryContextPass, PrimaryEguiContext};
use keyhole_whiteboard::{KeyMap, PointerClaims};

/// The HUD on the first camera that draws into a window. Needs `DefaultPlugins` with a window, and the whiteboard before it.
pub struct HudPlugin;

impl Plugin for HudPlugin {
    fn build(&self, app: &mut App) {
        if !app.is_plugin_added::<EguiPlugin>() {
            app.add_plugins(EguiPlugin::default());
        }
        // The first camera of all is the one that takes pictures; the HUD is for the window's.
        app.insert_resource(EguiGlobalSettings { auto_create_primary_context: false, ..default() });
        app.init_resource::<KeyMap>().world_mut().resource_mut::<KeyMap>().push_all(&KEYS);
        app.init_resource::<HudState>()
            .init_resource::<Intent>()
            .init_resource::<MeshFigures>()
            .init_resource::<PointerClaims>()
            .add_systems(PreUpdate, (read_keys, carry_out, claim_pointer).chain().after(InputSystems))
            .add_systems(Update, (count, take_window_camera))
            .add_systems(EguiPrimaryContextPass, (draw_hud, draw_bleeding).chain());
    }
}

/// Puts the HUD on the first camera that draws into a window.
fn take_window_camera(
    mut commands: Commands,
    cameras: Query<(Entity, &RenderTarget), (With<Camera>, Without<PrimaryEguiContext>)>,
    taken: Query<(), With<PrimaryEguiContext>>,
) {
    if !taken.is_empty() {
        return;
    }
    if let Some((camera, _)) = cameras.iter().find(|(_, target)| matches!(target, RenderTarget::Window(_))) {
        commands.entity(camera).insert(PrimaryEguiContext);
    }
}

fn claim_pointer(wants: Option<Res<EguiWantsInput>>, mut claims: ResMut<PointerClaims>) {
    claims.hud = wants.is_some_and(|w| w.wants_any_pointer_input());
}
