//! A serial line that a driver shares with its stop handles: anyone may write at any moment,
//! and whoever reads notes for all what the replies report.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use super::serial_line::{LineReader, SerialLine};
use super::{DeviceError, Speaker};

/// What replies report of a stage whose position can become unknown.
pub trait Knowledge {
    /// Why the position is unknown; `None` while it is known.
    fn unhomed_since(&mut self) -> &mut Option<String>;
}

/// An open line with what is known of the device on it.
pub struct SharedLine<K> {
    line: SerialLine,
    known: Mutex<K>,
    /// Notified after each reply.
    replied: Condvar,
}

impl<K: Knowledge> SharedLine<K> {
    /// Opens and configures the port, on which this device is expected. Nothing is sent.
    pub(super) fn with(
        path: &str,
        baud: u32,
        speaker: Speaker,
        known: K,
    ) -> Result<Self, DeviceError> {
        Ok(Self {
            line: SerialLine::open(path, baud)?.of(speaker),
            known: Mutex::new(known),
            replied: Condvar::new(),
        })
    }

    /// The port and its errors.
    pub fn line(&self) -> &SerialLine {
        &self.line
    }

    /// What is known now.
    pub fn known(&self) -> MutexGuard<'_, K> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The position is unknown from now on.
    pub fn forget_position(&self, since: &str) {
        *self.known().unhomed_since() = Some(since.to_owned());
    }

    /// Sends bytes.
    pub fn send(&self, bytes: &[u8]) -> Result<(), DeviceError> {
        self.line.send(bytes).map_err(|error| self.lost(error))
    }

    /// Hands the next line, of at most `longest` bytes, to `note`, before another reader has
    /// its turn; `None` if none came in time.
    pub(super) fn read<T>(
        &self,
        longest: usize,
        deadline: Instant,
        note: impl FnOnce(&mut K, &[u8]) -> T,
    ) -> Result<Option<T>, DeviceError> {
        self.read_from(self.line.reader(), longest, deadline, note)
    }

    /// Like [`read`](Self::read), but where another reads, waits until that one has read a
    /// line.
    pub(super) fn read_or_wait<T>(
        &self,
        longest: usize,
        deadline: Instant,
        note: impl FnOnce(&mut K, &[u8]) -> T,
    ) -> Result<Option<T>, DeviceError> {
        let Some(reader) = self.line.try_reader() else {
            let known = self.known();
            let wait = deadline.saturating_duration_since(Instant::now());
            let _unused = self.replied.wait_timeout(known, wait);
            return Ok(None);
        };
        self.read_from(reader, longest, deadline, note)
    }

    fn read_from<T>(
        &self,
        mut reader: LineReader<'_>,
        longest: usize,
        deadline: Instant,
        note: impl FnOnce(&mut K, &[u8]) -> T,
    ) -> Result<Option<T>, DeviceError> {
        let line = reader.line(longest, deadline);
        let Some(line) = line.map_err(|error| self.lost(error))? else {
            return Ok(None);
        };
        let noted = note(&mut self.known(), &line);
        self.replied.notify_all();
        Ok(Some(noted))
    }

    /// A port that went away takes the position with it.
    fn lost(&self, error: DeviceError) -> DeviceError {
        if matches!(error, DeviceError::Disconnected { .. }) {
            self.forget_position("it was disconnected");
        }
        error
    }
}
