//! What a recording starts with: who made it, in which scene, from which seeds.

use crate::recording::RecordingError;
use serde::{Deserialize, Serialize};
use std::io::Read;
use std::path::Path;

/// Version of the format of recordings. Another one is not read.
pub const FORMAT: u32 = 2;

/// Version of this program.
pub const PROGRAM: &str = env!("CARGO_PKG_VERSION");

/// What a recording begins with.
pub(crate) const MAGIC: [u8; 8] = *b"keyhole\0";

/// Everything that a replay must start from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Header {
    /// The scene.
    pub scene: SceneIdentity,
    /// Length of a tick, ns.
    pub tick_ns: u64,
    /// The seeds of whatever draws random numbers, by name; none while nothing does.
    pub seeds: Vec<(String, u64)>,
}

/// What a scene is made of.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SceneIdentity {
    /// Its name.
    pub name: String,
    /// Its file first, then every file that it names, each by the name that is used there, with the BLAKE3 of its contents.
    pub files: Vec<(String, [u8; 32])>,
}

impl Header {
    /// Whether a recording with this header can be played here, where a recording would begin with `here`.
    ///
    /// # Errors
    /// [`RecordingError::OtherScene`] with every file that differs; [`RecordingError::OtherSettings`].
    pub fn fits(&self, here: &Self) -> Result<(), RecordingError> {
        let differences = self.scene.differences(&here.scene);
        if !differences.is_empty() {
            return Err(RecordingError::OtherScene { scene: here.scene.name.clone(), differences });
        }
        let other = |name: &str, recorded: String, here: String| Err(RecordingError::OtherSettings { name: name.into(), recorded, here });
        if self.tick_ns != here.tick_ns {
            return other("ticks of", format!("{} ns", self.tick_ns), format!("{} ns", here.tick_ns));
        }
        if self.seeds != here.seeds {
            return other("the seeds", format!("{:?}", self.seeds), format!("{:?}", here.seeds));
        }
        Ok(())
    }
}

impl SceneIdentity {
    /// The identity of a scene from its files: the name of each as the scene says it, and where it is.
    ///
    /// # Errors
    /// [`RecordingError::File`] for a file that cannot be read.
    pub fn of<'a>(name: &str, files: impl IntoIterator<Item = (&'a str, &'a Path)>) -> Result<Self, RecordingError> {
        let hash = |(name, path): (&str, &Path)| {
            let contents = file_digest(path).map_err(|source| RecordingError::File { path: path.into(), source })?;
            Ok((name.to_owned(), contents))
        };
        Ok(Self { name: name.into(), files: files.into_iter().map(hash).collect::<Result<_, RecordingError>>()? })
    }

    /// What is different in another scene, file by file; empty when nothing is.
    #[must_use]
    pub fn differences(&self, other: &Self) -> Vec<String> {
        let mut found = Vec::new();
        for (name, contents) in &self.files {
            match other.files.iter().find(|(n, _)| n == name) {
                None => found.push(format!("{name} is no part of it any more")),
                Some((_, there)) if there != contents => found.push(format!("{name} has other contents")),
                Some(_) => {}
            }
        }
        let added = other.files.iter().filter(|(name, _)| !self.files.iter().any(|(n, _)| n == name));
        found.extend(added.map(|(name, _)| format!("{name} was no part of it")));
        found
    }
}

fn file_digest(path: &Path) -> std::io::Result<[u8; 32]> {
    let mut file = std::fs::File::open(path)?;
    let mut hash = blake3::Hasher::new();
    let mut buffer = vec![0; 1 << 16];
    loop {
        match file.read(&mut buffer)? {
            0 => return Ok(*hash.finalize().as_bytes()),
            n => hash.update(&buffer[..n]),
        };
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;

    #[test]
    fn a_changed_scene_says_what_differs() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let files = ["a.ron", "b.vtu", "c.glb"];
        files.iter().for_each(|f| std::fs::write(at(f), f).unwrap());
        let identity = |names: &[&str]| {
            let paths: Vec<_> = names.iter().map(|n| at(n)).collect();
            SceneIdentity::of("scene", names.iter().copied().zip(paths.iter().map(|p| p.as_path())))
        };
        let header = |scene| Header { scene, tick_ns: 16_666_667, seeds: Vec::new() };
        let before = header(identity(&files).unwrap());
        assert!(before.fits(&header(identity(&files).unwrap())).is_ok());
        std::fs::write(at("b.vtu"), "x").unwrap();
        std::fs::write(at("d.glb"), "x").unwrap();
        let error = before.fits(&header(identity(&["a.ron", "b.vtu", "d.glb"]).unwrap())).unwrap_err().to_string();
        for part in ["b.vtu has other contents", "c.glb is no part of it any more", "d.glb was no part of it"] {
            assert!(error.contains(part), "{error}");
        }
        assert!(!error.contains("a.ron"), "{error}");
        let slower = Header { tick_ns: 1, ..before.clone() };
        assert!(matches!(before.fits(&slower), Err(RecordingError::OtherSettings { .. })));
        assert!(matches!(identity(&["e.ron"]), Err(RecordingError::File { path, .. }) if path.ends_with("e.ron")));
    }
}
