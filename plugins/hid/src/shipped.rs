//! The profiles that come with the program, and those of the user.

use crate::error::ProfileError;
use crate::profile::Profile;
use std::env;
use std::path::{Path, PathBuf};

/// Name and text of each profile of `assets/devices`. They are part of the program, so that they are found wherever it is started.
pub const SHIPPED: [(&str, &str); 5] = [
    ("generic_vli.ron", include_str!("../../../assets/devices/generic_vli.ron")),
    ("xitact_like.ron", include_str!("../../../assets/devices/xitact_like.ron")),
    ("arduino_trainer.ron", include_str!("../../../assets/devices/arduino_trainer.ron")),
    ("gamepad.ron", include_str!("../../../assets/devices/gamepad.ron")),
    ("space_mouse.ron", include_str!("../../../assets/devices/space_mouse.ron")),
];

/// The profiles that come with the program.
///
/// # Errors
/// When one of them is no profile.
pub fn shipped() -> Result<Vec<Profile>, ProfileError> {
    SHIPPED.iter().map(|(name, text)| Profile::parse(name, text)).collect()
}

/// Where the user's own profiles are: `keyhole/devices` in the folder for settings. `None` when the system names no such folder.
#[must_use]
pub fn user_folder() -> Option<PathBuf> {
    let set = |name: &str| env::var_os(name).filter(|v| !v.is_empty()).map(PathBuf::from);
    let settings = set("XDG_CONFIG_HOME").or_else(|| set("APPDATA")).or_else(|| set("HOME").map(|home| home.join(".config")))?;
    Some(settings.join("keyhole").join("devices"))
}

/// Every profile of a folder, by name of the file; and what is wrong with those that are none. A folder that is not there has none.
#[must_use]
pub fn of_folder(folder: &Path) -> (Vec<Profile>, Vec<ProfileError>) {
    let Ok(entries) = std::fs::read_dir(folder) else { return (Vec::new(), Vec::new()) };
    let mut files: Vec<PathBuf> = entries.flatten().map(|e| e.path()).filter(|p| p.extension().is_some_and(|e| e == "ron")).collect();
    files.sort();
    let (mut profiles, mut errors) = (Vec::new(), Vec::new());
    for file in files {
        match Profile::load(&file) {
            Ok(profile) => profiles.push(profile),
            Err(error) => errors.push(error),
        }
    }
    (profiles, errors)
}

/// The user's profiles first, then those that come with the program; and what is wrong with any.
#[must_use]
pub fn all() -> (Vec<Profile>, Vec<ProfileError>) {
    let (mut profiles, mut errors) = user_folder().map(|f| of_folder(&f)).unwrap_or_default();
    match shipped() {
        Ok(shipped) => profiles.extend(shipped),
        Err(error) => errors.push(error),
    }
    (profiles, errors)
}
