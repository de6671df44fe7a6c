//! A stage that a person uses directly: what it does is stopped at the first request.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::{DeviceError, LampState, LightStage};
use crate::interrupt::{Interrupt, LOOK, StopLevel};

/// What came of work that could be stopped.
pub struct Stoppable<T> {
    /// What the work returned.
    pub outcome: T,
    /// Whether the stage was stopped meanwhile, and confirmed it.
    pub stop: Option<Result<(), DeviceError>>,
}

/// Runs `act`, which is told whether the stage was stopped, while another thread waits for a
/// request to stop it.
///
/// # Errors
/// The stage cannot be stopped, or no thread can be had.
pub fn stoppable<T>(
    stage: &mut dyn LightStage,
    interrupt: &Interrupt,
    act: impl FnOnce(&mut dyn LightStage, &AtomicBool) -> T,
) -> Result<Stoppable<T>, DeviceError> {
    let mut handle = Some(stage.stop_handle()?);
    let stopped = Arc::new(AtomicBool::new(false));
    let stop = Arc::new(Mutex::new(None));
    let (is_stopped, told) = (Arc::clone(&stopped), Arc::clone(&stop));
    let watching = interrupt.watch(move |interrupt| {
        if interrupt.level() == StopLevel::Continue {
            return;
        }
        if let Some(mut handle) = handle.take() {
            let confirmed = handle.stop();
            is_stopped.store(true, Ordering::Release);
            *told.lock().unwrap_or_else(PoisonError::into_inner) = Some(confirmed);
        }
    });
    let watching = watching.map_err(|source| DeviceError::Io {
        device: stage.info().port.clone(),
        source,
    })?;
    let outcome = act(stage, &stopped);
    drop(watching);
    let stop = stop.lock().unwrap_or_else(PoisonError::into_inner).take();
    Ok(Stoppable { outcome, stop })
}

/// How often a stage whose lamp is lit is queried.
const ASK: Duration = Duration::from_secs(1);

/// Waits until the time is over, the stage was stopped, or a pause is wanted. Asks the stage
/// meanwhile whether it is there and the lamp lit; returns whether it is.
///
/// # Errors
/// The stage does not answer.
pub fn keep_lit(
    stage: &mut dyn LightStage,
    lamp: LampState,
    seconds: Option<f64>,
    stopped: &AtomicBool,
    interrupt: &Interrupt,
) -> Result<bool, DeviceError> {
    let start = Instant::now();
    let over = || seconds.is_some_and(|seconds| start.elapsed().as_secs_f64() >= seconds);
    let stopped = || stopped.load(Ordering::Acquire);
    let watchdog = stage.watchdog();
    let mut asked = start;
    while !stopped() && !interrupt.wants_pause() && !over() {
        watchdog.wait(LOOK);
        watchdog.check()?;
        if asked.elapsed() >= ASK {
            asked = Instant::now();
            let is_other = stage.status()?.lamp.is_some_and(|is| is != lamp);
            if is_other && !stopped() {
                return Ok(false);
            }
        }
    }
    Ok(true)
}
