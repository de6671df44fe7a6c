//! A device on a thread of its own, called from asynchronous code.

use std::sync::mpsc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tokio::sync::oneshot;

use super::CaptureError;

type Job<D> = Box<dyn FnOnce(&mut D) + Send>;

/// Owns the thread that owns the device. Dropping it waits for the job in
/// progress and closes the device, unless it was [abandoned](Self::abandon).
pub(super) struct Worker<D> {
    name: &'static str,
    jobs: Option<mpsc::Sender<Job<D>>>,
    thread: Option<JoinHandle<()>>,
}

impl<D: Send + 'static> Worker<D> {
    pub(super) fn spawn(name: &'static str, mut device: D) -> Result<Self, CaptureError> {
        let (jobs, inbox) = mpsc::channel::<Job<D>>();
        let thread = std::thread::Builder::new()
            .name(name.into())
            .spawn(move || {
                while let Ok(job) = inbox.recv() {
                    job(&mut device);
                }
            })
            .map_err(CaptureError::Thread)?;
        Ok(Self {
            name,
            jobs: Some(jobs),
            thread: Some(thread),
        })
    }

    /// Runs `job` on the device's thread. The job begins even if nobody waits.
    pub(super) fn call<T, J>(
        &self,
        job: J,
    ) -> impl Future<Output = Result<T, CaptureError>> + use<T, J, D>
    where
        T: Send + 'static,
        J: FnOnce(&mut D) -> T + Send + 'static,
    {
        let (answer, result) = oneshot::channel();
        let boxed: Job<D> = Box::new(move |device| drop(answer.send(job(device))));
        // A closed inbox drops the job and with it `answer`: the wait below fails.
        let _ = self.jobs.as_ref().map(|jobs| jobs.send(boxed));
        let name = self.name;
        async move { result.await.map_err(|_| CaptureError::WorkerGone { name }) }
    }

    /// Drops the device whenever its job ends, and waits for that this long at most.
    pub(super) fn abandon(&mut self, patience: Duration) {
        self.jobs = None;
        if let Some(thread) = self.thread.take() {
            let end = Instant::now() + patience;
            while !thread.is_finished() && Instant::now() < end {
                std::thread::sleep(Duration::from_millis(1));
            }
        }
    }
}

impl<D> Drop for Worker<D> {
    fn drop(&mut self) {
        self.jobs = None;
        if let Some(thread) = self.thread.take() {
            // A panic of a driver was reported by the panic hook already.
            drop(thread.join());
        }
    }
}
