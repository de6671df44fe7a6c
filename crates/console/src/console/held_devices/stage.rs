//! The stage's thread: motions, lamp, and what the stage reports.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use super::lamp_timer::LampTimer;
use super::ports::BenchPorts;
use super::shared::{Action, Command, SetOnDrop, Shared};
use super::state::{Busy, LampWord, StageFacts};
use crate::device::guardian::{Step, Watchdog};
use crate::device::{DeviceError, LampState, LightStage, StageStatus, StopHandle};
use crate::fault::Fault;

/// Commands are waited for in parts of this length.
const TICK: Duration = Duration::from_millis(50);
/// How often the stage is queried.
const QUERY: Duration = Duration::from_secs(1);
/// This thread gives a sign of life to the guardian at least so often.
const ALIVE: Duration = Duration::from_secs(2);
/// A lamp whose time is over is turned off by the stage's thread; where that thread is in a
/// motion, the motion is ended after this time.
const GRACE: Duration = Duration::from_secs(1);

/// Why the devices are closed without an error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Ended {
    /// A page may connect again.
    Disconnected,
    /// The bench ends.
    ForGood,
}

/// The lamp did not become what it was to be.
#[derive(Debug, thiserror::Error)]
#[error("{0}; the stage was stopped and reports its lamp off now")]
pub struct LampDisobeyed(pub DeviceError);

/// Without a stage: waits until that is to end.
pub(super) fn wait(commands: &Receiver<Command>, leave: &AtomicBool) -> Ended {
    while !leave.load(Ordering::SeqCst) {
        match commands.recv_timeout(TICK) {
            Ok(Command::Disconnect) => return Ended::Disconnected,
            Ok(Command::End) | Err(RecvTimeoutError::Disconnected) => return Ended::ForGood,
            Ok(Command::Connect | Command::Act(..)) | Err(RecvTimeoutError::Timeout) => {}
        }
    }
    Ended::Disconnected
}

/// Obeys commands until that is to end; the lamp is off then.
///
/// # Errors
/// The stage is lost, or was taken over by its guardian.
pub(super) fn obey(
    stage: &mut dyn LightStage,
    shared: &Shared,
    ports: &BenchPorts,
    commands: &Receiver<Command>,
    leave: &AtomicBool,
) -> Result<Ended, DeviceError> {
    let watchdog = stage.watchdog();
    let is_guarded = watchdog.is_kept();
    let mut loop_ = StageLoop {
        stop: stage.stop_handle()?,
        stage,
        shared,
        ports,
        alive: Alive::new(watchdog),
        switched: None,
        timer: None,
        queried: Instant::now(),
        stops_seen: shared.stops(),
    };
    let ended = loop_.run(commands, leave);
    // A mute stage is dropped at once: its guardian stops it then.
    let is_mute = ended.as_ref().is_err_and(DeviceError::is_without_answer);
    if is_guarded && is_mute {
        return ended;
    }
    // Also after an error, as far as it goes; dropping the stage tries again.
    let dark = loop_.go_dark();
    let ended = ended?;
    dark.map(|()| ended)
}

/// Keeps a step announced to the guardian between the stage's own ones, so that a thread
/// that hangs here is noticed while the camera's thread goes on.
struct Alive {
    watchdog: Watchdog,
    step: Option<Step>,
}

impl Alive {
    fn new(watchdog: Watchdog) -> Self {
        Self {
            watchdog,
            step: None,
        }
    }

    /// The new step begins before the old one ends.
    fn renew(&mut self) {
        self.step = Some(self.watchdog.step(ALIVE));
    }

    /// What follows announces itself.
    fn pass(&mut self) {
        self.step = None;
    }
}

struct StageLoop<'a> {
    stage: &'a mut dyn LightStage,
    /// Ends motion and lamp where the stage does not obey otherwise.
    stop: Box<dyn StopHandle>,
    shared: &'a Shared,
    ports: &'a BenchPorts,
    alive: Alive,
    /// How the lamp was switched last, for stages that don't report.
    switched: Option<LampState>,
    /// While the lamp is lit.
    timer: Option<LampTimer>,
    queried: Instant,
    stops_seen: u64,
}

impl StageLoop<'_> {
    fn run(
        &mut self,
        commands: &Receiver<Command>,
        leave: &AtomicBool,
    ) -> Result<Ended, DeviceError> {
        self.report(None)?;
        while !leave.load(Ordering::SeqCst) {
            self.alive.renew();
            // A command.
            match commands.recv_timeout(TICK) {
                Ok(Command::Act(action, stops)) => self.act(action, stops)?,
                Ok(Command::Disconnect) => return Ok(Ended::Disconnected),
                Ok(Command::End) | Err(RecvTimeoutError::Disconnected) => {
                    return Ok(Ended::ForGood);
                }
                Ok(Command::Connect) | Err(RecvTimeoutError::Timeout) => {}
            }
            self.alive.watchdog.check()?;
            // A stop from another thread has ended motion and lamp.
            let stops = self.shared.stops();
            if stops != self.stops_seen {
                self.stops_seen = stops;
                self.after_stop()?;
            }
            // The lamp of a page that is silent.
            if self.time_left().is_some_and(|left| left.is_zero()) {
                let fact = "the lamp was turned off: the page that controls is silent";
                let fault = self.switch(LampState::Off)?;
                self.report(Some(fault.unwrap_or_else(|| Fault::new(fact))))?;
            }
            if self.queried.elapsed() >= QUERY {
                self.report(None)?;
            }
        }
        Ok(Ended::Disconnected)
    }

    /// Uses the stage, which announces its own steps.
    fn on_stage<T>(&mut self, act: impl FnOnce(&mut dyn LightStage) -> T) -> T {
        self.alive.pass();
        let result = act(self.stage);
        self.alive.renew();
        result
    }

    /// Carries out what was accepted, unless a stop came after it. Errors that leave the
    /// stage usable are published.
    fn act(&mut self, action: Action, stops: u64) -> Result<(), DeviceError> {
        // In this order: a stop that is not seen here sees the action and waits for its end.
        self.shared.acting.store(true, Ordering::SeqCst);
        let is_stopped = self.shared.stops() != stops;
        let outcome = match (is_stopped, action) {
            (true, _) => Ok(None),
            (false, Action::Home) => self.on_stage(|stage| stage.home().map(|_| None)),
            (false, Action::Move(target)) => {
                self.on_stage(|stage| stage.move_to(target).map(|_| None))
            }
            (false, Action::Lamp(lamp)) => self.switch(lamp),
        };
        self.shared.acting.store(false, Ordering::SeqCst);
        let was_stopped = self.shared.stops() != stops;
        match outcome {
            // What a stop interrupts fails: whether the stage is there, its state shows.
            Err(_) | Ok(Some(_)) if was_stopped => Ok(()),
            Err(error) if ends_the_connection(&error) => Err(error),
            Err(error) => self.report(Some(self.ports.advisor.fault(&error))),
            Ok(fault) => self.report(fault),
        }
    }

    /// Switches the lamp; what went wrong, if the stage is usable nevertheless. A lamp that is
    /// not reported as it was to be is not left so: the stage is stopped, by a reset where it
    /// has one.
    fn switch(&mut self, lamp: LampState) -> Result<Option<Fault>, DeviceError> {
        let error = match self.on_stage(|stage| stage.set_lamp(lamp)) {
            Ok(applied) => {
                self.lamp_is(applied);
                return Ok(None);
            }
            // Closing the stage turns the lamp off.
            Err(error) if ends_the_connection(&error) => return Err(error),
            Err(error) => error,
        };
        let is = self.on_stage(|stage| stage.status())?.lamp;
        if is == Some(LampState::Off) {
            self.lamp_is(LampState::Off);
            let is_as_wanted = lamp == LampState::Off;
            return Ok((!is_as_wanted).then(|| self.ports.advisor.fault(&error)));
        }
        // Refused before anything was sent, such as a channel that the lamp does not have.
        let reports = self.stage.reports_lamp();
        let is_as_before = is == self.switched || is.is_none() && !reports;
        let is_refused = matches!(error, DeviceError::Refused { .. }) && lamp != LampState::Off;
        if is_refused && is_as_before {
            return Ok(Some(self.ports.advisor.fault(&error)));
        }
        self.stop_stage()?;
        Ok(Some(match reports {
            true => self.ports.advisor.fault(&LampDisobeyed(error)),
            false => self.ports.advisor.fault(&error),
        }))
    }

    fn lamp_is(&mut self, lamp: LampState) {
        self.switched = Some(lamp);
        self.timer = match lamp {
            LampState::Off => None,
            LampState::On(_) => Some(LampTimer::lit(Instant::now())),
        };
    }

    /// Motion and lamp end, as the stage then reports itself.
    fn stop_stage(&mut self) -> Result<(), DeviceError> {
        self.alive.pass();
        let stopped = self.stop.stop();
        self.alive.renew();
        stopped?;
        // This tells driver and guardian so. A stage that is locked after a stop may refuse.
        match self.on_stage(|stage| stage.set_lamp(LampState::Off)) {
            Err(error @ DeviceError::NotApplied { .. }) => Err(error),
            Err(error) if ends_the_connection(&error) => Err(error),
            _ => {
                self.lamp_is(LampState::Off);
                Ok(())
            }
        }
    }

    /// At the end: a fault is shown where the devices are closed.
    fn go_dark(&mut self) -> Result<(), DeviceError> {
        if self.is_lit()
            && let Some(fault) = self.switch(LampState::Off)?
        {
            self.shared.change(|state| state.error = Some(fault));
        }
        Ok(())
    }

    /// Motion and lamp have ended; that is reported, and the lamp's end made certain.
    fn after_stop(&mut self) -> Result<(), DeviceError> {
        while self.shared.stopping.load(Ordering::SeqCst) > 0 {
            self.alive.renew();
            std::thread::sleep(TICK);
        }
        // The stop did it; this tells driver and guardian so, and whether it is so.
        let fault = match self.is_lit() {
            true => self.switch(LampState::Off)?,
            false => None,
        };
        self.lamp_is(LampState::Off);
        self.report(fault)
    }

    fn is_lit(&self) -> bool {
        self.timer.is_some()
    }

    fn time_left(&mut self) -> Option<Duration> {
        let now = Instant::now();
        let silence = (self.ports.silence)();
        let timer = self.timer.as_mut()?;
        timer.hear(silence, now);
        Some(timer.left(now))
    }

    /// Queries the stage and publishes its state, with an error if there is one. The last
    /// action is over then.
    fn report(&mut self, fault: Option<Fault>) -> Result<(), DeviceError> {
        self.queried = Instant::now();
        let status = self.on_stage(|stage| stage.status())?;
        if matches!(status.lamp, Some(LampState::On(_))) && !self.is_lit() {
            // Somebody else has lit it: it is watched over all the same.
            self.timer = Some(LampTimer::lit(self.queried));
        }
        let has_gone_out = self.is_lit() && status.lamp == Some(LampState::Off);
        if has_gone_out {
            self.timer = None;
            self.switched = Some(LampState::Off);
        }
        let left = self.time_left();
        let facts = facts(&status, self.switched, self.stage.reports_lamp());
        self.shared.change(|state| {
            state.stage = Some(facts);
            state.lamp_off_in_s = left.map(|left| left.as_secs_f64());
            if matches!(
                state.busy,
                Some(Busy::Homing | Busy::Moving | Busy::Switching)
            ) {
                state.busy = None;
            }
            if has_gone_out {
                state.error = Some(Fault::new("the lamp is no longer lit"));
            }
            if fault.is_some() {
                state.error = fault;
            }
        });
        Ok(())
    }
}

/// What a page is shown of a status.
pub(super) fn facts(
    status: &StageStatus,
    switched: Option<LampState>,
    reports_lamp: bool,
) -> StageFacts {
    let lamp_word = match reports_lamp {
        true => Some(LampWord::Reported),
        false => switched.map(|_| LampWord::Sent),
    };
    StageFacts {
        lamp_word,
        activity: status.activity,
        position: status.position,
        target: None,
        lamp: status.lamp.or(switched).unwrap_or(LampState::Off),
    }
}

/// Whether a stage that reports this is not to be used any more.
fn ends_the_connection(error: &DeviceError) -> bool {
    use DeviceError::*;
    !matches!(
        error,
        Refused { .. }
            | Alarm { .. }
            | NotHomed { .. }
            | OutOfReach { .. }
            | NotApplied { .. }
            | Firmware { .. }
    )
}

/// Ends a motion during which the lamp's time is over: the stage's thread cannot turn it off
/// meanwhile. Returns when it is to leave.
pub(super) fn stop_unwatched(
    shared: &Arc<Shared>,
    ports: &BenchPorts,
    leave: &AtomicBool,
    stop: impl Fn(&Arc<Shared>),
) {
    let _leave = SetOnDrop(leave);
    let mut timer = None::<LampTimer>;
    let mut over_since = None::<Instant>;
    while !leave.load(Ordering::SeqCst) {
        std::thread::sleep(TICK);
        let now = Instant::now();
        let stage = shared.state().stage;
        let is_lit = stage.is_some_and(|stage| stage.lamp != LampState::Off);
        if !is_lit {
            (timer, over_since) = (None, None);
            continue;
        }
        let timer = timer.get_or_insert_with(|| LampTimer::lit(now));
        timer.hear((ports.silence)(), now);
        if !(timer.left(now).is_zero() && shared.is_acting()) {
            over_since = None;
            continue;
        }
        let since = *over_since.get_or_insert(now);
        if now.saturating_duration_since(since) >= GRACE {
            over_since = None;
            stop(shared);
        }
    }
}
