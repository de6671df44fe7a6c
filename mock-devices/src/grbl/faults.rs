//! What goes wrong between the firmware and its host, on demand.

use crate::clock::lock;
use crate::random;
use std::sync::{Arc, Mutex};

/// When a fault strikes.
#[derive(Clone, Debug, PartialEq)]
pub enum Trigger {
    /// At once, and (for faults of answers) at every answer.
    Always,
    /// At the answer to a line that begins like this (upper case, no spaces).
    Line(String),
    /// At the answer to `?`.
    StatusQuery,
    /// At the welcome message.
    Banner,
    /// This many seconds after the stage has begun to move.
    InMotion {
        /// Seconds on the bench's clock.
        after_s: f64,
    },
}

/// What happens.
#[derive(Clone, Debug, PartialEq)]
pub enum Fault {
    /// The answer is not sent.
    NoReply,
    /// The answer comes later by this many seconds on the bench's clock.
    Delayed {
        /// Seconds.
        seconds: f64,
    },
    /// Every byte of the answer but its line ends is replaced by noise.
    Garbled,
    /// Only this many bytes of the answer are sent.
    Truncated {
        /// Bytes kept.
        keep: usize,
    },
    /// The answer is sent twice.
    Duplicated,
    /// The board restarts, as after a dip of its supply.
    Reset,
    /// The firmware raises this alarm.
    Alarm(u8),
    /// The port goes away, as when the cable is pulled. For good.
    Unplug,
}

#[derive(Debug)]
struct Rule {
    trigger: Trigger,
    fault: Fault,
    left: Option<u32>,
}

/// Handle by which a test makes a simulated controller fail; clones act on the
/// same controller.
#[derive(Clone, Debug, Default)]
pub struct Faults(Arc<Mutex<Vec<Rule>>>);

/// What an output answers.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Cause {
    Line(String),
    StatusQuery,
    Banner,
    /// Alarms and messages that nobody requested.
    Push,
}

/// Something that happens to the controller rather than to an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Mishap {
    Reset,
    Alarm(u8),
    Unplug,
}

impl Fault {
    fn mishap(&self) -> Option<Mishap> {
        match self {
            Self::Reset => Some(Mishap::Reset),
            Self::Alarm(code) => Some(Mishap::Alarm(*code)),
            Self::Unplug => Some(Mishap::Unplug),
            _ => None,
        }
    }
}

impl Trigger {
    fn matches(&self, cause: &Cause) -> bool {
        match (self, cause) {
            (Self::Always, _) => true,
            (Self::Line(start), Cause::Line(line)) => line.starts_with(start.as_str()),
            (Self::StatusQuery, Cause::StatusQuery) | (Self::Banner, Cause::Banner) => true,
            _ => false,
        }
    }
}

impl Faults {
    /// Strikes whenever its trigger comes, until [`clear`](Self::clear). A
    /// reset, alarm or unplugging strikes once.
    pub fn inject(&self, trigger: Trigger, fault: Fault) {
        self.push(trigger, fault, None);
    }

    /// Strikes the next `times` times that its trigger comes.
    pub fn inject_times(&self, trigger: Trigger, fault: Fault, times: u32) {
        self.push(trigger, fault, Some(times));
    }

    fn push(&self, trigger: Trigger, fault: Fault, times: Option<u32>) {
        let left = match fault.mishap() {
            Some(_) => Some(times.unwrap_or(1)),
            None => times,
        };
        lock(&self.0).push(Rule {
            trigger,
            fault,
            left,
        });
    }

    /// No fault strikes any more.
    pub fn clear(&self) {
        lock(&self.0).clear();
    }

    /// The bytes that leave for this answer, with their delay in seconds, and
    /// the mishaps that come with it.
    pub(super) fn shape(&self, cause: &Cause, text: &str) -> (Vec<u8>, f64, Vec<Mishap>) {
        let mut bytes = text.as_bytes().to_vec();
        let mut delay_s = 0.0;
        let mut mishaps = Vec::new();
        let mut rules = lock(&self.0);
        for (index, rule) in rules.iter_mut().enumerate() {
            if !rule.trigger.matches(cause) || rule.left == Some(0) {
                continue;
            }
            if rule.trigger == Trigger::Always && rule.fault.mishap().is_some() {
                continue; // `due` has them
            }
            rule.left = rule.left.map(|left| left - 1);
            match &rule.fault {
                Fault::NoReply => bytes.clear(),
                Fault::Delayed { seconds } => delay_s += seconds,
                Fault::Garbled => garble(&mut bytes, index as u64),
                Fault::Truncated { keep } => bytes.truncate(*keep),
                Fault::Duplicated => bytes.extend_from_within(..),
                Fault::Reset | Fault::Alarm(_) | Fault::Unplug => {
                    mishaps.extend(rule.fault.mishap());
                }
            }
        }
        rules.retain(|rule| rule.left != Some(0));
        (bytes, delay_s, mishaps)
    }

    /// Mishaps that are due at a time, given since when the stage has moved.
    pub(super) fn due(&self, now_s: f64, moving_since_s: Option<f64>) -> Vec<Mishap> {
        let mut mishaps = Vec::new();
        lock(&self.0).retain_mut(|rule| {
            let due = match rule.trigger {
                Trigger::Always => true,
                Trigger::InMotion { after_s } => {
                    moving_since_s.is_some_and(|since_s| now_s >= since_s + after_s)
                }
                _ => false,
            };
            let Some(mishap) = rule.fault.mishap().filter(|_| due) else {
                return true;
            };
            mishaps.push(mishap);
            rule.left = rule.left.map(|left| left.saturating_sub(1));
            rule.left != Some(0)
        });
        mishaps
    }

    /// When the first mishap of a motion that began at this time is due.
    pub(super) fn next_in_motion_s(&self, moving_since_s: f64) -> Option<f64> {
        lock(&self.0)
            .iter()
            .filter_map(|rule| match rule.trigger {
                Trigger::InMotion { after_s } if rule.fault.mishap().is_some() => {
                    Some(moving_since_s + after_s)
                }
                _ => None,
            })
            .reduce(f64::min)
    }
}

fn garble(bytes: &mut [u8], key: u64) {
    let mut numbers = random::stream(&[20, key, bytes.len() as u64]);
    for byte in bytes.iter_mut().filter(|byte| !b"\r\n".contains(byte)) {
        // Noise, but neither a line end nor the byte that was meant.
        *byte = loop {
            let noise = (numbers.bits() >> 56) as u8;
            if noise != *byte && noise != b'\r' && noise != b'\n' {
                break noise;
            }
        };
    }
}
