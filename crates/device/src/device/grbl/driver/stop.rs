//! Stopping a controller without its driver: from another thread, or on a port that no
//! driver holds.

use std::sync::Weak;
use std::time::{Duration, Instant};

use super::{REPORTS_WITH_OUTPUTS, activity};
use crate::device::grbl::link::{Link, STATUS};
use crate::device::grbl::protocol::Accessories;
use crate::device::{DeviceError, StageActivity, StopHandle};

/// How long a report may take while a stop is confirmed.
const STOP_PATIENCE: Duration = Duration::from_millis(500);
/// How long a firmware may take to say that it restarted: that is no start of the board.
pub(super) const RESTARTED: Duration = Duration::from_secs(2);
/// How long the reports that confirm a stop may take together.
const CONFIRMED: Duration = Duration::from_secs(1);

/// Stops a [`GrblStage`] without its driver.
pub(super) struct GrblStop {
    pub(super) link: Weak<Link>,
    pub(super) timeout: Duration,
}

impl StopHandle for GrblStop {
    fn stop(&mut self) -> Result<(), DeviceError> {
        // A driver that is gone has turned the lamp off and ended its motion.
        let Some(link) = self.link.upgrade() else {
            return Ok(());
        };
        link.restart(true, "it was stopped", self.timeout)?;
        confirm_stopped(&link)
    }
}

/// Queries after a restart what the machine does and which outputs are on. It may
/// be the driver that reads the answers. A build that never reports its outputs
/// has reported with its banner that it began anew.
pub(super) fn confirm_stopped(link: &Link) -> Result<(), DeviceError> {
    let end = Instant::now() + CONFIRMED;
    for _ in 0..REPORTS_WITH_OUTPUTS {
        link.send(&[STATUS])?;
        let deadline = end.min(Instant::now() + STOP_PATIENCE);
        let before = link.known().reports;
        while link.known().reports == before && Instant::now() < deadline {
            link.try_receive(deadline.min(Instant::now() + Duration::from_millis(20)))?;
        }
        if link.known().accessories.is_some() || Instant::now() >= end {
            break;
        }
    }
    let known = link.known().clone();
    // After a restart nothing moves, whatever waits.
    let stands = matches!(
        known.state.map(activity),
        Some(StageActivity::Idle | StageActivity::Alarm | StageActivity::Held)
    );
    let outputs = known.accessories.unwrap_or_default();
    if stands && outputs == Accessories::default() {
        return Ok(());
    }
    Err(DeviceError::NotApplied {
        device: link.line().device().to_owned(),
        what: "its state".to_owned(),
        is: match known.state {
            Some(state) => format!("{state}, {outputs}"),
            None => "not reported".to_owned(),
        },
        wanted: "a stop".to_owned(),
    })
}

/// Stops whatever GRBL controller is on a port that no driver holds: brakes,
/// resets it, which turns its outputs off, and waits for its banner.
pub fn stop_port(path: &str, baud: u32, timeout: Duration) -> Result<(), DeviceError> {
    let link = Link::open(path, baud)?;
    link.restart(true, "it was stopped", timeout)?;
    confirm_stopped(&link)
}
