//! Files that appear only when they are complete.

use crate::error::ImagingError;
use std::io::{BufWriter, Write};
use std::path::Path;

/// Writes a file under a temporary name beside its own and renames it.
///
/// # Errors
/// What `write` says, and those of the file system. The file that was there stays as it was.
pub fn whole_file(path: &Path, write: impl FnOnce(&mut dyn Write) -> Result<(), ImagingError>) -> Result<(), ImagingError> {
    let io = ImagingError::io;
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut file = tempfile::Builder::new().prefix(".keyhole-").tempfile_in(folder).map_err(io(path))?;
    let mut out = BufWriter::new(file.as_file_mut());
    write(&mut out)?;
    out.flush().map_err(io(path))?;
    drop(out);
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        file.as_file().set_permissions(std::fs::Permissions::from_mode(0o644)).map_err(io(path))?;
    }
    file.persist(path).map(|_| ()).map_err(|e| ImagingError::Io { path: path.into(), source: e.error })
}
