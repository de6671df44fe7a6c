//! The even light that a calibration looks at: asked of the operator, or simulated.

use std::io::{BufRead, IsTerminal};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use mock_devices::bench::{Bench as SimulatedBench, BenchConfig};
use mock_devices::camera::{CameraConfig as MockCameraConfig, SimulatedCamera as MockCamera};
use mock_devices::clock::Clock;
use mock_devices::sensor::{SensorConfig, SensorModel};
use mock_devices::{Illumination, RadianceSource};

use crate::capture::open::open_real_camera;
use crate::cli::CliError;
use crate::cli::output::write_stderr;
use crate::config::{CameraConfig, RigConfig};
use crate::device::simulated_camera::SimulatedCamera;
use crate::device::{Camera, DeviceError};

/// Radiance of the simulated uniform light, W/(m² sr), where none is stated.
pub(super) const UNIFORM_RADIANCE: f64 = 0.4;

pub(super) const LIGHT_HINT: &str = "point the camera at a steady, uniform light that saturates it within two \
    seconds but not in its shortest exposure; nothing was kept";

/// Asks the operator where the camera has no shutter; `false` without a terminal.
pub(super) fn ask_to_cover(cover: bool) -> bool {
    let what = if cover { "Cover" } else { "Uncover" };
    ask(&format!("{what} the lens"))
}

/// Asks the operator to switch the even light.
pub(super) fn ask_to_switch(on: bool) -> bool {
    let what = if on { "on" } else { "off" };
    ask(&format!(
        "Switch the light {what} and leave the room as it is"
    ))
}

fn ask(what: &str) -> bool {
    if !std::io::stdin().is_terminal() {
        return false;
    }
    write_stderr(&format!("{what}, then press Enter: "));
    std::io::stdin()
        .lock()
        .lines()
        .next()
        .is_some_and(|line| line.is_ok())
}

/// The rig's camera; a simulated one sees an even light of this radiance.
pub(super) fn open_camera(rig: &RigConfig, radiance: f64) -> Result<Box<dyn Camera>, CliError> {
    Ok(open_switched_camera(rig, radiance, 0.0)?.0)
}

/// A camera, and the switch of its light where both are simulated.
type Switched = (Box<dyn Camera>, Option<Arc<AtomicBool>>);

/// The rig's camera; a simulated one sees an even light of this radiance while the
/// switch is on, and `other` radiance always.
pub(super) fn open_switched_camera(
    rig: &RigConfig,
    radiance: f64,
    other: f64,
) -> Result<Switched, CliError> {
    let Some(sensor) = simulated_sensor(rig) else {
        return Ok((open_real_camera(rig, &crate::cli::open::of_port()?)?, None));
    };
    let is_on = Arc::new(AtomicBool::new(true));
    let camera = uniformly_lit(&rig.camera, sensor, [radiance, other], is_on.clone());
    Ok((camera, Some(is_on)))
}

/// The true sensor of a simulated rig: calibration and capture must see the same one.
pub fn simulated_sensor(rig: &RigConfig) -> Option<SensorConfig> {
    Some(rig.simulation.as_ref()?.sensor.clone())
}

/// The simulated camera in front of an integrating sphere.
fn uniformly_lit(
    camera: &CameraConfig,
    sensor: SensorConfig,
    [radiance, other]: [f64; 2],
    is_on: Arc<AtomicBool>,
) -> Box<dyn Camera> {
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
    let [width, height] = camera.resolution_px.map(|n| n as usize);
    let sphere = Sphere {
        resolution_px: camera.resolution_px,
        radiance: [other, other + radiance]
            .map(|radiance| Arc::new(vec![radiance as f32; width * height])),
        is_on,
    };
    let bench = SimulatedBench::new(BenchConfig::default(), Clock::instant());
    simulated_camera(camera, sensor, bench, Arc::new(sphere))
}

pub(super) fn simulated_camera(
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

/// A simulated lamp on a white card, and the camera that looks at it.
pub(super) struct LampBench {
    pub camera: Box<dyn Camera>,
    pub switch: Box<dyn FnMut(bool) -> Result<(), DeviceError>>,
    pub clock: Clock,
}

/// The simulated rig's lamp, cold, with one channel wired to the switch; `None`
/// for a real rig.
pub(super) fn lamp_bench(rig: &RigConfig, channel: u8) -> Option<LampBench> {
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
    let simulation = rig.simulation.as_ref()?;
    let config = BenchConfig {
        lamp: simulation.lamp,
        ..BenchConfig::default()
    };
    let clock = Clock::instant();
    let bench = SimulatedBench::new(config, clock.clone());
    let resolution_px = rig.camera.resolution_px;
    let camera = simulated_camera(
        &rig.camera,
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
