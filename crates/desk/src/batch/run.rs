//! Doing some or all jobs of a batch, N at a time.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use super::make::session_sha256;
use super::{Batch, BatchError, JOBS_FILE, Job, JobEnd};
use crate::cluster::Shard;
use crate::inverse::memory::free_bytes;

/// Which jobs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Selection {
    /// All of them.
    All,
    /// The one of this number, from 1.
    One(usize),
    /// Every n-th.
    Shard(Shard),
}

/// What a run did.
#[derive(Clone, Debug, Default)]
pub struct RunSummary {
    /// Jobs that were wanted.
    pub wanted: usize,
    /// Those that had been done before.
    pub before: usize,
    /// Numbers of those that failed with their reasons, in order.
    pub failed: Vec<(usize, String)>,
    /// Numbers of those on whose sessions another process is at work, in order.
    pub busy: Vec<usize>,
}

impl Batch {
    /// Does the jobs of a selection that are open, `parallel` at a time; all of them share the
    /// threads of the common pool. `ended` is called after each job. However the process ends, a
    /// further run completes the batch.
    ///
    /// # Errors
    /// Before any work: a number without a job, a record of other options, another session in the
    /// place of a job's, too little memory for so many fits at a time. Then: a record that cannot be written.
    pub fn run(
        &self,
        selection: Selection,
        parallel: usize,
        ended: &(dyn Fn(&Job, &JobEnd) + Sync),
    ) -> Result<RunSummary, BatchError> {
        // What there is to do.
        let mut open = Vec::new();
        let mut summary = RunSummary::default();
        for job in self.selected(selection)? {
            summary.wanted += 1;
            match self.record(job, &self.key(job)?)? {
                Some(record) if record.failure.is_none() => {
                    summary.before += 1;
                    ended(job, &JobEnd::Before);
                }
                _ => {
                    check_session(job)?;
                    open.push(job);
                }
            }
        }
        let parallel = parallel.clamp(1, open.len().max(1));
        check_memory(&open, parallel)?;

        // Doing it.
        let next = AtomicUsize::new(0);
        let stopped = AtomicBool::new(false);
        let ends = Mutex::new(Vec::new());
        let worker = || {
            while !stopped.load(Ordering::Relaxed) {
                let Some(&job) = open.get(next.fetch_add(1, Ordering::Relaxed)) else {
                    break;
                };
                let end = self.do_job(job);
                match &end {
                    Ok(end) => ended(job, end),
                    Err(_) => stopped.store(true, Ordering::Relaxed),
                }
                let mut ends = ends.lock().unwrap_or_else(|e| e.into_inner());
                ends.push((job.number, end));
            }
        };
        std::thread::scope(|scope| {
            for _ in 0..parallel {
                scope.spawn(worker);
            }
        });

        // What came of it.
        let mut ends = ends.into_inner().unwrap_or_else(|e| e.into_inner());
        ends.sort_by_key(|(number, _)| *number);
        for (number, end) in ends {
            match end? {
                JobEnd::Before => summary.before += 1,
                JobEnd::Done => {}
                JobEnd::Failed(reason) => summary.failed.push((number, reason)),
                JobEnd::Busy => summary.busy.push(number),
            }
        }
        Ok(summary)
    }

    fn selected(&self, selection: Selection) -> Result<Vec<&Job>, BatchError> {
        let jobs = self.jobs.iter();
        Ok(match selection {
            Selection::All => jobs.collect(),
            Selection::Shard(shard) => jobs.filter(|job| shard.has(job.number)).collect(),
            Selection::One(index) => {
                let job = index.checked_sub(1).and_then(|at| self.jobs.get(at));
                vec![job.ok_or_else(|| BatchError::NoSuchJob {
                    index,
                    jobs: self.jobs.len(),
                    path: self.folder.join(JOBS_FILE),
                })?]
            }
        })
    }
}

/// Refuses another session in the place of a job's; one that is gone makes the job fail.
fn check_session(job: &Job) -> Result<(), BatchError> {
    if session_sha256(&job.session).is_ok_and(|now| now != job.session_sha256) {
        return Err(BatchError::OtherSession {
            job: job.number,
            session: job.session.clone(),
        });
    }
    Ok(())
}

/// Refuses more fits at a time than the memory holds; one alone says itself what it lacks.
fn check_memory(jobs: &[&Job], parallel: usize) -> Result<(), BatchError> {
    let mut expected: Vec<u64> = jobs.iter().map(|job| job.expected_mib).collect();
    expected.sort_unstable_by(|a, b| b.cmp(a));
    let needed = |parallel: usize| expected.iter().take(parallel).sum::<u64>();
    let Some(free_mib) = free_bytes().map(|bytes| bytes >> 20) else {
        return Ok(());
    };
    if parallel == 1 || needed(parallel) <= free_mib {
        return Ok(());
    }
    let fitting = (1..parallel).rev().find(|&n| needed(n) <= free_mib);
    Err(BatchError::Memory {
        parallel,
        needed_mib: needed(parallel),
        free_mib,
        fitting: fitting.unwrap_or(1),
    })
}
