//! Reading a recording up to its last whole block.

use crate::recording::error::RecordingError;
use crate::recording::event::Event;
use crate::recording::header::{FORMAT, Header, MAGIC, PROGRAM};
use crate::recording::wire::Block;
use flate2::read::DeflateDecoder;
use std::io::Read;
use std::path::Path;

/// Most bytes that a block may have, deflated or not: a thousand ticks have a fiftieth of it.
const LARGEST_BLOCK: usize = 1 << 24;

/// A recording in memory.
#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    /// What it starts with.
    pub header: Header,
    /// What happened.
    pub events: Vec<Event>,
    /// Full digests of states: how many events there were before each, and the digest after the last tick among them.
    pub digests: Vec<(usize, [u8; 32])>,
    /// Where and why it breaks off; `None` when it was ended.
    pub break_off: Option<BreakOff>,
}

/// Where a recording breaks off.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("breaks off at byte {byte}: {why}; what was recorded before is played")]
pub struct BreakOff {
    /// The first byte that is not part of a whole block.
    pub byte: usize,
    /// Why.
    pub why: String,
}

impl Recording {
    /// Reads a file.
    ///
    /// # Errors
    /// [`RecordingError::File`], else as [`Recording::parse`].
    pub fn read(path: &Path) -> Result<Self, RecordingError> {
        let bytes = std::fs::read(path).map_err(|source| RecordingError::File { path: path.into(), source })?;
        Self::parse(&bytes)
    }

    /// Reads bytes. What follows the last whole block is not read: [`Recording::break_off`] says so.
    ///
    /// # Errors
    /// [`RecordingError::NoRecording`], [`RecordingError::OtherVersion`], [`RecordingError::NoHeader`].
    pub fn parse(bytes: &[u8]) -> Result<Self, RecordingError> {
        let mut at = checked_start(bytes)?;
        let no_header = |byte| RecordingError::NoHeader { byte };
        let (block, next) = block(bytes, at).map_err(|_| no_header(at))?;
        let Block::Header(header) = block else { return Err(no_header(at)) };
        at = next;
        let mut recording = Self { header, events: Vec::new(), digests: Vec::new(), break_off: None };
        loop {
            match self::block(bytes, at) {
                Ok((Block::Events { events, digest }, next)) => {
                    recording.events.extend(events.into_iter().map(Event::from));
                    recording.digests.push((recording.events.len(), digest));
                    at = next;
                }
                Ok((Block::End, _)) => return Ok(recording),
                Ok((Block::Header(_), _)) => return Ok(recording.broken_off(at, "a second header")),
                Err(why) => return Ok(recording.broken_off(at, why)),
            }
        }
    }

    fn broken_off(mut self, byte: usize, why: &str) -> Self {
        self.break_off = Some(BreakOff { byte, why: why.into() });
        self
    }

    /// Number of ticks.
    #[must_use]
    pub fn ticks(&self) -> u64 {
        self.events.iter().filter(|e| matches!(e, Event::Tick { .. })).count() as u64
    }
}

/// Reads what stands before the blocks. Gives where they start.
fn checked_start(bytes: &[u8]) -> Result<usize, RecordingError> {
    let known = bytes.len().min(MAGIC.len());
    if bytes[..known] != MAGIC[..known] || known == 0 {
        return Err(RecordingError::NoRecording);
    }
    let short = RecordingError::NoHeader { byte: bytes.len() };
    let Some((format, rest)) = bytes.get(MAGIC.len()..).and_then(|b| b.split_first_chunk::<4>()) else { return Err(short) };
    let format = u32::from_le_bytes(*format);
    let Some((length, rest)) = rest.split_first() else { return Err(short) };
    let Some(program) = rest.get(..usize::from(*length)) else { return Err(short) };
    let program = String::from_utf8_lossy(program).into_owned();
    if format != FORMAT || program != PROGRAM {
        return Err(RecordingError::OtherVersion { program, format });
    }
    Ok(MAGIC.len() + 4 + 1 + usize::from(*length))
}

/// The block at a byte, and where the next one starts; or why there is none.
fn block(bytes: &[u8], at: usize) -> Result<(Block, usize), &'static str> {
    let rest = bytes.get(at..).unwrap_or_default();
    if rest.is_empty() {
        return Err("the file ends without its end mark");
    }
    let (head, rest) = rest.split_first_chunk::<8>().ok_or("the file ends within a block")?;
    let [a, b, c, d, sum @ ..] = *head;
    let length = u32::from_le_bytes([a, b, c, d]) as usize;
    if length > LARGEST_BLOCK {
        return Err("a block says that it is larger than any");
    }
    let payload = rest.get(..length).ok_or("the file ends within a block")?;
    if crc32fast::hash(payload) != u32::from_le_bytes(sum) {
        return Err("a block is not as it was written");
    }
    let mut plain = Vec::new();
    let read = DeflateDecoder::new(payload).take(LARGEST_BLOCK as u64).read_to_end(&mut plain);
    read.map_err(|_| "a block cannot be inflated")?;
    let block = postcard::from_bytes(&plain).map_err(|_| "a block means nothing")?;
    Ok((block, at + 8 + length))
}
