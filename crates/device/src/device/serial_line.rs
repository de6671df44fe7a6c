//! A serial port that carries bytes: opened with its lock, written and read by
//! deadline, never waited on without end. Protocols are built on it.

use std::fs::File;
use std::io::{Read, Write};
use std::os::fd::{AsRawFd, BorrowedFd, OwnedFd};
use std::sync::{Mutex, MutexGuard, PoisonError, TryLockError};
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use serialport::{ClearBuffer, ErrorKind, SerialPort, TTYPort};

use super::guardian::Gate;
use super::{DeviceError, Speaker};
use crate::units::Seconds;

/// How long the port may refuse to take bytes before it counts as stuck.
const WRITE_TIMEOUT: Duration = Duration::from_millis(500);

/// How often one that waits looks whether the port was taken over: the answers are
/// the guardian's then.
const LOOK: Duration = Duration::from_millis(50);

/// A line feed comes so soon after its carriage return, or not at all.
const AFTER_RETURN: Duration = Duration::from_millis(50);

/// How long another opener may take to let go of the port: a program that just
/// ends, a child between its fork and its exec, a service that probes new ports.
const BUSY_PATIENCE: Duration = Duration::from_secs(1);

/// An open port. A driver and its stop handles share it: anyone may write at
/// any moment, one at a time reads.
pub struct SerialLine {
    device: String,
    /// Keeps the settings and the lock; bytes go through `file`.
    _port: TTYPort,
    file: File,
    input: Mutex<Vec<u8>>,
    gate: Gate,
    speaks: Option<Speaker>,
}

impl SerialLine {
    /// Opens and configures the port (8 data bits, no parity, 1 stop bit), and
    /// drops what has come before. Nothing is sent. A port in use is waited for,
    /// a second at most.
    ///
    /// # Errors
    /// [`DeviceError::OnNetwork`] for an address in place of a path.
    pub fn open(path: &str, baud: u32) -> Result<Self, DeviceError> {
        if let Some(error) = DeviceError::of_address(path) {
            return Err(error);
        }
        let port = open_when_free(path, baud)?;
        let _ = port.clear(ClearBuffer::Input);
        // SAFETY: the descriptor is the port's, which is open until after the call.
        let descriptor = unsafe { BorrowedFd::borrow_raw(port.as_raw_fd()) };
        let file = descriptor
            .try_clone_to_owned()
            .map_err(|error| io_error(path, error))?;
        Ok(Self {
            device: path.to_owned(),
            _port: port,
            file: file.into(),
            input: Mutex::default(),
            gate: Gate::default(),
            speaks: None,
        })
    }

    /// The same, of which this one is expected to answer.
    pub fn of(self, speaker: Speaker) -> Self {
        Self {
            speaks: Some(speaker),
            ..self
        }
    }

    /// The port's path.
    pub fn device(&self) -> &str {
        &self.device
    }

    /// The open port once more, for another process.
    pub fn duplicate(&self) -> Result<OwnedFd, DeviceError> {
        let file = self.file.try_clone();
        Ok(file.map_err(|error| io_error(&self.device, error))?.into())
    }

    /// What is asked before each write: whoever takes the port over closes it.
    pub fn gate(&self) -> Gate {
        self.gate.clone()
    }

    /// Sends bytes.
    ///
    /// # Errors
    /// [`DeviceError::Relieved`] where the guardian has taken the port over.
    pub fn send(&self, bytes: &[u8]) -> Result<(), DeviceError> {
        let deadline = Instant::now() + WRITE_TIMEOUT;
        let mut left = bytes;
        while !left.is_empty() {
            if !self.wait_for(PollFlags::OUT, deadline)? {
                return Err(self.no_reply(&printable(bytes), WRITE_TIMEOUT));
            }
            self.gate.pass()?;
            let written = (&self.file)
                .write(left)
                .map_err(|error| io_error(&self.device, error))?;
            self.gate.passed()?;
            left = &left[written..];
        }
        Ok(())
    }

    /// An error where the port has gone away.
    pub fn check_connected(&self) -> Result<(), DeviceError> {
        self.wait_for(PollFlags::empty(), Instant::now()).map(drop)
    }

    /// The reading end, once it is free.
    pub fn reader(&self) -> LineReader<'_> {
        LineReader {
            input: self.input.lock().unwrap_or_else(PoisonError::into_inner),
            line: self,
        }
    }

    /// The reading end, if nobody reads.
    pub fn try_reader(&self) -> Option<LineReader<'_>> {
        let input = match self.input.try_lock() {
            Ok(input) => input,
            Err(TryLockError::Poisoned(error)) => error.into_inner(),
            Err(TryLockError::WouldBlock) => return None,
        };
        Some(LineReader { input, line: self })
    }

    /// The error for something sent and not answered.
    pub fn no_reply(&self, sent: &str, timeout: Duration) -> DeviceError {
        DeviceError::NoReply {
            device: self.device.clone(),
            timeout: Seconds(timeout.as_secs_f64()),
            sent: sent.to_owned(),
        }
    }

    /// The error for an answer that the protocol does not allow: by whom else it is,
    /// where it tells.
    pub fn garbled(&self, answer: &str, expected: &str) -> DeviceError {
        let device = self.device.clone();
        let (answer, expected) = (answer.to_owned(), expected.to_owned());
        match Speaker::of(&answer) {
            Some(speaks) if self.speaks != Some(speaks) => DeviceError::OtherProtocol {
                device,
                answer,
                speaks,
                expected,
            },
            _ => DeviceError::Garbled {
                device,
                answer,
                expected,
            },
        }
    }

    /// The error for a command that the device, or its driver, does not take.
    pub fn refused(&self, command: &str, reason: &str) -> DeviceError {
        DeviceError::Refused {
            device: self.device.clone(),
            command: command.to_owned(),
            reason: reason.to_owned(),
        }
    }

    /// Waits until the file is ready; false at the deadline.
    fn wait_for(&self, event: PollFlags, deadline: Instant) -> Result<bool, DeviceError> {
        loop {
            self.gate.pass()?;
            let all = deadline.saturating_duration_since(Instant::now());
            let left = match self.gate.is_kept() {
                true => all.min(LOOK),
                false => all,
            };
            let timeout = Timespec {
                tv_sec: left.as_secs() as i64,
                tv_nsec: i64::from(left.subsec_nanos()),
            };
            let mut descriptors = [PollFd::new(&self.file, event)];
            match poll(&mut descriptors, Some(&timeout)) {
                Ok(0) if left < all => {}
                Ok(0) => return Ok(false),
                Ok(_) => {
                    let ready = descriptors[0].revents();
                    if ready.contains(event) {
                        return Ok(true);
                    }
                    return Err(self.disconnected());
                }
                Err(rustix::io::Errno::INTR) => {}
                Err(error) => return Err(io_error(&self.device, error.into())),
            }
        }
    }

    fn disconnected(&self) -> DeviceError {
        DeviceError::Disconnected {
            device: self.device.clone(),
        }
    }
}

/// Bytes as a person reads them: text, or hexadecimal where they are none.
pub fn printable(bytes: &[u8]) -> String {
    match std::str::from_utf8(bytes) {
        Ok(text) if !text.trim_end().contains(char::is_control) => text.trim_end().to_owned(),
        _ => {
            let hex: Vec<_> = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
            format!("0x{}", hex.join(" "))
        }
    }
}

/// The right to read a [`SerialLine`].
pub struct LineReader<'a> {
    input: MutexGuard<'a, Vec<u8>>,
    line: &'a SerialLine,
}

impl LineReader<'_> {
    /// The next line with its end (a line feed, a carriage return or both), or `longest`
    /// bytes without one; `None` if neither came in time.
    pub fn line(
        &mut self,
        longest: usize,
        deadline: Instant,
    ) -> Result<Option<Vec<u8>>, DeviceError> {
        loop {
            let end = self.input.iter().position(|byte| b"\r\n".contains(byte));
            let mut until = deadline;
            if let Some(mut end) = end {
                let is_last = end + 1 == self.input.len();
                let ends_with_return = self.input[end] == b'\r';
                if !(is_last && ends_with_return) {
                    end += usize::from(ends_with_return && self.input[end + 1] == b'\n');
                    return Ok(Some(self.input.drain(..=end).collect()));
                }
                // A line feed may follow, or nothing.
                until = deadline.min(Instant::now() + AFTER_RETURN);
            } else if self.input.len() > longest {
                return Ok(Some(std::mem::take(&mut *self.input)));
            }
            match self.more(until)? {
                Some(bytes) => self.input.extend(bytes),
                None if end.is_some() => return Ok(Some(std::mem::take(&mut *self.input))),
                None => return Ok(None),
            }
        }
    }

    /// What has come, for protocols without lines; `None` if nothing came in time.
    pub fn bytes(&mut self, deadline: Instant) -> Result<Option<Vec<u8>>, DeviceError> {
        if !self.input.is_empty() {
            return Ok(Some(std::mem::take(&mut *self.input)));
        }
        self.more(deadline)
    }

    fn more(&self, deadline: Instant) -> Result<Option<Vec<u8>>, DeviceError> {
        loop {
            if !self.line.wait_for(PollFlags::IN, deadline)? {
                return Ok(None);
            }
            let mut bytes = [0; 256];
            match (&self.line.file).read(&mut bytes) {
                Ok(0) => return Err(self.line.disconnected()),
                Ok(count) => return Ok(Some(bytes[..count].to_vec())),
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
                Err(error) => return Err(io_error(&self.line.device, error)),
            }
        }
    }
}

fn open_when_free(path: &str, baud: u32) -> Result<TTYPort, DeviceError> {
    let deadline = Instant::now() + BUSY_PATIENCE;
    loop {
        let opened = serialport::new(path, baud)
            .timeout(WRITE_TIMEOUT)
            .open_native()
            .map_err(|error| open_error(path, error));
        match opened {
            Err(DeviceError::Busy { .. }) if Instant::now() < deadline => {
                std::thread::sleep(Duration::from_millis(20));
            }
            opened => return opened,
        }
    }
}

/// An error of the system while the port is open.
fn io_error(device: &str, source: std::io::Error) -> DeviceError {
    use rustix::io::Errno;
    let gone = [
        Errno::IO,
        Errno::NXIO,
        Errno::NODEV,
        Errno::PIPE,
        Errno::BADF,
    ];
    let device = device.to_owned();
    match Errno::from_io_error(&source) {
        Some(errno) if gone.contains(&errno) => DeviceError::Disconnected { device },
        _ => DeviceError::Io { device, source },
    }
}

/// What went wrong at opening, from `serialport`'s kinds: a port locked by
/// another opener is its `NoDevice`.
fn open_error(path: &str, error: serialport::Error) -> DeviceError {
    let device = path.to_owned();
    match error.kind {
        ErrorKind::NoDevice => DeviceError::Busy { device },
        ErrorKind::Io(std::io::ErrorKind::NotFound) => DeviceError::NotFound { device },
        ErrorKind::Io(std::io::ErrorKind::PermissionDenied) => {
            DeviceError::PermissionDenied { device }
        }
        ErrorKind::Io(kind) => DeviceError::Io {
            device,
            source: std::io::Error::new(kind, error.description),
        },
        _ => DeviceError::WrongKind {
            device,
            wanted: "serial port",
            why: error.description,
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_are_shown_as_text_where_they_are_text() {
        assert_eq!(printable(b"/1 home\n"), "/1 home");
        assert_eq!(printable(&[0x18]), "0x18");
        assert_eq!(printable(&[0x7e, 6, 0xff]), "0x7e 06 ff");
    }

    #[test]
    fn what_opening_meets_becomes_a_fact() {
        let message = |kind, text: &str| {
            open_error("/dev/ttyUSB0", serialport::Error::new(kind, text)).to_string()
        };
        for (kind, expected) in [
            (ErrorKind::NoDevice, "in use by another process"),
            (
                ErrorKind::Io(std::io::ErrorKind::NotFound),
                "does not exist",
            ),
            (
                ErrorKind::Io(std::io::ErrorKind::PermissionDenied),
                "permission denied",
            ),
            (ErrorKind::Unknown, "is not a serial port: Not a typewriter"),
        ] {
            let message = message(kind, "Not a typewriter");
            assert!(message.starts_with("/dev/ttyUSB0"), "{message}");
            assert!(message.ends_with(expected), "{message}");
        }
    }

    /// A program that has just closed a port may have a child that still holds it.
    #[test]
    fn a_port_that_is_let_go_of_soon_is_waited_for() {
        let pair = TTYPort::pair().unwrap();
        let path = pair.1.name().unwrap();
        drop(pair.1);
        let held = SerialLine::open(&path, 115_200).unwrap();
        std::thread::scope(|scope| {
            let again = scope.spawn(|| SerialLine::open(&path, 115_200));
            std::thread::sleep(Duration::from_millis(100));
            drop(held);
            assert!(again.join().unwrap().is_ok());
        });
        let held = SerialLine::open(&path, 115_200).unwrap();
        assert!(matches!(
            SerialLine::open(&path, 115_200),
            Err(DeviceError::Busy { .. })
        ));
        drop(held);
    }

    #[test]
    fn files_that_are_no_ports_are_refused() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let path = file.path().to_str().unwrap();
        assert!(matches!(
            SerialLine::open(path, 115_200),
            Err(DeviceError::WrongKind { .. })
        ));
        let missing = format!("{path}-missing");
        assert!(matches!(
            SerialLine::open(&missing, 115_200),
            Err(DeviceError::NotFound { .. })
        ));
    }
}
