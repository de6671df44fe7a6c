//! Ctrl-C, SIGTERM and SIGHUP become requests to stop on an [`Interrupt`], Ctrl-Z
//! (SIGTSTP) one to pause: a program that the shell suspends on its own would
//! leave the lamp on.
//!
//! Only commands that hold hardware or a session listen; every other command
//! keeps the system's default and ends at once.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};

use signal_hook::consts::{SIGCONT, SIGHUP, SIGINT, SIGTERM, SIGTSTP};
use signal_hook::flag::register_usize;
use signal_hook::iterator::Signals;
use signal_hook::low_level::emulate_default_handler;

use super::context::Context;
use super::error::CliError;
use super::output::write_stderr;
use super::stderr;
use crate::interrupt::{Interrupt, Signal, StopLevel, Watching};

/// Starts to listen; from now on the command must poll what this returns.
pub fn listen() -> Result<Interrupt, CliError> {
    let mut signals = signals()?;
    let interrupt = Interrupt::new();
    let raised = interrupt.clone();
    std::thread::Builder::new()
        .name("signals".into())
        .spawn(move || {
            for number in signals.forever() {
                match Signal::from_number(number) {
                    Some(signal) => raised.raise(signal),
                    None => raised.ask_for_pause(),
                }
            }
        })?;
    Ok(interrupt)
}

/// Where a file would pass the size that the shell allows (`ulimit -f`), the system kills a
/// process that does not catch its signal; one that does gets an error from the write.
pub fn outlive_file_limits() {
    let caught = std::sync::Arc::default();
    // It can only fail for a signal that does not exist. Programs that are started do not inherit it.
    drop(signal_hook::flag::register(
        signal_hook::consts::SIGXFSZ,
        caught,
    ));
}

/// The latest of SIGTSTP and SIGCONT, where [`signals`] are heard.
static PAUSE: OnceLock<Arc<AtomicUsize>> = OnceLock::new();
/// It is SIGCONT.
const CONTINUED: usize = 1;

/// The signals that are listened to; and [`suspend`] knows of those that continue.
pub(super) fn signals() -> std::io::Result<Signals> {
    let latest = PAUSE.get_or_init(Arc::default);
    // Stored by the signal handlers, because `Signals` delivers pending signals in the order of their
    // numbers, not of their arrival.
    register_usize(SIGTSTP, latest.clone(), 0)?;
    register_usize(SIGCONT, latest.clone(), CONTINUED)?;
    Signals::new([SIGINT, SIGTERM, SIGHUP, SIGTSTP])
}

/// Suspends this process as Ctrl-Z does where nobody listens; returns when it is
/// continued (`fg`, SIGCONT), at once where it already was: making the bench safe takes time.
pub fn suspend() {
    stderr::flush_in_order();
    let latest = PAUSE.get().map(|latest| latest.load(Ordering::SeqCst));
    if latest == Some(CONTINUED) {
        return;
    }
    // It can only fail for a signal that does not exist.
    drop(emulate_default_handler(SIGTSTP));
}

/// For a command that holds nothing that must be ended in good order: a signal, also one that
/// was heard before, ends the program at once, with this error.
pub fn end_on_signal(
    context: &Context,
    interrupt: &Interrupt,
    error: impl Fn(Signal) -> CliError + Send + 'static,
) -> Result<(), CliError> {
    ending_on_signal(context, interrupt, error).map(std::mem::forget)
}

/// Likewise, until what is returned is dropped.
pub fn ending_on_signal(
    context: &Context,
    interrupt: &Interrupt,
    error: impl Fn(Signal) -> CliError + Send + 'static,
) -> Result<Watching, CliError> {
    let color = context.color;
    Ok(interrupt.watch(move |interrupt| {
        if let Some(signal) = interrupt.signal() {
            let error = error(signal);
            write_stderr(&error.render(color));
            stderr::flush(stderr::LAST_WORDS);
            std::process::exit(error.exit().code().into());
        }
        if interrupt.take_pause() {
            suspend();
        }
    })?)
}

/// Says at once that work which obeys between frames was asked to stop or to pause, until what
/// is returned is dropped: a frame may take long.
pub fn announcing(context: &Context, interrupt: &Interrupt) -> Result<Watching, CliError> {
    let context = context.clone();
    let mut said = Said::default();
    Ok(interrupt.watch(move |interrupt| {
        if let Some(text) = said.next(interrupt) {
            context.note(text);
        }
    })?)
}

/// What was said of the requests.
#[derive(Default)]
struct Said {
    stop: bool,
    pause: bool,
}

impl Said {
    /// What is to be said now.
    fn next(&mut self, interrupt: &Interrupt) -> Option<&'static str> {
        let stop = interrupt.level() == StopLevel::AfterThisFrame;
        if stop && !std::mem::replace(&mut self.stop, true) {
            return Some("stopping after this frame; Ctrl-C again stops now");
        }
        let pause = interrupt.wants_pause();
        let is_new = !std::mem::replace(&mut self.pause, pause);
        (pause && is_new).then_some("pausing after this frame")
    }
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, Instant};

    use super::*;

    #[test]
    fn each_request_is_announced_once() {
        let (interrupt, mut said) = (Interrupt::new(), Said::default());
        let mut next = |interrupt: &Interrupt| [said.next(interrupt), said.next(interrupt)];
        assert_eq!(next(&interrupt), [None, None]);
        for _ in 0..2 {
            interrupt.ask_for_pause();
            assert_eq!(next(&interrupt), [Some("pausing after this frame"), None]);
            interrupt.take_pause();
            assert_eq!(next(&interrupt), [None, None]);
        }
        interrupt.raise(Signal::Interrupt);
        let stopping = "stopping after this frame; Ctrl-C again stops now";
        assert_eq!(next(&interrupt), [Some(stopping), None]);
        interrupt.raise(Signal::Interrupt);
        assert_eq!(next(&interrupt), [None, None]);
    }

    /// Every signal to the process makes the request more urgent.
    #[test]
    fn signals_become_requests() {
        let interrupt = listen().unwrap();
        let steps = [
            (SIGTERM, StopLevel::AfterThisFrame, Signal::Terminate),
            (SIGINT, StopLevel::Now, Signal::Interrupt),
        ];
        for (number, level, signal) in steps {
            signal_hook::low_level::raise(number).unwrap();
            let patience = Instant::now() + Duration::from_secs(20);
            while interrupt.level() != level && Instant::now() < patience {
                std::thread::yield_now();
            }
            assert_eq!(interrupt.level(), level);
            assert_eq!(interrupt.signal(), Some(signal));
        }
    }
}
