//! The folder in which a program that is run (a camera's, a browser) leaves its files,
//! and the keeper: a small process that ends the program and removes the folder when
//! this process is gone, however it ended.

use std::fs::File;
use std::io::{BufRead, Write};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process_group};
use tempfile::TempDir;

use super::started::end_marked;
use crate::device::DeviceError;

/// A keeper that takes longer to end is left alone.
const END: Duration = Duration::from_secs(1);

/// The folder, which is removed with this.
#[derive(Debug)]
pub struct Workplace {
    folder: TempDir,
    keeper: Option<Mutex<Child>>,
}

impl Workplace {
    /// A new folder in the temporary one. `keeper` is to call [`keep`] with its
    /// standard input and the folder, which is added as its last argument.
    pub fn new(keeper: Option<Command>) -> Result<Self, DeviceError> {
        let folder = tempfile::Builder::new()
            .prefix("rig-camera-")
            .tempdir()
            .map_err(temporary)?;
        let keeper = keeper.map(|mut command| {
            command
                .arg(folder.path())
                .stdin(Stdio::piped())
                .stdout(Stdio::null())
                // Ctrl-C and a closed terminal are meant for this process alone.
                .process_group(0)
                .current_dir("/")
                .spawn()
                .map(Mutex::new)
                .map_err(|source| DeviceError::Io {
                    device: "the keeper of a program that is run".to_owned(),
                    source,
                })
        });
        Ok(Self {
            folder,
            keeper: keeper.transpose()?,
        })
    }

    /// A folder of its own for a frame, removed with the result.
    pub fn place(&self) -> Result<TempDir, DeviceError> {
        TempDir::new_in(self.folder.path()).map_err(temporary)
    }

    /// The folder.
    pub(super) fn path(&self) -> &Path {
        self.folder.path()
    }

    /// A file that nobody else sees.
    pub(in crate::device) fn scratch(&self) -> std::io::Result<File> {
        tempfile::tempfile_in(self.folder.path())
    }

    /// Which program is running now, leader of its process group; `None`: none.
    pub(in crate::device) fn runs(&self, program: Option<Pid>) {
        if let Some(keeper) = &self.keeper {
            let mut keeper = keeper.lock().unwrap_or_else(PoisonError::into_inner);
            let number = program.map_or(0, |pid| pid.as_raw_nonzero().get());
            if let Some(pipe) = &mut keeper.stdin {
                // Where the keeper is gone, this process must do without.
                drop(pipe.write_all(format!("{number}\n").as_bytes()));
            }
        }
    }
}

impl Drop for Workplace {
    fn drop(&mut self) {
        end_marked(self.folder.path());
        if let Some(keeper) = &mut self.keeper {
            let keeper = keeper.get_mut().unwrap_or_else(PoisonError::into_inner);
            drop(keeper.stdin.take());
            let end = Instant::now() + END;
            while matches!(keeper.try_wait(), Ok(None)) && Instant::now() < end {
                std::thread::sleep(Duration::from_millis(2));
            }
        }
    }
}

/// An error of the folder for temporary files, which `TMPDIR` names.
fn temporary(source: std::io::Error) -> DeviceError {
    DeviceError::TemporaryFolder {
        folder: std::env::temp_dir(),
        source,
    }
}

/// The keeper: is told which program runs, until the other end is closed; then ends
/// that program with all that any program of the folder has started, and removes the folder.
pub fn keep(pipe: impl BufRead, folder: &Path) -> std::io::Result<()> {
    let mut running = None;
    for line in pipe.lines().map_while(Result::ok) {
        running = line.parse().ok().and_then(Pid::from_raw);
    }
    if let Some(program) = running {
        // Fails where all have ended already.
        let _ = kill_process_group(program, Signal::KILL);
    }
    end_marked(folder);
    remove(folder)
}

/// Also what a program that is just ending still writes.
fn remove(folder: &Path) -> std::io::Result<()> {
    let mut removed = std::fs::remove_dir_all(PathBuf::from(folder));
    for _ in 0..20 {
        match removed {
            Err(error) if error.kind() == std::io::ErrorKind::DirectoryNotEmpty => {}
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(()),
            other => return other,
        }
        std::thread::sleep(Duration::from_millis(10));
        removed = std::fs::remove_dir_all(folder);
    }
    removed
}
