//! Files and folders that appear whole: written under another name in the same folder, then
//! renamed.
//!
//! That name is `.NAME.rig-part`, after the name that is to come, and what has it is locked as
//! long as it is written. A file of that name without a lock was left by a program that was
//! killed: the next program that writes into the folder removes it.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, BufWriter, Seek, Write};
#[cfg(unix)]
use std::os::unix::fs::MetadataExt;
#[cfg(windows)]
use std::os::windows::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use crate::file_system::{self, PART};
use crate::outside_file::never_waiting;

/// A name and what is added to it have at most 255 bytes; longer names lose their end.
const LONGEST_NAME: usize = 200;
/// So many programs write the same file at the same time, or were killed at it where the file
/// system has no locks.
const MOST_PARTS: u32 = 1000;
/// A name is lost to a program that clears the folder at that moment, or is free again.
const MOST_TRIES: u32 = 20;
/// So long may a program take to clear a file that it holds.
const PATIENCE: Duration = Duration::from_secs(1);

/// A file that is being written.
pub trait Out: Write + Seek {}

impl<T: Write + Seek> Out for T {}

/// Writes a file in place of any of that name, so that no reader ever sees half
/// of it: to a temporary file in the same folder, synchronised, then renamed.
/// Permissions are those of any new file.
///
/// # Errors
/// What stands there is no regular file (renaming would replace a device, a
/// link or a named pipe by a file), or the system refuses. Messages don't name
/// the path.
pub fn replace(path: &Path, write: impl FnOnce(&mut dyn Out) -> io::Result<()>) -> io::Result<()> {
    if std::fs::symlink_metadata(path).is_ok_and(|there| !there.is_file()) {
        return Err(not_regular());
    }
    written(path, write)?.renamed(|part| file_system::rename(part, path))
}

/// As [`replace`], where nothing has the name yet.
///
/// # Errors
/// [`io::ErrorKind::AlreadyExists`], or the system refuses.
pub fn create(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let part = written(path, |out| out.write_all(bytes))?;
    part.renamed(|part| file_system::rename_new(part, path))
}

/// Whether [`replace`] could write this file: for what works long before it writes. The
/// nearest parent that exists must take a new file, which leaves no trace.
///
/// # Errors
/// As [`replace`]; messages don't name the path.
pub fn check_writable(path: &Path) -> io::Result<()> {
    if std::fs::symlink_metadata(path).is_ok_and(|there| !there.is_file()) {
        return Err(not_regular());
    }
    check_folder(path.parent().unwrap_or(Path::new("")))
}

/// Whether files can be made in this folder, which may have to be made itself.
///
/// # Errors
/// The system refuses a file there. Messages don't name the path.
pub fn check_folder(folder: &Path) -> io::Result<()> {
    let folder = std::path::absolute(if folder.as_os_str().is_empty() {
        Path::new(".")
    } else {
        folder
    })?;
    let there = folder
        .ancestors()
        .find(|path| path.symlink_metadata().is_ok());
    let there = there.unwrap_or(Path::new("/"));
    if !there.is_dir() {
        return Err(io::ErrorKind::NotADirectory.into());
    }
    Part::file(&there.join("check")).map(drop)
}

fn not_regular() -> io::Error {
    io::Error::new(
        io::ErrorKind::InvalidInput,
        "it exists and is not a regular file",
    )
}

/// A temporary file in the folder of `path`, synchronised.
fn written(path: &Path, write: impl FnOnce(&mut dyn Out) -> io::Result<()>) -> io::Result<Part> {
    let part = Part::file(path)?;
    if let Some(file) = &part.open {
        let mut writer = BufWriter::new(file);
        write(&mut writer)?;
        writer.flush()?;
        drop(writer);
        file_system::sync_file(file, path)?;
    }
    Ok(part)
}

/// What is being written under a temporary name. Dropped, it is removed.
#[derive(Debug)]
pub struct Part {
    path: PathBuf,
    /// Locked, where the file system has locks.
    open: Option<File>,
    is_renamed: bool,
}

impl Part {
    /// A file that shall be called `target`.
    fn file(target: &Path) -> io::Result<Self> {
        Self::new(target, |path| {
            OpenOptions::new().write(true).create_new(true).open(path)
        })
    }

    /// A folder that shall be called `target`, to be filled and then [`renamed`](Self::renamed).
    ///
    /// # Errors
    /// The system's. Messages don't name the path.
    pub fn folder(target: &Path) -> io::Result<Self> {
        Self::new(target, |path| {
            std::fs::create_dir(path)?;
            file_system::open_folder(path)
        })
    }

    fn new(target: &Path, make: impl Fn(&Path) -> io::Result<File>) -> io::Result<Self> {
        let folder = target.parent().filter(|p| !p.as_os_str().is_empty());
        let folder = folder.unwrap_or(Path::new("."));
        // In the system's words where there is no such folder.
        std::fs::metadata(folder)?;
        clear_once(folder);
        for number in 1..=MOST_PARTS {
            let path = part_name(target, number);
            for _ in 0..MOST_TRIES {
                match make(&path) {
                    Ok(open) => {
                        // Another program that clears the folder may have been first: it goes.
                        let end = Instant::now() + PATIENCE;
                        while matches!(open.try_lock(), Err(TryLockError::WouldBlock))
                            && is_at(&open, &path)
                            && Instant::now() < end
                        {
                            thread::sleep(Duration::from_millis(1));
                        }
                        if is_at(&open, &path) {
                            return Ok(Self {
                                path,
                                open: Some(open),
                                is_renamed: false,
                            });
                        }
                    }
                    Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
                        if !clear(&path) {
                            break;
                        }
                    }
                    // The kind alone: the name that the system refuses is not the user's.
                    Err(error) => return Err(io::Error::from(error.kind())),
                }
            }
        }
        Err(io::ErrorKind::ResourceBusy.into())
    }

    /// Where it is meanwhile.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Gives it its name by `rename`.
    ///
    /// # Errors
    /// That of `rename`; nothing stays behind.
    pub fn renamed(mut self, rename: impl Fn(&Path) -> io::Result<()>) -> io::Result<()> {
        if rename(&self.path).is_err() {
            // Some file systems rename nothing that is open.
            self.open = None;
            rename(&self.path)?;
        }
        self.is_renamed = true;
        Ok(())
    }
}

impl Drop for Part {
    fn drop(&mut self) {
        if !self.is_renamed && remove(&self.path).is_err() {
            // Some file systems remove nothing that is open. What stays is cleared later.
            self.open = None;
            drop(remove(&self.path));
        }
    }
}

/// `.NAME.rig-part`, and others where programs write the same at the same time. It is a name
/// that every file system takes: whether it takes `target` is seen when that is given.
fn part_name(target: &Path, number: u32) -> PathBuf {
    let name = target.file_name().unwrap_or_default().to_string_lossy();
    let end = name.floor_char_boundary(LONGEST_NAME);
    let odd = |c: char| c.is_control() || "\"*:<>?\\|".contains(c);
    let name = name[..end].replace(odd, "_");
    target.with_file_name(match number {
        1 => format!(".{name}{PART}"),
        _ => format!(".{name}.{number}{PART}"),
    })
}

/// Removes what killed programs have left in a folder, once for each folder.
pub fn clear_once(folder: &Path) {
    static CLEARED: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());
    let mut cleared = CLEARED.lock().unwrap_or_else(PoisonError::into_inner);
    if cleared.iter().any(|known| known == folder) {
        return;
    }
    cleared.push(folder.to_owned());
    drop(cleared);
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    for entry in entries {
        let name = entry.file_name();
        let name = name.as_encoded_bytes();
        if name.starts_with(b".") && name.ends_with(PART.as_bytes()) {
            clear(&entry.path());
        }
    }
}

/// Removes what has a temporary name, unless a living program writes it or nobody can know;
/// whether it is gone.
fn clear(path: &Path) -> bool {
    let Ok(found) = path.symlink_metadata() else {
        return true;
    };
    if !found.is_file() && !found.is_dir() {
        return false;
    }
    let mut options = OpenOptions::new();
    options.read(true).write(found.is_file());
    let Ok(open) = never_waiting(&mut options, false).open(path) else {
        return false;
    };
    open.try_lock().is_ok() && is_at(&open, path) && remove(path).is_ok()
}

/// Whether a path still leads to what is open.
fn is_at(open: &File, path: &Path) -> bool {
    #[cfg(unix)]
    let id = |of: io::Result<std::fs::Metadata>| of.ok().map(|of| (of.dev(), of.ino()));
    // Stable Rust has no number of a file there; nobody removes one that is open.
    #[cfg(windows)]
    let id = |of: io::Result<std::fs::Metadata>| of.ok().map(|of| of.creation_time());
    let opened = id(open.metadata());
    opened.is_some() && opened == id(path.symlink_metadata())
}

fn remove(path: &Path) -> io::Result<()> {
    match path.symlink_metadata()?.is_dir() {
        true => std::fs::remove_dir_all(path),
        false => std::fs::remove_file(path),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_regular_files_are_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a");
        for text in ["one", "two"] {
            replace(&file, |out| out.write_all(text.as_bytes())).unwrap();
            assert_eq!(std::fs::read_to_string(&file).unwrap(), text);
        }
        let link = folder.path().join("link");
        std::os::unix::fs::symlink(&file, &link).unwrap();
        for there in [link.as_path(), folder.path(), Path::new("/dev/null")] {
            let error = replace(there, |_| Ok(())).unwrap_err().to_string();
            assert!(error.contains("not a regular file"), "{there:?}: {error}");
        }
        assert!(link.is_symlink());
    }

    #[test]
    fn what_exists_is_not_created() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a");
        create(&file, b"one").unwrap();
        let error = create(&file, b"two").unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::AlreadyExists);
        assert_eq!(std::fs::read(&file).unwrap(), b"one");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    /// What a killed program leaves is not locked.
    #[test]
    fn what_was_left_is_cleared_and_what_is_written_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let there = |name: &str| folder.path().join(name);
        let written = Part::file(&there("a")).unwrap();
        let made = Part::folder(&there("c")).unwrap();
        for left in [".b.rig-part", ".a.2.rig-part"] {
            std::fs::write(there(left), "half").unwrap();
        }
        std::fs::create_dir(there(".d.rig-part")).unwrap();
        std::fs::write(there(".d.rig-part/x"), "half").unwrap();
        std::fs::write(there(".of-others.part"), "theirs").unwrap();
        std::os::unix::fs::symlink("x", there(".link.rig-part")).unwrap();
        replace(&there("a"), |out| out.write_all(b"of another")).unwrap();
        // Each folder is cleared once: as another program would do it.
        for left in [".b.rig-part", ".d.rig-part"] {
            assert!(clear(&there(left)), "{left}");
        }
        for kept in [written.path(), made.path(), &there(".link.rig-part")] {
            assert!(!clear(kept), "{kept:?}");
        }
        written
            .renamed(|part| file_system::rename(part, &there("a")))
            .unwrap();
        drop(made);
        let names = std::fs::read_dir(folder.path()).unwrap();
        let mut names: Vec<_> = names.map(|entry| entry.unwrap().file_name()).collect();
        names.sort();
        assert_eq!(names, [".link.rig-part", ".of-others.part", "a"]);
        let long = "é".repeat(127);
        replace(&there(&long), |out| out.write_all(b"long")).unwrap();
        assert!(there(&long).is_file());
    }

    #[test]
    fn what_cannot_be_written_is_known_before() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        std::fs::write(&file, "old").unwrap();
        let not_made = folder.path().join("a/b/c");
        check_writable(&file).unwrap();
        check_writable(&not_made).unwrap();
        check_folder(&not_made).unwrap();
        for refused in [folder.path(), &file.join("x"), Path::new("/proc/x")] {
            check_writable(refused).unwrap_err();
        }
        check_folder(&file).unwrap_err();
        check_folder(Path::new("/proc/a/b")).unwrap_err();
        assert_eq!(std::fs::read(&file).unwrap(), b"old");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_failed_write_leaves_what_was_there() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a");
        std::fs::write(&file, "old").unwrap();
        replace(&file, |out| {
            out.write_all(b"new")?;
            Err(io::Error::other("no more"))
        })
        .unwrap_err();
        assert_eq!(std::fs::read_to_string(&file).unwrap(), "old");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
