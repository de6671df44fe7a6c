//! The line to a chain of Zaber devices: requests out, replies in by their
//! message id, and what follows from unsolicited flags.

use std::time::{Duration, Instant};

use super::codes::{self, Trust};
use super::protocol::{LONGEST_LINE, Message, Reply, command, parse};
use crate::device::shared_line::{Knowledge, SharedLine};
use crate::device::{DeviceError, Speaker};

/// How long another reader may go on before this one tries.
const LOOK: Duration = Duration::from_millis(20);
/// Message ids go round: 0 to 99.
const IDS: u8 = 100;

/// An open chain of devices.
pub type Link = SharedLine<Known>;

/// What the replies so far report about the stage.
#[derive(Clone, Debug, Default)]
pub struct Known {
    /// Why the position is unknown; `None` while it is known.
    pub unhomed_since: Option<String>,
    /// The fault that was reported last, until homing succeeds.
    pub fault: Option<String>,
    /// How often it was stopped by another thread.
    pub stops: u64,
    next_id: u8,
    /// Replies that were not taken yet, the oldest first.
    inbox: Vec<Reply>,
    /// The last line that made no sense.
    damaged: Option<String>,
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
        Self::with(path, baud, Speaker::Zaber, known)
    }

    /// Sends a request `attempts` times at most until the reply comes: more than once only
    /// what may be done twice. A rejection is an error.
    pub fn ask(
        &self,
        device: u8,
        axis: u8,
        words: &str,
        timeout: Duration,
        attempts: u32,
    ) -> Result<Reply, DeviceError> {
        self.known().damaged = None;
        for _ in 0..attempts {
            let id = self.new_id();
            let request = command(device, axis, id, words);
            tracing::trace!(
                device = self.line().device(),
                text = request.trim_end(),
                "sent"
            );
            self.send(request.as_bytes())?;
            let deadline = Instant::now() + timeout / attempts;
            if let Some(reply) = self.wait_for(device, id, deadline)? {
                if reply.accepted {
                    return Ok(reply);
                }
                let reason = codes::rejection(&reply.data);
                return Err(self
                    .line()
                    .refused(&format!("/{device} {axis} {words}"), &reason));
            }
        }
        let sent = format!("/{device} {axis} {words}");
        let damaged = self.known().damaged.take();
        self.distrust(&match damaged {
            Some(_) => "an answer was garbled".to_owned(),
            None => format!("{sent:?} was not answered"),
        });
        Err(match damaged {
            Some(text) => self
                .line()
                .garbled(&text, "a reply of the Zaber ASCII protocol"),
            None => self.line().no_reply(&sent, timeout),
        })
    }

    fn new_id(&self) -> u8 {
        let mut known = self.known();
        let id = known.next_id;
        known.next_id = (id + 1) % IDS;
        // What came a hundred requests late answers nothing.
        known.inbox.retain(|reply| reply.id != Some(id));
        id
    }

    fn wait_for(
        &self,
        device: u8,
        id: u8,
        deadline: Instant,
    ) -> Result<Option<Reply>, DeviceError> {
        loop {
            {
                let mut known = self.known();
                let found = known
                    .inbox
                    .iter()
                    .position(|reply| reply.device == device && reply.id == Some(id));
                if let Some(found) = found {
                    return Ok(Some(known.inbox.remove(found)));
                }
            }
            let now = Instant::now();
            if now >= deadline {
                return Ok(None);
            }
            self.read_or_wait(LONGEST_LINE, deadline.min(now + LOOK), Known::note)?;
        }
    }

    fn distrust(&self, since: &str) {
        let mut known = self.known();
        known.unhomed_since.get_or_insert_with(|| since.to_owned());
    }
}

impl Known {
    /// Every line changes what is known, whoever it was for.
    fn note(&mut self, line: &[u8]) {
        match parse(line) {
            Message::Reply(reply) => {
                self.note_flag(reply.flag.as_deref());
                self.inbox.push(reply);
                let surplus = self.inbox.len().saturating_sub(usize::from(IDS));
                self.inbox.drain(..surplus);
            }
            Message::Alert(alert) => self.note_flag(alert.flag.as_deref()),
            Message::Info => {}
            Message::Unknown(text) => self.damaged = Some(text),
        }
    }

    fn note_flag(&mut self, flag: Option<&str>) {
        let Some(flag) = flag else {
            return;
        };
        let trust = codes::trust(flag);
        if trust == Trust::Fault {
            self.fault = Some(codes::warning(flag));
        }
        if trust != Trust::Sound {
            self.unhomed_since
                .get_or_insert_with(|| codes::warning(flag));
        }
    }
}
