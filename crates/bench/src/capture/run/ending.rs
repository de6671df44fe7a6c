//! How a run ends: lamp off first, then the disk.

use super::Run;
use crate::capture::disk::Merger;
use crate::capture::progress::{Outcome, Progress};
use crate::capture::{CaptureError, Spent};
use crate::interrupt::{Interrupt, StopLevel};

impl Run<'_> {
    /// Lamp off first, then the disk; the first error is the one that counts.
    pub(super) async fn leave(
        self,
        result: Result<(), CaptureError>,
        spent: &mut Option<Spent>,
    ) -> Result<Outcome, CaptureError> {
        let Self {
            mut devices,
            disk,
            mut stored,
            merger,
            observer,
            interrupt,
            clock,
            ..
        } = self;
        // Lamp and devices.
        let mut of_devices = devices.spent();
        let result = match result {
            // The devices have not failed: they end in good order.
            Ok(())
            | Err(
                CaptureError::Interrupted
                | CaptureError::LowDisk { .. }
                | CaptureError::LampDrift { .. }
                | CaptureError::LightMoved { .. }
                | CaptureError::TooHot { .. },
            ) => match devices.shut_down().await {
                Ok(()) => result,
                Err(error) => Err(devices.stop_after(error)),
            },
            Err(error) => Err(devices.stop_after(error)),
        };
        // Waits for the drivers, which close their ports.
        drop(devices);
        let result = match result {
            Ok(()) => {
                observer.observe(&Progress::Merging);
                let merged = wait_for_merges(merger, &interrupt);
                stored.report_during(observer, merged).await
            }
            stopped => stopped,
        };
        of_devices.wall_s = clock.now_s();
        *spent = Some(of_devices);
        // The disk.
        let result = match result {
            Ok(()) => disk.finish().await.map(|()| Outcome::Complete),
            Err(stop @ (CaptureError::Interrupted | CaptureError::StoppedNow)) => disk
                .leave(stop.to_string())
                .await
                .map(|()| Outcome::Interrupted),
            Err(error) => {
                // Where the disk is what failed, it cannot note it.
                drop(disk.leave(error.to_string()).await);
                Err(error)
            }
        };
        stored.report(observer);
        result
    }
}

/// The lamp is off by now; a request to stop leaves the rest to a resume.
async fn wait_for_merges(merger: Merger, interrupt: &Interrupt) -> Result<(), CaptureError> {
    let merged = merger.finish();
    tokio::pin!(merged);
    loop {
        tokio::select! {
            biased;
            result = &mut merged => return result,
            () = tokio::time::sleep(std::time::Duration::from_millis(50)) => {}
        }
        if interrupt.level() >= StopLevel::AfterThisFrame {
            return Err(CaptureError::Interrupted);
        }
    }
}
