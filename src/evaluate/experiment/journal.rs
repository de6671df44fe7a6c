//! The journal of a run: its settings, then one line per finished case.
//!
//! Lines of JSON are appended whole; a process that dies leaves at most its last line
//! torn, and that line is dropped when the journal is opened again.

use std::collections::HashMap;
use std::fs::{File, OpenOptions};
use std::io::{Read, Seek, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::{EvaluateError, Row, Settings};
use crate::file_system;

/// Its name in the output folder.
pub const FILE: &str = "journal.jsonl";

#[derive(Serialize, Deserialize)]
struct Finished {
    case: String,
    rows: Vec<Row>,
}

/// An open journal; the folder is this process's until it is dropped.
pub struct Journal {
    path: PathBuf,
    file: File,
    finished: HashMap<String, Vec<Row>>,
}

impl Journal {
    /// Opens the journal in `folder`, or begins one there. `restart`: forget what it holds.
    pub fn open(folder: &Path, settings: &Settings, restart: bool) -> Result<Self, EvaluateError> {
        std::fs::create_dir_all(folder).map_err(EvaluateError::io(folder))?;
        let path = folder.join(FILE);
        let mut entries = std::fs::read_dir(folder).map_err(EvaluateError::io(folder))?;
        let is_other = path.exists() && !path.is_file();
        if is_other || !path.exists() && entries.next().is_some() {
            return Err(EvaluateError::ForeignFolder {
                path: folder.into(),
            });
        }
        let mut file = OpenOptions::new()
            .create(true)
            .read(true)
            .append(true)
            .open(&path)
            .map_err(EvaluateError::io(&path))?;
        match file_system::lock(&file, &path) {
            Ok(()) => {}
            Err(std::fs::TryLockError::WouldBlock) => {
                return Err(EvaluateError::Locked {
                    path: folder.into(),
                });
            }
            Err(std::fs::TryLockError::Error(error)) => {
                return Err(EvaluateError::io(&path)(error));
            }
        }
        let mut bytes = Vec::new();
        if !restart {
            file.read_to_end(&mut bytes)
                .map_err(EvaluateError::io(&path))?;
        }
        // What follows the last end of line was torn.
        let whole = bytes
            .iter()
            .rposition(|&b| b == b'\n')
            .map_or(0, |at| at + 1);
        file.set_len(whole as u64)
            .and_then(|()| file.seek(std::io::SeekFrom::End(0)))
            .map_err(EvaluateError::io(&path))?;
        let mut journal = Self {
            path,
            file,
            finished: HashMap::new(),
        };
        if whole == 0 {
            journal.append(settings)?;
        } else {
            journal.replay(&bytes[..whole], settings, folder)?;
        }
        Ok(journal)
    }

    fn replay(
        &mut self,
        bytes: &[u8],
        settings: &Settings,
        folder: &Path,
    ) -> Result<(), EvaluateError> {
        let damaged = |line: usize, error: serde_json::Error| EvaluateError::Journal {
            path: self.path.clone(),
            line: line + 1,
            fact: error.to_string(),
        };
        let lines = bytes.split(|&b| b == b'\n').filter(|line| !line.is_empty());
        let mut finished = HashMap::new();
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
                finished.insert(case.case, case.rows);
            }
        }
        self.finished = finished;
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
