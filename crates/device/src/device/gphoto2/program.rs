//! The program `gphoto2`: how it is run, and what its failures mean.

use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus};
use std::time::{Duration, Instant};

use super::output::{
    Setting, complaint, has_error, is_busy, one_line, parse_detected, parse_settings,
};
use crate::device::command_camera::{Workplace, how_it_ended};
use crate::device::{DeviceError, ProgramFault};
use crate::units::Seconds;

/// The program.
pub(super) const GPHOTO2: &str = "gphoto2";
/// So long may a question about settings take, and setting them.
pub(super) const SETTINGS_TIME: Duration = Duration::from_secs(20);
/// A body that is busy is asked again after this, so many times.
const BUSY_PAUSE: Duration = Duration::from_millis(300);
const BUSY_TRIES: u32 = 5;
/// libgphoto2's driver for bodies on a network, which detection does not find.
const NETWORK_DRIVER: &str = "PTP/IP Camera";

/// `gphoto2` for one body.
#[derive(Clone, Debug)]
pub(super) struct Gphoto {
    /// The body's port, as gphoto2 names it.
    pub(super) port: String,
}

/// Bodies that gphoto2 detects: model and port.
pub(super) fn detect(workplace: &Workplace) -> Result<Vec<(String, String)>, DeviceError> {
    let mut command = Command::new(GPHOTO2);
    command.env("LC_ALL", "C").arg("--auto-detect");
    let ended = workplace.run(command, Instant::now() + SETTINGS_TIME)?;
    let usb = Gphoto {
        port: "USB".to_owned(),
    };
    match ended.status {
        Some(status) if status.success() => Ok(parse_detected(&ended.stdout)),
        Some(status) => Err(usb.error(&["--auto-detect"], &complaint(&ended.stderr), status)),
        None => Err(usb.no_reply(&["--auto-detect"], SETTINGS_TIME)),
    }
}

impl Gphoto {
    /// The names of all settings, whole paths.
    pub(super) fn names(&self, workplace: &Workplace) -> Result<Vec<String>, DeviceError> {
        let text = self.run(workplace, &["--list-config"], SETTINGS_TIME)?;
        let paths = text.lines().filter(|line| line.starts_with('/'));
        Ok(paths.map(str::to_owned).collect())
    }

    /// These settings, in their order.
    pub(super) fn get(
        &self,
        workplace: &Workplace,
        names: &[&str],
    ) -> Result<Vec<Setting>, DeviceError> {
        let arguments: Vec<&str> = names
            .iter()
            .flat_map(|&name| ["--get-config", name])
            .collect();
        let text = self.run(workplace, &arguments, SETTINGS_TIME)?;
        let settings = parse_settings(&text);
        if settings.len() != names.len() {
            return Err(DeviceError::Garbled {
                device: self.port.clone(),
                answer: text.chars().take(200).collect(),
                expected: format!("the settings {}", names.join(", ")),
            });
        }
        Ok(settings)
    }

    /// Sets these, in their order, and returns them as they are afterwards.
    pub(super) fn set(
        &self,
        workplace: &Workplace,
        values: &[(&str, &str)],
    ) -> Result<Vec<Setting>, DeviceError> {
        let assignments: Vec<String> = values
            .iter()
            .map(|(name, value)| format!("{name}={value}"))
            .collect();
        let arguments: Vec<&str> = assignments
            .iter()
            .flat_map(|assignment| ["--set-config-value", assignment])
            .collect();
        self.run(workplace, &arguments, SETTINGS_TIME)?;
        let names: Vec<&str> = values.iter().map(|(name, _)| *name).collect();
        self.get(workplace, &names)
    }

    /// Takes a frame into `folder` and returns its raw file; the body keeps none.
    pub(super) fn capture(
        &self,
        workplace: &Workplace,
        folder: &Path,
        time: Duration,
    ) -> Result<PathBuf, DeviceError> {
        let pattern = folder.join("frame.%C");
        let pattern = pattern.to_string_lossy();
        let arguments = [
            "--capture-image-and-download",
            "--force-overwrite",
            "--filename",
            &pattern,
        ];
        let text = self.run(workplace, &arguments, time)?;
        let is_developed = |path: &Path| {
            let ending = path.extension().and_then(|ending| ending.to_str());
            ending.is_some_and(|ending| {
                ["jpg", "jpeg", "heic", "heif", "hif"]
                    .contains(&ending.to_ascii_lowercase().as_str())
            })
        };
        let files = std::fs::read_dir(folder).into_iter().flatten().flatten();
        let files: Vec<PathBuf> = files.map(|entry| entry.path()).collect();
        let raw = files.iter().find(|path| !is_developed(path));
        raw.cloned().ok_or_else(|| DeviceError::Refused {
            device: self.port.clone(),
            command: "--capture-image-and-download".to_owned(),
            reason: match files.is_empty() {
                true => format!("no file came: {}", one_line(&text)),
                false => "it gave a JPEG file and no raw file".to_owned(),
            },
        })
    }

    /// Runs gphoto2; a busy body is asked again.
    fn run(
        &self,
        workplace: &Workplace,
        arguments: &[&str],
        time: Duration,
    ) -> Result<String, DeviceError> {
        let deadline = Instant::now() + time;
        let mut tries = 0;
        loop {
            let mut command = Command::new(GPHOTO2);
            // Its messages are read, so they are not to be translated.
            command.env("LC_ALL", "C").args(["--port", &self.port]);
            if self.port.starts_with("ptpip:") {
                command.args(["--camera", NETWORK_DRIVER]);
            }
            command.args(arguments);
            let ended = workplace.run(command, deadline)?;
            let complaint = complaint(&ended.stderr);
            let Some(status) = ended.status else {
                return Err(self.no_reply(arguments, time));
            };
            // Some failures end with code 0.
            if status.success() && !has_error(&ended.stderr) {
                return Ok(ended.stdout);
            }
            tries += 1;
            if is_busy(&complaint) && tries < BUSY_TRIES && Instant::now() < deadline {
                std::thread::sleep(BUSY_PAUSE);
                continue;
            }
            return Err(self.error(arguments, &complaint, status));
        }
    }

    fn no_reply(&self, arguments: &[&str], time: Duration) -> DeviceError {
        DeviceError::NoReply {
            device: self.port.clone(),
            timeout: Seconds(time.as_secs_f64()),
            sent: arguments.join(" "),
        }
    }

    /// What a complaint of gphoto2 means.
    fn error(&self, arguments: &[&str], complaint: &str, status: ExitStatus) -> DeviceError {
        let device = self.port.clone();
        let has = |words: &[&str]| words.iter().any(|word| complaint.contains(word));
        if has(&["Could not claim", "-53:"]) {
            return DeviceError::Claimed { device };
        }
        if has(&["error while loading shared libraries"]) {
            return DeviceError::Program {
                program: GPHOTO2.to_owned(),
                fault: ProgramFault::NoLibrary {
                    said: complaint.to_owned(),
                },
            };
        }
        // No device there, or the connection broke. While a frame is taken gphoto2 names no
        // number.
        if has(&[
            "-52:",
            "-105:",
            "-7:",
            "error occurred in the io-library",
            "No camera found",
            "Could not detect",
        ]) {
            return DeviceError::Disconnected { device };
        }
        DeviceError::Refused {
            device,
            command: arguments.join(" "),
            reason: match (complaint, status.code()) {
                ("", _) => format!("gphoto2: {}", how_it_ended(status)),
                (complaint, None) => format!("{}, and wrote: {complaint}", how_it_ended(status)),
                (complaint, Some(_)) => complaint.to_owned(),
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::process::ExitStatusExt;

    use super::*;

    #[test]
    fn complaints_are_told_apart() {
        let gphoto = Gphoto {
            port: "usb:001,004".to_owned(),
        };
        let ended = |text: &str, status: i32| {
            let status = ExitStatus::from_raw(status);
            gphoto.error(&["--list-config"], &complaint(text), status)
        };
        let error = |text: &str| ended(text, 1 << 8);
        let claimed = "\n*** Error ***\nAn error occurred in the io-library ('Could not claim the USB device'): Could not claim interface 0 (Device or resource busy).\n*** Error (-53: 'Could not claim the USB device') ***\n\nFor debugging messages, please use";
        assert!(matches!(error(claimed), DeviceError::Claimed { .. }));
        let gone = "*** Error: No camera found. ***\n\n";
        assert!(matches!(error(gone), DeviceError::Disconnected { .. }));
        let other =
            "*** Error ***\nshutterspeed not found in configuration tree.\n*** Error (-1 'x')\n";
        match error(other) {
            DeviceError::Refused { reason, .. } => {
                assert!(reason.contains("not found"), "{reason}")
            }
            other => panic!("{other}"),
        }
        for (text, status, reason) in [
            ("", 3 << 8, "gphoto2: it ended with exit code 3"),
            ("", 9, "gphoto2: signal 9 ended it"),
            ("a note", 11, "signal 11 ended it, and wrote: a note"),
        ] {
            let error = ended(text, status).to_string();
            assert!(error.ends_with(reason), "{error}");
        }
        assert!(is_busy("PTP Device Busy") && !is_busy(&complaint(claimed)));
    }
}
