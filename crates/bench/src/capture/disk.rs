//! The two threads behind a capture: one brings frames to the disk, one merges
//! finished brackets while the stage already moves on.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::{mpsc, oneshot};

use super::CaptureError;
use super::progress::{FrameEvent, Progress};
use crate::device::RawFrame;
use crate::device::guardian::Watchdog;
use crate::session::{Event, SessionWriter, Sidecar, layout};

/// What a sink meets.
pub type SinkError = Box<dyn std::error::Error + Send + Sync>;

/// Makes one merged image out of a bracket's frames, which come one by one.
///
/// Errors are the merge's own words.
pub trait BracketSink: Send {
    /// The frames of another light direction follow.
    fn begin(&mut self, light: u32) -> Result<(), SinkError>;
    /// A light, ambient or dark frame of the bracket; pilots are left out.
    fn add(&mut self, frame: &RawFrame, sidecar: &Sidecar) -> Result<(), SinkError>;
    /// The bracket is whole; returns the bytes of its `radiance_L….exr`.
    fn finish(&mut self) -> Result<Vec<u8>, SinkError>;
}

/// Frames that wait for the disk at most, the one being taken among them. With
/// the one being written, these are what a crash can cost.
pub const WRITE_QUEUE: usize = 4;
/// Frames that wait for the merge at most.
const MERGE_QUEUE: usize = 8;
/// A capture waits so long at most for a place in either queue, perhaps with the lamp
/// lit: then its guardian takes the stage over.
const LONGEST_WAIT: Duration = Duration::from_secs(120);

enum DiskJob {
    Event(Event),
    Frame(Arc<RawFrame>, Box<Sidecar>),
    Radiance(u32, Vec<u8>),
    /// Everything before this is on the disk when it is answered.
    Settle(oneshot::Sender<()>),
    /// Ends the capture's session.
    Finish,
    /// Ends the thread; the session stays resumable.
    Leave(String),
}

/// The disk's thread.
pub(super) struct Disk {
    jobs: mpsc::Sender<DiskJob>,
    watchdog: Watchdog,
    /// How the thread ended, until somebody has asked.
    end: Option<oneshot::Receiver<Result<(), CaptureError>>>,
}

impl Disk {
    /// Starts the thread; also returns the frames that it has journalled, as they come.
    pub(super) fn spawn(
        mut session: SessionWriter,
        watchdog: Watchdog,
    ) -> Result<(Self, mpsc::UnboundedReceiver<Progress>), CaptureError> {
        let (jobs, mut inbox) = mpsc::channel(WRITE_QUEUE);
        let (journalled, stored) = mpsc::unbounded_channel();
        let end = spawn("disk", move || {
            while let Some(job) = inbox.blocking_recv() {
                match job {
                    DiskJob::Event(event) => session.record(event)?,
                    DiskJob::Frame(frame, sidecar) => {
                        session.commit_frame(&frame, &sidecar)?;
                        // Where nobody reports frames any more, the run has ended.
                        drop(journalled.send(stored_frame(&sidecar)));
                    }
                    DiskJob::Radiance(light, bytes) => {
                        session.commit_file(&layout::radiance_file(light), &bytes)?;
                    }
                    DiskJob::Settle(settled) => drop(settled.send(())),
                    DiskJob::Finish => {
                        session.finish()?;
                        break;
                    }
                    DiskJob::Leave(reason) => {
                        session.record(Event::Interrupted { reason })?;
                        break;
                    }
                }
            }
            Ok(())
        })?;
        let disk = Self {
            jobs,
            watchdog,
            end: Some(end),
        };
        Ok((disk, stored))
    }

    pub(super) async fn record(&mut self, event: Event) -> Result<(), CaptureError> {
        self.send(DiskJob::Event(event)).await
    }

    /// Waits until the queue is empty.
    pub(super) async fn settle(&mut self) -> Result<(), CaptureError> {
        let (settled, wait) = oneshot::channel();
        self.send(DiskJob::Settle(settled)).await?;
        match wait.await {
            Ok(()) => Ok(()),
            Err(_) => Err(self.why_gone().await),
        }
    }

    /// Waits for a place in the queue. It is taken before the frame is, so that
    /// no frame is exposed for a disk that is behind or gone.
    pub(super) async fn place(&mut self) -> Result<Place, CaptureError> {
        let step = self.watchdog.step(LONGEST_WAIT);
        let place = self.jobs.clone().reserve_owned().await;
        drop(step);
        match place {
            Ok(permit) => Ok(Place(permit)),
            Err(_) => Err(self.why_gone().await),
        }
    }

    pub(super) async fn finish(mut self) -> Result<(), CaptureError> {
        self.send(DiskJob::Finish).await?;
        self.ended().await
    }

    /// Writes what waits, then that the work was interrupted.
    pub(super) async fn leave(mut self, reason: String) -> Result<(), CaptureError> {
        self.send(DiskJob::Leave(reason)).await?;
        self.ended().await
    }

    async fn send(&mut self, job: DiskJob) -> Result<(), CaptureError> {
        let _step = self.watchdog.step(LONGEST_WAIT);
        match self.jobs.send(job).await {
            Ok(()) => Ok(()),
            Err(_) => Err(self.why_gone().await),
        }
    }

    /// The thread has ended before its time, and why is the error.
    async fn why_gone(&mut self) -> CaptureError {
        match self.ended().await {
            Ok(()) => CaptureError::WorkerGone { name: "disk" },
            Err(error) => error,
        }
    }

    async fn ended(&mut self) -> Result<(), CaptureError> {
        const GONE: Result<(), CaptureError> = Err(CaptureError::WorkerGone { name: "disk" });
        match self.end.take() {
            Some(end) => end.await.unwrap_or(GONE),
            None => GONE,
        }
    }
}

/// A place in the disk's queue.
pub(super) struct Place(mpsc::OwnedPermit<DiskJob>);

impl Place {
    /// Hands the frame over. Whether it got to the disk, the next call will tell.
    pub(super) fn frame(self, frame: Arc<RawFrame>, sidecar: Sidecar) {
        self.0.send(DiskJob::Frame(frame, Box::new(sidecar)));
    }
}

fn stored_frame(sidecar: &Sidecar) -> Progress {
    let (key, exposure) = (sidecar.key, sidecar.applied.exposure);
    Progress::Stored {
        frame: FrameEvent::new(key, sidecar.pilot, exposure, sidecar.lamp),
        file: layout::image_file(sidecar.key),
        retakes: sidecar.time.retakes.total(),
    }
}

enum MergeJob {
    Begin(u32),
    Add(Arc<RawFrame>, Box<Sidecar>),
    Finish,
    /// Everything before this was handed to the disk when it is answered.
    Settle(oneshot::Sender<()>),
}

/// The merge's thread; its results go to the disk's.
pub(super) struct Merger {
    jobs: mpsc::Sender<MergeJob>,
    watchdog: Watchdog,
    end: oneshot::Receiver<Result<(), CaptureError>>,
}

impl Merger {
    pub(super) fn spawn(mut sink: Box<dyn BracketSink>, disk: &Disk) -> Result<Self, CaptureError> {
        let (jobs, mut inbox) = mpsc::channel(MERGE_QUEUE);
        let results = disk.jobs.clone();
        let end = spawn("merge", move || {
            let mut current = 0;
            while let Some(job) = inbox.blocking_recv() {
                if let MergeJob::Begin(light) = job {
                    current = light;
                }
                let fail = |source| CaptureError::Merge {
                    light: current,
                    source,
                };
                match job {
                    MergeJob::Begin(light) => {
                        sink.begin(light).map_err(fail)?;
                    }
                    MergeJob::Add(frame, sidecar) => sink.add(&frame, &sidecar).map_err(fail)?,
                    MergeJob::Settle(settled) => drop(settled.send(())),
                    MergeJob::Finish => {
                        let bytes = sink.finish().map_err(fail)?;
                        if results
                            .blocking_send(DiskJob::Radiance(current, bytes))
                            .is_err()
                        {
                            // The disk's thread has ended and says why itself.
                            return Ok(());
                        }
                    }
                }
            }
            Ok(())
        })?;
        Ok(Self {
            jobs,
            watchdog: disk.watchdog.clone(),
            end,
        })
    }

    pub(super) async fn begin(&mut self, light: u32) -> Result<(), CaptureError> {
        self.send(MergeJob::Begin(light)).await
    }

    pub(super) async fn add(
        &mut self,
        frame: Arc<RawFrame>,
        sidecar: Sidecar,
    ) -> Result<(), CaptureError> {
        self.send(MergeJob::Add(frame, Box::new(sidecar))).await
    }

    pub(super) async fn finish_bracket(&mut self) -> Result<(), CaptureError> {
        self.send(MergeJob::Finish).await
    }

    /// Waits until what was finished is merged and handed to the disk.
    pub(super) async fn settle(&mut self) -> Result<(), CaptureError> {
        let (settled, wait) = oneshot::channel();
        self.send(MergeJob::Settle(settled)).await?;
        match wait.await {
            Ok(()) => Ok(()),
            Err(_) => Err(self.why_gone().await),
        }
    }

    /// Waits until every bracket was merged and handed to the disk.
    pub(super) async fn finish(self) -> Result<(), CaptureError> {
        drop(self.jobs);
        self.end
            .await
            .unwrap_or(Err(CaptureError::WorkerGone { name: "merge" }))
    }

    /// The thread has ended before its time, and why is the error.
    async fn why_gone(&mut self) -> CaptureError {
        match (&mut self.end).await {
            Ok(Err(error)) => error,
            _ => CaptureError::WorkerGone { name: "merge" },
        }
    }

    async fn send(&mut self, job: MergeJob) -> Result<(), CaptureError> {
        let _step = self.watchdog.step(LONGEST_WAIT);
        match self.jobs.send(job).await {
            Ok(()) => Ok(()),
            Err(_) => Err(self.why_gone().await),
        }
    }
}

/// A thread whose result can be awaited; a panic closes the channel.
fn spawn(
    name: &str,
    work: impl FnOnce() -> Result<(), CaptureError> + Send + 'static,
) -> Result<oneshot::Receiver<Result<(), CaptureError>>, CaptureError> {
    let (result, end) = oneshot::channel();
    std::thread::Builder::new()
        .name(name.into())
        .spawn(move || drop(result.send(work())))
        .map_err(CaptureError::Thread)?;
    Ok(end)
}
