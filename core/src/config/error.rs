//! What is wrong with a rig or scene file; facts only.

use std::path::PathBuf;

use super::slip::Slip;
use crate::shown::excerpt;

/// A file that cannot be used, and exactly where and why.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("{}: {source}", file.display())]
    Read {
        file: PathBuf,
        source: std::io::Error,
    },
    #[error("{file}:{line}:{column}: not valid TOML: {problem}")]
    Syntax {
        file: String,
        /// Line, from 1.
        line: usize,
        /// Character of the line, from 1.
        column: usize,
        problem: String,
        /// What made it so, where that is known.
        slip: Option<Slip>,
    },
    /// A path with a character that no path has, by an escape sequence that was not meant.
    #[error(
        "{file}:{line}: `{}` is {value}, which holds {character}",
        excerpt(key)
    )]
    ControlCharacter {
        file: String,
        /// Line, from 1.
        line: usize,
        key: String,
        value: String,
        character: &'static str,
    },
    #[error("{file}:{line}: unknown key `{}`; known here: {}", excerpt(key), known.join(", "))]
    UnknownKey {
        file: String,
        /// Line, from 1.
        line: usize,
        key: String,
        known: Vec<String>,
    },
    #[error("{file}:{line}: `{key}` is missing; it must be {allowed}")]
    Missing {
        file: String,
        /// Line of the table it belongs to, from 1.
        line: usize,
        key: String,
        allowed: String,
        /// Keys that are there and that nobody has asked for so far.
        unread: Vec<String>,
    },
    /// A value of the wrong type or outside its range.
    #[error("{file}:{line}: `{}` is {value}, but must be {allowed}", excerpt(key))]
    Invalid {
        file: String,
        /// Line, from 1.
        line: usize,
        key: String,
        value: String,
        allowed: String,
    },
    #[error("there is no rig named {name:?}; known: {}", known.join(", "))]
    UnknownRig { name: String, known: Vec<String> },
    /// No rig was named, and the simulated one would stand in for real hardware.
    #[error("no rig is configured, and real hardware is connected: {}", devices.join(", "))]
    FallbackRefused { devices: Vec<String> },
}
