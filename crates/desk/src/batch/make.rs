//! Making a batch: which sessions, with which options; all of it checked before any work.

use std::collections::HashMap;
use std::fs::DirEntry;
use std::path::{Path, PathBuf};

use super::job::resolved;
use super::jobs_file::{FORMAT, JOBS_FILE, JobEntry, JobsFile, List};
use super::options::OptionsReader;
use super::{Batch, BatchError, Job, ParseOptions, RECORDS_FOLDER};
use crate::checksum::sha256_hex;
use crate::outside_file::read_regular;
use crate::queue::JOURNAL_ENDING;
use crate::session::layout::JOURNAL_FILE;
use crate::session::{LARGEST_RECORD_BYTES, Session, SessionState, layout};
use crate::transport::Kernel;
use crate::whole_file;
use crate::workflow::{FitRequest, WorkflowError, expected};

/// The sessions of a new batch and the options of their fits.
#[derive(Clone, Debug, Default)]
pub struct NewBatch<'a> {
    /// Sessions that are fitted with `options`; what is [`passed_over`] among them is not.
    pub sessions: &'a [PathBuf],
    /// Options of their fits, as on the command line of `rig fit`.
    pub options: &'a str,
    /// A list of further sessions with options of their own: TOML with `fit` for all and
    /// `[[job]]` with `session`, relative to the list, and `fit`.
    pub list: Option<&'a Path>,
}

impl Batch {
    /// Checks the sessions and writes `jobs.toml` into `folder`, which is made. Where the folder
    /// has a batch of the same jobs already, that is opened.
    ///
    /// # Errors
    /// A session that is no session, is named twice or not captured completely, options that no
    /// fit has, a folder that holds something else or another batch. Nothing is written then.
    pub fn make(
        folder: &Path,
        new: &NewBatch<'_>,
        parse: &ParseOptions,
    ) -> Result<Self, BatchError> {
        let path = folder.join(JOBS_FILE);
        let former = match path.exists() {
            true => Some(Self::open(folder, parse)?),
            false => None,
        };
        whole_file::clear_once(folder);
        // Where it was killed before, there are no jobs yet.
        let is_own = |entry: std::io::Result<DirEntry>| {
            entry.is_ok_and(|entry| {
                let mut inside = std::fs::read_dir(entry.path()).into_iter().flatten();
                entry.file_name() == RECORDS_FOLDER && inside.next().is_none()
            })
        };
        let mut entries = std::fs::read_dir(folder).into_iter().flatten();
        if former.is_none() && !entries.all(is_own) || folder.is_file() {
            return Err(BatchError::ForeignFolder {
                path: folder.to_owned(),
            });
        }

        // The jobs, on the kernel of the batch that is there.
        let kernel = former
            .as_ref()
            .map_or(Kernel::detect(), |batch| batch.kernel);
        let here = std::env::current_dir().map_err(BatchError::io("."))?;
        let mut jobs = Vec::new();
        let mut reader = OptionsReader::new(parse);
        for (number, (session, options)) in (1..).zip(named(new)?) {
            let mut request = resolved(reader.request(number, &options)?, &here);
            request.kernel = Some(request.kernel.unwrap_or(kernel));
            jobs.push(job(number, &session, options, request)?);
        }
        if jobs.is_empty() {
            return Err(BatchError::Empty);
        }
        refuse_duplicates(&jobs)?;
        let batch = Self {
            folder: folder.to_owned(),
            kernel,
            jobs,
        };
        for job in &batch.jobs {
            batch.key(job)?;
        }
        if let Some(former) = former {
            return match difference(&former.jobs, &batch.jobs) {
                None => Ok(former),
                Some(difference) => Err(BatchError::OtherJobs { path, difference }),
            };
        }

        // The folder, the file last: without it there is no batch.
        let records = folder.join(RECORDS_FOLDER);
        std::fs::create_dir_all(&records).map_err(BatchError::io(&records))?;
        let text = batch.file(here).text();
        whole_file::create(&path, text.as_bytes()).map_err(BatchError::io(&path))?;
        Ok(batch)
    }

    fn file(&self, folder: PathBuf) -> JobsFile {
        let entry = |job: &Job| JobEntry {
            session: job.session.clone(),
            session_sha256: job.session_sha256.clone(),
            fit: job.options.clone(),
            memory_mib: job.request.memory_mib.unwrap_or_default(),
            expected_cpu_s: job.expected_cpu_s,
            expected_mib: job.expected_mib,
        };
        JobsFile {
            format: FORMAT,
            rig: env!("CARGO_PKG_VERSION").to_owned(),
            kernel: self.kernel.to_string(),
            folder,
            job: self.jobs.iter().map(entry).collect(),
        }
    }
}

/// The sessions as named, each with its options.
fn named(new: &NewBatch<'_>) -> Result<Vec<(PathBuf, String)>, BatchError> {
    let mut named: Vec<_> = new
        .sessions
        .iter()
        .filter(|path| passed_over(path).is_none())
        .map(|session| (session.clone(), new.options.to_owned()))
        .collect();
    if let Some(path) = new.list {
        let list = List::read(path)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        named.extend(list.job.into_iter().map(|listed| {
            let options = listed.fit.unwrap_or_else(|| list.fit.clone());
            (folder.join(listed.session), options)
        }));
    }
    Ok(named)
}

/// What the program itself has put among sessions, where a path leads to that: `sessions/*` of a
/// shell names it, too.
pub fn passed_over(path: &Path) -> Option<&'static str> {
    let name = path.file_name()?.as_encoded_bytes();
    if path.join(JOURNAL_FILE).exists() {
        return None;
    }
    if name.ends_with(JOURNAL_ENDING.as_bytes()) && path.is_file() {
        return Some("what was done of a queue");
    }
    if path.join(JOBS_FILE).is_file() {
        return Some("a batch");
    }
    name.starts_with(b".").then_some("hidden")
}

/// A job, once its session is checked.
fn job(
    number: usize,
    named: &Path,
    options: String,
    mut request: FitRequest,
) -> Result<Job, BatchError> {
    let of_session = |source: WorkflowError| BatchError::Session {
        job: number,
        source: Box::new(source),
    };

    // The session.
    let session = Session::open(named).map_err(|error| of_session(error.into()))?;
    if session.state() != SessionState::Complete {
        let summary = session.summary();
        return Err(BatchError::Incomplete {
            job: number,
            session: named.to_owned(),
            finished: summary.lights_finished,
            planned: summary.lights_planned,
        });
    }
    let root = named.canonicalize().map_err(BatchError::io(named))?;

    // What its fit will take, which depends on no machine.
    let config = session.rig().map_err(|error| of_session(error.into()))?;
    let lights = session.stage_positions();
    let lights = lights.map_err(|error| of_session(error.into()))?;
    let expected = expected(&config, &lights, &request).map_err(of_session)?;
    let memory_mib = *request.memory_mib.get_or_insert(expected.memory_mib);
    let expected_mib = (expected.work.expected_bytes() / f64::from(1 << 20)).ceil() as u64;
    Ok(Job {
        number,
        session_sha256: session_sha256(&root)?,
        session: root,
        options,
        request,
        expected_cpu_s: expected.work.expected_cpu_s().round(),
        expected_mib: expected_mib.min(memory_mib),
    })
}

/// SHA-256 of a session's `session.toml`.
pub(super) fn session_sha256(root: &Path) -> Result<String, BatchError> {
    let path = root.join(layout::SESSION_FILE);
    let bytes = read_regular(&path, LARGEST_RECORD_BYTES).map_err(BatchError::io(&path))?;
    Ok(sha256_hex(&bytes))
}

pub(super) fn refuse_duplicates(jobs: &[Job]) -> Result<(), BatchError> {
    let mut known = HashMap::new();
    for job in jobs {
        if let Some(first) = known.insert(&job.session, job.number) {
            return Err(BatchError::Duplicate {
                session: job.session.clone(),
                first,
                second: job.number,
            });
        }
    }
    Ok(())
}

/// The first difference between two lists of jobs, in words.
fn difference(then: &[Job], now: &[Job]) -> Option<String> {
    for (a, b) in then.iter().zip(now) {
        let number = a.number;
        if a.session != b.session || a.session_sha256 != b.session_sha256 {
            let (a, b) = (a.session.display(), b.session.display());
            return Some(format!("job {number} was {a}, is {b}"));
        }
        if a.request != b.request {
            let (a, b) = (&a.options, &b.options);
            return Some(format!(
                "the options of job {number} were \"{a}\", are \"{b}\""
            ));
        }
    }
    let (then, now) = (then.len(), now.len());
    (then != now).then(|| format!("it had {then} sessions, has {now}"))
}
