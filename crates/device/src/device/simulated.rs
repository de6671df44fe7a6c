//! The simulated bench behind the production traits: a camera that looks at it,
//! and its stage through the production GRBL driver on a pseudo-terminal.

use std::sync::Arc;

use mock_devices::RadianceSource;
use mock_devices::bench::{
    AngleAxis, Axis, Bench, BenchConfig, Kinematics, LampModel, Mount, StageErrors,
};
use mock_devices::camera::{CameraConfig, SimulatedCamera as MockCamera};
use mock_devices::clock::Clock;
use mock_devices::grbl::{Faults, GrblSettings, GrblSimulator, LampPin};
use mock_devices::sensor::{SensorConfig, SensorModel};

use super::grbl::protocol::{Spindle, effect_of};
use super::grbl::{GrblConfig, GrblStage, axis_index};
use super::kinematics::{AxisMap, Mechanism, Pose};
use super::simulated_camera::SimulatedCamera;
use super::{DeviceError, Mosaic};
use crate::units::StageAngles;

/// What a simulated bench is: how its devices are used, and how the truth differs.
#[derive(Clone, Debug)]
pub struct SimulatedConfig {
    /// The stage as its driver sees it. The firmware is made to match: axes,
    /// travel, lamp outputs. `port` is ignored.
    pub stage: GrblConfig,
    /// How the true stage departs from that.
    pub errors: StageErrors,
    /// The lamp's power over time.
    pub lamp: LampModel,
    /// Which channel of the lamp lights R, G and B of the scene: entry c of
    /// [`mock_devices::Illumination::channels`]; `None` stays dark.
    pub channel_of_colour: [Option<u8>; 3],
    /// The sensor.
    pub sensor: SensorConfig,
    /// The camera around it.
    pub camera: CameraConfig,
    /// The serial number that the camera reports.
    pub camera_serial: String,
    /// Colour filters that the radiance source has accounted for.
    pub mosaic: Mosaic,
    /// Whether waiting moves a virtual clock instead of taking time.
    pub instant: bool,
    /// Key of everything random about the stage; the sensor has its own.
    pub seed: u64,
}

/// A bench with its firmware running. Keep it while its devices are in use.
pub struct SimulatedBench {
    simulator: GrblSimulator,
    config: SimulatedConfig,
}

impl SimulatedBench {
    /// Builds the bench and powers its controller.
    pub fn start(config: SimulatedConfig) -> Result<Self, DeviceError> {
        let clock = if config.instant {
            Clock::instant()
        } else {
            Clock::real_time()
        };
        Self::start_at(config, clock)
    }

    fn start_at(config: SimulatedConfig, clock: Clock) -> Result<Self, DeviceError> {
        let stage = &config.stage;
        let bench = Bench::new(
            BenchConfig {
                kinematics: Kinematics {
                    azimuth: angle_axis(stage.axes[0], &stage.kinematics.first)?,
                    elevation: angle_axis(stage.axes[1], &stage.kinematics.second)?,
                    mount: mount(stage.kinematics.mechanism),
                },
                errors: config.errors,
                lamp: config.lamp,
                seed: config.seed,
                ..BenchConfig::default()
            },
            clock,
        );
        let firmware = mock_devices::grbl::GrblConfig {
            settings: settings(stage),
            lamp_wiring: config.channel_of_colour.map(|channel| {
                let commands = channel.and_then(|channel| stage.lamp_on.get(usize::from(channel)));
                commands.map_or(LampPin::None, |commands| pin_of(commands))
            }),
            ..Default::default()
        };
        let simulator =
            GrblSimulator::spawn(firmware, bench).map_err(|source| DeviceError::Io {
                device: NAME.to_owned(),
                source,
            })?;
        Ok(Self { simulator, config })
    }

    /// What it was built from.
    pub fn config(&self) -> &SimulatedConfig {
        &self.config
    }

    /// The true bench.
    pub fn bench(&self) -> &Bench {
        self.simulator.bench()
    }

    /// Handle by which the firmware is made to fail.
    pub fn stage_faults(&self) -> Faults {
        self.simulator.faults()
    }

    /// Pulls the cable of the controller.
    pub fn unplug_stage(&self) {
        self.simulator.unplug();
    }

    /// These lights were begun before this bench was started, by another process of the
    /// same session, and are captured or not: the stage's next errors are those of the
    /// visits that follow, or that go on.
    pub fn count_visits(&self, begun: &[(StageAngles, bool)]) {
        let stage = &self.config.stage;
        for &(light, is_captured) in begun {
            let Some(Pose(pose)) = stage.kinematics.solve(light) else {
                continue;
            };
            let mut target = [0.0; 3];
            for ((map, letter), coordinate) in stage
                .kinematics
                .axes()
                .into_iter()
                .zip(stage.axes)
                .zip(pose)
            {
                if let Some(axis) = axis_index(letter).and_then(|index| target.get_mut(index)) {
                    *axis = map.position(coordinate);
                }
            }
            if is_captured {
                self.bench().count_visit(target);
            } else {
                self.bench().continue_visit(target);
            }
        }
    }

    /// The stage's configuration with its port.
    pub fn stage_config(&self) -> GrblConfig {
        GrblConfig {
            port: self.simulator.path().display().to_string(),
            ..self.config.stage.clone()
        }
    }

    /// The stage, by its production driver.
    pub fn open_stage(&self) -> Result<GrblStage, DeviceError> {
        GrblStage::open(self.stage_config())
    }

    /// A camera that looks at the bench and sees what `source` renders.
    pub fn open_camera(&self, source: Arc<dyn RadianceSource>) -> SimulatedCamera {
        let SimulatedConfig {
            sensor,
            camera,
            camera_serial,
            mosaic,
            ..
        } = &self.config;
        let sensor = SensorModel::new(sensor.clone());
        SimulatedCamera::new(
            MockCamera::new(camera.clone(), self.bench().clone(), sensor, source),
            camera_serial.clone(),
            *mosaic,
        )
    }
}

const NAME: &str = "the simulated bench";

fn mount(mechanism: Mechanism) -> Mount {
    match mechanism {
        Mechanism::Rotary => Mount::Angles,
        Mechanism::Arc {
            radius_mm,
            centre_height_mm,
        } => Mount::Arc {
            radius_mm,
            centre_height_mm,
        },
        Mechanism::Gantry { height_mm } => Mount::Gantry { height_mm },
    }
}

fn angle_axis(letter: char, map: &AxisMap) -> Result<AngleAxis, DeviceError> {
    let axis = match letter {
        'X' => Axis::X,
        'Y' => Axis::Y,
        'Z' => Axis::Z,
        other => {
            return Err(DeviceError::Refused {
                device: NAME.to_owned(),
                command: format!("axis {other}"),
                reason: "the simulated controller has the axes X, Y and Z".to_owned(),
            });
        }
    };
    Ok(AngleAxis {
        axis,
        deg_per_mm: 1.0 / map.scale,
        offset_deg: map.offset,
    })
}

/// Settings of a firmware whose travel is that of the axes, and whose motors turn as fast as
/// the rig file's feed, reached within [`SPEED_UP_S`]. Its machine space begins at the switch,
/// at 0; a stage with negative positions gets none of the firmware's own soft limits.
fn settings(stage: &GrblConfig) -> GrblSettings {
    let mut settings = GrblSettings::default();
    settings.homing_pull_off = 0.0;
    for (map, letter) in stage.kinematics.axes().into_iter().zip(stage.axes) {
        let ends = [map.position(map.min), map.position(map.max)];
        settings.soft_limits &= ends.iter().all(|&end| end >= -1e-6);
        let index = axis_index(letter);
        if let Some(index) = index.filter(|&index| index < settings.max_travel.len()) {
            settings.max_travel[index] = ends[0].max(ends[1]).max(1.0);
            settings.max_rate[index] = stage.feed_per_min;
            settings.acceleration[index] = stage.feed_per_min / 60.0 / SPEED_UP_S;
        }
    }
    settings
}

/// Time in which an axis reaches its speed, s: an arm of half a kilogram on a belt.
const SPEED_UP_S: f64 = 0.5;

fn pin_of(commands: &[String]) -> LampPin {
    let (on, _) = effect_of(commands);
    match (on.spindle, on.flood, on.mist) {
        (Spindle::Clockwise | Spindle::Counterclockwise, _, _) => LampPin::Spindle,
        (_, true, _) => LampPin::Flood,
        (_, _, true) => LampPin::Mist,
        _ => LampPin::None,
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::device::kinematics::{Mechanism, TwoAxes};
    use crate::device::{
        Camera, CameraSettings, FrameKey, FrameKind, LampChannel, LampState, LightStage,
    };
    use crate::units::Seconds;
    use mock_devices::Illumination;

    /// A stage of 360° × 90° whose machine space begins at −180° and 0°, with
    /// three channels on spindle, flood and mist.
    pub(crate) fn stage_config() -> GrblConfig {
        let map = |min, max| AxisMap {
            scale: 1.0,
            offset: min,
            min,
            max,
        };
        let commands = |line: &str| vec![line.to_owned()];
        GrblConfig {
            kinematics: TwoAxes {
                mechanism: Mechanism::Rotary,
                first: map(-180.0, 180.0),
                second: map(0.0, 90.0),
                approach: 2.0,
            },
            feed_per_min: 3000.0,
            lamp_on: vec![commands("M3 S1000"), commands("M8"), commands("M7")],
            ..GrblConfig::of_port("", 115_200)
        }
    }

    pub(crate) fn simulated(clock: Clock, stage: GrblConfig) -> SimulatedBench {
        let config = SimulatedConfig {
            stage,
            errors: StageErrors::default(),
            lamp: LampModel::default(),
            channel_of_colour: [Some(0), Some(1), Some(2)],
            sensor: SensorConfig::typical([8, 4], 1),
            camera: CameraConfig::default(),
            camera_serial: "SIM-1".to_owned(),
            mosaic: Mosaic::None,
            instant: true,
            seed: 1,
        };
        SimulatedBench::start_at(config, clock).unwrap()
    }

    /// As bright as the lamp's first channel times the sine of its elevation.
    struct Flat;

    impl RadianceSource for Flat {
        fn resolution_px(&self) -> [u32; 2] {
            [8, 4]
        }
        fn radiance(&self, light: &Illumination) -> Arc<Vec<f32>> {
            let radiance = light.channels[0] * light.elevation_rad.sin();
            Arc::new(vec![radiance as f32; 32])
        }
    }

    fn key(kind: FrameKind) -> FrameKey {
        FrameKey::new(0, 0, 0, kind)
    }

    /// The camera sees what the production driver has done to the bench.
    #[test]
    fn the_camera_sees_the_stage_that_the_driver_moves() {
        let bench = simulated(Clock::instant(), stage_config());
        let mut stage = bench.open_stage().unwrap();
        let mut camera = bench.open_camera(Arc::new(Flat));
        let applied = camera
            .configure(CameraSettings::new(Seconds(0.002), 1.0))
            .unwrap();
        assert_eq!(applied.exposure, Seconds(0.002));
        stage.home().unwrap();
        let mut mean = |stage: &mut GrblStage, elevation_deg, lamp| {
            let target = StageAngles::new(20.0, elevation_deg);
            stage.move_to(target).unwrap();
            stage.set_lamp(lamp).unwrap();
            for _ in 0..3 {
                camera.grab(key(FrameKind::Light)).unwrap();
            }
            let frame = camera.grab(key(FrameKind::Light)).unwrap();
            frame.counts.iter().map(|&c| f64::from(c)).sum::<f64>() / 32.0
        };
        // 1e6 e/s × 2 ms × 0.38 DN/e = 760 DN over 64; shot noise of the mean of
        // 32 pixels is 3 DN.
        let above = mean(&mut stage, 90.0, LampState::On(LampChannel(0)));
        let oblique = mean(&mut stage, 30.0, LampState::On(LampChannel(0)));
        let other = mean(&mut stage, 30.0, LampState::On(LampChannel(1)));
        assert!((above - 824.0).abs() < 20.0, "{above}");
        assert!((oblique - 444.0).abs() < 20.0, "{oblique}");
        assert!((other - 64.0).abs() < 4.0, "{other}");
    }

    /// What the driver makes of a direction, and what the bench, which was written
    /// by itself, makes of the motors' positions.
    #[test]
    fn every_mechanism_brings_the_lamp_to_its_direction() {
        let map = |min, max| AxisMap {
            scale: 2.0,
            offset: min,
            min,
            max,
        };
        let arc = Mechanism::Arc {
            radius_mm: 300.0,
            centre_height_mm: -40.0,
        };
        let gantry = Mechanism::Gantry { height_mm: 350.0 };
        for (mechanism, first, second) in [
            (Mechanism::Rotary, map(-180.0, 180.0), map(0.0, 90.0)),
            (arc, map(-180.0, 180.0), map(0.0, 90.0)),
            (gantry, map(-400.0, 400.0), map(-400.0, 400.0)),
        ] {
            let mut stage = stage_config();
            stage.kinematics = TwoAxes {
                mechanism,
                first,
                second,
                approach: 2.0,
            };
            let bench = simulated(Clock::instant(), stage);
            let mut stage = bench.open_stage().unwrap();
            stage.home().unwrap();
            for [azimuth_deg, elevation_deg] in [[30.0, 60.0], [-120.0, 45.0], [100.0, 85.0]] {
                let target = StageAngles::new(azimuth_deg, elevation_deg);
                stage.move_to(target).unwrap();
                let [azimuth, elevation] = bench.bench().stage_angles_deg();
                let is = StageAngles::new(azimuth, elevation);
                let off = is.to_light().angle_between(target.to_light());
                assert!(off.to_degrees() < 0.01, "{mechanism:?}: {is} for {target}");
            }
        }
    }

    /// A bench that knows of an earlier visit errs as the one that made it.
    #[test]
    fn visits_are_counted_across_benches() {
        let at = |azimuth_deg, elevation_deg| StageAngles {
            azimuth_deg,
            elevation_deg,
        };
        let lights = [at(20.0, 61.7), at(-33.3, 80.0)];
        let errors = StageErrors {
            repeatability_mm: 0.1,
            ..StageErrors::default()
        };
        let start = || {
            let config = simulated(Clock::instant(), stage_config()).config;
            let bench = SimulatedBench::start(SimulatedConfig { errors, ..config }).unwrap();
            let mut stage = bench.open_stage().unwrap();
            stage.home().unwrap();
            (bench, stage)
        };
        let visit = |(bench, stage): &mut (SimulatedBench, GrblStage), light| {
            stage.move_to(light).unwrap();
            stage.set_lamp(LampState::On(LampChannel(0))).unwrap();
            let true_deg = bench.bench().stage_angles_deg();
            stage.set_lamp(LampState::Off).unwrap();
            true_deg
        };
        let mut whole = start();
        let first = visit(&mut whole, lights[0]);
        let other = visit(&mut whole, lights[1]);
        let again = visit(&mut whole, lights[0]);
        assert_ne!(first, again);
        let mut resumed = start();
        resumed.0.count_visits(&[(lights[0], true)]);
        assert_eq!(visit(&mut resumed, lights[1]), other);
        assert_eq!(visit(&mut resumed, lights[0]), again);
    }

    #[test]
    fn camera_faults_are_device_errors() {
        let bench = simulated(Clock::instant(), stage_config());
        let mut camera = bench.open_camera(Arc::new(Flat));
        assert!(camera.set_shutter(false).unwrap());
        camera.faults().now().stalled = 1;
        assert!(matches!(
            camera.grab(key(FrameKind::Dark)),
            Err(DeviceError::NoReply { .. })
        ));
        assert!(camera.grab(key(FrameKind::Dark)).is_ok());
        camera.faults().now().is_disconnected = true;
        assert!(matches!(
            camera.grab(key(FrameKind::Dark)),
            Err(DeviceError::Disconnected { .. })
        ));
    }

    #[test]
    fn an_axis_that_the_simulator_lacks_is_refused() {
        let mut stage = stage_config();
        stage.axes[0] = 'A';
        let config = simulated(Clock::instant(), stage_config()).config;
        let config = SimulatedConfig { stage, ..config };
        assert!(matches!(
            SimulatedBench::start(config),
            Err(DeviceError::Refused { .. })
        ));
    }
}
