//! A device on a thread of its own, so that a call that never returns holds nobody up.

use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::time::Duration;

use super::super::DeviceError;
use crate::units::Seconds;

/// How long a device may take to be closed before its thread is abandoned.
const CLOSING: Duration = Duration::from_secs(1);

type Work<D> = Box<dyn FnOnce(&mut D) + Send>;

/// The thread, by what it is given to do. Work is done one after the other.
pub struct Worker<D> {
    device: String,
    work: Option<mpsc::Sender<Work<D>>>,
    closed: Receiver<()>,
}

impl<D: 'static> Worker<D> {
    /// Opens the device on a new thread.
    ///
    /// # Errors
    /// Those of `open`; [`DeviceError::NoReply`] where it takes longer than `limit`.
    pub fn start(
        device: &str,
        limit: Seconds,
        open: impl FnOnce() -> Result<D, DeviceError> + Send + 'static,
    ) -> Result<Self, DeviceError> {
        let (work, orders) = mpsc::channel::<Work<D>>();
        let (tell_opened, opened) = mpsc::sync_channel(1);
        let (tell_closed, closed) = mpsc::sync_channel::<()>(1);
        let run = move || {
            match open() {
                Err(error) => drop(tell_opened.send(Err(error))),
                Ok(mut device) => {
                    // Nobody waits any longer: the device is closed at once.
                    if tell_opened.send(Ok(())).is_ok() {
                        orders.iter().for_each(|work| work(&mut device));
                    }
                }
            }
            drop(tell_closed);
        };
        std::thread::Builder::new()
            .name("webcam".to_owned())
            .spawn(run)
            .map_err(|source| DeviceError::Io {
                device: device.to_owned(),
                source,
            })?;
        let worker = Self {
            device: device.to_owned(),
            work: Some(work),
            closed,
        };
        worker.answer(&opened, limit, "a request to open it")??;
        Ok(worker)
    }

    /// Gives the thread something to do, and returns where its result will be.
    pub fn begin<T: Send + 'static>(
        &self,
        work: impl FnOnce(&mut D) -> T + Send + 'static,
    ) -> Receiver<T> {
        let (done, result) = mpsc::sync_channel(1);
        if let Some(orders) = &self.work {
            // A thread that has ended drops the work, which shows in the result.
            let _ = orders.send(Box::new(move |device| drop(done.send(work(device)))));
        }
        result
    }

    /// The result of work that was begun.
    ///
    /// # Errors
    /// [`DeviceError::NoReply`] to what was `sent` where it is not there within `limit`, and
    /// [`DeviceError::Io`] where the thread has ended.
    pub fn answer<T>(
        &self,
        result: &Receiver<T>,
        limit: Seconds,
        sent: &str,
    ) -> Result<T, DeviceError> {
        let device = self.device.clone();
        result
            .recv_timeout(limit.to_duration())
            .map_err(|error| match error {
                RecvTimeoutError::Timeout => DeviceError::NoReply {
                    device,
                    timeout: limit,
                    sent: sent.to_owned(),
                },
                RecvTimeoutError::Disconnected => DeviceError::Io {
                    device,
                    source: std::io::Error::other("its driver ended unexpectedly"),
                },
            })
    }

    /// Closes the device. A thread that is held up is abandoned after a second, and closes it
    /// whenever the call returns.
    pub fn close(&mut self) {
        self.work = None;
        // Its end shows as a channel without a sender.
        let _ = self.closed.recv_timeout(CLOSING);
    }
}

impl<D> Drop for Worker<D> {
    fn drop(&mut self) {
        if self.work.take().is_some() {
            let _ = self.closed.recv_timeout(CLOSING);
        }
    }
}
