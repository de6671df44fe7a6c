//! Exposure brackets merged into radiance.

use std::path::{Path, PathBuf};

use pyo3::prelude::*;
use rig_device::radiometry::bracket_files::{self, BracketFile, read_frame};
use rig_device::radiometry::bracket_merge::{
    self, CountModel, MergeRequest, check_linear, check_mosaic,
};
use rig_device::radiometry::frame_file::FrameFile;
use rig_device::radiometry::mosaic::Mosaic;
use rig_device::radiometry::response::Response;
use rig_device::radiometry::sensor::SensorNoise;
use rig_setup::calibration::record::ResponseValues;
use rig_setup::calibration::record_in;

use crate::errors::{Fault, input};
use crate::image::{self, image_record};
use crate::numbers::{Integer, Real};
use crate::records::{plain, record};
use crate::work;

/// Merge an exposure bracket into a radiance image with variances: the image of `rig merge`.
///
/// frames: files or folders of them; PNG, TIFF or JPEG, all of one size.
/// exposures: CSV file with lines `file,exposure_s[,light|ambient|dark]`; by default each frame's
///     EXIF data or its name, such as scene_20ms.png.
/// gain: DN per electron; read_noise: electrons; black_level, saturation: DN; bit_depth: bits of
///     a count; dark_current: electrons per second; responsivity: electrons per second for unit
///     radiance. The first three are needed unless there is a response.
/// response: record by `rig calibrate response`, for 8-bit frames that are not linear.
/// mosaic: "none", "rggb", "grbg", "gbrg" or "bggr"; a cell becomes one pixel unless
///     full_resolution.
/// measured_exposures: use the exposures that the frames show in place of the stated ones, the
///     shortest apart; Merged.exposures has them.
/// out: OpenEXR file to keep the image in as well.
/// progress: called as progress(phase, done, total) with frames, then rows of pixels.
///
/// Returns Merged. Raises InputError for frames that make no bracket or a sensor that is not
/// described, MissingFileError or FileError.
#[pyfunction]
#[pyo3(signature = (frames, *, exposures = None, gain = None, read_noise = None, black_level = None, saturation = None, bit_depth = None, dark_current = Real(0.0), responsivity = Real(1.0), response = None, mosaic = "none", full_resolution = false, measured_exposures = false, out = None, progress = None))]
#[expect(clippy::too_many_arguments, reason = "keywords of a Python function")]
pub fn merge(
    py: Python<'_>,
    frames: &Bound<'_, PyAny>,
    exposures: Option<PathBuf>,
    gain: Option<Real>,
    read_noise: Option<Real>,
    black_level: Option<Real>,
    saturation: Option<Real>,
    bit_depth: Option<Integer>,
    dark_current: Real,
    responsivity: Real,
    response: Option<PathBuf>,
    mosaic: &str,
    full_resolution: bool,
    measured_exposures: bool,
    out: Option<PathBuf>,
    progress: Option<Py<PyAny>>,
) -> PyResult<Py<PyAny>> {
    let frames = match frames.extract::<PathBuf>() {
        Ok(one) => vec![one],
        Err(_) => frames.extract::<Vec<PathBuf>>()?,
    };
    let mosaic: Mosaic = mosaic
        .parse()
        .map_err(|allowed| input(format!("mosaic is {mosaic:?}, but must be {allowed}")))?;
    let bit_depth = bit_depth.map(|bits| bits.within("bit_depth", 1..=16));
    let number = |value: Option<Real>| value.map(|Real(value)| value);
    let sensor = Sensor {
        gain: number(gain),
        read_noise: number(read_noise),
        black_level: number(black_level),
        saturation: number(saturation),
        bit_depth: bit_depth.transpose()?,
        dark_current: dark_current.0,
        responsivity: responsivity.0,
    };
    let bracket = bracket_files::find(&frames, exposures.as_deref()).map_err(Fault::from)?;
    let model = count_model(&bracket.files, response.as_deref(), &sensor, mosaic)?;

    // The merge writes a file, in bands of rows; without `out` it is a temporary one.
    let scratch = tempfile::tempdir()?;
    let path = out.unwrap_or_else(|| scratch.path().join("radiance.exr"));
    let merged = work::interruptible(py, progress, |progress| {
        let request = MergeRequest {
            files: &bracket.files,
            model: &model,
            mosaic,
            full_resolution,
            measured_exposures,
            out: &path,
        };
        bracket_merge::merge(&request, progress)
    })?;
    let merged = merged.map_err(Fault::from)?;
    let file = image::read(py, &path)?;
    record!(
        py,
        "Merged",
        image = image_record(py, file.image, file.has_variance)?,
        masked_pixels = merged.masked_pixels,
        agreement = plain(py, &merged.agreement)?,
        exposures = plain(py, &merged.exposures)?,
    )
}

/// What is said of the sensor.
struct Sensor {
    gain: Option<f64>,
    read_noise: Option<f64>,
    black_level: Option<f64>,
    saturation: Option<f64>,
    bit_depth: Option<u32>,
    dark_current: f64,
    responsivity: f64,
}

fn count_model(
    files: &[BracketFile],
    response: Option<&Path>,
    sensor: &Sensor,
    mosaic: Mosaic,
) -> Result<CountModel, Fault> {
    let first = files.first().ok_or_else(|| input("frames is empty"))?;
    let path = first.path.as_path();
    let frame = read_frame(path)?;
    check_mosaic(path, &frame, mosaic)?;
    if let Some(record) = response {
        let record = record_in::<ResponseValues>(record)?;
        let curves = record.values.channels.into_iter().map(Response::from);
        return Ok(CountModel::Response(curves.collect()));
    }
    check_linear(path, &frame)?;
    let noise = sensor.noise(&frame)?;
    noise.check(frame.width * frame.height).map_err(input)?;
    Ok(CountModel::Linear(Box::new(noise)))
}

impl Sensor {
    fn noise(&self, frame: &FrameFile) -> Result<SensorNoise, Fault> {
        let needed = |value: Option<f64>, name: &str| {
            value.ok_or_else(|| input(format!("the sensor is unknown: {name} is missing")))
        };
        let mut noise = SensorNoise::ideal(
            needed(self.gain, "gain")?,
            needed(self.read_noise, "read_noise")?,
            needed(self.black_level, "black_level")?,
            self.bit_depth.unwrap_or(frame.bits),
        );
        noise.dark_current_e_s = self.dark_current;
        noise.responsivity_e_s = self.responsivity;
        if let Some(saturation_dn) = self.saturation {
            noise.saturation_dn = saturation_dn;
            noise.linear_max_dn = saturation_dn;
        }
        Ok(noise)
    }
}
