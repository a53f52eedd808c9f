//! What can be wrong with a device, its descriptor or its profile.

use std::path::PathBuf;

/// What is wrong with a report descriptor.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DescriptorError {
    /// Empty, or longer than any.
    #[error("the report descriptor has {bytes} bytes; one has between 1 and {most}")]
    Length {
        /// Its length.
        bytes: usize,
        /// The longest that is taken.
        most: usize,
    },
    /// An item that no device needs.
    #[error("the report descriptor's item at byte {offset}: {what}")]
    Item {
        /// Where the item begins.
        offset: usize,
        /// What is wrong with it.
        what: &'static str,
    },
    /// The parser gave up.
    #[error("the report descriptor cannot be understood: {0}")]
    Parser(String),
}

/// A rule of profiles that is broken: what was found and what was expected.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct RuleError(pub String);

/// What is wrong with a profile.
#[derive(Debug, thiserror::Error)]
pub enum ProfileError {
    /// It is no profile.
    #[error("{place}:{line}:{column}: {what}; assets/devices holds examples")]
    Syntax {
        /// The file, or the name of a shipped profile.
        place: String,
        /// Line, from 1.
        line: usize,
        /// Column, from 1.
        column: usize,
        /// What is wrong.
        what: String,
    },
    /// It says something that cannot be.
    #[error("{place}: {rule}")]
    Meaning {
        /// The file, or the name of a shipped profile.
        place: String,
        /// The rule that is broken.
        rule: RuleError,
    },
    /// It cannot be read.
    #[error("{}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// It cannot be said in RON.
    #[error("the profile cannot be written as RON: {0}")]
    Ron(#[from] ron::Error),
}

/// Why a profile does not fit a device.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FitError {
    /// The descriptor.
    #[error(transparent)]
    Descriptor(#[from] DescriptorError),
    /// A usage that the device does not have.
    #[error("{axis}: the device has no usage {page:#06x}:{usage:#06x} (number {nth}); `keyhole device monitor --raw` shows what it has")]
    NoUsage {
        /// What the usage was asked for.
        axis: String,
        /// Usage page.
        page: u16,
        /// Usage.
        usage: u16,
        /// Which of several.
        nth: u8,
    },
    /// A field that says nothing.
    #[error("{axis}: its counts begin and end at {at}: the profile has to say `counts`")]
    NoRange {
        /// What the field was asked for.
        axis: String,
        /// Both ends.
        at: i64,
    },
}

/// Why a device cannot be talked to.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TransportError {
    /// It may not be opened.
    #[error("{path} may not be opened: {rule}")]
    Denied {
        /// The device's file.
        path: String,
        /// What to do.
        rule: String,
    },
    /// It is not there any more.
    #[error("the device is gone: {0}")]
    Gone(String),
    /// It does not do what was asked.
    #[error("the device does not answer: {0}")]
    Fault(String),
}
