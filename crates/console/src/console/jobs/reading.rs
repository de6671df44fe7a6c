//! What a job prints: its events and its result on stdout, its messages on stderr.

use std::io::{BufRead, BufReader, Read};
use std::process::ExitStatus;
use std::sync::mpsc::SyncSender;

use crate::capture::{Progress, Stamped};

/// An event is at most so long (bytes).
const LONGEST_EVENT: u64 = 1 << 20;
/// What the threads of a job report.
pub enum Heard {
    /// An event.
    Event(Box<Stamped>),
    /// A line on stdout that is no event.
    Result(String),
    /// Bytes on stderr.
    Message(Vec<u8>),
    /// The process has ended.
    Ended(Option<ExitStatus>),
}

/// Reports events and results until the stream ends or nobody listens any more.
pub fn read_events(stdout: impl Read, sender: &SyncSender<Heard>) {
    let mut reader = BufReader::new(stdout);
    let mut line = Vec::new();
    loop {
        line.clear();
        match reader
            .by_ref()
            .take(LONGEST_EVENT)
            .read_until(b'\n', &mut line)
        {
            Ok(0) | Err(_) => return,
            Ok(_) => {}
        }
        let text = String::from_utf8_lossy(&line);
        let text = text.trim();
        let heard = match serde_json::from_str::<Stamped>(text) {
            Ok(stamped) => {
                let result = match &stamped.event {
                    Progress::Fitted { fit, .. } => Some(fit.clone()),
                    Progress::Ended { session, .. } => session.clone(),
                    _ => None,
                };
                if let Some(result) = result
                    && sender.send(Heard::Result(result)).is_err()
                {
                    return;
                }
                Heard::Event(Box::new(stamped))
            }
            // An event of another version, or the end of one that was too long.
            Err(_) if text.is_empty() || text.starts_with('{') => continue,
            Err(_) => Heard::Result(text.to_owned()),
        };
        if sender.send(heard).is_err() {
            return;
        }
    }
}

/// Reports messages likewise.
pub fn read_messages(mut stderr: impl Read, sender: &SyncSender<Heard>) {
    let mut bytes = [0; 4096];
    while let Ok(count @ 1..) = stderr.read(&mut bytes) {
        if sender
            .send(Heard::Message(bytes[..count].to_vec()))
            .is_err()
        {
            return;
        }
    }
}
