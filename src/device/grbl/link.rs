//! The line to a GRBL controller: bytes out, replies in, never waiting without
//! end, and what follows from replies that nobody asked for.

use std::os::fd::OwnedFd;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::codes;
use super::protocol::{
    Accessories, Dialect, LONGEST_LINE, MachineState, Reply, StatusReport, machine_state, parse,
};
use crate::device::guardian::Gate;
use crate::device::serial_line::{LineReader, SerialLine, printable};
use crate::device::{AlarmCause, DeviceError, FirmwareFault, Speaker};

/// Real-time command: report the status.
pub const STATUS: u8 = b'?';
/// Real-time command: brake and hold.
pub const HOLD: u8 = b'!';
/// Real-time command: restart the firmware at once; all outputs go off.
pub const RESET: u8 = 0x18;

/// An open line. Shared by the driver and its stop handles: any of them may
/// write real-time bytes at any moment, and whoever reads keeps [`Known`] true.
pub struct Link {
    line: SerialLine,
    known: Mutex<Known>,
    heard: Condvar,
}

/// What the replies so far say about the controller.
#[derive(Clone, Debug)]
pub struct Known {
    /// Why the position is unknown; `None` while it is known.
    pub unhomed_since: Option<String>,
    /// The alarm that was raised last, until homing succeeds.
    pub alarm: Option<(AlarmCause, String)>,
    /// How the firmware counts.
    pub dialect: Dialect,
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
        Ok(Self {
            line: SerialLine::open(path, baud)?.of(Speaker::Grbl),
            known: Mutex::new(Known {
                unhomed_since: Some("it was connected".to_owned()),
                alarm: None,
                dialect: Dialect::default(),
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
        self.line.device()
    }

    /// The open port once more, for another process.
    pub fn duplicate(&self) -> Result<OwnedFd, DeviceError> {
        self.line.duplicate()
    }

    /// What the port asks before each write.
    pub fn gate(&self) -> Gate {
        self.line.gate()
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
        self.line.send(bytes).map_err(|error| self.lost(error))
    }

    /// The next reply, or `None` if none came in time.
    pub fn receive(&self, deadline: Instant) -> Result<Option<Reply>, DeviceError> {
        self.receive_from(self.line.reader(), deadline)
    }

    /// Like [`receive`](Self::receive), but gives way at once to another reader.
    pub fn try_receive(&self, deadline: Instant) -> Result<(), DeviceError> {
        let Some(reader) = self.line.try_reader() else {
            let known = self.known();
            let wait = deadline.saturating_duration_since(Instant::now());
            let _unused = self.heard.wait_timeout(known, wait);
            return Ok(());
        };
        self.receive_from(reader, deadline).map(drop)
    }

    /// What a reply says is noted before another reader has its turn.
    fn receive_from(
        &self,
        mut reader: LineReader,
        deadline: Instant,
    ) -> Result<Option<Reply>, DeviceError> {
        let line = reader.line(LONGEST_LINE, deadline);
        let Some(line) = line.map_err(|error| self.lost(error))? else {
            return Ok(None);
        };
        let reply = parse(&line);
        self.note(&reply);
        Ok(Some(reply))
    }

    /// Every reply changes what is known, whoever it was for.
    fn note(&self, reply: &Reply) {
        let mut known = self.known();
        match reply {
            Reply::Banner { dialect, .. } => {
                known.dialect = *dialect;
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
                let (cause, reason) = codes::alarm(known.dialect, code);
                if known.restart_cause.is_none() {
                    known.unhomed_since = Some(reason.clone());
                }
                known.alarm = Some((cause, reason));
                // Either the firmware is deaf to all but a reset or its banner follows.
                known.needs_reset = true;
            }
            Reply::Status(report) => known.note_report(report),
            // All that is read of it: whether it stands.
            Reply::OldStatus(text) => {
                known.reports += 1;
                known.state = text[1..].split(',').next().and_then(machine_state);
            }
            Reply::Info { key, text } if key == "VER" => known.dialect = Dialect::of(text),
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

    /// The error for something sent and not answered; from now on replies may be late.
    pub fn no_reply(&self, sent: &[u8], timeout: Duration) -> DeviceError {
        let sent = printable(sent);
        self.distrust(&format!("{sent:?} was not answered"));
        self.line.no_reply(&sent, timeout)
    }

    /// The error for an answer that the protocol does not allow.
    pub fn garbled(&self, answer: &str, expected: &str) -> DeviceError {
        self.distrust("an answer was garbled");
        self.line.garbled(answer, expected)
    }

    /// The error for a command that is not taken.
    pub fn refused(&self, command: &str, reason: &str) -> DeviceError {
        self.line.refused(command, reason)
    }

    /// The error for a firmware that is not as it must be.
    pub fn firmware(&self, fault: FirmwareFault) -> DeviceError {
        DeviceError::Firmware {
            device: self.device().to_owned(),
            fault,
        }
    }

    fn distrust(&self, since: &str) {
        let mut known = self.known();
        known.needs_reset = true;
        known.unhomed_since.get_or_insert_with(|| since.to_owned());
    }

    /// A port that went away takes the position with it.
    fn lost(&self, error: DeviceError) -> DeviceError {
        if matches!(error, DeviceError::Disconnected { .. }) {
            self.forget_position("it was disconnected");
        }
        error
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
        let locked = [
            MachineState::Alarm,
            MachineState::Sleep,
            MachineState::ConfigAlarm,
        ];
        if locked.contains(&report.state) {
            self.unhomed_since
                .get_or_insert_with(|| "the firmware locked itself".to_owned());
        }
    }
}
