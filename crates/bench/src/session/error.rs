//! What can be wrong with a session; facts only.

use std::io;
use std::path::{Path, PathBuf};

use crate::file_system::has_no_more_files;
use crate::shown::nth;

/// A session could not be written, read or trusted.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum SessionError {
    /// The folder or file that was to be made is there already.
    #[error("{} exists already", path.display())]
    Exists { path: PathBuf },
    /// The folder holds no session.
    #[error("{} is not a session: {why}", path.display())]
    NotASession { path: PathBuf, why: String },
    #[error("no space left on the disk of {} ({operation})", path.display())]
    DiskFull {
        path: PathBuf,
        /// Which operation met the end of the disk.
        operation: &'static str,
    },
    #[error("the file system of {} has no more files to give ({operation})", path.display())]
    NoMoreFiles {
        path: PathBuf,
        operation: &'static str,
    },
    /// What the user may write is used up.
    #[error("the disk quota is used up ({operation} {})", path.display())]
    OverQuota {
        path: PathBuf,
        operation: &'static str,
    },
    /// Any other failure of the file system.
    #[error("cannot {operation} {}: {source}", path.display())]
    Io {
        path: PathBuf,
        /// What was tried, e.g. `rename`.
        operation: &'static str,
        source: io::Error,
    },
    /// A file holds other bytes than the journal says.
    #[error("{} has SHA-256 {actual}, the journal records {expected}", path.display())]
    Checksum {
        path: PathBuf,
        /// From the journal, hexadecimal.
        expected: String,
        /// Of the file, hexadecimal.
        actual: String,
    },
    #[error("{} has {actual_bytes} bytes, the journal records {expected_bytes}", path.display())]
    Length {
        path: PathBuf,
        expected_bytes: u64,
        actual_bytes: u64,
    },
    #[error("{} is a link to {}, and a session holds its files itself", path.display(), target.display())]
    Link { path: PathBuf, target: PathBuf },
    /// A value of `session.toml` is outside its range.
    #[error("{}: `{key}` is {value}, but must be {allowed}", path.display())]
    Value {
        path: PathBuf,
        key: String,
        value: String,
        allowed: String,
    },
    #[error(
        "{light} of {} has no merged image, because the capture ended after {finished} of {planned} lights ({reason})",
        path.display(), light = nth("light", *light)
    )]
    NotCaptured {
        path: PathBuf,
        light: u32,
        finished: usize,
        planned: usize,
        /// Why the capture ended, as far as the journal knows.
        reason: String,
    },
    /// A journalled file is gone.
    #[error("{} is in the journal but not on the disk", path.display())]
    Missing { path: PathBuf },
    /// A line of the journal is not what was written.
    #[error("{}, line {line}: {why}", path.display())]
    CorruptJournal {
        path: PathBuf,
        /// Line number, from 1.
        line: usize,
        why: String,
    },
    /// A file of the session is malformed.
    #[error("{}: {why}", path.display())]
    Malformed { path: PathBuf, why: String },
    /// Another process writes this session.
    #[error("{} is being written by another process", path.display())]
    Locked { path: PathBuf },
    /// The sample's name cannot be part of a folder name.
    #[error(
        "sample name {name:?} is not 1 to 64 letters, digits, dots, hyphens or underscores \
         that start with a letter or a digit"
    )]
    SampleName { name: String },
    /// A raw frame is committed a second time.
    #[error("{} is journalled already; raw frames are never replaced", path.display())]
    FrameTaken { path: PathBuf },
}

impl SessionError {
    /// Sorts a system error into what it means.
    pub fn io(operation: &'static str, path: &Path, source: io::Error) -> Self {
        let path = path.to_owned();
        match source.kind() {
            io::ErrorKind::StorageFull if has_no_more_files(&path) => {
                Self::NoMoreFiles { path, operation }
            }
            io::ErrorKind::StorageFull => Self::DiskFull { path, operation },
            io::ErrorKind::QuotaExceeded => Self::OverQuota { path, operation },
            io::ErrorKind::AlreadyExists => Self::Exists { path },
            _ => Self::Io {
                path,
                operation,
                source,
            },
        }
    }

    /// Whether a journalled file is gone or holds something else, and which.
    pub fn damaged_file(&self) -> Option<&Path> {
        match self {
            Self::Missing { path } | Self::Length { path, .. } | Self::Checksum { path, .. } => {
                Some(path)
            }
            _ => None,
        }
    }

    /// What is written there is no such thing, and why.
    pub fn malformed(path: &Path, why: impl ToString) -> Self {
        Self::Malformed {
            path: path.to_owned(),
            why: why.to_string(),
        }
    }
}
