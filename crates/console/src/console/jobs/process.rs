//! A child process that is sent signals: only while it is there, so that no other process
//! that gets its number afterwards is.

use std::process::{Child, ExitStatus};
use std::sync::{Mutex, MutexGuard, PoisonError};

use rustix::io::Errno;
use rustix::process::{Pid, Signal, WaitId, WaitIdOptions, kill_process, waitid};

/// A child that has been started.
#[derive(Debug)]
pub struct Process {
    pid: Pid,
    /// `None` once it has been waited for.
    child: Mutex<Option<Child>>,
}

impl Process {
    /// Of this child, whose pipes have been taken.
    pub fn new(child: Child) -> Self {
        Self {
            pid: Pid::from_child(&child),
            child: Mutex::new(Some(child)),
        }
    }

    /// Its number.
    pub fn pid(&self) -> u32 {
        self.pid.as_raw_nonzero().get().unsigned_abs()
    }

    fn child(&self) -> MutexGuard<'_, Option<Child>> {
        self.child.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sends these signals in this order, unless it has ended. Never waits.
    pub fn send(&self, signals: &[Signal]) {
        // Held while it is sent: nobody can wait for it meanwhile.
        if self.child().is_some() {
            for signal in signals {
                // It can only fail for a process that has just ended.
                let _ = kill_process(self.pid, *signal);
            }
        }
    }

    /// Waits until it ends.
    pub fn wait(&self) -> Option<ExitStatus> {
        // Its number stays taken until it is waited for below, under the lock.
        let options = WaitIdOptions::EXITED | WaitIdOptions::NOWAIT;
        while matches!(waitid(WaitId::Pid(self.pid), options), Err(Errno::INTR)) {}
        self.child().take()?.wait().ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::process::ExitStatusExt;
    use std::process::Command;

    #[test]
    fn signals_reach_a_process_that_is_waited_for_and_none_that_has_ended() {
        let process = Process::new(Command::new("sleep").arg("60").spawn().unwrap());
        std::thread::scope(|scope| {
            let waiting = scope.spawn(|| process.wait());
            process.send(&[Signal::STOP, Signal::TERM, Signal::CONT]);
            assert_eq!(waiting.join().unwrap().unwrap().signal(), Some(15));
        });
        process.send(&[Signal::KILL]);
        assert_eq!(process.wait(), None);
    }
}
