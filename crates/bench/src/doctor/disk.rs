//! The folder of the sessions.

use std::io::Write;
use std::path::Path;
use std::time::Instant;

use rustix::fs::{Access, access};

use super::{Check, Trouble};
use crate::config::ResolvedRig;
use crate::file_system::{self, Lack};
use crate::units::size;

/// Free space and speed of the disk that will hold the sessions, and what its file system
/// can do.
pub(super) fn checks(rig: &ResolvedRig, folder: &Path) -> Vec<Check> {
    if let Err(error) = access(folder, Access::WRITE_OK) {
        let error = std::io::Error::from(error);
        let fact = format!("the folder {} cannot be written: {error}", folder.display());
        return vec![Check::failed("folder", fact, Trouble::ReadOnly)];
    }
    let failed =
        |name, error: std::io::Error| Check::failed(name, error.to_string(), Trouble::DiskFails);
    let reserve = rig.config.capture.disk_reserve_bytes;
    let space = match file_system::free_bytes(folder) {
        Ok(u64::MAX) => Check::warning(
            "disk space",
            "the file system does not say how much is free",
            Trouble::SpaceUnknown,
        ),
        Ok(free) => {
            let fact = format!("{} free, {} stay reserved", size(free), size(reserve));
            match free <= reserve {
                true => Check::failed("disk space", fact, Trouble::DiskFull),
                false => Check::ok("disk space", fact),
            }
        }
        Err(error) => failed("disk space", error),
    };
    let speed = match write_rate_bytes_s(folder) {
        Ok(rate) => Check::ok("disk speed", format!("{}/s written and synced", size(rate))),
        Err(error) => failed("disk speed", error),
    };
    let mut checks = vec![file_system_of(folder), space, speed];
    checks.extend(files(folder));
    checks
}

/// Whether the files of a capture can be made, where the file system says.
fn files(folder: &Path) -> Option<Check> {
    /// Of a capture of one light.
    const FEW: u64 = 100;
    let free = file_system::free_files(folder).ok()??;
    let fact = format!("{free} more can be made");
    Some(match free {
        ..FEW => Check::failed("files", fact, Trouble::FewFiles),
        _ => Check::ok("files", fact),
    })
}

/// Whether a session can be written as it should be: tried with a file that goes again.
fn file_system_of(folder: &Path) -> Check {
    let name = "file system";
    match file_system::probe(folder) {
        Err(error) => {
            let fact = format!("no session can be kept in {}: {error}", folder.display());
            Check::failed(name, fact, Trouble::NoSession(error))
        }
        Ok(lacks) if lacks.is_empty() => Check::ok(
            name,
            "locks, confirms what is on the medium, and replaces files",
        ),
        Ok(lacks) => {
            let lacks: Vec<String> = lacks.iter().map(Lack::to_string).collect();
            let fact = format!("that of {} {}", folder.display(), lacks.join("; it "));
            Check::warning(name, fact, Trouble::Lacking)
        }
    }
}

/// Writes and syncs a few megabytes as a capture would.
fn write_rate_bytes_s(folder: &Path) -> std::io::Result<u64> {
    const BLOCKS: usize = 8;
    let block = vec![0x5a; 1 << 20];
    // Closed before it is removed, which not every file system does with an open one.
    let file = tempfile::Builder::new()
        .prefix(".rig-speed-")
        .suffix(file_system::PART)
        .tempfile_in(folder)?;
    let (mut file, path) = file.into_parts();
    // Else another program might take it for what a killed one has left.
    let _ = file.try_lock();
    let start = Instant::now();
    for _ in 0..BLOCKS {
        file.write_all(&block)?;
    }
    file_system::sync_file(&file, &path)?;
    let rate = (BLOCKS * block.len()) as f64 / start.elapsed().as_secs_f64().max(1e-9);
    drop(file);
    path.close()?;
    Ok(rate as u64)
}
