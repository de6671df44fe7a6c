//! The sensor behind the network: what it counts in a frame of given settings.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use super::memory::{Identity, Memory, TICKS_PER_S};
use mock_devices::RadianceSource;
use mock_devices::bench::Bench;
use mock_devices::camera::CameraConfig;
use mock_devices::sensor::{FrameKey, NoiseKey, SensorModel};

/// Settings of a frame as the registers have them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Settings {
    pub exposure_s: f64,
    pub gain: f64,
    pub black_dn: f64,
}

/// A sensor that sees a scene in the light of the bench.
pub struct Exposer {
    sensor: SensorModel,
    scene: Arc<dyn RadianceSource>,
    bench: Bench,
    config: CameraConfig,
    on_since_s: f64,
    frames: AtomicU64,
}

impl Exposer {
    /// The device is switched on now. Of `config`, the read-out, the interval of frames, the
    /// temperatures and the seed count; exposures and gains are the registers'.
    pub fn new(
        config: CameraConfig,
        sensor: SensorModel,
        scene: Arc<dyn RadianceSource>,
        bench: Bench,
    ) -> Self {
        Self {
            on_since_s: bench.clock().now_s(),
            sensor,
            scene,
            bench,
            config,
            frames: AtomicU64::new(0),
        }
    }

    pub(super) fn memory(&self, identity: &Identity) -> Memory {
        let black_dn = self.sensor.config().black_level_dn;
        Memory::new(identity, self.sensor.resolution_px(), black_dn)
    }

    pub(super) fn bit_depth(&self) -> u32 {
        self.sensor.config().bit_depth
    }

    pub(super) fn temperature_c(&self) -> f64 {
        let [cold, warm] = self.config.temperature_c;
        let on_s = self.bench.clock().now_s() - self.on_since_s;
        warm + (cold - warm) * (-on_s / self.config.warming_s).exp()
    }

    /// The device's clock.
    pub(super) fn ticks(&self) -> u64 {
        ticks(self.bench.clock().now_s() - self.on_since_s)
    }

    /// How long after the start of a frame the next one begins where none is triggered.
    pub(super) fn wait_for_interval(&self, start_ticks: u64) {
        let start_s = self.on_since_s + start_ticks as f64 / TICKS_PER_S;
        let clock = self.bench.clock();
        clock.wait_until(start_s + self.config.frame_interval_s);
    }

    /// A frame that begins now: when, in ticks, and its counts, after exposure and read-out.
    pub(super) fn expose(&self, settings: Settings) -> (u64, Vec<u16>) {
        let clock = self.bench.clock();
        let start_s = clock.now_s();
        let end_s = start_s + settings.exposure_s;
        // In real time the scene is rendered during the exposure, from what the bench is going
        // to do, and once more only if something else happened.
        let expected = self.bench.illumination_over(start_s, end_s);
        let rendered = self.scene.radiance(&expected);
        clock.wait_until(end_s + self.config.readout_s);
        let light = self.bench.illumination_over(start_s, end_s);
        let radiance = match light == expected {
            true => rendered,
            false => self.scene.radiance(&light),
        };
        let number = self.frames.fetch_add(1, Ordering::Relaxed);
        let noise = NoiseKey {
            seed: self.config.noise_seed,
            frame: FrameKey {
                light: 0,
                exposure: (number >> 32) as u32,
                repeat: number as u32,
                kind: 3,
            },
        };
        let Settings {
            exposure_s,
            gain,
            black_dn,
        } = settings;
        let mut counts = self.sensor.expose(&radiance, exposure_s, gain, noise);
        let raised = (black_dn - self.sensor.config().black_level_dn).round() as i32;
        if raised != 0 {
            let most = i32::from(self.sensor.saturation_dn());
            for count in &mut counts {
                *count = (i32::from(*count) + raised).clamp(0, most) as u16;
            }
        }
        (ticks(start_s - self.on_since_s), counts)
    }
}

fn ticks(seconds: f64) -> u64 {
    (seconds * TICKS_PER_S) as u64
}
