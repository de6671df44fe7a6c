//! Checks every byte of a session against its journal, and finds what the
//! journal does not know.

use std::collections::HashSet;
use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use serde::Serialize;
use sha2::{Digest, Sha256};

use super::SessionError;
use super::journal::{FileDigest, Journal, hex};
use super::layout::{JOURNAL_FILE, QUARANTINE_FOLDER};

/// What a check of a session found.
#[derive(Debug)]
pub struct Verification {
    /// Whether the capture ran to its end.
    pub complete: bool,
    /// Journalled files that hold what they should.
    pub good_files: usize,
    /// Their bytes.
    pub good_bytes: u64,
    /// Journalled files that are gone or hold something else.
    pub problems: Vec<SessionError>,
    /// Files that no record names, relative to the session.
    pub strays: Vec<PathBuf>,
    /// Bytes after the journal's last whole line.
    pub torn_bytes: u64,
    /// Why the frames may not be what they claim to be although every byte is
    /// the one that was written.
    pub suspicion: Option<String>,
}

impl Verification {
    /// Nothing is wrong: every journalled file holds what it should, there is
    /// no stray and no torn line. An interrupted session can be intact.
    pub fn is_intact(&self) -> bool {
        self.problems.is_empty() && self.strays.is_empty() && self.torn_bytes == 0
    }
}

/// Checks the session in `root`.
///
/// # Errors
/// Only where the journal itself cannot be trusted; everything else is in the
/// [`Verification`].
pub fn verify(root: &Path) -> Result<Verification, SessionError> {
    let journal = Journal::read(root)?;
    let mut found = Verification {
        complete: journal.is_complete(),
        good_files: 0,
        good_bytes: 0,
        problems: Vec::new(),
        strays: strays(root, &journal)?,
        torn_bytes: journal.torn_bytes,
        suspicion: journal.suspicion(),
    };
    for file in journal.files() {
        match check(root, file) {
            Ok(()) => {
                found.good_files += 1;
                found.good_bytes += file.bytes;
            }
            Err(problem) => found.problems.push(problem),
        }
    }
    Ok(found)
}

/// Whether a file holds what the journal says.
pub fn check(root: &Path, file: &FileDigest) -> Result<(), SessionError> {
    let path = root.join(&file.path);
    let actual = match sha256_of(&path) {
        Ok(actual) => actual,
        Err(e) if e.kind() == io::ErrorKind::NotFound => {
            return Err(SessionError::Missing { path });
        }
        Err(e) => return Err(SessionError::io("read", &path, e)),
    };
    if actual == file.sha256 {
        Ok(())
    } else {
        Err(SessionError::Checksum {
            path,
            expected: file.sha256.clone(),
            actual,
        })
    }
}

fn sha256_of(path: &Path) -> io::Result<String> {
    let mut file = File::open(path)?;
    let mut hash = Sha256::new();
    let mut piece = vec![0; 1 << 16];
    loop {
        match file.read(&mut piece)? {
            0 => return Ok(hex(&hash.finalize())),
            bytes => hash.update(&piece[..bytes]),
        }
    }
}

/// Files below `root` that no record names, relative to it, sorted. Folders
/// don't count, nor what is in quarantine already.
pub fn strays(root: &Path, journal: &Journal) -> Result<Vec<PathBuf>, SessionError> {
    let known: HashSet<PathBuf> = journal
        .files()
        .iter()
        .map(|file| PathBuf::from(&file.path))
        .chain([PathBuf::from(JOURNAL_FILE)])
        .collect();
    let mut strays = Vec::new();
    let mut folders = vec![PathBuf::new()];
    while let Some(folder) = folders.pop() {
        let path = root.join(&folder);
        let read = |e| SessionError::io("list", &path, e);
        for entry in fs::read_dir(&path).map_err(read)? {
            let entry = entry.map_err(read)?;
            let relative = folder.join(entry.file_name());
            if entry.file_type().map_err(read)?.is_dir() {
                if relative != Path::new(QUARANTINE_FOLDER) {
                    folders.push(relative);
                }
            } else if !known.contains(&relative) {
                strays.push(relative);
            }
        }
    }
    strays.sort();
    Ok(strays)
}

/// One session in a list.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// Its folder.
    pub session: PathBuf,
    /// The sample's name.
    pub sample: String,
    /// Start, RFC 3339, UTC.
    pub created_utc: String,
    /// Whether any device was a simulated one.
    pub simulated: bool,
    /// Whether the capture ran to its end.
    pub complete: bool,
    /// Light directions planned.
    pub lights_planned: usize,
    /// Light directions whose frames are all journalled.
    pub lights_finished: usize,
    /// Frames journalled.
    pub frames: usize,
    /// Whether the stage was found to have lost steps.
    pub suspect: bool,
}
