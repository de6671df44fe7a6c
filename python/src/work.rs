//! Work that takes more than a moment.
//!
//! The work runs on a thread of its own while the calling thread, without the interpreter's lock,
//! waits for it. A few times a second, and whenever the work reports how far it is, the calling
//! thread takes the lock, calls Python's `progress` and lets signal handlers run. If either
//! raises, the work ends the next time it reports: it unwinds, and nothing is written. Callbacks
//! so always run on the thread that called, where notebooks need them.
//!
//! The library's threads don't outlive a fork. A forked process that would wait for them for ever
//! is refused.

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::process;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::Duration;

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use rig_bench::workflow::{Notice, Observer};
use rig_core::progress::Progress;

/// So often signals are looked for while the work is silent.
const LOOK: Duration = Duration::from_millis(50);

/// The process in which the library's threads were started.
static STARTED_IN: OnceLock<u32> = OnceLock::new();

/// Refuses a process that was forked from one whose threads had started.
fn refuse_forks() -> PyResult<()> {
    let own = process::id();
    if *STARTED_IN.get_or_init(|| own) == own {
        return Ok(());
    }
    Err(PyRuntimeError::new_err(
        "this process was forked after rig's threads had started, which a fork doesn't copy; \
         start processes with multiprocessing.get_context(\"spawn\")",
    ))
}

/// Runs short work on all processors without the interpreter's lock.
pub fn detached<T: Send>(py: Python<'_>, work: impl FnOnce() -> T + Send) -> PyResult<T> {
    refuse_forks()?;
    Ok(py.detach(work))
}

/// Runs long work, which reports to `progress`, a Python callable
/// `progress(phase: str, done: int, total: int | None)`, or to nobody.
///
/// # Errors
/// What `progress` or a signal handler raises, such as `KeyboardInterrupt`.
pub fn interruptible<T: Send>(
    py: Python<'_>,
    progress: Option<Py<PyAny>>,
    work: impl FnOnce(&Reporter<'_>) -> T + Send,
) -> PyResult<T> {
    refuse_forks()?;
    let is_unwanted = AtomicBool::new(false);
    let is_unwanted = &is_unwanted;
    let (sender, receiver) = channel();
    let (outcome, raised) = py.detach(move || {
        std::thread::scope(|scope| {
            let worker = scope.spawn(move || {
                let reporter = Reporter {
                    sender,
                    is_unwanted,
                };
                catch_unwind(AssertUnwindSafe(|| work(&reporter)))
            });
            let raised = attend(receiver, progress, is_unwanted);
            (worker.join().and_then(|outcome| outcome), raised)
        })
    });
    match (raised, outcome) {
        (Some(raised), Err(end)) if !end.is::<Unwanted>() => {
            drop(raised);
            resume_unwind(end)
        }
        (Some(raised), _) => Err(raised),
        (None, Ok(result)) => Ok(result),
        (None, Err(panic)) => resume_unwind(panic),
    }
}

/// Hands on what the work reports until it ends; what Python raised meanwhile.
fn attend(
    receiver: Receiver<Report>,
    progress: Option<Py<PyAny>>,
    is_unwanted: &AtomicBool,
) -> Option<PyErr> {
    let mut shown = Shown::default();
    let mut raised = None;
    loop {
        let report = match receiver.recv_timeout(LOOK) {
            Ok(report) => Some(report),
            Err(RecvTimeoutError::Timeout) => None,
            Err(RecvTimeoutError::Disconnected) => return raised,
        };
        if raised.is_some() {
            continue;
        }
        let attended = Python::attach(|py| {
            if let Some(report) = report {
                shown.take(py, report, progress.as_ref())?;
            }
            py.check_signals()
        });
        if let Err(error) = attended {
            raised = Some(error);
            is_unwanted.store(true, Ordering::Relaxed);
        }
    }
}

/// Steps of work that says how much of its time is over.
const PARTS: usize = 1000;

/// The phase that was last reported to Python.
#[derive(Default)]
struct Shown {
    phase: String,
    done: usize,
    total: Option<usize>,
    /// Whether `done` of `total` is of all phases together.
    counts_all: bool,
}

impl Shown {
    fn take(
        &mut self,
        py: Python<'_>,
        report: Report,
        progress: Option<&Py<PyAny>>,
    ) -> PyResult<()> {
        match report {
            Report::Notice(text) => {
                let logger = py
                    .import("logging")?
                    .call_method1("getLogger", ("rig_reflectometry",))?;
                logger.call_method1("info", ("%s", text))?;
                return Ok(());
            }
            Report::Begin(phase, _) if self.counts_all => self.phase = phase,
            Report::Begin(phase, total) => {
                *self = Self {
                    phase,
                    done: 0,
                    total,
                    counts_all: false,
                };
            }
            Report::Advance(_) if self.counts_all => return Ok(()),
            Report::Advance(steps) => self.done += steps,
            Report::PartOver(part) => {
                self.done = (part * PARTS as f64) as usize;
                self.total = Some(PARTS);
                self.counts_all = true;
                // Else the phase's name follows.
                if self.done < PARTS {
                    return Ok(());
                }
            }
        }
        match progress {
            Some(progress) => progress
                .call1(py, (&self.phase, self.done, self.total))
                .map(drop),
            None => Ok(()),
        }
    }
}

enum Report {
    Begin(String, Option<usize>),
    Advance(usize),
    PartOver(f64),
    Notice(String),
}

/// What work unwinds with once nobody wants its result.
struct Unwanted;

/// Receives what the work reports; ends it once its result is unwanted.
pub struct Reporter<'a> {
    sender: Sender<Report>,
    is_unwanted: &'a AtomicBool,
}

impl Reporter<'_> {
    fn report(&self, report: Report) {
        self.pulse();
        // The calling thread attends until this sender is gone.
        let _ = self.sender.send(report);
    }
}

impl Progress for Reporter<'_> {
    fn begin(&self, phase: &str, steps: Option<usize>) {
        self.report(Report::Begin(phase.to_owned(), steps));
    }

    fn advance(&self, steps: usize) {
        self.report(Report::Advance(steps));
    }

    fn pulse(&self) {
        if self.is_unwanted.load(Ordering::Relaxed) {
            resume_unwind(Box::new(Unwanted));
        }
    }
}

impl Observer for Reporter<'_> {
    fn notice(&self, notice: Notice<'_>) {
        self.report(Report::Notice(notice.to_string()));
    }

    fn part_over(&self, part: f64) {
        self.report(Report::PartOver(part));
    }
}
