//! The files of an input: those of a folder and the folders in it, of a zip archive, or those that a DICOMDIR lists.

use crate::dicom_file::{self, Elements, Pixels, is_dicom};
use crate::error::ImagingError;
use dicom_dictionary_std::{tags, uids};
use std::io::{Cursor, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Folders within folders that are looked into: links that go round in a circle end there.
const MAX_DEPTH: usize = 12;
/// Files beyond which an input is refused.
const MAX_FILES: usize = 200_000;
/// What the members of an archive may unpack to in any case, all together, bytes; and how many times its size beyond that. Images pack to
/// a half or a third, masks to a hundredth; a deflate stream can make 1032 bytes of one, and does so in archives made to fill a disk.
const UNPACKED: u64 = 1 << 30;
const EXPANSION: u64 = 200;
/// Bytes that tell a DICOM file.
const HEAD: u64 = 132;

/// A file of an input.
#[derive(Clone)]
pub enum InputFile {
    /// A file on disk.
    OnDisk(PathBuf),
    /// A member of a zip archive.
    InZip {
        /// The archive, shared by its members.
        archive: zip::ZipArchive<Cursor<Arc<[u8]>>>,
        /// Which member.
        index: usize,
        /// The archive's path with the member's name behind it, for messages.
        name: PathBuf,
    },
}

impl std::fmt::Debug for InputFile {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "InputFile({})", self.name().display())
    }
}

impl InputFile {
    /// What messages call it.
    #[must_use]
    pub fn name(&self) -> &Path {
        match self {
            Self::OnDisk(path) | Self::InZip { name: path, .. } => path,
        }
    }

    /// All bytes.
    ///
    /// # Errors
    /// Those of the file system, and members that are damaged, encrypted, or larger than they declare.
    pub fn read(&self) -> Result<Vec<u8>, ImagingError> {
        self.read_up_to(u64::MAX)
    }

    /// Whether it is a DICOM file; one that cannot be read is none.
    #[must_use]
    pub fn is_dicom(&self) -> bool {
        self.read_up_to(HEAD).is_ok_and(|head| is_dicom(&head))
    }

    fn read_up_to(&self, most: u64) -> Result<Vec<u8>, ImagingError> {
        let mut bytes = Vec::new();
        match self {
            Self::OnDisk(path) => {
                std::fs::File::open(path).and_then(|f| f.take(most).read_to_end(&mut bytes)).map_err(ImagingError::io(path))?;
            }
            Self::InZip { archive, index, name } => {
                let bad =
                    |e: String| ImagingError::Format { path: name.clone(), reason: format!("broken zip member: {e}; unpack the archive") };
                let mut archive = archive.clone();
                let member = archive.by_index(*index).map_err(|e| bad(e.to_string()))?;
                // Sizes were judged when the archive was opened; a member that holds more than it declares is an error here.
                member.take(most).read_to_end(&mut bytes).map_err(|e| bad(e.to_string()))?;
            }
        }
        Ok(bytes)
    }
}

/// All files of a folder, of a zip archive or of a DICOMDIR, in the order of their names; `None` when the path is any other file.
///
/// # Errors
/// Folders that cannot be read, broken archives, archives whose members overlap or unpack to many times their size, a DICOMDIR whose files are not there.
pub fn list(path: &Path) -> Result<Option<Vec<InputFile>>, ImagingError> {
    let files = if path.is_dir() {
        let mut found = Vec::new();
        walk(path, 0, &mut found)?;
        found.sort();
        found.into_iter().map(InputFile::OnDisk).collect()
    } else {
        let mut head = Vec::new();
        std::fs::File::open(path).and_then(|f| f.take(HEAD).read_to_end(&mut head)).map_err(ImagingError::io(path))?;
        if head.starts_with(b"PK\x03\x04") {
            members(path)?
        } else if is_dicom(&head) {
            match listed(path)? {
                Some(files) => files,
                None => return Ok(None),
            }
        } else {
            return Ok(None);
        }
    };
    Ok(Some(files))
}

fn walk(folder: &Path, depth: usize, found: &mut Vec<PathBuf>) -> Result<(), ImagingError> {
    for entry in std::fs::read_dir(folder).map_err(ImagingError::io(folder))? {
        let path = entry.map_err(ImagingError::io(folder))?.path();
        if path.is_dir() {
            if depth < MAX_DEPTH {
                walk(&path, depth + 1, found)?;
            }
        } else if path.is_file() {
            found.push(path);
        }
        if found.len() > MAX_FILES {
            return Err(ImagingError::Format {
                path: folder.into(),
                reason: format!("holds more than {MAX_FILES} files: give the series' own folder"),
            });
        }
    }
    Ok(())
}

fn members(path: &Path) -> Result<Vec<InputFile>, ImagingError> {
    let bytes: Arc<[u8]> = std::fs::read(path).map_err(ImagingError::io(path))?.into();
    let bad = |e: zip::result::ZipError| ImagingError::Format {
        path: path.into(),
        reason: format!("broken zip archive: {e}; unpack it and give the folder"),
    };
    let packed = bytes.len() as u64;
    let mut archive = zip::ZipArchive::new(Cursor::new(bytes)).map_err(bad)?;
    let refused = |reason: String| ImagingError::Format { path: path.into(), reason };
    let (mut names, mut places, mut unpacked) = (Vec::new(), Vec::new(), 0_u64);
    for index in 0..archive.len().min(MAX_FILES) {
        let member = archive.by_index_raw(index).map_err(bad)?;
        let end = member.data_start().unwrap_or(member.header_start()).saturating_add(member.compressed_size());
        places.push((member.header_start(), end));
        unpacked = unpacked.saturating_add(member.size());
        if member.is_file() {
            names.push((member.name().map(|n| n.into_owned()).unwrap_or_else(|_| format!("member {index}")), index));
        }
    }
    places.sort_unstable();
    if places.windows(2).any(|w| w[1].0 < w[0].1) || places.iter().any(|(_, end)| *end > packed) {
        return Err(refused("members of this zip archive share their bytes: it is damaged, or made to fill a disk; make it anew".into()));
    }
    if unpacked > UNPACKED.max(packed.saturating_mul(EXPANSION)) {
        let megabytes = unpacked >> 20;
        return Err(refused(format!(
            "this zip archive of {packed} bytes declares {megabytes} MB unpacked, more than {EXPANSION} times its size: if it is what it should be, unpack it and give the folder"
        )));
    }
    names.sort();
    Ok(names.into_iter().map(|(name, index)| InputFile::InZip { archive: archive.clone(), index, name: path.join(name) }).collect())
}

/// The files that a DICOMDIR lists (PS3.3 F.3), beside it; `None` when the file is another DICOM object.
fn listed(path: &Path) -> Result<Option<Vec<InputFile>>, ImagingError> {
    let object = dicom_file::open(path, Pixels::Skip)?;
    if object.meta().media_storage_sop_class_uid().trim_end_matches(['\0', ' ']) != uids::MEDIA_STORAGE_DIRECTORY_STORAGE {
        return Ok(None);
    }
    let e = Elements::new(path, &object);
    let folder = path.parent().unwrap_or(Path::new("."));
    let mut files = Vec::new();
    for record in e.items(tags::DIRECTORY_RECORD_SEQUENCE) {
        let Some(id) = record.get(tags::REFERENCED_FILE_ID) else { continue };
        let parts = id.to_multi_str().map_err(|e2| e.wrong(tags::REFERENCED_FILE_ID, format!("is no text ({e2})")))?;
        let parts: Vec<&str> = parts.iter().map(|p| p.trim_matches(['\0', ' '])).collect();
        // An ID names folders below the DICOMDIR; anything else leads out of the medium.
        if parts.iter().any(|p| p.is_empty() || *p == "." || *p == ".." || p.contains(['/', '\\'])) {
            return Err(e.wrong(tags::REFERENCED_FILE_ID, format!("is {}: expected names of folders and a file", parts.join("\\"))));
        }
        let file = parts.iter().fold(folder.to_path_buf(), |at, p| at.join(p));
        // Copied from a medium, names are often in lower case.
        let lower = parts.iter().fold(folder.to_path_buf(), |at, p| at.join(p.to_lowercase()));
        let file = if !file.is_file() && lower.is_file() { lower } else { file };
        if !file.is_file() {
            return Err(e.wrong(
                tags::REFERENCED_FILE_ID,
                format!("names {}, which is not there: copy the whole medium, or give its folder", file.display()),
            ));
        }
        files.push(file);
    }
    files.sort();
    files.dedup();
    Ok(Some(files.into_iter().map(InputFile::OnDisk).collect()))
}
