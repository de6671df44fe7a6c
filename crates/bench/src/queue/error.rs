//! What can be wrong with a queue; facts only.

use std::path::PathBuf;

use crate::config::ConfigError;

/// A queue that cannot be used.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum QueueError {
    /// The list of samples.
    #[error(transparent)]
    List(#[from] ConfigError),
    /// A name that a session has which is not of this queue.
    #[error(transparent)]
    Taken(ConfigError),
    /// A line of the journal that is not one of its own.
    #[error("{}, line {line}: {fact}", path.display())]
    Journal {
        path: PathBuf,
        /// From 1.
        line: usize,
        fact: String,
    },
    #[error("{}: another process works on this queue", path.display())]
    Locked { path: PathBuf },
    /// The system refuses.
    #[error("{}: {source}", path.display())]
    Io {
        path: PathBuf,
        source: std::io::Error,
    },
}
