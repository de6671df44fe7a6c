//! A camera behind a program: it is run once per frame, given the exposure and
//! where to put the file, and must have written it when it ends.

pub mod program;
mod workplace;

use std::ffi::OsStr;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process_group};

use self::workplace::Workplace;
use super::described::{DescribedCamera, Driver, FrameSource, Wanted, io_error};
use super::retake::FrameFault;
use super::{CameraInfo, DeviceError, RawFrame};

pub use self::workplace::keep;

/// `camera.driver = "command"`.
pub const DRIVER: Driver = Driver {
    name: "command",
    key: "command",
    allowed: "a program with its arguments, among them {exposure_s} and {output}",
    is_path: false,
    accepts: |text| {
        let words = words(text);
        let has = |key: &str| words.iter().skip(1).any(|word| word.contains(key));
        has("{exposure_s}") && has("{output}")
    },
    ready: |text| {
        let program = words(text).swap_remove(0);
        match program::fault(&program) {
            None => Ok(format!("frames come from the program {program}")),
            Some(fault) => Err(DeviceError::Program { program, fault }),
        }
    },
    open: |text, description| {
        let program = CameraProgram::new(words(text), description.keeper)?;
        let model = program.name();
        let info = CameraInfo {
            model,
            ..description.info
        };
        Ok(Box::new(DescribedCamera::new(
            program,
            info,
            description.timeout,
        )))
    },
};

fn words(text: &OsStr) -> Vec<String> {
    let text = text.to_string_lossy();
    text.split_whitespace().map(str::to_owned).collect()
}

/// A program that takes frames.
#[derive(Clone, Debug)]
pub struct CameraProgram {
    /// Program and arguments. In arguments `{exposure_s}`, `{gain}` and
    /// `{output}` stand for the exposure in seconds, the gain as a factor and
    /// the path to write, which ends in `.tif`.
    command: Vec<String>,
    workplace: Arc<Workplace>,
}

/// How often is looked whether the program has ended.
const POLL: Duration = Duration::from_millis(5);
/// So much of what it wrote to stderr is reported: its end is most informative.
const REPORTED_BYTES: u64 = 600;

impl CameraProgram {
    /// A program with its arguments. It is not run yet. `keeper` is to
    /// call [`keep`] with its standard input and its last argument, a folder that is
    /// added: it ends the program where this process cannot. Without one a program
    /// goes on when this process is killed.
    ///
    /// # Errors
    /// If there can be no temporary folder or the keeper cannot be started.
    pub fn new(command: Vec<String>, keeper: Option<Command>) -> Result<Self, DeviceError> {
        Ok(Self {
            command,
            workplace: Arc::new(Workplace::new(keeper)?),
        })
    }

    /// Arguments with their values, program first.
    fn filled_in(&self, wanted: &Wanted, output: &Path) -> Vec<String> {
        let fill = |word: &String| {
            word.replace("{exposure_s}", &wanted.settings.exposure.0.to_string())
                .replace("{gain}", &wanted.settings.gain.to_string())
                .replace("{output}", &output.display().to_string())
        };
        self.command.iter().map(fill).collect()
    }

    /// Runs the program to its end, or ends it and all that it started.
    fn run(&self, words: &[String], deadline: Instant) -> Result<Ended, RunError> {
        let mut errors = self.workplace.scratch()?;
        let none = || RunError::Start(std::io::ErrorKind::NotFound.into());
        let (program, arguments) = words.split_first().ok_or_else(none)?;
        let child = Command::new(program)
            .args(arguments)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(errors.try_clone()?)
            // Apart from the terminal's signals, and to be ended as a whole.
            .process_group(0)
            .spawn()
            .map_err(RunError::Start)?;
        self.workplace.runs(Some(Pid::from_child(&child)));
        let mut running = Running(child, &self.workplace);
        let status = loop {
            if let Some(status) = running.0.try_wait()? {
                break Some(status);
            }
            if Instant::now() >= deadline {
                break None;
            }
            std::thread::sleep(POLL);
        };
        drop(running);
        Ok(Ended {
            status,
            stderr: end_of(&mut errors)?,
        })
    }
}

impl FrameSource for CameraProgram {
    const SENT: &'static str = "a frame, whose file could not be read";

    fn name(&self) -> String {
        self.command.first().cloned().unwrap_or_default()
    }

    /// Runs the program and reads its file.
    fn take(&self, wanted: &Wanted) -> Result<RawFrame, DeviceError> {
        let device = self.name();
        let place = self.workplace.place()?;
        let output = place.path().join("frame.tif");
        let words = self.filled_in(wanted, &output);
        let unrunnable = |fault| DeviceError::Program {
            program: device.clone(),
            fault,
        };
        let ended = self
            .run(&words, wanted.deadline)
            .map_err(|error| match error {
                RunError::Start(error) => match program::fault_of(&device, &error) {
                    Some(fault) => unrunnable(fault),
                    None => io_error(device.clone(), error),
                },
                RunError::Other(error) => io_error(device.clone(), error),
            })?;
        let refused = |reason: String| DeviceError::Refused {
            device: device.clone(),
            command: words[1..].join(" "),
            reason: reason + &and_wrote(&ended.stderr),
        };
        match ended.status {
            None => Err(DeviceError::NoReply {
                device,
                timeout: wanted.timeout,
                sent: words[1..].join(" ") + &and_wrote(&ended.stderr),
            }),
            Some(status) if !status.success() => Err(match status.code() {
                Some(code) => match program::fault_at_end(&device, code, &ended.stderr) {
                    Some(fault) => unrunnable(fault),
                    None => refused(format!("it ended with exit code {code}")),
                },
                None => refused(format!(
                    "signal {} ended it",
                    status.signal().unwrap_or_default()
                )),
            }),
            Some(_) if !output.exists() => Err(refused("it wrote no file".to_owned())),
            Some(_) => wanted.read(&output).map_err(|fault| {
                let fault = match fault {
                    FrameFault::Undecodable(what) => {
                        FrameFault::Undecodable(what + &and_wrote(&ended.stderr))
                    }
                    other => other,
                };
                DeviceError::BadFrame { device, fault }
            }),
        }
    }
}

/// What running a program met.
enum RunError {
    /// It did not start.
    Start(std::io::Error),
    /// Anything else.
    Other(std::io::Error),
}

impl From<std::io::Error> for RunError {
    fn from(error: std::io::Error) -> Self {
        Self::Other(error)
    }
}

/// How the program ended (`None`: it had to be), and the end of its stderr.
struct Ended {
    status: Option<ExitStatus>,
    stderr: String,
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

fn end_of(errors: &mut File) -> std::io::Result<String> {
    let length = errors.seek(SeekFrom::End(0))?;
    errors.seek(SeekFrom::Start(length.saturating_sub(REPORTED_BYTES)))?;
    let mut bytes = Vec::new();
    errors.take(REPORTED_BYTES).read_to_end(&mut bytes)?;
    let text = String::from_utf8_lossy(&bytes);
    let lines: Vec<&str> = text
        .lines()
        .map(str::trim)
        .filter(|l| !l.is_empty())
        .collect();
    Ok(lines.join("; "))
}

/// What the program wrote to stderr, to be put after something else.
fn and_wrote(text: &str) -> String {
    if text.is_empty() {
        String::new()
    } else {
        format!(", and it wrote: {text}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::described::tests::{KEY, configured};
    use crate::device::{Camera, ProgramFault};
    use image::{ImageBuffer, Luma};

    /// A camera whose program is this shell script; `$1` is the exposure, `$2`
    /// the gain, `$3` the output, `$4` a folder with the image `good.tif`.
    fn camera(folder: &Path, script: &str, timeout_s: f64) -> DescribedCamera<CameraProgram> {
        let path = folder.join("camera.sh");
        std::fs::write(&path, script).unwrap();
        let image = ImageBuffer::from_fn(4, 2, |x, y| Luma([(100 * y + x) as u16]));
        image.save(folder.join("good.tif")).unwrap();
        let words = [
            "sh",
            path.to_str().unwrap(),
            "{exposure_s}",
            "{gain}",
            "{output}",
        ];
        let mut command = words.map(str::to_owned).to_vec();
        command.push(folder.display().to_string());
        let program = CameraProgram::new(command, None).unwrap();
        configured(program, timeout_s, 0.0251, 2.0)
    }

    #[test]
    fn the_program_gets_the_settings_and_its_file_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let script = "echo $1 $2 > $4/got; cp $4/good.tif $3";
        let mut camera = camera(folder.path(), script, 20.0);
        let frame = camera.grab(KEY).unwrap();
        assert_eq!(frame.counts, [0, 1, 2, 3, 100, 101, 102, 103]);
        let got = std::fs::read_to_string(folder.path().join("got")).unwrap();
        assert_eq!(got, "0.025 2\n");
    }

    #[test]
    fn failures_come_with_what_the_program_wrote() {
        let folder = tempfile::tempdir().unwrap();
        let error = |script: &str| {
            camera(folder.path(), script, 20.0)
                .grab(KEY)
                .unwrap_err()
                .to_string()
        };
        let said = error("echo 'no camera found' >&2; exit 3");
        assert!(
            said.contains("exit code 3, and it wrote: no camera found"),
            "{said}"
        );
        let said = error("kill -9 $$");
        assert!(said.ends_with("signal 9 ended it"), "{said}");
        assert!(error("exit 0").ends_with("it wrote no file"));
        for (special, kind) in [
            ("mkfifo $3", "it is a named pipe, not a regular file"),
            ("mkdir $3", "Is a directory (os error 21)"),
            ("ln -s /dev/zero $3", "it is a device, not a regular file"),
        ] {
            let said = error(special);
            assert!(said.ends_with(kind), "{special}: {said}");
        }
        let said = error("head -c 60 $4/good.tif > $3; echo half >&2");
        assert!(
            said.contains("frame.tif: ") && said.ends_with("it wrote: half"),
            "{said}"
        );
        let of = |program: String| {
            configured(
                CameraProgram::new(vec![program], None).unwrap(),
                20.0,
                0.1,
                1.0,
            )
            .grab(KEY)
        };
        let is_missing = |fault: &ProgramFault| matches!(fault, ProgramFault::Missing { .. });
        assert!(matches!(
            of("/no/such/program".to_owned()),
            Err(DeviceError::Program { fault, .. }) if is_missing(&fault)
        ));
        assert!(matches!(
            of(folder.path().join("good.tif").display().to_string()),
            Err(DeviceError::Program {
                fault: ProgramFault::NotExecutable { .. },
                ..
            })
        ));
    }

    #[test]
    fn a_program_that_hangs_is_ended_with_all_it_started() {
        let folder = tempfile::tempdir().unwrap();
        let script = "echo waiting >&2; sleep 600 & echo $! > $4/pid; wait";
        let mut camera = camera(folder.path(), script, 1.0);
        let began = Instant::now();
        let error = camera.grab(KEY).unwrap_err();
        assert!(matches!(error, DeviceError::NoReply { .. }), "{error}");
        assert!(error.to_string().contains("waiting"), "{error}");
        assert!(began.elapsed() < Duration::from_secs(60));
        let pid = std::fs::read_to_string(folder.path().join("pid")).unwrap();
        let state = format!("/proc/{}/stat", pid.trim());
        // Whoever inherits the dead process may take a moment to bury it.
        let is_dead = || std::fs::read_to_string(&state).map_or(true, |text| text.contains(") Z "));
        let deadline = Instant::now() + Duration::from_secs(30);
        while !is_dead() && Instant::now() < deadline {
            std::thread::sleep(POLL);
        }
        assert!(is_dead(), "{:?}", std::fs::read_to_string(&state));
    }
}
