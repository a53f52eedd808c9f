//! Writing a recording, block by block.

use crate::recording::digest::StateDigest;
use crate::recording::error::RecordingError;
use crate::recording::event::{Event, TickInput};
use crate::recording::header::{FORMAT, Header, MAGIC, PROGRAM};
use crate::recording::wire::{Block, WireEvent};
use flate2::Compression;
use flate2::write::DeflateEncoder;
use std::io::Write;
use std::path::Path;
use std::time::{Duration, Instant};

/// Longest time for which events wait to be written, on the wall's clock and on the simulation's.
const LONGEST_WAIT: Duration = Duration::from_secs(1);

/// A recording that is being written. What is left when it is dropped is written then.
pub struct RecordingWriter {
    out: Box<dyn Write + Send + Sync>,
    waiting: Vec<WireEvent>,
    digest: [u8; 32],
    written: Instant,
    ticks_a_block: usize,
    /// Nothing more is written: it has ended, or writing failed.
    closed: bool,
}

impl RecordingWriter {
    /// A recording in a new file. Unlike other results it stands under its own name at once: that is what a program that was killed leaves.
    ///
    /// # Errors
    /// [`RecordingError::File`] when the file cannot be made, or is there already.
    pub fn create(path: &Path, header: &Header) -> Result<Self, RecordingError> {
        let file = std::fs::File::create_new(path).map_err(|source| RecordingError::File { path: path.into(), source })?;
        Self::new(file, header)
    }

    /// A recording in any stream. Each block is written in one go, followed by a flush.
    ///
    /// # Errors
    /// When the header cannot be written.
    pub fn new(out: impl Write + Send + Sync + 'static, header: &Header) -> Result<Self, RecordingError> {
        let ticks_a_block = (LONGEST_WAIT.as_nanos() as u64 / header.tick_ns.max(1)).clamp(1, 1000) as usize;
        let mut writer =
            Self { out: Box::new(out), waiting: Vec::new(), digest: [0; 32], written: Instant::now(), ticks_a_block, closed: false };
        let mut start = MAGIC.to_vec();
        start.extend_from_slice(&FORMAT.to_le_bytes());
        start.push(PROGRAM.len() as u8);
        start.extend_from_slice(PROGRAM.as_bytes());
        start.extend(encode(&Block::Header(header.clone()))?);
        writer.put(&start)?;
        Ok(writer)
    }

    /// Takes down a tick that has ended, and writes what waits once it is a second of ticks.
    ///
    /// # Errors
    /// When writing fails; the recording is closed then.
    pub fn tick(&mut self, input: &TickInput, digest: StateDigest) -> Result<(), RecordingError> {
        self.digest = digest.bytes();
        self.push(Event::Tick { input: *input, mark: digest.mark() })
    }

    /// Takes down that the scene is started over.
    ///
    /// # Errors
    /// As [`RecordingWriter::tick`].
    pub fn reset(&mut self, clock: u64) -> Result<(), RecordingError> {
        self.push(Event::Reset { clock })
    }

    fn push(&mut self, event: Event) -> Result<(), RecordingError> {
        if self.closed {
            return Ok(());
        }
        self.waiting.push(WireEvent::from(&event));
        if self.waiting.len() >= self.ticks_a_block { self.write() } else { Ok(()) }
    }

    /// Writes what has waited for a second on the wall's clock, however few ticks that were.
    ///
    /// # Errors
    /// As [`RecordingWriter::tick`].
    pub fn write_if_due(&mut self) -> Result<(), RecordingError> {
        if self.written.elapsed() >= LONGEST_WAIT { self.write() } else { Ok(()) }
    }

    /// Writes what waits.
    ///
    /// # Errors
    /// As [`RecordingWriter::tick`].
    pub fn write(&mut self) -> Result<(), RecordingError> {
        if self.closed || self.waiting.is_empty() {
            return Ok(());
        }
        let block = encode(&Block::Events { events: std::mem::take(&mut self.waiting), digest: self.digest })?;
        self.put(&block)
    }

    /// Ends the recording.
    ///
    /// # Errors
    /// As [`RecordingWriter::tick`].
    pub fn finish(&mut self) -> Result<(), RecordingError> {
        self.write()?;
        if !self.closed {
            let end = encode(&Block::End)?;
            self.put(&end)?;
            self.closed = true;
        }
        Ok(())
    }

    fn put(&mut self, bytes: &[u8]) -> Result<(), RecordingError> {
        self.written = Instant::now();
        self.out.write_all(bytes).and_then(|()| self.out.flush()).map_err(|error| {
            self.closed = true;
            error.into()
        })
    }
}

impl Drop for RecordingWriter {
    fn drop(&mut self) {
        if let Err(error) = self.finish() {
            tracing::error!("{error}");
        }
    }
}

/// A block with its length and checksum.
fn encode(block: &Block) -> Result<Vec<u8>, RecordingError> {
    let plain = postcard::to_stdvec(block).map_err(RecordingError::Encode)?;
    let mut bytes = vec![0; 8];
    let mut encoder = DeflateEncoder::new(&mut bytes, Compression::default());
    encoder.write_all(&plain)?;
    encoder.finish()?;
    let (length, sum) = ((bytes.len() - 8) as u32, crc32fast::hash(&bytes[8..]));
    bytes[..4].copy_from_slice(&length.to_le_bytes());
    bytes[4..8].copy_from_slice(&sum.to_le_bytes());
    Ok(bytes)
}
