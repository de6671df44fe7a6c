//! Ordinary webcams through nokhwa: luma of 8 bits (`YUYV`), exposures by the control that UVC
//! cameras have, read back.
//!
//! nokhwa waits for a frame without a limit and reports neither numbers nor damage. Therefore
//! it works on a thread of its own, a frame must have exactly the bytes of its size, and it
//! counts only if its exposure began after it was requested: its time stamp is taken for the
//! end of the exposure. Frames without a time stamp pass until none can be older.

mod nokhwa_device;
mod port;
#[cfg(test)]
mod tests;
mod worker;

use std::io;
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

use super::described::{Description, Driver};
use super::frame_row::PreviousFrame;
use super::manual_settings::ManualSettings;
use super::retake::FrameFault;
use super::system_error::{device_error, stream_error};
use super::{
    Camera, CameraInfo, CameraSettings, DeviceError, FrameKey, Mosaic, RawFrame, pixel_format,
};
use crate::units::Seconds;
use nokhwa_device::NokhwaDevice;
use port::{Frame, Port, Webcam};
use worker::Worker;

/// `camera.driver = "webcam"`.
pub const DRIVER: Driver = Driver {
    name: "webcam",
    offer: "a webcam that is not connected now",
    only_practice: true,
    key: "device",
    allowed: "a path such as /dev/v4l/by-id/…; where there are none, a number as `rig devices` lists it",
    is_path: false,
    accepts: |text| text.to_str().is_some_and(|text| !text.trim().is_empty()),
    ready: |text| nokhwa_device::ready(&text.to_string_lossy()),
    open: |text, description| {
        let name = text.to_string_lossy();
        Ok(Box::new(WebcamCamera::<NokhwaDevice>::open(
            &name,
            &description,
        )?))
    },
    find: nokhwa_device::find,
};

/// Buffers that nokhwa's streams have: so many frames may be older than a request.
const BUFFERS: u32 = 4;
/// Frames that may still have the old settings after a change.
const SETTLING_FRAMES: u32 = 3;
/// Exposures that a frame may have to wait for: those of the ring, the one under way, those
/// with old settings, and its own.
const LONGEST_WAIT: f64 = (BUFFERS + 1 + SETTLING_FRAMES + 1) as f64;
/// How long opening, and setting all controls, may take.
const CONTROL_TIMEOUT: Seconds = Seconds(10.0);
/// How long a camera that was unplugged is waited for.
const RETURN_TIMEOUT: Seconds = Seconds(30.0);
/// Bytes of a pixel in `YUYV`.
const PIXEL_BYTES: usize = 2;

/// A webcam under manual control.
pub struct WebcamCamera<W> {
    device: String,
    /// As the rig file describes it.
    described: CameraInfo,
    /// As it was found.
    info: CameraInfo,
    /// Beyond the exposures.
    timeout: Seconds,
    worker: Worker<W>,
    manual: ManualSettings,
    settings: Option<CameraSettings>,
    /// A frame that was requested and has not come.
    pending: Option<Receiver<io::Result<Frame>>>,
    /// So many of the next frames may have old settings.
    settling: u32,
    previous: Option<PreviousFrame>,
    opened: Instant,
}

impl<W: Webcam> WebcamCamera<W> {
    /// Opens the camera at this address. No frame is taken.
    ///
    /// # Errors
    /// It is not there, is not the described one, or gives no such frames.
    pub fn open(device: &str, description: &Description) -> Result<Self, DeviceError> {
        let info = &description.info;
        let refused = |command: &str, reason: String| DeviceError::Refused {
            device: device.to_owned(),
            command: command.to_owned(),
            reason,
        };
        if info.bit_depth != 8 || info.mosaic != Mosaic::None {
            let wanted = format!("{} bits, filters {}", info.bit_depth, info.mosaic);
            let reason = "a webcam's frames are luma of 8 bits without filters";
            return Err(refused(&wanted, reason.to_owned()));
        }
        let (address, size, longest) = (
            device.to_owned(),
            info.resolution_px,
            info.exposure_range[1],
        );
        let open = move || W::open(&address, size, longest);
        let worker = Worker::start(device, CONTROL_TIMEOUT, open)?;
        let asked = worker.begin(|webcam: &mut W| {
            let (model, serial) = (webcam.model(), webcam.serial());
            let manual = ManualSettings::of(&Port::new(webcam))?;
            Ok((model, serial, manual))
        });
        let (model, serial, manual) = worker
            .answer(&asked, CONTROL_TIMEOUT, "a request for its controls")?
            .map_err(|error| device_error(device, error))?;
        // Records belong to one camera, so that it must be named: by its model where it has
        // no number.
        let serial = serial.unwrap_or_else(|| model.clone());
        let wanted = &info.serial;
        if wanted.is_empty() {
            let reason = format!("calibration records are found by it; it must be {serial:?}");
            return Err(refused("a rig file without camera.serial", reason));
        }
        if *wanted != serial {
            return Err(DeviceError::NotApplied {
                device: device.to_owned(),
                what: "the camera's serial number".to_owned(),
                is: serial,
                wanted: wanted.clone(),
            });
        }
        let (exposure_range, exposure_step) = manual.exposures();
        Ok(Self {
            device: device.to_owned(),
            described: info.clone(),
            info: CameraInfo {
                model,
                serial,
                exposure_range,
                exposure_step,
                ..info.clone()
            },
            timeout: description.timeout,
            worker,
            manual,
            settings: None,
            pending: None,
            settling: 0,
            previous: None,
            opened: Instant::now(),
        })
    }

    /// Time since the camera was opened.
    fn at(&self, moment: Instant) -> Seconds {
        Seconds(moment.saturating_duration_since(self.opened).as_secs_f64())
    }

    fn bad_frame(&self, fault: String) -> DeviceError {
        DeviceError::BadFrame {
            device: self.device.clone(),
            fault: FrameFault::Undecodable(fault),
        }
    }

    /// Waits for a frame that is still under way, because the library does one thing at a
    /// time.
    fn finish_pending(&mut self) -> Result<(), DeviceError> {
        if let Some(pending) = self.pending.take() {
            let late = self
                .worker
                .answer(&pending, self.timeout, "a request for a frame");
            if matches!(late, Err(DeviceError::NoReply { .. })) {
                self.pending = Some(pending);
            }
            late.map(drop)?;
        }
        Ok(())
    }

    /// The counts of a frame.
    fn read(&self, frame: &Frame) -> Result<RawFrame, DeviceError> {
        let [width, height] = self.info.resolution_px;
        let expected = PIXEL_BYTES * width as usize * height as usize;
        if frame.bytes.len() != expected {
            return Err(self.bad_frame(format!(
                "it has {} bytes, and {width} × {height} pixels of {PIXEL_BYTES} bytes are {expected}",
                frame.bytes.len()
            )));
        }
        let format = pixel_format::of_fourcc(*b"YUYV")
            .ok_or_else(|| self.bad_frame("YUYV is unknown".to_owned()))?;
        let counts = format
            .decode(&frame.bytes, width, height, 0)
            .map_err(|error| self.bad_frame(error.to_string()))?;
        Ok(RawFrame {
            width,
            height,
            counts,
            sequence: None,
            timestamp: frame.ended.map(|ended| self.at(ended)),
        })
    }
}

impl<W: Webcam> Camera for WebcamCamera<W> {
    fn info(&self) -> &CameraInfo {
        &self.info
    }

    fn configure(&mut self, requested: CameraSettings) -> Result<CameraSettings, DeviceError> {
        self.settings = None;
        self.previous = None;
        self.finish_pending()?;
        let (manual, device) = (self.manual, self.device.clone());
        let applied = self.worker.begin(move |webcam: &mut W| {
            let failed = |error| device_error(&device, error);
            let port = Port::new(webcam);
            manual.apply(&port, &device, &[], requested, &failed)
        });
        let applied = self
            .worker
            .answer(&applied, CONTROL_TIMEOUT, "its settings")??;
        self.settling = SETTLING_FRAMES;
        self.settings = Some(applied);
        Ok(applied)
    }

    /// Webcams have no shutter.
    fn set_shutter(&mut self, _open: bool) -> Result<bool, DeviceError> {
        Ok(false)
    }

    fn grab(&mut self, key: FrameKey) -> Result<RawFrame, DeviceError> {
        let Some(CameraSettings { exposure, .. }) = self.settings else {
            return Err(DeviceError::Refused {
                device: self.device.clone(),
                command: "a frame".to_owned(),
                reason: "its settings are automatic or unknown until it is configured".to_owned(),
            });
        };
        // NaN where it cannot be set: 0 then.
        let exposure = Seconds(exposure.0.max(0.0));
        let asked = self.at(Instant::now());
        let previous = self.previous.take();
        let since = previous
            .and_then(|previous| previous.unchanged_since(key, asked))
            .unwrap_or(asked);
        let timeout = Seconds(LONGEST_WAIT * exposure.0 + self.timeout.0);
        let deadline = Instant::now() + timeout.to_duration();
        let sent = "a request for a frame";
        let mut untimed = 0;
        loop {
            // The next frame; one that does not come stays requested.
            let pending = self.pending.take();
            let pending = pending.unwrap_or_else(|| self.worker.begin(W::next_frame));
            let left = deadline.saturating_duration_since(Instant::now());
            let frame = match self
                .worker
                .answer(&pending, Seconds(left.as_secs_f64()), sent)
            {
                Ok(Ok(frame)) => frame,
                Ok(Err(error)) if error.kind() == io::ErrorKind::Interrupted => {
                    std::thread::sleep(Duration::from_millis(1));
                    continue;
                }
                Ok(Err(error)) => {
                    return Err(stream_error(&self.device, self.info.resolution_px, error));
                }
                Err(DeviceError::NoReply { device, sent, .. }) => {
                    self.pending = Some(pending);
                    return Err(DeviceError::NoReply {
                        device,
                        timeout,
                        sent,
                    });
                }
                Err(error) => return Err(error),
            };
            // Whether it began after the request, with these settings.
            let is_fresh = match frame.ended {
                Some(ended) => self.at(ended).0 - exposure.0 >= since.0,
                None => {
                    untimed += 1;
                    untimed > BUFFERS + 1
                }
            };
            if !is_fresh {
                continue;
            }
            if self.settling > 0 {
                self.settling -= 1;
                continue;
            }
            let frame = self.read(&frame)?;
            self.previous = Some(PreviousFrame {
                key,
                since,
                returned: self.at(Instant::now()),
            });
            return Ok(frame);
        }
    }

    fn longest_frame(&self, exposure: Seconds) -> Seconds {
        Seconds(LONGEST_WAIT * exposure.0.max(0.0) + self.timeout.0 + 0.5)
    }

    fn may_return_within(&self) -> Seconds {
        RETURN_TIMEOUT
    }

    fn reconnect(&mut self) -> Result<(), DeviceError> {
        self.pending = None;
        self.worker.close();
        let description = Description {
            info: self.described.clone(),
            timeout: self.timeout,
            keeper: None,
        };
        let mut places = vec![self.device.clone()];
        places.extend(W::addresses(&self.info.serial));
        let again = places
            .into_iter()
            .find_map(|place| Self::open(&place, &description).ok());
        *self = again.ok_or_else(|| DeviceError::Disconnected {
            device: self.device.clone(),
        })?;
        Ok(())
    }
}
