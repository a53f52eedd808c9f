//! What a recording of a theatre starts with.

use crate::simulation::TICKS_PER_SECOND;
use crate::theatre::Theatre;
use bevy::prelude::{Fixed, Time};
use keyhole_assessment::recording::{Header, Recording, RecordingError, SceneIdentity};
use std::path::Path;

/// The header of a recording of a theatre that was loaded from `scene`: a digest of that file and of every file that it names.
///
/// # Errors
/// When one of the files cannot be read.
pub fn header(scene: &Path, theatre: &Theatre) -> Result<Header, RecordingError> {
    let folder = scene.parent().unwrap_or(Path::new(""));
    let meshes = theatre.scene.organs.iter().filter_map(|organ| organ.mesh.as_deref().map(Path::new));
    let surfaces = theatre.scene.anatomy.iter().filter_map(|anatomy| anatomy.path.as_deref().map(Path::new));
    // By the names that stand in the scene: a repository that was moved is the same.
    let named = meshes.chain(surfaces).map(|path| (path.strip_prefix(folder).unwrap_or(path), path));
    let own = (Path::new(scene.file_name().unwrap_or(scene.as_os_str())), scene);
    let files: Vec<(String, &Path)> =
        std::iter::once(own).chain(named).map(|(name, path)| (name.to_string_lossy().into_owned(), path)).collect();
    let scene = SceneIdentity::of(&theatre.scene.name, files.iter().map(|(name, path)| (name.as_str(), *path)))?;
    let tick_ns = Time::<Fixed>::from_hz(TICKS_PER_SECOND).timestep().as_nanos() as u64;
    // Nothing in the simulation draws random numbers.
    Ok(Header { scene, tick_ns, seeds: Vec::new() })
}

/// Reads a recording that is to be played in a theatre that was loaded from `scene`. One that breaks off is played up to there, and said so on standard
/// error.
///
/// # Errors
/// When it is no recording, or of another version, or of another scene.
pub fn read(file: &Path, scene: &Path, theatre: &Theatre) -> Result<Recording, RecordingError> {
    let recording = Recording::read(file)?;
    recording.header.fits(&header(scene, theatre)?)?;
    if let Some(break_off) = &recording.break_off {
        eprintln!("keyhole: {} {break_off}", file.display());
    }
    Ok(recording)
}
