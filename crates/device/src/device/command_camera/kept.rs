//! A program that is run to its end, with a time limit, so that nothing it started stays
//! behind, however this process ends.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process_group};

use super::program;
use super::started::{MARK, end_marked};
use super::workplace::Workplace;
use crate::device::DeviceError;
use crate::device::described::io_error;
use crate::outside_text;

/// Time between two looks whether the program has ended.
const POLL: Duration = Duration::from_millis(5);
/// So much of its output is read, from the end of stdout and of stderr, bytes.
const READ_BYTES: u64 = 1 << 22;

/// How a program ended, and what it wrote.
#[derive(Debug)]
pub struct Ended {
    /// `None`: it was ended, because its time was over.
    pub status: Option<ExitStatus>,
    /// Its standard output.
    pub stdout: String,
    /// Its standard error.
    pub stderr: String,
}

impl Workplace {
    /// Runs a program to its end, or ends it and all that it started at the deadline.
    ///
    /// # Errors
    /// [`DeviceError::Program`] if it cannot be run, or the system's error.
    pub fn run(&self, mut command: Command, deadline: Instant) -> Result<Ended, DeviceError> {
        let name = command.get_program().to_string_lossy().into_owned();
        let io = |source| io_error(name.clone(), source);
        let mut output = self.scratch().map_err(io)?;
        let mut errors = self.scratch().map_err(io)?;
        let child = command
            .env(MARK, self.path())
            .stdin(Stdio::null())
            .stdout(output.try_clone().map_err(io)?)
            .stderr(errors.try_clone().map_err(io)?)
            // Apart from the terminal's signals, and to be ended as a whole.
            .process_group(0)
            .spawn()
            .map_err(|error| match program::fault_of(&name, &error) {
                Some(fault) => DeviceError::Program {
                    program: name.clone(),
                    fault,
                },
                None => io_error(name.clone(), error),
            })?;
        self.runs(Some(Pid::from_child(&child)));
        let mut running = Running(child, self);
        let status = loop {
            if let Some(status) = running.0.try_wait().map_err(io)? {
                break Some(status);
            }
            if Instant::now() >= deadline {
                break None;
            }
            std::thread::sleep(POLL);
        };
        drop(running);
        if status.is_none_or(|status| !status.success()) {
            end_marked(self.path());
        }
        Ok(Ended {
            status,
            stdout: text_of(&mut output).map_err(io)?,
            stderr: text_of(&mut errors).map_err(io)?,
        })
    }
}

/// Ends the program's whole process group when dropped.
struct Running<'a>(Child, &'a Workplace);

impl Drop for Running<'_> {
    fn drop(&mut self) {
        // Fails where the program and all its children have ended already.
        let _ = kill_process_group(Pid::from_child(&self.0), Signal::KILL);
        let _ = self.0.wait();
        self.1.runs(None);
    }
}

/// The end of what a file holds, as text of any encoding.
fn text_of(file: &mut File) -> std::io::Result<String> {
    let length = file.seek(SeekFrom::End(0))?;
    file.seek(SeekFrom::Start(length.saturating_sub(READ_BYTES)))?;
    let mut bytes = Vec::new();
    file.take(READ_BYTES).read_to_end(&mut bytes)?;
    Ok(outside_text::decode_any(&bytes))
}

/// How a program ended.
pub(in crate::device) fn how_it_ended(status: ExitStatus) -> String {
    match status.code() {
        Some(code) => format!("it ended with exit code {code}"),
        None => format!("signal {} ended it", status.signal().unwrap_or_default()),
    }
}
