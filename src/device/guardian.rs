//! The guardian: a small process that holds the stage's port and stops the stage
//! when this process is gone, even if it was killed outright.
//!
//! It is a child that waits at the end of a pipe. The system closes the pipe
//! when this process ends, however it ends; unless the child was dismissed
//! before, it then sends the bytes that stop the stage over the same open port
//! (which needs no opening, so that no lock stands in the way and no board
//! resets), and asks until the stage confirms.

use std::fs::File;
use std::io::{self, Read, Write};
use std::os::fd::OwnedFd;
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, Stdio};
use std::str::FromStr;
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::termios::{QueueSelector, tcflush};

use super::{
    DeviceError, LampState, LightStage, ReferenceCheck, StageActivity, StageInfo, StageStatus,
    StopHandle,
};
use crate::units::StageAngles;

/// Within this time after the loss the stage is stopped, or the guardian gives up.
pub const DEADLINE: Duration = Duration::from_secs(3);
/// An answer that takes longer is not waited for; everything is sent again.
const PATIENCE: Duration = Duration::from_millis(700);
/// What dismisses a guardian.
const DISMISSAL: u8 = b'.';

/// Bytes for the device and what it answers to them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Exchange {
    /// Sent at once.
    pub send: Vec<u8>,
    /// One of these is in the answer; empty: none is waited for.
    pub answers: Vec<Vec<u8>>,
}

impl Exchange {
    /// From bytes and the answers that confirm them.
    pub fn new(send: &[u8], answers: &[&[u8]]) -> Self {
        Self {
            send: send.to_owned(),
            answers: answers.iter().map(|answer| answer.to_vec()).collect(),
        }
    }
}

/// `21=` or `3f=3c49646c65,3c416c61726d`: hexadecimal, as it fits a command line.
impl std::fmt::Display for Exchange {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let hex = |bytes: &[u8]| -> String { bytes.iter().map(|b| format!("{b:02x}")).collect() };
        let answers: Vec<String> = self.answers.iter().map(|a| hex(a)).collect();
        write!(f, "{}={}", hex(&self.send), answers.join(","))
    }
}

impl FromStr for Exchange {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let bytes = |hex: &str| -> Option<Vec<u8>> {
            let (pairs, []) = hex.as_bytes().as_chunks::<2>() else {
                return None;
            };
            pairs
                .iter()
                .map(|pair| u8::from_str_radix(str::from_utf8(pair).ok()?, 16).ok())
                .collect()
        };
        let parsed = text.split_once('=').and_then(|(send, answers)| {
            let answers = answers.split(',').filter(|answer| !answer.is_empty());
            Some(Self {
                send: bytes(send)?,
                answers: answers.map(bytes).collect::<Option<_>>()?,
            })
        });
        parsed.ok_or_else(|| format!("{text:?} is not hexadecimal bytes=answer,answer"))
    }
}

/// How a stage is stopped over its open port by whoever holds it: lamp off,
/// motion ended, and the device's word for it.
#[derive(Debug)]
pub struct PortStop {
    /// The open port, a duplicate of the driver's own.
    pub port: OwnedFd,
    /// What the port is called.
    pub name: String,
    /// In this order.
    pub exchanges: Vec<Exchange>,
    /// Whether the stage says if its lamp is lit. Otherwise what it confirms is
    /// that it was told.
    pub reports_lamp: bool,
}

/// The child process. Unless [dismissed](Self::dismiss) it stops the stage when
/// this is dropped, or when this process ends.
#[derive(Debug)]
pub struct Guardian(Child);

impl Guardian {
    /// Starts it. `command` shall call [`stand_guard`] with its standard input
    /// and output, which are the pipe and the port.
    pub fn spawn(mut command: Command, stop: PortStop) -> io::Result<Self> {
        command
            .stdin(Stdio::piped())
            .stdout(Stdio::from(stop.port))
            // Ctrl-C and a closed terminal are meant for this process alone.
            .process_group(0)
            .current_dir("/")
            .spawn()
            .map(Self)
    }

    /// Ends it: the stage is safe.
    pub fn dismiss(mut self) {
        if let Some(pipe) = &mut self.0.stdin {
            // One that is gone already needs no dismissal.
            drop(pipe.write_all(&[DISMISSAL]));
        }
    }
}

impl Drop for Guardian {
    fn drop(&mut self) {
        drop(self.0.stdin.take());
        // It ends by its deadline, and the port is free only then.
        drop(self.0.wait());
    }
}

/// How a guardian's watch ended.
#[derive(Debug)]
pub enum Watch {
    /// It was dismissed and has done nothing.
    Dismissed,
    /// The pipe was closed without a dismissal; whether the stage confirmed that
    /// it has stopped.
    Acted(io::Result<()>),
}

/// Waits at the pipe; when that is closed without a dismissal, stops the stage.
pub fn stand_guard(mut pipe: impl Read, port: OwnedFd, exchanges: &[Exchange]) -> Watch {
    let mut byte = [0];
    loop {
        match pipe.read(&mut byte) {
            Ok(1) if byte[0] == DISMISSAL => return Watch::Dismissed,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Ok(1) => {}
            _ => return Watch::Acted(stop(&File::from(port), exchanges)),
        }
    }
}

fn stop(port: &File, exchanges: &[Exchange]) -> io::Result<()> {
    let end = Instant::now() + DEADLINE;
    // What waits to be sent would come before the stop; not every port can.
    let _ = tcflush(port, QueueSelector::OFlush);
    while Instant::now() < end {
        let mut confirmed = true;
        for exchange in exchanges {
            confirmed &= perform(port, exchange, end)?;
        }
        if confirmed {
            return Ok(());
        }
    }
    Err(io::Error::new(
        io::ErrorKind::TimedOut,
        format!("no confirmation within {} s", DEADLINE.as_secs()),
    ))
}

/// Whether the device gave one of the answers in time.
fn perform(mut port: &File, exchange: &Exchange, end: Instant) -> io::Result<bool> {
    let until = end.min(Instant::now() + PATIENCE);
    let mut heard = Vec::new();
    let mut buffer = [0; 256];
    // What was said before is no answer.
    while is_ready(port, PollFlags::IN, Instant::now())? && port.read(&mut buffer)? > 0 {}
    if !is_ready(port, PollFlags::OUT, until)? {
        return Ok(false);
    }
    port.write_all(&exchange.send)?;
    loop {
        let mut answers = exchange.answers.iter();
        if exchange.answers.is_empty()
            || answers.any(|answer| heard.windows(answer.len()).any(|part| part == answer))
        {
            return Ok(true);
        }
        if !is_ready(port, PollFlags::IN, until)? {
            return Ok(false);
        }
        match port.read(&mut buffer)? {
            0 => return Err(io::ErrorKind::UnexpectedEof.into()),
            count => heard.extend_from_slice(&buffer[..count]),
        }
    }
}

fn is_ready(port: &File, event: PollFlags, until: Instant) -> io::Result<bool> {
    loop {
        let left = until.saturating_duration_since(Instant::now());
        let timeout = Timespec {
            tv_sec: left.as_secs() as i64,
            tv_nsec: i64::from(left.subsec_nanos()),
        };
        let mut descriptors = [PollFd::new(port, event)];
        match poll(&mut descriptors, Some(&timeout)) {
            Ok(0) => return Ok(false),
            Ok(_) if descriptors[0].revents().contains(event) => return Ok(true),
            Ok(_) => return Err(io::ErrorKind::BrokenPipe.into()),
            Err(rustix::io::Errno::INTR) => {}
            Err(error) => return Err(error.into()),
        }
    }
}

/// A stage whose guardian lives as long as it does. When it is dropped and the
/// stage does not say that its lamp is off and that it stands, the guardian
/// stops it.
pub struct GuardedStage {
    /// Always there until the drop.
    stage: Option<Box<dyn LightStage>>,
    info: StageInfo,
    guardian: Option<Guardian>,
    reports_lamp: bool,
    /// Whether the last command about the lamp turned it off.
    told_off: bool,
}

impl GuardedStage {
    /// Starts a guardian for the stage, where it has a port to stop it by.
    /// `command` gives the program and all its arguments but the exchanges,
    /// which are added, each after `--exchange`, and `--unverified` where the
    /// lamp is not reported.
    pub fn guard(
        stage: Box<dyn LightStage>,
        command: impl FnOnce(&str) -> Command,
    ) -> Result<Box<dyn LightStage>, DeviceError> {
        let Some(stop) = stage.port_stop()? else {
            return Ok(stage);
        };
        let mut command = command(&stop.name);
        for exchange in &stop.exchanges {
            command.arg("--exchange").arg(exchange.to_string());
        }
        if !stop.reports_lamp {
            command.arg("--unverified");
        }
        let device = format!("the guardian of {}", stop.name);
        let reports_lamp = stop.reports_lamp;
        let guardian =
            Guardian::spawn(command, stop).map_err(|source| DeviceError::Io { device, source })?;
        Ok(Box::new(Self {
            info: stage.info().clone(),
            stage: Some(stage),
            guardian: Some(guardian),
            reports_lamp,
            told_off: false,
        }))
    }

    fn stage(&mut self) -> &mut dyn LightStage {
        self.stage
            .as_deref_mut()
            .expect("it is there until the drop")
    }

    fn is_safe(&self, status: &StageStatus) -> bool {
        let is_off = match status.lamp {
            Some(lamp) => lamp == LampState::Off,
            None => !self.reports_lamp && self.told_off,
        };
        let stands = matches!(status.activity, StageActivity::Idle | StageActivity::Alarm);
        stands && is_off
    }
}

impl Drop for GuardedStage {
    fn drop(&mut self) {
        let status = self.stage().status();
        let is_safe = !std::thread::panicking() && status.is_ok_and(|status| self.is_safe(&status));
        self.stage = None;
        if let Some(guardian) = self.guardian.take()
            && is_safe
        {
            guardian.dismiss();
        }
    }
}

impl LightStage for GuardedStage {
    fn info(&self) -> &StageInfo {
        &self.info
    }

    fn home(&mut self) -> Result<StageStatus, DeviceError> {
        self.told_off = false;
        let status = self.stage().home()?;
        self.told_off = true;
        Ok(status)
    }

    fn move_to(&mut self, target: StageAngles) -> Result<StageAngles, DeviceError> {
        self.stage().move_to(target)
    }

    fn set_lamp(&mut self, lamp: LampState) -> Result<LampState, DeviceError> {
        self.told_off = false;
        let applied = self.stage().set_lamp(lamp)?;
        self.told_off = applied == LampState::Off;
        Ok(applied)
    }

    fn status(&mut self) -> Result<StageStatus, DeviceError> {
        self.stage().status()
    }

    fn temperature_c(&mut self) -> Option<f64> {
        self.stage().temperature_c()
    }

    fn check_reference(&mut self) -> Result<Option<ReferenceCheck>, DeviceError> {
        self.stage().check_reference()
    }

    fn stop_handle(&self) -> Result<Box<dyn StopHandle>, DeviceError> {
        self.stage
            .as_deref()
            .expect("it is there until the drop")
            .stop_handle()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::net::UnixStream;

    fn exchanges() -> Vec<Exchange> {
        vec![
            Exchange::new(b"!", &[]),
            Exchange::new(&[0x18], &[b"Grbl"]),
            Exchange::new(b"?", &[b"<Idle", b"<Alarm"]),
        ]
    }

    #[test]
    fn exchanges_survive_a_command_line() {
        for exchange in exchanges() {
            assert_eq!(exchange.to_string().parse(), Ok(exchange));
        }
        for bad in ["", "21", "2=", "zz=", "21=4", "21=ää"] {
            assert!(bad.parse::<Exchange>().is_err(), "{bad}");
        }
    }

    /// What the device heard, and how the watch ended. `answer` is the device's
    /// to each byte.
    fn watch(pipe: &[u8], answer: fn(u8) -> &'static [u8]) -> (Vec<u8>, Watch) {
        let (port, mut device) = UnixStream::pair().unwrap();
        // Said long before.
        device.write_all(b"Grbl <Idle").unwrap();
        let device = std::thread::spawn(move || {
            let mut heard = Vec::new();
            let mut byte = [0];
            // An end with bytes unread is an error to this one.
            while matches!(device.read(&mut byte), Ok(1)) {
                heard.push(byte[0]);
                if device.write_all(answer(byte[0])).is_err() {
                    break;
                }
            }
            heard
        });
        let watch = stand_guard(pipe, port.into(), &exchanges());
        (device.join().unwrap(), watch)
    }

    #[test]
    fn a_dismissed_guardian_does_nothing() {
        let (heard, watch) = watch(&[DISMISSAL], |_| b"");
        assert!(matches!(watch, Watch::Dismissed) && heard.is_empty());
    }

    #[test]
    fn a_closed_pipe_stops_the_stage_once_it_confirms() {
        let (heard, watch) = watch(&[], |byte| match byte {
            0x18 => b"\r\nGrbl 1.1h ['$' for help]\r\n",
            b'?' => b"<Alarm|MPos:0.000,0.000,0.000>\r\n",
            _ => b"",
        });
        assert!(matches!(watch, Watch::Acted(Ok(()))), "{watch:?}");
        assert_eq!(heard, [b'!', 0x18, b'?']);
    }

    #[test]
    fn a_stage_that_does_not_confirm_is_asked_again_and_told() {
        let began = Instant::now();
        let (heard, watch) = watch(&[], |byte| match byte {
            0x18 => b"Grbl",
            _ => b"<Run|",
        });
        assert!(matches!(watch, Watch::Acted(Err(_))), "{watch:?}");
        assert!(heard.len() > 3 && began.elapsed() >= DEADLINE, "{heard:?}");
    }
}
