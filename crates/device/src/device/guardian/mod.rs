//! The guardian: a small process that holds the stage's port and stops the stage
//! when the thread that drives the bench gives no sign of life, whatever the
//! reason: the program was killed, stopped, starved, or is stuck.
//!
//! It is a child at the other end of a socket. Every step that may take a while
//! announces there when it will be over at the latest ([`Watchdog::step`]); while
//! the lamp is lit or the stage moves, the guardian acts [`GRACE`] after that time
//! has passed without another sign of life, and at once when the socket is closed
//! without a dismissal: the system closes it when this process ends, however it
//! ends.
//!
//! It acts over the same open port (which needs no opening, so that no lock
//! stands in the way and no board resets). First it marks the socket: from then
//! on every driver's write to the port fails, also in a process that was stopped
//! and wakes later. Then it sends the bytes that stop the stage, and asks until
//! the stage confirms. It answers this process's questions, so that a guardian
//! that was killed or stopped is noticed as well.

mod guarded;
mod message;
mod process;
mod watchdog;

use std::os::fd::OwnedFd;
use std::str::FromStr;
use std::time::Duration;

pub use guarded::{GuardedStage, guarded_camera};
pub use process::{Watch, stand_guard};
pub use watchdog::{Gate, Step, Watchdog};

/// Within this time after it began to act the stage is stopped, or the guardian
/// gives up.
pub const DEADLINE: Duration = Duration::from_secs(3);
/// So long after the announced end of a step the guardian acts.
pub const GRACE: Duration = Duration::from_secs(1);

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
    /// Whether the stage reports if its lamp is lit. Otherwise what it confirms is
    /// that it was told.
    pub reports_lamp: bool,
    /// What the driver asks before each of its writes.
    pub gate: Gate,
}

#[cfg(test)]
pub(in crate::device::guardian) mod tests {
    use super::*;

    pub fn exchanges() -> Vec<Exchange> {
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
}
