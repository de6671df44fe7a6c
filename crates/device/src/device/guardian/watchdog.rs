//! The program's side of the watch: which steps are under way, until when, and
//! whether the guardian is there.

use std::io::{ErrorKind, Read, Write};
use std::net::Shutdown;
use std::os::unix::net::UnixStream;
use std::process::Child;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError, Weak};
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};

use super::message::{Message, PONG, now};
use crate::device::{DeviceError, StopHandle};

/// Between two steps the program computes for so long at most.
const BETWEEN: Duration = Duration::from_secs(5);
/// How often the guardian is asked whether it is there.
const ASK: Duration = Duration::from_millis(500);
/// A guardian that takes longer to answer is gone.
const ANSWER: Duration = Duration::from_secs(2);
/// Waits are announced in parts no longer than this.
const PART: Duration = Duration::from_millis(500);

/// The thread that works reports to its guardian here that it lives, and learns here
/// whether the guardian does. Clones are the same watchdog. Where a stage has no
/// guardian (simulated, or moved by hand) nobody listens.
#[derive(Clone, Default)]
pub struct Watchdog(Option<Arc<Shared>>);

struct Shared {
    /// What the guardian guards.
    device: String,
    /// Never waited on: a guardian that reads nothing is gone.
    link: UnixStream,
    steps: Mutex<Steps>,
    child: Mutex<Child>,
    is_lost: AtomicBool,
    is_over: AtomicBool,
}

#[derive(Default)]
struct Steps {
    /// The lamp is lit, or may be, or the stage moves.
    at_risk: bool,
    /// Number and end of each step under way.
    under_way: Vec<(u64, Duration)>,
    next: u64,
}

impl Watchdog {
    /// One whose guardian is at the other end of `link`, the process `child`. What
    /// it guards is called `device`. Where the guardian is lost, `stop` stops the
    /// stage at once.
    ///
    /// # Errors
    /// If no thread can be started.
    pub(super) fn start(
        device: String,
        link: UnixStream,
        child: Child,
        stop: Box<dyn StopHandle>,
    ) -> std::io::Result<Self> {
        link.set_nonblocking(true)?;
        let shared = Arc::new(Shared {
            device,
            link,
            steps: Mutex::default(),
            child: Mutex::new(child),
            is_lost: AtomicBool::new(false),
            is_over: AtomicBool::new(false),
        });
        let asked = Arc::downgrade(&shared);
        let watchdog = Self(Some(shared));
        std::thread::Builder::new()
            .name("guardian".to_owned())
            .spawn(move || keep_asking(&asked, stop))?;
        Ok(watchdog)
    }

    /// A step begins that takes no longer than this; it ends where the result is
    /// dropped.
    #[must_use = "the step ends where this is dropped"]
    pub fn step(&self, longest: Duration) -> Step {
        let number = self.0.as_ref().map_or(0, |shared| {
            let mut steps = shared.steps();
            let number = steps.next;
            steps.next += 1;
            steps.under_way.push((number, now() + longest));
            shared.announce(&steps);
            number
        });
        Step {
            watchdog: self.clone(),
            number,
        }
    }

    /// Whether a guardian watches.
    pub fn is_kept(&self) -> bool {
        self.0.is_some()
    }

    /// Waits, as long as everything is as it should be.
    pub fn wait(&self, time: Duration) {
        let end = Instant::now() + time;
        while self.check().is_ok() {
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return;
            }
            let _step = self.step(PART);
            std::thread::sleep(left.min(PART));
        }
    }

    /// Whether somebody must turn the lamp off or end a motion if this thread does
    /// not go on.
    pub(super) fn set_at_risk(&self, at_risk: bool) {
        if let Some(shared) = &self.0 {
            let mut steps = shared.steps();
            steps.at_risk = at_risk;
            shared.announce(&steps);
        }
    }

    /// An error if the guardian has taken the stage over, or is lost: then the
    /// stage is stopped, and nothing more may be done with it.
    pub fn check(&self) -> Result<(), DeviceError> {
        let Some(shared) = &self.0 else {
            return Ok(());
        };
        let device = || shared.device.clone();
        if shared.is_over() {
            Ok(())
        } else if shared.is_lost() {
            Err(DeviceError::Unguarded { device: device() })
        } else if shared.is_relieved() {
            Err(DeviceError::Relieved { device: device() })
        } else {
            Ok(())
        }
    }

    /// Ends the watch: the guardian stops the stage, unless it was dismissed, and
    /// ends. Waits for that, `longest` at most; then it is killed.
    pub(super) fn end(&self, is_safe: bool, longest: Duration) {
        let Some(shared) = &self.0 else {
            return;
        };
        let is_dismissed = is_safe && self.check().is_ok();
        // First, so that nobody takes the end of the guardian for its loss.
        shared.is_over.store(true, Ordering::Release);
        if is_dismissed {
            shared.say(Message::Dismissed);
        }
        drop(shared.link.shutdown(Shutdown::Both));
        let mut child = shared.child();
        let end = Instant::now() + longest;
        while matches!(child.try_wait(), Ok(None)) && Instant::now() < end {
            std::thread::sleep(Duration::from_millis(2));
        }
        drop(child.kill());
        drop(child.wait());
    }
}

/// A step under way, until it is dropped.
pub struct Step {
    watchdog: Watchdog,
    number: u64,
}

impl Drop for Step {
    fn drop(&mut self) {
        if let Some(shared) = &self.watchdog.0 {
            let mut steps = shared.steps();
            steps.under_way.retain(|(number, _)| *number != self.number);
            shared.announce(&steps);
        }
    }
}

impl Shared {
    fn steps(&self) -> MutexGuard<'_, Steps> {
        self.steps.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn child(&self) -> MutexGuard<'_, Child> {
        self.child.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn is_over(&self) -> bool {
        self.is_over.load(Ordering::Acquire)
    }

    fn is_lost(&self) -> bool {
        self.is_lost.load(Ordering::Acquire)
    }

    /// Every change of the steps is a sign of life.
    fn announce(&self, steps: &Steps) {
        let ends = steps.under_way.iter().map(|(_, end)| *end);
        self.say(match steps.at_risk {
            true => Message::Until(ends.min().unwrap_or_else(|| now() + BETWEEN)),
            false => Message::Rest,
        });
    }

    /// Whether it was received will show when the guardian is asked next.
    fn say(&self, message: Message) {
        drop((&self.link).write(&message.to_bytes()));
    }

    fn events(&self, wanted: PollFlags, longest: Duration) -> PollFlags {
        let timeout = Timespec {
            tv_sec: longest.as_secs() as i64,
            tv_nsec: i64::from(longest.subsec_nanos()),
        };
        let mut descriptors = [PollFd::new(&self.link, wanted)];
        match poll(&mut descriptors, Some(&timeout)) {
            Ok(_) => descriptors[0].revents(),
            Err(_) => PollFlags::empty(),
        }
    }

    /// Whether the guardian has marked its end of the socket, which it does before
    /// it acts. One that has ended has closed it.
    fn is_relieved(&self) -> bool {
        let events = self.events(PollFlags::RDHUP, Duration::ZERO);
        events.contains(PollFlags::RDHUP) && !events.contains(PollFlags::HUP)
    }

    /// Whether the guardian answers.
    fn answers(&self) -> bool {
        self.say(Message::Ping);
        let end = Instant::now() + ANSWER;
        let mut heard = [0; 64];
        loop {
            // Looked at last after the time is over: this process may itself have
            // been stopped in between.
            let left = end.saturating_duration_since(Instant::now());
            self.events(PollFlags::IN, left);
            match (&self.link).read(&mut heard) {
                Ok(0) => return false,
                Ok(count) if heard[..count].contains(&PONG) => return true,
                Err(error) if !is_temporary(error.kind()) => return false,
                _ if left.is_zero() => return false,
                _ => {}
            }
        }
    }
}

fn is_temporary(kind: ErrorKind) -> bool {
    matches!(kind, ErrorKind::WouldBlock | ErrorKind::Interrupted)
}

/// Asks the guardian whether it is there, until the watch is over. Says itself
/// nothing of the thread that works.
fn keep_asking(watched: &Weak<Shared>, mut stop: Box<dyn StopHandle>) {
    while let Some(shared) = watched.upgrade() {
        let answers = shared.answers();
        if shared.is_over() {
            return;
        }
        if shared.is_relieved() {
            tracing::error!("{}: its guardian has taken it over", shared.device);
            // This process may have been stopped in the middle of a write.
            shared.say(Message::Again);
            return;
        }
        if !answers {
            shared.is_lost.store(true, Ordering::Release);
            tracing::error!("the guardian of {} does not answer", shared.device);
            // One that wakes later does no harm, but nobody shall wait for it.
            drop(shared.child().kill());
            if let Err(error) = stop.stop() {
                tracing::error!("the stage did not confirm that it stopped: {error}");
            }
            return;
        }
        shared.events(PollFlags::RDHUP, ASK);
    }
}

/// What a port asks before each write: nothing is sent to a stage that the
/// guardian has taken over. Open until a watchdog keeps it; clones are the same.
#[derive(Clone, Default)]
pub struct Gate(Arc<OnceLock<Watchdog>>);

impl std::fmt::Debug for Gate {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(out, "Gate({})", self.0.get().is_some())
    }
}

impl Gate {
    /// Who keeps it from now on.
    pub(super) fn keep(&self, watchdog: Watchdog) {
        drop(self.0.set(watchdog));
    }

    /// Whether a watchdog keeps it.
    pub fn is_kept(&self) -> bool {
        self.0.get().is_some()
    }

    /// An error if the guardian has taken the stage over. A guardian that is lost
    /// holds nobody: the stage must be stopped then.
    pub fn pass(&self) -> Result<(), DeviceError> {
        match self.0.get().map_or(Ok(()), Watchdog::check) {
            Err(DeviceError::Unguarded { .. }) => Ok(()),
            other => other,
        }
    }

    /// The same after a write. If the guardian acted meanwhile, it is asked to do
    /// so again: what was written may have come after.
    pub fn passed(&self) -> Result<(), DeviceError> {
        let passed = self.pass();
        if passed.is_err()
            && let Some(shared) = self.0.get().and_then(|watchdog| watchdog.0.as_ref())
        {
            shared.say(Message::Again);
        }
        passed
    }
}
