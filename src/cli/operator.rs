//! The person at the bench of a manual stage, asked at the terminal or, where `--events` is given
//! and stdin is none, by the program that reads the events.

use std::io::{BufRead, IsTerminal};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use super::error::CliError;
use super::output::write_stderr;
use crate::capture::event_lines::EventLines;
use crate::capture::{HandWork, Progress};
use crate::device::manual::{Operator, Request};
use crate::device::{LampChannel, LampState};

/// Asks on stderr, receives on stdin.
pub struct Terminal(());

impl Terminal {
    /// An error where nobody sits at the terminal.
    pub fn new() -> Result<Self, CliError> {
        if std::io::stdin().is_terminal() && std::io::stderr().is_terminal() {
            return Ok(Self(()));
        }
        Err(CliError::new(
            "a manual stage needs its operator at a terminal, and stdin or stderr is no terminal",
        )
        .hint("run it in a terminal, without redirecting stdin or stderr"))
    }
}

fn words(request: Request) -> String {
    match request {
        Request::Place { light, angles } => {
            format!("place the light at direction {}: {angles}", light + 1)
        }
        Request::Lamp(LampState::Off) => "turn the lamp off".to_owned(),
        Request::Lamp(LampState::On(LampChannel(channel))) => {
            format!("turn on channel {channel} of the lamp, and no other")
        }
    }
}

impl Operator for Terminal {
    fn ask(&self, request: Request) -> bool {
        let question = words(request);
        write_stderr(&format!(
            "\n{question}, then press Enter (n and Enter: not possible) "
        ));
        let mut answer = String::new();
        let heard = std::io::stdin().lock().read_line(&mut answer);
        heard.is_ok_and(|bytes| bytes > 0) && !answer.trim().eq_ignore_ascii_case("n")
    }

    fn tell(&self, request: Request) {
        write_stderr(&format!("\n{} now\n", words(request)));
    }
}

/// Who is asked in a capture: the reader of its events where it has some and no terminal.
pub fn of_capture(lines: Option<&EventLines>) -> Result<Arc<dyn Operator>, CliError> {
    match lines {
        Some(lines) if !std::io::stdin().is_terminal() => Ok(Arc::new(Reader::of(lines))),
        _ => Ok(Arc::new(Terminal::new()?)),
    }
}

/// How often a question is looked at whether a stop has come meanwhile.
const STOP_LOOK: Duration = Duration::from_millis(50);

/// An answer as a line of stdin: `{"number": 3, "done": true}`.
#[derive(serde::Deserialize)]
struct Answer {
    number: u64,
    done: bool,
}

/// The program that reads the events; it answers on stdin.
struct Reader {
    lines: EventLines,
    answers: Mutex<Receiver<Answer>>,
    asked: AtomicU64,
    stops: AtomicU64,
}

impl Reader {
    fn of(lines: &EventLines) -> Self {
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
}

impl Operator for Reader {
    fn ask(&self, request: Request) -> bool {
        let stops = self.stops.load(Ordering::Acquire);
        let number = self.asked.fetch_add(1, Ordering::AcqRel) + 1;
        let work = match request {
            Request::Place { angles, .. } => HandWork::Place(angles),
            Request::Lamp(LampState::Off) => HandWork::LampOff,
            Request::Lamp(LampState::On(channel)) => HandWork::LampOn { channel },
        };
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

    fn tell(&self, request: Request) {
        self.stops.fetch_add(1, Ordering::AcqRel);
        self.lines.warn(&format!("{} now", words(request)));
    }
}
