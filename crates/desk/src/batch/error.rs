//! Why a batch, or one of its jobs, could not be done; facts only.

use std::path::PathBuf;

use crate::cluster::LineBreak;
use crate::report::ReportError;
use crate::session::SessionError;
use crate::session::fit_record::FitRecordError;
use crate::workflow::WorkflowError;

/// A batch could not be made, run or collected.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum BatchError {
    /// The system refused.
    #[error("{}: {source}", path.display())]
    Io {
        path: PathBuf,
        source: std::io::Error,
    },
    /// A list or a file of jobs that does not parse.
    #[error("{}, line {line}: {fact}", path.display())]
    Syntax {
        path: PathBuf,
        /// From 1.
        line: usize,
        fact: String,
    },
    #[error("no session is named")]
    Empty,
    /// The folder holds something else.
    #[error("{}: not empty, and no batch's folder", path.display())]
    ForeignFolder { path: PathBuf },
    /// The folder holds no batch.
    #[error("{}: there is no batch (no jobs.toml)", path.display())]
    NoBatch { path: PathBuf },
    /// The batch was made by another version of the program.
    #[error("{}: its jobs are of rig {then}, and this is rig {now}", path.display())]
    OtherVersion {
        path: PathBuf,
        then: String,
        now: String,
    },
    #[error("{}: a batch of other jobs: {difference}", path.display())]
    OtherJobs { path: PathBuf, difference: String },
    /// A session is named twice.
    #[error("job {second}: {} is job {first} already", session.display())]
    Duplicate {
        session: PathBuf,
        first: usize,
        second: usize,
    },
    /// The session of a job cannot be fitted.
    #[error("job {job}: {source}")]
    Session {
        job: usize,
        source: Box<WorkflowError>,
    },
    /// A session whose capture did not come to its end.
    #[error("job {job}: {} is not captured completely: {finished} of {planned} lights", session.display())]
    Incomplete {
        job: usize,
        session: PathBuf,
        finished: usize,
        planned: usize,
    },
    #[error("job {job}, fit \"{options}\": {fact}")]
    Options {
        job: usize,
        options: String,
        fact: String,
    },
    /// Another session stands where the job's stood.
    #[error("job {job}: {} is another session than the one that the batch was made with", session.display())]
    OtherSession { job: usize, session: PathBuf },
    #[error("{}: job {job} was done with other options than it has now", path.display())]
    OtherOptions { path: PathBuf, job: usize },
    /// An invalid record.
    #[error("{}: {fact}", path.display())]
    Record { path: PathBuf, fact: String },
    #[error("there is no job {index}: {} has jobs 1 to {jobs}", path.display())]
    NoSuchJob {
        index: usize,
        jobs: usize,
        path: PathBuf,
    },
    #[error(
        "{parallel} fits at a time need about {needed_mib} MiB of memory, and {free_mib} MiB are free"
    )]
    Memory {
        parallel: usize,
        needed_mib: u64,
        free_mib: u64,
        fitting: usize,
    },
    #[error("a job array has 1 to {most} tasks, not {tasks}")]
    Tasks { tasks: usize, most: usize },
    /// A command line that no job script can hold.
    #[error(transparent)]
    Script(#[from] LineBreak),
    /// The page could not be made: a defect of the program.
    #[error("page of the batch: {0}")]
    Page(#[from] minijinja::Error),
}

/// Why one job has no result; its text is what the table states.
#[derive(Debug, thiserror::Error)]
pub enum JobFailure {
    /// Its session is gone.
    #[error("there is no {}, where jobs.toml states the session", path.display())]
    Gone {
        /// As the file of jobs has it.
        path: PathBuf,
    },
    /// The fit.
    #[error("{0}")]
    Fit(#[from] WorkflowError),
    /// The fit that was made cannot be read.
    #[error("{0}")]
    FitRecord(#[from] FitRecordError),
    /// The session.
    #[error("{0}")]
    Session(#[from] SessionError),
    /// The material.
    #[error("{0}")]
    Brdf(#[from] crate::brdf::BrdfError),
    /// The report.
    #[error("report: {0}")]
    Report(#[from] ReportError),
    /// A defect of the program.
    #[error("internal error: {0}")]
    Defect(String),
}

impl BatchError {
    /// For `map_err`, with the path.
    pub(super) fn io(path: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |source| Self::Io { path, source }
    }
}
