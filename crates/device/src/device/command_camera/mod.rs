//! A camera behind a program: it is run once per frame, given the exposure and
//! where to put the file, and must have written it when it ends. It may report on its
//! standard output what exposure, gain, serial number and temperature the frame had.

pub mod answer;
mod kept;
pub mod program;
mod started;
mod workplace;

use std::ffi::OsStr;
use std::path::Path;
use std::process::Command;
use std::sync::Arc;

use super::described::{DescribedCamera, Driver, FrameSource, Taken, Wanted, find_none};
use super::retake::FrameFault;
use super::{CameraInfo, DeviceError};

pub use self::answer::AnswerFault;
pub use self::kept::Ended;
pub(super) use self::kept::how_it_ended;
pub use self::workplace::Workplace;
pub use self::workplace::keep;

/// `camera.driver = "command"`.
pub const DRIVER: Driver = Driver {
    name: "command",
    offer: "a program that takes each frame",
    only_practice: false,
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
    find: find_none,
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

/// So much of what it wrote to stderr is reported: its end is most informative.
const REPORTED_BYTES: usize = 600;

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
}

impl FrameSource for CameraProgram {
    const SENT: &'static str = "a frame, whose file could not be read";

    fn name(&self) -> String {
        self.command.first().cloned().unwrap_or_default()
    }

    /// Runs the program, and reads its file and its answer.
    fn take(&self, wanted: &Wanted) -> Result<Taken, DeviceError> {
        let device = self.name();
        let place = self.workplace.place()?;
        let output = place.path().join("frame.tif");
        let words = self.filled_in(wanted, &output);
        let unrunnable = |fault| DeviceError::Program {
            program: device.clone(),
            fault,
        };
        let mut command = Command::new(&device);
        command.args(words.iter().skip(1));
        let ended = self.workplace.run(command, wanted.deadline)?;
        let stderr = end_of(&ended.stderr);
        let refused = |reason: String| DeviceError::Refused {
            device: device.clone(),
            command: words[1..].join(" "),
            reason: reason + &and_wrote(&stderr),
        };
        match ended.status {
            None => Err(DeviceError::NoReply {
                device,
                timeout: wanted.timeout,
                sent: words[1..].join(" ") + &and_wrote(&stderr),
            }),
            Some(status) if !status.success() => Err(match status.code() {
                Some(code) => match program::fault_at_end(&device, code, &stderr) {
                    Some(fault) => unrunnable(fault),
                    None => refused(how_it_ended(status)),
                },
                None => refused(how_it_ended(status)),
            }),
            Some(_) if !output.exists() => Err(refused("it wrote no file".to_owned())),
            Some(_) => {
                let frame = wanted.read(&output).map_err(|fault| {
                    let fault = match fault {
                        FrameFault::Undecodable(what) => {
                            FrameFault::Undecodable(what + &and_wrote(&stderr))
                        }
                        other => other,
                    };
                    let device = device.clone();
                    DeviceError::BadFrame { device, fault }
                })?;
                let stated = answer::parse(&ended.stdout).map_err(|fault| DeviceError::Answer {
                    program: device,
                    fault,
                })?;
                Ok(Taken { frame, stated })
            }
        }
    }
}

/// The end of a text, its lines in one.
fn end_of(text: &str) -> String {
    let mut start = text.len().saturating_sub(REPORTED_BYTES);
    while !text.is_char_boundary(start) {
        start += 1;
    }
    let lines: Vec<&str> = text[start..]
        .lines()
        .map(str::trim)
        .filter(|line| !line.is_empty())
        .collect();
    lines.join("; ")
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
    use crate::device::{Camera, ProgramFault, Stated};
    use crate::units::Seconds;
    use image::{ImageBuffer, Luma};
    use std::time::{Duration, Instant};

    const POLL: Duration = Duration::from_millis(5);

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
    fn what_the_program_reports_goes_with_the_frame() {
        let folder = tempfile::tempdir().unwrap();
        let of = |answer: &str| {
            let script = format!("cp $4/good.tif $3; echo warming up; echo '{answer}'");
            let mut camera = camera(folder.path(), &script, 20.0);
            let frame = camera.grab(KEY);
            (frame.map(|_| camera.stated_with_frame()), camera)
        };
        // 25 ms at gain 2 were requested, in steps of 1 ms.
        let (stated, mut whole) = of(r#"{"exposure_s": 0.0256, "serial": "A 3", "sensor_c": 31}"#);
        let stated = stated.unwrap();
        assert_eq!(stated.exposure, Some(Seconds(0.0256)));
        assert_eq!(stated.serial.as_deref(), Some("A 3"));
        assert_eq!(whole.temperature_c(), Some(31.0));
        let mut none = of("saved").1;
        assert_eq!(none.temperature_c(), None);
        assert_eq!(none.stated_with_frame(), Stated::default());
        // Another exposure or gain is a wrong frame, another camera an error at once.
        for wrong in [r#"{"exposure_s": 0.0271}"#, r#"{"gain": 1.0}"#] {
            let error = of(wrong).0.unwrap_err();
            assert!(
                matches!(
                    &error,
                    DeviceError::BadFrame {
                        fault: FrameFault::Settings { .. },
                        ..
                    }
                ),
                "{wrong}: {error}"
            );
        }
        let script = r#"cp $4/good.tif $3; echo "{\"serial\": \"$(date +%N)\"}""#;
        let mut swapped = camera(folder.path(), script, 20.0);
        swapped.grab(KEY).unwrap();
        assert!(matches!(
            swapped.grab(KEY),
            Err(DeviceError::OtherCamera { .. })
        ));
        assert!(matches!(of("{\"gain\"").0, Err(DeviceError::Answer { .. })));
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
        // One in its process group, and one that has left it and its parent.
        for start in [
            "sleep 600 & echo $! > $4/pid",
            "(setsid sh -c 'echo $$ > '$4'/pid; exec sleep 600' &)",
        ] {
            let script = format!("echo waiting >&2; {start}; sleep 600");
            let mut camera = camera(folder.path(), &script, 1.0);
            let began = Instant::now();
            let error = camera.grab(KEY).unwrap_err();
            assert!(matches!(error, DeviceError::NoReply { .. }), "{error}");
            assert!(error.to_string().contains("waiting"), "{error}");
            assert!(began.elapsed() < Duration::from_secs(60));
            assert_dies(&folder.path().join("pid"));
        }
    }

    fn assert_dies(file: &Path) {
        let pid = std::fs::read_to_string(file).unwrap();
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
