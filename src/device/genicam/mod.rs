//! GenICam cameras (GigE Vision, USB3 Vision) through Aravis.
//!
//! Everything automatic is switched off and every setting is read back as the camera rounds
//! it. Each frame is triggered by software, so that it begins after it was requested and none
//! is thrown away. Names of features are those of the Standard Features Naming Convention.

mod features;
pub mod pixels;

use std::time::{Duration, Instant};

use aravis::glib::object::Cast;
use aravis::{
    Buffer, BufferStatus, CameraExt, CameraExtManual, GvDevice, GvStreamOption, Stream, StreamExt,
};

use super::described::{Description, Driver, find_none};
use super::retake::FrameFault;
use super::{Camera, CameraInfo, CameraSettings, DeviceError, FrameKey, RawFrame};
use crate::units::Seconds;
use features::Features;
use pixels::PixelFormat;

/// `camera.driver = "genicam"`.
pub const DRIVER: Driver = Driver {
    name: "genicam",
    key: "device",
    allowed: "vendor and serial number as `Basler-12345678`, or the camera's IP address",
    is_path: false,
    accepts: |text| text.to_str().is_some_and(|text| !text.trim().is_empty()),
    ready: |text| Ok(format!("GenICam camera {}", text.to_string_lossy())),
    open: |text, description| {
        let name = text.to_string_lossy();
        Ok(Box::new(GenicamCamera::open(&name, &description)?))
    },
    find: find_none,
};

/// How long a camera that was unplugged, or lost to another program, is waited for.
const RETURN_TIMEOUT: Seconds = Seconds(30.0);
/// Buffers of the stream. Each frame is requested alone, so that one would do; the others
/// take what a camera sends that was not requested.
const BUFFERS: usize = 4;
/// Size of a packet on this machine's own loopback, bytes.
const LOOPBACK_PACKET: i64 = 9000;
const EXPOSURE: &str = "ExposureTime";
const GAIN: &str = "Gain";
const US: f64 = 1e-6;

/// A camera that waits for triggers.
pub struct GenicamCamera {
    /// As the rig file names it.
    device: String,
    info: CameraInfo,
    timeout: Seconds,
    format: PixelFormat,
    /// First of the two, because it is dropped first.
    stream: Option<Stream>,
    camera: aravis::Camera,
    features: Features,
    settings: Option<CameraSettings>,
    /// Number and start of the last frame.
    last: Option<(u64, u64)>,
    frames_lost: u64,
}

impl GenicamCamera {
    /// Opens the camera that `device` names, takes control and sets its format. No frame is
    /// taken.
    ///
    /// # Errors
    /// It is not there, another program controls it, or it is not what the description says.
    pub fn open(device: &str, description: &Description) -> Result<Self, DeviceError> {
        // The camera, and control of it.
        let camera = aravis::Camera::new(Some(device)).map_err(|_| DeviceError::NotFound {
            device: device.to_owned(),
        })?;
        let features = camera.device().map(|device_object| Features {
            device: device_object,
            name: device.to_owned(),
        });
        let features = features.ok_or_else(|| DeviceError::NotFound {
            device: device.to_owned(),
        })?;
        if let Some(network) = features.device.downcast_ref::<GvDevice>()
            && !network.is_controller()
        {
            return Err(DeviceError::Controlled {
                device: device.to_owned(),
            });
        }
        // Which one.
        let serial = features.text("DeviceSerialNumber");
        let wanted = &description.info.serial;
        if !wanted.is_empty() && *wanted != serial {
            return Err(DeviceError::NotApplied {
                device: device.to_owned(),
                what: "the camera's serial number".to_owned(),
                is: serial,
                wanted: wanted.clone(),
            });
        }
        // Format and size.
        let info = &description.info;
        let offered = features.choices("PixelFormat");
        let format = pixels::best_of(&offered, info.bit_depth, info.mosaic);
        let format = format.ok_or_else(|| {
            let wanted = format!("{} bits, filters {:?}", info.bit_depth, info.mosaic);
            features.refused(&wanted, format!("it offers {}", offered.join(", ")))
        })?;
        features.choose("PixelFormat", format.name)?;
        let size = [features.integer("Width")?, features.integer("Height")?];
        if size != info.resolution_px.map(i64::from) {
            return Err(DeviceError::NotApplied {
                device: device.to_owned(),
                what: "the size of a frame".to_owned(),
                is: format!("{} × {}", size[0], size[1]),
                wanted: format!("{} × {}", info.resolution_px[0], info.resolution_px[1]),
            });
        }
        if !features.has(EXPOSURE) {
            return Err(features.refused(EXPOSURE, "the camera has no such feature"));
        }
        // What it can do.
        let range = features.bounds(EXPOSURE)?.map(|us| Seconds(us * US));
        let info = CameraInfo {
            model: features.text("DeviceModelName"),
            serial,
            exposure_range: range,
            exposure_step: Seconds(features.step(EXPOSURE).unwrap_or(1.0) * US),
            ..info.clone()
        };
        Ok(Self {
            device: device.to_owned(),
            info,
            timeout: description.timeout,
            format,
            stream: None,
            camera,
            features,
            settings: None,
            last: None,
            frames_lost: 0,
        })
    }

    /// Everything manual, a frame at each trigger.
    fn set_manual(&self) -> Result<(), DeviceError> {
        let features = &self.features;
        for automatic in [
            "ExposureAuto",
            "GainAuto",
            "BlackLevelAuto",
            "BalanceWhiteAuto",
        ] {
            features.choose(automatic, "Off")?;
        }
        features.switch_off("GammaEnable")?;
        features.choose("ExposureMode", "Timed")?;
        features.choose("AcquisitionMode", "Continuous")?;
        features.choose("TriggerSelector", "FrameStart")?;
        let is_triggered = features.choose("TriggerSource", "Software")?
            && features.choose("TriggerMode", "On")?;
        match is_triggered {
            true => Ok(()),
            false => Err(features.refused(
                "TriggerSource = Software",
                "the camera cannot be triggered by software",
            )),
        }
    }

    /// Gain as a factor of the camera's lowest. Cameras state decibels, or a factor without
    /// a unit whose lowest is 1.
    fn set_gain(&self, factor: f64) -> Result<f64, DeviceError> {
        let features = &self.features;
        if !features.has(GAIN) {
            return match factor == 1.0 {
                true => Ok(1.0),
                false => Err(features.refused(GAIN, "the camera has no gain, so only 1")),
            };
        }
        let [lowest, _] = features.bounds(GAIN)?;
        match features.unit(GAIN).as_str() {
            "dB" | "" if lowest < 0.5 => {
                let db = features.set_float(GAIN, lowest + 20.0 * factor.log10())?;
                Ok(10_f64.powf((db - lowest) / 20.0))
            }
            _ if lowest > 0.0 => Ok(features.set_float(GAIN, lowest * factor)? / lowest),
            unit => {
                let reason = format!("its unit is {unit:?}, neither dB nor a factor");
                Err(features.refused(GAIN, reason))
            }
        }
    }

    /// Opens the stream once; the device sends where it says.
    fn start(&mut self) -> Result<(), DeviceError> {
        let features = &self.features;
        let failed = |error| features.failed("a stream", &error);
        if self.stream.is_none() {
            if let Some(network) = features.device.downcast_ref::<GvDevice>() {
                // A raw socket needs rights that programs rarely have, and sees no packets of
                // the loopback device.
                network.set_stream_options(GvStreamOption::PACKET_SOCKET_DISABLED);
                let address = features.integer("GevCurrentIPAddress").unwrap_or(0);
                let tuned = match address >> 24 == 127 {
                    true => network.set_packet_size(LOOPBACK_PACKET as i32),
                    false => network.auto_packet_size(),
                };
                // The size that it has stays.
                tuned.unwrap_or_else(|error| tracing::debug!("packet size: {error}"));
            }
            let stream = self.camera.create_stream().map_err(failed)?;
            let bytes = features.integer("PayloadSize")?;
            for _ in 0..BUFFERS {
                stream.push_buffer(Buffer::new_allocate(bytes.max(1) as usize));
            }
            self.stream = Some(stream);
        }
        features.execute("AcquisitionStart")
    }

    fn bad_frame(&self, fault: FrameFault) -> DeviceError {
        DeviceError::BadFrame {
            device: self.device.clone(),
            fault,
        }
    }

    /// What a frame holds; `None` where it is not the one that was requested.
    fn read(&mut self, buffer: &Buffer) -> Result<RawFrame, DeviceError> {
        let (number, start_ns) = (buffer.frame_id(), buffer.timestamp());
        if buffer.status() != BufferStatus::Success {
            return Err(self.bad_frame(FrameFault::Damaged));
        }
        // Numbers run on without gaps, from 65 535 to 1 on old links.
        if let Some((last, last_ns)) = self.last {
            if start_ns <= last_ns {
                return Err(self.bad_frame(FrameFault::Late));
            }
            self.frames_lost += number.saturating_sub(last + 1);
        }
        self.last = Some((number, start_ns));
        let found = [buffer.image_width(), buffer.image_height()].map(|side| side as u32);
        let pixels = found[0] as usize * found[1] as usize;
        if found != self.info.resolution_px {
            return Err(self.bad_frame(FrameFault::Size {
                found,
                counts: pixels,
                expected: self.info.resolution_px,
            }));
        }
        if buffer.image_pixel_format().raw() != self.format.code {
            let fault = format!("its pixel format is not {}", self.format.name);
            return Err(self.bad_frame(FrameFault::Undecodable(fault)));
        }
        let bytes = buffer.image_data();
        let counts = self.format.decode(&bytes, pixels, self.info.bit_depth);
        let counts = counts.map_err(|fault| self.bad_frame(fault))?;
        Ok(RawFrame {
            width: found[0],
            height: found[1],
            counts,
            sequence: Some(number),
            timestamp: Some(Seconds(start_ns as f64 * 1e-9)),
        })
    }
}

impl Camera for GenicamCamera {
    fn info(&self) -> &CameraInfo {
        &self.info
    }

    fn configure(&mut self, requested: CameraSettings) -> Result<CameraSettings, DeviceError> {
        self.settings = None;
        // Some cameras take settings only between acquisitions.
        if self.stream.is_some() {
            self.features.execute("AcquisitionStop")?;
        }
        self.set_manual()?;
        let gain = self.set_gain(requested.gain)?;
        let exposure_us = self
            .features
            .set_float(EXPOSURE, requested.exposure.0 / US)?;
        let settings = CameraSettings {
            exposure: Seconds(exposure_us * US),
            gain,
        };
        self.last = None;
        self.start()?;
        self.settings = Some(settings);
        Ok(settings)
    }

    /// Cameras have no shutter that GenICam could close.
    fn set_shutter(&mut self, _open: bool) -> Result<bool, DeviceError> {
        Ok(false)
    }

    fn grab(&mut self, _: FrameKey) -> Result<RawFrame, DeviceError> {
        let (Some(settings), Some(stream)) = (self.settings, self.stream.clone()) else {
            let reason = "it is not configured";
            return Err(self.features.refused("a frame", reason));
        };
        // What nobody requested goes back.
        while let Some(buffer) = stream.try_pop_buffer() {
            stream.push_buffer(buffer);
        }
        let timeout = Seconds(settings.exposure.0 + self.timeout.0);
        let deadline = Instant::now() + timeout.to_duration();
        self.features.execute("TriggerSoftware")?;
        let left = deadline.saturating_duration_since(Instant::now());
        let popped =
            stream.timeout_pop_buffer(left.max(Duration::from_millis(1)).as_micros() as u64);
        match popped {
            Some(buffer) => {
                let frame = self.read(&buffer);
                stream.push_buffer(buffer);
                frame
            }
            None => {
                // Whether it is still there.
                self.features.integer("PayloadSize")?;
                Err(DeviceError::NoReply {
                    device: self.device.clone(),
                    timeout,
                    sent: "TriggerSoftware".to_owned(),
                })
            }
        }
    }

    fn temperature_c(&mut self) -> Option<f64> {
        let feature = "DeviceTemperature";
        let has = self.features.has(feature);
        has.then(|| self.features.float(feature).ok()).flatten()
    }

    fn frames_lost(&self) -> u64 {
        self.frames_lost
    }

    fn longest_frame(&self, exposure: Seconds) -> Seconds {
        // The trigger and the question whether the camera is there have time-outs of their own.
        Seconds(exposure.0.max(0.0) + self.timeout.0 + 10.0)
    }

    fn may_return_within(&self) -> Seconds {
        RETURN_TIMEOUT
    }

    fn reconnect(&mut self) -> Result<(), DeviceError> {
        let gone = |_| DeviceError::Disconnected {
            device: self.device.clone(),
        };
        let description = Description {
            info: self.info.clone(),
            timeout: self.timeout,
            keeper: None,
        };
        self.stream = None;
        let again = Self::open(&self.device, &description).map_err(gone)?;
        let frames_lost = self.frames_lost;
        *self = again;
        self.frames_lost = frames_lost;
        Ok(())
    }
}
