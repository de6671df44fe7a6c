//! The tables of a rig file that say how it is used: `[capture]`, `[fit]`,
//! `[calibration]`.

use std::ops::RangeInclusive;
use std::path::PathBuf;

use super::ConfigError;
use super::camera::CameraConfig;
use super::fit::{FitRequest, Source};
use super::reader::Section;
use crate::units::Seconds;

/// How a capture is done.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CaptureConfig {
    /// Signal-to-noise ratio that dark pixels of the sample reach after the merge.
    pub dark_snr: f64,
    /// Shortest and longest exposure of a bracket.
    pub exposure_range: [Seconds; 2],
    /// Largest ratio of neighbouring exposures.
    pub exposure_ratio: f64,
    /// Part of the usable range that the brightest pixel reaches in the shortest exposure.
    pub peak_fraction: f64,
    /// Most frames averaged at one exposure.
    pub max_frames: u32,
    /// Whether frames with the lamp off are taken at every light.
    pub ambient: bool,
    /// Dark frames at each exposure; 0 takes none.
    pub dark_frames: u32,
    /// Wait after a move before the first frame.
    pub settle: Seconds,
    /// Wait after the lamp is switched before the first frame.
    pub lamp_settle: Seconds,
    /// Wait with the lamp on before the first light.
    pub lamp_warm_up: Seconds,
    /// Whether the first light is visited again after the last one; `None`: unless somebody
    /// must do it by hand.
    pub revisit_first: Option<bool>,
    /// Free space that must remain on the disk, bytes.
    pub disk_reserve_bytes: u64,
    /// Diameter of the disc of a point out of focus above which a capture warns, pixels
    /// of the merged image.
    pub blur_limit_px: f64,
}

impl CaptureConfig {
    /// Reads the `[capture]` table; exposures must be the camera's.
    pub fn read(mut table: Section, camera: &CameraConfig) -> Result<Self, ConfigError> {
        let [shortest, longest] = camera.exposure_range.map(|exposure| exposure.0 * 1e3);
        let shortest_ms = table
            .number("shortest_ms", shortest..=longest)?
            .or(shortest);
        let longest_ms = table.number("longest_ms", shortest..=longest)?.or(longest);
        if shortest_ms > longest_ms {
            let allowed = format!("at least shortest_ms ({shortest_ms})");
            return Err(table.conflict("longest_ms", longest_ms, &allowed));
        }
        let capture = Self {
            dark_snr: table.number("snr", 1.0..=1e4)?.or(20.0),
            exposure_range: [Seconds(shortest_ms * 1e-3), Seconds(longest_ms * 1e-3)],
            exposure_ratio: table.number("exposure_ratio", 1.2..=64.0)?.or(4.0),
            peak_fraction: table.number("peak_fraction", 0.1..=0.95)?.or(0.7),
            max_frames: table.integer("max_frames", 1..=4096)?.or(64) as u32,
            ambient: table.flag("ambient")?.or(true),
            dark_frames: table.integer("dark_frames", 0..=1024)?.or(8) as u32,
            settle: Seconds(table.number("settle_s", 0.0..=60.0)?.or(0.3)),
            lamp_settle: Seconds(table.number("lamp_settle_s", 0.0..=60.0)?.or(0.1)),
            lamp_warm_up: Seconds(table.number("lamp_warm_up_s", 0.0..=7200.0)?.or(0.0)),
            revisit_first: table.flag("revisit_first")?.optional(),
            blur_limit_px: table.number("blur_limit_px", 0.01..=1000.0)?.or(1.0),
            disk_reserve_bytes: table.integer("disk_reserve_mb", 0..=1_000_000)?.or(500)
                * 1_000_000,
        };
        table.finish()?;
        Ok(capture)
    }
}

/// Reads the `[fit]` table: how a session is fitted unless the command says otherwise.
pub fn read_fit(mut table: Section) -> Result<FitRequest, ConfigError> {
    let fit = FitRequest::read(&mut table)?;
    table.finish()?;
    Ok(fit)
}

impl Source for Section {
    type Error = ConfigError;
    const SAMPLES: &'static str = "samples_per_pixel";

    fn integer(
        &mut self,
        key: &'static str,
        range: RangeInclusive<u64>,
    ) -> Result<Option<u64>, ConfigError> {
        Ok(self.integer(key, range)?.optional())
    }

    fn number(
        &mut self,
        key: &'static str,
        range: RangeInclusive<f64>,
    ) -> Result<Option<f64>, ConfigError> {
        Ok(self.number(key, range)?.optional())
    }

    fn flag(&mut self, key: &'static str) -> Result<Option<bool>, ConfigError> {
        Ok(self.flag(key)?.optional())
    }

    fn text(&mut self, key: &'static str) -> Result<Option<String>, ConfigError> {
        Ok(self.text(key)?.optional())
    }

    fn choice<T: Clone>(
        &mut self,
        key: &'static str,
        choices: &[(&'static str, T)],
    ) -> Result<Option<T>, ConfigError> {
        Ok(self.choice(key, choices)?.optional())
    }
}

/// Which calibration records belong to the rig; a record that isn't named is
/// the newest valid one of its kind.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibrationConfig {
    /// Folder with one folder per kind; `None`: `calibration/<rig>` next to or
    /// above the rig file, or the records built into the program.
    pub folder: Option<PathBuf>,
    /// Id of the record of the sensor's noise.
    pub sensor: Option<String>,
    /// Id of the record of the sensor's relative response by pixel.
    pub flat: Option<String>,
    /// Id of the record of the radiometric scale.
    pub scale: Option<String>,
    /// Id of the record of the lamp's irradiance.
    pub lights: Option<String>,
    /// Id of the record of the lights' directions.
    pub directions: Option<String>,
    /// Id of the record of the camera's point spread, focus and aperture.
    pub focus: Option<String>,
    /// Id of the record of the sample's pose; `None`: none is used, since a pose holds
    /// only until somebody touches the sample.
    pub pose: Option<String>,
    /// Id of the record of the lens.
    pub camera: Option<String>,
    /// Id of the record of the lens' veiling glare.
    pub glare: Option<String>,
}

impl CalibrationConfig {
    /// Reads the `[calibration]` table.
    pub fn read(mut table: Section) -> Result<Self, ConfigError> {
        let mut id = |kind| -> Result<_, ConfigError> {
            Ok(table
                .parsed(
                    kind,
                    "the id of a record: letters, digits, - and _",
                    record_id,
                )?
                .optional())
        };
        let (sensor, flat, scale, lights) =
            (id("sensor")?, id("flat")?, id("scale")?, id("lights")?);
        let (directions, pose, camera) = (id("directions")?, id("pose")?, id("camera")?);
        let (focus, glare) = (id("focus")?, id("glare")?);
        let folder = table.path("folder")?.optional();
        table.finish()?;
        Ok(Self {
            folder,
            sensor,
            flat,
            scale,
            lights,
            directions,
            focus,
            pose,
            camera,
            glare,
        })
    }
}

/// A record's id names a file, so it has no path in it.
fn record_id(text: &str) -> Option<String> {
    let allowed = |b: u8| b.is_ascii_alphanumeric() || b == b'-' || b == b'_';
    ((1..=80).contains(&text.len()) && text.bytes().all(allowed)).then(|| text.to_owned())
}
