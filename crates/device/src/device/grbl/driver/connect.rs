//! From opening the port until the firmware is known: that it speaks, which it is, and
//! whether it is set up as a stage needs it.

use std::time::{Duration, Instant};

use super::GrblStage;
use crate::device::grbl::link::{RESET, STATUS, is_restart};
use crate::device::grbl::protocol::{Reply, is_old};
use crate::device::{DeviceError, FirmwareFault, Speaker};

/// How long a version before 1.1 may take to say which it is.
const VERSION_PATIENCE: Duration = Duration::from_secs(1);

/// What came instead of a status report.
#[derive(Default)]
struct Heard {
    /// The last line.
    last: Option<String>,
    /// The first line that tells who speaks.
    other: Option<String>,
    /// The last report of the processor that it restarts.
    restart: Option<String>,
    /// A line was accepted.
    is_accepted: bool,
}

impl Heard {
    fn note(&mut self, text: String) {
        if is_restart(&text) {
            self.restart = Some(text.clone());
        }
        if Speaker::of(&text).is_some_and(|speaker| speaker != Speaker::Grbl) {
            self.other.get_or_insert_with(|| text.clone());
        }
        self.last = Some(text);
    }

    fn is_nothing(&self) -> bool {
        self.last.is_none() && !self.is_accepted
    }
}

impl GrblStage {
    /// Asks until the firmware speaks. If it stays silent for half of the time it
    /// may be locked up by a limit switch, which only a reset ends. Controllers of other
    /// kinds answer whole lines alone, so that an empty one is tried last.
    pub(super) fn wait_until_alive(&self) -> Result<(), DeviceError> {
        let timeout = self.config.connect_timeout.to_duration();
        let start = Instant::now();
        let mut heard = Heard::default();
        let (mut was_reset, mut was_tried) = (false, false);
        while start.elapsed() < timeout && !(was_tried && heard.other.is_some()) {
            if !was_reset && start.elapsed() > timeout / 2 {
                was_reset = true;
                self.link.send(&[RESET])?;
            }
            if !was_tried && start.elapsed() > timeout * 3 / 4 && heard.is_nothing() {
                was_tried = true;
                self.link.send(b"\n")?;
            }
            self.link.send(&[STATUS])?;
            let next = Instant::now() + (timeout / 10).min(Duration::from_millis(250));
            while let Some(reply) = self.link.receive(next)? {
                match reply {
                    Reply::Banner { version, .. } if is_old(&version) => {
                        return Err(self.old(&version));
                    }
                    Reply::OldStatus(_) => return Err(self.old_by_status()),
                    Reply::Status(_) | Reply::Banner { .. } => {
                        self.link.drain()?;
                        let mut known = self.link.known();
                        known.unhomed_since = Some("it was connected".to_owned());
                        known.undervoltage = None;
                        return Ok(());
                    }
                    Reply::Unknown(text) => heard.note(text),
                    Reply::Ok => heard.is_accepted = true,
                    _ => {}
                }
            }
        }
        Err(self.no_grbl(heard, timeout))
    }

    /// What is on the port instead.
    fn no_grbl(&self, heard: Heard, timeout: Duration) -> DeviceError {
        let expected = "a GRBL status report";
        match heard.other.or(heard.restart).or(heard.last) {
            Some(text) => self.link.garbled(&text, expected),
            // Whatever it accepts, it gives no reports.
            None if heard.is_accepted => DeviceError::OtherProtocol {
                device: self.link.line().device().to_owned(),
                answer: "ok".to_owned(),
                speaks: Speaker::Marlin,
                expected: expected.to_owned(),
            },
            None => self.link.no_reply(&[STATUS], timeout),
        }
    }

    fn old(&self, version: &str) -> DeviceError {
        self.link.firmware(FirmwareFault::Old {
            is: format!("GRBL {version}"),
            needed: "GRBL 1.1",
        })
    }

    /// A version before 1.1 has answered; which one, it reports itself.
    pub(super) fn old_by_status(&self) -> DeviceError {
        let deadline = Instant::now() + VERSION_PATIENCE;
        if let Err(error) = self.link.send(b"$I\n") {
            return error;
        }
        while let Ok(Some(reply)) = self.link.receive(deadline) {
            match reply {
                // `[0.9j.20160316:]`: version and date.
                Reply::Info { key, .. } if is_old(&key) => {
                    let version = key.rsplit_once('.').map_or(&*key, |(version, _)| version);
                    return self.old(version);
                }
                Reply::Banner { version, .. } => return self.old(&version),
                Reply::Ok => break,
                _ => {}
            }
        }
        self.old("0.9 or older")
    }

    pub(super) fn identify(&mut self) -> Result<(), DeviceError> {
        for reply in self.command("$I", self.reply_timeout())? {
            if let Reply::Info { key, text } = reply
                && key == "VER"
            {
                // Stock GRBL has no watchdog; builds with one say so in their name.
                self.info.has_watchdog = text.contains("host-watchdog=");
                self.info.firmware = text.trim_end_matches(':').to_owned();
            }
        }
        for reply in self.command("$$", self.reply_timeout())? {
            if let Reply::Setting { number, value } = reply {
                self.settings.insert(number, value);
            }
        }
        // grblHAL's lathe mode ($32=2) leaves the outputs alone.
        if let Some(mode) = self.setting(32).filter(|&mode| mode != 0.0 && mode != 2.0) {
            return Err(self.link.firmware(FirmwareFault::LaserMode(mode)));
        }
        if let Some(inches) = self.setting(13).filter(|&inches| inches != 0.0) {
            return Err(self.link.firmware(FirmwareFault::Inches(inches)));
        }
        Ok(())
    }
}
