//! A camera behind a program: it is run once per frame, told the exposure and
//! where to put the file, and must have written it when it ends.

pub mod program;
mod workplace;

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process_group};

use self::workplace::Workplace;
use super::retake::FrameFault;
use super::{
    Camera, CameraInfo, CameraSettings, DeviceError, FrameKey, RawFrame, image_file, outside,
};
use crate::units::Seconds;

pub use self::workplace::keep;

/// What the program is and what its files hold.
#[derive(Clone, Debug, PartialEq)]
pub struct CommandConfig {
    /// Program and arguments. In arguments `{exposure_s}`, `{gain}` and
    /// `{output}` stand for the exposure in seconds, the gain as a factor and
    /// the path to write, which ends in `.tif`.
    pub command: Vec<String>,
    /// The camera as the rig file describes it: nobody can be asked.
    pub info: CameraInfo,
    /// How long the program, and reading its file, may take beyond the exposure.
    pub timeout: Seconds,
}

/// A camera that is a program.
#[derive(Debug)]
pub struct CommandCamera {
    config: CommandConfig,
    settings: Option<CameraSettings>,
    workplace: Arc<Workplace>,
}

/// How often is looked whether the program has ended.
const POLL: Duration = Duration::from_millis(5);
/// So much of what it wrote to stderr is told: its end says most.
const TOLD_BYTES: u64 = 600;
impl CommandCamera {
    /// A camera of this configuration. The program is not run yet. `keeper` is to
    /// call [`keep`] with its standard input and its last argument, a folder that is
    /// added: it ends the program where this process cannot. Without one a program
    /// goes on when this process is killed.
    ///
    /// # Errors
    /// If there can be no temporary folder or the keeper cannot be started.
    pub fn new(config: CommandConfig, keeper: Option<Command>) -> Result<Self, DeviceError> {
        Ok(Self {
            config,
            settings: None,
            workplace: Arc::new(Workplace::new(keeper)?),
        })
    }

    fn program(&self) -> String {
        self.config.command.first().cloned().unwrap_or_default()
    }
}

/// One frame, taken on a thread that can be abandoned.
struct Job {
    config: CommandConfig,
    settings: CameraSettings,
    workplace: Arc<Workplace>,
    timeout: Seconds,
    deadline: Instant,
}

impl Job {
    /// Arguments with their values, program first.
    fn filled_in(&self, output: &Path) -> Vec<String> {
        let fill = |word: &String| {
            word.replace("{exposure_s}", &self.settings.exposure.0.to_string())
                .replace("{gain}", &self.settings.gain.to_string())
                .replace("{output}", &output.display().to_string())
        };
        self.config.command.iter().map(fill).collect()
    }

    /// Runs the program and reads its file.
    fn take(self, device: String) -> Result<RawFrame, DeviceError> {
        let place = self.workplace.place()?;
        let output = place.path().join("frame.tif");
        let words = self.filled_in(&output);
        let unrunnable = |fault| DeviceError::Program {
            program: device.clone(),
            fault,
        };
        let ended = self.run(&words).map_err(|error| match error {
            RunError::Start(error) => match program::fault_of(&device, &error) {
                Some(fault) => unrunnable(fault),
                None => io_error(&device, error),
            },
            RunError::Other(error) => io_error(&device, error),
        })?;
        let refused = |reason: String| DeviceError::Refused {
            device: device.clone(),
            command: words[1..].join(" "),
            reason: reason + &and_said(&ended.said),
        };
        match ended.status {
            None => Err(DeviceError::NoReply {
                device,
                timeout: self.timeout,
                sent: words[1..].join(" ") + &and_said(&ended.said),
            }),
            Some(status) if !status.success() => Err(match status.code() {
                Some(code) => match program::fault_at_end(&device, code, &ended.said) {
                    Some(fault) => unrunnable(fault),
                    None => refused(format!("it ended with exit code {code}")),
                },
                None => refused(format!(
                    "signal {} ended it",
                    status.signal().unwrap_or_default()
                )),
            }),
            Some(_) if !output.exists() => Err(refused("it wrote no file".to_owned())),
            Some(_) => {
                let info = &self.config.info;
                image_file::read(&output, info.resolution_px, info.bit_depth).map_err(|fault| {
                    let fault = match fault {
                        FrameFault::Undecodable(what) => {
                            FrameFault::Undecodable(what + &and_said(&ended.said))
                        }
                        other => other,
                    };
                    DeviceError::BadFrame { device, fault }
                })
            }
        }
    }

    /// Runs the program to its end, or ends it and all that it started.
    fn run(&self, words: &[String]) -> Result<Ended, RunError> {
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
            if Instant::now() >= self.deadline {
                break None;
            }
            std::thread::sleep(POLL);
        };
        drop(running);
        Ok(Ended {
            status,
            said: end_of(&mut errors)?,
        })
    }
}

fn io_error(device: &str, source: std::io::Error) -> DeviceError {
    let device = device.to_owned();
    match source.kind() {
        std::io::ErrorKind::NotFound => DeviceError::NotFound { device },
        std::io::ErrorKind::PermissionDenied => DeviceError::PermissionDenied { device },
        _ => DeviceError::Io { device, source },
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
    said: String,
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
    errors.seek(SeekFrom::Start(length.saturating_sub(TOLD_BYTES)))?;
    let mut bytes = Vec::new();
    errors.take(TOLD_BYTES).read_to_end(&mut bytes)?;
    let text = String::from_utf8_lossy(&bytes);
    let lines: Vec<&str> = text
        .lines()
        .map(str::trim)
        .filter(|l| !l.is_empty())
        .collect();
    Ok(lines.join("; "))
}

/// What the program said, to be put after something else.
fn and_said(said: &str) -> String {
    if said.is_empty() {
        String::new()
    } else {
        format!(", and it wrote: {said}")
    }
}

impl Camera for CommandCamera {
    fn info(&self) -> &CameraInfo {
        &self.config.info
    }

    /// The program is told the values with each frame; nothing can be read back,
    /// so that only the images show whether they were applied.
    fn configure(&mut self, requested: CameraSettings) -> Result<CameraSettings, DeviceError> {
        let applied = CameraSettings {
            exposure: super::nearest_exposure(&self.config.info, requested.exposure),
            gain: requested.gain,
        };
        self.settings = Some(applied);
        Ok(applied)
    }

    fn set_shutter(&mut self, _open: bool) -> Result<bool, DeviceError> {
        Ok(false)
    }

    fn grab(&mut self, _key: FrameKey) -> Result<RawFrame, DeviceError> {
        let settings = self.settings.ok_or_else(|| DeviceError::Refused {
            device: self.program(),
            command: "a frame".to_owned(),
            reason: "it is not configured".to_owned(),
        })?;
        let timeout = Seconds(settings.exposure.0 + self.config.timeout.0);
        let job = Job {
            config: self.config.clone(),
            settings,
            workplace: Arc::clone(&self.workplace),
            timeout,
            deadline: Instant::now() + timeout.to_duration(),
        };
        let device = self.program();
        let its_device = device.clone();
        let sent = "a frame, whose file could not be read";
        outside::frame_within(device, timeout, sent, move || job.take(its_device))
    }

    fn longest_frame(&self, exposure: Seconds) -> Seconds {
        Seconds(exposure.0 + self.config.timeout.0 + 2.0 * outside::HANDOVER.as_secs_f64())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::{FrameKind, Mosaic, ProgramFault};
    use image::{ImageBuffer, Luma};

    const KEY: FrameKey = FrameKey {
        light: 0,
        exposure: 0,
        repeat: 0,
        kind: FrameKind::Light,
    };

    /// A camera whose program is this shell script; `$1` is the exposure, `$2`
    /// the gain, `$3` the output, `$4` a folder with the image `good.tif`.
    fn camera(folder: &Path, script: &str, timeout_s: f64) -> CommandCamera {
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
        let config = CommandConfig {
            command,
            info: CameraInfo {
                driver: "command".to_owned(),
                model: "sh".to_owned(),
                serial: String::new(),
                resolution_px: [4, 2],
                bit_depth: 12,
                mosaic: Mosaic::None,
                exposure_range: [Seconds(0.001), Seconds(30.0)],
                exposure_step: Seconds(0.001),
            },
            timeout: Seconds(timeout_s),
        };
        let mut camera = CommandCamera::new(config, None).unwrap();
        camera
            .configure(CameraSettings {
                exposure: Seconds(0.0251),
                gain: 2.0,
            })
            .unwrap();
        camera
    }

    #[test]
    fn the_program_is_told_the_settings_and_its_file_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let script = "echo $1 $2 > $4/told; cp $4/good.tif $3";
        let mut camera = camera(folder.path(), script, 20.0);
        let frame = camera.grab(KEY).unwrap();
        assert_eq!(frame.counts, [0, 1, 2, 3, 100, 101, 102, 103]);
        let told = std::fs::read_to_string(folder.path().join("told")).unwrap();
        assert_eq!(told, "0.025 2\n");
    }

    #[test]
    fn failures_come_with_what_the_program_said() {
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
        let mut missing = camera(folder.path(), "", 20.0);
        missing.config.command = vec!["/no/such/program".to_owned()];
        let is_missing = |fault: &ProgramFault| matches!(fault, ProgramFault::Missing { .. });
        assert!(matches!(
            missing.grab(KEY),
            Err(DeviceError::Program { fault, .. }) if is_missing(&fault)
        ));
        missing.config.command = vec![folder.path().join("good.tif").display().to_string()];
        assert!(matches!(
            missing.grab(KEY),
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
