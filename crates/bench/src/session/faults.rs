//! Disks for tests: one that fails where the test says, one that is small, one
//! that does not wait.

use std::io;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use super::commit::{Disk, SystemDisk};

/// The system's disk without waiting for the medium: for tests of everything
/// but a power cut, which fsync many thousand times otherwise.
#[derive(Clone, Copy, Debug, Default)]
pub struct UnsyncedDisk;

impl Disk for UnsyncedDisk {
    fn create_dir(&self, path: &Path) -> io::Result<()> {
        SystemDisk.create_dir(path)
    }

    fn write_temporary(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        SystemDisk.write_temporary(path, bytes)
    }

    fn remove_file(&self, path: &Path) -> io::Result<()> {
        SystemDisk.remove_file(path)
    }

    fn append(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        SystemDisk.append(path, bytes)
    }

    fn truncate(&self, path: &Path, bytes: u64) -> io::Result<()> {
        SystemDisk.truncate(path, bytes)
    }

    fn sync_file(&self, _: &Path) -> io::Result<()> {
        Ok(())
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        SystemDisk.rename(from, to)
    }

    fn sync_dir(&self, _: &Path) -> io::Result<()> {
        Ok(())
    }
}

/// How an operation fails.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// An input/output error, once; nothing was written.
    Error,
    /// Half of the bytes were written, then an error, once.
    ShortWrite,
    /// The disk is full from here on; half of the bytes still fitted.
    DiskFull,
    /// The operation and all later ones do not happen: the process is gone.
    Crash,
}

impl Fault {
    /// Every kind.
    pub const ALL: [Self; 4] = [Self::Error, Self::ShortWrite, Self::DiskFull, Self::Crash];
}

/// A disk with one fault at the `at`-th operation (from 0).
pub struct FaultyDisk {
    under: Arc<dyn Disk>,
    at: u64,
    fault: Fault,
    count: AtomicU64,
}

impl FaultyDisk {
    /// The system's disk, which fails at operation number `at`, counted from 0.
    pub fn new(at: u64, fault: Fault) -> Self {
        Self::over(Arc::new(SystemDisk), at, fault)
    }

    /// Likewise over another disk.
    pub fn over(under: Arc<dyn Disk>, at: u64, fault: Fault) -> Self {
        Self {
            under,
            at,
            fault,
            count: AtomicU64::new(0),
        }
    }

    /// How many operations were requested so far.
    pub fn operations(&self) -> u64 {
        self.count.load(Ordering::SeqCst)
    }

    /// `part` performs what a torn operation still does.
    fn step(
        &self,
        whole: impl FnOnce() -> io::Result<()>,
        part: impl FnOnce(),
        needs_space: bool,
    ) -> io::Result<()> {
        let number = self.count.fetch_add(1, Ordering::SeqCst);
        let now = number == self.at;
        let since = number >= self.at;
        match self.fault {
            Fault::Error if now => Err(io::Error::other("injected fault")),
            Fault::ShortWrite if now => {
                part();
                Err(io::Error::new(
                    io::ErrorKind::WriteZero,
                    "injected short write",
                ))
            }
            Fault::DiskFull if since && (now || needs_space) => {
                if now {
                    part();
                }
                Err(io::ErrorKind::StorageFull.into())
            }
            Fault::Crash if since => Err(io::Error::other("injected crash")),
            _ => whole(),
        }
    }
}

impl Disk for FaultyDisk {
    fn create_dir(&self, path: &Path) -> io::Result<()> {
        self.step(|| self.under.create_dir(path), || (), true)
    }

    fn write_temporary(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        self.step(
            || self.under.write_temporary(path, bytes),
            || drop(self.under.write_temporary(path, &bytes[..bytes.len() / 2])),
            true,
        )
    }

    fn remove_file(&self, path: &Path) -> io::Result<()> {
        self.step(|| self.under.remove_file(path), || (), false)
    }

    fn append(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        self.step(
            || self.under.append(path, bytes),
            || drop(self.under.append(path, &bytes[..bytes.len() / 2])),
            true,
        )
    }

    fn truncate(&self, path: &Path, bytes: u64) -> io::Result<()> {
        self.step(|| self.under.truncate(path, bytes), || (), false)
    }

    fn sync_file(&self, path: &Path) -> io::Result<()> {
        self.step(|| self.under.sync_file(path), || (), false)
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.step(|| self.under.rename(from, to), || (), false)
    }

    fn sync_dir(&self, path: &Path) -> io::Result<()> {
        self.step(|| self.under.sync_dir(path), || (), false)
    }
}

/// A disk that has room for so many bytes, of which it gives none back.
pub struct SmallDisk {
    under: Arc<dyn Disk>,
    free: AtomicU64,
}

impl SmallDisk {
    /// With this room left, over another disk.
    pub fn over(under: Arc<dyn Disk>, free_bytes: u64) -> Self {
        Self {
            under,
            free: AtomicU64::new(free_bytes),
        }
    }

    fn take(&self, bytes: &[u8]) -> io::Result<()> {
        let left = |free: u64| free.checked_sub(bytes.len() as u64);
        match self
            .free
            .fetch_update(Ordering::SeqCst, Ordering::SeqCst, left)
        {
            Ok(_) => Ok(()),
            Err(_) => Err(io::ErrorKind::StorageFull.into()),
        }
    }
}

impl Disk for SmallDisk {
    fn create_dir(&self, path: &Path) -> io::Result<()> {
        self.under.create_dir(path)
    }

    fn write_temporary(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        self.take(bytes)?;
        self.under.write_temporary(path, bytes)
    }

    fn remove_file(&self, path: &Path) -> io::Result<()> {
        self.under.remove_file(path)
    }

    fn append(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        self.take(bytes)?;
        self.under.append(path, bytes)
    }

    fn truncate(&self, path: &Path, bytes: u64) -> io::Result<()> {
        self.under.truncate(path, bytes)
    }

    fn sync_file(&self, path: &Path) -> io::Result<()> {
        self.under.sync_file(path)
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.under.rename(from, to)
    }

    fn sync_dir(&self, path: &Path) -> io::Result<()> {
        self.under.sync_dir(path)
    }

    fn free_bytes(&self, _: &Path) -> io::Result<u64> {
        Ok(self.free.load(Ordering::SeqCst))
    }
}
