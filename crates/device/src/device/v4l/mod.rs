//! Frames from a Video4Linux camera.
//!
//! Exposure goes through `V4L2_CID_EXPOSURE_ABSOLUTE` (steps of 100 µs), which
//! UVC cameras have. Everything automatic is switched off first and every
//! setting is read back.

mod control_port;
mod negotiation;
mod ring;

use std::io;
use std::path::Path;
use std::time::{Duration, Instant};

use v4l::Device;
use v4l::buffer::Flags;
use v4l::capability::Flags as Capability;

use super::controls::{self, ControlInfo, ControlPort, TemperatureControl};
use super::discovery::{self, DeviceKind};
use super::frame_row::PreviousFrame;
use super::manual_settings::ManualSettings;
use super::pixel_format::PixelFormat;
use super::retake::FrameFault;
use super::system_error::{device_error, stream_error};
use super::{Camera, CameraInfo, CameraSettings, DeviceError, FrameKey, RawFrame};
use crate::units::Seconds;
use ring::{BUFFERS, LossCounter, Ring, began_after, monotonic_now, timestamp};

/// A camera as its driver needs it.
#[derive(Clone, Debug, PartialEq)]
pub struct V4lConfig {
    /// Path, best below `/dev/v4l/by-id`.
    pub device: String,
    /// The USB serial number that the device must have; `None`: any.
    pub serial: Option<String>,
    /// Pixel format by its four-character code; `None`: the deepest raw one, or
    /// the one that fits `bit_depth` best.
    pub format: Option<[u8; 4]>,
    /// Whether a format that is good for a preview alone may be taken.
    pub preview: bool,
    /// Significant bits of a sample where they are fewer than the format has
    /// room for, as of a 12-bit sensor in `Y16`; `None`: all.
    pub bit_depth: Option<u32>,
    /// Width and height, pixels; `None`: as the camera is set.
    pub resolution_px: Option<[u32; 2]>,
    /// Further controls, by id, and their values.
    pub controls: Vec<(u32, i64)>,
    /// The control that says the sensor's temperature, and how many °C a count of it is.
    pub temperature: Option<TemperatureControl>,
    /// How long a frame may take beyond its exposure.
    pub frame_timeout: Seconds,
    /// How long it is waited for after it was unplugged.
    pub return_timeout: Seconds,
    /// Whether a camera may be opened whose exposure cannot be set, for a look
    /// at it: its exposures are then NaN.
    pub any_exposure: bool,
}

impl V4lConfig {
    /// Whatever camera is at this path, as it is set.
    pub fn of_device(device: &str) -> Self {
        Self {
            device: device.to_owned(),
            serial: None,
            format: None,
            preview: false,
            bit_depth: None,
            resolution_px: None,
            controls: Vec::new(),
            temperature: None,
            frame_timeout: Seconds(5.0),
            return_timeout: Seconds(0.0),
            any_exposure: false,
        }
    }
}

/// ENOTTY: what answers is no Video4Linux device.
const NOT_THIS_KIND: i32 = 25;

/// What a node that gives images says it can do, by one of the kernel's two interfaces.
const IMAGES: Capability = Capability::VIDEO_CAPTURE.union(Capability::VIDEO_CAPTURE_MPLANE);

/// A camera that streams frames.
pub struct V4lCamera {
    config: V4lConfig,
    info: CameraInfo,
    /// First of the two, because it is dropped first.
    ring: Ring,
    device: Device,
    format: PixelFormat,
    stride: u32,
    manual: ManualSettings,
    /// Id, and °C per count.
    temperature: Option<(u32, f64)>,
    settings: Option<CameraSettings>,
    previous: Option<PreviousFrame>,
    frames_lost: u64,
}

impl V4lCamera {
    /// Opens the camera and sets its format. No frame is taken.
    ///
    /// # Errors
    /// Facts about the device, its serial number, its formats or its controls.
    pub fn open(config: V4lConfig) -> Result<Self, DeviceError> {
        let failed = |error| device_error(&config.device, error);
        if config.device.contains('\0') {
            return Err(failed(io::ErrorKind::NotFound.into()));
        }
        // The node, which must give images.
        let device = Device::with_path(&config.device).map_err(failed)?;
        let capabilities = device.query_caps().map_err(|error| {
            if error.raw_os_error() == Some(NOT_THIS_KIND) {
                return DeviceError::WrongKind {
                    device: config.device.clone(),
                    wanted: "camera",
                    why: error.to_string(),
                };
            }
            failed(error)
        })?;
        if !capabilities.capabilities.intersects(IMAGES) {
            let node = Path::new(&config.device);
            return Err(DeviceError::NoImages {
                device: config.device.clone(),
                image_node: discovery::first_node(Path::new("/"), node)
                    .map(|node| node.display().to_string()),
            });
        }
        // The camera, by its serial number.
        let serial = discovery::serial_of_camera(Path::new("/"), Path::new(&config.device));
        if let Some(wanted) = &config.serial
            && serial.as_ref() != Some(wanted)
        {
            return Err(DeviceError::NotApplied {
                device: config.device.clone(),
                what: "the camera's serial number".to_owned(),
                is: serial.unwrap_or_else(|| "none".to_owned()),
                wanted: wanted.clone(),
            });
        }
        // Format and controls.
        let (format, resolution_px, stride) = negotiation::set_format(&device, &config)?;
        let manual = ManualSettings::of(&device).map_err(failed)?;
        if !manual.has_exposure() && !config.any_exposure {
            return Err(DeviceError::Refused {
                device: config.device.clone(),
                command: "EXPOSURE_ABSOLUTE".to_owned(),
                reason: "the camera has no such control, so exposures cannot be set".to_owned(),
            });
        }
        let temperature = match &config.temperature {
            None => None,
            Some(wanted) => {
                let found = controls::find(&device, &wanted.name).map_err(failed)?;
                let found = found.ok_or_else(|| DeviceError::Refused {
                    device: config.device.clone(),
                    command: format!("control {:?}", wanted.name),
                    reason: "the camera has no such control".to_owned(),
                })?;
                Some((found.id, wanted.unit_c))
            }
        };
        // What it can do.
        let (exposure_range, exposure_step) = manual.exposures();
        let info = CameraInfo {
            driver: "v4l".to_owned(),
            model: capabilities.card,
            serial: serial.unwrap_or_default(),
            resolution_px,
            bit_depth: format.bits,
            mosaic: format.mosaic,
            exposure_range,
            exposure_step,
        };
        Ok(Self {
            config,
            info,
            ring: Ring::of_driver(&capabilities.driver),
            device,
            format,
            stride,
            manual,
            temperature,
            settings: None,
            previous: None,
            frames_lost: 0,
        })
    }

    /// The format that was agreed on.
    pub fn format(&self) -> PixelFormat {
        self.format
    }

    fn refused(&self, command: &str, reason: String) -> DeviceError {
        DeviceError::Refused {
            device: self.config.device.clone(),
            command: command.to_owned(),
            reason,
        }
    }

    /// The same camera, wherever it is plugged in now.
    fn find_again(&self) -> Result<Self, DeviceError> {
        let gone = || DeviceError::Disconnected {
            device: self.config.device.clone(),
        };
        let serial = &self.info.serial;
        let mut places = vec![self.config.device.clone()];
        // Without a serial number only the same place can be the same camera.
        if !serial.is_empty() {
            let found = discovery::find_devices(Path::new("/"));
            let same = found
                .iter()
                .filter(|device| device.kind == DeviceKind::Camera && device.serial == *serial)
                .filter(|device| device.first_node.is_none());
            places.extend(same.map(|device| device.path.display().to_string()));
        }
        let expected = |camera: &Self| {
            // A device's name may change with its place, the rest may not.
            let model = self.info.model.clone();
            let found = camera.info.clone();
            CameraInfo { model, ..found } == self.info
        };
        let config = |device| V4lConfig {
            device,
            serial: (!serial.is_empty()).then(|| serial.clone()),
            ..self.config.clone()
        };
        places
            .into_iter()
            .filter_map(|place| Self::open(config(place)).ok())
            .find(expected)
            .ok_or_else(gone)
    }
}

/// Every control of the device at this path, with its range and value.
///
/// # Errors
/// Facts about opening and asking the device.
pub fn controls_of(device: &str) -> Result<Vec<ControlInfo>, DeviceError> {
    let failed = |error| device_error(device, error);
    let port = Device::with_path(device).map_err(failed)?;
    controls::list(&port).map_err(failed)
}

impl Camera for V4lCamera {
    fn info(&self) -> &CameraInfo {
        &self.info
    }

    fn configure(&mut self, requested: CameraSettings) -> Result<CameraSettings, DeviceError> {
        self.settings = None;
        self.previous = None;
        let name = &self.config.device;
        let failed = |error| device_error(name, error);
        let wanted = &self.config.controls;
        let settings = self
            .manual
            .apply(&self.device, name, wanted, requested, &failed)?;
        self.settings = Some(settings);
        Ok(settings)
    }

    /// Cameras have no shutter that Video4Linux could close.
    fn set_shutter(&mut self, _open: bool) -> Result<bool, DeviceError> {
        Ok(false)
    }

    fn grab(&mut self, key: FrameKey) -> Result<RawFrame, DeviceError> {
        let Some(CameraSettings { exposure, .. }) = self.settings else {
            let reason = "its settings are automatic or unknown until it is configured";
            return Err(self.refused("a frame", reason.to_owned()));
        };
        // NaN where nobody knows it: 0 then.
        let exposure = Seconds(exposure.0.max(0.0));
        // Since when neither lamp nor settings have changed.
        let asked = monotonic_now();
        let previous = self.previous.take();
        let since = previous
            .and_then(|previous| previous.unchanged_since(key, asked))
            .unwrap_or(asked);
        // A frame may be under way, and then the next takes its time.
        let timeout = Seconds(2.0 * exposure.0 + self.config.frame_timeout.0);
        let deadline = Instant::now() + timeout.to_duration();
        // Frames until one has begun after that.
        let mut losses = LossCounter::new(asked, exposure);
        let mut untimed = 0;
        while Instant::now() < deadline {
            let left = deadline.saturating_duration_since(Instant::now());
            let next = self
                .ring
                .next(&self.device, left.max(Duration::from_millis(1)));
            let [width, height] = self.info.resolution_px;
            let failed = |error| stream_error(&self.config.device, [width, height], error);
            let Some((bytes, meta)) = next.map_err(failed)? else {
                // Also a device that reports an error without a frame: no busy loop.
                std::thread::sleep(Duration::from_millis(1));
                continue;
            };
            losses.note(&meta);
            let fresh = began_after(&meta, exposure, since).unwrap_or_else(|| {
                // All buffers of the ring and the frame under way may be older.
                untimed += 1;
                untimed > BUFFERS + 1
            });
            if !fresh {
                continue;
            }
            self.frames_lost += losses.lost;
            let bad_frame = |fault| DeviceError::BadFrame {
                device: self.config.device.clone(),
                fault,
            };
            // The frame itself.
            if meta.flags.contains(Flags::ERROR) {
                return Err(bad_frame(FrameFault::Damaged));
            }
            let counts = self
                .format
                .decode(bytes, width, height, self.stride)
                .map_err(|error| bad_frame(FrameFault::Undecodable(error.to_string())))?;
            self.previous = Some(PreviousFrame {
                key,
                since,
                returned: monotonic_now(),
            });
            return Ok(RawFrame {
                width,
                height,
                counts,
                sequence: Some(u64::from(meta.sequence)),
                timestamp: Some(timestamp(&meta)),
            });
        }
        Err(DeviceError::NoReply {
            device: self.config.device.clone(),
            timeout,
            sent: "a request for a frame".to_owned(),
        })
    }

    fn temperature_c(&mut self) -> Option<f64> {
        let (id, unit_c) = self.temperature?;
        let counts = ControlPort::get(&self.device, id).ok()?;
        Some(counts as f64 * unit_c)
    }

    fn frames_lost(&self) -> u64 {
        self.frames_lost
    }

    fn longest_frame(&self, exposure: Seconds) -> Seconds {
        Seconds(2.0 * exposure.0.max(0.0) + self.config.frame_timeout.0 + 0.5)
    }

    fn may_return_within(&self) -> Seconds {
        self.config.return_timeout
    }

    fn reconnect(&mut self) -> Result<(), DeviceError> {
        self.ring.stop();
        let again = self.find_again()?;
        let frames_lost = self.frames_lost;
        *self = again;
        self.frames_lost = frames_lost;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_opening_meets_becomes_a_fact() {
        let open = |device: &str| V4lCamera::open(V4lConfig::of_device(device)).map(drop);
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("video0").display().to_string();
        assert!(matches!(open(&file), Err(DeviceError::NotFound { .. })));
        assert!(matches!(open("a\0b"), Err(DeviceError::NotFound { .. })));
        std::fs::write(&file, "").unwrap();
        assert!(matches!(open(&file), Err(DeviceError::WrongKind { .. })));
    }
}
