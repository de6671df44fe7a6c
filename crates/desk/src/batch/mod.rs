//! Many sessions, fitted and reported, on one machine or many.
//!
//! A batch is a folder:
//!
//! | file | content |
//! |---|---|
//! | `jobs.toml` | the jobs: sessions with the options of their fits; written once |
//! | `records/00001.json` | what became of job 1; appears whole, when the job is done |
//! | `table.csv`, `table.json` | one row per job, without times: the same on any machines |
//! | `times.csv` | how long each job took, and where |
//! | `index.html` | the same for people, with a link to each session's report |
//!
//! A job ([`Job`]) is idempotent: done again it finds its record, or else its fit in the
//! session, by the key that the fit states ([`Job::key`]). It holds a lock of its session, so
//! that of two processes with one session one reports it and nothing is done twice; the
//! system drops the lock of a process that dies. No two processes write one file. So it
//! doesn't matter who does which job: [`Batch::run`] does some or all of them, N at a time,
//! [`Batch::collect`] joins the records of all, and [`Batch::job_array`] has Slurm do them.
//!
//! ```no_run
//! use std::path::{Path, PathBuf};
//! use rig_desk::batch::{Batch, NewBatch, Selection};
//! use rig_bench::workflow::FitRequest;
//!
//! let sessions = [PathBuf::from("sessions/red"), PathBuf::from("sessions/green")];
//! let new = NewBatch { sessions: &sessions, ..NewBatch::default() };
//! let parse = |_: &[String]| Ok(FitRequest::default());
//! let batch = Batch::make(Path::new("batch"), &new, &parse)?;
//! batch.run(Selection::All, 1, &|_, _| {})?;
//! let table = batch.collect()?.table;
//! # Ok::<(), rig_desk::batch::BatchError>(())
//! ```

mod collect;
mod error;
mod job;
mod jobs_file;
mod make;
mod one_job;
mod options;
mod page;
mod record;
mod row;
mod run;
mod tasks;

pub use collect::Collected;
pub use error::{BatchError, JobFailure};
pub use job::Job;
pub use jobs_file::JOBS_FILE;
pub use make::{NewBatch, passed_over};
pub use one_job::JobEnd;
pub use options::ParseOptions;
pub use run::{RunSummary, Selection};
pub use tasks::{ArrayRequest, TaskPlan};

use std::path::{Path, PathBuf};

use self::jobs_file::{JobEntry, JobsFile};
use self::options::OptionsReader;
use crate::transport::Kernel;
use crate::workflow::FitRequest;

/// Records of jobs, one file each.
const RECORDS_FOLDER: &str = "records";

/// The jobs of a folder.
#[derive(Debug)]
pub struct Batch {
    folder: PathBuf,
    /// Of all fits whose options name none.
    kernel: Kernel,
    jobs: Vec<Job>,
}

impl Batch {
    /// Opens a batch by its folder or its file of jobs. `parse` reads the options of fits. A
    /// session that is no more where the file states it is looked for as it lay to the batch.
    ///
    /// # Errors
    /// No batch, one of another version of the program, or a file of jobs that was damaged or
    /// names a session twice.
    pub fn open(place: &Path, parse: &ParseOptions) -> Result<Self, BatchError> {
        let folder = match place.file_name() {
            Some(name) if name == JOBS_FILE => place.parent().unwrap_or(Path::new("")),
            _ => place,
        };
        let path = folder.join(JOBS_FILE);
        if !path.exists() {
            return Err(BatchError::NoBatch {
                path: folder.to_owned(),
            });
        }
        let file = JobsFile::read(&path)?;
        let kernel = Kernel::ALL.iter().find(|k| k.to_string() == file.kernel);
        let Some(&kernel) = kernel else {
            let fact = format!("\"{}\" is no kernel", file.kernel);
            return Err(BatchError::Record { path, fact });
        };
        let mut options = OptionsReader::new(parse);
        let jobs = (1..).zip(file.job).map(|(number, entry)| {
            let request = options.request(number, &entry.fit)?;
            let session = found(entry.session, &entry.session_sha256, folder);
            let entry = JobEntry { session, ..entry };
            Ok(opened(number, entry, request, kernel, &file.folder))
        });
        let jobs = jobs.collect::<Result<Vec<_>, BatchError>>()?;
        if jobs.is_empty() {
            return Err(BatchError::Empty);
        }
        make::refuse_duplicates(&jobs)?;
        Ok(Self {
            folder: folder.to_owned(),
            kernel,
            jobs,
        })
    }

    /// The batch's folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The jobs by number.
    pub fn jobs(&self) -> &[Job] {
        &self.jobs
    }

    /// The job's key.
    fn key(&self, job: &Job) -> Result<String, BatchError> {
        job.key()
            .map_err(|(path, error)| BatchError::io(path)(error))
    }
}

/// Folders above the batch, and names at the end of a session's path, by which it is looked for.
const FOLDERS: usize = 6;

/// Where a session lies: where it was, or as it lay to the batch that was moved with it, or that
/// is mounted elsewhere on this machine. It is known by the checksum of its `session.toml`.
fn found(stated: PathBuf, sha256: &str, batch: &Path) -> PathBuf {
    if stated.symlink_metadata().is_ok() {
        return stated;
    }
    let batch = batch.canonicalize().unwrap_or_default();
    let names: Vec<_> = stated.iter().collect();
    let ends = (1..names.len().min(FOLDERS)).map(|n| names[names.len() - n..].iter().collect());
    let ends: Vec<PathBuf> = ends.collect();
    let mut places = batch
        .ancestors()
        .take(FOLDERS)
        .flat_map(|folder| ends.iter().map(|end| folder.join(end)));
    let is_it = |place: &PathBuf| make::session_sha256(place).is_ok_and(|there| there == sha256);
    places.find(is_it).unwrap_or(stated)
}

/// A job as the file has it.
fn opened(
    number: usize,
    entry: JobEntry,
    request: FitRequest,
    kernel: Kernel,
    folder: &Path,
) -> Job {
    let mut request = job::resolved(request, folder);
    request.kernel = Some(request.kernel.unwrap_or(kernel));
    request.memory_mib = Some(entry.memory_mib);
    Job {
        number,
        session: entry.session,
        session_sha256: entry.session_sha256,
        options: entry.fit,
        request,
        expected_cpu_s: entry.expected_cpu_s,
        expected_mib: entry.expected_mib,
    }
}
