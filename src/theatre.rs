//! Everything that a scene needs from disk, read and checked before an app is built.

use bevy::prelude::*;
use keyhole_instruments::{HandKey, HandTrack, Script, ScriptError, ViewKey};
use keyhole_scene::surface::SurfaceError;
use keyhole_scene::{Scene, SceneAnatomy, SceneError};
use keyhole_tetmesh::TetMesh;
use keyhole_whiteboard::PartMesh;
use std::path::{Path, PathBuf};

/// The scene that is played when none is named, from the root of the repository.
const DEFAULT_SCENE: &str = "scenes/kidney_resection.scene.ron";

/// A scene ready to be spawned, as often as one likes.
#[derive(Resource, Clone, Debug)]
pub struct Theatre {
    /// The scene, with paths that can be opened.
    pub scene: Scene,
    /// The meshes of its organs, at their place in the world.
    pub meshes: Vec<TetMesh>,
    /// The surfaces of its anatomy, each in its own frame.
    pub surfaces: Vec<PartMesh>,
    /// Its demonstration; empty when it has none.
    pub script: Script,
}

/// Why a scene cannot be played.
#[derive(Debug, thiserror::Error)]
pub enum TheatreError {
    /// The scene or one of its meshes.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The surface of a piece of anatomy.
    #[error(transparent)]
    Surface(#[from] SurfaceError),
    /// The scene is well-formed, but what it says cannot be.
    #[error("{}", list(path, problems))]
    Problems {
        /// The scene's file.
        path: PathBuf,
        /// What is wrong, each with its place.
        problems: Vec<String>,
    },
    /// The demonstration.
    #[error("{}: demonstration: {source}", path.display())]
    Script {
        /// The scene's file.
        path: PathBuf,
        /// What is wrong with it.
        source: ScriptError,
    },
    /// There is no default scene beside the program, in the current folder, or where the program was built.
    #[error("the default scene {DEFAULT_SCENE} is in none of {}: name a scene, or start keyhole from its own folder", shown(tried))]
    NoDefault {
        /// Where it was looked for.
        tried: Vec<PathBuf>,
    },
}

impl Theatre {
    /// Reads a scene and its meshes.
    ///
    /// # Errors
    /// When the scene, a mesh or the demonstration is not as it should be.
    pub fn load(path: &Path) -> Result<Self, TheatreError> {
        let scene = keyhole_scene::load(path)?;
        let problems: Vec<String> = keyhole_scene::check(path).into_iter().map(|p| p.to_string()).collect();
        if !problems.is_empty() {
            return Err(TheatreError::Problems { path: path.into(), problems });
        }
        Self::of(scene, path)
    }

    /// The theatre of a scene whose values have been checked, with its meshes. `path` is named in errors.
    ///
    /// # Errors
    /// When a mesh or the demonstration is not as it should be.
    pub fn of(scene: Scene, path: &Path) -> Result<Self, TheatreError> {
        let meshes = scene.organs.iter().map(|o| o.read_mesh()).collect::<Result<_, _>>()?;
        let surfaces = scene.anatomy.iter().map(SceneAnatomy::read_surface).collect::<Result<_, _>>()?;
        let script = script(&scene).map_err(|source| TheatreError::Script { path: path.into(), source })?;
        Ok(Self { scene, meshes, surfaces, script })
    }

    /// How long the demonstration lasts, s; `None` when there is none.
    #[must_use]
    pub fn demonstration_s(&self) -> Option<f64> {
        self.scene.demonstration.as_ref().map(|d| d.seconds)
    }
}

/// Where the default scene is: in the current folder, beside the program or above it, or in the folder that it was built from.
///
/// # Errors
/// When it is nowhere.
pub fn default_scene() -> Result<PathBuf, TheatreError> {
    let program = std::env::current_exe().unwrap_or_default();
    let built_from = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut tried = vec![PathBuf::from(".")];
    tried.extend(program.ancestors().skip(1).take(3).map(Path::to_path_buf));
    tried.push(built_from.to_path_buf());
    tried.iter().map(|folder| folder.join(DEFAULT_SCENE)).find(|file| file.is_file()).ok_or(TheatreError::NoDefault { tried })
}

fn script(scene: &Scene) -> Result<Script, ScriptError> {
    let Some(demonstration) = &scene.demonstration else { return Ok(Script::default()) };
    let hand_key = |k: &keyhole_scene::HandKeyframe| HandKey {
        time_s: k.time_s,
        tip: Vec3::from_array(k.tip),
        roll_rad: k.roll_deg.to_radians(),
        grip: k.grip,
        active: k.active,
    };
    let view_key =
        |k: &keyhole_scene::ViewKeyframe| ViewKey { time_s: k.time_s, target: Vec3::from_array(k.target), distance_m: k.distance_m };
    let hands =
        demonstration.hands.iter().map(|h| HandTrack { hand: h.hand.hand(), keys: h.keys.iter().map(hand_key).collect() }).collect();
    Script::new(hands, demonstration.view.iter().map(view_key).collect())
}

fn list(path: &Path, problems: &[String]) -> String {
    match problems {
        [one] => one.clone(),
        [first, rest @ ..] => {
            format!("{first}\n({} more: `keyhole scene check {}` lists them)", rest.len(), path.display())
        }
        [] => String::new(),
    }
}

fn shown(paths: &[PathBuf]) -> String {
    paths.iter().map(|p| p.display().to_string()).collect::<Vec<_>>().join(", ")
}
