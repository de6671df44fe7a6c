//! What file systems do differently: waiting for the medium, locks, renaming.
//!
//! Local file systems do all of it. Network and foreign ones (NFS, SMB, sshfs, folders
//! shared with a virtual machine, FAT) lack one or the other. What can be done in another
//! way is; what cannot is done without, and said once.

use std::fmt;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::thread;
use std::time::{Duration, Instant};

#[cfg(unix)]
use rustix::fs::{CWD, RenameFlags, StatVfs, renameat_with, statvfs};
use rustix::io::Errno;

/// How long a lock that is held is asked for again. A program that is being started holds
/// copies of the locks of the one that starts it, for a moment.
const LOCK_PATIENCE: Duration = Duration::from_millis(200);

/// End of the names under which is written what gets another name when it is whole
/// ([`crate::whole_file`]).
pub const PART: &str = ".rig-part";

/// What a file system cannot do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lack {
    /// It does not wait until a file or the name of a file is on the medium.
    Sync,
    /// It has no locks.
    Locks,
    /// It does not rename over a file that exists.
    Replace,
}

/// What it means, as the end of a sentence.
impl fmt::Display for Lack {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::Sync => {
                "does not confirm that files and their names are on the medium: \
                 a power cut may cost the newest ones"
            }
            Self::Locks => "has no locks: nothing keeps a second rig from writing the same folder",
            Self::Replace => {
                "does not rename over an existing file, so files are replaced in two steps: \
                 a power cut between them leaves the old one as .NAME.old"
            }
        })
    }
}

/// Errors by which file systems refuse an operation that they lack: SMB and vboxsf EINVAL, FUSE
/// ENOSYS or ENOTSUP, some EBADF.
#[cfg(unix)]
const NOT_OFFERED: [Errno; 5] = [
    Errno::INVAL,
    Errno::NOTSUP,
    Errno::OPNOTSUPP,
    Errno::NOSYS,
    Errno::BADF,
];
/// In addition where a folder is to be opened or synchronised.
#[cfg(unix)]
const NO_FOLDER_SYNC: [Errno; 3] = [Errno::ACCESS, Errno::PERM, Errno::ISDIR];
/// In addition where a file is to be locked: NFS without its lock service.
#[cfg(unix)]
const NO_LOCKS: [Errno; 1] = [Errno::NOLCK];
/// So answers one that cannot rename over an existing file.
#[cfg(unix)]
const NOT_OVER_EXISTING: [Errno; 6] = [
    Errno::EXIST,
    Errno::PERM,
    Errno::ACCESS,
    Errno::BUSY,
    Errno::NOTSUP,
    Errno::INVAL,
];

/// The same on Windows: no such function, not supported; access denied; file or name exists.
#[cfg(windows)]
const NOT_OFFERED: [Errno; 2] = [Errno::from_raw_os_error(1), Errno::from_raw_os_error(50)];
#[cfg(windows)]
const NO_FOLDER_SYNC: [Errno; 1] = [Errno::from_raw_os_error(5)];
#[cfg(windows)]
const NO_LOCKS: [Errno; 0] = [];
#[cfg(windows)]
const NOT_OVER_EXISTING: [Errno; 2] = [Errno::from_raw_os_error(80), Errno::from_raw_os_error(183)];

fn is_one_of(error: &io::Error, errnos: &[Errno]) -> bool {
    Errno::from_io_error(error).is_some_and(|errno| errnos.contains(&errno))
}

/// Waits until a file's bytes are on the medium, as far as the file system says.
///
/// # Errors
/// The system's error about the medium (input or output, no space left).
pub fn sync_file(file: &File, path: &Path) -> io::Result<()> {
    said(sync(file, &[])?, path);
    Ok(())
}

/// Waits until the names in a folder are on the medium, as far as the file system says.
///
/// # Errors
/// As [`sync_file`], or there is no such folder.
pub fn sync_folder(folder: &Path) -> io::Result<()> {
    said(folder_sync(folder)?, folder);
    Ok(())
}

fn sync(file: &File, more: &[Errno]) -> io::Result<Option<Lack>> {
    match call::sync(file) {
        Err(error) if is_one_of(&error, &NOT_OFFERED) || is_one_of(&error, more) => {
            Ok(Some(Lack::Sync))
        }
        other => other.map(|()| None),
    }
}

/// Opens a folder, to be locked or synchronised.
pub(crate) fn open_folder(folder: &Path) -> io::Result<File> {
    #[cfg(unix)]
    return File::open(folder);
    #[cfg(windows)]
    {
        use std::os::windows::fs::OpenOptionsExt;
        // FILE_FLAG_BACKUP_SEMANTICS, without which no folder is opened.
        let mut options = OpenOptions::new();
        options.read(true).custom_flags(0x0200_0000).open(folder)
    }
}

fn folder_sync(folder: &Path) -> io::Result<Option<Lack>> {
    match open_folder(folder) {
        Ok(open) => sync(&open, &NO_FOLDER_SYNC),
        Err(error) if is_one_of(&error, &NO_FOLDER_SYNC) => Ok(Some(Lack::Sync)),
        Err(error) => Err(error),
    }
}

/// Locks a file for this process alone, as long as it is open. It must be open for
/// writing, because NFS locks no other, and other handles should neither read nor write
/// it: SMB keeps them from it.
///
/// # Errors
/// Another process holds it and does not let go at once, or what the system says.
pub fn lock(file: &File, path: &Path) -> Result<(), TryLockError> {
    said(file_lock(file)?, path);
    Ok(())
}

/// Locks a file together with others that do the same, and keeps away who would [`lock`] it.
///
/// # Errors
/// As [`lock`].
pub fn lock_shared(file: &File, path: &Path) -> Result<(), TryLockError> {
    said(file_lock_by(|| call::lock_shared(file))?, path);
    Ok(())
}

fn file_lock(file: &File) -> Result<Option<Lack>, TryLockError> {
    file_lock_by(|| call::lock(file))
}

fn file_lock_by(call: impl Fn() -> Result<(), TryLockError>) -> Result<Option<Lack>, TryLockError> {
    let end = Instant::now() + LOCK_PATIENCE;
    loop {
        match call() {
            Err(TryLockError::WouldBlock) if Instant::now() < end => {
                thread::sleep(Duration::from_millis(5));
            }
            Err(TryLockError::Error(e)) if e.kind() == io::ErrorKind::Interrupted => {}
            Err(TryLockError::Error(e))
                if is_one_of(&e, &NOT_OFFERED) || is_one_of(&e, &NO_LOCKS) =>
            {
                return Ok(Some(Lack::Locks));
            }
            other => return other.map(|()| None),
        }
    }
}

/// Gives a file its new name, also where a file has that already; a folder, where nothing
/// or an empty folder has it.
///
/// # Errors
/// The system's error; the former file is there again.
pub fn rename(from: &Path, to: &Path) -> io::Result<()> {
    said(file_rename(from, to)?, to);
    Ok(())
}

fn file_rename(from: &Path, to: &Path) -> io::Result<Option<Lack>> {
    let error = match call::rename(from, to) {
        Ok(()) => return Ok(None),
        Err(error) => error,
    };
    let is_over_file = to.symlink_metadata().is_ok_and(|there| there.is_file());
    if !is_over_file || !is_one_of(&error, &NOT_OVER_EXISTING) {
        return Err(error);
    }
    let mut aside = std::ffi::OsString::from(".");
    aside.push(to.file_name().unwrap_or_default());
    aside.push(".old");
    let aside = to.with_file_name(aside);
    drop(std::fs::remove_file(&aside));
    if call::rename(to, &aside).is_err() {
        return Err(error);
    }
    if let Err(error) = call::rename(from, to) {
        call::rename(&aside, to)?;
        return Err(error);
    }
    // One that stays does no harm.
    drop(std::fs::remove_file(&aside));
    Ok(Some(Lack::Replace))
}

/// Gives a file a name that nothing has yet.
///
/// # Errors
/// [`io::ErrorKind::AlreadyExists`], or what the system says.
pub fn rename_new(from: &Path, to: &Path) -> io::Result<()> {
    match call::rename_new(from, to) {
        Err(error) if is_one_of(&error, &NOT_OFFERED) => {}
        other => return other,
    }
    // The name is taken first, with an empty file.
    OpenOptions::new().write(true).create_new(true).open(to)?;
    let renamed = rename(from, to);
    if renamed.is_err() {
        drop(std::fs::remove_file(to));
    }
    renamed
}

/// Bytes that this process may still write where this folder is; the largest number where
/// the file system does not say how large it is.
#[cfg(unix)]
pub fn free_bytes(folder: &Path) -> io::Result<u64> {
    let StatVfs {
        f_blocks,
        f_bavail,
        f_frsize,
        ..
    } = statvfs(folder)?;
    Ok(match f_blocks {
        0 => u64::MAX,
        _ => f_bavail.saturating_mul(f_frsize),
    })
}

/// Files that may still be made where this folder is; none where the file system does not say,
/// or makes room for them as it does for bytes.
#[cfg(unix)]
pub fn free_files(folder: &Path) -> io::Result<Option<u64>> {
    let StatVfs {
        f_files, f_favail, ..
    } = statvfs(folder)?;
    Ok((f_files > 0).then_some(f_favail))
}

/// Nobody is asked there.
#[cfg(windows)]
#[allow(missing_docs)]
pub fn free_bytes(_: &Path) -> io::Result<u64> {
    Ok(u64::MAX)
}

#[cfg(windows)]
#[allow(missing_docs)]
pub fn free_files(_: &Path) -> io::Result<Option<u64>> {
    Ok(None)
}

/// Whether no file can be made where this is or shall be, although there may be room for bytes.
pub fn has_no_more_files(path: &Path) -> bool {
    let absolute = std::path::absolute(path).unwrap_or_default();
    let existing = absolute.ancestors().find(|path| path.is_dir());
    existing.is_some_and(|folder| free_files(folder).is_ok_and(|free| free == Some(0)))
}

/// Tries in a folder all that a session needs of its file system: writes a file, locks and
/// synchronises it, synchronises the folder, renames the file and replaces it. What is
/// lacking; nothing stays behind.
///
/// # Errors
/// The system's error where something fails that nothing can replace.
pub fn probe(folder: &Path) -> io::Result<Vec<Lack>> {
    let scratch = |name: &str| -> io::Result<(File, tempfile::TempPath)> {
        let file = tempfile::Builder::new()
            .prefix(".rig-probe-")
            .suffix(&format!("{name}{PART}"))
            .tempfile_in(folder)?;
        let (mut file, path) = file.into_parts();
        // Else another program might take it for what a killed one has left.
        let _ = file.try_lock();
        file.write_all(b"rig")?;
        Ok((file, path))
    };
    let (first, first_path) = scratch(".first")?;
    let (second, second_path) = scratch(".second")?;
    let locks = file_lock(&first)?;
    let mut syncs = sync(&first, &[])?;
    // Some rename no file that is open.
    drop((first, second));
    let replaces = file_rename(&second_path, &first_path)?;
    syncs = syncs.or(folder_sync(folder)?);
    Ok([locks, syncs, replaces].into_iter().flatten().collect())
}

/// Says once for each lack that the file system of this file or folder has it.
fn said(lack: Option<Lack>, path: &Path) {
    static SAID: Mutex<Vec<Lack>> = Mutex::new(Vec::new());
    let Some(lack) = lack else {
        return;
    };
    let mut said = SAID
        .lock()
        .unwrap_or_else(std::sync::PoisonError::into_inner);
    if !said.contains(&lack) {
        said.push(lack);
        let folder = if path.is_dir() {
            Some(path)
        } else {
            path.parent()
        };
        // What has a hidden name is not named: it is temporary.
        let is_hidden = |folder: &Path| {
            let name = folder.file_name().unwrap_or_default();
            name.as_encoded_bytes().starts_with(b".")
        };
        let folder = folder.map(|folder| match is_hidden(folder) {
            true => folder.parent().unwrap_or(folder),
            false => folder,
        });
        let folder = folder.filter(|folder| !folder.as_os_str().is_empty());
        let folder: PathBuf = folder.unwrap_or(Path::new(".")).into();
        log::warn!("the file system of {} {lack}", folder.display());
    }
}

/// The system's calls themselves.
mod call {
    use super::*;

    pub fn sync(file: &File) -> io::Result<()> {
        injected(Call::Sync)?;
        file.sync_all()
    }

    pub fn lock(file: &File) -> Result<(), TryLockError> {
        injected(Call::Lock).map_err(TryLockError::Error)?;
        file.try_lock()
    }

    pub fn lock_shared(file: &File) -> Result<(), TryLockError> {
        injected(Call::Lock).map_err(TryLockError::Error)?;
        file.try_lock_shared()
    }

    pub fn rename(from: &Path, to: &Path) -> io::Result<()> {
        injected(Call::Rename)?;
        if to.exists() {
            injected(Call::RenameOver)?;
        }
        std::fs::rename(from, to)
    }

    pub fn rename_new(from: &Path, to: &Path) -> io::Result<()> {
        injected(Call::RenameNew)?;
        #[cfg(unix)]
        return Ok(renameat_with(CWD, from, CWD, to, RenameFlags::NOREPLACE)?);
        #[cfg(windows)]
        {
            let _ = (from, to);
            Err(NOT_OFFERED[0].into())
        }
    }

    /// For tests of other file systems than the one they run on.
    #[allow(missing_docs)]
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum Call {
        Sync,
        Lock,
        Rename,
        RenameOver,
        RenameNew,
    }

    #[cfg(not(test))]
    fn injected(_: Call) -> io::Result<()> {
        Ok(())
    }

    #[cfg(test)]
    fn injected(call: Call) -> io::Result<()> {
        super::faults::of(call)
    }
}

/// Calls that fail in this thread, for tests of this and other modules.
#[cfg(test)]
pub mod faults {
    pub use super::call::Call;
    use rustix::io::Errno;
    use std::cell::RefCell;

    thread_local! {
        static FAULTS: RefCell<Vec<(Call, Errno)>> = const { RefCell::new(Vec::new()) };
    }

    pub(super) fn of(call: Call) -> std::io::Result<()> {
        FAULTS.with_borrow(|faults| {
            let fault = faults.iter().find(|(failing, _)| *failing == call);
            fault.map_or(Ok(()), |(_, errno)| Err((*errno).into()))
        })
    }

    /// Runs `act` on a file system on which these calls fail so.
    pub fn with<T>(faults: &[(Call, Errno)], act: impl FnOnce() -> T) -> T {
        FAULTS.set(faults.to_vec());
        let result = act();
        FAULTS.set(Vec::new());
        result
    }
}

#[cfg(test)]
mod tests {
    use super::faults::{Call, with};
    use super::*;

    fn folder_with(files: &[&str]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for name in files {
            std::fs::write(folder.path().join(name), name).unwrap();
        }
        folder
    }

    fn names(folder: &Path) -> Vec<String> {
        let entries = std::fs::read_dir(folder).unwrap();
        let mut names: Vec<String> = entries
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn what_a_file_system_does_not_offer_is_done_without() {
        let folder = folder_with(&["a"]);
        let file = File::options()
            .write(true)
            .open(folder.path().join("a"))
            .unwrap();
        for errno in NOT_OFFERED {
            with(&[(Call::Sync, errno), (Call::Lock, errno)], || {
                assert_eq!(sync(&file, &[]).unwrap(), Some(Lack::Sync), "{errno}");
                assert_eq!(folder_sync(folder.path()).unwrap(), Some(Lack::Sync));
                assert_eq!(file_lock(&file).unwrap(), Some(Lack::Locks), "{errno}");
            });
        }
        with(&[(Call::Lock, Errno::NOLCK)], || lock(&file, folder.path())).unwrap();
        with(&[(Call::Sync, Errno::ACCESS)], || {
            sync_folder(folder.path())
        })
        .unwrap();
    }

    /// A medium that fails is no peculiarity.
    #[test]
    fn an_error_of_the_medium_stays_one() {
        let folder = folder_with(&["a", "b"]);
        let [a, b] = ["a", "b"].map(|name| folder.path().join(name));
        let file = File::options().write(true).open(&a).unwrap();
        for errno in [Errno::IO, Errno::NOSPC, Errno::DQUOT, Errno::ROFS] {
            with(
                &[
                    (Call::Sync, errno),
                    (Call::Lock, errno),
                    (Call::Rename, errno),
                ],
                || {
                    assert!(sync_file(&file, &a).is_err() && sync_folder(folder.path()).is_err());
                    assert!(matches!(lock(&file, &a), Err(TryLockError::Error(_))));
                    assert!(rename(&a, &b).is_err() && rename_new(&a, &b).is_err());
                },
            );
        }
        assert!(with(&[(Call::Sync, Errno::ACCESS)], || sync_file(&file, &a)).is_err());
        assert!(sync_folder(&folder.path().join("none")).is_err());
        assert_eq!(std::fs::read(&b).unwrap(), b"b");
        assert_eq!(names(folder.path()), ["a", "b"]);
    }

    /// As that of a program that is being started.
    #[test]
    fn a_lock_that_is_let_go_at_once_is_waited_for() {
        let path = tempfile::NamedTempFile::new().unwrap();
        let held = File::options().write(true).open(path.path()).unwrap();
        lock(&held, path.path()).unwrap();
        let ends = thread::spawn(move || {
            thread::sleep(Duration::from_millis(20));
            drop(held);
        });
        let other = File::options().write(true).open(path.path()).unwrap();
        lock(&other, path.path()).unwrap();
        ends.join().unwrap();
    }

    #[test]
    fn a_lock_that_another_holds_is_respected() {
        let folder = folder_with(&["a"]);
        let path = folder.path().join("a");
        let open = || File::options().write(true).open(&path).unwrap();
        let (first, second) = (open(), open());
        lock(&first, &path).unwrap();
        assert!(matches!(
            lock(&second, &path),
            Err(TryLockError::WouldBlock)
        ));
        drop(first);
        lock(&second, &path).unwrap();
    }

    #[test]
    fn a_file_is_replaced_in_two_steps_where_one_does_not_do() {
        for errno in NOT_OVER_EXISTING {
            let folder = folder_with(&["new", "file"]);
            let [new, file] = ["new", "file"].map(|name| folder.path().join(name));
            let lack = with(&[(Call::RenameOver, errno)], || file_rename(&new, &file)).unwrap();
            assert_eq!(lack, Some(Lack::Replace), "{errno}");
            assert_eq!(std::fs::read(&file).unwrap(), b"new");
            assert_eq!(names(folder.path()), ["file"]);
        }
    }

    #[test]
    fn a_new_name_is_never_that_of_another_file() {
        for errno in NOT_OFFERED {
            let folder = folder_with(&["a", "b", "there"]);
            let [a, b, there] = ["a", "b", "there"].map(|name| folder.path().join(name));
            let new = folder.path().join("new");
            // Without links, too: nothing but the claim and the rename is used.
            with(&[(Call::RenameNew, errno)], || rename_new(&a, &new)).unwrap();
            assert_eq!(std::fs::read(&new).unwrap(), b"a");
            let both = [(Call::RenameNew, errno), (Call::RenameOver, Errno::EXIST)];
            with(&both, || rename_new(&b, &folder.path().join("other"))).unwrap();
            let error = with(&both, || rename_new(&new, &there)).unwrap_err();
            assert_eq!(error.kind(), io::ErrorKind::AlreadyExists);
            assert_eq!(names(folder.path()), ["new", "other", "there"]);
        }
    }

    #[test]
    fn a_folder_is_tried_without_a_trace() {
        let folder = folder_with(&["a"]);
        assert_eq!(probe(folder.path()).unwrap(), []);
        let lacking = [
            (Call::Lock, Errno::NOLCK),
            (Call::Sync, Errno::INVAL),
            (Call::RenameOver, Errno::PERM),
        ];
        let lacks = with(&lacking, || probe(folder.path())).unwrap();
        assert_eq!(lacks, [Lack::Locks, Lack::Sync, Lack::Replace]);
        assert!(with(&[(Call::Sync, Errno::IO)], || probe(folder.path())).is_err());
        assert_eq!(names(folder.path()), ["a"]);
        assert!(probe(&folder.path().join("none")).is_err());
    }
}
