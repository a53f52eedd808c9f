//! The cameras. There is one for the window and one for pictures; each shows one of the two views at a time.

use crate::layers;
use crate::optics::{Lens, eye_pose};
use crate::orbit::OrbitState;
use bevy::anti_alias::fxaa::Fxaa;
use bevy::camera::visibility::RenderLayers;
use bevy::core_pipeline::tonemapping::Tonemapping;
use bevy::prelude::*;
use bevy::render::renderer::RenderAdapterInfo;
use bevy::window::PrimaryWindow;
use keyhole_whiteboard::{Endoscope, ViewMode};

/// A camera that shows one of the views.
#[derive(Component, Clone, Copy, Debug, PartialEq, Eq)]
#[require(Camera3d, AmbientLight, RenderLayers, Tonemapping = Tonemapping::AcesFitted)]
pub struct Eye {
    /// Which view.
    pub shows: ViewMode,
}

/// The eye in the window: shows what [`ViewMode`] says.
#[derive(Component, Clone, Copy, Debug, Default)]
pub struct WindowEye;

/// Vertical angle of view of the global view, rad.
const GLOBAL_ANGLE_OF_VIEW_RAD: f32 = 0.6;

/// How edges are smoothed: by multisampling, but where the adapter is software that costs a third of a frame, and a filter does.
pub fn smooth_edges(mut commands: Commands, adapter: Option<Res<RenderAdapterInfo>>, eyes: Query<Entity, Added<Eye>>) {
    if adapter.is_some_and(|a| a.device_type == wgpu::DeviceType::Cpu) {
        for eye in &eyes {
            commands.entity(eye).insert((Msaa::Off, Fxaa::default()));
        }
    }
}

/// Opens the eye in the window, if there is a window.
pub fn open_window_eye(mut commands: Commands, windows: Query<(), With<PrimaryWindow>>) {
    if !windows.is_empty() {
        commands.spawn((Name::new("window eye"), Eye { shows: ViewMode::Global }, WindowEye));
    }
}

/// V: the other view.
pub fn switch_view(keys: Res<ButtonInput<KeyCode>>, mut mode: ResMut<ViewMode>) {
    if keys.just_pressed(KeyCode::KeyV) {
        *mode = match *mode {
            ViewMode::Global => ViewMode::Laparoscopic,
            ViewMode::Laparoscopic => ViewMode::Global,
        };
    }
}

/// The window's eye shows the view that is chosen.
pub fn follow_mode(mode: Res<ViewMode>, mut eyes: Query<&mut Eye, With<WindowEye>>) {
    for mut eye in &mut eyes {
        if eye.shows != *mode {
            eye.shows = *mode;
        }
    }
}

/// Puts every eye where its view is seen from, with that view's lens, layers and surroundings. Without an endoscope the laparoscopic view
/// is the global one.
pub fn aim_eyes(
    mut commands: Commands,
    orbit: Res<OrbitState>,
    endoscopes: Query<&Endoscope>,
    mut eyes: Query<(Entity, &Eye, &mut Transform, &mut Projection, &mut Camera, &mut RenderLayers, &mut AmbientLight, Option<&Lens>)>,
) {
    let endoscope = endoscopes.iter().next();
    for (entity, eye, mut transform, mut projection, mut camera, mut seen, mut ambient, lens) in &mut eyes {
        match (eye.shows, endoscope) {
            (ViewMode::Laparoscopic, Some(endoscope)) => {
                let pose = eye_pose(endoscope);
                *transform = Transform::from_isometry(pose);
                set_perspective(&mut projection, endoscope.angle_of_view_rad, 0.002, 1.0);
                camera.clear_color = ClearColorConfig::Custom(Color::BLACK);
                *seen = RenderLayers::from_layers(&[0]).union(&layers::scope_only());
                ambient.brightness = 25.0;
                let wanted = Lens::of(endoscope);
                if lens != Some(&wanted) {
                    commands.entity(entity).insert(wanted);
                }
            }
            _ => {
                *transform = orbit.transform();
                set_perspective(&mut projection, GLOBAL_ANGLE_OF_VIEW_RAD, 0.01, 20.0);
                camera.clear_color = ClearColorConfig::Custom(Color::linear_rgb(0.020, 0.028, 0.034));
                *seen = RenderLayers::from_layers(&[0]).union(&layers::global_only());
                ambient.brightness = 130.0;
                if lens.is_some() {
                    commands.entity(entity).remove::<Lens>();
                }
            }
        }
    }
}

/// The aspect ratio is the renderer's business.
fn set_perspective(projection: &mut Projection, fov: f32, near: f32, far: f32) {
    if let Projection::Perspective(perspective) = projection {
        perspective.fov = fov;
        perspective.near = near;
        perspective.far = far;
    }
}
