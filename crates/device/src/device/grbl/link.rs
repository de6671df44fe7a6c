//! The line to a GRBL controller: bytes out, replies in, never waiting without
//! end, and what follows from unsolicited replies.

use std::time::{Duration, Instant};

use super::codes;
use super::protocol::{
    Accessories, Dialect, LONGEST_LINE, MachineState, Reply, StatusReport, machine_state, parse,
};
use crate::device::serial_line::printable;
use crate::device::shared_line::{Knowledge, SharedLine};
use crate::device::{AlarmCause, DeviceError, FirmwareFault, Speaker};

/// Real-time command: report the status.
pub const STATUS: u8 = b'?';
/// Real-time command: brake and hold.
pub const HOLD: u8 = b'!';
/// Real-time command: restart the firmware at once; all outputs go off.
pub const RESET: u8 = 0x18;

/// An open line to a controller.
pub type Link = SharedLine<Known>;

/// What the replies so far report about the controller.
#[derive(Clone, Debug, Default)]
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
    /// Some report named its outputs: there are builds that never do.
    pub reports_outputs: bool,
    /// Spindle speed by the last report that had it.
    pub speed: Option<f64>,
    /// What the machine is doing by the last report since the last restart.
    pub state: Option<MachineState>,
    /// A message that the supply voltage fell, until the firmware has started.
    pub undervoltage: Option<String>,
    /// A restart that is wanted, so that its banner is reported as what caused it.
    pub restart_cause: Option<String>,
}

impl Knowledge for Known {
    fn unhomed_since(&mut self) -> &mut Option<String> {
        &mut self.unhomed_since
    }
}

impl SharedLine<Known> {
    /// Opens and configures the port. Nothing is sent.
    pub fn open(path: &str, baud: u32) -> Result<Self, DeviceError> {
        let known = Known {
            unhomed_since: Some("it was connected".to_owned()),
            ..Known::default()
        };
        Self::with(path, baud, Speaker::Grbl, known)
    }

    /// The next reply, or `None` if none came in time.
    pub fn receive(&self, deadline: Instant) -> Result<Option<Reply>, DeviceError> {
        self.read(LONGEST_LINE, deadline, Known::note)
    }

    /// Like [`receive`](Self::receive), but gives way at once to another reader.
    pub fn try_receive(&self, deadline: Instant) -> Result<(), DeviceError> {
        let reply = self.read_or_wait(LONGEST_LINE, deadline, Known::note);
        reply.map(drop)
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
    /// outputs off and all motion ended. Another reader may be at work.
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
        let silent = self.line().no_reply(&sent, timeout);
        self.undervoltage().unwrap_or(silent)
    }

    /// The error for an answer that the protocol does not allow.
    pub fn garbled(&self, answer: &str, expected: &str) -> DeviceError {
        self.distrust("an answer was garbled");
        let garbled = self.line().garbled(answer, expected);
        let named = match is_restart(answer) {
            true => self.firmware(FirmwareFault::Restarting(answer.to_owned())),
            false => garbled,
        };
        self.undervoltage().unwrap_or(named)
    }

    /// The error for a controller whose supply voltage fell, if it says so.
    pub fn undervoltage(&self) -> Option<DeviceError> {
        let said = self.known().undervoltage.clone();
        said.map(|said| self.firmware(FirmwareFault::Undervoltage(said)))
    }

    /// The error for a firmware that is not as it must be.
    pub fn firmware(&self, fault: FirmwareFault) -> DeviceError {
        DeviceError::Firmware {
            device: self.line().device().to_owned(),
            fault,
        }
    }

    fn distrust(&self, since: &str) {
        let mut known = self.known();
        known.needs_reset = true;
        known.unhomed_since.get_or_insert_with(|| since.to_owned());
    }
}

impl Known {
    /// Every reply changes what is known, whoever it was for.
    fn note(&mut self, line: &[u8]) -> Reply {
        let reply = parse(line);
        match &reply {
            Reply::Banner { dialect, .. } => {
                self.dialect = *dialect;
                self.restarts += 1;
                let cause = self.restart_cause.clone();
                let by_itself = match self.undervoltage.take() {
                    Some(_) => "its supply voltage fell and it restarted",
                    None => "the firmware restarted by itself",
                };
                self.unhomed_since = Some(cause.unwrap_or_else(|| by_itself.to_owned()));
                self.needs_reset = false;
                self.accessories = None;
                self.state = None;
                self.work_offset = None;
            }
            Reply::Alarm(code) => {
                let (cause, reason) = codes::alarm(self.dialect, code);
                if self.restart_cause.is_none() {
                    self.unhomed_since = Some(reason.clone());
                }
                self.alarm = Some((cause, reason));
                // Either the firmware takes nothing but a reset or its banner follows.
                self.needs_reset = true;
            }
            Reply::Status(report) => self.note_report(report),
            // All that is read of it: whether it stands.
            Reply::OldStatus(text) => {
                self.reports += 1;
                self.state = text[1..].split(',').next().and_then(machine_state);
            }
            Reply::Info { key, text } if key == "VER" => self.dialect = Dialect::of(text),
            Reply::Unknown(text) if is_undervoltage(text) => {
                self.undervoltage = Some(text.clone());
            }
            _ => {}
        }
        reply
    }

    fn note_report(&mut self, report: &StatusReport) {
        self.reports += 1;
        self.state = Some(report.state);
        if report.work_offset.is_some() {
            self.work_offset.clone_from(&report.work_offset);
        }
        if report.accessories.is_some() {
            self.accessories = report.accessories;
            self.reports_outputs = true;
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

/// Whether a processor reports that it restarts, as the boot loaders of ESP32 and ESP8266 do.
pub(super) fn is_restart(text: &str) -> bool {
    ["rst:0x", "rst cause:"]
        .iter()
        .any(|start| text.contains(start))
}

/// Whether a processor reports that it restarts because its supply voltage fell, as those of
/// Espressif do: `Brownout detector was triggered`, `rst:0xf (RTCWDT_BROWN_OUT_RESET)`.
fn is_undervoltage(text: &str) -> bool {
    let text = text.to_ascii_lowercase().replace(['_', '-', ' '], "");
    text.contains("brownout")
}
