//! The `[simulation]` table: the truth of a simulated bench, which the capture
//! and the fit never see.

use std::ops::RangeInclusive;

use mock_devices::bench::{LampModel, StageErrors};
use mock_devices::camera::CameraConfig as MockCamera;
use mock_devices::glare::Glare;
use mock_devices::sensor::{PixelCounts, SensorConfig};

#[cfg(feature = "serial")]
use super::RigConfig;
use super::reader::Section;
use super::reflectance::BrdfSpec;
#[cfg(feature = "serial")]
use super::stage::StageDriver;
use super::view::take_lens;
use super::{CameraConfig, ConfigError};
#[cfg(feature = "serial")]
use crate::device::{simulated::SimulatedConfig, simulated_hand};
use crate::radiometry::mosaic::Mosaic;
use crate::transport::{Camera, Folded, LensSpec};

/// What is true on a simulated bench.
#[derive(Clone, Debug, PartialEq)]
pub struct SimulationConfig {
    /// What the sample is made of.
    pub material: MaterialSpec,
    /// Seed of the bench: its perturbations, its paths, its noise.
    pub seed: u64,
    /// Standard deviation of the sample's true position against the configured one, mm.
    pub pose_error_mm: f64,
    /// Standard deviation of its true orientation, degrees.
    pub pose_error_deg: f64,
    /// Facets around the true sample's rim: finer than the fit's, so that the
    /// fit doesn't share its mesh.
    pub segments: u32,
    /// Light paths per pixel of the true images.
    pub samples_per_pixel: u32,
    /// Longest path of the true images, in surface reflections.
    pub max_reflections: u32,
    /// Radiance of the room's light on the sensor, W/(m² sr).
    pub ambient_w_m2_sr: f64,
    /// Whether motion and exposure take time.
    pub timing: Timing,
    /// How the true stage departs from what it reports, axis units.
    pub stage_errors: StageErrors,
    /// The lamp's power over time.
    pub lamp: LampModel,
    /// The sensor's truth; its calibration record is what was measured of it.
    pub sensor: SensorConfig,
    /// The camera around the sensor.
    pub camera: MockCamera,
    /// The lens.
    pub lens: TrueLens,
    /// Light that the lens puts elsewhere.
    pub glare: Glare,
}

/// The true lens, where it differs from that of `[geometry.camera]`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TrueLens {
    /// Principal point, aspect and distortion.
    pub mapping: Option<LensSpec>,
    /// Standard deviation of the point spread in focus, sensor pixels.
    pub point_spread_px: Option<f64>,
    /// Numerical aperture on the sample's side.
    pub object_na: Option<f64>,
    /// Distance from the camera at which it is sharp, mm.
    pub focus_mm: Option<f64>,
}

impl TrueLens {
    /// The camera as it truly is.
    ///
    /// # Errors
    /// [`Folded`] where the lens distorts the camera's image too much.
    pub fn of(&self, stated: &Camera) -> Result<Camera, Folded> {
        let camera = match self.mapping {
            Some(mapping) => stated.with_lens(mapping)?,
            None => *stated,
        };
        Ok(Camera {
            point_spread_px: self.point_spread_px.unwrap_or(stated.point_spread_px),
            object_na: self.object_na.unwrap_or(stated.object_na),
            focus_mm: self.focus_mm.unwrap_or(stated.focus_mm),
            ..camera
        })
    }
}

/// What the simulated sample is made of.
#[derive(Clone, Debug, PartialEq)]
pub enum MaterialSpec {
    /// A material that the program brings, as `source:name`, e.g. `nbrdf:red-plastic`.
    Bundled {
        /// Where it comes from, e.g. `nbrdf`.
        source: String,
        /// Which one.
        name: String,
    },
    /// A BRDF as scene files give it.
    Brdf(BrdfSpec),
}

/// Whether simulated motion and exposure take time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Timing {
    /// A virtual clock that jumps.
    Instant,
    /// As long as on a real bench.
    Realistic,
}

impl SimulationConfig {
    /// Reads the `[simulation]` table of a rig with this camera.
    pub fn read(mut table: Section, camera: &CameraConfig) -> Result<Self, ConfigError> {
        let bundled = table
            .parsed(
                "material",
                "`source:name` such as \"nbrdf:red-plastic\"",
                material,
            )?
            .optional();
        let brdf = table.section("brdf")?.optional();
        let material = match (bundled, brdf) {
            (Some((source, name)), None) => MaterialSpec::Bundled { source, name },
            (None, Some(brdf)) => MaterialSpec::Brdf(BrdfSpec::read(brdf)?),
            (Some(_), Some(_)) => {
                return Err(table.conflict("material", "given", "absent where `brdf` is given"));
            }
            (None, None) => {
                return Err(table.missing("material", "`source:name`, or `brdf` a table"));
            }
        };
        let seed = table.integer("seed", 0..=i64::MAX as u64)?.or(1);
        let sensor = read_sensor(table.section_or_empty("sensor")?, camera, seed)?;
        let simulation = Self {
            material,
            seed,
            sensor,
            camera: read_camera(table.section_or_empty("camera")?, camera, seed)?,
            lens: read_lens(table.section_or_empty("lens")?, camera)?,
            glare: read_glare(table.section_or_empty("glare")?)?,
            stage_errors: read_stage_errors(table.section_or_empty("stage")?)?,
            lamp: read_lamp(table.section_or_empty("lamp")?)?,
            pose_error_mm: table.number("pose_error_mm", 0.0..=10.0)?.or(0.0),
            pose_error_deg: table.number("pose_error_deg", 0.0..=10.0)?.or(0.0),
            segments: table.integer("segments", 8..=4096)?.or(256) as u32,
            samples_per_pixel: table.integer("samples_per_pixel", 1..=1_048_576)?.or(4096) as u32,
            max_reflections: table.integer("max_reflections", 1..=64)?.or(32) as u32,
            ambient_w_m2_sr: table.number("ambient_w_m2_sr", 0.0..=1e6)?.or(0.0),
            timing: table
                .choice(
                    "timing",
                    &[
                        ("instant", Timing::Instant),
                        ("realistic", Timing::Realistic),
                    ],
                )?
                .or(Timing::Realistic),
        };
        table.finish()?;
        Ok(simulation)
    }
}

fn material(text: &str) -> Option<(String, String)> {
    let valid = |part: &str| {
        let allowed = |b: u8| b.is_ascii_alphanumeric() || b == b'-' || b == b'_';
        !part.is_empty() && part.bytes().all(allowed)
    };
    let (source, name) = text.split_once(':')?;
    (valid(source) && valid(name)).then(|| (source.to_owned(), name.to_owned()))
}

fn read_sensor(
    mut table: Section,
    camera: &CameraConfig,
    seed: u64,
) -> Result<SensorConfig, ConfigError> {
    // Counts, those of pixels behind each colour filter where three numbers are given.
    let mut each = |key, range: RangeInclusive<f64>, default| -> Result<[f64; 3], ConfigError> {
        let found = table.channels(key, range)?.or([default; 3]);
        let is_one = found == [found[0]; 3];
        match camera.mosaic {
            Mosaic::None if !is_one => {
                let allowed = "one number for a camera without colour filters";
                Err(table.conflict(key, format!("{found:?}"), allowed))
            }
            _ => Ok(found),
        }
    };
    let gain_dn_per_e = each("gain_dn_per_e", 1e-4..=100.0, 0.38)?;
    let read_noise_e = each("read_noise_e", 0.0..=1000.0, 2.4)?;
    let black_level_dn = each("black_level_dn", -16_384.0..=16_384.0, 64.0)?;
    let counts = |colour: usize| PixelCounts {
        gain_dn_per_e: gain_dn_per_e[colour],
        read_noise_e: read_noise_e[colour],
        black_level_dn: black_level_dn[colour],
    };
    let by_place = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(x, y)| camera.mosaic.channel(x, y));
    let cell = by_place.map(|colour| counts(colour.unwrap_or(0)));
    let of_green = counts(1);
    let sensor = SensorConfig {
        resolution_px: camera.resolution_px,
        bit_depth: camera.bit_depth,
        responsivity: table.number("responsivity", 1.0..=1e12)?.or(1e6),
        gain_dn_per_e: of_green.gain_dn_per_e,
        read_noise_e: of_green.read_noise_e,
        nonlinearity: table.number("nonlinearity", -0.2..=0.2)?.or(0.0),
        full_well_e: table.number("full_well_e", 100.0..=1e7)?.or(10_500.0),
        black_level_dn: of_green.black_level_dn,
        cell: (cell != [of_green; 4]).then_some(cell),
        dark_current_e_s: table.number("dark_current_e_s", 0.0..=1e6)?.or(3.0),
        dsnu_e_s: table.number("dsnu_e_s", 0.0..=1e6)?.or(0.6),
        offset_dsnu_e: table.number("offset_dsnu_e", 0.0..=1000.0)?.or(0.5),
        prnu: table.number("prnu", 0.0..=0.2)?.or(0.006),
        hot_fraction: table.number("hot_fraction", 0.0..=0.1)?.or(2e-4),
        hot_current_e_s: table.number("hot_current_e_s", 0.0..=1e8)?.or(2000.0),
        hot_pixels: Vec::new(),
        seed,
    };
    table.finish()?;
    Ok(sensor)
}

fn read_camera(
    mut table: Section,
    camera: &CameraConfig,
    seed: u64,
) -> Result<MockCamera, ConfigError> {
    let ms = |value: f64| value * 1e-3;
    let mock = MockCamera {
        exposure_range_s: camera.exposure_range.map(|exposure| exposure.0),
        exposure_step_s: camera.exposure_step.0,
        settings_latency_frames: table.integer("settings_latency_frames", 0..=32)?.or(2) as u32,
        frame_interval_s: ms(table.number("frame_interval_ms", 0.0..=1e4)?.or(33.3)),
        readout_s: ms(table.number("readout_ms", 0.0..=1e4)?.or(10.0)),
        has_shutter: table.flag("has_shutter")?.or(true),
        noise_seed: seed,
        ..MockCamera::default()
    };
    table.finish()?;
    Ok(mock)
}

fn read_lens(mut table: Section, camera: &CameraConfig) -> Result<TrueLens, ConfigError> {
    let lens = TrueLens {
        mapping: take_lens(&mut table, camera.resolution_px)?,
        point_spread_px: table.number("point_spread_px", 0.0..=20.0)?.optional(),
        object_na: table.number("object_na", 0.0..=0.95)?.optional(),
        focus_mm: table.number("focus_mm", 1e-3..=1e5)?.optional(),
    };
    table.finish()?;
    Ok(lens)
}

fn read_glare(mut table: Section) -> Result<Glare, ConfigError> {
    let glare = Glare {
        uniform: table.number("uniform", 0.0..=0.02)?.or(0.0),
        halo: table.number("halo", 0.0..=0.02)?.or(0.0),
        halo_width: table.number("halo_width", 0.01..=0.5)?.or(0.1),
    };
    table.finish()?;
    Ok(glare)
}

fn read_stage_errors(mut table: Section) -> Result<StageErrors, ConfigError> {
    let errors = StageErrors {
        azimuth_offset_deg: table.number("azimuth_offset_deg", -10.0..=10.0)?.or(0.0),
        elevation_offset_deg: table.number("elevation_offset_deg", -10.0..=10.0)?.or(0.0),
        backlash_mm: [table.number("backlash", 0.0..=10.0)?.or(0.0); 3],
        positioning_mm: table.number("positioning", 0.0..=10.0)?.or(0.0),
        repeatability_mm: table.number("repeatability", 0.0..=10.0)?.or(0.0),
        homing_mm: table.number("homing", 0.0..=10.0)?.or(0.0),
        coast_s: table.number("coast_s", 0.0..=10.0)?.or(0.0),
    };
    table.finish()?;
    Ok(errors)
}

fn read_lamp(mut table: Section) -> Result<LampModel, ConfigError> {
    let lamp = LampModel {
        power: table.channels("power", 0.0..=10.0)?.or([1.0; 3]),
        warm_up_fraction: table.number("warm_up_fraction", 0.0..=1.0)?.or(0.0),
        warm_up_s: table.number("warm_up_s", 0.1..=1e5)?.or(60.0),
        drift_per_hour: table.number("drift_per_hour", -1.0..=1.0)?.or(0.0),
        flicker_depth: table.number("flicker_depth", 0.0..=1.0)?.or(0.0),
        flicker_hz: table.number("flicker_hz", 0.1..=1e6)?.or(100.0),
    };
    table.finish()?;
    Ok(lamp)
}

#[cfg(feature = "serial")]
impl RigConfig {
    /// The simulated bench that this rig describes; `None` for a real one.
    pub fn simulated_bench(&self) -> Option<SimulatedConfig> {
        let simulation = self.simulation.as_ref()?;
        let stage = match &self.stage.driver {
            StageDriver::Simulated(stage) => stage.clone(),
            StageDriver::Manual(manual) => simulated_hand::firmware(manual.channels),
            _ => return None,
        };
        let channel_of = |colour: usize| {
            let mut channels = self.stage.measures.iter();
            channels
                .position(|measures| measures.colours().contains(&colour))
                .map(|channel| channel as u8)
        };
        Some(SimulatedConfig {
            stage,
            errors: simulation.stage_errors,
            lamp: simulation.lamp,
            channel_of_colour: [0, 1, 2].map(channel_of),
            sensor: simulation.sensor.clone(),
            camera_serial: self.camera.serial.clone().unwrap_or_default(),
            camera: simulation.camera.clone(),
            mosaic: self.camera.mosaic,
            instant: simulation.timing == Timing::Instant,
            seed: simulation.seed,
        })
    }
}

#[cfg(all(test, feature = "serial"))]
mod tests {
    use std::path::Path;

    use crate::config::{BUILT_IN, RigConfig};
    use crate::device::simulated::SimulatedBench;
    use crate::device::{LampChannel, LampState, LightStage};
    use crate::units::StageAngles;

    /// Gain, read noise and black level of each colour, where the camera has colours.
    #[test]
    fn what_counts_differ_in_may_be_stated_for_each_colour() {
        let rig = |mosaic: &str, gain: &str| {
            let text = BUILT_IN[0].1.replace("mosaic = \"none\"", mosaic);
            let text = text.replace("gain_dn_per_e = 0.38", gain);
            let text = text.replace("black_level_dn = 64.0", "black_level_dn = -0.5");
            RigConfig::parse("rig.toml", Path::new(""), &text)
        };
        let sensor = |mosaic, gain| {
            let rig = rig(mosaic, gain).unwrap();
            rig.simulation.unwrap().sensor
        };
        let gain = "gain_dn_per_e = [0.6, 0.38, 0.5]";
        let each = sensor("mosaic = \"grbg\"", gain);
        let cell = each.cell.unwrap();
        assert_eq!(
            cell.map(|pixel| pixel.gain_dn_per_e),
            [0.38, 0.6, 0.5, 0.38]
        );
        assert_eq!(cell.map(|pixel| pixel.black_level_dn), [-0.5; 4]);
        assert_eq!(each.gain_dn_per_e, 0.38);
        let one = sensor("mosaic = \"grbg\"", "gain_dn_per_e = 0.4");
        assert_eq!((one.cell, one.gain_dn_per_e), (None, 0.4));
        let refused = rig("mosaic = \"none\"", gain).unwrap_err().to_string();
        assert!(
            refused.contains("one number for a camera without colour filters"),
            "{refused}"
        );
    }

    /// The simulated rig as it is shipped runs: its stage homes, reaches its
    /// limits, and each lamp channel lights the colour that it claims to measure.
    #[test]
    fn the_shipped_bench_runs() {
        let rig = RigConfig::parse("simulated", Path::new(""), BUILT_IN[0].1).unwrap();
        let bench = SimulatedBench::start(rig.simulated_bench().unwrap()).unwrap();
        let mut stage = bench.open_stage().unwrap();
        stage.home().unwrap();
        for (azimuth_deg, elevation_deg) in [(-180.0, 45.0), (180.0, 90.0), (0.0, 90.0)] {
            let target = StageAngles::new(azimuth_deg, elevation_deg);
            let reached = stage.move_to(target).unwrap();
            assert!(
                (reached.azimuth_deg - azimuth_deg).abs() < 0.05,
                "{reached}"
            );
            assert!(
                (reached.elevation_deg - elevation_deg).abs() < 0.05,
                "{reached}"
            );
        }
        for (channel, measures) in rig.stage.measures.iter().enumerate() {
            stage
                .set_lamp(LampState::On(LampChannel(channel as u8)))
                .unwrap();
            let lit = bench.bench().illumination().channels;
            for (colour, power) in lit.iter().enumerate() {
                let expected = f64::from(measures.colours().contains(&colour));
                assert_eq!(*power, expected, "{measures:?} lights {lit:?}");
            }
        }
        stage.set_lamp(LampState::Off).unwrap();
        assert_eq!(bench.bench().illumination().channels, [0.0; 3]);
    }
}
