//! The simulated camera before a white card that a simulated lamp lights, on a
//! clock that jumps: for calibrations of the lamp.

use std::sync::Arc;

use mock_devices::bench::{Bench, BenchConfig};
use mock_devices::camera::{CameraConfig, SimulatedCamera as MockCamera};
use mock_devices::clock::Clock;
use mock_devices::sensor::{SensorConfig, SensorModel};
use mock_devices::{Illumination, RadianceSource};

use super::Mosaic;
use super::simulated_camera::SimulatedCamera;

pub use mock_devices::bench::LampModel;

/// Width and height of its frames.
const SIZE: [u32; 2] = [48, 32];

/// The card, the lamp and the clock that they share.
#[derive(Clone)]
pub struct LitCard {
    bench: Bench,
}

struct Card {
    radiance: f64,
}

impl RadianceSource for Card {
    fn resolution_px(&self) -> [u32; 2] {
        SIZE
    }
    fn radiance(&self, light: &Illumination) -> Arc<Vec<f32>> {
        let radiance = (self.radiance * light.channels[0]) as f32;
        Arc::new(vec![radiance; (SIZE[0] * SIZE[1]) as usize])
    }
}

impl LitCard {
    /// A cold lamp, and the camera that sees the card at this radiance (W/(m² sr))
    /// under the full lamp. The seed is that of sensor and noise.
    pub fn new(lamp: LampModel, radiance: f64, seed: u64) -> (Self, SimulatedCamera) {
        let config = BenchConfig {
            lamp,
            ..BenchConfig::default()
        };
        let bench = Bench::new(config, Clock::instant());
        let sensor = SensorModel::new(SensorConfig::typical(SIZE, seed));
        let camera = CameraConfig {
            noise_seed: seed,
            ..CameraConfig::default()
        };
        let mock = MockCamera::new(camera, bench.clone(), sensor, Arc::new(Card { radiance }));
        let camera = SimulatedCamera::new(mock, "CARD-1".to_owned(), Mosaic::None);
        (Self { bench }, camera)
    }

    /// Switches the lamp.
    pub fn switch(&self, on: bool) {
        let drive = if on { [1.0, 0.0, 0.0] } else { [0.0; 3] };
        self.bench.set_lamp(self.bench.clock().now_s(), drive);
    }

    /// Whether the lamp is off.
    pub fn is_dark(&self) -> bool {
        self.bench.lamp_drive() == [0.0; 3]
    }

    /// Lets time pass, seconds.
    pub fn wait(&self, seconds: f64) {
        self.bench.clock().advance(seconds);
    }
}
