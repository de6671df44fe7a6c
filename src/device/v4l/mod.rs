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

use super::controls::{self, ControlInfo, ControlPort, TemperatureControl, id};
use super::discovery::{self, DeviceKind};
use super::frame_row::PreviousFrame;
use super::pixel_format::PixelFormat;
use super::retake::FrameFault;
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

/// Unit of `EXPOSURE_ABSOLUTE`, seconds.
const EXPOSURE_UNIT_S: f64 = 100e-6;
/// A USB cable pulled shows as this error number (ENODEV).
const NO_SUCH_DEVICE: i32 = 19;
/// A request that a USB device stalls shows as this one (EPIPE).
const STALLED: i32 = 32;
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
    /// Absent where it cannot be set.
    exposure: Option<Range>,
    gain: Option<Gain>,
    /// Id, and °C per count.
    temperature: Option<(u32, f64)>,
    settings: Option<CameraSettings>,
    previous: Option<PreviousFrame>,
    frames_lost: u64,
}

/// An integer control's range.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Range {
    minimum: i64,
    maximum: i64,
    step: i64,
}

/// The control that sets the gain.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Gain {
    id: u32,
    range: Range,
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
        let exposure = range_of(&device, id::EXPOSURE_ABSOLUTE).map_err(failed)?;
        if exposure.is_none() && !config.any_exposure {
            return Err(DeviceError::Refused {
                device: config.device.clone(),
                command: "EXPOSURE_ABSOLUTE".to_owned(),
                reason: "the camera has no such control, so exposures cannot be set".to_owned(),
            });
        }
        let seconds = |steps: Option<i64>| {
            Seconds(steps.map_or(f64::NAN, |steps| steps as f64 * EXPOSURE_UNIT_S))
        };
        let mut gain = None;
        for id in [id::ANALOGUE_GAIN, id::GAIN] {
            if gain.is_none() {
                let range = range_of(&device, id).map_err(failed)?;
                gain = range.map(|range| Gain { id, range });
            }
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
        let info = CameraInfo {
            driver: "v4l".to_owned(),
            model: capabilities.card,
            serial: serial.unwrap_or_default(),
            resolution_px,
            bit_depth: format.bits,
            mosaic: format.mosaic,
            exposure_range: [
                seconds(exposure.map(|range| range.minimum.max(1))),
                seconds(exposure.map(|range| range.maximum)),
            ],
            exposure_step: seconds(exposure.map(|range| range.step)),
        };
        Ok(Self {
            config,
            info,
            ring: Ring::of_driver(&capabilities.driver),
            device,
            format,
            stride,
            exposure,
            gain,
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

    fn error(&self, error: io::Error) -> DeviceError {
        device_error(&self.config.device, error)
    }

    fn refused(&self, command: &str, reason: String) -> DeviceError {
        DeviceError::Refused {
            device: self.config.device.clone(),
            command: command.to_owned(),
            reason,
        }
    }

    fn set(&self, id: u32, value: i64, what: &str) -> Result<i64, DeviceError> {
        controls::set(&self.device, id, value).map_err(|error| match error.raw_os_error() {
            Some(STALLED) => self.refused(what, "it stalls this request".to_owned()),
            _ => self.error(error),
        })
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

fn range_of(port: &dyn ControlPort, id: u32) -> io::Result<Option<Range>> {
    let control = port.query(id)?;
    Ok(control.map(|control| Range {
        minimum: control.minimum,
        maximum: control.maximum,
        step: control.step,
    }))
}

impl Range {
    /// The allowed value nearest to `wanted`.
    fn nearest(self, wanted: f64) -> i64 {
        let steps = ((wanted - self.minimum as f64) / self.step as f64).round();
        let last = (self.maximum - self.minimum) / self.step;
        // A float becomes the nearest integer, and NaN 0.
        self.minimum + (steps as i64).clamp(0, last.max(0)) * self.step
    }
}

impl Gain {
    /// The raw value of a gain factor, 1 being the lowest. A control that begins
    /// at 0 has no known unit, so that only its lowest value is a known factor.
    fn raw(self, factor: f64) -> Option<i64> {
        if self.range.minimum > 0 {
            Some(self.range.nearest(factor * self.range.minimum as f64))
        } else {
            (factor == 1.0).then_some(self.range.minimum)
        }
    }

    fn factor(self, raw: i64) -> Option<f64> {
        if self.range.minimum > 0 {
            Some(raw as f64 / self.range.minimum as f64)
        } else {
            (raw == self.range.minimum).then_some(1.0)
        }
    }
}

fn device_error(device: &str, error: io::Error) -> DeviceError {
    let device = device.to_owned();
    const BUSY: i32 = 16;
    match (error.raw_os_error(), error.kind()) {
        (Some(NO_SUCH_DEVICE), _) => DeviceError::Disconnected { device },
        (Some(BUSY), _) => DeviceError::Busy { device },
        (_, io::ErrorKind::NotFound) => DeviceError::NotFound { device },
        (_, io::ErrorKind::PermissionDenied) => DeviceError::PermissionDenied { device },
        _ => DeviceError::Io {
            device,
            source: error,
        },
    }
}

/// A stream that does not start: ENOSPC speaks of the bus, not of a disk.
fn stream_error(device: &str, [width, height]: [u32; 2], error: io::Error) -> DeviceError {
    const NO_BANDWIDTH: i32 = 28;
    match error.raw_os_error() {
        Some(NO_BANDWIDTH) => DeviceError::NoBandwidth {
            device: device.to_owned(),
            width,
            height,
        },
        _ => device_error(device, error),
    }
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
        controls::set_manual(&self.device, name, &failed)?;
        controls::set_wanted(&self.device, name, &self.config.controls, &failed)?;
        let gain = match self.gain {
            None if requested.gain == 1.0 => 1.0,
            None => {
                let reason = "the camera has no gain control, so only 1".to_owned();
                return Err(self.refused(&format!("gain {}", requested.gain), reason));
            }
            Some(control) => {
                let command = format!("gain {}", requested.gain);
                let unknown = || {
                    let reason = "the unit of its gain is unknown, so only 1 (the lowest)";
                    self.refused(&command, reason.to_owned())
                };
                let raw = control.raw(requested.gain).ok_or_else(unknown)?;
                let applied = self.set(control.id, raw, &command)?;
                control.factor(applied).ok_or_else(unknown)?
            }
        };
        let exposure_s = match self.exposure {
            None => f64::NAN,
            Some(range) => {
                let steps = range.nearest(requested.exposure.0 / EXPOSURE_UNIT_S);
                let what = format!("exposure {}", requested.exposure);
                let applied = self.set(id::EXPOSURE_ABSOLUTE, steps, &what)?;
                applied as f64 * EXPOSURE_UNIT_S
            }
        };
        let settings = CameraSettings {
            exposure: Seconds(exposure_s),
            gain,
        };
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
    fn values_are_rounded_to_the_controls_range() {
        let range = Range {
            minimum: 3,
            maximum: 2047,
            step: 2,
        };
        for (wanted, nearest) in [
            (0.0, 3),
            (5.9, 5),
            (6.1, 7),
            (1e12, 2047),
            (f64::INFINITY, 2047),
            (f64::NAN, 3),
        ] {
            assert_eq!(range.nearest(wanted), nearest, "{wanted}");
        }
    }

    #[test]
    fn a_gain_without_a_unit_is_only_1() {
        let gain = |minimum| Gain {
            id: id::GAIN,
            range: Range {
                minimum,
                maximum: 1000,
                step: 1,
            },
        };
        assert_eq!(gain(64).raw(2.5), Some(160));
        assert_eq!(gain(64).factor(160), Some(2.5));
        assert_eq!(gain(0).raw(1.0), Some(0));
        assert_eq!(gain(0).raw(2.0), None);
        assert_eq!(gain(0).factor(5), None);
    }

    #[test]
    fn what_opening_meets_becomes_a_fact() {
        let open = |device: &str| V4lCamera::open(V4lConfig::of_device(device)).map(drop);
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("video0").display().to_string();
        assert!(matches!(open(&file), Err(DeviceError::NotFound { .. })));
        assert!(matches!(open("a\0b"), Err(DeviceError::NotFound { .. })));
        std::fs::write(&file, "").unwrap();
        assert!(matches!(open(&file), Err(DeviceError::WrongKind { .. })));
        let gone = device_error("x", io::Error::from_raw_os_error(19));
        assert!(matches!(gone, DeviceError::Disconnected { .. }));
        let full = stream_error("x", [640, 480], io::Error::from_raw_os_error(28));
        assert!(matches!(full, DeviceError::NoBandwidth { .. }), "{full}");
        let gone = stream_error("x", [640, 480], io::Error::from_raw_os_error(19));
        assert!(matches!(gone, DeviceError::Disconnected { .. }));
        let busy = device_error("x", io::Error::from_raw_os_error(16));
        assert!(matches!(busy, DeviceError::Busy { .. }));
    }
}
