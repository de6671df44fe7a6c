//! Frames that have got to the disk, reported by the thread that drives the bench.

use tokio::sync::mpsc::UnboundedReceiver;

use crate::capture::progress::{Observer, Progress};

/// What the disk's thread has journalled and nobody has reported yet; as many frames as are
/// taken between two reports, a few.
pub(super) struct Stored(UnboundedReceiver<Progress>);

impl Stored {
    pub(super) fn new(frames: UnboundedReceiver<Progress>) -> Self {
        Self(frames)
    }

    /// Reports what there is.
    pub(super) fn report(&mut self, observer: &mut dyn Observer) {
        while let Ok(frame) = self.0.try_recv() {
            observer.observe(&frame);
        }
    }

    /// Reports frames as they come until `work` is done.
    pub(super) async fn report_during<T>(
        &mut self,
        observer: &mut dyn Observer,
        work: impl Future<Output = T>,
    ) -> T {
        tokio::pin!(work);
        loop {
            tokio::select! {
                biased;
                result = &mut work => return result,
                Some(frame) = self.0.recv() => observer.observe(&frame),
            }
        }
    }
}
