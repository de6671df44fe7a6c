//! The line to a chain of Zaber devices: requests out, replies in by their
//! message id, and what follows from flags that nobody asked for.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::codes::{self, Trust};
use super::protocol::{LONGEST_LINE, Message, Reply, command, parse};
use crate::device::serial_line::SerialLine;
use crate::device::{DeviceError, Speaker};

/// How long another reader may go on before one looks for oneself.
const LOOK: Duration = Duration::from_millis(20);
/// Message ids go round: 0 to 99.
const IDS: u8 = 100;

/// An open chain, shared by the driver and its stop handles: everyone may ask
/// at any moment, and whoever reads delivers to all.
pub struct Link {
    line: SerialLine,
    known: Mutex<Known>,
    heard: Condvar,
}

/// What the replies so far say about the stage.
#[derive(Clone, Debug)]
pub struct Known {
    /// Why the position is unknown; `None` while it is known.
    pub unhomed_since: Option<String>,
    /// The fault that was reported last, until homing succeeds.
    pub fault: Option<String>,
    /// How often it was stopped from beside.
    pub stops: u64,
    next_id: u8,
    /// Replies that nobody has taken yet, the oldest first.
    inbox: Vec<Reply>,
    /// The last line that made no sense.
    damaged: Option<String>,
}

impl Link {
    /// Opens and configures the port. Nothing is sent.
    pub fn open(path: &str, baud: u32) -> Result<Self, DeviceError> {
        Ok(Self {
            line: SerialLine::open(path, baud)?.of(Speaker::Zaber),
            known: Mutex::new(Known {
                unhomed_since: Some("it was connected".to_owned()),
                fault: None,
                stops: 0,
                next_id: 0,
                inbox: Vec::new(),
                damaged: None,
            }),
            heard: Condvar::new(),
        })
    }

    /// The port and its errors.
    pub fn line(&self) -> &SerialLine {
        &self.line
    }

    /// What is known now.
    pub fn known(&self) -> MutexGuard<'_, Known> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The position is unknown from now on.
    pub fn forget_position(&self, since: &str) {
        self.known().unhomed_since = Some(since.to_owned());
    }

    /// Asks `attempts` times at most until the reply comes: more than once only
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
            self.send(&command(device, axis, id, words))?;
            let deadline = Instant::now() + timeout / attempts;
            if let Some(reply) = self.wait_for(device, id, deadline)? {
                if reply.accepted {
                    return Ok(reply);
                }
                let reason = codes::rejection(&reply.data);
                return Err(self
                    .line
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
                .line
                .garbled(&text, "a reply of the Zaber ASCII protocol"),
            None => self.line.no_reply(&sent, timeout),
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

    fn send(&self, text: &str) -> Result<(), DeviceError> {
        tracing::trace!(device = self.line.device(), text = text.trim_end(), "sent");
        let sent = self.line.send(text.as_bytes());
        sent.map_err(|error| self.lost(error))
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
            match self.line.try_reader() {
                Some(mut reader) => {
                    let line = reader.line(LONGEST_LINE, deadline.min(now + LOOK));
                    if let Some(line) = line.map_err(|error| self.lost(error))? {
                        self.note(parse(&line));
                    }
                }
                None => {
                    let _unused = self.heard.wait_timeout(self.known(), LOOK);
                }
            }
        }
    }

    /// Every line changes what is known, whoever it was for.
    fn note(&self, message: Message) {
        let mut known = self.known();
        match message {
            Message::Reply(reply) => {
                known.note_flag(reply.flag.as_deref());
                known.inbox.push(reply);
                let surplus = known.inbox.len().saturating_sub(usize::from(IDS));
                known.inbox.drain(..surplus);
            }
            Message::Alert(alert) => known.note_flag(alert.flag.as_deref()),
            Message::Info => {}
            Message::Unknown(text) => known.damaged = Some(text),
        }
        drop(known);
        self.heard.notify_all();
    }

    fn distrust(&self, since: &str) {
        let mut known = self.known();
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
