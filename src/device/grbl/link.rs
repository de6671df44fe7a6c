//! The line to a GRBL controller: bytes out, replies in, never waiting without
//! end, and what follows from replies that nobody asked for.

use std::fs::File;
use std::io::{Read, Write};
use std::os::fd::{AsRawFd, BorrowedFd, OwnedFd};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError, TryLockError};
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use serialport::{ClearBuffer, ErrorKind, SerialPort, TTYPort};

use super::codes;
use super::protocol::{Accessories, LONGEST_LINE, MachineState, Reply, StatusReport, parse};
use crate::device::DeviceError;
use crate::units::Seconds;

/// Real-time command: report the status.
pub const STATUS: u8 = b'?';
/// Real-time command: brake and hold.
pub const HOLD: u8 = b'!';
/// Real-time command: restart the firmware at once; all outputs go off.
pub const RESET: u8 = 0x18;

/// How long the port may refuse to take bytes before it counts as stuck.
const WRITE_TIMEOUT: Duration = Duration::from_millis(500);

/// An open line. Shared by the driver and its stop handles: any of them may
/// write real-time bytes at any moment, and whoever reads keeps [`Known`] true.
pub struct Link {
    device: String,
    /// Keeps the settings and the lock; bytes go through `file`.
    _port: TTYPort,
    file: File,
    input: Mutex<Vec<u8>>,
    known: Mutex<Known>,
    heard: Condvar,
}

/// What the replies so far say about the controller.
#[derive(Clone, Debug)]
pub struct Known {
    /// Why the position is unknown; `None` while it is known.
    pub unhomed_since: Option<String>,
    /// The alarm that was raised last, until homing succeeds.
    pub alarm: Option<String>,
    /// Replies may be late or the firmware locked up: reset it before going on.
    pub needs_reset: bool,
    /// Banners seen.
    pub restarts: u64,
    /// Status reports seen.
    pub reports: u64,
    /// Work coordinate offset of the last report that had one.
    pub work_offset: Option<Vec<f64>>,
    /// Outputs by the last report that had them.
    pub accessories: Option<Accessories>,
    /// Spindle speed by the last report that had it.
    pub speed: Option<f64>,
    /// What the machine is doing by the last report since the last restart.
    pub state: Option<MachineState>,
    /// A restart that is wanted, so that its banner is told as what caused it.
    pub restart_cause: Option<String>,
}

impl Link {
    /// Opens and configures the port. Nothing is sent.
    pub fn open(path: &str, baud: u32) -> Result<Self, DeviceError> {
        let port = serialport::new(path, baud)
            .timeout(WRITE_TIMEOUT)
            .open_native()
            .map_err(|error| open_error(path, error))?;
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
            known: Mutex::new(Known {
                unhomed_since: Some("it was connected".to_owned()),
                alarm: None,
                needs_reset: false,
                restarts: 0,
                reports: 0,
                work_offset: None,
                accessories: None,
                speed: None,
                state: None,
                restart_cause: None,
            }),
            heard: Condvar::new(),
        })
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

    /// What is known now.
    pub fn known(&self) -> MutexGuard<'_, Known> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The position is unknown from now on.
    pub fn forget_position(&self, since: &str) {
        self.known().unhomed_since = Some(since.to_owned());
    }

    /// Sends bytes.
    pub fn send(&self, bytes: &[u8]) -> Result<(), DeviceError> {
        let deadline = Instant::now() + WRITE_TIMEOUT;
        let mut left = bytes;
        while !left.is_empty() {
            if !self.wait_for(PollFlags::OUT, deadline)? {
                return Err(self.no_reply(bytes, WRITE_TIMEOUT));
            }
            let written = (&self.file)
                .write(left)
                .map_err(|error| io_error(&self.device, error))?;
            left = &left[written..];
        }
        Ok(())
    }

    /// The next reply, or `None` if none came in time.
    pub fn receive(&self, deadline: Instant) -> Result<Option<Reply>, DeviceError> {
        let mut input = self.input.lock().unwrap_or_else(PoisonError::into_inner);
        self.receive_into(&mut input, deadline)
    }

    /// Like [`receive`](Self::receive), but gives way at once to another reader.
    pub fn try_receive(&self, deadline: Instant) -> Result<(), DeviceError> {
        let mut input = match self.input.try_lock() {
            Ok(input) => input,
            Err(TryLockError::Poisoned(error)) => error.into_inner(),
            Err(TryLockError::WouldBlock) => {
                let known = self.known();
                let wait = deadline.saturating_duration_since(Instant::now());
                let _unused = self.heard.wait_timeout(known, wait);
                return Ok(());
            }
        };
        self.receive_into(&mut input, deadline).map(drop)
    }

    fn receive_into(
        &self,
        input: &mut Vec<u8>,
        deadline: Instant,
    ) -> Result<Option<Reply>, DeviceError> {
        loop {
            if let Some(end) = input.iter().position(|&byte| byte == b'\n') {
                let line: Vec<u8> = input.drain(..=end).collect();
                let reply = parse(&line);
                self.note(&reply);
                return Ok(Some(reply));
            }
            if input.len() > LONGEST_LINE {
                let line = std::mem::take(input);
                return Ok(Some(parse(&line)));
            }
            if !self.wait_for(PollFlags::IN, deadline)? {
                return Ok(None);
            }
            let mut bytes = [0; 256];
            match (&self.file).read(&mut bytes) {
                Ok(0) => return Err(self.disconnected()),
                Ok(count) => input.extend_from_slice(&bytes[..count]),
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
                Err(error) => return Err(io_error(&self.device, error)),
            }
        }
    }

    /// Every reply changes what is known, whoever it was for.
    fn note(&self, reply: &Reply) {
        let mut known = self.known();
        match reply {
            Reply::Banner(_) => {
                known.restarts += 1;
                let cause = known.restart_cause.clone();
                let cause = cause.unwrap_or_else(|| "the firmware restarted by itself".to_owned());
                known.unhomed_since = Some(cause);
                known.needs_reset = false;
                known.accessories = None;
                known.state = None;
                known.work_offset = None;
            }
            Reply::Alarm(code) => {
                let reason = codes::alarm(*code);
                if known.restart_cause.is_none() {
                    known.unhomed_since = Some(reason.clone());
                }
                known.alarm = Some(reason);
                // Either the firmware is deaf to all but a reset or its banner follows.
                known.needs_reset = true;
            }
            Reply::Status(report) => known.note_report(report),
            _ => {}
        }
        drop(known);
        self.heard.notify_all();
    }

    /// Reads and drops what has come already, until it is quiet for a moment.
    pub fn drain(&self) -> Result<(), DeviceError> {
        let end = Instant::now() + Duration::from_millis(500);
        while Instant::now() < end {
            if self
                .receive(Instant::now() + Duration::from_millis(20))?
                .is_none()
            {
                break;
            }
        }
        Ok(())
    }

    /// Restarts the firmware and waits for its banner, which it sends with all
    /// outputs off and all motion ended. Works beside another reader.
    pub fn restart(
        &self,
        brake_first: bool,
        cause: &str,
        timeout: Duration,
    ) -> Result<(), DeviceError> {
        let before = {
            let mut known = self.known();
            known.restart_cause = Some(cause.to_owned());
            known.unhomed_since = Some(cause.to_owned());
            known.restarts
        };
        let outcome = self.restart_and_wait(brake_first, before, timeout);
        self.known().restart_cause = None;
        outcome
    }

    fn restart_and_wait(
        &self,
        brake_first: bool,
        before: u64,
        timeout: Duration,
    ) -> Result<(), DeviceError> {
        // Two writes: a controller that misses one byte still gets the other.
        if brake_first {
            self.send(&[HOLD])?;
        }
        self.send(&[RESET])?;
        let deadline = Instant::now() + timeout;
        while self.known().restarts == before {
            let now = Instant::now();
            if now >= deadline {
                return Err(self.no_reply(&[RESET], timeout));
            }
            self.try_receive(deadline.min(now + Duration::from_millis(20)))?;
        }
        Ok(())
    }

    /// Waits until the file is ready; false at the deadline.
    fn wait_for(&self, event: PollFlags, deadline: Instant) -> Result<bool, DeviceError> {
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            let timeout = Timespec {
                tv_sec: left.as_secs() as i64,
                tv_nsec: i64::from(left.subsec_nanos()),
            };
            let mut descriptors = [PollFd::new(&self.file, event)];
            match poll(&mut descriptors, Some(&timeout)) {
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

    /// The error for something sent and not answered; from now on replies may be late.
    pub fn no_reply(&self, sent: &[u8], timeout: Duration) -> DeviceError {
        let sent = match sent {
            [RESET] => "0x18".to_owned(),
            bytes => String::from_utf8_lossy(bytes).trim_end().to_owned(),
        };
        self.distrust(&format!("{sent:?} was not answered"));
        DeviceError::NoReply {
            device: self.device.clone(),
            timeout: Seconds(timeout.as_secs_f64()),
            sent,
        }
    }

    /// The error for an answer that the protocol does not allow.
    pub fn garbled(&self, answer: &str, expected: &str) -> DeviceError {
        self.distrust("an answer was garbled");
        DeviceError::Garbled {
            device: self.device.clone(),
            answer: answer.to_owned(),
            expected: expected.to_owned(),
        }
    }

    fn distrust(&self, since: &str) {
        let mut known = self.known();
        known.needs_reset = true;
        known.unhomed_since.get_or_insert_with(|| since.to_owned());
    }

    fn disconnected(&self) -> DeviceError {
        self.forget_position("it was disconnected");
        DeviceError::Disconnected {
            device: self.device.clone(),
        }
    }
}

impl Known {
    fn note_report(&mut self, report: &StatusReport) {
        self.reports += 1;
        self.state = Some(report.state);
        if report.work_offset.is_some() {
            self.work_offset.clone_from(&report.work_offset);
        }
        if report.accessories.is_some() {
            self.accessories = report.accessories;
        }
        if report.speed.is_some() {
            self.speed = report.speed;
        }
        if matches!(report.state, MachineState::Alarm | MachineState::Sleep) {
            self.unhomed_since
                .get_or_insert_with(|| "the firmware locked itself".to_owned());
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
        _ => DeviceError::Io {
            device,
            source: std::io::Error::other(format!("not a serial port: {}", error.description)),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
            (ErrorKind::Unknown, "not a serial port: Not a typewriter"),
        ] {
            let message = message(kind, "Not a typewriter");
            assert!(message.starts_with("/dev/ttyUSB0"), "{message}");
            assert!(message.ends_with(expected), "{message}");
        }
    }

    #[test]
    fn files_that_are_no_ports_are_refused() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let path = file.path().to_str().unwrap();
        assert!(matches!(
            Link::open(path, 115_200),
            Err(DeviceError::Io { .. })
        ));
        let missing = format!("{path}-missing");
        assert!(matches!(
            Link::open(&missing, 115_200),
            Err(DeviceError::NotFound { .. })
        ));
    }
}
