//! What goes wrong at a device; facts only.

#[cfg(target_os = "linux")]
use super::AnswerFault;
use super::{Speaker, retake};
use crate::units::{Seconds, StageAngles};

/// What went wrong at a device; facts only.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum DeviceError {
    /// There is no such port or device file.
    #[error("{device} does not exist")]
    NotFound { device: String },
    /// An address on a network where a serial port is wanted.
    #[error("{device} is an address on a network, and controllers there are not supported")]
    OnNetwork { device: String },
    /// The system refuses access.
    #[error("{device}: permission denied")]
    PermissionDenied { device: String },
    #[error("{device} is in use by another process")]
    Busy { device: String },
    #[error("another program has claimed the camera at {device}")]
    Claimed {
        /// Port as gphoto2 names it.
        device: String,
    },
    /// Another program controls a camera on the network.
    #[error("{device} is controlled by another program")]
    Controlled { device: String },
    #[error("this program was built without the driver of this camera")]
    WithoutDriver,
    #[error("{device} did not answer within {timeout} (sent {sent:?})")]
    NoReply {
        device: String,
        timeout: Seconds,
        sent: String,
    },
    /// There is something else than what is wanted.
    #[error("{device} is not a {wanted}: {why}")]
    WrongKind {
        device: String,
        wanted: &'static str,
        why: String,
    },
    /// What answers speaks another protocol.
    #[error("{device} answered {answer:?}: that is {speaks}, not {expected}")]
    OtherProtocol {
        device: String,
        answer: String,
        speaks: Speaker,
        expected: String,
    },
    /// The firmware is not, or not set up, as a stage needs it.
    #[error("{device}: {fault}")]
    Firmware {
        device: String,
        fault: FirmwareFault,
    },
    /// A program that takes the frames cannot be run.
    #[error("{program}: {fault}")]
    Program {
        program: String,
        fault: ProgramFault,
    },
    /// What a camera's program reports of a frame is not what may stand there.
    #[cfg(target_os = "linux")]
    #[error("{program}: {fault}")]
    Answer { program: String, fault: AnswerFault },
    #[error("{device} is the camera {is:?}, and {wanted:?} is wanted")]
    OtherCamera {
        device: String,
        is: String,
        /// Serial number of the rig file, or of the frames before.
        wanted: String,
    },
    /// A node of a camera that gives no images, such as that of its metadata.
    #[error("{device} gives no images{}", other_node(image_node.as_deref()))]
    NoImages {
        device: String,
        /// The node of the same camera that does, where one is found.
        image_node: Option<String>,
    },
    #[error(
        "none of the formats of {device} is uncompressed: it offers {}",
        offered_formats(offered)
    )]
    Compressed {
        device: String,
        offered: Vec<String>,
    },
    /// A webcam that its library cannot use, or not safely.
    #[error("{device}: {fault}")]
    Webcam { device: String, fault: WebcamFault },
    /// The system has no room for the stream on the camera's bus.
    #[error(
        "{device}: its USB bus has no bandwidth left for a stream of {width} × {height} pixels"
    )]
    NoBandwidth {
        device: String,
        width: u32,
        height: u32,
    },
    /// An answer that the protocol does not allow.
    #[error("{device} answered {answer:?}, which is not {expected}")]
    Garbled {
        device: String,
        answer: String,
        expected: String,
    },
    #[error("{device}: a frame cannot be used: {fault}")]
    BadFrame {
        device: String,
        fault: retake::FrameFault,
    },
    /// The device refused a command.
    #[error("{device} refused {command:?}: {reason}")]
    Refused {
        device: String,
        command: String,
        reason: String,
    },
    /// The device is in alarm: its position is unknown.
    #[error("{device} is in alarm: {reason}")]
    Alarm {
        device: String,
        cause: AlarmCause,
        reason: String,
    },
    /// A move was requested while the position is unknown.
    #[error("{device} has not been homed since {since}, so its position is unknown")]
    NotHomed { device: String, since: String },
    #[error("{device}: {target} is outside the limits ({limits})")]
    OutOfReach {
        device: String,
        target: StageAngles,
        limits: String,
    },
    #[error("{device}: {what} is {is} after {wanted} was commanded")]
    NotApplied {
        device: String,
        what: String,
        is: String,
        wanted: String,
    },
    /// Nothing can be put into the folder for temporary files.
    #[error("the folder for temporary files, {}: {source}", folder.display())]
    TemporaryFolder {
        /// As `TMPDIR` names it, or the system's own.
        folder: std::path::PathBuf,
        source: std::io::Error,
    },
    /// The guardian has taken the stage over, because it had received nothing from this
    /// process for longer than was announced.
    #[error(
        "{device}: the program gave no sign of life for longer than it had announced, \
         and its guardian has taken the stage over"
    )]
    Relieved { device: String },
    #[error("the guardian of {device} has ended or does not answer; the stage was stopped")]
    Unguarded { device: String },
    /// The device went away.
    #[error("{device} was disconnected")]
    Disconnected { device: String },
    /// Any other failure of the system.
    #[error("{device}: {source}")]
    Io {
        device: String,
        source: std::io::Error,
    },
}

impl DeviceError {
    /// Whether no answer came, or none that can be read: whatever is asked next may wait in vain.
    pub fn is_without_answer(&self) -> bool {
        matches!(self, Self::NoReply { .. } | Self::Garbled { .. })
    }

    /// Where a port is not named by a path but by the address of a controller on a network: a
    /// URL, a host with a port's number, or an IP address.
    pub fn of_address(port: &str) -> Option<Self> {
        let is_host = |host: &str| !host.is_empty() && !host.contains('/');
        let has_port =
            |(host, number): (&str, &str)| is_host(host) && number.parse::<u16>().is_ok();
        let is_url = port
            .split_once("://")
            .is_some_and(|(kind, _)| is_host(kind));
        let is_address =
            port.rsplit_once(':').is_some_and(has_port) || port.parse::<std::net::IpAddr>().is_ok();
        (is_url || is_address).then(|| Self::OnNetwork {
            device: port.to_owned(),
        })
    }
}

fn other_node(image_node: Option<&str>) -> String {
    match image_node {
        Some(node) => format!("; those of the same camera come from {node}"),
        None => String::new(),
    }
}

fn offered_formats(offered: &[String]) -> String {
    match offered {
        [] => "none at all".to_owned(),
        offered => offered.join(", "),
    }
}

/// What raises an alarm, as far as something else is to be done about it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AlarmCause {
    /// A limit switch was hit, or is closed.
    LimitSwitch,
    /// A target is beyond the travel that the firmware knows.
    SoftLimit,
    /// The switches were not found, or not left.
    Homing,
    /// An emergency stop or another control input is active.
    EmergencyStop,
    /// It waits to be homed.
    HomingRequired,
    /// Anything else.
    Other,
}

/// A firmware that is not, or not set up, as a stage needs it. Settings are those of GRBL.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)]
pub enum FirmwareFault {
    #[error("its firmware is {is}, and {needed} or later is needed")]
    Old { is: String, needed: &'static str },
    /// `$22=0`.
    #[error("it refused {command:?}: homing is not enabled ($22=0)")]
    HomingDisabled { command: String },
    /// No axis has a homing cycle (FluidNC, grblHAL).
    #[error("it refused {command:?}: no axis is set to be homed")]
    NothingToHome { command: String },
    /// `$32` is not 0.
    #[error("laser mode is on ($32={0}), which switches the lamp with the motion")]
    LaserMode(f64),
    /// `$13` is not 0.
    #[error("positions are reported in inches ($13={0})")]
    Inches(f64),
    #[error("its status reports have no position: neither MPos, nor WPos and WCO")]
    NoPosition,
    /// Fewer axes than the stage uses.
    #[error("its status reports have {axes} axes, and axis {letter} is needed")]
    NoAxis { axes: usize, letter: char },
    #[error("the safety door input is open, or was opened and not confirmed since (Door:{0})")]
    Door(u8),
    #[error("it is held and takes no command (Hold:{0})")]
    Held(u8),
    /// `$SLP`, or a sleep timer.
    #[error("it sleeps and takes no command until it is reset (Sleep)")]
    Asleep,
    /// FluidNC could not read its configuration file.
    #[error("its configuration is faulty, and it moves nothing ({0})")]
    Configuration(String),
    #[error("it restarts again and again, because its supply voltage falls ({0:?})")]
    Undervoltage(String),
    /// The firmware restarts for another reason.
    #[error("it restarts instead of answering ({0:?})")]
    Restarting(String),
    /// A command that this build lacks.
    #[error("it refused {command:?}: {reason}")]
    Unsupported { command: String, reason: String },
}

/// Why a webcam cannot be used through nokhwa.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs)]
pub enum WebcamFault {
    #[error("nokhwa gets no YUYV frames of {width} × {height} pixels from it: {said}")]
    NoFormat {
        width: u32,
        height: u32,
        said: String,
    },
    /// Damaged frames would look like whole ones.
    #[error(
        "uvcvideo hands damaged frames over (its parameter nodrop is {nodrop:?}, not 0), \
         and nokhwa does not report which are"
    )]
    DamageUnseen {
        /// The parameter's value; empty where it cannot be read.
        nodrop: String,
    },
}

/// Why a program cannot be run.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs)]
pub enum ProgramFault {
    /// There is none of this name.
    #[error("there is no such program{}", if *looked_in_path { " in PATH" } else { "" })]
    Missing {
        /// The name has no `/`.
        looked_in_path: bool,
    },
    #[error("it may not be executed (mode {mode:04o})")]
    NotExecutable { mode: u32 },
    /// Its folder may not be entered, or its file system allows no programs.
    #[error("the system does not let it be executed (permission denied)")]
    Denied,
    /// It is a folder.
    #[error("it is a folder")]
    Folder,
    #[error(
        "its first line ends with a carriage return, so that its interpreter is sought as {interpreter:?}"
    )]
    WindowsLineEnds { interpreter: String },
    /// What its first line names does not exist or may not be executed.
    #[error("its interpreter {interpreter:?} cannot be run")]
    NoInterpreter { interpreter: String },
    #[error("it is a program for another system: the loader that it names does not exist")]
    NoLoader,
    #[error("it is neither a program for this processor nor a script that begins with #!")]
    NotAProgram,
    /// The loader found no library (exit code 127).
    #[error("it could not be loaded: {said}")]
    NoLibrary { said: String },
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_told_from_paths() {
        for (port, expected) in [
            ("socket://192.168.1.50:23", true),
            ("rfc2217://bench:2217", true),
            ("192.168.1.50:23", true),
            ("fluidnc.local:23", true),
            ("[fe80::1]:23", true),
            ("192.168.1.50", true),
            ("fe80::1", true),
            ("/dev/serial/by-path/pci-0000:00:14.0-usb-0:2:1.0", false),
            ("/dev/tty:23", false),
            ("tty", false),
            ("COM3:", false),
        ] {
            let is_address = DeviceError::of_address(port).is_some();
            assert_eq!(is_address, expected, "{port}");
        }
    }
}
