//! The file of a batch's jobs, `jobs.toml`, and the lists that people write.

use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::BatchError;
use crate::outside_file::read_regular;
use crate::shown::{self, MESSAGE, shortened};

/// Its name in the batch's folder.
pub const JOBS_FILE: &str = "jobs.toml";

/// Version of the file's layout.
pub(super) const FORMAT: u32 = 1;

/// A job takes about 400 bytes.
const LARGEST_BYTES: u64 = 64 << 20;

/// `jobs.toml` as it stands on the disk.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct JobsFile {
    pub format: u32,
    /// Version of the program.
    pub rig: String,
    /// Kernel of all fits whose options name none.
    pub kernel: String,
    /// Where relative paths in options start.
    pub folder: PathBuf,
    #[serde(default)]
    pub job: Vec<JobEntry>,
}

/// One job of it.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct JobEntry {
    pub session: PathBuf,
    pub session_sha256: String,
    pub fit: String,
    /// Memory that the whole fit may take, MiB.
    pub memory_mib: u64,
    /// Processor time that it is expected to take, seconds.
    pub expected_cpu_s: f64,
    /// Memory that it is expected to take, MiB.
    pub expected_mib: u64,
}

/// What decides whether the rest can be read.
#[derive(Deserialize)]
struct Version {
    format: u32,
    rig: String,
}

impl JobsFile {
    /// Reads the file.
    pub fn read(path: &Path) -> Result<Self, BatchError> {
        let text = read_text(path)?;
        let Version { format, rig } = parse(path, &text)?;
        let now = env!("CARGO_PKG_VERSION");
        if rig != now || format != FORMAT {
            return Err(BatchError::OtherVersion {
                path: path.to_owned(),
                then: rig,
                now: now.to_owned(),
            });
        }
        parse(path, &text)
    }

    /// The text of the file.
    pub fn text(&self) -> String {
        let body = toml::to_string(self).expect("plain data with string keys is always TOML");
        format!("# Written by `rig batch`; its results are of these jobs and no others.\n{body}")
    }
}

/// A list of sessions as a person writes it: options for all, and for each session that differs
/// its own in their place.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct List {
    #[serde(default)]
    pub fit: String,
    #[serde(default)]
    pub job: Vec<Listed>,
}

/// One session of it.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Listed {
    pub session: PathBuf,
    pub fit: Option<String>,
}

impl List {
    /// Reads a list.
    pub fn read(path: &Path) -> Result<Self, BatchError> {
        parse(path, &read_text(path)?)
    }
}

fn read_text(path: &Path) -> Result<String, BatchError> {
    let bytes = read_regular(path, LARGEST_BYTES).map_err(BatchError::io(path))?;
    let no_text = |_| std::io::Error::new(std::io::ErrorKind::InvalidData, "it is no UTF-8 text");
    String::from_utf8(bytes).map_err(|error| BatchError::io(path)(no_text(error)))
}

fn parse<T: DeserializeOwned>(path: &Path, text: &str) -> Result<T, BatchError> {
    toml::from_str(text).map_err(|error| {
        let at = error.span().map_or(0, |span| span.start.min(text.len()));
        let before = text.get(..at).unwrap_or_default();
        BatchError::Syntax {
            path: path.to_owned(),
            line: before.matches('\n').count() + 1,
            fact: shortened(&shown::line(error.message()), MESSAGE).into_owned(),
        }
    })
}
