//! The list of sessions, kept in memory.

use std::collections::HashMap;
use std::fs::FileType;
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use rayon::prelude::*;

use super::row::Row;
use crate::fault::{Advisor, Fault};
use crate::session::layout::{JOURNAL_FILE, REPORT_FILE, SESSION_FILE};

/// Which file it was, and in which state: inode, length, time of the last change in ns.
type FileStamp = Option<[i128; 3]>;
/// The files by which a session changes. Everything that is added to a session is
/// journalled.
pub type Stamp = [FileStamp; 3];

/// The sessions of one folder. A session is read anew only when its journal, `session.toml`
/// or report has changed.
#[derive(Debug)]
pub struct Catalogue {
    folder: PathBuf,
    advisor: Advisor,
    known: Mutex<HashMap<String, (Stamp, Arc<Row>)>>,
}

impl Catalogue {
    /// Of the sessions in this folder, which need not exist yet.
    pub fn new(folder: impl Into<PathBuf>, advisor: Advisor) -> Self {
        Self {
            folder: folder.into(),
            advisor,
            known: Mutex::default(),
        }
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Who advises on errors.
    pub fn advisor(&self) -> &Advisor {
        &self.advisor
    }

    /// The sessions that a search finds (all, if it has no words), newest first; folders that
    /// cannot be read are among them, with their error. Requests wait for one another.
    ///
    /// # Errors
    /// The folder itself cannot be read. One that does not exist has no sessions.
    pub fn list(&self, search: &str) -> io::Result<Vec<Arc<Row>>> {
        let entries = match std::fs::read_dir(&self.folder) {
            Ok(entries) => entries,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
            Err(error) => return Err(error),
        };
        let (mut names, mut rows) = (Vec::new(), Vec::new());
        for entry in entries.flatten() {
            // Hidden: also a session that is being made.
            let name = entry.file_name();
            if name.as_encoded_bytes().starts_with(b".") {
                continue;
            }
            let Ok(kind) = entry.file_type() else {
                continue;
            };
            match name.to_str() {
                Some(name) if kind.is_dir() => names.push(name.to_owned()),
                _ => {
                    let failed =
                        |fact| Arc::new(Row::failed(&name.to_string_lossy(), Fault::new(fact)));
                    rows.extend(unreadable(kind).map(failed));
                }
            }
        }
        rows.extend(self.read(names));
        rows.retain(|row| row.matches(search));
        rows.sort_by(|a, b| (&b.began, &b.name).cmp(&(&a.began, &a.name)));
        Ok(rows)
    }

    /// The rows of these folders, from memory where nothing has changed.
    fn read(&self, names: Vec<String>) -> Vec<Arc<Row>> {
        let mut known = lock(&self.known);
        let read = |name: String| {
            let stamp = stamp(&self.folder.join(&name));
            let row = match known.get(&name) {
                Some((then, row)) if *then == stamp => Arc::clone(row),
                _ => Arc::new(Row::read(&self.folder, &name, &self.advisor)),
            };
            (name, (stamp, row))
        };
        // What is gone is forgotten.
        *known = names.into_par_iter().map(read).collect();
        known.values().map(|(_, row)| Arc::clone(row)).collect()
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Why something in the folder that is no folder of a readable name is no session; `None`
/// for files, which nobody takes for one.
fn unreadable(kind: FileType) -> Option<&'static str> {
    if kind.is_symlink() {
        Some("it is a symbolic link, which is not followed")
    } else if kind.is_dir() {
        Some("its name is no Unicode text")
    } else {
        None
    }
}

/// In which state a session is, as far as the times of its files tell.
pub fn stamp(session: &Path) -> Stamp {
    [JOURNAL_FILE, SESSION_FILE, REPORT_FILE].map(|name| {
        let found = session.join(name).symlink_metadata().ok()?;
        let changed_ns = i128::from(found.mtime()) * 1_000_000_000 + i128::from(found.mtime_nsec());
        Some([found.ino().into(), found.len().into(), changed_ns])
    })
}

#[cfg(test)]
mod tests {
    use std::os::unix::ffi::OsStrExt;
    use std::os::unix::fs::symlink;

    use super::*;
    use crate::session::example::{fitted_session, session};

    fn names(rows: &[Arc<Row>]) -> Vec<&str> {
        rows.iter().map(|row| row.name.as_str()).collect()
    }

    #[test]
    fn broken_and_foreign_folders_hide_no_session() {
        let outside = tempfile::tempdir().unwrap();
        let folder = outside.path().join("sessions");
        let catalogue = Catalogue::new(&folder, Advisor::silent());
        assert!(catalogue.list("").unwrap().is_empty(), "no folder yet");
        let old = session(&folder, "bowl", "2026-11-21T02:34:00Z");
        let new = session(&folder, "cup", "2026-11-22T02:34:00Z");

        // Half-written, emptied, foreign, named badly, hidden, files, links.
        let half = session(&folder, "half", "2026-11-23T02:34:00Z");
        std::fs::write(folder.join(&half).join(SESSION_FILE), "sample = ").unwrap();
        let emptied = session(&folder, "emptied", "2026-11-24T02:34:00Z");
        std::fs::write(folder.join(&emptied).join(JOURNAL_FILE), "").unwrap();
        std::fs::create_dir(folder.join("photos")).unwrap();
        std::fs::create_dir(folder.join(std::ffi::OsStr::from_bytes(b"b\xffd"))).unwrap();
        std::fs::create_dir(folder.join(".hidden.part")).unwrap();
        std::fs::write(folder.join("note.txt"), "a note").unwrap();
        symlink(folder.join(&old), folder.join("link")).unwrap();
        let linked = session(&folder, "linked", "2026-11-20T02:34:00Z");
        let journal = folder.join(&linked).join(JOURNAL_FILE);
        std::fs::rename(&journal, outside.path().join("journal")).unwrap();
        symlink(outside.path().join("journal"), &journal).unwrap();

        let rows = catalogue.list("").unwrap();
        assert_eq!(
            names(&rows),
            [
                &emptied,
                &half,
                &new,
                &old,
                &linked,
                "photos",
                "link",
                "b\u{fffd}d"
            ]
        );
        let error = |name: &str| {
            let row = rows.iter().find(|row| row.name == name).unwrap();
            row.error.as_ref().map(|fault| fault.error.as_str())
        };
        assert_eq!((error(&old), error(&new)), (None, None));
        for (name, fact) in [
            (half.as_str(), "session.toml"),
            (&emptied, "journal"),
            ("photos", "neither session.toml nor journal.jsonl"),
            ("link", "symbolic link"),
            (&linked, "symbolic link"),
            ("b\u{fffd}d", "no Unicode"),
        ] {
            assert!(
                error(name).unwrap().contains(fact),
                "{name}: {:?}",
                error(name)
            );
        }
        assert_eq!(names(&catalogue.list("cup").unwrap()), [&new]);
    }

    #[test]
    fn a_session_is_read_again_when_it_has_changed() {
        let folder = tempfile::tempdir().unwrap();
        let changed = fitted_session(folder.path());
        let other = session(folder.path(), "cup", "2026-11-20T02:34:00Z");
        let catalogue = Catalogue::new(folder.path(), Advisor::silent());
        let first = catalogue.list("").unwrap();
        let again = catalogue.list("").unwrap();
        assert_eq!(names(&first), [&changed, &other]);
        assert!(first.iter().zip(&again).all(|(a, b)| Arc::ptr_eq(a, b)));

        std::fs::remove_file(folder.path().join(&changed).join(REPORT_FILE)).unwrap();
        let again = catalogue.list("").unwrap();
        assert!(first[0].report && !again[0].report);
        assert!(Arc::ptr_eq(&first[1], &again[1]));

        for name in [&changed, &other] {
            std::fs::remove_dir_all(folder.path().join(name)).unwrap();
        }
        assert!(catalogue.list("").unwrap().is_empty());
        assert!(lock(&catalogue.known).is_empty());
    }
}
