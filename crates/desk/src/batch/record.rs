//! What became of a job: one file, written whole when it is done.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::{Batch, BatchError, Job, RECORDS_FOLDER};
use crate::outside_file::read_regular;
use crate::result_table::Row;
use crate::whole_file;

/// A record has some kilobytes.
const LARGEST_RECORD_BYTES: u64 = 4 << 20;

/// A job's record.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct JobRecord {
    pub job: usize,
    /// [`Job::key`] when it was done.
    pub key: String,
    /// Why it failed, if it did.
    pub failure: Option<String>,
    /// Its row of the table.
    pub row: Row,
    /// The fit in the session, such as `fits/0`.
    pub fit: Option<String>,
    /// Start, RFC 3339, UTC.
    pub began_utc: String,
    /// Wall time of fit, report and the rest, seconds.
    pub seconds: f64,
    /// The machine.
    pub host: String,
    /// Threads that it could use.
    pub threads: usize,
}

impl Batch {
    fn record_path(&self, job: &Job) -> PathBuf {
        let folder = self.folder.join(RECORDS_FOLDER);
        folder.join(format!("{:05}.json", job.number))
    }

    /// The record of a job, if it has one.
    ///
    /// # Errors
    /// It is damaged, or of another key than this.
    pub(super) fn record(&self, job: &Job, key: &str) -> Result<Option<JobRecord>, BatchError> {
        let path = self.record_path(job);
        let bytes = match read_regular(&path, LARGEST_RECORD_BYTES) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(BatchError::io(path)(error)),
        };
        let record: JobRecord =
            serde_json::from_slice(&bytes).map_err(|error| BatchError::Record {
                path: path.clone(),
                fact: error.to_string(),
            })?;
        if record.key != key || record.job != job.number {
            return Err(BatchError::OtherOptions {
                path,
                job: job.number,
            });
        }
        Ok(Some(record))
    }

    /// Writes the record of a job in place of any former one.
    pub(super) fn keep(&self, job: &Job, record: &JobRecord) -> Result<(), BatchError> {
        let path = self.record_path(job);
        let bytes = serde_json::to_vec_pretty(record).map_err(|error| BatchError::Record {
            path: path.clone(),
            fact: error.to_string(),
        })?;
        replace(&path, &bytes)
    }
}

/// Writes a file of the batch whole.
pub(super) fn replace(path: &Path, bytes: &[u8]) -> Result<(), BatchError> {
    whole_file::replace(path, |out| out.write_all(bytes)).map_err(BatchError::io(path))
}
