//! Cameras and light stages: the two traits, what crosses them, and one file
//! per protocol.
//!
//! Drivers block; each is owned by one thread. A driver returns what happened
//! (read back from the device), never what was requested.

#[cfg(target_os = "linux")]
pub mod by_hand;
#[cfg(target_os = "linux")]
pub mod command_camera;
pub mod controls;
pub mod described;
pub mod described_drivers;
#[cfg(target_os = "linux")]
pub mod discovery;
pub mod dome;
mod error;
pub mod even_light;
#[cfg(target_os = "linux")]
pub mod folder_camera;
pub mod frame_figures;
pub mod frame_row;
#[cfg(feature = "genicam")]
pub mod genicam;
#[cfg(target_os = "linux")]
pub mod gphoto2;
pub mod grbl;
#[cfg(target_os = "linux")]
pub mod guardian;
pub mod image_file;
pub mod kinematics;
pub mod lit_card;
pub mod manual;
#[cfg(any(feature = "v4l", feature = "webcam"))]
pub mod manual_settings;
pub mod outside;
pub mod pixel_format;
pub mod retake;
#[cfg(feature = "serial")]
pub mod serial_line;
#[cfg(feature = "serial")]
mod shared_line;
#[cfg(feature = "serial")]
pub mod simulated;
pub mod simulated_camera;
#[cfg(feature = "serial")]
pub mod simulated_hand;
mod speaker;
pub mod stated;
#[cfg(any(feature = "v4l", feature = "webcam"))]
mod system_error;
pub mod temperature;
#[cfg(feature = "v4l")]
pub mod v4l;
#[cfg(feature = "webcam")]
pub mod webcam;
pub mod zaber;

use std::time::Duration;

use crate::units::{Seconds, StageAngles};
use serde::{Deserialize, Serialize};

#[cfg(target_os = "linux")]
pub use self::command_camera::AnswerFault;
pub use self::error::{AlarmCause, DeviceError, FirmwareFault, ProgramFault, WebcamFault};
pub use self::speaker::Speaker;
pub use self::stated::Stated;
pub use crate::radiometry::mosaic::Mosaic;

/// Which part of the lamp is lit. A lamp of one colour has one channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(transparent)]
pub struct LampChannel(pub u8);

/// The lamp's state: dark, or one channel lit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LampState {
    /// No light.
    Off,
    /// This channel at its configured power, the others off.
    On(LampChannel),
}

impl std::fmt::Display for LampState {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Off => f.write_str("off"),
            Self::On(channel) => write!(f, "channel {}", channel.0),
        }
    }
}

/// What the stage is doing, as it reports itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum StageActivity {
    /// Standing still, position known.
    Idle,
    /// Moving to a target.
    Moving,
    /// Searching its reference switches.
    Homing,
    /// Motion paused.
    Held,
    /// Refuses to move until it is homed or unlocked; the position is unknown.
    Alarm,
}

/// A stage's read-back.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StageStatus {
    /// What it is doing.
    pub activity: StageActivity,
    /// Where it is; `None` while unknown (not homed, after an alarm or a reset).
    pub position: Option<StageAngles>,
    /// The lamp, as far as the device reports it.
    pub lamp: Option<LampState>,
}

/// What a stage is and can reach.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StageInfo {
    /// The driver's name, e.g. `grbl`.
    pub driver: String,
    /// Firmware version as the device gives it.
    pub firmware: String,
    /// The port, by a stable name where there is one.
    pub port: String,
    /// Whether the firmware turns the lamp off by itself when the host is lost.
    pub has_watchdog: bool,
}

/// Where the reference switches were found against where they should have been.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReferenceCheck {
    /// Found minus expected of each axis, degrees or mm as the axis has it.
    pub off: [f64; 2],
    /// What the stage's position tolerance allows, in the same units.
    pub allowed: f64,
}

impl ReferenceCheck {
    /// Whether an axis has lost steps: a distance that is no number counts too.
    pub fn is_off(&self) -> bool {
        self.off.iter().any(|off| {
            let distance = off.abs();
            distance.is_nan() || distance > self.allowed
        })
    }
}

/// What a stage does, by how long it may take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StageStep {
    /// Seeking the reference switches.
    Home,
    /// Moving to a target.
    Move,
    /// Switching the lamp.
    Lamp,
    /// Reporting its state.
    Query,
}

impl StageStep {
    /// How long it takes at most on two axes: `homing` and `whole` are the time-outs of a
    /// homing and of a move over all of the travel, `reply` that of a reply, of which a query
    /// takes `replies`.
    #[cfg(feature = "serial")]
    fn longest(self, homing: Duration, whole: Duration, reply: Duration, replies: u32) -> Duration {
        match self {
            Self::Home => homing + 2 * replies * reply,
            // To where the approach begins, and on.
            Self::Move => 2 * (2 * whole + replies * reply + Duration::from_secs(1)),
            Self::Lamp => 4 * reply,
            Self::Query => replies * reply,
        }
    }
}

/// A lamp on a movable (or switchable) mount.
///
/// After an alarm, reset, timeout or reconnect the position is unknown and
/// `move_to` refuses until `home` succeeds. Connecting never moves anything.
pub trait LightStage: Send {
    /// What was found at connection.
    fn info(&self) -> &StageInfo;
    /// Finds the reference switches; on success the position is known.
    fn home(&mut self) -> Result<StageStatus, DeviceError>;
    /// Moves, approaching each axis from one side, waits until the stage stands,
    /// and returns the position it reports.
    fn move_to(&mut self, target: StageAngles) -> Result<StageAngles, DeviceError>;
    /// Switches the lamp and returns the state the device reports.
    fn set_lamp(&mut self, lamp: LampState) -> Result<LampState, DeviceError>;
    /// Queries the device.
    fn status(&mut self) -> Result<StageStatus, DeviceError>;
    /// Whether the device reports if its lamp is lit. Where it does not, that it is off is
    /// sent and not verified.
    fn reports_lamp(&self) -> bool {
        false
    }
    /// The lamp's temperature now, °C; `None` where the device does not report. A reading
    /// that fails is none: nothing depends on it but a limit.
    fn temperature_c(&mut self) -> Option<f64> {
        None
    }
    /// Seeks the reference switches anew, keeping the count of steps, and says
    /// how far off that was: steps lost since the last homing. The stage stands
    /// at its switches afterwards. `None` where the device cannot tell.
    fn check_reference(&mut self) -> Result<Option<ReferenceCheck>, DeviceError> {
        Ok(None)
    }
    /// A handle that stops motion and lamp from another thread, also while this
    /// one waits for a reply.
    fn stop_handle(&self) -> Result<Box<dyn StopHandle>, DeviceError>;
    /// How long a step of this kind takes at most until it ends or fails: what the
    /// driver's own time-outs come to.
    fn longest(&self, step: StageStep) -> Duration {
        match step {
            StageStep::Home | StageStep::Move => Duration::from_secs(600),
            StageStep::Lamp | StageStep::Query => Duration::from_secs(10),
        }
    }
    /// Who watches over the thread that uses this stage; by default nobody.
    #[cfg(target_os = "linux")]
    fn watchdog(&self) -> guardian::Watchdog {
        guardian::Watchdog::default()
    }
    /// How another process stops this stage over its open port when this process
    /// is gone; `None` where there is no such way.
    #[cfg(target_os = "linux")]
    fn port_stop(&self) -> Result<Option<guardian::PortStop>, DeviceError> {
        Ok(None)
    }
}

/// Stops a stage without its driver's thread.
pub trait StopHandle: Send {
    /// Motion halted at once and lamp off, both as the device then reports itself.
    /// Afterwards the position is unknown.
    fn stop(&mut self) -> Result<(), DeviceError>;
}

/// Settings of a camera. Requested ones go in, applied ones come back.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraSettings {
    /// Time during which a frame collects light.
    pub exposure: Seconds,
    /// Analogue gain, as a factor; 1 is the camera's lowest.
    pub gain: f64,
}

impl CameraSettings {
    /// An exposure at a gain.
    pub const fn new(exposure: Seconds, gain: f64) -> Self {
        Self { exposure, gain }
    }
}

/// What a camera is and can do.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraInfo {
    /// The driver's name, e.g. `v4l`.
    pub driver: String,
    /// Model as the device gives it.
    pub model: String,
    /// Serial number; empty if the device has none.
    pub serial: String,
    /// Width and height of a frame, pixels.
    pub resolution_px: [u32; 2],
    /// Significant bits of a raw count.
    pub bit_depth: u32,
    /// Colour filters.
    pub mosaic: Mosaic,
    /// Shortest and longest exposure of one frame.
    pub exposure_range: [Seconds; 2],
    /// Smallest step of the exposure.
    pub exposure_step: Seconds,
}

/// What a frame is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FrameKind {
    /// Lamp on.
    Light,
    /// Lamp off, shutter open: the room's own light.
    Ambient,
    /// No light reaches the sensor.
    Dark,
}

/// The place of a frame in a capture; a simulated camera keys its noise by it,
/// a real one ignores it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct FrameKey {
    /// Index of the light direction in the plan.
    pub light: u32,
    /// Index of the bracket entry (lamp channel and exposure) in the plan.
    pub exposure: u32,
    /// Repeat at the same settings.
    pub repeat: u32,
    /// Light, ambient or dark.
    pub kind: FrameKind,
}

impl FrameKey {
    /// A frame of a light, the index of its exposure, and which repeat it is.
    pub const fn new(light: u32, exposure: u32, repeat: u32, kind: FrameKind) -> Self {
        Self {
            light,
            exposure,
            repeat,
            kind,
        }
    }
}

/// Raw counts as the sensor gave them.
#[derive(Clone, Debug, PartialEq)]
pub struct RawFrame {
    /// Pixels per row.
    pub width: u32,
    /// Rows; row 0 is the top.
    pub height: u32,
    /// `width * height` raw counts, DN, row by row.
    pub counts: Vec<u16>,
    /// The device's running number, where it has one: a gap is a dropped frame.
    pub sequence: Option<u64>,
    /// Device time of the frame's start on its own monotonic clock, seconds, where it has one.
    pub timestamp: Option<Seconds>,
}

impl RawFrame {
    /// Counts of a device that numbers and times no frames.
    pub const fn new(width: u32, height: u32, counts: Vec<u16>) -> Self {
        Self {
            width,
            height,
            counts,
            sequence: None,
            timestamp: None,
        }
    }
}

/// A camera under manual control.
pub trait Camera: Send {
    /// What was found at connection.
    fn info(&self) -> &CameraInfo;
    /// Sets manual mode and the settings, and returns those read back. Frames
    /// already under way keep the old ones.
    fn configure(&mut self, requested: CameraSettings) -> Result<CameraSettings, DeviceError>;
    /// Closes or opens the shutter for dark frames. `Ok(false)`: the camera has
    /// none, and somebody must cover the lens or dark frames are taken with the
    /// lamp off.
    fn set_shutter(&mut self, open: bool) -> Result<bool, DeviceError>;
    /// The next frame that begins after this call. A frame that is not right is
    /// [`DeviceError::BadFrame`]; [`retake::grab_right`] takes it again.
    fn grab(&mut self, key: FrameKey) -> Result<RawFrame, DeviceError>;
    /// What the camera reported with the last frame of [`grab`](Self::grab), where it does
    /// so: that frame's settings are these and not those that `configure` returned.
    fn stated_with_frame(&self) -> Stated {
        Stated::default()
    }
    /// The sensor's temperature now, °C; `None` where the device does not report. A reading
    /// that fails is none.
    fn temperature_c(&mut self) -> Option<f64> {
        None
    }
    /// Frames that the device's running numbers have shown to be lost so far,
    /// each while one was waited for.
    fn frames_lost(&self) -> u64 {
        0
    }
    /// How long [`grab`](Self::grab) takes at most at this exposure until it returns
    /// or fails.
    fn longest_frame(&self, exposure: Seconds) -> Seconds {
        Seconds(2.0 * exposure.0.max(0.0) + 10.0)
    }
    /// Least time between frames of a live picture: a mechanical shutter wears.
    fn least_period(&self) -> Duration {
        Duration::ZERO
    }
    /// How long a camera that went away is worth waiting for; 0: it cannot come back.
    fn may_return_within(&self) -> Seconds {
        Seconds(0.0)
    }
    /// Finds the same device again, by its serial number, after
    /// [`DeviceError::Disconnected`]. Afterwards it is to be configured anew.
    ///
    /// # Errors
    /// [`DeviceError::Disconnected`] while it is not there.
    fn reconnect(&mut self) -> Result<(), DeviceError> {
        Err(DeviceError::Disconnected {
            device: self.info().model.clone(),
        })
    }
}

/// The exposure of the camera's range and step that is nearest to the one requested.
fn nearest_exposure(info: &CameraInfo, wanted: Seconds) -> Seconds {
    let [shortest, longest] = info.exposure_range;
    let steps = (wanted.0 / info.exposure_step.0).round();
    Seconds(
        (steps * info.exposure_step.0)
            .max(shortest.0)
            .min(longest.0),
    )
}
