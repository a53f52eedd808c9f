//! The plugin of the HUD.

use crate::figures::{MeshFigures, count};
use crate::intent::{HudState, Intent, KEYS, carry_out, read_keys};
use crate::panel::draw_hud;
use bevy::camera::CameraOutputMode;
use bevy::camera::visibility::RenderLayers;
use bevy::input::InputSystems;
use bevy::prelude::*;
use bevy::render::render_resource::BlendState;
use bevy::window::PrimaryWindow;
use bevy_egui::input::EguiWantsInput;
use bevy_egui::{EguiGlobalSettings, EguiPlugin, EguiPrimaryContextPass, PrimaryEguiContext};
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
            .add_systems(EguiPrimaryContextPass, draw_hud);
    }
}

/// A camera for the HUD alone, over all others of the window: each of them may have but a part of it.
fn open_hud_eye(mut commands: Commands, windows: Query<(), With<PrimaryWindow>>) {
    if windows.is_empty() {
        return;
    }
    let over = CameraOutputMode::Write { blend_state: Some(BlendState::PREMULTIPLIED_ALPHA_BLENDING), clear_color: ClearColorConfig::None };
    let camera = Camera { order: 100, clear_color: ClearColorConfig::Custom(Color::NONE), output_mode: over, ..default() };
    // It sees nothing but the HUD.
    commands.spawn((Name::new("HUD eye"), Camera2d, camera, Msaa::Off, RenderLayers::none(), PrimaryEguiContext));
}

fn claim_pointer(wants: Option<Res<EguiWantsInput>>, mut claims: ResMut<PointerClaims>) {
    claims.hud = wants.is_some_and(|w| w.wants_any_pointer_input());
}
