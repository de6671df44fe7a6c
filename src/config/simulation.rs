//! The `[simulation]` table: the truth of a simulated bench, which the capture
//! and the fit never see.

use super::ConfigError;
use super::reader::Section;
use super::reflectance::BrdfSpec;

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
    /// Standard deviation of the lamp's true direction against the commanded one, degrees.
    pub light_error_deg: f64,
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
    /// Whether the camera can shut out the light by itself.
    pub has_shutter: bool,
    /// The sensor's truth.
    pub sensor: SensorTruth,
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

/// What a simulated sensor truly is; its calibration record is what was measured of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorTruth {
    /// Electrons per second and per W/(m² sr): lens, pixel area and quantum efficiency together.
    pub responsivity: f64,
    /// System gain K, DN per electron.
    pub gain_dn_per_e: f64,
    /// Standard deviation of the read noise, e⁻.
    pub read_noise_e: f64,
    /// Most electrons a pixel holds.
    pub full_well_e: f64,
    /// Count without any electron, DN.
    pub black_level_dn: f64,
    /// Mean dark current, e⁻/s.
    pub dark_current_e_s: f64,
    /// Standard deviation of the dark current over the pixels, e⁻/s.
    pub dsnu_e_s: f64,
    /// Standard deviation of the offset over the pixels, e⁻.
    pub offset_dsnu_e: f64,
    /// Relative standard deviation of the response over the pixels.
    pub prnu: f64,
    /// Fraction of pixels that are hot.
    pub hot_fraction: f64,
    /// Extra dark current of a hot pixel, e⁻/s.
    pub hot_current_e_s: f64,
}

impl SimulationConfig {
    /// Reads the `[simulation]` table.
    pub fn read(mut table: Section) -> Result<Self, ConfigError> {
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
        let sensor = SensorTruth::read(table.section_or_empty("sensor")?)?;
        let simulation = Self {
            material,
            sensor,
            seed: table.integer("seed", 0..=i64::MAX as u64)?.or(1),
            pose_error_mm: table.number("pose_error_mm", 0.0..=10.0)?.or(0.0),
            pose_error_deg: table.number("pose_error_deg", 0.0..=10.0)?.or(0.0),
            light_error_deg: table.number("light_error_deg", 0.0..=10.0)?.or(0.0),
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
            has_shutter: table.flag("has_shutter")?.or(true),
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

impl SensorTruth {
    fn read(mut table: Section) -> Result<Self, ConfigError> {
        let sensor = Self {
            responsivity: table.number("responsivity", 1.0..=1e12)?.or(1e6),
            gain_dn_per_e: table.number("gain_dn_per_e", 1e-4..=100.0)?.or(0.38),
            read_noise_e: table.number("read_noise_e", 0.0..=1000.0)?.or(2.4),
            full_well_e: table.number("full_well_e", 100.0..=1e7)?.or(10_500.0),
            black_level_dn: table.number("black_level_dn", 0.0..=16_384.0)?.or(64.0),
            dark_current_e_s: table.number("dark_current_e_s", 0.0..=1e6)?.or(3.0),
            dsnu_e_s: table.number("dsnu_e_s", 0.0..=1e6)?.or(0.6),
            offset_dsnu_e: table.number("offset_dsnu_e", 0.0..=1000.0)?.or(0.5),
            prnu: table.number("prnu", 0.0..=0.2)?.or(0.006),
            hot_fraction: table.number("hot_fraction", 0.0..=0.1)?.or(2e-4),
            hot_current_e_s: table.number("hot_current_e_s", 0.0..=1e8)?.or(2000.0),
        };
        table.finish()?;
        Ok(sensor)
    }
}
