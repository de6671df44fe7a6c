//! A request to stop or to pause, shared between whoever hears it (a signal handler, a
//! button) and whoever must obey it at a safe moment.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicI32, AtomicU32, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

/// What asked the program to stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Signal {
    /// Ctrl-C, SIGINT.
    Interrupt,
    /// SIGTERM.
    Terminate,
    /// SIGHUP: the terminal went away.
    HangUp,
}

impl Signal {
    /// POSIX number.
    pub fn number(self) -> i32 {
        match self {
            Signal::HangUp => 1,
            Signal::Interrupt => 2,
            Signal::Terminate => 15,
        }
    }

    /// The signal of a POSIX number, if it is one of the three.
    pub fn from_number(number: i32) -> Option<Self> {
        [Signal::Interrupt, Signal::Terminate, Signal::HangUp]
            .into_iter()
            .find(|signal| signal.number() == number)
    }
}

/// How urgent the request is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum StopLevel {
    /// Nobody asked.
    Continue,
    /// Asked once: finish the frame, lamp off, leave a resumable session.
    AfterThisFrame,
    /// Asked again: stop the motion now, lamp off.
    Now,
}

/// A shared counter of stop requests, and a wish to pause; clones see the same.
#[derive(Clone, Debug, Default)]
pub struct Interrupt {
    pause: Arc<AtomicBool>,
    requests: Arc<AtomicU32>,
    latest: Arc<AtomicI32>,
}

impl Interrupt {
    /// Nobody has asked yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Asks once more.
    pub fn raise(&self, signal: Signal) {
        self.latest.store(signal.number(), Ordering::SeqCst);
        self.requests.fetch_add(1, Ordering::SeqCst);
    }

    /// Asks for a pause.
    pub fn ask_for_pause(&self) {
        self.pause.store(true, Ordering::SeqCst);
    }

    /// Whether a pause is wanted, which [`take_pause`](Self::take_pause) still says
    /// afterwards.
    pub fn wants_pause(&self) -> bool {
        self.pause.load(Ordering::SeqCst)
    }

    /// Whether a pause is wanted; whoever hears it must obey.
    pub fn take_pause(&self) -> bool {
        self.pause.swap(false, Ordering::SeqCst)
    }

    /// What is wanted now; cheap enough to ask in every loop.
    pub fn level(&self) -> StopLevel {
        match self.requests.load(Ordering::SeqCst) {
            0 => StopLevel::Continue,
            1 => StopLevel::AfterThisFrame,
            _ => StopLevel::Now,
        }
    }

    /// The latest signal, once there was one.
    pub fn signal(&self) -> Option<Signal> {
        Signal::from_number(self.latest.load(Ordering::SeqCst))
    }

    /// Has a thread look at the requests every [`LOOK`], until what is returned is dropped.
    ///
    /// # Errors
    /// No thread can be had.
    pub fn watch(
        &self,
        mut look: impl FnMut(&Interrupt) + Send + 'static,
    ) -> std::io::Result<Watching> {
        let interrupt = self.clone();
        let over = Arc::new(AtomicBool::new(false));
        let is_over = Arc::clone(&over);
        let thread = std::thread::Builder::new()
            .name("watching signals".into())
            .spawn(move || {
                while !is_over.load(Ordering::SeqCst) {
                    look(&interrupt);
                    std::thread::sleep(LOOK);
                }
            })?;
        Ok(Watching {
            over,
            thread: Some(thread),
        })
    }
}

/// How often requests are looked at.
pub const LOOK: Duration = Duration::from_millis(20);

/// As long as it lives, requests are looked at.
#[must_use]
pub struct Watching {
    over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Drop for Watching {
    /// Afterwards nobody looks any more.
    fn drop(&mut self) {
        self.over.store(true, Ordering::SeqCst);
        if let Some(thread) = self.thread.take() {
            // It does not panic; if it did, nothing would depend on it either.
            drop(thread.join());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clones_share_requests_and_each_request_is_more_urgent() {
        let heard = Interrupt::new();
        let obeyed = heard.clone();
        assert_eq!(obeyed.level(), StopLevel::Continue);
        assert_eq!(obeyed.signal(), None);
        heard.raise(Signal::Terminate);
        assert_eq!(obeyed.level(), StopLevel::AfterThisFrame);
        assert_eq!(obeyed.signal(), Some(Signal::Terminate));
        heard.raise(Signal::Interrupt);
        assert_eq!(obeyed.level(), StopLevel::Now);
        assert_eq!(obeyed.signal(), Some(Signal::Interrupt));
    }

    #[test]
    fn a_pause_is_heard_once() {
        let heard = Interrupt::new();
        let obeyed = heard.clone();
        assert!(!obeyed.take_pause());
        heard.ask_for_pause();
        heard.ask_for_pause();
        assert!(obeyed.take_pause());
        assert!(!obeyed.take_pause());
        assert_eq!(obeyed.level(), StopLevel::Continue);
    }
}
