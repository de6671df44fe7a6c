//! Stopping motion and lamp from any thread, whatever the stage's thread is doing.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use super::shared::{Shared, lock};
use super::state::Busy;
use crate::device::{DeviceError, LampState};
use crate::fault::Advisor;

/// One that is stopping and one that waits for it: more would do nothing.
const MOST_STOPPING: usize = 2;
/// An action that goes on for so long after a stop began after it.
const ENDS_WITHIN: Duration = Duration::from_millis(500);
/// So often such an action is stopped again.
const ATTEMPTS: u32 = 10;
const LOOK: Duration = Duration::from_millis(5);

/// The stage may be moving, or its lamp lit.
#[derive(Debug, thiserror::Error)]
#[error("the stage did not confirm that it stopped: {0}")]
pub struct Unstopped(pub DeviceError);

/// What a STOP has reached; its end is published.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stopping(pub &'static str);

/// Why a STOP has reached nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NotStopped {
    /// The devices are not open here; another program may use them.
    #[error("the bench is not connected to this console, which did not check its stage and lamp")]
    NotConnected,
    /// The devices are open here, and no stage is among them.
    #[error("this console holds no stage: no motion and no lamp was stopped")]
    NoStage,
    /// Something else has the devices that this console does not end.
    #[error("the devices are in use by {0}: the stage was not stopped")]
    Lent(&'static str),
}

/// Stops motion and lamp, in a thread of its own; returns at once.
pub(super) fn stop(shared: &Arc<Shared>, advisor: &Advisor) {
    // Before anything else: what was accepted before doesn't begin any more.
    shared.stops.fetch_add(1, Ordering::SeqCst);
    if shared.stopping.fetch_add(1, Ordering::SeqCst) >= MOST_STOPPING {
        shared.stopping.fetch_sub(1, Ordering::SeqCst);
        return;
    }
    shared.change(|state| {
        if state.connected {
            // What is wrong from now on is of this stop.
            (state.busy, state.error) = (Some(Busy::Stopping), None);
        }
    });
    let (of, advisor) = (Arc::clone(shared), advisor.clone());
    let stopping = std::thread::Builder::new().name("stop".to_owned());
    let begun = stopping.spawn(move || stop_now(&of, &advisor));
    if begun.is_err() {
        // The system has no thread left: then this one waits.
        stop_now(shared, &Advisor::silent());
    }
}

fn stop_now(shared: &Shared, advisor: &Advisor) {
    let outcome = until_stopped(shared);
    shared.stopping.fetch_sub(1, Ordering::SeqCst);
    shared.change(|state| {
        if state.busy == Some(Busy::Stopping) {
            state.busy = None;
        }
        if let Some(stage) = &mut state.stage {
            // Until it is reported anew.
            (stage.position, stage.target) = (None, None);
            if outcome.is_ok() {
                (stage.lamp, state.lamp_off_in_s) = (LampState::Off, None);
            }
        }
        if let Err(error) = outcome {
            state.error = Some(advisor.fault(&Unstopped(error)));
        }
    });
}

fn until_stopped(shared: &Shared) -> Result<(), DeviceError> {
    let mut slot = lock(&shared.stop);
    let Some(handle) = &mut *slot else {
        // Where it is being opened.
        shared.stop_when_open.store(true, Ordering::SeqCst);
        return Ok(());
    };
    let mut outcome = handle.stop();
    for _ in 0..ATTEMPTS {
        let end = Instant::now() + ENDS_WITHIN;
        while shared.is_acting() && Instant::now() < end {
            std::thread::sleep(LOOK);
        }
        if !shared.is_acting() {
            break;
        }
        outcome = handle.stop();
    }
    outcome
}
