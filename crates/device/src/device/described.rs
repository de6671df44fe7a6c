//! Cameras that cannot be queried: the rig file describes them, and a program or a person
//! takes each frame with the settings that it is given.
//!
//! A driver is a [`FrameSource`], in a file of its own with a [`Driver`] that names it in rig
//! files, and a line in [`DRIVERS`](super::described_drivers::DRIVERS).

use std::ffi::OsStr;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use super::retake::FrameFault;
use super::{
    Camera, CameraInfo, CameraSettings, DeviceError, FrameKey, RawFrame, Stated, image_file,
    nearest_exposure, outside,
};
use crate::units::Seconds;

/// Opens a camera by what the rig file's setting names.
pub type Open = fn(&OsStr, Description) -> Result<Box<dyn Camera>, DeviceError>;

/// A driver as rig files name it.
#[derive(Debug)]
pub struct Driver {
    /// Value of `camera.driver`.
    pub name: &'static str,
    /// How `rig init` offers it while no camera of it is connected; empty where this build
    /// lacks it.
    pub offer: &'static str,
    /// Whether its frames are for practice, not for measurement: `rig init` says so.
    pub only_practice: bool,
    /// The one key of `[camera]` that is this driver's own.
    pub key: &'static str,
    /// What the key may be, as errors state it.
    pub allowed: &'static str,
    /// Whether the key is a path, relative to the rig file.
    pub is_path: bool,
    /// Whether the driver takes this value of the key.
    pub accepts: fn(&OsStr) -> bool,
    /// Where frames come from by this value, for a person; or why none can, as far as it
    /// shows without opening the camera: whether a file is there, a program can be run.
    pub ready: fn(&OsStr) -> Result<String, DeviceError>,
    /// Makes the camera of a value that it accepts.
    pub open: Open,
    /// The cameras that this driver can see now, without taking control of any; none where
    /// its program or library is not installed.
    pub find: fn() -> Result<Vec<FoundCamera>, DeviceError>,
}

/// A camera that a driver sees.
#[derive(Debug)]
pub struct FoundCamera {
    /// The value of the driver's key that opens this camera.
    pub address: String,
    /// Its model, as it reports it; empty where it does not.
    pub model: String,
    /// Its serial number; empty where it shows only once the camera is opened.
    pub serial: String,
    /// Why it cannot be opened.
    pub problem: Option<DeviceError>,
}

/// For drivers whose cameras cannot be looked for: programs and folders.
pub fn find_none() -> Result<Vec<FoundCamera>, DeviceError> {
    Ok(Vec::new())
}

impl PartialEq for Driver {
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name
    }
}

/// What a rig file says of such a camera, and what its driver may start.
pub struct Description {
    /// The camera; the driver states the model.
    pub info: CameraInfo,
    /// How long a frame may take beyond its exposure.
    pub timeout: Seconds,
    /// A process that ends the camera's program when this one is gone, see
    /// `command_camera::keep`.
    pub keeper: Option<Command>,
}

/// The frame that is wanted.
#[derive(Clone, Debug)]
pub struct Wanted {
    /// Counted from 1.
    pub number: u64,
    /// Exposure and gain to take it with.
    pub settings: CameraSettings,
    /// Exposure and time-out together.
    pub timeout: Seconds,
    /// When that is over.
    pub deadline: Instant,
    /// Width and height that the frame must have, pixels.
    pub resolution_px: [u32; 2],
    /// Significant bits that a count may have.
    pub bit_depth: u32,
}

impl Wanted {
    /// Reads the image file that holds it.
    ///
    /// # Errors
    /// The file is not such a frame.
    pub fn read(&self, path: &Path) -> Result<RawFrame, FrameFault> {
        image_file::read(path, self.resolution_px, self.bit_depth)
    }
}

/// A frame and what was reported with it.
#[derive(Clone, Debug)]
pub struct Taken {
    /// The counts.
    pub frame: RawFrame,
    /// What the source reports; nothing, where it cannot.
    pub stated: Stated,
}

impl From<RawFrame> for Taken {
    /// A frame with which nothing is reported.
    fn from(frame: RawFrame) -> Self {
        let stated = Stated::default();
        Self { frame, stated }
    }
}

/// How such a camera's frames are taken.
pub trait FrameSource: Clone + Send + 'static {
    /// What a frame that never comes was a reply to.
    const SENT: &'static str;

    /// What errors call the camera.
    fn name(&self) -> String;

    /// Takes a frame and returns by its deadline. It runs on a thread that is abandoned
    /// where a file system does not respond.
    ///
    /// # Errors
    /// No frame, or not one of this camera.
    fn take(&self, wanted: &Wanted) -> Result<Taken, DeviceError>;
}

/// A camera that cannot be queried.
#[derive(Clone, Debug)]
pub struct DescribedCamera<S> {
    source: S,
    info: CameraInfo,
    timeout: Seconds,
    settings: Option<CameraSettings>,
    frames: u64,
    /// Reported with the last frame.
    stated: Stated,
    /// Serial number that frames must have: the rig file's, or that of the first frame.
    serial: String,
}

impl<S: FrameSource> DescribedCamera<S> {
    /// A camera with these properties, whose frames may take `timeout` beyond their exposure.
    pub fn new(source: S, info: CameraInfo, timeout: Seconds) -> Self {
        Self {
            source,
            serial: info.serial.clone(),
            info,
            timeout,
            settings: None,
            frames: 0,
            stated: Stated::default(),
        }
    }
}

impl<S: FrameSource> DescribedCamera<S> {
    /// One camera takes all frames: that of the rig file's serial number, or the first.
    fn check_serial(&mut self, stated: &Stated) -> Result<(), DeviceError> {
        let Some(is) = &stated.serial else {
            return Ok(());
        };
        if self.serial.is_empty() {
            self.serial.clone_from(is);
        }
        if self.serial == *is {
            return Ok(());
        }
        Err(DeviceError::OtherCamera {
            device: self.source.name(),
            is: is.clone(),
            wanted: self.serial.clone(),
        })
    }
}

impl<S: FrameSource> Camera for DescribedCamera<S> {
    fn info(&self) -> &CameraInfo {
        &self.info
    }

    /// The values go with each frame; what the source reports with the frame shows whether
    /// they were applied, and where it reports nothing, the images alone.
    fn configure(&mut self, requested: CameraSettings) -> Result<CameraSettings, DeviceError> {
        let applied = CameraSettings::new(
            nearest_exposure(&self.info, requested.exposure),
            requested.gain,
        );
        self.settings = Some(applied);
        Ok(applied)
    }

    fn set_shutter(&mut self, _open: bool) -> Result<bool, DeviceError> {
        Ok(false)
    }

    fn grab(&mut self, _key: FrameKey) -> Result<RawFrame, DeviceError> {
        let device = self.source.name();
        let settings = self.settings.ok_or_else(|| DeviceError::Refused {
            device: device.clone(),
            command: "a frame".to_owned(),
            reason: "it is not configured".to_owned(),
        })?;
        self.frames += 1;
        let timeout = Seconds(settings.exposure.0 + self.timeout.0);
        let wanted = Wanted {
            number: self.frames,
            settings,
            timeout,
            deadline: Instant::now() + timeout.to_duration(),
            resolution_px: self.info.resolution_px,
            bit_depth: self.info.bit_depth,
        };
        let source = self.source.clone();
        let requested = wanted.settings;
        let sent = S::SENT;
        let taken = outside::frame_within(device, timeout, sent, move || source.take(&wanted))?;
        self.check_serial(&taken.stated)?;
        let step = self.info.exposure_step;
        taken
            .stated
            .check(requested, step)
            .map_err(|fault| DeviceError::BadFrame {
                device: self.source.name(),
                fault,
            })?;
        self.stated = taken.stated;
        Ok(taken.frame)
    }

    fn stated_with_frame(&self) -> Stated {
        self.stated.clone()
    }

    fn temperature_c(&mut self) -> Option<f64> {
        self.stated.sensor_c
    }

    fn longest_frame(&self, exposure: Seconds) -> Seconds {
        let handovers = 2 * outside::HANDOVER;
        Seconds(exposure.0 + self.timeout.0 + Duration::as_secs_f64(&handovers))
    }
}

/// A failure of the system, by what it means for a device.
pub(super) fn io_error(device: String, source: std::io::Error) -> DeviceError {
    match source.kind() {
        std::io::ErrorKind::NotFound => DeviceError::NotFound { device },
        std::io::ErrorKind::PermissionDenied => DeviceError::PermissionDenied { device },
        _ => DeviceError::Io { device, source },
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::device::{FrameKind, Mosaic};

    /// Any frame.
    pub const KEY: FrameKey = FrameKey::new(0, 0, 0, FrameKind::Light);

    /// A camera of 4 × 2 pixels and 12 bits, configured to `exposure_s` and `gain`.
    pub fn configured<S: FrameSource>(
        source: S,
        timeout_s: f64,
        exposure_s: f64,
        gain: f64,
    ) -> DescribedCamera<S> {
        let info = CameraInfo {
            driver: "described".to_owned(),
            model: source.name(),
            serial: String::new(),
            resolution_px: [4, 2],
            bit_depth: 12,
            mosaic: Mosaic::None,
            exposure_range: [Seconds(0.001), Seconds(30.0)],
            exposure_step: Seconds(0.001),
        };
        let mut camera = DescribedCamera::new(source, info, Seconds(timeout_s));
        let exposure = Seconds(exposure_s);
        camera.configure(CameraSettings { exposure, gain }).unwrap();
        camera
    }
}
