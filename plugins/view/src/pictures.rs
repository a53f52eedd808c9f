//! Pictures of the views, saved as PNG, with a window or without.
//!
//! A request is taken up when the ones before it are done: the picture's eye is opened, the renderer gets the time to compile what it
//! needs, one frame is read back and saved under a temporary name, then renamed.

use crate::eyes::{Eye, EyeOf, Viewpoint};
use crate::smoothing::MotionSettings;
use bevy::camera::RenderTarget;
use bevy::prelude::*;
use bevy::render::render_resource::{PipelineCache, TextureFormat, TextureUsages};
use bevy::render::view::screenshot::{Screenshot, ScreenshotCaptured};
use bevy::render::{Render, RenderApp, RenderSystems};
use keyhole_whiteboard::ViewMode;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// What a picture shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PictureOf {
    /// One of the views, without HUD, in the size of [`crate::ViewPlugin`].
    View(ViewMode),
    /// The theatre from a place, as the global view shows it.
    From(Viewpoint),
    /// What is painted, see [`crate::Paint`], by itself, from a place.
    Specimen(Viewpoint),
    /// The window as it is, with its HUD.
    Window,
}

/// A picture to be taken.
#[derive(Clone, Debug, PartialEq)]
pub struct PictureRequest {
    /// Where to save it; the name ends in `.png`. An existing file is replaced.
    pub path: PathBuf,
    /// What it shows.
    pub of: PictureOf,
}

/// Pictures still to be taken up, in order. Written by anybody.
#[derive(Resource, Clone, Debug, Default)]
pub struct PictureRequests(pub Vec<PictureRequest>);

/// Pictures requested and not yet saved, as of the last frame.
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PicturesPending(pub usize);

/// Pictures that failed since the app started.
#[derive(Resource, Debug, Default)]
pub struct PictureErrors(pub Vec<PictureError>);

/// Why there is no picture.
#[derive(Debug, thiserror::Error)]
pub enum PictureError {
    /// The file cannot be written.
    #[error("{path}: the picture cannot be saved: {why}")]
    Save {
        /// The file.
        path: PathBuf,
        /// What the encoder or the file system says.
        why: String,
    },
    /// The renderer never delivered.
    #[error("{path}: the renderer delivered no picture within {frames} frames")]
    NoPicture {
        /// The file.
        path: PathBuf,
        /// How long was waited.
        frames: u32,
    },
}

/// Frames before a picture: what the first one left to compile is known in the third, for the renderer works one frame behind.
const FEWEST_FRAMES: u32 = 3;

/// Frames without anything left to compile before a picture.
const IDLE_FRAMES: u32 = 2;

/// Frames until a picture is given up.
const MOST_FRAMES: u32 = 2000;

#[derive(Debug)]
struct Job {
    request: PictureRequest,
    frames: u32,
    idle: u32,
    asked: bool,
}

/// The eye for pictures and what it is busy with.
#[derive(Resource, Debug)]
pub struct Darkroom {
    eye: Entity,
    target: Handle<Image>,
    job: Option<Job>,
    compiling: Arc<AtomicUsize>,
}

/// Sets the darkroom up; the renderer's app must be there already.
pub fn build_darkroom(app: &mut App, size: UVec2) {
    let compiling = Arc::new(AtomicUsize::new(0));
    if let Some(render) = app.get_sub_app_mut(RenderApp) {
        let count = compiling.clone();
        let report = move |cache: Res<PipelineCache>| count.store(cache.waiting_pipelines().count(), Ordering::Relaxed);
        render.add_systems(Render, report.in_set(RenderSystems::Cleanup));
    }
    let mut image = Image::new_target_texture(size.x, size.y, TextureFormat::Rgba8UnormSrgb, None);
    image.texture_descriptor.usage |= TextureUsages::COPY_SRC;
    let target = app.world_mut().resource_mut::<Assets<Image>>().add(image);
    let eye = app
        .world_mut()
        .spawn((
            Name::new("picture eye"),
            Eye { shows: EyeOf::Global },
            Camera { is_active: false, order: -1, ..default() },
            RenderTarget::Image(target.clone().into()),
        ))
        .id();
    app.init_resource::<PictureRequests>().init_resource::<PicturesPending>().init_resource::<PictureErrors>().insert_resource(Darkroom {
        eye,
        target,
        job: None,
        compiling,
    });
}

/// Works on the first request.
pub fn develop(
    mut commands: Commands,
    mut darkroom: ResMut<Darkroom>,
    mut requests: ResMut<PictureRequests>,
    mut pending: ResMut<PicturesPending>,
    mut errors: ResMut<PictureErrors>,
    mut eyes: Query<(&mut Eye, &mut Camera)>,
) {
    if darkroom.job.is_none() && !requests.0.is_empty() {
        let request = requests.0.remove(0);
        darkroom.job = Some(Job { request, frames: 0, idle: 0, asked: false });
    }
    let (eye, target, compiling) = (darkroom.eye, darkroom.target.clone(), darkroom.compiling.load(Ordering::Relaxed));
    if let Ok((mut eye, mut camera)) = eyes.get_mut(eye) {
        // The frame that is asked for is the last one that is drawn.
        let shows = darkroom.job.as_ref().filter(|job| !job.asked).and_then(|job| match job.request.of {
            PictureOf::View(mode) => Some(EyeOf::from(mode)),
            PictureOf::From(place) => Some(EyeOf::From(place)),
            PictureOf::Specimen(place) => Some(EyeOf::Specimen(place)),
            PictureOf::Window => None,
        });
        camera.is_active = shows.is_some();
        eye.shows = shows.unwrap_or(eye.shows);
    }
    if let Some(job) = &mut darkroom.job {
        job.frames += 1;
        job.idle = if compiling == 0 { job.idle + 1 } else { 0 };
        if !job.asked && job.frames >= FEWEST_FRAMES && job.idle >= IDLE_FRAMES {
            job.asked = true;
            let screenshot = match job.request.of {
                PictureOf::View(_) | PictureOf::From(_) | PictureOf::Specimen(_) => Screenshot::image(target),
                PictureOf::Window => Screenshot::primary_window(),
            };
            commands.spawn(screenshot).observe(save);
        } else if job.frames > MOST_FRAMES {
            errors.0.push(PictureError::NoPicture { path: job.request.path.clone(), frames: MOST_FRAMES });
            darkroom.job = None;
        }
    }
    pending.0 = requests.0.len() + usize::from(darkroom.job.is_some());
}

fn save(captured: On<ScreenshotCaptured>, mut darkroom: ResMut<Darkroom>, mut errors: ResMut<PictureErrors>) {
    let Some(job) = darkroom.job.take() else { return };
    if let Err(why) = save_png(&captured.image, &job.request.path) {
        errors.0.push(PictureError::Save { path: job.request.path, why });
    }
}

fn save_png(image: &Image, path: &Path) -> Result<(), String> {
    let picture = image.clone().try_into_dynamic().map_err(|e| e.to_string())?.to_rgb8();
    // The encoder knows the format by the ending.
    let temporary = path.with_extension("part.png");
    let saved = picture.save(&temporary).map_err(|e| e.to_string());
    let renamed = saved.and_then(|()| std::fs::rename(&temporary, path).map_err(|e| e.to_string()));
    if renamed.is_err() {
        // Nothing half-written stays; that it may not be there is fine.
        drop(std::fs::remove_file(&temporary));
    }
    renamed
}

/// Takes pictures now, in an app that is driven by `App::update` and whose plugins are finished: simulated time stands still meanwhile and
/// the newest tick is shown.
///
/// # Errors
/// The first picture that failed.
pub fn take_pictures(app: &mut App, pictures: impl IntoIterator<Item = PictureRequest>) -> Result<(), PictureError> {
    let was_paused = app.world().resource::<Time<Virtual>>().is_paused();
    let motion = *app.world().resource::<MotionSettings>();
    app.world_mut().resource_mut::<Time<Virtual>>().pause();
    app.insert_resource(MotionSettings::Newest);
    app.world_mut().resource_mut::<PictureRequests>().0.extend(pictures);
    loop {
        app.update();
        if app.world().resource::<PicturesPending>().0 == 0 {
            break;
        }
    }
    app.insert_resource(motion);
    if !was_paused {
        app.world_mut().resource_mut::<Time<Virtual>>().unpause();
    }
    let errors = &mut app.world_mut().resource_mut::<PictureErrors>().0;
    if errors.is_empty() { Ok(()) } else { Err(errors.remove(0)) }
}
