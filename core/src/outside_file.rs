//! Reading files that others have put there: never waiting, never without bound.
//!
//! A path that someone names may lead to a named pipe, whose opening waits for a
//! writer, or to a device, which never ends and says that its length is 0.

use std::fs::{File, FileType, Metadata, OpenOptions};
use std::io::{self, Read};
#[cfg(unix)]
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
#[cfg(windows)]
use std::os::windows::fs::OpenOptionsExt;
use std::path::Path;

use crate::outside_text;

/// Whether the file's name ends in this, which has no dot, in capitals or not.
pub fn ends_in(path: &Path, ending: &str) -> bool {
    let found = path.extension();
    found.is_some_and(|found| found.eq_ignore_ascii_case(ending))
}

/// Opens a regular file, or a link to one, for reading, and never waits.
///
/// # Errors
/// What stands there is a folder, named pipe, socket or device, which is not
/// opened; or the system refuses. Messages don't name the path.
pub fn open_regular(path: &Path) -> io::Result<File> {
    // Before the opening, which alone makes some devices act.
    check(&std::fs::metadata(path)?)?;
    let file = never_waiting(OpenOptions::new().read(true), true).open(path)?;
    // Again, because another may stand there by now.
    check(&file.metadata()?)?;
    Ok(file)
}

/// Opens a regular file, or makes one, for reading from its beginning and appending at its
/// end: a journal. Never waits, and follows no link.
///
/// # Errors
/// As [`open_regular`]; a link stands there.
pub fn append_regular(path: &Path) -> io::Result<File> {
    match std::fs::symlink_metadata(path) {
        Ok(there) => check(&there)?,
        Err(error) if error.kind() == io::ErrorKind::NotFound => {}
        Err(error) => return Err(error),
    }
    let mut options = OpenOptions::new();
    options.create(true).read(true).append(true);
    let file = never_waiting(&mut options, false).open(path)?;
    check(&file.metadata()?)?;
    Ok(file)
}

/// These options, by which the opening of what stands there never waits and, unless
/// `follows_links`, what a link leads to is not opened.
pub fn never_waiting(options: &mut OpenOptions, follows_links: bool) -> &mut OpenOptions {
    #[cfg(unix)]
    let flags = {
        use rustix::fs::OFlags;
        let never_wait = OFlags::NONBLOCK | OFlags::NOCTTY;
        let links = match follows_links {
            true => OFlags::empty(),
            false => OFlags::NOFOLLOW,
        };
        (never_wait | links).bits().cast_signed()
    };
    // Opens the link itself, which is no regular file.
    #[cfg(windows)]
    let flags = if follows_links { 0 } else { 0x0020_0000 };
    options.custom_flags(flags)
}

/// The bytes of a regular file of at most `max_bytes`, whatever length the
/// system says that it has.
///
/// # Errors
/// As [`open_regular`]; the file is larger ([`io::ErrorKind::FileTooLarge`]).
pub fn read_regular(path: &Path, max_bytes: u64) -> io::Result<Vec<u8>> {
    read_opened(&open_regular(path)?, max_bytes)
}

/// What follows in an open file, at most `max_bytes`.
///
/// # Errors
/// The file is larger ([`io::ErrorKind::FileTooLarge`]), or the system refuses.
pub fn read_opened(file: &File, max_bytes: u64) -> io::Result<Vec<u8>> {
    let length = file.metadata()?.len();
    if length > max_bytes {
        return Err(too_large(&format!("it has {length} bytes"), max_bytes));
    }
    let mut bytes = Vec::with_capacity(length as usize);
    file.take(max_bytes.saturating_add(1))
        .read_to_end(&mut bytes)?;
    if bytes.len() as u64 > max_bytes {
        return Err(too_large("it does not end there", max_bytes));
    }
    Ok(bytes)
}

/// The text of a regular file of at most `max_bytes`, by [`outside_text::decode`].
///
/// # Errors
/// As [`read_regular`]; the bytes are no Unicode text ([`io::ErrorKind::InvalidData`]).
pub fn read_text(path: &Path, max_bytes: u64) -> io::Result<String> {
    let bytes = read_regular(path, max_bytes)?;
    outside_text::decode(bytes).map_err(|error| io::Error::new(io::ErrorKind::InvalidData, error))
}

fn too_large(fact: &str, max_bytes: u64) -> io::Error {
    let text = format!("{fact}, but at most {max_bytes} bytes are read");
    io::Error::new(io::ErrorKind::FileTooLarge, text)
}

fn check(found: &Metadata) -> io::Result<()> {
    if found.is_file() {
        return Ok(());
    }
    if found.is_dir() {
        #[cfg(unix)]
        return Err(rustix::io::Errno::ISDIR.into());
        #[cfg(windows)]
        return Err(io::ErrorKind::IsADirectory.into());
    }
    let text = format!("it is {}, not a regular file", kind(found.file_type()));
    Err(io::Error::new(io::ErrorKind::InvalidInput, text))
}

/// In words, with its article.
pub fn kind(found: FileType) -> &'static str {
    match found {
        _ if found.is_file() => "a regular file",
        _ if found.is_dir() => "a folder",
        _ if found.is_symlink() => "a link",
        #[cfg(unix)]
        _ if found.is_fifo() => "a named pipe",
        #[cfg(unix)]
        _ if found.is_socket() => "a socket",
        #[cfg(unix)]
        _ if found.is_char_device() || found.is_block_device() => "a device",
        _ => "of an unknown kind",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::ErrorKind;
    use std::os::unix::net::UnixListener;

    #[test]
    fn a_regular_file_is_read_up_to_its_bound() {
        let folder = tempfile::tempdir().unwrap();
        let (file, link) = (folder.path().join("a"), folder.path().join("link"));
        std::fs::write(&file, "twelve bytes").unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        assert_eq!(read_regular(&link, 12).unwrap(), b"twelve bytes");
        let error = read_regular(&file, 11).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::FileTooLarge);
        assert!(error.to_string().contains("12 bytes") && error.to_string().contains("11 bytes"));
        std::fs::write(&file, b"\xff").unwrap();
        assert_eq!(
            read_text(&file, 12).unwrap_err().kind(),
            ErrorKind::InvalidData
        );
    }

    /// Files of /proc say that their length is 0.
    #[test]
    fn the_bytes_count_not_the_stated_length() {
        let path = Path::new("/proc/self/stat");
        assert_eq!(std::fs::metadata(path).unwrap().len(), 0);
        assert!(read_regular(path, 1 << 20).unwrap().len() > 10);
        assert_eq!(
            read_regular(path, 10).unwrap_err().kind(),
            ErrorKind::FileTooLarge
        );
    }

    #[test]
    fn what_is_no_regular_file_is_named_and_never_waited_for() {
        let folder = tempfile::tempdir().unwrap();
        let (pipe, socket) = (folder.path().join("pipe"), folder.path().join("socket"));
        let mode = rustix::fs::Mode::from_raw_mode(0o600);
        rustix::fs::mknodat(rustix::fs::CWD, &pipe, rustix::fs::FileType::Fifo, mode, 0).unwrap();
        let _listener = UnixListener::bind(&socket).unwrap();
        for (path, words) in [
            (pipe.as_path(), "a named pipe"),
            (socket.as_path(), "a socket"),
            (Path::new("/dev/zero"), "a device"),
            (folder.path(), "directory"),
        ] {
            for error in [read_regular(path, 100).err(), append_regular(path).err()] {
                let error = error.unwrap().to_string();
                assert!(error.contains(words), "{error}");
            }
        }
    }
}
