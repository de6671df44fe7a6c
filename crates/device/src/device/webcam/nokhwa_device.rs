//! A webcam through nokhwa.
//!
//! On Linux nokhwa counts cameras as the nodes `/dev/videoN`, and `Other(id)` reaches the
//! Video4Linux control with this id.

use std::io;
use std::path::{Path, PathBuf};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

use nokhwa::NokhwaError;
use nokhwa::utils::{
    ApiBackend, CameraFormat, CameraIndex, ControlValueDescription, ControlValueSetter,
    FrameFormat, KnownCameraControl, KnownCameraControlFlag, RequestedFormat, RequestedFormatType,
    Resolution,
};
use rustix::fs::{Access, access};

use super::super::controls::{ControlInfo, ControlKind, id};
use super::super::described::{FoundCamera, io_error};
use super::super::system_error::device_error;
use super::super::{DeviceError, WebcamFault, discovery};
use super::port::{Frame, Webcam};
use crate::units::Seconds;

/// The only format whose bytes are counts on every system.
const FORMAT: FrameFormat = FrameFormat::YUYV;
/// Whether `uvcvideo` hands damaged frames over: 1, the default of newer kernels, or 0.
const NODROP: &str = "/sys/module/uvcvideo/parameters/nodrop";

/// An open camera.
pub struct NokhwaDevice {
    camera: nokhwa::Camera,
    model: String,
    serial: Option<String>,
}

/// Whether there is such a camera, as far as it shows without opening it.
pub fn ready(address: &str) -> Result<String, DeviceError> {
    if address.contains('/') {
        node_number(address)?;
        access(address, Access::READ_OK | Access::WRITE_OK)
            .map_err(|error| io_error(address.to_owned(), error.into()))?;
    }
    Ok(format!("webcam {address}"))
}

/// The cameras that nokhwa lists, without the further nodes of each.
pub fn find() -> Result<Vec<FoundCamera>, DeviceError> {
    let found = nokhwa::query(ApiBackend::Auto).map_err(|error| DeviceError::Io {
        device: "nokhwa".to_owned(),
        source: system_error(&error),
    })?;
    let root = Path::new("/");
    Ok(found
        .into_iter()
        .filter_map(|camera| {
            let number = camera.index().as_string();
            let node = PathBuf::from(format!("/dev/video{number}"));
            if discovery::first_node(root, &node).is_some() {
                return None;
            }
            let address = match node.exists() {
                true => node.display().to_string(),
                false => number,
            };
            let problem = ready(&address).err();
            let serial = discovery::serial_of_camera(root, &node);
            Some(FoundCamera {
                serial: serial.unwrap_or_else(|| camera.human_name()),
                model: camera.human_name(),
                address,
                problem,
            })
        })
        .collect())
}

/// The number by which nokhwa opens the node behind a path.
fn node_number(path: &str) -> Result<u32, DeviceError> {
    let node = std::fs::canonicalize(path).map_err(|error| device_error(path, error))?;
    let number = node
        .to_str()
        .and_then(|node| node.strip_prefix("/dev/video")?.parse().ok());
    number.ok_or_else(|| DeviceError::WrongKind {
        device: path.to_owned(),
        wanted: "camera",
        why: format!("{} is no /dev/video node", node.display()),
    })
}

/// The system's error that a message of nokhwa ends with, or the message.
fn system_error(error: &NokhwaError) -> io::Error {
    let text = error.to_string();
    let number = text
        .rsplit_once("(os error ")
        .and_then(|(_, rest)| rest.split_once(')')?.0.parse().ok());
    match number {
        Some(number) => io::Error::from_raw_os_error(number),
        None => io::Error::other(text),
    }
}

/// nokhwa's name of a Video4Linux control; it lists a control by this name alone.
fn control_of(id: u32) -> KnownCameraControl {
    match id {
        id::GAIN => KnownCameraControl::Gain,
        id => KnownCameraControl::Other(u128::from(id)),
    }
}

/// The fastest rate at which an exposure of `longest` fits between two frames; the slowest
/// where it fits at none.
fn rate_for(rates: &[u32], longest: Seconds) -> Option<u32> {
    let fits = |rate: &u32| *rate > 0 && 1.0 / f64::from(*rate) >= longest.0;
    let fastest = rates.iter().copied().filter(fits).max();
    fastest.or_else(|| rates.iter().copied().min())
}

/// Refuses a camera whose damaged frames cannot be distinguished from whole ones.
fn check_damage(address: &str, number: u32) -> Result<(), DeviceError> {
    let driver = format!("/sys/class/video4linux/video{number}/device/driver");
    let driver = std::fs::canonicalize(driver).unwrap_or_default();
    if driver.file_name() != Some("uvcvideo".as_ref()) {
        return Ok(());
    }
    let nodrop = std::fs::read_to_string(NODROP).unwrap_or_default();
    match nodrop.trim() {
        "0" => Ok(()),
        value => Err(DeviceError::Webcam {
            device: address.to_owned(),
            fault: WebcamFault::DamageUnseen {
                nodrop: value.to_owned(),
            },
        }),
    }
}

impl Webcam for NokhwaDevice {
    fn open(
        address: &str,
        [width, height]: [u32; 2],
        longest: Seconds,
    ) -> Result<Self, DeviceError> {
        // Which one.
        let is_node = address.contains('/');
        let index = match is_node {
            true => {
                let number = node_number(address)?;
                check_damage(address, number)?;
                CameraIndex::Index(number)
            }
            false => match address.trim().parse() {
                Ok(number) => CameraIndex::Index(number),
                Err(_) => CameraIndex::String(address.to_owned()),
            },
        };
        let failed = |error: NokhwaError| {
            let error = system_error(&error);
            match error.raw_os_error() {
                Some(_) => device_error(address, error),
                None => DeviceError::Webcam {
                    device: address.to_owned(),
                    fault: WebcamFault::NoFormat {
                        width,
                        height,
                        said: error.to_string(),
                    },
                },
            }
        };
        // The first format of this kind; then size and rate.
        let any = RequestedFormat::with_formats(RequestedFormatType::None, &[FORMAT]);
        let mut camera = nokhwa::Camera::new(index, any).map_err(failed)?;
        let size = Resolution::new(width, height);
        let rates = camera
            .compatible_list_by_resolution(FORMAT)
            .map_err(failed)?;
        let rates = rates.get(&size).map_or(&[][..], Vec::as_slice);
        let rate = rate_for(rates, longest).unwrap_or(camera.frame_rate());
        let exact = RequestedFormatType::Exact(CameraFormat::new(size, FORMAT, rate));
        camera
            .set_camera_requset(RequestedFormat::with_formats(exact, &[FORMAT]))
            .map_err(failed)?;
        let serial = is_node
            .then(|| discovery::serial_of_camera(Path::new("/"), Path::new(address)))
            .flatten();
        // The name in the list, so that both are the same; the open camera may have another.
        let listed = nokhwa::query(ApiBackend::Auto).unwrap_or_default();
        let listed = listed.iter().find(|found| found.index() == camera.index());
        let model = listed.map_or_else(|| camera.info().human_name(), |found| found.human_name());
        Ok(Self {
            camera,
            model,
            serial,
        })
    }

    fn addresses(serial: &str) -> Vec<String> {
        let found = find().unwrap_or_default().into_iter();
        found
            .filter(|camera| camera.serial == serial && camera.serial != camera.model)
            .map(|camera| camera.address)
            .collect()
    }

    fn model(&self) -> String {
        self.model.clone()
    }

    fn serial(&self) -> Option<String> {
        self.serial.clone()
    }

    fn control(&self, id: u32) -> io::Result<Option<ControlInfo>> {
        let control = match self.camera.camera_control(control_of(id)) {
            Ok(control) => control,
            Err(error) => {
                let error = system_error(&error);
                let is_absent = error.raw_os_error().is_none();
                return is_absent.then_some(None).ok_or(error);
            }
        };
        let (kind, [minimum, maximum, step, default, value]) = match *control.description() {
            ControlValueDescription::IntegerRange {
                min,
                max,
                value,
                step,
                default,
            } => (
                ControlKind::Integer,
                [min, max, step.max(1), default, value],
            ),
            ControlValueDescription::Boolean { value, default } => (
                ControlKind::Boolean,
                [0, 1, 1, i64::from(default), i64::from(value)],
            ),
            _ => return Ok(None),
        };
        Ok(Some(ControlInfo {
            id,
            label: control.name().to_owned(),
            kind,
            minimum,
            maximum,
            step,
            default,
            value: Some(value),
            read_only: control.flag().contains(&KnownCameraControlFlag::ReadOnly),
            inactive: !control.active(),
        }))
    }

    fn set_control(&mut self, id: u32, value: i64) -> io::Result<()> {
        let kind = self.control(id)?.map(|control| control.kind);
        let value = match kind {
            Some(ControlKind::Boolean) => ControlValueSetter::Boolean(value != 0),
            _ => ControlValueSetter::Integer(value),
        };
        match self.camera.set_camera_control(control_of(id), value) {
            Ok(()) => Ok(()),
            // Set, and another value read back: what that is, is read by who set it.
            Err(NokhwaError::SetPropertyError { error, .. }) if error == "Rejected" => Ok(()),
            Err(error) => Err(system_error(&error)),
        }
    }

    fn next_frame(&mut self) -> io::Result<Frame> {
        if !self.camera.is_stream_open() {
            self.camera.open_stream().map_err(|e| system_error(&e))?;
        }
        let buffer = self.camera.frame();
        let now = Instant::now();
        let buffer = match buffer {
            Ok(buffer) => buffer,
            Err(error) => {
                // The stream would queue a buffer again that the kernel still has.
                let _ = self.camera.stop_stream();
                return Err(system_error(&error));
            }
        };
        // Its age by the wall clock, read just now by nokhwa too: a clock that is set later
        // changes nothing.
        let age = buffer.capture_timestamp().and_then(|stamp| {
            let now = SystemTime::now().duration_since(UNIX_EPOCH).ok()?;
            now.checked_sub(stamp)
        });
        Ok(Frame {
            bytes: buffer.buffer().to_vec(),
            ended: age.and_then(|age| now.checked_sub(age)),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rate_is_as_fast_as_the_longest_exposure_allows() {
        let rate = |longest_s| rate_for(&[30, 15, 5, 0], Seconds(longest_s));
        assert_eq!(rate(0.01), Some(30));
        assert_eq!(rate(0.05), Some(15));
        assert_eq!(rate(0.2), Some(5));
        assert_eq!(rate_for(&[30, 15, 5], Seconds(2.0)), Some(5));
        assert_eq!(rate_for(&[], Seconds(0.01)), None);
    }

    #[test]
    fn numbers_of_the_system_are_read_from_messages() {
        let read = |text: &str| system_error(&NokhwaError::ReadFrameError(text.to_owned()));
        assert_eq!(
            read("No such device (os error 19)").raw_os_error(),
            Some(19)
        );
        assert_eq!(read("a closed stream").raw_os_error(), None);
        assert!(
            read("a closed stream")
                .to_string()
                .contains("a closed stream")
        );
    }

    #[test]
    fn what_opening_meets_becomes_a_fact() {
        let open = |address: &str| NokhwaDevice::open(address, [640, 480], Seconds(0.1)).map(drop);
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("video0").display().to_string();
        assert!(matches!(open(&file), Err(DeviceError::NotFound { .. })));
        assert!(matches!(ready(&file), Err(DeviceError::NotFound { .. })));
        std::fs::write(&file, "").unwrap();
        assert!(matches!(open(&file), Err(DeviceError::WrongKind { .. })));
        assert!(matches!(open("9999"), Err(DeviceError::NotFound { .. })));
        assert!(find().is_ok());
    }
}
