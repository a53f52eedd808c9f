//! The cameras: those of the window, which show one view, two in one, or both lenses of a stereo endoscope, and one for pictures.

use crate::layers;
use crate::optics::{Lens, eye_pose};
use crate::orbit::OrbitState;
use crate::shading::Lights;
use bevy::anti_alias::fxaa::Fxaa;
use bevy::camera::Viewport;
use bevy::camera::visibility::RenderLayers;
use bevy::core_pipeline::prepass::DepthPrepass;
use bevy::core_pipeline::tonemapping::Tonemapping;
use bevy::light::ShadowFilteringMethod;
use bevy::math::Vec3A;
use bevy::prelude::*;
use bevy::render::renderer::RenderAdapterInfo;
use bevy::window::PrimaryWindow;
use keyhole_whiteboard::{Endoscope, ScopeOptics, SimulationControl, ViewMode};

/// A camera.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
#[require(Camera3d, AmbientLight, RenderLayers, ShadowFilteringMethod, Tonemapping = Tonemapping::AcesFitted)]
pub struct Eye {
    /// What it shows.
    pub shows: EyeOf,
}

/// What a camera shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum EyeOf {
    /// The whole theatre, from where the trainee has put the camera.
    Global,
    /// Through a lens of the endoscope. Without an endoscope it is the global view.
    Scope(ScopeEye),
    /// The theatre from a place.
    From(Viewpoint),
    /// What is painted, by itself, from a place.
    Specimen(Viewpoint),
}

/// Where the window looks from at what is painted, see [`crate::Paint`], by itself; `None`: it shows the theatre.
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq)]
pub struct SpecimenView(pub Option<Viewpoint>);

impl From<ViewMode> for EyeOf {
    fn from(mode: ViewMode) -> Self {
        match mode {
            ViewMode::Global => Self::Global,
            ViewMode::Laparoscopic => Self::Scope(ScopeEye::Middle),
        }
    }
}

/// Which lens of an endoscope.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ScopeEye {
    /// The only one.
    Middle,
    /// The left one of a stereo endoscope.
    Left,
    /// The right one.
    Right,
}

impl ScopeEye {
    /// To the right of the middle, as a part of the distance of the lenses.
    fn aside(self) -> f32 {
        match self {
            Self::Middle => 0.0,
            Self::Left => -0.5,
            Self::Right => 0.5,
        }
    }
}

/// A place to look from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Viewpoint {
    /// Where the camera is, m.
    pub eye: Vec3,
    /// What it looks at, m.
    pub target: Vec3,
}

impl Viewpoint {
    /// The camera's place; up is Y, or -Z for a camera that looks straight up or down.
    #[must_use]
    pub fn transform(&self) -> Transform {
        let along = (self.target - self.eye).normalize_or(Vec3::NEG_Z);
        let up = if along.cross(Vec3::Y).length_squared() < 1e-6 { Vec3::NEG_Z } else { Vec3::Y };
        Transform::from_translation(self.eye).looking_to(along, up)
    }
}

/// What a camera of the window is for.
#[derive(Component, Clone, Copy, Debug, PartialEq, Eq)]
pub enum WindowEye {
    /// Shows what [`ViewMode`] says, or the left lens.
    Main,
    /// The right lens.
    Second,
    /// The other view, small, in a corner.
    Inset,
}

/// How the window is shared out.
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ViewLayout {
    /// One view.
    #[default]
    Single,
    /// The other view small in the lower right corner.
    Inset,
    /// The laparoscopic view through both lenses, side by side: for glasses or for squinting. Of an endoscope with one lens the default distance is taken.
    /// The global view is single.
    SideBySide,
}

/// How far the lens of the endoscope has fogged over, 0 to 1.
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq)]
pub struct ScopeFog(pub f32);

/// Vertical angle of view of the global view, rad.
const GLOBAL_ANGLE_OF_VIEW_RAD: f32 = 0.6;

/// Height of the inset as a part of the window's.
const INSET_HEIGHT: f32 = 0.36;

/// Distance of the lenses of a stereo endoscope when its scene says none, m: that of common 10 mm scopes.
const STEREO_BASE_M: f32 = 0.0045;

/// Spares an adapter that is software. There, multisampling costs a third of a frame; a filter does instead, and that only for pictures: it goes over the whole
/// target and costs a fifth. What lies behind something else is found out before it is shaded.
pub fn spare_software(mut commands: Commands, adapter: Option<Res<RenderAdapterInfo>>, eyes: Query<(Entity, Has<WindowEye>), Added<Eye>>) {
    if adapter.is_some_and(|a| a.device_type == wgpu::DeviceType::Cpu) {
        for (eye, of_window) in &eyes {
            commands.entity(eye).insert((Msaa::Off, DepthPrepass));
            if !of_window {
                commands.entity(eye).insert(Fxaa::default());
            }
        }
    }
}

/// Opens the eyes of the window, if there is a window.
pub fn open_window_eyes(mut commands: Commands, windows: Query<(), With<PrimaryWindow>>) {
    if windows.is_empty() {
        return;
    }
    for (order, eye) in [WindowEye::Main, WindowEye::Second, WindowEye::Inset].into_iter().enumerate() {
        let camera = Camera { order: order as isize, is_active: eye == WindowEye::Main, ..default() };
        commands.spawn((Name::new(format!("window eye {eye:?}")), Eye { shows: EyeOf::Global }, eye, camera));
    }
}

/// V: the other view. I: the other view as an inset. T: stereo. L: a clean lens.
pub fn switch_view(keys: Res<ButtonInput<KeyCode>>, mut mode: ResMut<ViewMode>, mut layout: ResMut<ViewLayout>, mut fog: ResMut<ScopeFog>) {
    if keys.just_pressed(KeyCode::KeyV) {
        *mode = other(*mode);
    }
    for (key, wanted) in [(KeyCode::KeyI, ViewLayout::Inset), (KeyCode::KeyT, ViewLayout::SideBySide)] {
        if keys.just_pressed(key) {
            *layout = if *layout == wanted { ViewLayout::Single } else { wanted };
        }
    }
    if keys.just_pressed(KeyCode::KeyL) {
        fog.0 = 0.0;
    }
}

fn other(mode: ViewMode) -> ViewMode {
    match mode {
        ViewMode::Global => ViewMode::Laparoscopic,
        ViewMode::Laparoscopic => ViewMode::Global,
    }
}

/// Lets the lens fog over while simulated time goes by; a new endoscope is clean.
pub fn fog_lens(
    time: Res<Time<Virtual>>,
    control: Res<SimulationControl>,
    mut fog: ResMut<ScopeFog>,
    endoscopes: Query<(Ref<Endoscope>, Option<&ScopeOptics>)>,
) {
    let Some((endoscope, optics)) = endoscopes.iter().next() else { return };
    if endoscope.is_added() {
        fog.0 = 0.0;
    }
    if let Some(seconds) = optics.and_then(|o| o.fogs_in_s).filter(|_| !control.paused) {
        fog.0 = (fog.0 + time.delta_secs() / seconds).min(1.0);
    }
}

/// What a camera of the window shows in which part of it; `None`: it is shut.
fn share(eye: WindowEye, layout: ViewLayout, mode: ViewMode, has_scope: bool, window: UVec2) -> Option<(EyeOf, Option<Viewport>)> {
    let part = |physical_position, physical_size| Viewport { physical_position, physical_size, ..default() };
    // What is round fits into a square.
    let side = (window.x / 2).min(window.y).max(1);
    let (half, low) = (UVec2::splat(side), UVec2::new((window.x / 2).saturating_sub(side), window.y.saturating_sub(side)) / 2);
    let stereo = layout == ViewLayout::SideBySide && mode == ViewMode::Laparoscopic && has_scope;
    match eye {
        WindowEye::Main if stereo => Some((EyeOf::Scope(ScopeEye::Left), Some(part(low, half)))),
        // The round picture of a wide window leaves its sides black: nothing is drawn there.
        WindowEye::Main if mode == ViewMode::Laparoscopic && has_scope && window.x > window.y => {
            let left = UVec2::new((window.x - window.y) / 2, 0);
            Some((mode.into(), Some(part(left, UVec2::splat(window.y)))))
        }
        WindowEye::Main => Some((mode.into(), None)),
        WindowEye::Second if stereo => Some((EyeOf::Scope(ScopeEye::Right), Some(part(low.with_x(window.x / 2 + low.x), half)))),
        WindowEye::Inset if layout == ViewLayout::Inset && has_scope => {
            let height = ((window.y as f32 * INSET_HEIGHT) as u32).max(1);
            let shown = other(mode);
            // What is round needs no corners.
            let width = if shown == ViewMode::Laparoscopic { height } else { height * 4 / 3 };
            let size = UVec2::new(width.min(window.x).max(1), height);
            Some((shown.into(), Some(part(window.saturating_sub(size), size))))
        }
        WindowEye::Second | WindowEye::Inset => None,
    }
}

/// Shares the window out among its cameras.
pub fn arrange_window(
    mode: Res<ViewMode>,
    layout: Res<ViewLayout>,
    specimen: Res<SpecimenView>,
    window: Query<&Window, With<PrimaryWindow>>,
    endoscopes: Query<(), With<Endoscope>>,
    mut eyes: Query<(&mut Eye, &mut Camera, &WindowEye)>,
) {
    let Ok(window) = window.single() else { return };
    for (mut eye, mut camera, of_window) in &mut eyes {
        let share = match specimen.0 {
            None => share(*of_window, *layout, *mode, !endoscopes.is_empty(), window.physical_size()),
            Some(from) => (*of_window == WindowEye::Main).then_some((EyeOf::Specimen(from), None)),
        };
        if camera.is_active != share.is_some() {
            camera.is_active = share.is_some();
        }
        let Some((shows, viewport)) = share else { continue };
        eye.set_if_neq(Eye { shows });
        let place = |v: &Option<Viewport>| v.as_ref().map(|v| (v.physical_position, v.physical_size));
        if place(&camera.viewport) != place(&viewport) {
            camera.viewport = viewport;
        }
    }
}

/// What a camera sees, and what light it sees it in.
type Light<'a> = (&'a mut RenderLayers, &'a mut AmbientLight, &'a mut ShadowFilteringMethod);

/// Puts every eye where its view is seen from, with that view's lens, layers and surroundings. Without an endoscope the laparoscopic view
/// is the global one.
pub fn aim_eyes(
    mut commands: Commands,
    orbit: Res<OrbitState>,
    fog: Res<ScopeFog>,
    endoscopes: Query<(&Endoscope, Option<&ScopeOptics>)>,
    mut eyes: Query<(Entity, &Eye, &mut Transform, &mut Projection, &mut Camera, Light<'static>, Option<&Lens>)>,
) {
    let endoscope = endoscopes.iter().next();
    for (entity, eye, mut transform, mut projection, mut camera, (mut seen, mut ambient, mut filter), lens) in &mut eyes {
        match (eye.shows, endoscope) {
            (EyeOf::Scope(of), Some((endoscope, optics))) => {
                let optics = optics.copied().unwrap_or_default();
                let mut pose = eye_pose(endoscope);
                let aside = of.aside() * optics.stereo_base_m.unwrap_or(STEREO_BASE_M);
                pose.translation += pose.rotation * Vec3A::X * aside;
                *transform = Transform::from_isometry(pose);
                set_perspective(&mut projection, endoscope.angle_of_view_rad, 0.002, 1.0);
                camera.clear_color = ClearColorConfig::Custom(Color::BLACK);
                *seen = RenderLayers::from_layers(&[0]).union(&layers::scope_only());
                ambient.brightness = 25.0;
                filter.set_if_neq(Lights::Endoscope.filter());
                let viewport = camera.viewport.as_ref().map_or(Vec4::ZERO, |v| {
                    let (at, size) = (v.physical_position.as_vec2(), v.physical_size.as_vec2());
                    Vec4::new(at.x, at.y, size.x, size.y)
                });
                let wanted = Lens { viewport, fog: fog.0, ..Lens::of(endoscope, &optics) };
                if lens != Some(&wanted) {
                    commands.entity(entity).insert(wanted);
                }
            }
            (shows, _) => {
                *transform = match shows {
                    EyeOf::From(place) | EyeOf::Specimen(place) => place.transform(),
                    EyeOf::Global | EyeOf::Scope(_) => orbit.transform(),
                };
                set_perspective(&mut projection, GLOBAL_ANGLE_OF_VIEW_RAD, 0.01, 20.0);
                camera.clear_color = ClearColorConfig::Custom(Color::linear_rgb(0.020, 0.028, 0.034));
                *seen = match shows {
                    EyeOf::Specimen(_) => layers::specimen_only(),
                    _ => RenderLayers::from_layers(&[0]).union(&layers::global_only()),
                };
                // The colours of a specimen are to be read off it, not its shape.
                let (brightness, lights) =
                    if matches!(shows, EyeOf::Specimen(_)) { (1500.0, Lights::Specimen) } else { (130.0, Lights::Theatre) };
                ambient.brightness = brightness;
                filter.set_if_neq(lights.filter());
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

#[cfg(test)]
mod tests {
    use super::*;

    /// The parts of a window lie within it; both lenses have halves of it, side by side; the inset shows the other view.
    #[test]
    fn a_window_is_shared_out() {
        let window = UVec2::new(1281, 720);
        let at = |eye, layout, mode, scope| share(eye, layout, mode, scope, window);
        let place = |shared: Option<(EyeOf, Option<Viewport>)>| shared.and_then(|s| s.1).map(|v| (v.physical_position, v.physical_size));
        for mode in [ViewMode::Global, ViewMode::Laparoscopic] {
            for layout in [ViewLayout::Single, ViewLayout::Inset, ViewLayout::SideBySide] {
                for eye in [WindowEye::Main, WindowEye::Second, WindowEye::Inset] {
                    if let Some((low, size)) = place(at(eye, layout, mode, true)) {
                        assert!((low + size).cmple(window).all() && size.cmpgt(UVec2::ZERO).all());
                    }
                    let open = at(eye, layout, mode, false).is_some();
                    assert_eq!(open, eye == WindowEye::Main, "without an endoscope there is one view");
                }
            }
            let square = (mode == ViewMode::Laparoscopic).then_some((UVec2::new(280, 0), UVec2::splat(720)));
            assert_eq!(place(at(WindowEye::Main, ViewLayout::Single, mode, true)), square, "a round picture fits into a square");
            let inset = at(WindowEye::Inset, ViewLayout::Inset, mode, true);
            assert_eq!(inset.map(|s| s.0), Some(other(mode).into()));
        }
        let halves = [WindowEye::Main, WindowEye::Second].map(|eye| place(at(eye, ViewLayout::SideBySide, ViewMode::Laparoscopic, true)));
        assert_eq!(halves, [UVec2::new(0, 40), UVec2::new(640, 40)].map(|low| Some((low, UVec2::splat(640)))));
        assert_eq!(at(WindowEye::Second, ViewLayout::SideBySide, ViewMode::Global, true).map(|s| s.0), None);
    }
}
