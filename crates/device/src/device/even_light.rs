//! The simulated sensor before an even light, without bench or clock: for
//! calibrations whose result can be compared with the truth.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use mock_devices::sensor::{FrameKey as MockFrameKey, NoiseKey, SensorModel};

pub use mock_devices::sensor::SensorConfig;

use super::{Camera, CameraInfo, CameraSettings, DeviceError, FrameKey, Mosaic, RawFrame};
use crate::units::Seconds;

/// A camera that looks at a light of the same radiance everywhere.
pub struct EvenLight {
    info: CameraInfo,
    sensor: SensorModel,
    settings: CameraSettings,
    open: bool,
    /// Radiance, W/(m² sr).
    pub radiance: f64,
    /// Other light, W/(m² sr): none in the first column, about this in the last.
    pub ambient: f64,
    /// Whether the light is on.
    pub is_on: Arc<AtomicBool>,
    /// Relative growth of the light from one frame to the next.
    pub drift_per_frame: f64,
    frames: u32,
    noise_seed: u64,
}

impl EvenLight {
    /// The sensor with a shutter, exposures from 50 µs to 2 s in steps of 10 µs.
    /// Equal noise seeds give equal frames.
    pub fn new(config: SensorConfig, radiance: f64, noise_seed: u64) -> Self {
        Self {
            info: CameraInfo {
                driver: "simulated".to_owned(),
                model: "simulated sensor before an even light".to_owned(),
                serial: String::new(),
                resolution_px: config.resolution_px,
                bit_depth: config.bit_depth,
                mosaic: Mosaic::None,
                exposure_range: [Seconds(5e-5), Seconds(2.0)],
                exposure_step: Seconds(1e-5),
            },
            sensor: SensorModel::new(config),
            settings: CameraSettings::new(Seconds(0.01), 1.0),
            open: true,
            radiance,
            ambient: 0.0,
            is_on: Arc::new(AtomicBool::new(true)),
            drift_per_frame: 0.0,
            frames: 0,
            noise_seed,
        }
    }

    /// The true sensor.
    pub fn sensor(&self) -> &SensorModel {
        &self.sensor
    }
}

impl Camera for EvenLight {
    fn info(&self) -> &CameraInfo {
        &self.info
    }

    fn configure(&mut self, requested: CameraSettings) -> Result<CameraSettings, DeviceError> {
        let step_s = self.info.exposure_step.0;
        let steps = (requested.exposure.0 / step_s).round().max(1.0);
        self.settings = CameraSettings {
            exposure: Seconds(steps * step_s),
            ..requested
        };
        Ok(self.settings)
    }

    fn set_shutter(&mut self, open: bool) -> Result<bool, DeviceError> {
        self.open = open;
        Ok(true)
    }

    fn grab(&mut self, key: FrameKey) -> Result<RawFrame, DeviceError> {
        let drift = 1.0 + self.drift_per_frame * f64::from(self.frames);
        self.frames += 1;
        let [width, height] = self.info.resolution_px;
        let light = match self.is_on.load(Ordering::Relaxed) {
            true => self.radiance * drift,
            false => 0.0,
        };
        let radiance = |pixel: u32| {
            let other = self.ambient * f64::from(pixel % width) / f64::from(width);
            if self.open {
                (light + other) as f32
            } else {
                0.0
            }
        };
        let radiances: Vec<f32> = (0..width * height).map(radiance).collect();
        let noise = NoiseKey {
            seed: self.noise_seed,
            frame: MockFrameKey {
                light: key.light,
                exposure: key.exposure,
                repeat: key.repeat,
                kind: key.kind as u32,
            },
        };
        let counts = self.sensor.expose(
            &radiances,
            self.settings.exposure.0,
            self.settings.gain,
            noise,
        );
        Ok(RawFrame::new(width, height, counts))
    }
}
