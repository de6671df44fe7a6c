//! What the camera of a simulated rig sees while it is calibrated: an integrating sphere, a white
//! card before the lamp, or one with black traps.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use mock_devices::bench::{Bench as SimulatedBench, BenchConfig};
use mock_devices::camera::{CameraConfig as MockCameraConfig, SimulatedCamera as MockCamera};
use mock_devices::clock::Clock;
use mock_devices::sensor::{SensorConfig, SensorModel};
use mock_devices::{Illumination, RadianceSource};

use super::{CameraConfig, RigConfig};
use crate::device::simulated_camera::SimulatedCamera;
use crate::device::{Camera, DeviceError};
use crate::simulation::glare_card;

/// Radiance of the simulated uniform light, W/(m² sr), where none is stated.
pub const UNIFORM_RADIANCE: f64 = 0.4;

/// A simulated lamp on a white card, and the camera that looks at it.
pub struct LampBench {
    /// The camera.
    pub camera: Box<dyn Camera>,
    /// Switches the lamp.
    pub switch: Box<dyn FnMut(bool) -> Result<(), DeviceError>>,
    clock: Clock,
}

/// The camera before a white card with two black traps.
pub struct TrapCard {
    /// The camera.
    pub camera: Box<dyn Camera>,
    /// Regions inside the traps, pixels: first column, first row, columns, rows.
    pub traps: [[usize; 4]; 2],
}

impl LampBench {
    /// Lets so many seconds pass.
    pub fn clock(&self) -> impl FnMut(f64) + use<> {
        let clock = self.clock.clone();
        move |seconds| clock.advance(seconds)
    }
}

impl RigConfig {
    /// The simulated camera in front of an integrating sphere: it sees `radiance` while the
    /// switch is on, and `other` radiance always. `None` for a real rig.
    pub fn evenly_lit_camera(
        &self,
        radiance: f64,
        other: f64,
    ) -> Option<(Box<dyn Camera>, Arc<AtomicBool>)> {
        struct Sphere {
            resolution_px: [u32; 2],
            /// With the light off and on.
            radiance: [Arc<Vec<f32>>; 2],
            is_on: Arc<AtomicBool>,
        }
        impl RadianceSource for Sphere {
            fn resolution_px(&self) -> [u32; 2] {
                self.resolution_px
            }
            fn radiance(&self, _: &Illumination) -> Arc<Vec<f32>> {
                self.radiance[usize::from(self.is_on.load(Ordering::Relaxed))].clone()
            }
        }
        let sensor = self.simulation.as_ref()?.sensor.clone();
        let is_on = Arc::new(AtomicBool::new(true));
        let [width, height] = self.camera.resolution_px.map(|n| n as usize);
        let sphere = Sphere {
            resolution_px: self.camera.resolution_px,
            radiance: [other, other + radiance]
                .map(|radiance| Arc::new(vec![radiance as f32; width * height])),
            is_on: is_on.clone(),
        };
        let bench = SimulatedBench::new(BenchConfig::default(), Clock::instant());
        let camera = simulated_camera(&self.camera, sensor, bench, Arc::new(sphere));
        Some((camera, is_on))
    }

    /// The simulated rig's lamp, cold, with one channel wired to the switch; `None` for a real
    /// rig.
    pub fn lamp_on_card(&self, channel: u8) -> Option<LampBench> {
        struct Card {
            resolution_px: [u32; 2],
        }
        impl RadianceSource for Card {
            fn resolution_px(&self) -> [u32; 2] {
                self.resolution_px
            }
            fn radiance(&self, light: &Illumination) -> Arc<Vec<f32>> {
                let pixels = self.resolution_px.iter().product::<u32>() as usize;
                let relative: f64 = light.channels.iter().sum();
                Arc::new(vec![(UNIFORM_RADIANCE * relative) as f32; pixels])
            }
        }
        let simulation = self.simulation.as_ref()?;
        let config = BenchConfig {
            lamp: simulation.lamp,
            ..BenchConfig::default()
        };
        let clock = Clock::instant();
        let bench = SimulatedBench::new(config, clock.clone());
        let resolution_px = self.camera.resolution_px;
        let camera = simulated_camera(
            &self.camera,
            simulation.sensor.clone(),
            bench.clone(),
            Arc::new(Card { resolution_px }),
        );
        let switch = move |on: bool| {
            let mut drive = [0.0; 3];
            if on && let Some(drive) = drive.get_mut(usize::from(channel)) {
                *drive = 1.0;
            }
            bench.set_lamp(bench.clock().now_s(), drive);
            Ok(())
        };
        Some(LampBench {
            camera,
            switch: Box::new(switch),
            clock,
        })
    }

    /// The simulated camera before a white card with two black traps of this reflectance over
    /// the card's. `None` for a real rig.
    pub fn camera_before_traps(&self, trap_reflectance: f64) -> Option<TrapCard> {
        struct Card {
            resolution_px: [u32; 2],
            radiance: Arc<Vec<f32>>,
        }
        impl RadianceSource for Card {
            fn resolution_px(&self) -> [u32; 2] {
                self.resolution_px
            }
            fn radiance(&self, _: &Illumination) -> Arc<Vec<f32>> {
                self.radiance.clone()
            }
        }
        let simulation = self.simulation.as_ref()?;
        let resolution_px = self.camera.resolution_px;
        let (card, traps) = glare_card::card(
            resolution_px.map(|n| n as usize),
            [UNIFORM_RADIANCE, trap_reflectance],
            simulation.glare,
        );
        let card = Card {
            resolution_px,
            radiance: Arc::new(card),
        };
        let bench = SimulatedBench::new(BenchConfig::default(), Clock::instant());
        let sensor = simulation.sensor.clone();
        let camera = simulated_camera(&self.camera, sensor, bench, Arc::new(card));
        Some(TrapCard { camera, traps })
    }
}

fn simulated_camera(
    camera: &CameraConfig,
    sensor: SensorConfig,
    bench: SimulatedBench,
    source: Arc<dyn RadianceSource>,
) -> Box<dyn Camera> {
    let config = MockCameraConfig {
        exposure_range_s: camera.exposure_range.map(|s| s.0),
        exposure_step_s: camera.exposure_step.0,
        settings_latency_frames: camera.settings_latency_frames,
        has_shutter: true,
        // Frames of a calibration and of a capture must not share their noise.
        noise_seed: sensor.seed ^ 0x6361_6c69_6272_6174,
        ..MockCameraConfig::default()
    };
    let mock = MockCamera::new(config, bench, SensorModel::new(sensor), source);
    let serial = camera.serial.clone().unwrap_or_default();
    Box::new(SimulatedCamera::new(mock, serial, camera.mosaic))
}
