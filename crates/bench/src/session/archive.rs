//! A session as one file for another machine: a plain tar archive (POSIX ustar), the same bytes
//! for the same session. Nothing is compressed: frames and images are already.
//!
//! The journal comes first. It names every other file with its length and SHA-256; these follow
//! in the order of their paths. So only one archive belongs to a journal, and [`check`] compares
//! with that one instead of interpreting what stands there: links, special files, absolute paths,
//! `..`, duplicates, sizes that are not those of the journal are not what comes next, and the
//! archive is refused before anything is written.

use std::collections::HashMap;
use std::fs::{File, OpenOptions};
use std::io::{self, BufReader, Read, Seek, Write};
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use super::journal::{FileDigest, Journal, LARGEST_JOURNAL_BYTES};
use super::layout::{
    CALIBRATION_FOLDER, DERIVED_FOLDER, JOB_LOCK_FILE, JOURNAL_FILE, LOCK_FILE, RAW_FOLDER,
};
use super::verify::{Verification, verify};
use super::{SessionError, journalled};
use crate::checksum::hex;
use crate::file_system;
use crate::outside_file::{open_regular, read_regular};
use crate::whole_file::{self, Part};

/// Bytes of a tar block: headers have one, files fill up their last.
const BLOCK: usize = 512;
/// Bytes that are copied at a time.
const PIECE: usize = 1 << 16;

/// A session could not be packed or unpacked.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum ArchiveError {
    /// The session, or what was unpacked, is damaged, or the folder is there already.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// The file is no archive of a session, or was changed.
    #[error("{} is no packed session: {why}", path.display())]
    Refused {
        path: PathBuf,
        /// What is not as a session's archive has it.
        why: String,
    },
    /// A file of the session has a name that an archive or another machine cannot take.
    #[error("{} cannot be packed: {why}", path.display())]
    Unpackable { path: PathBuf, why: String },
    #[error("{} is inside the session, which would then hold what its journal does not know", path.display())]
    Inside { path: PathBuf },
    /// The system refuses.
    #[error("{}: {source}", path.display())]
    Io { path: PathBuf, source: io::Error },
}

/// Writes the session in `root` to the file `out`, in place of any of that name. What was found
/// in the session; its strays are left out.
///
/// # Errors
/// See [`ArchiveError`]; a damaged session is not packed.
pub fn pack(root: &Path, out: &Path) -> Result<Verification, ArchiveError> {
    let io_error = |source| ArchiveError::Io {
        path: out.to_owned(),
        source,
    };
    let mut found = verify(root)?;
    if let Some(problem) = found.problems.drain(..).next() {
        return Err(problem.into());
    }
    let folder = out.parent().filter(|folder| !folder.as_os_str().is_empty());
    let folder = folder.unwrap_or(Path::new(".")).canonicalize();
    let root_is = root.canonicalize().map_err(io_error)?;
    if folder.map_err(io_error)?.starts_with(root_is) {
        let path = out.to_owned();
        return Err(ArchiveError::Inside { path });
    }
    // A line that is written meanwhile, or torn, does not count.
    let path = root.join(JOURNAL_FILE);
    let mut bytes = read_regular(&path, LARGEST_JOURNAL_BYTES)
        .map_err(|source| SessionError::io("read", &path, source))?;
    let journal = Journal::parse(&bytes).map_err(|(line, why)| SessionError::CorruptJournal {
        path,
        line,
        why,
    })?;
    bytes.truncate(journal.whole_bytes as usize);
    let unpackable = |why| ArchiveError::Unpackable {
        path: root.to_owned(),
        why,
    };
    let files = files_of(&journal).map_err(unpackable)?;
    let mut failed = None;
    let written = whole_file::replace(out, |archive| {
        put(archive, JOURNAL_FILE, bytes.len() as u64, &mut &*bytes)?;
        for file in &files {
            match journalled::open(root, file) {
                Ok(mut opened) => put(archive, &file.path, file.bytes, &mut opened)?,
                Err(error) => {
                    failed = Some(error);
                    return Err(io::ErrorKind::InvalidData.into());
                }
            }
        }
        archive.write_all(&[0; 2 * BLOCK])
    });
    match failed {
        Some(error) => Err(error.into()),
        None => written.map_err(io_error).map(|()| found),
    }
}

/// Compares every byte of an archive with its journal.
///
/// # Errors
/// [`ArchiveError::Refused`], [`ArchiveError::Io`].
pub fn check(archive: &Path) -> Result<Verification, ArchiveError> {
    let (file, bytes) = opened(archive)?;
    walk(BufReader::new(file), bytes, |_, _| Ok(())).map_err(|stop| stop.of(archive))
}

/// As [`check`], of an archive in memory; an error is what is wrong.
///
/// # Errors
/// What the archive has and should not.
pub fn check_bytes(archive: &[u8]) -> Result<Verification, String> {
    match walk(archive, archive.len() as u64, |_, _| Ok(())) {
        Ok(found) => Ok(found),
        Err(Stop::Refused(why)) => Err(why),
        Err(Stop::Io(error)) => Err(error.to_string()),
    }
}

/// Writes an archive's session to the new folder `out`, which appears whole, or not at all. The
/// archive is checked before anything is written, and the session before it gets its name.
pub fn unpack(archive: &Path, out: &Path) -> Result<Verification, ArchiveError> {
    let io_error = |source| ArchiveError::Io {
        path: out.to_owned(),
        source,
    };
    if out.symlink_metadata().is_ok() {
        let path = out.to_owned();
        return Err(SessionError::Exists { path }.into());
    }
    let (mut file, bytes) = opened(archive)?;
    let stopped = |stop: Stop| stop.of(archive);
    walk(BufReader::new(&file), bytes, |_, _| Ok(())).map_err(stopped)?;
    file.rewind().map_err(io_error)?;
    let part = Part::folder(out).map_err(io_error)?;
    let hidden = part.path();
    for folder in [RAW_FOLDER, CALIBRATION_FOLDER, DERIVED_FOLDER] {
        std::fs::create_dir(hidden.join(folder)).map_err(io_error)?;
    }
    let mut open: Option<(String, File)> = None;
    walk(BufReader::new(&file), bytes, |name, piece| {
        if open.as_ref().is_none_or(|(before, _)| before != name) {
            synced(hidden, open.take())?;
            let path = hidden.join(name);
            std::fs::create_dir_all(path.parent().unwrap_or(hidden))?;
            let new = OpenOptions::new().write(true).create_new(true).open(path)?;
            open = Some((name.to_owned(), new));
        }
        match &mut open {
            Some((_, file)) => file.write_all(piece),
            None => Ok(()),
        }
    })
    .map_err(|stop| match stop {
        Stop::Io(source) => io_error(source),
        refused => refused.of(archive),
    })?;
    synced(hidden, open.take()).map_err(io_error)?;
    let mut found = verify(hidden)?;
    if let Some(problem) = found.problems.drain(..).next() {
        return Err(ArchiveError::Refused {
            path: archive.to_owned(),
            why: problem.to_string(),
        });
    }
    part.renamed(|hidden| file_system::rename_new(hidden, out))
        .map_err(io_error)?;
    Ok(found)
}

fn synced(folder: &Path, file: Option<(String, File)>) -> io::Result<()> {
    match file {
        Some((name, file)) => file_system::sync_file(&file, &folder.join(name)),
        None => Ok(()),
    }
}

fn opened(archive: &Path) -> Result<(File, u64), ArchiveError> {
    let io_error = |source| ArchiveError::Io {
        path: archive.to_owned(),
        source,
    };
    let file = open_regular(archive).map_err(io_error)?;
    let bytes = file.metadata().map_err(io_error)?.len();
    Ok((file, bytes))
}

/// Why an archive was not read to its end.
enum Stop {
    Refused(String),
    Io(io::Error),
}

impl Stop {
    fn of(self, archive: &Path) -> ArchiveError {
        let path = archive.to_owned();
        match self {
            Self::Refused(why) => ArchiveError::Refused { path, why },
            Self::Io(source) => ArchiveError::Io { path, source },
        }
    }
}

impl From<io::Error> for Stop {
    fn from(error: io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::UnexpectedEof => Self::Refused("it ends too early".to_owned()),
            _ => Self::Io(error),
        }
    }
}

/// Reads an archive of so many bytes from its begin to its end, compares it with the one that
/// its journal describes, and hands out the files' bytes: name, piece.
fn walk(
    mut archive: impl Read,
    bytes: u64,
    mut take: impl FnMut(&str, &[u8]) -> io::Result<()>,
) -> Result<Verification, Stop> {
    let refused = |why: String| Err(Stop::Refused(why));
    // The journal, which says what else there is.
    let mut first = [0; BLOCK];
    archive.read_exact(&mut first)?;
    let size = octal(&first[SIZE]).filter(|&size| size <= bytes.min(LARGEST_JOURNAL_BYTES));
    let Some(size) = size.filter(|&size| header(JOURNAL_FILE, size).is_ok_and(|h| h == first))
    else {
        return refused(format!("it does not begin with {JOURNAL_FILE}"));
    };
    let mut text = vec![0; size as usize];
    archive.read_exact(&mut text)?;
    padding(&mut archive, size)?;
    let journal = Journal::parse(&text)
        .map_err(|(line, why)| Stop::Refused(format!("{JOURNAL_FILE}, line {line}: {why}")))?;
    if journal.torn_bytes > 0 || journal.records.is_empty() {
        return refused(format!("{JOURNAL_FILE} does not end with a record"));
    }
    let files = files_of(&journal).map_err(Stop::Refused)?;
    // Before gigabytes are read.
    let lengths = files.iter().map(|file| file.bytes).chain([size]);
    let whole = lengths
        .map(|bytes| {
            bytes
                .checked_next_multiple_of(BLOCK as u64)?
                .checked_add(BLOCK as u64)
        })
        .try_fold(2 * BLOCK as u64, |sum, bytes| sum.checked_add(bytes?));
    if whole != Some(bytes) {
        return refused(format!("it has {bytes} bytes, not those of its journal"));
    }
    take(JOURNAL_FILE, &text)?;
    // The files.
    let mut piece = vec![0; PIECE];
    for file in &files {
        let mut block = [0; BLOCK];
        archive.read_exact(&mut block)?;
        if header(&file.path, file.bytes).as_ref() != Ok(&block) {
            return refused(format!(
                "{}, which its journal names next, does not follow",
                file.path
            ));
        }
        take(&file.path, &[])?;
        let (mut hash, mut rest) = (Sha256::new(), file.bytes);
        while rest > 0 {
            let part = &mut piece[..rest.min(PIECE as u64) as usize];
            archive.read_exact(part)?;
            hash.update(&*part);
            take(&file.path, part)?;
            rest -= part.len() as u64;
        }
        if hex(&hash.finalize()) != file.sha256 {
            return refused(format!("{} has not the SHA-256 of its journal", file.path));
        }
        padding(&mut archive, file.bytes)?;
    }
    let mut end = [0; 2 * BLOCK];
    archive.read_exact(&mut end)?;
    if end.iter().any(|&byte| byte != 0) || archive.read(&mut [0])? > 0 {
        return refused("something follows its files".to_owned());
    }
    Ok(Verification {
        complete: journal.is_complete(),
        good_files: files.len(),
        good_bytes: files.iter().map(|file| file.bytes).sum(),
        problems: Vec::new(),
        strays: Vec::new(),
        torn_bytes: 0,
        suspicion: journal.suspicion(),
        clock_step: journal.clock_step(),
    })
}

/// The zeros after a file of so many bytes.
fn padding(archive: &mut impl Read, bytes: u64) -> Result<(), Stop> {
    let mut block = [0; BLOCK];
    let zeros = &mut block[..(bytes.next_multiple_of(BLOCK as u64) - bytes) as usize];
    archive.read_exact(zeros)?;
    match zeros.iter().all(|&byte| byte == 0) {
        true => Ok(()),
        false => Err(Stop::Refused(
            "something stands between its files".to_owned(),
        )),
    }
}

fn put(
    out: &mut dyn whole_file::Out,
    name: &str,
    bytes: u64,
    from: &mut dyn Read,
) -> io::Result<()> {
    out.write_all(&header(name, bytes).map_err(io::Error::other)?)?;
    // Not a byte more than the header says, whoever writes meanwhile.
    if io::copy(&mut from.take(bytes), out)? < bytes {
        return Err(io::ErrorKind::UnexpectedEof.into());
    }
    let rest = bytes.next_multiple_of(BLOCK as u64) - bytes;
    out.write_all(&[0; BLOCK][..rest as usize])
}

/// What a journal names, sorted by path.
///
/// # Errors
/// A name that could lead elsewhere, or be another file's on another machine.
fn files_of(journal: &Journal) -> Result<Vec<FileDigest>, String> {
    let mut files: Vec<FileDigest> = journal.files().into_iter().cloned().collect();
    files.sort_by(|a, b| a.path.cmp(&b.path));
    // Names as a file system without case has them: as they are written, and whether a folder.
    let mut known: HashMap<String, (&str, bool)> = HashMap::new();
    for own in [JOURNAL_FILE, LOCK_FILE, JOB_LOCK_FILE] {
        known.insert(own.to_owned(), (own, false));
    }
    for file in &files {
        let path = file.path.as_str();
        let is_plain = |name: &str| !matches!(name, "" | "." | "..");
        if !path.split('/').all(is_plain)
            || path.contains(['\\', ':'])
            || path.contains(char::is_control)
        {
            return Err(format!("{path:?} is not a path of plain names"));
        }
        header(path, file.bytes)?;
        let folders = path.match_indices('/').map(|(at, _)| (&path[..at], true));
        for (name, is_folder) in folders.chain([(path, false)]) {
            let before = known.insert(name.to_lowercase(), (name, is_folder));
            match before {
                None => (),
                Some((same, true)) if is_folder && same == name => (),
                Some((other, _)) => {
                    return Err(format!("{other:?} and {name:?} cannot both be there"));
                }
            }
        }
    }
    Ok(files)
}

/// Where a header has the length of its file.
const SIZE: std::ops::Range<usize> = 124..136;
/// Where it has the sum of its bytes.
const SUM: std::ops::Range<usize> = 148..156;

/// The ustar header of a file: readable by all, of nobody, of no time.
///
/// # Errors
/// A path or a length that it has no room for.
fn header(path: &str, bytes: u64) -> Result<[u8; BLOCK], String> {
    // The path whole, or cut at a slash.
    let cuts = path
        .match_indices('/')
        .map(|(at, _)| (&path[..at], &path[at + 1..]));
    let mut cuts = [("", path)].into_iter().chain(cuts);
    let (folder, name) = cuts
        .find(|(folder, name)| folder.len() <= 155 && name.len() <= 100)
        .ok_or_else(|| format!("{path:?} is too long for an archive"))?;
    if bytes >= 1 << 33 {
        return Err(format!("{path:?} has {bytes} bytes, 8 GiB or more"));
    }
    let mut header = [0; BLOCK];
    let mut set = |at: usize, text: &[u8]| header[at..at + text.len()].copy_from_slice(text);
    set(0, name.as_bytes());
    set(100, b"0000644\0");
    set(108, b"0000000\0");
    set(116, b"0000000\0");
    set(SIZE.start, format!("{bytes:011o}\0").as_bytes());
    set(136, b"00000000000\0");
    set(SUM.start, b"        ");
    set(156, b"0");
    set(257, b"ustar\x0000");
    set(345, folder.as_bytes());
    let sum: u32 = header.iter().map(|&byte| u32::from(byte)).sum();
    header[SUM].copy_from_slice(format!("{sum:06o}\0 ").as_bytes());
    Ok(header)
}

/// The number of a header's field.
fn octal(field: &[u8]) -> Option<u64> {
    let digits = str::from_utf8(field.strip_suffix(b"\0")?).ok()?;
    u64::from_str_radix(digits, 8).ok()
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::sync::Arc;

    use super::*;
    use crate::session::faults::UnsyncedDisk;
    use crate::session::{NewSession, SessionWriter, example};

    fn session(parent: &Path) -> PathBuf {
        let new = NewSession {
            parent,
            created: jiff::Timestamp::UNIX_EPOCH,
            short_id: "0f3a9c",
            record: &example::record(),
            calibration: &[("sensor.toml".into(), vec![b'x'; 700])],
        };
        let mut writer = SessionWriter::create(Arc::new(UnsyncedDisk), &new).unwrap();
        writer.commit_file("fits/0/fit.toml", b"a fit").unwrap();
        layout_of(parent)
    }

    fn layout_of(parent: &Path) -> PathBuf {
        let mut entries = fs::read_dir(parent).unwrap().flatten();
        entries.find(|entry| entry.path().is_dir()).unwrap().path()
    }

    #[test]
    fn a_session_comes_back_and_its_archive_is_the_same_for_the_same_content() {
        let folder = tempfile::tempdir().unwrap();
        let parent = folder.path().join("sessions");
        fs::create_dir(&parent).unwrap();
        let root = session(&parent);
        fs::write(root.join("note.txt"), "not of the journal").unwrap();
        let (one, two) = (folder.path().join("1.tar"), folder.path().join("2.tar"));
        let packed = pack(&root, &one).unwrap();
        assert_eq!(packed.strays, [Path::new("note.txt")]);
        let out = folder.path().join("out");
        let found = unpack(&one, &out).unwrap();
        assert_eq!(
            (found.good_files, found.complete),
            (packed.good_files, false)
        );
        assert!(found.is_intact() && verify(&out).unwrap().is_intact());
        pack(&out, &two).unwrap();
        assert_eq!(fs::read(&one).unwrap(), fs::read(&two).unwrap());
        let again = unpack(&one, &out);
        assert!(matches!(
            again,
            Err(ArchiveError::Session(SessionError::Exists { .. }))
        ));
        let inside = pack(&out, &out.join("raw/x.tar"));
        assert!(matches!(inside, Err(ArchiveError::Inside { .. })));
    }

    /// Every byte counts: none can be changed, added or taken away.
    #[test]
    fn whatever_differs_is_refused_and_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let parent = folder.path().join("sessions");
        fs::create_dir(&parent).unwrap();
        let (archive, out) = (folder.path().join("a.tar"), folder.path().join("out"));
        pack(&session(&parent), &archive).unwrap();
        let good = fs::read(&archive).unwrap();
        for at in 0..good.len() {
            let mut bad = good.clone();
            bad[at] ^= 0x21;
            assert!(check_bytes(&bad).is_err(), "byte {at}");
        }
        for length in (0..good.len()).step_by(97) {
            assert!(check_bytes(&good[..length]).is_err(), "{length} bytes");
        }
        assert!(check_bytes(&[&good[..], &[0; 512]].concat()).is_err());
        let mut bad = good.clone();
        let at = good.windows(5).position(|bytes| bytes == b"a fit").unwrap();
        bad[at] = b'A';
        fs::write(&archive, bad).unwrap();
        let refused = unpack(&archive, &out).unwrap_err().to_string();
        assert!(
            refused.contains("fits/0/fit.toml has not the SHA-256"),
            "{refused}"
        );
        let mut names: Vec<_> = fs::read_dir(folder.path()).unwrap().flatten().collect();
        names.retain(|entry| entry.path() != archive && entry.path() != parent);
        assert!(names.is_empty(), "{names:?}");
    }

    /// Journals whose names lead elsewhere, or to one file twice.
    #[test]
    fn names_are_refused_that_could_be_other_files() {
        use crate::session::journal::{Event, FORMAT, Record};
        let refusal = |paths: &[&str]| {
            let digest = |path: &str| FileDigest::of(path, b"");
            let start = Event::Start {
                format: FORMAT,
                session: digest("session.toml"),
            };
            let files = paths.iter().map(|path| Event::File { file: digest(path) });
            let records = [start].into_iter().chain(files).zip(0..);
            let records = records.map(|(event, number)| Record {
                number,
                utc: String::new(),
                event,
            });
            let journal = Journal {
                records: records.collect(),
                ..Journal::default()
            };
            files_of(&journal).err()
        };
        let long = "n".repeat(101);
        for paths in [
            &["/etc/passwd"][..],
            &["../a"],
            &["a/../../b"],
            &["a//b"],
            &["a/./b"],
            &["a\\b"],
            &["C:b"],
            &["a\nb"],
            &["raw/a", "RAW/b"],
            &["fits/a", "fits/A"],
            &["a", "a/b"],
            &["a/b", "a"],
            &["Journal.jsonl"],
            &[".lock"],
            &[&long],
        ] {
            assert!(refusal(paths).is_some(), "{paths:?}");
        }
        let folder = "f".repeat(120);
        let fine = format!("{folder}/{}", "n".repeat(100));
        assert_eq!(refusal(&["raw/a", "raw/b", "schüssel.ply", &fine]), None);
    }
}
