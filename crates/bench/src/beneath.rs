//! Files below a folder, opened step by step, so that no path leads elsewhere: not by `..`,
//! not by a symbolic link, not by one that is put there meanwhile.

use std::ffi::OsStr;
use std::fs::File;
use std::io::{self, Read};
use std::os::fd::{AsFd, OwnedFd};
use std::path::{Component, Path, PathBuf};

use rustix::fs::{CWD, FileType, Mode, OFlags, fstat, openat};
use rustix::io::Errno;

/// Why a file below a folder was not opened or read; facts only.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum BeneathError {
    /// Its path has something else than plain names.
    #[error("{path:?} is no path below the folder")]
    Path { path: String },
    #[error("{}: it is a symbolic link, which is not followed", path.display())]
    Link { path: PathBuf },
    /// It is a folder, a pipe, a device.
    #[error("{}: it is no regular file", path.display())]
    NoFile { path: PathBuf },
    /// It is larger than anything of its kind.
    #[error("{}: it has more than {most_bytes} bytes", path.display())]
    TooLarge { path: PathBuf, most_bytes: u64 },
    /// The system refuses.
    #[error("{}: {source}", path.display())]
    Io { path: PathBuf, source: io::Error },
}

impl BeneathError {
    /// Whether nothing is there, as opposed to something that is not opened.
    pub fn is_missing(&self) -> bool {
        matches!(self, Self::Io { source, .. } if matches!(
            source.kind(),
            io::ErrorKind::NotFound | io::ErrorKind::NotADirectory
        ))
    }
}

/// Opens the regular file `relative` below `root`, which may itself be reached by links.
/// Never waits.
pub fn open(root: &Path, relative: &str) -> Result<File, BeneathError> {
    let names = names(relative)?;
    let (last, folders) = names.split_last().ok_or_else(|| BeneathError::Path {
        path: relative.to_owned(),
    })?;
    let (parent, path) = walk(root, folders)?;
    let path = path.join(last);
    let flags = OFlags::RDONLY | OFlags::NONBLOCK | OFlags::NOCTTY;
    let file = step(&parent, last, flags, &path)?;
    let found = fstat(&file).map_err(|errno| io_error(&path, errno))?;
    match FileType::from_raw_mode(found.st_mode) {
        FileType::RegularFile => Ok(File::from(file)),
        _ => Err(BeneathError::NoFile { path }),
    }
}

/// The bytes of [`open`]'s file, which has at most `most_bytes`.
///
/// # Errors
/// As [`open`]; a larger file.
pub fn read(root: &Path, relative: &str, most_bytes: u64) -> Result<Vec<u8>, BeneathError> {
    let file = open(root, relative)?;
    let mut bytes = Vec::new();
    let path = root.join(relative);
    match file.take(most_bytes + 1).read_to_end(&mut bytes) {
        Ok(_) if bytes.len() as u64 > most_bytes => {
            Err(BeneathError::TooLarge { path, most_bytes })
        }
        Ok(_) => Ok(bytes),
        Err(source) => Err(BeneathError::Io { path, source }),
    }
}

/// Whether `relative` below `root` is a folder that no link leads to.
pub fn check_folder(root: &Path, relative: &str) -> Result<(), BeneathError> {
    walk(root, &names(relative)?).map(drop)
}

/// The names of a path; every one a plain one.
fn names(relative: &str) -> Result<Vec<&OsStr>, BeneathError> {
    let refused = || BeneathError::Path {
        path: relative.to_owned(),
    };
    if relative.is_empty() || relative.contains(['\0', '\\']) || relative.ends_with('/') {
        return Err(refused());
    }
    // `components` passes over `a//b` and `a/./b`, which no address of ours has.
    let parts = relative.split('/').count();
    let names: Option<Vec<&OsStr>> = Path::new(relative)
        .components()
        .map(|component| match component {
            Component::Normal(name) => Some(name),
            _ => None,
        })
        .collect();
    match names {
        Some(names) if names.len() == parts => Ok(names),
        _ => Err(refused()),
    }
}

/// Opens folder after folder; returns the last one and its path.
fn walk(root: &Path, folders: &[&OsStr]) -> Result<(OwnedFd, PathBuf), BeneathError> {
    let flags = OFlags::RDONLY | OFlags::DIRECTORY | OFlags::CLOEXEC;
    let mut folder =
        openat(CWD, root, flags, Mode::empty()).map_err(|errno| io_error(root, errno))?;
    let mut path = root.to_owned();
    for name in folders {
        path.push(name);
        folder = step(&folder, name, OFlags::RDONLY | OFlags::DIRECTORY, &path)?;
    }
    Ok((folder, path))
}

fn step(
    folder: &impl AsFd,
    name: &OsStr,
    flags: OFlags,
    path: &Path,
) -> Result<OwnedFd, BeneathError> {
    let flags = flags | OFlags::NOFOLLOW | OFlags::CLOEXEC;
    openat(folder, name, flags, Mode::empty()).map_err(|errno| {
        // A folder's link gives ENOTDIR.
        let is_link = || {
            path.symlink_metadata()
                .is_ok_and(|found| found.is_symlink())
        };
        match errno {
            Errno::LOOP | Errno::NOTDIR if is_link() => BeneathError::Link {
                path: path.to_owned(),
            },
            // A socket.
            Errno::NXIO => BeneathError::NoFile {
                path: path.to_owned(),
            },
            errno => io_error(path, errno),
        }
    })
}

fn io_error(path: &Path, errno: Errno) -> BeneathError {
    BeneathError::Io {
        path: path.to_owned(),
        source: errno.into(),
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;

    #[test]
    fn only_regular_files_below_the_folder_are_opened() {
        let outside = tempfile::tempdir().unwrap();
        std::fs::write(outside.path().join("secret"), "secret").unwrap();
        let folder = outside.path().join("sessions");
        std::fs::create_dir_all(folder.join("a/b")).unwrap();
        std::fs::write(folder.join("a/b/file"), "here").unwrap();
        symlink(outside.path().join("secret"), folder.join("a/link")).unwrap();
        symlink("b", folder.join("a/way")).unwrap();
        symlink(outside.path(), folder.join("out")).unwrap();
        assert_eq!(read(&folder, "a/b/file", 4).unwrap(), b"here");

        let link = |path: &str| matches!(open(&folder, path), Err(BeneathError::Link { .. }));
        assert!(link("a/link") && link("a/way/file") && link("out/secret") && link("out"));
        for path in [
            "",
            ".",
            "..",
            "../secret",
            "a/../../secret",
            "a/b/../b/file",
            "/etc/passwd",
            "a//b/file",
            "a/b/file/",
            "./a/b/file",
            "a\\b",
            "a\0b",
        ] {
            let refused = open(&folder, path);
            assert!(
                matches!(refused, Err(BeneathError::Path { .. })),
                "{path:?}"
            );
        }
        assert!(matches!(
            open(&folder, "a/b"),
            Err(BeneathError::NoFile { .. })
        ));
        assert!(open(&folder, "a/none").unwrap_err().is_missing());
        assert!(open(&folder, "a/b/file/more").unwrap_err().is_missing());
        let large = read(&folder, "a/b/file", 3);
        assert!(matches!(large, Err(BeneathError::TooLarge { .. })));
    }

    /// Opening a pipe without a writer would wait for one.
    #[test]
    fn nothing_is_waited_for() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        rustix::fs::mkfifoat(CWD, &pipe, Mode::RUSR | Mode::WUSR).unwrap();
        let _socket = std::os::unix::net::UnixListener::bind(folder.path().join("socket")).unwrap();
        for name in ["pipe", "socket"] {
            let refused = open(folder.path(), name);
            assert!(
                matches!(refused, Err(BeneathError::NoFile { .. })),
                "{name}"
            );
        }
    }

    #[test]
    fn folders_are_checked_likewise() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("a")).unwrap();
        symlink("a", folder.path().join("link")).unwrap();
        assert!(check_folder(folder.path(), "a").is_ok());
        let link = check_folder(folder.path(), "link");
        assert!(matches!(link, Err(BeneathError::Link { .. })));
    }
}
