//! Recording what comes from outside, tick by tick, and playing it again to the same bits.
//!
//! The simulation is deterministic: with the same program, the same scene and the same [`TickInput`] in each tick it ends in the same bits. A
//! recording therefore holds inputs and no states, and digests of the states to prove it by.
//!
//! # The file
//! All numbers are little-endian.
//!
//! | bytes | what |
//! |---|---|
//! | 8 | `keyhole\0` |
//! | 4 | version of the format, [`FORMAT`] |
//! | 1 + n | version of the program: its length, then its text |
//! | blocks | to the end of the file |
//!
//! A block is its payload's length (4 bytes), the payload's CRC-32 (4 bytes) and the payload: [`postcard`](https://postcard.jamesmunns.com) of a
//! header, of a second of ticks, or of the end, deflated. The program's version stands outside of the blocks so that every version can name every other.
//! A block is written at least once a second in one go: a file that breaks off anywhere is played up to its last whole block.
//!
//! # Seeking
//! The file has no snapshots of states: what a solver takes from one tick to the next to start warm belongs to the state, and a second of it is larger than an
//! hour of inputs. Who plays a recording keeps checkpoints in memory ([`keyhole_whiteboard::Checkpoint`]) and goes on from the last before where it wants to
//! be; a restart of the scene is a checkpoint that costs nothing.

pub mod digest;
pub mod error;
pub mod event;
pub mod header;
pub mod player;
pub mod plugin;
pub mod reader;
mod wire;
pub mod writer;

pub use digest::{StateDigest, state_digest};
pub use error::RecordingError;
pub use event::{Event, TickInput};
pub use header::{FORMAT, Header, SceneIdentity};
pub use player::{Difference, Play, Position};
pub use plugin::{Player, PlayerSystems, Recorder, RecordingPlugin};
pub use reader::{BreakOff, Recording};
pub use writer::RecordingWriter;
