//! The simulated camera behind the production trait; it needs no serial port.

use mock_devices::camera::{CameraFaults, MockCameraError, SimulatedCamera as MockCamera};
use mock_devices::sensor::{FrameKey as MockFrameKey, SensorModel};

use super::frame_row::PreviousFrame;
use super::retake::FrameFault;
use super::{
    Camera, CameraInfo, CameraSettings, DeviceError, FrameKey, FrameKind, Mosaic, RawFrame,
};
use crate::units::Seconds;

pub use mock_devices::RadianceSource;

/// The simulated camera behind the [`Camera`] trait.
pub struct SimulatedCamera {
    camera: MockCamera,
    info: CameraInfo,
    frames_lost: u64,
    may_return_within: Seconds,
    previous: Option<PreviousFrame>,
    /// When the last frame began, on the bench's clock.
    last_start_s: f64,
}

impl SimulatedCamera {
    /// Wraps a mock camera whose radiance source accounts for `mosaic`.
    pub fn new(camera: MockCamera, serial: String, mosaic: Mosaic) -> Self {
        let sensor = camera.sensor().config();
        let info = CameraInfo {
            driver: "simulated".to_owned(),
            model: format!("simulated {}-bit sensor", sensor.bit_depth),
            serial,
            resolution_px: sensor.resolution_px,
            bit_depth: sensor.bit_depth,
            mosaic,
            exposure_range: camera.config().exposure_range_s.map(Seconds),
            exposure_step: Seconds(camera.config().exposure_step_s),
        };
        Self {
            camera,
            info,
            frames_lost: 0,
            may_return_within: Seconds(0.0),
            previous: None,
            last_start_s: f64::NEG_INFINITY,
        }
    }

    /// How long it is waited for after it was unplugged; 0, as it begins: not at all.
    pub fn wait_for_return(&mut self, within: Seconds) {
        self.may_return_within = within;
    }

    fn bad_frame(&self, fault: FrameFault) -> DeviceError {
        DeviceError::BadFrame {
            device: self.name(),
            fault,
        }
    }

    fn name(&self) -> String {
        format!("{} {}", self.info.model, self.info.serial)
    }

    /// Handle by which it is made to fail.
    pub fn faults(&self) -> CameraFaults {
        self.camera.faults()
    }

    /// The true sensor.
    pub fn sensor(&self) -> &SensorModel {
        self.camera.sensor()
    }

    fn error(&self, error: MockCameraError) -> DeviceError {
        let device = self.name();
        match error {
            MockCameraError::Disconnected => DeviceError::Disconnected { device },
            MockCameraError::NoFrame { timeout_s } => DeviceError::NoReply {
                device,
                timeout: Seconds(timeout_s),
                sent: "a request for a frame".to_owned(),
            },
            MockCameraError::SizeMismatch { .. } => DeviceError::Refused {
                device,
                command: "a request for a frame".to_owned(),
                reason: error.to_string(),
            },
        }
    }
}

impl Camera for SimulatedCamera {
    fn info(&self) -> &CameraInfo {
        &self.info
    }

    fn configure(&mut self, requested: CameraSettings) -> Result<CameraSettings, DeviceError> {
        self.previous = None;
        match self.camera.configure(requested.exposure.0, requested.gain) {
            Ok(applied) => Ok(CameraSettings::new(
                Seconds(applied.exposure_s),
                applied.gain,
            )),
            Err(error) => Err(self.error(error)),
        }
    }

    fn set_shutter(&mut self, open: bool) -> Result<bool, DeviceError> {
        self.previous = None;
        match self.camera.set_shutter(open) {
            Ok(exists) => Ok(exists),
            Err(error) => Err(self.error(error)),
        }
    }

    fn grab(&mut self, key: FrameKey) -> Result<RawFrame, DeviceError> {
        let asked_for = key;
        let key = MockFrameKey {
            light: key.light,
            exposure: key.exposure,
            repeat: key.repeat,
            kind: match key.kind {
                FrameKind::Light => 0,
                FrameKind::Ambient => 1,
                FrameKind::Dark => 2,
            },
        };
        let asked = Seconds(self.camera.bench().clock().now_s());
        let since = self
            .previous
            .take()
            .and_then(|previous| previous.unchanged_since(asked_for, asked))
            .unwrap_or(asked);
        let frame = match self.camera.grab_since(key, since.0) {
            Ok(frame) => frame,
            Err(error) => return Err(self.error(error)),
        };
        let is_old = frame.timestamp_s <= self.last_start_s;
        self.last_start_s = frame.timestamp_s;
        if frame.timestamp_s < since.0 || is_old {
            return Err(self.bad_frame(FrameFault::Late));
        }
        self.frames_lost += frame.lost;
        if frame.damaged {
            return Err(self.bad_frame(FrameFault::Damaged));
        }
        self.previous = Some(PreviousFrame {
            key: asked_for,
            since,
            returned: Seconds(self.camera.bench().clock().now_s()),
        });
        Ok(RawFrame {
            width: frame.width,
            height: frame.height,
            counts: frame.counts,
            sequence: Some(frame.sequence),
            timestamp: Some(Seconds(frame.timestamp_s)),
        })
    }

    fn temperature_c(&mut self) -> Option<f64> {
        let is_there = !self.camera.faults().now().is_disconnected;
        is_there.then(|| self.camera.temperature_c())
    }

    fn frames_lost(&self) -> u64 {
        self.frames_lost
    }

    fn may_return_within(&self) -> Seconds {
        self.may_return_within
    }

    fn reconnect(&mut self) -> Result<(), DeviceError> {
        // Any command would do: it fails while the camera is gone.
        match self.camera.set_shutter(true) {
            Ok(_) => Ok(()),
            Err(error) => Err(self.error(error)),
        }
    }
}
