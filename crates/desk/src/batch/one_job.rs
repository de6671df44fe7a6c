//! One job from its lock to its record.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Instant;

use super::record::JobRecord;
use super::row::{Found, Status, row};
use super::{Batch, BatchError, Job, JobFailure};
use crate::report::load::FitChoice;
use crate::report::{self, ReportRequest};
use crate::result_table::Row;
use crate::session::fit_record::{FitRecord, numbers_in, read_in};
use crate::session::layout::FITS_FOLDER;
use crate::session::{Session, SessionError, lock_for_job};
use crate::workflow::{FitRequest, fit_session};

/// How a job ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum JobEnd {
    /// It had been done before.
    Before,
    /// It is done: a fit and its report are in the session.
    Done,
    /// It failed, for this reason, which the table states.
    Failed(String),
    /// Another process is at work on the session.
    Busy,
}

impl Batch {
    /// Does a job, unless it was done before. One that failed is tried again.
    ///
    /// # Errors
    /// The record was made with other options, or cannot be read or written. What is wrong with the session or its fit is no error, but
    /// a job that failed.
    pub(super) fn do_job(&self, job: &Job) -> Result<JobEnd, BatchError> {
        let key = self.key(job)?;
        let is_done = || {
            let record = self.record(job, &key)?;
            Ok::<_, BatchError>(record.is_some_and(|record| record.failure.is_none()))
        };
        if is_done()? {
            return Ok(JobEnd::Before);
        }
        let _lock = match lock_for_job(&job.session) {
            Ok(lock) => Some(lock),
            Err(SessionError::Locked { .. }) => return Ok(JobEnd::Busy),
            // A session that is gone or cannot be written: the fit says so.
            Err(_) => None,
        };
        // The process that held the lock may have done it.
        if is_done()? {
            return Ok(JobEnd::Before);
        }

        let began_utc = jiff::Timestamp::now().to_string();
        let clock = Instant::now();
        // A defect that one session meets must not cost the others their fits.
        let ended = catch_unwind(AssertUnwindSafe(|| self.fit_and_report(job, &key)));
        let ended = ended.unwrap_or_else(|panic| {
            let message = panic.downcast_ref::<&str>().copied();
            let message = message.or(panic.downcast_ref::<String>().map(String::as_str));
            Err(JobFailure::Defect(message.unwrap_or("no message").into()))
        });
        let (row, fit, failure) = match ended {
            Ok((row, fit)) => (row, Some(fit), None),
            Err(failure) => {
                let reason = reason(job, &failure);
                (failed_row(job, &reason), None, Some(reason))
            }
        };
        let record = JobRecord {
            job: job.number,
            key,
            failure: failure.clone(),
            row,
            fit,
            began_utc,
            seconds: clock.elapsed().as_secs_f64(),
            host: host(),
            threads: rayon::current_num_threads(),
        };
        self.keep(job, &record)?;
        Ok(failure.map_or(JobEnd::Done, JobEnd::Failed))
    }

    /// The fit, found or made, its report, and the row. All that the row says is read from the
    /// disk, so that a fit which is found gives the same row as one which was just made.
    fn fit_and_report(&self, job: &Job, key: &str) -> Result<(Row, String), JobFailure> {
        if job.session.symlink_metadata().is_err() {
            let path = job.session.clone();
            return Err(JobFailure::Gone { path });
        }
        let session = Session::open(&job.session)?;
        let (number, fit) = match fit_of(&session, key) {
            Some(found) => found,
            None => {
                let request = FitRequest {
                    job: Some(key.to_owned()),
                    ..job.request.clone()
                };
                fit_session(&job.session, &request, &())?;
                let session = Session::open(&job.session)?;
                fit_of(&session, key).ok_or_else(|| {
                    JobFailure::Defect("the fit that was made does not state its job".into())
                })?
            }
        };
        report::write(&ReportRequest {
            fit: Some(FitChoice::Number(number)),
            ..ReportRequest::of(&job.session)
        })?;
        let record = session.record();
        let found = Found {
            sample: Some(&record.sample),
            simulated: Some(record.simulated),
            fit: Some(&fit),
            failure: None,
        };
        Ok((
            row(job, Status::Done, &found)?,
            format!("{FITS_FOLDER}/{number}"),
        ))
    }
}

/// The fit of a session that states this job, with its number: the first, should there be more.
fn fit_of(session: &Session, key: &str) -> Option<(u32, FitRecord)> {
    let fits = numbers_in(session).into_iter();
    let mut readable = fits.filter_map(|number| Some((number, read_in(session, number).ok()?)));
    readable.find(|(_, fit)| fit.settings.asked.job.as_deref() == Some(key))
}

/// The reason with the session by its name alone, which is the same wherever it lies; of one that
/// is gone, its path.
fn reason(job: &Job, failure: &JobFailure) -> String {
    let text = crate::shown::line(&crate::shown::with_causes(failure));
    if matches!(failure, JobFailure::Gone { .. }) {
        return text;
    }
    text.replace(&*job.session.to_string_lossy(), &job.session_name())
}

fn failed_row(job: &Job, reason: &str) -> Row {
    let session = Session::open(&job.session).ok();
    let record = session.as_ref().map(Session::record);
    let found = Found {
        sample: record.map(|record| record.sample.as_str()),
        simulated: record.map(|record| record.simulated),
        fit: None,
        failure: Some(reason),
    };
    row(job, Status::Failed, &found).unwrap_or_default()
}

/// The machine's name.
fn host() -> String {
    let name = rustix::system::uname();
    name.nodename().to_string_lossy().into_owned()
}
