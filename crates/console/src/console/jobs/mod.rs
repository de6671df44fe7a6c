//! Work as processes of this very program: one job at a time (a capture, a fit, a calibration, an
//! export),
//! and short commands whose JSON the page shows.
//!
//! A job is watched by threads: one reads its events, one its messages, one waits for its
//! end, and one keeps the state of all and publishes it. None of them holds the job up for
//! longer than a pipe that is full, which a capture does not wait for.

mod capture_state;
mod job_state;
mod log;
mod process;
mod query;
mod reading;
mod routes;

use std::ffi::OsString;
use std::io::Write;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{ChildStdin, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use rustix::process::Signal;
use serde_json::Value;

pub use self::capture_state::{CaptureState, StoredFrame};
pub use self::job_state::{Kind, State};
pub use self::query::{Answer, QueryError, query};
pub use self::routes::routes;
pub(super) use self::routes::{AskedLights, SHORT, capture, option, without_fit};
pub use crate::shell_words::command_line as shown;

use self::job_state::JobState;
use self::process::Process;
use self::reading::{Heard, read_events, read_messages};
use super::hub::Hub;
use crate::capture::Progress;
use crate::file_system::free_bytes;

/// States are published so often at most.
const PUBLISH: Duration = Duration::from_millis(100);
/// The free space of the disk is read so often.
const DISK: Duration = Duration::from_secs(2);
/// What a job has printed before its end is awaited for so long: another process may have
/// inherited its pipes.
const LAST_WORDS: Duration = Duration::from_secs(2);
/// Likewise where the console is ending: a guardian may go on for seconds.
const LAST_WORDS_AT_END: Duration = Duration::from_millis(300);
/// Short commands that run at once.
const MOST_QUERIES: usize = 2;
/// Short commands that run or wait: a part of the server's places stays free for actions.
const MOST_ASKED: usize = 64;
/// A job that is stopped again so long after the first time is killed; the guardian turns
/// the lamp off.
const KILL_AFTER: Duration = Duration::from_secs(10);

/// Closes the devices that the console holds itself, lamp off, until what it returns is
/// dropped; they go to a job of this kind.
pub type Lend = Arc<dyn Fn(Kind) -> Result<Loan, JobError> + Send + Sync>;
/// While it lasts the devices are the job's.
pub type Loan = Box<dyn Send>;
/// Called with each frame that a capture has on the disk: its session's folder, and its file
/// in that.
pub type Stored = Arc<dyn Fn(&Path, &str) + Send + Sync>;

/// What all jobs have in common.
#[derive(Clone, Debug)]
pub struct Program {
    /// This program.
    pub path: PathBuf,
    /// As `--rig` takes it.
    pub rig: String,
    /// The folder of the sessions.
    pub folder: PathBuf,
}

/// A job to start.
#[derive(Clone, Debug)]
pub struct Work {
    /// What it is.
    pub kind: Kind,
    /// Of the program.
    pub arguments: Vec<OsString>,
    /// Arguments that only the console needs, such as `--events`: not shown.
    pub hidden: Vec<OsString>,
    /// The session that it works on, by name.
    pub session: Option<String>,
    /// Where a page gets its results, relative to the page.
    pub downloads: Vec<String>,
    /// Whether the job has the console's terminal: its messages go there.
    pub at_terminal: bool,
    /// Whether it needs the bench's devices.
    pub takes_devices: bool,
}

impl Work {
    /// With nothing but arguments.
    pub fn new(kind: Kind, arguments: Vec<OsString>) -> Self {
        Self {
            kind,
            arguments,
            hidden: Vec::new(),
            session: None,
            downloads: Vec::new(),
            at_terminal: false,
            takes_devices: kind == Kind::Capture,
        }
    }
}

/// Why a job was not started.
#[derive(Debug, thiserror::Error)]
pub enum JobError {
    /// There is one already.
    #[error("{} is running", .0.what())]
    Busy(Kind),
    /// The console is ending, as it does before one of another bench takes its place.
    #[error("the console is ending, or another bench was chosen")]
    Ending,
    /// The console's own bench does not let go of the devices.
    #[error("{fact}")]
    Devices {
        /// Why.
        fact: String,
        /// What to do about it.
        hint: Option<String>,
    },
    /// The system did not start it.
    #[error("{command}: {source}")]
    Begin {
        /// Its command line.
        command: String,
        /// The system's error.
        source: std::io::Error,
    },
}

/// The console's jobs; clones share them.
#[derive(Clone)]
pub struct Jobs(Arc<Shared>);

struct Shared {
    program: Program,
    hub: Hub,
    lend: OnceLock<Lend>,
    stored: OnceLock<Stored>,
    /// Short commands that run.
    queries: Arc<tokio::sync::Semaphore>,
    /// Those, and the ones that wait.
    asked: Arc<tokio::sync::Semaphore>,
    run: Mutex<Run>,
    ended: Condvar,
    shown: Mutex<Shown>,
}

/// What decides whether a job may start, and reaches the one that runs. Held for moments
/// only: the way of a STOP leads through it.
#[derive(Default)]
struct Run {
    kind: Option<Kind>,
    takes_devices: bool,
    process: Option<Arc<Process>>,
    first_stop: Option<Instant>,
    /// Counts the requests to pause.
    pauses: u64,
    /// Signals that came before the process was there.
    waiting: Vec<Signal>,
    /// Where a job reads the answers of the person at the bench.
    stdin: Option<ChildStdin>,
    /// The devices are the job's.
    loan: Option<Loan>,
    is_closed: bool,
    last_exit: Option<ExitStatus>,
}

/// What pages are shown.
#[derive(Default)]
struct Shown {
    job: JobState,
    capture: Option<CaptureState>,
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Jobs {
    /// No job yet.
    pub fn new(program: Program, hub: Hub) -> Self {
        let jobs = Self(Arc::new(Shared {
            program,
            hub,
            lend: OnceLock::new(),
            stored: OnceLock::new(),
            queries: Arc::new(tokio::sync::Semaphore::new(MOST_QUERIES)),
            asked: Arc::new(tokio::sync::Semaphore::new(MOST_ASKED)),
            run: Mutex::default(),
            ended: Condvar::new(),
            shown: Mutex::default(),
        }));
        jobs.publish();
        jobs
    }

    /// Called before each job that takes the devices.
    pub fn lend_devices(&self, lend: Lend) {
        let _ = self.0.lend.set(lend);
    }

    /// Called with each frame of a capture.
    pub fn watch_frames(&self, stored: Stored) {
        let _ = self.0.stored.set(stored);
    }

    /// What all jobs have in common.
    pub fn program(&self) -> &Program {
        &self.0.program
    }

    /// The job that runs or is about to.
    pub fn running(&self) -> Option<Kind> {
        locked(&self.0.run).kind
    }

    /// Whether a capture runs or is about to.
    pub fn is_capturing(&self) -> bool {
        self.running() == Some(Kind::Capture)
    }

    /// Whether the devices are those of a job that runs or is about to.
    pub fn has_devices(&self) -> bool {
        let run = locked(&self.0.run);
        run.kind.is_some() && run.takes_devices
    }

    /// The newest frame of the latest capture that is on the disk, and its session's folder.
    pub fn last_frame(&self) -> Option<(PathBuf, StoredFrame)> {
        let shown = locked(&self.0.shown);
        let capture = shown.capture.as_ref()?;
        let frame = capture.frame.clone()?;
        Some((PathBuf::from(capture.session.as_ref()?), frame))
    }

    /// What was measured in the frame of this number, once, if it is still the newest.
    pub fn set_frame_figures(&self, number: u64, figures: Value) {
        let mut shown = locked(&self.0.shown);
        let frame = shown.capture.as_mut().and_then(|c| c.frame.as_mut());
        let is_new = |frame: &&mut StoredFrame| frame.number == number && frame.figures.is_none();
        if let Some(frame) = frame.filter(is_new) {
            frame.figures = Some(figures);
            drop(shown);
            self.publish();
        }
    }

    /// Starts a job; its command line as it is shown.
    ///
    /// # Errors
    /// If there is one, the console is ending, or the system refuses.
    pub fn start(&self, work: Work) -> Result<String, JobError> {
        // The only job, from now on.
        let mut run = locked(&self.0.run);
        match run.kind {
            _ if run.is_closed => return Err(JobError::Ending),
            Some(kind) => return Err(JobError::Busy(kind)),
            None => {}
        }
        *run = Run {
            kind: Some(work.kind),
            takes_devices: work.takes_devices,
            ..Run::default()
        };
        drop(run);
        let line = shown("rig", &work.arguments);

        // The process. It may need the devices that the console holds.
        let lend = self.0.lend.get().filter(|_| work.takes_devices);
        let begun = lend
            .map(|lend| lend(work.kind))
            .transpose()
            .and_then(|loan| {
                let failed = |source| JobError::Begin {
                    command: line.clone(),
                    source,
                };
                // The devices may have been waited for.
                if locked(&self.0.run).is_closed {
                    return Err(JobError::Ending);
                }
                Ok((loan, self.spawn(&work).map_err(failed)?))
            });
        let (loan, (process, stdin, stdout, stderr)) = match begun {
            Ok(begun) => begun,
            Err(error) => {
                locked(&self.0.run).kind = None;
                self.0.ended.notify_all();
                return Err(error);
            }
        };
        // It can be reached from now on; what was asked of it meanwhile comes first.
        {
            let mut run = locked(&self.0.run);
            let waiting = std::mem::take(&mut run.waiting);
            process.send(&waiting);
            run.process = Some(process.clone());
            run.loan = loan;
            run.stdin = stdin;
        }
        {
            let mut shown = locked(&self.0.shown);
            shown.job = JobState::begun(&work, line.clone(), process.pid());
            if work.kind == Kind::Capture {
                shown.capture = Some(CaptureState::after(shown.capture.as_ref()));
            }
        }
        self.publish();

        // Its threads.
        let (sender, heard) = sync_channel(1000);
        self.watch(&process, stdout, stderr, sender);
        let jobs = self.clone();
        std::thread::spawn(move || jobs.follow(&heard));
        Ok(line)
    }

    fn spawn(&self, work: &Work) -> std::io::Result<Spawned> {
        let mut command = Command::new(&self.0.program.path);
        command
            .args(&work.arguments)
            .args(&work.hidden)
            .stdout(Stdio::piped());
        if !work.at_terminal {
            command
                .env("NO_COLOR", "1")
                // What the terminal sends is for the console, which passes it on.
                .process_group(0)
                .stderr(Stdio::piped());
        }
        // The page answers what is asked, also where the messages go to a terminal.
        command.stdin(match work.kind {
            Kind::Capture | Kind::Calibration => Stdio::piped(),
            Kind::Fit | Kind::Export => Stdio::null(),
        });
        let mut child = command.spawn()?;
        let pipes = (child.stdin.take(), child.stdout.take(), child.stderr.take());
        Ok((Arc::new(Process::new(child)), pipes.0, pipes.1, pipes.2))
    }

    /// The threads that report to `sender`.
    fn watch(
        &self,
        process: &Arc<Process>,
        stdout: Option<std::process::ChildStdout>,
        stderr: Option<std::process::ChildStderr>,
        sender: SyncSender<Heard>,
    ) {
        let (done, both_done) = sync_channel(2);
        let (events, ended) = (sender.clone(), done.clone());
        std::thread::spawn(move || {
            if let Some(stdout) = stdout {
                read_events(stdout, &events);
            }
            let _ = ended.send(());
        });
        let messages = sender.clone();
        std::thread::spawn(move || {
            if let Some(stderr) = stderr {
                read_messages(stderr, &messages);
            }
            let _ = done.send(());
        });
        let (process, jobs) = (process.clone(), self.clone());
        std::thread::spawn(move || {
            let status = process.wait();
            let patience = match locked(&jobs.0.run).is_closed {
                true => LAST_WORDS_AT_END,
                false => LAST_WORDS,
            };
            let latest = Instant::now() + patience;
            for _ in 0..2 {
                let left = latest.saturating_duration_since(Instant::now());
                let _ = both_done.recv_timeout(left);
            }
            drop(sender.send(Heard::Ended(status)));
        });
    }

    /// Keeps the state of a job until it has ended.
    fn follow(&self, heard: &Receiver<Heard>) {
        let mut disk_read: Option<Instant> = None;
        loop {
            // What comes within one interval is published once.
            let Ok(first) = heard.recv() else { return };
            let latest = Instant::now() + PUBLISH;
            let mut next = Ok(first);
            let mut ended = None;
            loop {
                match next {
                    Ok(Heard::Ended(status)) => ended = Some(status),
                    Ok(heard) => self.hear(heard),
                    Err(RecvTimeoutError::Timeout) => break,
                    Err(RecvTimeoutError::Disconnected) => break,
                }
                if ended.is_some() {
                    break;
                }
                next = heard.recv_timeout(latest.saturating_duration_since(Instant::now()));
            }
            // Also at the end, which may have been a full disk.
            if ended.is_some() || disk_read.is_none_or(|read| read.elapsed() >= DISK) {
                disk_read = Some(Instant::now());
                let free = free_bytes(&self.0.program.folder).ok();
                if let Some(capture) = &mut locked(&self.0.shown).capture {
                    capture.disk_free_bytes = free;
                }
            }
            if let Some(status) = ended {
                self.end(status);
                return;
            }
            self.publish();
        }
    }

    fn hear(&self, heard: Heard) {
        let mut shown = locked(&self.0.shown);
        let is_frame = matches!(&heard, Heard::Event(stamped)
            if matches!(stamped.event, Progress::Stored { .. }));
        shown.hear(heard);
        drop(shown);
        if is_frame
            && let Some(stored) = self.0.stored.get()
            && let Some((session, frame)) = self.last_frame()
        {
            stored(&session, &frame.file);
        }
    }

    fn end(&self, status: Option<ExitStatus>) {
        locked(&self.0.shown).end(status);
        self.publish();
        announce_sessions(&self.0.hub);
        let mut run = locked(&self.0.run);
        run.kind = None;
        run.process = None;
        run.stdin = None;
        run.last_exit = status;
        let loan = run.loan.take();
        drop(run);
        drop(loan);
        self.0.ended.notify_all();
    }

    fn publish(&self) {
        let shown = locked(&self.0.shown);
        let capture = serde_json::to_value(&shown.capture).unwrap_or_default();
        let job = shown.job.json();
        // Published under the lock, so that an older state never follows a newer one.
        self.0.hub.publish("capture", capture);
        self.0.hub.publish("job", job);
    }

    /// Waits until no job runs; how the last one ended.
    pub fn wait(&self) -> Option<ExitStatus> {
        let mut run = locked(&self.0.run);
        while run.kind.is_some() {
            run = match self.0.ended.wait(run) {
                Ok(run) => run,
                Err(poisoned) => poisoned.into_inner(),
            };
        }
        run.last_exit
    }

    /// What the last job printed as its result.
    pub fn result(&self) -> Option<String> {
        locked(&self.0.shown).job.result.clone()
    }

    /// No job starts any more.
    pub fn close(&self) {
        locked(&self.0.run).is_closed = true;
    }

    /// No job starts any more, unless one runs or is about to; whether that is so.
    pub fn close_if_idle(&self) -> bool {
        let mut run = locked(&self.0.run);
        let is_idle = run.kind.is_none();
        run.is_closed |= is_idle;
        is_idle
    }

    /// Passes signals on to the job that runs, if any. Never waits for it.
    pub fn send(&self, signals: &[Signal]) {
        let mut run = locked(&self.0.run);
        match &run.process {
            Some(process) => process.send(signals),
            None if run.kind.is_some() => run.waiting.extend(signals),
            None => {}
        }
    }

    /// Pauses the capture, as Ctrl-Z does: lamp off, stage standing.
    pub fn pause(&self) {
        locked(&self.0.run).pauses += 1;
        self.send(&[Signal::TSTP]);
    }

    /// Continues it, as `fg` does.
    pub fn resume(&self) {
        self.wake();
    }

    /// Stops it after its present frame, as Ctrl-C does.
    pub fn finish(&self) {
        self.pass_on(&[Signal::INT]);
    }

    /// Passes on that it is to end; one that is paused goes on, so that it can. One that asks
    /// the person at the bench waits no longer by itself: a "not done" from here might reach it
    /// before the signal does, and be a failure.
    pub fn pass_on(&self, signals: &[Signal]) {
        self.set_ending();
        self.send(signals);
        self.wake();
    }

    /// Stops it now, as a second Ctrl-C does. Two signals of one kind at once may arrive as
    /// one, so the second is another. Where it does not end, a repetition kills it. What is
    /// being stopped; `None` where no job runs.
    pub fn stop(&self) -> Option<Kind> {
        let mut run = locked(&self.0.run);
        let kind = run.kind?;
        let first = *run.first_stop.get_or_insert_with(Instant::now);
        drop(run);
        match first.elapsed() >= KILL_AFTER {
            true => self.send(&[Signal::KILL]),
            false => self.send(&[Signal::INT, Signal::TERM]),
        }
        self.set_ending();
        self.wake();
        Some(kind)
    }

    /// A paused process takes no signal but this; it may be about to suspend itself, so it
    /// is repeated, unless another pause is requested meanwhile.
    fn wake(&self) {
        self.send(&[Signal::CONT]);
        let run = locked(&self.0.run);
        let (process, pauses) = (run.process.clone(), run.pauses);
        drop(run);
        let jobs = self.clone();
        std::thread::spawn(move || {
            for pause_ms in [50, 200, 750] {
                std::thread::sleep(Duration::from_millis(pause_ms));
                // Held, so that no pause comes in between.
                let run = locked(&jobs.0.run);
                match &process {
                    Some(process) if run.pauses == pauses => process.send(&[Signal::CONT]),
                    _ => return,
                }
            }
        });
    }

    fn set_ending(&self) {
        let mut shown = locked(&self.0.shown);
        if !matches!(shown.job.state, Some(State::Running | State::Paused)) {
            return;
        }
        shown.job.state = Some(State::Ending);
        // Publishing takes the lock.
        drop(shown);
        self.publish();
    }

    /// Answers the job's question of this number: whether the person has done what it asks.
    /// `false` where that question is open no more.
    pub fn answer(&self, number: u64, done: bool) -> bool {
        let mut shown = locked(&self.0.shown);
        let is_open = shown.job.answered(number);
        drop(shown);
        if is_open && let Some(stdin) = &mut locked(&self.0.run).stdin {
            let line = serde_json::json!({"number": number, "done": done});
            // A job that has just ended takes none; an answer a question never fills the pipe.
            let _ = writeln!(stdin, "{line}");
        }
        self.publish();
        is_open
    }

    /// A short command, on this thread.
    ///
    /// # Errors
    /// As [`query`].
    pub fn query(
        &self,
        arguments: &[OsString],
        stdin: &[u8],
        limit: Duration,
    ) -> Result<Answer, QueryError> {
        query(&self.0.program.path, arguments, stdin, limit)
    }

    /// Likewise, for handlers: on another thread, and only two at once.
    ///
    /// # Errors
    /// As [`query`].
    pub async fn ask(
        &self,
        arguments: Vec<OsString>,
        stdin: Vec<u8>,
        limit: Duration,
    ) -> Result<Answer, QueryError> {
        let jobs = self.clone();
        let Ok(place) = self.0.asked.clone().try_acquire_owned() else {
            return Err(QueryError::Many);
        };
        // The semaphore is never closed. The command keeps its place also when the page that
        // asked is gone.
        let turn = self.0.queries.clone().acquire_owned().await.ok();
        let asked = tokio::task::spawn_blocking(move || {
            let answer = jobs.query(&arguments, &stdin, limit);
            drop((turn, place));
            answer
        });
        asked.await.unwrap_or_else(|_| {
            Err(QueryError::Failed {
                fact: "internal error".to_owned(),
                hint: None,
            })
        })
    }
}

type Spawned = (
    Arc<Process>,
    Option<ChildStdin>,
    Option<std::process::ChildStdout>,
    Option<std::process::ChildStderr>,
);

impl Shown {
    fn hear(&mut self, heard: Heard) {
        match heard {
            Heard::Event(stamped) => {
                self.job.apply(&stamped.event);
                let is_capture = self.job.kind == Some(Kind::Capture);
                if let Some(capture) = self.capture.as_mut().filter(|_| is_capture) {
                    capture.apply(*stamped);
                }
            }
            Heard::Result(line) => self.job.result = Some(line),
            Heard::Message(bytes) => self.job.log.add(&bytes),
            Heard::Ended(_) => {}
        }
    }

    fn end(&mut self, status: Option<ExitStatus>) {
        self.job.end(status);
        let was_stopped = self.job.state == Some(State::Interrupted);
        if self.job.kind == Some(Kind::Capture)
            && let Some(capture) = &mut self.capture
        {
            capture.process_ended(was_stopped);
        }
    }
}

/// The list of sessions has changed: pages load it again.
pub fn announce_sessions(hub: &Hub) {
    use std::sync::atomic::{AtomicU64, Ordering};
    static CHANGES: AtomicU64 = AtomicU64::new(0);
    let count = CHANGES.fetch_add(1, Ordering::Relaxed) + 1;
    hub.publish("sessions", serde_json::json!({"changed": count}));
}

/// Whether a name is that of a session's folder, not a path to elsewhere; the folder itself
/// is no symbolic link.
pub fn is_session(folder: &Path, name: &str) -> bool {
    let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '-' | '_');
    name.starts_with(|c: char| c.is_ascii_alphanumeric())
        && name.chars().all(allowed)
        && std::fs::symlink_metadata(folder.join(name)).is_ok_and(|is| is.is_dir())
}

#[cfg(test)]
mod tests;
