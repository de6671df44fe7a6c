//! Why a batch, or one of its jobs, could not be done; facts only.

use std::path::PathBuf;

use crate::cluster::LineBreak;
use crate::report::ReportError;
use crate::session::SessionError;
use crate::session::fit_record::FitRecordError;
use crate::workflow::WorkflowError;

/// A batch could not be made, run or collected.
#[derive(Debug, thiserror::Error)]
pub enum BatchError {
    /// The system refused.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// Its reason.
        source: std::io::Error,
    },
    /// A list or a file of jobs that does not parse.
    #[error("{}, line {line}: {fact}", path.display())]
    Syntax {
        /// The file.
        path: PathBuf,
        /// From 1.
        line: usize,
        /// What is wrong.
        fact: String,
    },
    /// There is no session to fit.
    #[error("no session is named")]
    Empty,
    /// The folder holds something else.
    #[error("{}: not empty, and no batch's folder", path.display())]
    ForeignFolder {
        /// The folder.
        path: PathBuf,
    },
    /// The folder holds no batch.
    #[error("{}: there is no batch (no jobs.toml)", path.display())]
    NoBatch {
        /// The folder.
        path: PathBuf,
    },
    /// The batch was made by another version of the program.
    #[error("{}: its jobs are of rig {then}, and this is rig {now}", path.display())]
    OtherVersion {
        /// The file of jobs.
        path: PathBuf,
        /// The version that wrote it.
        then: String,
        /// This program's.
        now: String,
    },
    /// The folder holds a batch of other jobs.
    #[error("{}: a batch of other jobs: {difference}", path.display())]
    OtherJobs {
        /// The file of jobs.
        path: PathBuf,
        /// The first difference, then and now.
        difference: String,
    },
    /// A session is named twice.
    #[error("job {second}: {} is job {first} already", session.display())]
    Duplicate {
        /// The session.
        session: PathBuf,
        /// Number of the job that has it.
        first: usize,
        /// Number of the other.
        second: usize,
    },
    /// The session of a job cannot be fitted.
    #[error("job {job}: {source}")]
    Session {
        /// Number of the job.
        job: usize,
        /// What is wrong.
        source: Box<WorkflowError>,
    },
    /// A session whose capture did not come to its end.
    #[error("job {job}: {} is not captured completely: {finished} of {planned} lights", session.display())]
    Incomplete {
        /// Number of the job.
        job: usize,
        /// The session.
        session: PathBuf,
        /// Lights that are finished.
        finished: usize,
        /// Lights that are planned.
        planned: usize,
    },
    /// Options that no fit has.
    #[error("job {job}, fit \"{options}\": {fact}")]
    Options {
        /// Number of the job.
        job: usize,
        /// As they were given.
        options: String,
        /// What is wrong with them.
        fact: String,
    },
    /// Another session stands where the job's stood.
    #[error("job {job}: {} is another session than the one that the batch was made with", session.display())]
    OtherSession {
        /// Number of the job.
        job: usize,
        /// Where it stands.
        session: PathBuf,
    },
    /// The job was done with other options, another version or another mask or dictionary.
    #[error("{}: job {job} was done with other options than it has now", path.display())]
    OtherOptions {
        /// The job's record.
        path: PathBuf,
        /// Number of the job.
        job: usize,
    },
    /// A record that is none.
    #[error("{}: {fact}", path.display())]
    Record {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        fact: String,
    },
    /// There is no job of this number.
    #[error("there is no job {index}: {} has jobs 1 to {jobs}", path.display())]
    NoSuchJob {
        /// As asked for.
        index: usize,
        /// How many there are.
        jobs: usize,
        /// The file of jobs.
        path: PathBuf,
    },
    /// So many fits at a time do not fit into the memory.
    #[error(
        "{parallel} fits at a time need about {needed_mib} MiB of memory, and {free_mib} MiB are free"
    )]
    Memory {
        /// Fits at a time.
        parallel: usize,
        /// What they need, MiB.
        needed_mib: u64,
        /// What is free, MiB.
        free_mib: u64,
        /// So many would fit.
        fitting: usize,
    },
    /// More tasks than an array may have.
    #[error("a job array has 1 to {most} tasks, not {tasks}")]
    Tasks {
        /// As asked for.
        tasks: usize,
        /// How many are possible.
        most: usize,
    },
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
