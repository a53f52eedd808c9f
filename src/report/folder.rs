//! A folder that appears under its name only when everything in it is written.

use std::io;
use std::path::{Path, PathBuf};

/// A folder being filled, under a temporary name beside its final place. Dropped unfinished, it is gone.
#[derive(Debug)]
pub struct Folder {
    filling: tempfile::TempDir,
    place: PathBuf,
}

impl Folder {
    /// Starts a folder that will be at `place`.
    ///
    /// # Errors
    /// When there is already something there, other than an empty folder, or the folder above cannot be written to.
    pub fn begin(place: &Path) -> io::Result<Self> {
        let taken = match std::fs::read_dir(place) {
            Ok(mut entries) => entries.next().is_some(),
            Err(_) => place.exists(),
        };
        if taken {
            return Err(io::Error::new(io::ErrorKind::AlreadyExists, "is there already and not empty: give another name or move it away"));
        }
        let above = place.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        std::fs::create_dir_all(above)?;
        Ok(Self { filling: tempfile::Builder::new().prefix(".keyhole-").tempdir_in(above)?, place: place.into() })
    }

    /// Where to write now.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.filling.path()
    }

    /// Gives the folder its name.
    ///
    /// # Errors
    /// When something has come to its place meanwhile.
    pub fn finish(self) -> io::Result<PathBuf> {
        if self.place.is_dir() {
            // Only succeeds on an empty one.
            std::fs::remove_dir(&self.place)?;
        }
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            std::fs::set_permissions(self.filling.path(), std::fs::Permissions::from_mode(0o755))?;
        }
        std::fs::rename(self.filling.path(), &self.place)?;
        // What it named is no longer there: nothing is left to remove.
        drop(self.filling.keep());
        Ok(self.place)
    }
}

/// The first of `report`, `report-2`, `report-3`... in a folder that is not there yet.
#[must_use]
pub fn unused(folder: &Path) -> PathBuf {
    let mut place = folder.join("report");
    let mut number = 1;
    while place.exists() {
        number += 1;
        place = folder.join(format!("report-{number}"));
    }
    place
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;

    #[test]
    fn a_folder_appears_whole_or_not_at_all_and_overwrites_nothing() {
        let above = tempfile::tempdir().unwrap();
        let place = unused(above.path());
        assert!(place.ends_with("report"));
        let folder = Folder::begin(&place).unwrap();
        std::fs::write(folder.path().join("a"), "x").unwrap();
        assert!(!place.exists());
        drop(folder);
        assert_eq!(std::fs::read_dir(above.path()).unwrap().count(), 0);
        let folder = Folder::begin(&place).unwrap();
        std::fs::write(folder.path().join("a"), "x").unwrap();
        folder.finish().unwrap();
        assert_eq!(std::fs::read(place.join("a")).unwrap(), b"x");
        assert!(unused(above.path()).ends_with("report-2"));
        assert_eq!(Folder::begin(&place).unwrap_err().kind(), io::ErrorKind::AlreadyExists);
    }
}
