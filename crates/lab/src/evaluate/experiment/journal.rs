//! The journals of a run: its settings, then one line per finished case.
//!
//! A run of all cases keeps them in `journal.jsonl`, the run of a shard in a journal of its
//! own, such as `journal-3-of-8.jsonl`, so that no two processes append to one file. Whoever
//! runs reads all journals of the folder and does what none of them has. A run of all cases
//! has the folder for itself, shards share it: a lock of `journal.jsonl`, exclusive or shared.
//!
//! Lines of JSON are appended whole; a process that dies leaves at most its last line
//! torn, and that line is dropped when its journal is opened again.

use std::collections::HashMap;
use std::fs::{File, TryLockError};
use std::io::{Seek, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::{EvaluateError, Row, Settings};
use crate::cluster::Shard;
use crate::file_system;
use crate::outside_file::{append_regular, read_opened, read_regular};

/// Far more than the longest experiment writes.
const LARGEST_BYTES: u64 = 256 << 20;

/// Name of the journal of a run of all cases, in the output folder.
pub const FILE: &str = "journal.jsonl";

#[derive(Serialize, Deserialize)]
struct Finished {
    case: String,
    rows: Vec<Row>,
}

/// An open journal; as long as it is open, nobody else appends to it.
pub struct Journal {
    path: PathBuf,
    file: File,
    finished: HashMap<String, Vec<Row>>,
    /// The journal of a run of all cases, which a shard keeps from being opened.
    _shared: Option<File>,
}

/// Of which shard a file is a journal; `None` of none.
fn shard_of(name: &str) -> Option<Shard> {
    let inside = name.strip_prefix("journal-")?.strip_suffix(".jsonl")?;
    inside.replacen("-of-", "/", 1).parse().ok()
}

/// Name of a shard's journal.
fn file_of(shard: Shard) -> String {
    format!("journal-{}-of-{}.jsonl", shard.number(), shard.of())
}

impl Journal {
    /// Opens the journal in `folder`, or begins one there. `restart`: forget what the folder
    /// holds of other runs, which is for a run of all cases alone.
    pub fn open(
        folder: &Path,
        settings: &Settings,
        restart: bool,
        shard: Option<Shard>,
    ) -> Result<Self, EvaluateError> {
        std::fs::create_dir_all(folder).map_err(EvaluateError::io(folder))?;
        let of_all = folder.join(FILE);
        refuse_foreign(folder, &of_all)?;

        // The locks, before anything is read.
        let all = open_file(&of_all)?;
        let (path, file, shared) = match shard {
            None => {
                locked(file_system::lock(&all, &of_all), folder)?;
                (of_all, all, None)
            }
            Some(shard) => {
                locked(file_system::lock_shared(&all, &of_all), folder)?;
                let path = folder.join(file_of(shard));
                let file = open_file(&path)?;
                locked(file_system::lock(&file, &path), folder)?;
                refuse_other_division(folder, shard)?;
                (path, file, Some(all))
            }
        };
        if restart {
            for other in journals(folder)?.into_iter().filter(|other| *other != path) {
                std::fs::remove_file(&other).map_err(EvaluateError::io(&other))?;
            }
        }

        // What its own file holds; what follows the last end of line was torn.
        let mut journal = Self {
            path,
            file,
            finished: HashMap::new(),
            _shared: shared,
        };
        let mut bytes = Vec::new();
        if !restart {
            let read = read_opened(&journal.file, LARGEST_BYTES);
            bytes = read.map_err(EvaluateError::io(&journal.path))?;
        }
        let whole = whole_lines(&bytes).len();
        journal
            .file
            .set_len(whole as u64)
            .and_then(|()| journal.file.seek(std::io::SeekFrom::End(0)).map(drop))
            .map_err(EvaluateError::io(&journal.path))?;

        // What all files hold: those of others may be growing.
        for path in journals(folder)? {
            let bytes = match path == journal.path {
                true => std::mem::take(&mut bytes),
                false => read_regular(&path, LARGEST_BYTES).map_err(EvaluateError::io(&path))?,
            };
            journal.replay(&path, whole_lines(&bytes), settings, folder)?;
        }
        if whole == 0 {
            journal.append(settings)?;
        }
        Ok(journal)
    }

    /// Adds the cases of a journal to those that are finished.
    fn replay(
        &mut self,
        path: &Path,
        bytes: &[u8],
        settings: &Settings,
        folder: &Path,
    ) -> Result<(), EvaluateError> {
        let damaged = |line: usize, error: serde_json::Error| EvaluateError::Journal {
            path: path.to_owned(),
            line: line + 1,
            fact: error.to_string(),
        };
        let lines = bytes.split(|&b| b == b'\n').filter(|line| !line.is_empty());
        for (number, line) in lines.enumerate() {
            if number == 0 {
                let then: Settings =
                    serde_json::from_slice(line).map_err(|error| damaged(0, error))?;
                let differences = then.differences(settings);
                if !differences.is_empty() {
                    return Err(EvaluateError::SettingsChanged {
                        path: folder.into(),
                        differences,
                    });
                }
            } else {
                let case: Finished =
                    serde_json::from_slice(line).map_err(|error| damaged(number, error))?;
                self.finished.insert(case.case, case.rows);
            }
        }
        Ok(())
    }

    /// The rows of a case, if it is finished.
    pub fn rows(&self, case: &str) -> Option<&Vec<Row>> {
        self.finished.get(case)
    }

    /// Keeps the rows of a finished case.
    pub fn finish(&mut self, case: &str, rows: Vec<Row>) -> Result<(), EvaluateError> {
        let line = Finished {
            case: case.to_owned(),
            rows,
        };
        self.append(&line)?;
        self.finished.insert(line.case, line.rows);
        Ok(())
    }

    fn append(&mut self, line: &impl Serialize) -> Result<(), EvaluateError> {
        let mut bytes = serde_json::to_vec(line)
            .map_err(|error| EvaluateError::Fact(format!("journal: {error}")))?;
        bytes.push(b'\n');
        self.file
            .write_all(&bytes)
            .and_then(|()| file_system::sync_file(&self.file, &self.path))
            .map_err(EvaluateError::io(&self.path))
    }
}

/// What was written whole.
fn whole_lines(bytes: &[u8]) -> &[u8] {
    let end = bytes.iter().rposition(|&b| b == b'\n');
    &bytes[..end.map_or(0, |at| at + 1)]
}

fn open_file(path: &Path) -> Result<File, EvaluateError> {
    append_regular(path).map_err(EvaluateError::io(path))
}

fn locked(lock: Result<(), TryLockError>, folder: &Path) -> Result<(), EvaluateError> {
    lock.map_err(|error| match error {
        TryLockError::WouldBlock => EvaluateError::Locked {
            path: folder.into(),
        },
        TryLockError::Error(error) => EvaluateError::io(folder)(error),
    })
}

/// The journals of a folder, that of a run of all cases first, then by name.
fn journals(folder: &Path) -> Result<Vec<PathBuf>, EvaluateError> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(EvaluateError::io(folder))? {
        let name = entry.map_err(EvaluateError::io(folder))?.file_name();
        if let Some(name) = name.to_str()
            && (name == FILE || shard_of(name).is_some())
        {
            found.push((name != FILE, folder.join(name)));
        }
    }
    found.sort();
    Ok(found.into_iter().map(|(_, path)| path).collect())
}

/// Refuses a folder with something else in it. Shards may be beginning it at this moment.
fn refuse_foreign(folder: &Path, of_all: &Path) -> Result<(), EvaluateError> {
    let is_foreign = match of_all.exists() {
        true => !of_all.is_file(),
        false => std::fs::read_dir(folder)
            .map_err(EvaluateError::io(folder))?
            .flatten()
            .any(|entry| {
                let name = entry.file_name();
                let name = name.to_str().unwrap_or_default();
                name != FILE && shard_of(name).is_none()
            }),
    };
    if is_foreign {
        return Err(EvaluateError::ForeignFolder {
            path: folder.into(),
        });
    }
    Ok(())
}

/// Refuses to work next to shards of another number: some cases would be done twice.
fn refuse_other_division(folder: &Path, shard: Shard) -> Result<(), EvaluateError> {
    for path in journals(folder)? {
        let name = path.file_name().and_then(|name| name.to_str());
        let other = name.and_then(shard_of);
        if other.is_some_and(|other| other.of() != shard.of()) {
            locked(file_system::lock(&open_file(&path)?, &path), folder)?;
        }
    }
    Ok(())
}
