//! What the bench's threads and the pages' requests share.

use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::state::State;
use crate::console::hub::Hub;
use crate::console::picture::live::LiveFrame;
use crate::device::{CameraSettings, LampState, StopHandle};
use crate::fault::Fault;
use crate::units::StageAngles;

/// A command for the thread that holds the devices.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Command {
    Connect,
    Disconnect,
    /// A motion or a switching, with the number of stops before it was accepted.
    Act(Action, u64),
    /// The thread ends.
    End,
}

/// What the stage is to do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Action {
    Home,
    Move(StageAngles),
    Lamp(LampState),
}

pub(super) struct Shared {
    pub(super) hub: Hub,
    pub(super) live: LiveFrame,
    state: Mutex<State>,
    /// Requested of the camera and not yet taken up.
    pub(super) wanted: Mutex<Option<CameraSettings>>,
    /// Stops the stage while it is held open.
    pub(super) stop: Mutex<Option<Box<dyn StopHandle>>>,
    /// Whether there is such a handle, for whoever does not wait for the one who stops.
    pub(super) has_stage: AtomicBool,
    /// A stop came before there was one.
    pub(super) stop_when_open: AtomicBool,
    /// How often a stop was requested.
    pub(super) stops: AtomicU64,
    /// Threads that stop the stage, or wait to.
    pub(super) stopping: AtomicUsize,
    /// The stage's thread is in an action.
    pub(super) acting: AtomicBool,
    /// Whether the devices are held, or are about to be.
    held: Mutex<bool>,
    let_go: Condvar,
}

impl Shared {
    pub(super) fn new(hub: Hub) -> Self {
        let shared = Self {
            hub,
            live: LiveFrame::default(),
            state: Mutex::default(),
            wanted: Mutex::default(),
            stop: Mutex::default(),
            has_stage: AtomicBool::new(false),
            stop_when_open: AtomicBool::new(false),
            stops: AtomicU64::new(0),
            stopping: AtomicUsize::new(0),
            acting: AtomicBool::new(false),
            held: Mutex::new(false),
            let_go: Condvar::new(),
        };
        shared.change(|_| ());
        shared
    }

    /// Changes the state and publishes it.
    pub(super) fn change<T>(&self, change: impl FnOnce(&mut State) -> T) -> T {
        let mut state = lock(&self.state);
        let result = change(&mut state);
        // Under the lock, so that the newest state is the one published last. Plain data is
        // always JSON.
        if let Ok(json) = serde_json::to_value(&*state) {
            self.hub.publish("bench", json);
        }
        result
    }

    pub(super) fn state(&self) -> State {
        lock(&self.state).clone()
    }

    pub(super) fn stops(&self) -> u64 {
        self.stops.load(Ordering::SeqCst)
    }

    /// The stage is open, and stopped so; `None`: no more. Whether a stop came before.
    pub(super) fn set_stop(&self, handle: Option<Box<dyn StopHandle>>) -> bool {
        let mut stop = lock(&self.stop);
        self.has_stage.store(handle.is_some(), Ordering::SeqCst);
        *stop = handle;
        self.stop_when_open.swap(false, Ordering::SeqCst)
    }

    pub(super) fn is_acting(&self) -> bool {
        self.acting.load(Ordering::SeqCst)
    }

    /// Takes the devices for a connection; `false` if they are held already.
    pub(super) fn hold(&self) -> bool {
        !std::mem::replace(&mut *lock(&self.held), true)
    }

    pub(super) fn is_held(&self) -> bool {
        *lock(&self.held)
    }

    /// The devices are closed, for this reason if they were not to be.
    pub(super) fn let_go(&self, fault: Option<Fault>) {
        self.live.clear();
        *lock(&self.wanted) = None;
        self.change(|state| {
            let error = fault.or_else(|| state.error.take());
            *state = State {
                error,
                lent_to: state.lent_to,
                ..State::default()
            };
        });
        *lock(&self.held) = false;
        self.let_go.notify_all();
    }

    /// Waits until the devices are closed; `false` if they are not in this time.
    pub(super) fn wait_let_go(&self, longest: Duration) -> bool {
        let end = Instant::now() + longest;
        let mut held = lock(&self.held);
        while *held {
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return false;
            }
            let waited = self.let_go.wait_timeout(held, left);
            held = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
        true
    }
}

pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Also where a panic ends it: the other threads of the scope are waited for.
pub(super) struct SetOnDrop<'a>(pub(super) &'a AtomicBool);

impl Drop for SetOnDrop<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::SeqCst);
    }
}
