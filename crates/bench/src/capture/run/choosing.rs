//! Between the lights of a plan that is not fixed: which one follows.

use std::path::Path;
use std::time::Duration;

use tokio::sync::oneshot;

use super::Run;
use crate::capture::progress::Progress;
use crate::capture::{CaptureError, SinkError};
use crate::interrupt::StopLevel;
use crate::session::{Decision, Event};

/// Decides after the lights of a session which one follows.
pub trait Chooser: Send {
    /// From what the session in `root` holds; alike for the same session, whether it was
    /// interrupted before or not.
    ///
    /// # Errors
    /// Lights that tell nothing; they suspend the capture.
    fn choose(&mut self, root: &Path) -> Result<Decision, SinkError>;
}

impl Run<'_> {
    /// Decides after the last light of the plan. Whether one follows; it is then the plan's last.
    pub(super) async fn another_follows(&mut self) -> Result<bool, CaptureError> {
        let was_last = |decision: Decision| decision.stop.is_some();
        if self.plan.until.is_none() || self.session.journal().decisions().any(was_last) {
            return Ok(false);
        }
        let Some(mut chooser) = self.chooser.take() else {
            return Ok(false);
        };
        // Lamp off as in a pause, and every image on the disk.
        self.devices.rest().await?;
        self.position = None;
        self.merger.settle().await?;
        self.disk.settle().await?;
        self.stored.report(self.observer);
        // The choice takes a while, and other threads.
        self.observer.observe(&Progress::Choosing);
        let root = self.session.root().to_owned();
        let (chosen, wait) = oneshot::channel();
        std::thread::Builder::new()
            .name("choice".into())
            .spawn(move || {
                let decision = chooser.choose(&root);
                drop(chosen.send((chooser, decision)));
            })
            .map_err(CaptureError::Thread)?;
        let (chooser, decision) = self.unless_stopped(wait).await?;
        self.chooser = Some(chooser);
        let decision = decision.map_err(|source| CaptureError::Choice { source })?;
        self.disk.record(Event::Decision(decision)).await?;
        self.observer.observe(&Progress::Decided(decision));
        let Some(light) = decision.next() else {
            return Ok(false);
        };
        self.plan.lights.push(light);
        self.lights += 1;
        self.clock.add_light();
        Ok(true)
    }

    /// A request to stop does not wait for the choice: a resume makes it again.
    async fn unless_stopped<T>(&self, mut wait: oneshot::Receiver<T>) -> Result<T, CaptureError> {
        const GONE: CaptureError = CaptureError::WorkerGone { name: "choice" };
        loop {
            if self.interrupt.level() >= StopLevel::AfterThisFrame {
                return Err(CaptureError::Interrupted);
            }
            let waited = tokio::time::timeout(Duration::from_millis(50), &mut wait);
            if let Ok(found) = waited.await {
                return found.map_err(|_| GONE);
            }
        }
    }
}
