//! What a capture and its fit report, as JSON lines on stdout for other programs.
//!
//! Nothing that the reader does holds the capture up: a thread of its own writes the lines
//! from a bounded queue. Frames about to be taken and the time left are dropped first, the
//! end of the capture last.

use std::fs::File;
use std::io;
use std::os::fd::AsFd;

use super::{Ending, Observer, Progress, Stamped};
use crate::shown::is_obeyed;
use crate::write_queue::{LAST_WORDS, WriteQueue};

/// Room for events that a later one supersedes, bytes.
const SUPERSEDED: usize = 1 << 18;
/// For the others.
const USUAL: usize = 1 << 19;
/// For the few that a reader cannot do without.
const ESSENTIAL: usize = USUAL + (1 << 16);

/// The lines; when it is dropped, the reader gets a second to take what waits.
#[derive(Clone)]
pub struct EventLines(&'static WriteQueue);

impl EventLines {
    /// Of this process's stdout, which nothing else may write to from now on.
    ///
    /// # Errors
    /// No thread can be had.
    pub fn start() -> io::Result<Self> {
        let stdout = File::from(io::stdout().as_fd().try_clone_to_owned()?);
        let dropped = |count| line(&Progress::Dropped { count });
        Ok(Self(WriteQueue::start("events", stdout, dropped)?))
    }

    /// Puts an event into the queue. Never waits.
    pub fn send(&self, event: &Progress) {
        self.0.put(&line(event), room_of(event), true);
    }

    /// A warning that the capture itself does not report.
    pub fn warn(&self, text: &str) {
        let text = text.to_owned();
        self.send(&Progress::Warning { text });
    }

    /// The end of a capture that did not begin.
    pub fn not_begun(&self, error: String) {
        self.send(&Progress::Ended {
            outcome: Ending::Failed,
            session: None,
            elapsed_s: 0.0,
            error: Some(error),
            spent: None,
        });
    }

    /// The end of a fit that was made in vain, with advice where there is some.
    pub fn fit_failed(&self, error: String, hint: Option<String>) {
        self.send(&Progress::FitFailed { error, hint });
    }

    /// Waits until the reader has taken everything, a second at most; not at all where it
    /// has taken nothing for so long.
    pub fn flush(&self) {
        self.0.flush(LAST_WORDS);
    }
}

impl Drop for EventLines {
    fn drop(&mut self) {
        self.flush();
    }
}

impl Observer for &EventLines {
    fn observe(&mut self, progress: &Progress) {
        self.send(progress);
    }

    /// The reader gets the news of the pause before this process is suspended.
    fn pause(&mut self) {
        self.0.flush_unless_stuck(LAST_WORDS);
    }
}

fn line(event: &Progress) -> String {
    let text = serde_json::to_string(&Stamped::now(event)).expect("events have only string keys");
    json_line(&text)
}

fn room_of(event: &Progress) -> usize {
    use Progress::*;
    match event {
        Frame { .. } | Left { .. } | Fit { .. } | Calibrating { .. } => SUPERSEDED,
        Begun { .. }
        | Asked { .. }
        | Paused
        | Continued
        | Ended { .. }
        | Fitted { .. }
        | FitFailed { .. } => ESSENTIAL,
        _ => USUAL,
    }
}

/// JSON and a line end. JSON escapes most of what a terminal obeys; the rest, which stands in
/// texts alone, is escaped here.
pub fn json_line(text: &str) -> String {
    let mut shown = String::with_capacity(text.len() + 1);
    for c in text.chars() {
        match c {
            '\n' => shown.push(c),
            c if is_obeyed(c) => shown += &format!("\\u{:04x}", u32::from(c)),
            c => shown.push(c),
        }
    }
    shown.push('\n');
    shown
}
