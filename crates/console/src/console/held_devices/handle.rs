//! What pages may do with the bench.

use std::sync::atomic::Ordering;
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Mutex, OnceLock};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::held;
use super::ports::BenchPorts;
use super::shared::{Action, Command, Shared, lock};
use super::state::{Busy, State};
use super::stop::{self, NotStopped, Stopping};
use crate::console::hub::Hub;
use crate::console::picture::live::LiveFrame;
use crate::device::{CameraSettings, LampChannel, LampState};
use crate::fault::{Advisor, Fault};
use crate::units::{Seconds, StageAngles};

/// Between two looks whether the thread has ended.
const LOOK: Duration = Duration::from_millis(5);

/// At the end a lamp that is still lit after this time is stopped by another thread.
const STOPPED_AFTER: Duration = Duration::from_millis(1500);
/// At the end all that is waited for but a frame of the camera takes no longer together.
const HOPELESS_AFTER: Duration = Duration::from_secs(4);
/// Where it is urgent, what ends by itself has so long.
const URGENT: Duration = Duration::from_secs(2);

/// The bench of a console. Clones are the same; no call but [`Self::end`] and [`Self::lend`]
/// waits for a device. What comes of a command is published as topic `bench`.
#[derive(Clone)]
pub struct HeldDevices {
    shared: Arc<Shared>,
    commands: Arc<Mutex<Sender<Command>>>,
    advisor: Advisor,
    thread: Arc<Mutex<Option<JoinHandle<()>>>>,
    stop_borrower: Arc<OnceLock<StopBorrower>>,
}

/// Ends what the devices are lent to; `false` where nothing is to be ended.
pub type StopBorrower = Box<dyn Fn() -> bool + Send + Sync>;

impl std::fmt::Debug for HeldDevices {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.debug_struct("HeldDevices")
            .field("state", &self.shared.state())
            .finish_non_exhaustive()
    }
}

impl HeldDevices {
    /// A bench that is not connected.
    ///
    /// # Errors
    /// The system has no thread left.
    pub fn new(hub: Hub, ports: BenchPorts) -> std::io::Result<Self> {
        let shared = Arc::new(Shared::new(hub));
        let (sender, receiver) = channel();
        let advisor = ports.advisor.clone();
        let of = Arc::clone(&shared);
        let thread = std::thread::Builder::new()
            .name("bench".to_owned())
            .spawn(move || held::obey(&of, &ports, &receiver))?;
        Ok(Self {
            shared,
            commands: Arc::new(Mutex::new(sender)),
            advisor,
            thread: Arc::new(Mutex::new(Some(thread))),
            stop_borrower: Arc::default(),
        })
    }

    /// As pages see it.
    pub fn state(&self) -> State {
        self.shared.state()
    }

    /// The newest frame.
    pub fn live(&self) -> &LiveFrame {
        &self.shared.live
    }

    /// Opens the devices.
    ///
    /// # Errors
    /// They are open or being opened, or lent.
    pub fn connect(&self) -> Result<(), Fault> {
        self.shared.change(|state| {
            if let Some(to) = state.lent_to {
                return Err(Fault::new(format!("the devices are in use by {to}")));
            }
            if !self.shared.hold() {
                return Err(Fault::new("the bench is connected already"));
            }
            self.shared.stop_when_open.store(false, Ordering::SeqCst);
            state.busy = Some(Busy::Connecting);
            state.error = None;
            Ok(())
        })?;
        self.send(Command::Connect);
        Ok(())
    }

    /// Ends motion, turns the lamp off and closes the devices.
    pub fn disconnect(&self) {
        if !self.shared.is_held() {
            return;
        }
        self.stop_action();
        self.shared.change(|state| {
            if state.connected {
                state.busy = Some(Busy::Disconnecting);
            }
        });
        self.send(Command::Disconnect);
    }

    /// Finds the stage's reference switches.
    ///
    /// # Errors
    /// There is no stage, or it is busy.
    pub fn home(&self) -> Result<(), Fault> {
        self.act(Action::Home, Busy::Homing)
    }

    /// Moves the stage.
    ///
    /// # Errors
    /// As [`Self::home`]; angles that are no numbers.
    pub fn move_to(&self, target: StageAngles) -> Result<(), Fault> {
        if !(target.azimuth_deg.is_finite() && target.elevation_deg.is_finite()) {
            return Err(Fault::new("azimuth and elevation must be numbers"));
        }
        self.act(Action::Move(target), Busy::Moving)
    }

    /// Lights one channel of the lamp, or turns it off. It goes out by itself: see
    /// [`super::lamp_timer`].
    ///
    /// # Errors
    /// As [`Self::home`].
    pub fn set_lamp(&self, channel: Option<LampChannel>) -> Result<(), Fault> {
        let lamp = channel.map_or(LampState::Off, LampState::On);
        self.act(Action::Lamp(lamp), Busy::Switching)
    }

    /// Sets exposure and gain of the frames that follow.
    ///
    /// # Errors
    /// The bench is not connected, or a value is not above 0.
    pub fn set_exposure(&self, settings: CameraSettings) -> Result<(), Fault> {
        let Seconds(exposure_s) = settings.exposure;
        let is_valid = |value: f64| value.is_finite() && value > 0.0;
        if !(is_valid(exposure_s) && is_valid(settings.gain)) {
            return Err(Fault::new("exposure and gain must be numbers above 0"));
        }
        if !self.state().connected {
            return Err(Fault::new("the bench is not connected"));
        }
        *lock(&self.shared.wanted) = Some(settings);
        Ok(())
    }

    /// How a STOP of the bench reaches what its devices are lent to.
    pub fn stop_borrower_by(&self, stop: StopBorrower) {
        let _ = self.stop_borrower.set(stop);
    }

    /// Stops motion and lamp at once, whatever is under way; what is being stopped.
    ///
    /// # Errors
    /// This console holds no stage: nothing was stopped.
    pub fn stop(&self) -> Result<Stopping, NotStopped> {
        let has_stage = self.shared.has_stage.load(Ordering::SeqCst);
        stop::stop(&self.shared, &self.advisor);
        let state = self.state();
        let borrower = state.lent_to.filter(|_| {
            let stop = self.stop_borrower.get();
            stop.is_some_and(|stop| stop())
        });
        match (borrower, state.lent_to) {
            (Some(to), _) => Ok(Stopping(to)),
            _ if has_stage => Ok(Stopping("the stage")),
            (None, Some(to)) => Err(NotStopped::Lent(to)),
            _ if state.connected => Err(NotStopped::NoStage),
            _ if self.shared.is_held() => Ok(Stopping("the bench, as soon as it is connected")),
            _ => Err(NotStopped::NotConnected),
        }
    }

    /// The error with the advice on it.
    pub(super) fn fault(&self, error: NotStopped) -> Fault {
        self.advisor.fault(&error)
    }

    /// Closes the devices for another process, waits until they are closed, and keeps pages
    /// from opening them as long as what is returned exists.
    ///
    /// # Errors
    /// They are lent already, or still open after this time.
    pub fn lend(&self, to: &'static str, longest: Duration) -> Result<Loan, Fault> {
        self.shared
            .change(|state| match state.lent_to.replace(to) {
                Some(other) => {
                    state.lent_to = Some(other);
                    Err(Fault::new(format!("the devices are in use by {other}")))
                }
                None => Ok(()),
            })?;
        let loan = Loan(Arc::clone(&self.shared));
        self.disconnect();
        match self.shared.wait_let_go(longest) {
            true => Ok(loan),
            false => Err(Fault::new(format!(
                "the bench's devices are still open after {} s",
                longest.as_secs()
            ))),
        }
    }

    /// Ends motion, turns the lamp off, closes the devices and ends the thread; for the end of
    /// the process. `false` if that takes longer: the guardian sees to the lamp then. A stage
    /// that hangs is stopped from another thread, and not waited for; neither are devices that
    /// are still being opened, nor anything once `is_urgent`.
    pub fn end(&self, longest: Duration, is_urgent: impl Fn() -> bool) -> bool {
        let began = Instant::now();
        self.disconnect();
        self.send(Command::End);
        let Some(thread) = lock(&self.thread).take() else {
            return true;
        };
        let (mut end, mut is_stopped) = (began + longest, false);
        let (mut last, mut waited) = (began, Duration::ZERO);
        while !thread.is_finished() {
            let state = self.state();
            let is_lit = state
                .stage
                .is_some_and(|stage| stage.lamp != LampState::Off);
            if is_lit && !is_stopped && began.elapsed() >= STOPPED_AFTER {
                is_stopped = true;
                stop::stop(&self.shared, &self.advisor);
            }
            if is_urgent() {
                end = end.min(Instant::now() + URGENT);
            }
            let now = Instant::now();
            // Else the camera's thread is in a frame, and the stage's has ended.
            if state.stage.is_some() || state.camera.is_none() {
                waited += now - last;
            }
            last = now;
            if waited >= HOPELESS_AFTER || now >= end {
                return false;
            }
            std::thread::sleep(LOOK);
        }
        thread.join().is_ok()
    }

    fn send(&self, command: Command) {
        // A thread that has ended holds nothing that could obey.
        let _ = lock(&self.commands).send(command);
    }

    fn act(&self, action: Action, busy: Busy) -> Result<(), Fault> {
        let stops = self.shared.change(|state| {
            if !state.connected {
                return Err(Fault::new("the bench is not connected"));
            }
            if state.stage.is_none() {
                return Err(Fault::new("the bench has no stage"));
            }
            if state.busy.is_some() {
                return Err(Fault::new("the stage is busy"));
            }
            state.busy = Some(busy);
            state.error = None;
            if let (Action::Move(target), Some(stage)) = (action, &mut state.stage) {
                stage.target = Some(target);
            }
            Ok(self.shared.stops())
        })?;
        self.send(Command::Act(action, stops));
        Ok(())
    }

    /// Does nothing where no action is under way: a stop makes a stage forget its position.
    fn stop_action(&self) {
        let busy = self.state().busy;
        if matches!(busy, Some(Busy::Homing | Busy::Moving)) || self.shared.is_acting() {
            stop::stop(&self.shared, &self.advisor);
        } else {
            // What was accepted a moment ago doesn't begin.
            self.shared.stops.fetch_add(1, Ordering::SeqCst);
        }
    }
}

/// The bench's devices are closed and stay so, for another process, until this is dropped.
#[must_use = "pages may open the devices again when this is dropped"]
pub struct Loan(Arc<Shared>);

impl std::fmt::Debug for Loan {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.write_str("Loan")
    }
}

impl Drop for Loan {
    fn drop(&mut self) {
        self.0.change(|state| state.lent_to = None);
    }
}
