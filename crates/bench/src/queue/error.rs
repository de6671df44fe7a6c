//! What can be wrong with a queue; facts only.

use std::path::PathBuf;

use crate::config::ConfigError;

/// A queue that cannot be used.
#[derive(Debug, thiserror::Error)]
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
        /// The journal.
        path: PathBuf,
        /// From 1.
        line: usize,
        /// What is wrong.
        fact: String,
    },
    /// Another process works on the queue.
    #[error("{}: another process works on this queue", path.display())]
    Locked {
        /// The journal.
        path: PathBuf,
    },
    /// The system refuses.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
}
