//! What the camera of a simulated rig sees while it is calibrated: an integrating sphere, a white
//! card before the lamp, or one with black traps.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use mock_devices::bench::{Bench as SimulatedBench, BenchConfig};
use mock_devices::camera::{CameraConfig as MockCameraConfig, SimulatedCamera as MockCamera};
use mock_devices::clock::Clock;
use mock_devices::sensor::{SensorConfig, SensorModel};
use mock_devices::{Illumination, RadianceSource};

use super::RigConfig;
use crate::device::simulated_camera::SimulatedCamera;
use crate::device::{Camera, DeviceError};
use crate::simulation::glare_card;

/// Radiance of the simulated uniform light, W/(m² sr), where none is stated.
pub const UNIFORM_RADIANCE: f64 = 0.4;

/// A simulated lamp on a white card, and the camera that looks at it.
#[allow(missing_docs)]
pub struct LampBench {
    pub camera: Box<dyn Camera>,
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
        let sensor = self.simulation.as_ref()?.sensor.clone();
        let is_on = Arc::new(AtomicBool::new(true));
        let pixels = self.camera.resolution_px.map(|n| n as usize);
        // With the light off and on.
        let evenly = |radiance: f64| Arc::new(vec![radiance as f32; pixels[0] * pixels[1]]);
        let off_on = [other, other + radiance].map(evenly);
        let switch = is_on.clone();
        let camera = self.camera_before(sensor, still_bench(), move |_| {
            off_on[usize::from(switch.load(Ordering::Relaxed))].clone()
        });
        Some((camera, is_on))
    }

    /// The simulated rig's lamp, cold, with one channel wired to the switch; `None` for a real
    /// rig.
    pub fn lamp_on_card(&self, channel: u8) -> Option<LampBench> {
        let simulation = self.simulation.as_ref()?;
        let config = BenchConfig {
            lamp: simulation.lamp,
            ..BenchConfig::default()
        };
        let clock = Clock::instant();
        let bench = SimulatedBench::new(config, clock.clone());
        let pixels = self.camera.resolution_px.iter().product::<u32>() as usize;
        let sensor = simulation.sensor.clone();
        let camera = self.camera_before(sensor, bench.clone(), move |light| {
            let relative: f64 = light.channels.iter().sum();
            Arc::new(vec![(UNIFORM_RADIANCE * relative) as f32; pixels])
        });
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
        let simulation = self.simulation.as_ref()?;
        let (card, traps) = glare_card::card(
            self.camera.resolution_px.map(|n| n as usize),
            [UNIFORM_RADIANCE, trap_reflectance],
            simulation.glare,
        );
        let card = Arc::new(card);
        let sensor = simulation.sensor.clone();
        let camera = self.camera_before(sensor, still_bench(), move |_| card.clone());
        Some(TrapCard { camera, traps })
    }

    /// The simulated camera before what has this radiance under the bench's lamp, row by row.
    fn camera_before(
        &self,
        sensor: SensorConfig,
        bench: SimulatedBench,
        radiance: impl Fn(&Illumination) -> Arc<Vec<f32>> + Send + Sync + 'static,
    ) -> Box<dyn Camera> {
        let camera = &self.camera;
        let config = MockCameraConfig {
            exposure_range_s: camera.exposure_range.map(|s| s.0),
            exposure_step_s: camera.exposure_step.0,
            settings_latency_frames: camera.settings_latency_frames,
            has_shutter: true,
            // Frames of a calibration and of a capture must not share their noise.
            noise_seed: sensor.seed ^ 0x6361_6c69_6272_6174,
            ..MockCameraConfig::default()
        };
        let view = View {
            resolution_px: camera.resolution_px,
            radiance,
        };
        let mock = MockCamera::new(config, bench, SensorModel::new(sensor), Arc::new(view));
        let serial = camera.serial.clone().unwrap_or_default();
        Box::new(SimulatedCamera::new(mock, serial, camera.mosaic))
    }
}

/// A bench on which nothing moves.
fn still_bench() -> SimulatedBench {
    SimulatedBench::new(BenchConfig::default(), Clock::instant())
}

/// What has a radiance by the light on it.
struct View<F> {
    resolution_px: [u32; 2],
    radiance: F,
}

impl<F: Fn(&Illumination) -> Arc<Vec<f32>> + Send + Sync> RadianceSource for View<F> {
    fn resolution_px(&self) -> [u32; 2] {
        self.resolution_px
    }

    fn radiance(&self, light: &Illumination) -> Arc<Vec<f32>> {
        (self.radiance)(light)
    }
}
