//! Files that the journal vouches for, read as it states them: regular files
//! inside the session, of the length and the SHA-256 of their record.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{self, Read, Seek};
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use super::SessionError;
use super::journal::{FileDigest, Journal};
use super::layout::{
    DERIVED_FOLDER, FITS_FOLDER, JOURNAL_FILE, QUARANTINE_FOLDER, RAW_FOLDER, VALIDATIONS_FOLDER,
};
use crate::checksum::hex;
use crate::outside_file::open_regular;

/// Files beyond this are checked but not read into memory.
const LARGEST_READ_BYTES: u64 = 2 << 30;

/// The file's bytes, checked against its record.
pub(super) fn read(root: &Path, file: &FileDigest) -> Result<Vec<u8>, SessionError> {
    read_within(root, file, LARGEST_READ_BYTES)
}

/// Likewise of a file of at most so many bytes.
pub(super) fn read_within(
    root: &Path,
    file: &FileDigest,
    largest_bytes: u64,
) -> Result<Vec<u8>, SessionError> {
    if file.bytes > largest_bytes {
        let bytes = file.bytes;
        let why = format!("it has {bytes} bytes, but at most {largest_bytes} are read");
        return Err(SessionError::malformed(&root.join(&file.path), why));
    }
    let mut bytes = Vec::new();
    pass(root, file, |piece| bytes.extend_from_slice(piece))?;
    Ok(bytes)
}

/// Whether a file holds what the journal says.
///
/// # Errors
/// [`SessionError::Missing`], [`SessionError::Length`], [`SessionError::Checksum`], or
/// [`SessionError::Io`] for what is no regular file or cannot be read.
pub fn check(root: &Path, file: &FileDigest) -> Result<(), SessionError> {
    pass(root, file, |_| ()).map(drop)
}

/// As [`check`]; the file, open at its beginning, for what is read in pieces.
pub(super) fn open(root: &Path, file: &FileDigest) -> Result<File, SessionError> {
    let mut opened = pass(root, file, |_| ())?;
    match opened.rewind() {
        Ok(()) => Ok(opened),
        Err(error) => Err(SessionError::io("read", &root.join(&file.path), error)),
    }
}

/// Hands out the file piece by piece, never more than its record says, and then itself,
/// read to its end.
fn pass(root: &Path, file: &FileDigest, mut take: impl FnMut(&[u8])) -> Result<File, SessionError> {
    let path = root.join(&file.path);
    let failed = |error: io::Error| match error.kind() {
        io::ErrorKind::NotFound | io::ErrorKind::NotADirectory => {
            SessionError::Missing { path: path.clone() }
        }
        _ => SessionError::io("read", &path, error),
    };
    let opened = open_regular(&path).map_err(failed)?;
    let actual_bytes = opened.metadata().map_err(failed)?.len();
    let length = |actual_bytes| SessionError::Length {
        path: path.clone(),
        expected_bytes: file.bytes,
        actual_bytes,
    };
    if actual_bytes != file.bytes {
        return Err(length(actual_bytes));
    }
    let mut opened = opened.take(file.bytes.saturating_add(1));
    let (mut hash, mut piece, mut passed) = (Sha256::new(), vec![0; 1 << 16], 0);
    loop {
        match opened.read(&mut piece).map_err(failed)? {
            0 => break,
            bytes => {
                hash.update(&piece[..bytes]);
                take(&piece[..bytes]);
                passed += bytes as u64;
            }
        }
    }
    // It was cut or has grown meanwhile.
    if passed != file.bytes {
        return Err(length(passed));
    }
    let actual = hex(&hash.finalize());
    if actual == file.sha256 {
        return Ok(opened.into_inner());
    }
    Err(SessionError::Checksum {
        path,
        expected: file.sha256.clone(),
        actual,
    })
}

/// The session's own files and folders that are links, each with where it leads, and a
/// `quarantine` that is no folder. A session holds its files itself: with a link in it a
/// copied folder may hold none of them, and a file moved through it leaves the session.
pub(super) fn misplaced(root: &Path, journal: &Journal) -> Vec<SessionError> {
    let mut found = Vec::new();
    for name in own_names(journal) {
        let path = root.join(&name);
        let Ok(there) = path.symlink_metadata() else {
            continue;
        };
        if there.is_symlink() {
            let target = std::fs::read_link(&path).unwrap_or_default();
            found.push(SessionError::Link { path, target });
        } else if name == Path::new(QUARANTINE_FOLDER) && !there.is_dir() {
            found.push(SessionError::malformed(&path, "it is not a folder"));
        }
    }
    found
}

/// Every journalled file with the folders on the way to it, and what each session has.
pub(super) fn own_names(journal: &Journal) -> BTreeSet<PathBuf> {
    let each = [
        JOURNAL_FILE,
        RAW_FOLDER,
        DERIVED_FOLDER,
        FITS_FOLDER,
        VALIDATIONS_FOLDER,
        QUARANTINE_FOLDER,
    ];
    let mut names: BTreeSet<PathBuf> = each.into_iter().map(PathBuf::from).collect();
    for file in journal.files() {
        let ways = Path::new(&file.path).ancestors();
        let ways = ways.filter(|way| !way.as_os_str().is_empty());
        names.extend(ways.map(Path::to_owned));
    }
    names
}
