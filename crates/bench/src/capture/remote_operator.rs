//! The person at the bench, at a manual stage or of a calibration, asked through the program that
//! reads the events.

use std::io::BufRead;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use super::event_lines::EventLines;
use super::{HandWork, Progress};
use crate::device::LampState;
use crate::device::manual::{Operator, Request};

/// How often a question is looked at whether a stop has come meanwhile.
const STOP_LOOK: Duration = Duration::from_millis(50);

/// An answer as a line of stdin: `{"number": 3, "done": true}`.
#[derive(serde::Deserialize)]
struct Answer {
    number: u64,
    done: bool,
}

/// The person at the bench, asked through the program that reads the events, which answers on
/// stdin.
pub struct RemoteOperator {
    lines: EventLines,
    answers: Mutex<Receiver<Answer>>,
    asked: AtomicU64,
    stops: AtomicU64,
}

impl RemoteOperator {
    /// Asks by events of `lines`, and reads the answers from this process's stdin.
    pub fn of(lines: &EventLines) -> Self {
        let (sender, answers) = channel();
        // It ends with its stream, or with the program.
        std::thread::spawn(move || {
            for line in std::io::stdin().lock().lines() {
                let Ok(line) = line else { return };
                if let Ok(answer) = serde_json::from_str(&line)
                    && sender.send(answer).is_err()
                {
                    return;
                }
            }
        });
        Self {
            lines: lines.clone(),
            answers: Mutex::new(answers),
            asked: AtomicU64::new(0),
            stops: AtomicU64::new(0),
        }
    }

    /// Reports this to the reader too.
    pub fn report(&self, event: &Progress) {
        self.lines.send(event);
    }

    /// Returns once the person has done it, or has said that they have not: `false`, as where
    /// nobody answers any more.
    pub fn has_done(&self, work: HandWork) -> bool {
        let stops = self.stops.load(Ordering::Acquire);
        let number = self.asked.fetch_add(1, Ordering::AcqRel) + 1;
        self.lines.send(&Progress::Asked { number, work });
        let answers = self.answers.lock().unwrap_or_else(PoisonError::into_inner);
        loop {
            match answers.recv_timeout(STOP_LOOK) {
                Ok(answer) if answer.number == number => return answer.done,
                Err(RecvTimeoutError::Disconnected) => return false,
                _ if self.stops.load(Ordering::Acquire) != stops => return false,
                // An answer to an earlier question, or none yet.
                _ => {}
            }
        }
    }
}

impl Operator for RemoteOperator {
    fn ask(&self, request: Request) -> bool {
        self.has_done(match request {
            Request::Place { angles, .. } => HandWork::Place(angles),
            Request::Lamp(LampState::Off) => HandWork::LampOff,
            Request::Lamp(LampState::On(channel)) => HandWork::LampOn { channel },
        })
    }

    fn tell(&self, request: Request) {
        self.stops.fetch_add(1, Ordering::AcqRel);
        self.lines.warn(&format!("{request} now"));
    }
}
