//! A console from its parts to its end: a signal, or a page that chooses another bench.

use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::process::ExitStatus;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender};
use std::time::{Duration, Instant};

use rustix::process::Signal as Sent;

use super::catalogue::{self, SessionPages};
use super::control::Control;
use super::facts::{Mode, facts};
use super::frames;
use super::guides::{self, Guides};
use super::held_devices::{self, BenchPorts, HeldDevices};
use super::hub::Hub;
use super::jobs::{self, JobError, Jobs, Kind, Program, Work};
use super::picture::outline_routes;
use super::queue;
use super::rigs::{self, Rigs};
use super::server::{Parts, Server, ServerError};
use crate::config::{ConfigError, Origin, ResolvedRig, RigConfig};
use crate::fault::{Advisor, Fault};
use crate::interrupt::Signal;
use crate::session::{Session, SessionError};

/// The devices are closed in this time, or the guardian sees to the lamp.
const CLOSING: Duration = Duration::from_secs(15);
/// Before it is suspended the console waits no longer for that.
const SUSPENDING: Duration = Duration::from_secs(4);
/// How often a job that was asked to end is sent SIGCONT: it may have paused itself at that moment.
const CONTINUE: Duration = Duration::from_millis(250);
/// A job has so long to end after a second signal; then it is killed, and the guardian turns
/// the lamp off.
const KILL_AFTER: Duration = Duration::from_millis(2500);
/// A job that was killed is not waited for any longer.
const GIVE_UP_AFTER: Duration = Duration::from_millis(4500);

/// What a console is about.
#[derive(Clone, Debug)]
pub struct Subject {
    /// Its bench.
    pub rig: ResolvedRig,
    /// The bench as `--rig` takes it.
    pub named: String,
    /// Folder of the sessions.
    pub folder: PathBuf,
}

impl Subject {
    /// That of a session, which has its own rig.
    ///
    /// # Errors
    /// The session or its rig cannot be read.
    pub fn of_session(root: &Path) -> Result<Self, ConsoleError> {
        let session = Session::open(root)?;
        let record = session.record();
        let file = record.rig.clone();
        let bare = file.strip_prefix("built-in ");
        let named = bare.and_then(|name| name.strip_suffix(".toml"));
        let parent = root.parent().filter(|parent| *parent != Path::new(""));
        Ok(Self {
            named: named.unwrap_or(&file).to_owned(),
            folder: parent.unwrap_or(Path::new(".")).to_owned(),
            rig: ResolvedRig {
                config: RigConfig::parse(&file, Path::new(""), &record.config)?,
                origin: Origin::Argument,
                folder: Path::new(&file).parent().map(Path::to_owned),
                file,
            },
        })
    }
}

/// What wakes the thread that runs a console.
pub enum Woken {
    /// A signal to this process, by its number.
    Signal(i32),
    /// No job runs any more.
    JobEnded,
    /// A page has chosen another bench, or the same one as its file is now.
    Chosen(Box<ResolvedRig>, String),
}

/// What comes after a console.
pub enum Then {
    /// The end, with the last signal.
    End(Option<Signal>),
    /// A console of this bench at the same address.
    Bench(Box<ResolvedRig>, String),
}

/// What a console says to whoever started it.
pub enum Notice<'a> {
    /// Nothing runs; a signal ends the console.
    Ready,
    /// The capture that the console was started around has left this session.
    Captured(&'a Path),
    /// That capture has ended; the console stays until a signal.
    Stays,
    /// A signal ends the console when this job has stopped.
    Stopping(Kind),
    /// The devices were closed with this error.
    Closed(&'a str),
    /// The devices are not closed yet.
    NotClosed,
}

/// What a console needs of the program that starts it.
pub struct Surroundings<'a> {
    /// Opens the devices of a rig.
    pub ports: &'a dyn Fn(&ResolvedRig, &Control) -> BenchPorts,
    /// The advice on errors.
    pub advisor: Advisor,
    /// Wakes the thread that runs the console.
    pub wake: Sender<Woken>,
    /// What has woken it.
    pub woken: Receiver<Woken>,
    /// Takes what the console says.
    pub tell: &'a dyn Fn(Notice<'_>),
    /// Suspends this process, as Ctrl-Z does.
    pub suspend: fn(),
}

impl Surroundings<'_> {
    /// Whether another signal to end has come.
    pub fn is_urgent(&self) -> bool {
        let suspends = Sent::TSTP.as_raw();
        let mut woken = self.woken.try_iter();
        woken.any(|woken| matches!(woken, Woken::Signal(number) if number != suspends))
    }
}

/// Why a console could not begin or go on.
#[derive(Debug, thiserror::Error)]
pub enum ConsoleError {
    /// The work that it should begin with.
    #[error("{0}")]
    Work(#[from] JobError),
    /// Its server does not start.
    #[error("{0}")]
    Server(#[from] ServerError),
    /// The session that it is about.
    #[error("{0}")]
    Session(#[from] SessionError),
    /// The rig of that session.
    #[error("{0}")]
    Rig(#[from] ConfigError),
    /// The system gives no thread.
    #[error("{0}")]
    Io(#[from] std::io::Error),
}

/// A console that answers.
pub struct Console {
    jobs: Jobs,
    bench: HeldDevices,
}

impl Console {
    /// Is what this server serves from now on.
    ///
    /// # Errors
    /// The bench's thread or the server's cannot be started.
    pub fn start(
        subject: &Subject,
        server: &mut Server,
        around: &Surroundings<'_>,
    ) -> Result<Self, ConsoleError> {
        let Subject { rig, named, folder } = subject;

        // The console's parts.
        let hub = Hub::default();
        let control = Control::new(hub.clone());
        let program = Program {
            path: std::env::current_exe()?,
            rig: named.clone(),
            folder: folder.clone(),
        };
        let jobs = Jobs::new(program, hub.clone());
        let bench = HeldDevices::new(hub.clone(), (around.ports)(rig, &control))?;
        let pages = Arc::new(SessionPages::new(folder, around.advisor.clone()));

        // A job gets the devices that the bench holds.
        let lender = bench.clone();
        jobs.lend_devices(Arc::new(move |kind| {
            let devices = |fault: Fault| JobError::Devices {
                fact: fault.error,
                hint: fault.hint,
            };
            let loan = lender.lend(kind.what(), CLOSING).map_err(devices)?;
            Ok(Box::new(loan) as jobs::Loan)
        }));
        let borrowers = jobs.clone();
        bench.stop_borrower_by(Box::new(move || {
            borrowers.has_devices() && borrowers.stop().is_some()
        }));

        let wake = around.wake.clone();
        let choose = Arc::new(move |named, rig| {
            // The main thread may be ending.
            let _ = wake.send(Woken::Chosen(Box::new(rig), named));
        });
        let rigs = Rigs::new(Path::new("."), named, rig, jobs.clone(), choose);

        // The server.
        let routes = jobs::routes(jobs.clone())
            .merge(held_devices::routes(bench.clone()))
            .merge(frames::routes(&jobs))
            .merge(outline_routes(
                Some(rig.config.clone()),
                around.advisor.clone(),
            ))
            .merge(catalogue::routes(pages))
            .merge(catalogue::action_routes(jobs.clone()))
            .merge(guides::routes(Guides::new(
                jobs.clone(),
                bench.clone(),
                rig,
            )))
            .merge(queue::routes(jobs.clone()))
            .merge(rigs::routes(rigs));
        server.serve(Parts {
            hub,
            control,
            facts: facts(&rig.config, &rig.file, folder, Mode::Bench),
            routes,
        })?;
        Ok(Self { jobs, bench })
    }

    /// Starts `work`, if any, and stays until a signal ends the console or a page has chosen
    /// another bench. How a capture that it was started around ended is in `captured`.
    ///
    /// # Errors
    /// The work cannot be started.
    pub fn run(
        &self,
        work: Option<Work>,
        is_first: bool,
        captured: &mut Option<Option<ExitStatus>>,
        around: &Surroundings<'_>,
    ) -> Result<Then, ConsoleError> {
        // Only the first console is around a capture.
        let is_capture = work.is_some();
        if let Some(work) = work {
            self.jobs.start(work)?;
            self.wait_for_job(&around.wake)?;
        } else if is_first {
            (around.tell)(Notice::Ready);
        }
        Ok(self.until_ended(is_capture, captured, around)?)
    }

    /// Returns when a signal has ended the console and the job has ended.
    fn until_ended(
        &self,
        is_capture: bool,
        captured: &mut Option<Option<ExitStatus>>,
        around: &Surroundings<'_>,
    ) -> std::io::Result<Then> {
        let suspends = Sent::TSTP.as_raw();
        let had_terminal = terminal().is_some();
        let mut ending = None::<Signal>;
        // A second signal.
        let mut urgent_since = None::<Instant>;
        loop {
            match around.woken.recv_timeout(CONTINUE) {
                Err(RecvTimeoutError::Disconnected) => break,
                Err(RecvTimeoutError::Timeout) if ending.is_some() => {
                    self.jobs.send(&[Sent::CONT]);
                }
                Err(RecvTimeoutError::Timeout) => {}
                Ok(Woken::JobEnded) => {
                    if is_capture && captured.is_none() {
                        *captured = Some(self.captured(around));
                        if ending.is_none() {
                            (around.tell)(Notice::Stays);
                        }
                    }
                    if ending.is_some() && self.jobs.running().is_none() {
                        break;
                    }
                }
                // A job may have begun since the page was answered: the bench is its own. One that
                // began from now on would be in nobody's hands.
                Ok(Woken::Chosen(..)) if ending.is_some() || !self.jobs.close_if_idle() => {}
                Ok(Woken::Chosen(rig, named)) => return Ok(Then::Bench(rig, named)),
                Ok(Woken::Signal(number)) if number == suspends => {
                    // The lamp must not stay on while nobody watches over it.
                    drop(
                        self.bench
                            .lend("nobody: the console is suspended", SUSPENDING),
                    );
                    (around.suspend)();
                }
                Ok(Woken::Signal(number)) => {
                    let signal = Signal::from_number(number).unwrap_or(Signal::Terminate);
                    self.jobs.close();
                    if ending.replace(signal).is_some() {
                        urgent_since.get_or_insert_with(Instant::now);
                        let _ = self.jobs.stop();
                        continue;
                    }
                    let Some(kind) = self.jobs.running() else {
                        // Its end may not have woken this thread yet.
                        if is_capture && captured.is_none() {
                            *captured = Some(self.captured(around));
                        }
                        break;
                    };
                    (around.tell)(Notice::Stopping(kind));
                    self.wait_for_job(&around.wake)?;
                    let knows = is_capture && captured.is_none();
                    let signals = match knows && reaches_the_capture(number, had_terminal) {
                        true => &[][..],
                        false => &[sent(signal)],
                    };
                    self.jobs.pass_on(signals);
                }
            }
            match urgent_since.map(|since| since.elapsed()) {
                Some(waited) if waited >= GIVE_UP_AFTER => break,
                Some(waited) if waited >= KILL_AFTER => self.jobs.send(&[Sent::KILL]),
                _ => {}
            }
        }
        Ok(Then::End(ending))
    }

    /// How the capture ended.
    fn captured(&self, around: &Surroundings<'_>) -> Option<ExitStatus> {
        let status = self.jobs.wait();
        if let Some(session) = self.jobs.result() {
            (around.tell)(Notice::Captured(Path::new(&session)));
        }
        status
    }

    /// Lamp off, devices closed; another signal hurries it.
    pub fn close(&self, is_urgent: impl Fn() -> bool, around: &Surroundings<'_>) {
        let before = self.bench.state().error;
        let is_closed = self.bench.end(CLOSING, is_urgent);
        let error = self.bench.state().error;
        if let Some(fault) = error.filter(|error| Some(error) != before.as_ref()) {
            (around.tell)(Notice::Closed(&fault.error));
        } else if !is_closed {
            (around.tell)(Notice::NotClosed);
        }
    }

    /// Wakes the main thread when no job runs.
    fn wait_for_job(&self, wake: &Sender<Woken>) -> std::io::Result<()> {
        let (jobs, wake) = (self.jobs.clone(), wake.clone());
        std::thread::Builder::new()
            .name("job".into())
            .spawn(move || {
                jobs.wait();
                // The main thread may have ended meanwhile.
                let _ = wake.send(Woken::JobEnded);
            })?;
        Ok(())
    }
}

/// The controlling terminal, if there is one.
fn terminal() -> Option<OwnedFd> {
    use rustix::fs::{Mode, OFlags};
    let flags = OFlags::RDONLY | OFlags::NOCTTY | OFlags::CLOEXEC | OFlags::NONBLOCK;
    rustix::fs::open("/dev/tty", flags, Mode::empty()).ok()
}

/// Whether a signal has come from the terminal, which sends it to the capture there as well:
/// passed on, it would count twice.
fn reaches_the_capture(number: i32, had_terminal: bool) -> bool {
    let terminal = terminal();
    match number {
        _ if number == Sent::INT.as_raw() => {
            let group = terminal.and_then(|tty| rustix::termios::tcgetpgrp(tty).ok());
            group == Some(rustix::process::getpgrp())
        }
        // Of a terminal that is gone; the kernel tells the leader of a session alone.
        _ if number == Sent::HUP.as_raw() => {
            let is_leader = rustix::process::getsid(None).ok() == Some(rustix::process::getpid());
            had_terminal && terminal.is_none() && !is_leader
        }
        _ => false,
    }
}

fn sent(signal: Signal) -> Sent {
    match signal {
        Signal::Interrupt => Sent::INT,
        Signal::Terminate => Sent::TERM,
        Signal::HangUp => Sent::HUP,
    }
}
