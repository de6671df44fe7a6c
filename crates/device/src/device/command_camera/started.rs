//! Processes that a camera's program has started, also those that have left its process group.

use std::os::unix::ffi::OsStrExt;
use std::path::Path;

use rustix::process::{Pid, Signal, kill_process};

/// In the environment of a camera's program, and so of all that it starts: the folder of its
/// workplace.
pub(super) const MARK: &str = "RIG_CAMERA_FOLDER";
/// So often is looked for what was started meanwhile.
const LOOKS: u32 = 5;

/// Ends what a camera's program of this workplace has started and what has left its process
/// group (`setsid`), as far as the system lists processes with their environment (`/proc`).
pub(super) fn end_marked(folder: &Path) {
    let mut mark = format!("{MARK}=").into_bytes();
    mark.extend(folder.as_os_str().as_bytes());
    let is_marked = |pid: Pid| {
        let path = format!("/proc/{}/environ", pid.as_raw_nonzero());
        let environ = std::fs::read(path).unwrap_or_default();
        environ.split(|&byte| byte == 0).any(|entry| entry == mark)
    };
    for _ in 0..LOOKS {
        let listed = std::fs::read_dir("/proc").into_iter().flatten().flatten();
        let pids = listed.filter_map(|entry| entry.file_name().to_str()?.parse().ok());
        let marked: Vec<Pid> = pids
            .filter_map(Pid::from_raw)
            .filter(|&pid| is_marked(pid))
            .collect();
        if marked.is_empty() {
            return;
        }
        for pid in marked {
            // Fails where it has ended already.
            let _ = kill_process(pid, Signal::KILL);
        }
    }
}
