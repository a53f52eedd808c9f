//! Why a scene cannot be loaded or written.

use std::path::PathBuf;

/// What went wrong with a scene.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// The file cannot be read.
    #[error("{}: cannot be read: {source}: give the path of a scene (.scene.ron)", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The text is not a scene.
    #[error("{}:{line}:{column}: {what}", path.display())]
    Syntax {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// Column, from 1.
        column: usize,
        /// What is wrong and what to do.
        what: String,
    },
    /// The mesh of an organ cannot be used.
    #[error("organ \"{organ}\": {what}")]
    Mesh {
        /// The organ.
        organ: String,
        /// What is wrong, with the file.
        what: String,
    },
    /// A new scene would overwrite something.
    #[error("{}: is there already: a starter never overwrites, give another name or move it away", path.display())]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// The file cannot be written.
    #[error("{}: cannot be written: {source}: check that the folder is there and may be written to", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// No demonstration can be made for this mesh.
    #[error("{}: {what}", path.display())]
    Unsuited {
        /// The mesh.
        path: PathBuf,
        /// Why, and what to do.
        what: String,
    },
}
