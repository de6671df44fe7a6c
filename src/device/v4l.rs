//! Raw frames from a Video4Linux camera.
//!
//! Exposure goes through `V4L2_CID_EXPOSURE_ABSOLUTE` (steps of 100 µs), which
//! UVC cameras have. Everything automatic is switched off first and every
//! setting is read back.

use std::io;
use std::path::Path;
use std::time::{Duration, Instant};

use rustix::time::{ClockId, clock_gettime};
use v4l::buffer::{Flags, Metadata, Type};
use v4l::control::{Control, Value};
use v4l::io::mmap::Stream;
use v4l::io::traits::CaptureStream;
use v4l::v4l_sys::{v4l2_queryctrl, v4l2_queryctrl as QueryControl};
use v4l::video::Capture;
use v4l::{Device, FourCC};

use super::pixel_format::{PixelFormat, best_of, of_fourcc};
use super::{Camera, CameraInfo, CameraSettings, DeviceError, FrameKey, RawFrame, discovery};
use crate::units::Seconds;

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
    /// Significant bits of a sample where they are fewer than the format has
    /// room for, as of a 12-bit sensor in `Y16`; `None`: all.
    pub bit_depth: Option<u32>,
    /// Width and height, pixels; `None`: as the camera is set.
    pub resolution_px: Option<[u32; 2]>,
    /// How long a frame may take beyond its exposure.
    pub frame_timeout: Seconds,
}

/// `V4L2_CID_*` of `linux/v4l2-controls.h`.
mod id {
    pub const AUTO_WHITE_BALANCE: u32 = 0x0098_090c;
    pub const AUTO_GAIN: u32 = 0x0098_0912;
    pub const GAIN: u32 = 0x0098_0913;
    pub const EXPOSURE_AUTO: u32 = 0x009a_0901;
    pub const EXPOSURE_ABSOLUTE: u32 = 0x009a_0902;
    pub const EXPOSURE_AUTO_PRIORITY: u32 = 0x009a_0903;
    pub const ANALOGUE_GAIN: u32 = 0x009e_0903;
}

/// `V4L2_EXPOSURE_MANUAL`.
const EXPOSURE_MANUAL: i64 = 1;
/// Unit of `EXPOSURE_ABSOLUTE`, seconds.
const EXPOSURE_UNIT_S: f64 = 100e-6;
/// Buffers in the ring; so many frames may be older than a request.
const BUFFERS: u32 = 4;
/// A USB cable pulled shows as this error number (ENODEV).
const NO_SUCH_DEVICE: i32 = 19;

/// A camera that streams raw frames.
pub struct V4lCamera {
    config: V4lConfig,
    info: CameraInfo,
    device: Device,
    format: PixelFormat,
    stride: u32,
    exposure: Range,
    gain: Option<Gain>,
    settings: Option<CameraSettings>,
    /// Absent before the first frame and after a timeout: the crate would queue
    /// again a buffer that the kernel still has.
    stream: Option<Stream<'static>>,
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
    pub fn open(config: V4lConfig) -> Result<Self, DeviceError> {
        let failed = |error| device_error(&config.device, error);
        if config.device.contains('\0') {
            return Err(failed(io::ErrorKind::NotFound.into()));
        }
        let device = Device::with_path(&config.device).map_err(failed)?;
        let capabilities = device.query_caps().map_err(failed)?;
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
        let (format, resolution_px, stride) = set_format(&device, &config)?;
        let exposure = range_of(&device, id::EXPOSURE_ABSOLUTE)
            .map_err(failed)?
            .ok_or_else(|| DeviceError::Refused {
                device: config.device.clone(),
                command: "EXPOSURE_ABSOLUTE".to_owned(),
                reason: "the camera has no such control, so exposures cannot be set".to_owned(),
            })?;
        let mut gain = None;
        for id in [id::ANALOGUE_GAIN, id::GAIN] {
            if gain.is_none() {
                let range = range_of(&device, id).map_err(failed)?;
                gain = range.map(|range| Gain { id, range });
            }
        }
        let info = CameraInfo {
            driver: "v4l".to_owned(),
            model: capabilities.card,
            serial: serial.unwrap_or_default(),
            resolution_px,
            bit_depth: format.bits,
            mosaic: format.mosaic,
            exposure_range: [exposure.minimum.max(1), exposure.maximum]
                .map(|steps| Seconds(steps as f64 * EXPOSURE_UNIT_S)),
            exposure_step: Seconds(exposure.step as f64 * EXPOSURE_UNIT_S),
        };
        Ok(Self {
            config,
            info,
            device,
            format,
            stride,
            exposure,
            gain,
            settings: None,
            stream: None,
        })
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

    /// Sets a control and returns what is read back.
    fn set(&self, id: u32, value: i64) -> Result<i64, DeviceError> {
        let value = Value::Integer(value);
        self.device
            .set_control(Control { id, value })
            .map_err(|error| self.error(error))?;
        match self.device.control(id).map_err(|error| self.error(error))? {
            Control {
                value: Value::Integer(value),
                ..
            } => Ok(value),
            Control {
                value: Value::Boolean(value),
                ..
            } => Ok(i64::from(value)),
            other => Err(self.refused(
                &format!("control {id:#x}"),
                format!("read back as {:?}", other.value),
            )),
        }
    }

    /// Sets a control that cameras may lack, and checks that it took.
    fn set_if_there(&self, id: u32, name: &str, value: i64) -> Result<(), DeviceError> {
        if range_of(&self.device, id)
            .map_err(|error| self.error(error))?
            .is_none()
        {
            return Ok(());
        }
        let is = self.set(id, value)?;
        if is == value {
            return Ok(());
        }
        Err(DeviceError::NotApplied {
            device: self.config.device.clone(),
            what: name.to_owned(),
            is: is.to_string(),
            wanted: value.to_string(),
        })
    }

    /// The next buffer, a fresh one or not; `None` at a short timeout.
    fn next_buffer(&mut self, timeout: Duration) -> io::Result<Option<(Vec<u8>, Metadata)>> {
        if self.stream.is_none() {
            self.stream = Some(Stream::with_buffers(
                &self.device,
                Type::VideoCapture,
                BUFFERS,
            )?);
        }
        let Some(stream) = &mut self.stream else {
            return Ok(None);
        };
        stream.set_timeout(timeout.min(Duration::from_secs(3600)));
        match stream.next() {
            Ok((bytes, meta)) => {
                let used = (meta.bytesused as usize).min(bytes.len());
                Ok(Some((bytes[..used].to_vec(), *meta)))
            }
            Err(error) => {
                self.stream = None;
                match error.kind() {
                    io::ErrorKind::TimedOut | io::ErrorKind::WouldBlock => Ok(None),
                    io::ErrorKind::Interrupted => Ok(None),
                    _ => Err(error),
                }
            }
        }
    }
}

/// Sets format and size without leftovers of the old ones, and believes only
/// what comes back.
fn set_format(
    device: &Device,
    config: &V4lConfig,
) -> Result<(PixelFormat, [u32; 2], u32), DeviceError> {
    let failed = |error| device_error(&config.device, error);
    let refused = |command: String, reason: String| DeviceError::Refused {
        device: config.device.clone(),
        command,
        reason,
    };
    let offered: Vec<[u8; 4]> = device
        .enum_formats()
        .map_err(failed)?
        .iter()
        .map(|description| description.fourcc.repr)
        .collect();
    let names = |codes: &[[u8; 4]]| {
        let text = |code: &[u8; 4]| String::from_utf8_lossy(code).trim_end().to_owned();
        codes.iter().map(text).collect::<Vec<_>>().join(", ")
    };
    let mut wanted = match config.format {
        Some(code) => of_fourcc(code).ok_or_else(|| {
            refused(
                format!("format {}", names(&[code])),
                "not a format that can be read".to_owned(),
            )
        })?,
        None => best_of(&offered, config.bit_depth, false).ok_or_else(|| {
            let reason = format!(
                "none of the camera's formats is uncompressed: {}",
                names(&offered)
            );
            refused("an uncompressed format".to_owned(), reason)
        })?,
    };
    let bits = config.bit_depth.unwrap_or(wanted.bits);
    if !(1..=wanted.bits).contains(&bits) {
        let reason = format!("its samples have 1 to {} bits", wanted.bits);
        return Err(refused(format!("{bits} bits of {}", wanted.name()), reason));
    }
    wanted.bits = bits;
    let mut format = device.format().map_err(failed)?;
    if let Some([width, height]) = config.resolution_px {
        (format.width, format.height) = (width, height);
    }
    (format.fourcc, format.stride, format.size) = (FourCC::new(&wanted.fourcc), 0, 0);
    let (width, height) = (format.width, format.height);
    let applied = device.set_format(&format).map_err(failed)?;
    if applied.fourcc.repr != wanted.fourcc {
        let reason = format!("the camera offers {}", names(&offered));
        return Err(refused(format!("format {}", wanted.name()), reason));
    }
    if (applied.width, applied.height) != (width, height) {
        return Err(DeviceError::NotApplied {
            device: config.device.clone(),
            what: "the resolution".to_owned(),
            is: format!("{} × {}", applied.width, applied.height),
            wanted: format!("{width} × {height}"),
        });
    }
    Ok((wanted, [applied.width, applied.height], applied.stride))
}

/// The range of a control; `None` if the camera lacks it or has disabled it.
///
/// The crate's own `query_controls` panics on unknown types and odd menu texts.
fn range_of(device: &Device, id: u32) -> io::Result<Option<Range>> {
    const DISABLED: u32 = 1;
    const INVALID: i32 = 22;
    let mut query = QueryControl {
        id,
        // SAFETY: plain numbers and arrays of them, for which zero is valid.
        ..unsafe { std::mem::zeroed::<v4l2_queryctrl>() }
    };
    // SAFETY: VIDIOC_QUERYCTRL reads and writes exactly this structure.
    let asked = unsafe {
        v4l::v4l2::ioctl(
            device.handle().fd(),
            v4l::v4l2::vidioc::VIDIOC_QUERYCTRL,
            (&raw mut query).cast(),
        )
    };
    match asked {
        Ok(()) if query.flags & DISABLED != 0 => Ok(None),
        Ok(()) => Ok(Some(Range {
            minimum: i64::from(query.minimum),
            maximum: i64::from(query.maximum),
            step: i64::from(query.step).max(1),
        })),
        Err(error) if error.raw_os_error() == Some(INVALID) => Ok(None),
        Err(error) => Err(error),
    }
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

/// Whether a frame began after `since` (CLOCK_MONOTONIC). `None` if the buffer
/// does not say.
fn began_after(meta: &Metadata, exposure: Seconds, since: Seconds) -> Option<bool> {
    let flags = meta.flags.bits();
    if flags & Flags::TIMESTAMP_MASK.bits() != Flags::TIMESTAMP_MONOTONIC.bits() {
        return None;
    }
    let start_of_exposure = Flags::TSTAMP_SRC_SOE.bits();
    let at_start = flags & Flags::TSTAMP_SRC_MASK.bits() == start_of_exposure;
    let start_s = timestamp_s(meta) - if at_start { 0.0 } else { exposure.0 };
    Some(start_s >= since.0)
}

fn timestamp_s(meta: &Metadata) -> f64 {
    meta.timestamp.sec as f64 + meta.timestamp.usec as f64 * 1e-6
}

fn monotonic_now() -> Seconds {
    let now = clock_gettime(ClockId::Monotonic);
    Seconds(now.tv_sec as f64 + now.tv_nsec as f64 * 1e-9)
}

impl Camera for V4lCamera {
    fn info(&self) -> &CameraInfo {
        &self.info
    }

    fn configure(&mut self, requested: CameraSettings) -> Result<CameraSettings, DeviceError> {
        self.settings = None;
        self.set_if_there(id::EXPOSURE_AUTO, "manual exposure", EXPOSURE_MANUAL)?;
        self.set_if_there(id::EXPOSURE_AUTO_PRIORITY, "fixed frame rate", 0)?;
        self.set_if_there(id::AUTO_GAIN, "manual gain", 0)?;
        self.set_if_there(id::AUTO_WHITE_BALANCE, "manual white balance", 0)?;
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
                let applied = self.set(control.id, raw)?;
                control.factor(applied).ok_or_else(unknown)?
            }
        };
        let steps = self
            .exposure
            .nearest(requested.exposure.0 / EXPOSURE_UNIT_S);
        let applied = self.set(id::EXPOSURE_ABSOLUTE, steps)?;
        let settings = CameraSettings {
            exposure: Seconds(applied as f64 * EXPOSURE_UNIT_S),
            gain,
        };
        self.settings = Some(settings);
        Ok(settings)
    }

    /// Cameras have no shutter that Video4Linux could close.
    fn set_shutter(&mut self, _open: bool) -> Result<bool, DeviceError> {
        Ok(false)
    }

    fn grab(&mut self, _key: FrameKey) -> Result<RawFrame, DeviceError> {
        let Some(CameraSettings { exposure, .. }) = self.settings else {
            let reason = "its settings are automatic or unknown until it is configured";
            return Err(self.refused("a frame", reason.to_owned()));
        };
        let asked = monotonic_now();
        // A frame may be under way, and then the next takes its time.
        let timeout = Seconds(2.0 * exposure.0 + self.config.frame_timeout.0);
        let deadline = Instant::now() + timeout.to_duration();
        let mut untimed = 0;
        let mut damage = None;
        while Instant::now() < deadline {
            let left = deadline.saturating_duration_since(Instant::now());
            let next = self.next_buffer(left.max(Duration::from_millis(1)));
            let Some((bytes, meta)) = next.map_err(|error| self.error(error))? else {
                // Also a device that reports an error without a frame: no busy loop.
                std::thread::sleep(Duration::from_millis(1));
                continue;
            };
            let fresh = began_after(&meta, exposure, asked).unwrap_or_else(|| {
                // All buffers of the ring and the frame under way may be older.
                untimed += 1;
                untimed > BUFFERS + 1
            });
            if !fresh {
                continue;
            }
            if meta.flags.contains(Flags::ERROR) {
                damage = Some("a frame that the driver marks as damaged".to_owned());
                continue;
            }
            let [width, height] = self.info.resolution_px;
            match self.format.decode(&bytes, width, height, self.stride) {
                Ok(counts) => {
                    return Ok(RawFrame {
                        width,
                        height,
                        counts,
                        sequence: Some(u64::from(meta.sequence)),
                        timestamp: Some(Seconds(timestamp_s(&meta))),
                    });
                }
                Err(error) => damage = Some(error.to_string()),
            }
        }
        let device = self.config.device.clone();
        Err(match damage {
            Some(answer) => DeviceError::Garbled {
                device,
                answer,
                expected: format!("a whole frame in format {}", self.format.name()),
            },
            None => DeviceError::NoReply {
                device,
                timeout,
                sent: "a request for a frame".to_owned(),
            },
        })
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
    fn only_frames_that_began_later_are_fresh() {
        let meta = |flags: Flags, microseconds| Metadata {
            flags,
            timestamp: v4l::Timestamp::new(100, microseconds),
            ..Metadata::default()
        };
        let fresh = |meta: &Metadata| began_after(meta, Seconds(0.02), Seconds(100.01));
        let at_start = Flags::TIMESTAMP_MONOTONIC | Flags::TSTAMP_SRC_SOE;
        assert_eq!(fresh(&meta(at_start, 9_000)), Some(false));
        assert_eq!(fresh(&meta(at_start, 11_000)), Some(true));
        let at_end = Flags::TIMESTAMP_MONOTONIC;
        assert_eq!(fresh(&meta(at_end, 29_000)), Some(false));
        assert_eq!(fresh(&meta(at_end, 31_000)), Some(true));
        assert_eq!(fresh(&meta(Flags::empty(), 31_000)), None);
    }

    #[test]
    fn what_opening_meets_becomes_a_fact() {
        let open = |device: &str| {
            V4lCamera::open(V4lConfig {
                device: device.to_owned(),
                serial: None,
                format: None,
                bit_depth: None,
                resolution_px: None,
                frame_timeout: Seconds(1.0),
            })
            .map(drop)
        };
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("video0").display().to_string();
        assert!(matches!(open(&file), Err(DeviceError::NotFound { .. })));
        assert!(matches!(open("a\0b"), Err(DeviceError::NotFound { .. })));
        std::fs::write(&file, "").unwrap();
        assert!(matches!(open(&file), Err(DeviceError::Io { .. })));
        let gone = device_error("x", io::Error::from_raw_os_error(19));
        assert!(matches!(gone, DeviceError::Disconnected { .. }));
        let busy = device_error("x", io::Error::from_raw_os_error(16));
        assert!(matches!(busy, DeviceError::Busy { .. }));
    }
}
