//! Files that appear whole: written under another name in the same folder, then renamed.

use std::io::{self, BufWriter, Seek, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use tempfile::TempPath;

use crate::file_system;

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
    let file = written(path, write)?;
    file_system::rename(&file, path)?;
    // Renamed: nothing is left to remove.
    file.keep().map_err(|error| error.error)?;
    Ok(())
}

/// As [`replace`], where nothing has the name yet.
///
/// # Errors
/// [`io::ErrorKind::AlreadyExists`], or the system refuses.
pub fn create(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let file = written(path, |out| out.write_all(bytes))?;
    file_system::rename_new(&file, path)?;
    file.keep().map_err(|error| error.error)?;
    Ok(())
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
    // Closed before it is removed, which not every file system does with an open one.
    let file = tempfile::NamedTempFile::new_in(there)?;
    file.into_temp_path().close()
}

fn not_regular() -> io::Error {
    io::Error::new(
        io::ErrorKind::InvalidInput,
        "it exists and is not a regular file",
    )
}

/// A temporary file in the folder of `path`, synchronised and closed; dropping it removes it.
fn written(
    path: &Path,
    write: impl FnOnce(&mut dyn Out) -> io::Result<()>,
) -> io::Result<TempPath> {
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty());
    // In the system's words where there is no such folder.
    std::fs::metadata(folder.unwrap_or(Path::new(".")))?;
    // The kind alone: the message would name the temporary file.
    let file = tempfile::Builder::new()
        .permissions(std::fs::Permissions::from_mode(0o666))
        .tempfile_in(folder.unwrap_or(Path::new(".")))
        .map_err(|error| io::Error::from(error.kind()))?;
    // Not the temporary file itself, whose errors would name it.
    let mut writer = BufWriter::new(file.as_file());
    write(&mut writer)?;
    writer.flush()?;
    drop(writer);
    file_system::sync_file(file.as_file(), path)?;
    Ok(file.into_temp_path())
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
