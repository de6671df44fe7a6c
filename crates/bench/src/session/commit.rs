//! How bytes reach the disk, and in which order.
//!
//! A file is written under a temporary name in its own folder, fsynced, renamed,
//! and the folder is fsynced; only then may a journal line speak of it. A crash
//! between any two steps leaves either nothing under the final name or the whole
//! file. Every step is one operation of [`Disk`].

use std::ffi::OsString;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use super::SessionError;
use crate::file_system;

/// The operations that change a disk. Each either happened or returns an error;
/// [`Disk::append`] and [`Disk::write_temporary`] may have happened in part.
pub trait Disk: Send + Sync {
    /// Makes one folder; its parent exists. An existing one is an error.
    fn create_dir(&self, path: &Path) -> io::Result<()>;
    /// Makes a file and writes all bytes; what a crash left under this temporary
    /// name is lost.
    fn write_temporary(&self, path: &Path, bytes: &[u8]) -> io::Result<()>;
    /// Removes a file.
    fn remove_file(&self, path: &Path) -> io::Result<()>;
    /// Writes all bytes at the end of an existing file.
    fn append(&self, path: &Path, bytes: &[u8]) -> io::Result<()>;
    /// Cuts a file to this length.
    fn truncate(&self, path: &Path, bytes: u64) -> io::Result<()>;
    /// Waits until a file's bytes are on the medium.
    fn sync_file(&self, path: &Path) -> io::Result<()>;
    /// Gives a file or folder its new name, in one step where the file system has one.
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()>;
    /// Waits until a folder's names are on the medium, as far as the file system reports.
    fn sync_dir(&self, path: &Path) -> io::Result<()>;
    /// Bytes that this process may still write where this folder is.
    fn free_bytes(&self, folder: &Path) -> io::Result<u64> {
        file_system::free_bytes(folder)
    }
}

/// The system's file system.
#[derive(Clone, Copy, Debug, Default)]
pub struct SystemDisk;

impl Disk for SystemDisk {
    fn create_dir(&self, path: &Path) -> io::Result<()> {
        fs::create_dir(path)
    }

    fn write_temporary(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        File::create(path)?.write_all(bytes)
    }

    fn remove_file(&self, path: &Path) -> io::Result<()> {
        fs::remove_file(path)
    }

    fn append(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        OpenOptions::new().append(true).open(path)?.write_all(bytes)
    }

    fn truncate(&self, path: &Path, bytes: u64) -> io::Result<()> {
        OpenOptions::new().write(true).open(path)?.set_len(bytes)
    }

    fn sync_file(&self, path: &Path) -> io::Result<()> {
        // SMB flushes no file that is open for reading alone.
        let file = OpenOptions::new().write(true).open(path)?;
        file_system::sync_file(&file, path)
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        file_system::rename(from, to)
    }

    fn sync_dir(&self, path: &Path) -> io::Result<()> {
        file_system::sync_folder(path)
    }
}

/// Whether a file may take the place of one that exists.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Replace {
    /// An existing file is an error (raw frames, `session.toml`).
    Never,
    /// Derived files can be made again.
    Derived,
}

/// Name under which a file is written before it gets its own.
pub fn temporary_name(path: &Path) -> PathBuf {
    let mut name = OsString::from(".");
    name.push(path.file_name().unwrap_or_default());
    name.push(".part");
    path.with_file_name(name)
}

/// Brings files of one folder to the disk: all are written and fsynced, then
/// all renamed, then the folder is fsynced once. After `Ok` they survive a
/// power cut.
///
/// # Errors
/// [`SessionError::Exists`] with [`Replace::Never`] where a file has its name
/// already; otherwise what the file system reports. What was written under
/// temporary names is removed then, as far as the disk lets it.
pub fn commit_files(
    disk: &dyn Disk,
    folder: &Path,
    files: &[(&str, &[u8])],
    replace: Replace,
) -> Result<(), SessionError> {
    for (name, _) in files {
        let path = folder.join(name);
        if replace == Replace::Never && path.symlink_metadata().is_ok() {
            return Err(SessionError::Exists { path });
        }
    }
    let written = write_temporaries(disk, folder, files);
    if written.is_err() {
        for (name, _) in files {
            drop(disk.remove_file(&temporary_name(&folder.join(name))));
        }
    }
    written?;
    for (name, _) in files {
        let path = folder.join(name);
        disk.rename(&temporary_name(&path), &path)
            .map_err(|e| SessionError::io("rename to", &path, e))?;
    }
    sync_dir(disk, folder)
}

fn write_temporaries(
    disk: &dyn Disk,
    folder: &Path,
    files: &[(&str, &[u8])],
) -> Result<(), SessionError> {
    for (name, bytes) in files {
        let temporary = temporary_name(&folder.join(name));
        disk.write_temporary(&temporary, bytes)
            .map_err(|e| SessionError::io("write", &temporary, e))?;
        disk.sync_file(&temporary)
            .map_err(|e| SessionError::io("fsync", &temporary, e))?;
    }
    Ok(())
}

/// Appends one journal line and waits until it is on the medium.
pub fn append_line(disk: &dyn Disk, path: &Path, line: &[u8]) -> Result<(), SessionError> {
    disk.append(path, line)
        .map_err(|e| SessionError::io("append to", path, e))?;
    disk.sync_file(path)
        .map_err(|e| SessionError::io("fsync", path, e))
}

/// Makes a folder and its missing parents, each name fsynced in its parent.
pub fn create_dirs(disk: &dyn Disk, path: &Path) -> Result<(), SessionError> {
    if path.is_dir() {
        return Ok(());
    }
    let parent = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    create_dirs(disk, parent)?;
    match disk.create_dir(path) {
        Ok(()) => sync_dir(disk, parent),
        Err(_) if path.is_dir() => Ok(()),
        Err(e) => Err(SessionError::io("create the folder", path, e)),
    }
}

pub(crate) fn sync_dir(disk: &dyn Disk, path: &Path) -> Result<(), SessionError> {
    disk.sync_dir(path)
        .map_err(|e| SessionError::io("fsync the folder", path, e))
}

/// Bytes that this process may still write on the disk that holds `path`, or
/// the nearest of its parents that exists.
pub fn free_bytes(path: &Path) -> Result<u64, SessionError> {
    free(path, file_system::free_bytes)
}

/// Files that may still be made there, where the file system says.
pub fn free_files(path: &Path) -> Result<Option<u64>, SessionError> {
    free(path, file_system::free_files)
}

fn free<T>(path: &Path, ask: impl Fn(&Path) -> io::Result<T>) -> Result<T, SessionError> {
    let existing = existing(path)?;
    ask(&existing).map_err(|e| SessionError::io("ask for the free space of", &existing, e))
}

/// Refuses a folder that could not be made, or in which none could.
///
/// # Errors
/// What is there is no folder, or may not be written.
pub fn check_creatable(path: &Path) -> Result<(), SessionError> {
    let existing = existing(path)?;
    let checked = match existing.is_dir() {
        #[cfg(unix)]
        true => {
            use rustix::fs::{Access, access};
            access(&existing, Access::WRITE_OK | Access::EXEC_OK).map_err(io::Error::from)
        }
        #[cfg(windows)]
        true => Ok(()),
        false => Err(io::ErrorKind::NotADirectory.into()),
    };
    checked.map_err(|e| SessionError::io("make a folder in", &existing, e))
}

/// The path, or the nearest of the folders above it that exists.
fn existing(path: &Path) -> Result<PathBuf, SessionError> {
    let absolute = std::path::absolute(path).map_err(|e| SessionError::io("find", path, e))?;
    let existing = absolute.ancestors().find(|p| p.symlink_metadata().is_ok());
    Ok(existing.unwrap_or(Path::new("/")).to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::faults::{Fault, FaultyDisk};

    #[test]
    fn a_failed_commit_leaves_no_file_under_its_name_or_the_whole_one() {
        for fault in Fault::ALL {
            for operation in 0.. {
                let folder = tempfile::tempdir().unwrap();
                let disk = FaultyDisk::new(operation, fault);
                let done = commit_files(
                    &disk,
                    folder.path(),
                    &[("a.png", b"counts"), ("a.toml", b"sidecar")],
                    Replace::Never,
                );
                for (name, bytes) in [("a.png", &b"counts"[..]), ("a.toml", b"sidecar")] {
                    match fs::read(folder.path().join(name)) {
                        Ok(found) => assert_eq!(found, bytes, "{fault:?} at {operation}"),
                        Err(_) => assert!(done.is_err(), "{fault:?} at {operation}"),
                    }
                }
                if done.is_ok() {
                    assert!(operation > 6, "{fault:?} at {operation} went unnoticed");
                    break;
                }
            }
        }
    }

    /// A full disk gets the space of an unfinished file back; what only a crash
    /// can leave is in nobody's way.
    #[test]
    fn an_unfinished_file_does_not_stay_or_stand_in_the_way() {
        let folder = tempfile::tempdir().unwrap();
        let temporary = temporary_name(&folder.path().join("x"));
        let commit =
            |disk: &dyn Disk| commit_files(disk, folder.path(), &[("x", b"bytes")], Replace::Never);
        assert!(matches!(
            commit(&FaultyDisk::new(0, Fault::DiskFull)),
            Err(SessionError::DiskFull { .. })
        ));
        assert!(!temporary.exists());
        fs::write(&temporary, b"longer than what comes").unwrap();
        commit(&SystemDisk).unwrap();
        assert_eq!(fs::read(folder.path().join("x")).unwrap(), b"bytes");
    }

    #[test]
    fn nothing_is_overwritten() {
        let folder = tempfile::tempdir().unwrap();
        let commit = |bytes: &[u8], replace| {
            commit_files(&SystemDisk, folder.path(), &[("x", bytes)], replace)
        };
        commit(b"first", Replace::Never).unwrap();
        assert!(matches!(
            commit(b"second", Replace::Never),
            Err(SessionError::Exists { .. })
        ));
        assert_eq!(fs::read(folder.path().join("x")).unwrap(), b"first");
        commit(b"third", Replace::Derived).unwrap();
        assert_eq!(fs::read(folder.path().join("x")).unwrap(), b"third");
    }
}
