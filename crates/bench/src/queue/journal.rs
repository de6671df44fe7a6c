//! What was done of a queue, a line of JSON for each event, next to the sessions.
//!
//! Lines are appended whole and synced; a process that dies leaves at most its last line torn,
//! and that line is dropped when the journal is opened again.

use std::fs::{File, TryLockError};
use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::QueueError;
use crate::file_system;
use crate::outside_file::{append_regular, read_opened};
use crate::session::fit_record::Verdict;

/// End of the journal's name, after that of the list.
pub const JOURNAL_ENDING: &str = ".queue.jsonl";
/// Version of the journal.
const FORMAT: u32 = 1;
/// Far more than a queue writes.
const LARGEST_BYTES: u64 = 64 << 20;

/// What happened.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub(super) enum Event {
    /// The journal begins.
    Start { format: u32 },
    /// A session of this sample, which has those before, is about to be made.
    Next { sample: String, before: Vec<String> },
    /// It is there; its capture begins.
    Begun { sample: String, session: String },
    /// Its capture is complete.
    Captured { session: String },
    /// Nothing more is to be done with it.
    Done {
        session: String,
        #[serde(default, skip_serializing_if = "Option::is_none")]
        verdict: Option<Verdict>,
        #[serde(default, skip_serializing_if = "Option::is_none")]
        error: Option<String>,
    },
    /// Its interrupted capture is left as it is.
    Abandoned { session: String },
    /// The sample shall have one more session.
    Again { sample: String },
    /// The sample shall have so many sessions fewer.
    LeftOut {
        sample: String,
        sessions: usize,
        #[serde(default, skip_serializing_if = "Option::is_none")]
        reason: Option<String>,
    },
    /// What was left out of the sample is wanted after all.
    TakenBack { sample: String },
}

#[derive(Serialize, Deserialize)]
struct Line {
    utc: String,
    #[serde(flatten)]
    event: Event,
}

/// The open journal, which is this process's until it is dropped.
#[derive(Debug)]
pub(super) struct Journal {
    path: PathBuf,
    file: File,
}

impl Journal {
    /// Opens or begins the journal of this file of samples in the folder of the sessions, and
    /// returns what it holds.
    pub(super) fn open(samples: &Path, folder: &Path) -> Result<(Self, Vec<Event>), QueueError> {
        let mut name = samples.file_stem().unwrap_or_default().to_owned();
        name.push(JOURNAL_ENDING);
        let path = folder.join(name);
        let io = |path: &Path| {
            let path = path.to_owned();
            move |source| QueueError::Io { path, source }
        };
        std::fs::create_dir_all(folder).map_err(io(folder))?;
        let file = append_regular(&path).map_err(io(&path))?;
        match file_system::lock(&file, &path) {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(QueueError::Locked { path }),
            Err(TryLockError::Error(source)) => return Err(QueueError::Io { path, source }),
        }
        let mut journal = Self { path, file };
        let read = read_opened(&journal.file, LARGEST_BYTES);
        let mut bytes = read.map_err(io(&journal.path))?;
        // What follows the last end of line was torn.
        let whole = bytes.iter().rposition(|&b| b == b'\n');
        bytes.truncate(whole.map_or(0, |at| at + 1));
        let events = journal.parse(&bytes)?;
        let cut = journal.file.set_len(bytes.len() as u64);
        cut.and_then(|()| journal.file.seek(SeekFrom::End(0)))
            .map_err(io(&journal.path))?;
        if events.is_empty() {
            journal.append(&Event::Start { format: FORMAT })?;
            file_system::sync_folder(folder).map_err(io(folder))?;
        }
        Ok((journal, events))
    }

    fn parse(&self, bytes: &[u8]) -> Result<Vec<Event>, QueueError> {
        let wrong = |line: usize, fact: String| QueueError::Journal {
            path: self.path.clone(),
            line: line + 1,
            fact,
        };
        let lines = bytes.split(|&b| b == b'\n').filter(|line| !line.is_empty());
        let mut events = Vec::new();
        for (number, line) in lines.enumerate() {
            let Line { event, .. } =
                serde_json::from_slice(line).map_err(|error| wrong(number, error.to_string()))?;
            match (number, &event) {
                (0, Event::Start { format: FORMAT }) => {}
                (0, Event::Start { format }) => {
                    let fact = format!("format is {format}, allowed is {FORMAT}");
                    return Err(wrong(0, fact));
                }
                (0, _) => return Err(wrong(0, "it does not begin with `start`".to_owned())),
                _ => {}
            }
            events.push(event);
        }
        Ok(events)
    }

    /// Adds an event, on the disk before this returns.
    pub(super) fn append(&mut self, event: &Event) -> Result<(), QueueError> {
        let line = Line {
            utc: jiff::Timestamp::now()
                .strftime("%Y-%m-%dT%H:%M:%SZ")
                .to_string(),
            event: event.clone(),
        };
        let mut text = serde_json::to_string(&line).expect("plain data is always JSON");
        text.push('\n');
        let written = self.file.write_all(text.as_bytes());
        written
            .and_then(|()| file_system::sync_file(&self.file, &self.path))
            .map_err(|source| QueueError::Io {
                path: self.path.clone(),
                source,
            })
    }
}
