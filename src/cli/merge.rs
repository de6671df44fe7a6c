//! `rig merge`: any exposure bracket becomes a radiance image.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::output::{write_json, write_path};
use super::rig_choice::RigArg;
use super::{CliError, Context, HintExt, bracket_files};
use crate::calibration::noise::sensor_noise;
use crate::calibration::record::{FlatValues, ResponseValues, ScaleValues, SensorValues};
use crate::calibration::{Library, record_in};
use crate::radiometry::agreement::ExposureAgreement;
use crate::radiometry::bracket_files::read_frame;
use crate::radiometry::bracket_merge::{
    self, BracketMergeError, CountModel, MergeRequest, check_linear, check_mosaic,
};
use crate::radiometry::frame_file::{FrameFile, Tone};
use crate::radiometry::mosaic::Mosaic;
use crate::radiometry::response::Response;
use crate::radiometry::sensor::SensorNoise;

/// Merges an exposure bracket into a radiance image with variance and mask
///
/// Raw frames, whose counts are proportional to light, need the sensor's description: the records
/// of a rig (--rig) or options, which take precedence. Other frames (8 bits) need the camera's
/// response (--response).
#[derive(clap::Args, Debug)]
pub struct MergeArgs {
    /// Frames, or folders of them: PNG, TIFF or JPEG, grey (mono or Bayer) or RGB, 8 or 16 bits,
    /// all of one size
    #[arg(value_name = "FRAMES", required = true)]
    frames: Vec<PathBuf>,
    /// Table of exposures: CSV lines `file,exposure_s[,light|ambient|dark]`, files by path or name,
    /// separated by commas, semicolons or tabs (default: each frame's EXIF data, or its name, such
    /// as scene_20ms.png, scene_0,02s.png or scene_1-250s.jpg)
    #[arg(long, value_name = "CSV")]
    exposures: Option<PathBuf>,
    /// The radiance image to write (OpenEXR)
    #[arg(long, value_name = "EXR", default_value = "radiance.exr")]
    out: PathBuf,
    /// Colour filters over the sensor: none, rggb, grbg, gbrg or bggr; cells become RGB pixels
    #[arg(long, value_name = "ORDER", default_value = "none")]
    mosaic: Mosaic,
    /// Keep the resolution of a mosaic: a colour that a pixel did not measure is the mean of its
    /// nearest neighbours (default: a cell of 2 x 2 becomes one pixel, nothing is interpolated)
    #[arg(long)]
    full_resolution: bool,
    /// How the exposures agree, as JSON: ratios from the images, drift, pixels that moved
    #[arg(long)]
    json: bool,
    /// Frames of a camera that is not linear: its record by `rig calibrate response` (the image is
    /// then in relative units)
    #[arg(long, value_name = "TOML", conflicts_with_all = ["gain", "read_noise", "mosaic"])]
    response: Option<PathBuf>,
    /// Take the sensor from this rig's records
    #[command(flatten)]
    rig: RigArg,
    /// System gain K (DN per electron; > 0)
    #[arg(long, value_name = "K")]
    gain: Option<f64>,
    /// Read noise, standard deviation (electrons; >= 0)
    #[arg(long, value_name = "E")]
    read_noise: Option<f64>,
    /// Count without light (DN; >= 0)
    #[arg(long, value_name = "DN")]
    black_level: Option<f64>,
    /// Counts at or above this are clipped (DN; default full scale)
    #[arg(long, value_name = "DN")]
    saturation: Option<f64>,
    /// Significant bits of a count (1 to 16; default the file's 8 or 16)
    #[arg(long, value_name = "BITS", value_parser = clap::value_parser!(u32).range(1..=16))]
    bit_depth: Option<u32>,
    /// Dark current (electrons per second; default 0), used without dark or ambient frames
    #[arg(long, value_name = "RATE")]
    dark_current: Option<f64>,
    /// Electrons per second for unit radiance (default 1: the image is in electrons per second)
    #[arg(long, value_name = "R")]
    responsivity: Option<f64>,
}

/// `rig merge`.
pub fn run(args: &MergeArgs, context: &Context) -> Result<(), CliError> {
    let files = bracket_files::find(&args.frames, args.exposures.as_deref(), context)?;
    let first_path = files[0].path.as_path();
    let first = read_frame(first_path).map_err(bracket_files::advised)?;
    check_mosaic(first_path, &first, args.mosaic).map_err(advised)?;
    let model = match &args.response {
        Some(path) => {
            let record = record_in::<ResponseValues>(path)?;
            let curves = record.values.channels.into_iter().map(Response::from);
            CountModel::Response(curves.collect())
        }
        None => {
            let noise = args.noise(context, first_path, &first)?;
            noise.check(first.width * first.height).hint(SENSOR_HINT)?;
            CountModel::Linear(Box::new(noise))
        }
    };
    let request = MergeRequest {
        files: &files,
        model: &model,
        mosaic: args.mosaic,
        full_resolution: args.full_resolution,
        out: &args.out,
    };
    let merged = bracket_merge::merge(&request, &()).map_err(advised)?;
    for steps in &merged.agreement {
        warn(steps, context);
    }
    let [width, height] = merged.size;
    if merged.masked_pixels > 0 {
        context.note(format_args!(
            "{} of {} pixels are masked: clipped in every exposure, hot, or moving",
            merged.masked_pixels,
            width * height
        ));
    }
    if !args.json {
        return write_path(&args.out);
    }
    write_json(&MergeReport {
        image: args.out.display().to_string(),
        width,
        height,
        masked_pixels: merged.masked_pixels,
        channels: merged.agreement,
    })
}

/// What to do about a bracket that cannot be merged.
fn advised(error: BracketMergeError) -> CliError {
    use BracketMergeError::*;
    let hint = match error {
        Files(error) => return bracket_files::advised(error),
        Image(error) => return error.into(),
        ColouredMosaic { .. } => "leave --mosaic out for frames that are RGB already",
        Jpeg { .. } => RESPONSE_HINT,
        OtherResponse { .. } => "a response belongs to frames of the camera that it was found with",
        Count { .. } => "set --bit-depth to the significant bits of a count",
        Channels => return CliError::new(error),
        Disk(_) => DISK_HINT,
        Merge(_) => BRACKET_HINT,
    };
    CliError::from(error).hint(hint)
}

const SENSOR_HINT: &str =
    "--gain, --read-noise, --black-level, --saturation and --bit-depth describe the sensor";
const DISK_HINT: &str = "frames wait in the folder of --out while they are merged: make room \
    there, or choose another folder";
const RESPONSE_HINT: &str = "find the camera's response with `rig calibrate response`, then give \
    the record with --response";
const BRACKET_HINT: &str = "mark at least one frame as light in the table (the default)";

#[derive(Serialize)]
struct MergeReport {
    image: String,
    width: usize,
    height: usize,
    masked_pixels: usize,
    /// How the exposures agree, per channel of the frames, shortest first.
    channels: Vec<Vec<ExposureAgreement>>,
}

/// A frame whose signal differs from the others' prediction by more than this
/// part is reported: a wrong exposure, or counts that are not linear.
const RATIO_WARNING: f64 = 0.01;
/// A change of the light over the frames of one exposure beyond this is reported.
const DRIFT_WARNING: f64 = 0.005;

fn warn(steps: &[ExposureAgreement], context: &Context) {
    for step in steps {
        let off = (step.signal_ratio - 1.0).abs();
        if off > RATIO_WARNING.max(5.0 * step.signal_ratio_std) {
            context.warn(format_args!(
                "the exposure of {} s collected {:.3} ± {:.3} times what the shorter ones \
                 predict: a wrong exposure time, a lamp that drifts, or counts that are not \
                 proportional to light",
                step.exposure_s, step.signal_ratio, step.signal_ratio_std
            ));
        }
        if step.drift.abs() > DRIFT_WARNING.max(5.0 * step.drift_std) {
            context.warn(format_args!(
                "the light changed by {:.1}% over the {} frames of {} s: let the lamp warm up, \
                 or see `rig calibrate lamp`",
                100.0 * step.drift,
                step.frames,
                step.exposure_s
            ));
        }
        if step.moved_pixels > 0 {
            context.warn(format_args!(
                "{} pixels of the exposure of {} s differ from the other frames: something \
                 moved; they are masked",
                step.moved_pixels, step.exposure_s
            ));
        }
    }
}

impl MergeArgs {
    /// The sensor from the rig's records where --rig is given, and the options.
    fn noise(
        &self,
        context: &Context,
        path: &Path,
        frame: &FrameFile,
    ) -> Result<SensorNoise, CliError> {
        check_linear(path, frame).map_err(advised)?;
        if frame.tone == Tone::Gamma {
            context.warn(format_args!(
                "{}: the PNG says that its counts are sRGB or have another gamma, and they are \
                 merged as proportional to light: if a camera or converter has bent them, \
                 {RESPONSE_HINT}",
                path.display()
            ));
        }
        let mut noise = if self.rig.rig.is_some() {
            self.recorded_noise(context, frame)?
        } else {
            let need = |value: Option<f64>, option: &str| {
                value.ok_or_else(|| {
                    CliError::new(format!("the sensor is unknown: {option} is missing")).hint(
                        "give --gain, --read-noise and --black-level, or --rig for a rig with a sensor record",
                    )
                })
            };
            SensorNoise::ideal(
                need(self.gain, "--gain")?,
                need(self.read_noise, "--read-noise")?,
                need(self.black_level, "--black-level")?,
                self.bit_depth.unwrap_or(frame.bits),
            )
        };
        let set = |target: &mut f64, value: Option<f64>| {
            if let Some(value) = value {
                *target = value;
            }
        };
        set(&mut noise.gain_dn_per_e, self.gain);
        set(&mut noise.read_noise_e, self.read_noise);
        set(&mut noise.black_level_dn, self.black_level);
        set(&mut noise.dark_current_e_s, self.dark_current);
        set(&mut noise.responsivity_e_s, self.responsivity);
        if let Some(saturation_dn) = self.saturation {
            noise.saturation_dn = saturation_dn;
            noise.linear_max_dn = saturation_dn;
        }
        noise.bit_depth = self.bit_depth.unwrap_or(noise.bit_depth);
        Ok(noise)
    }

    fn recorded_noise(
        &self,
        context: &Context,
        frame: &FrameFile,
    ) -> Result<SensorNoise, CliError> {
        let rig = self.rig.resolve(context)?;
        let library = Library::of_rig(&rig);
        let pins = &rig.config.calibration;
        let gain = rig.config.camera.gain;
        let sensor = library
            .load_for::<SensorValues>(pins.sensor.as_deref(), gain)?
            .ok_or_else(|| {
                CliError::new(format!("there is no sensor record in {}", library.place()))
            })
            .hint("run `rig calibrate sensor`, or describe the sensor by options")?;
        let flat = library.load_for::<FlatValues>(pins.flat.as_deref(), gain)?;
        let scale = library.load_for::<ScaleValues>(pins.scale.as_deref(), gain)?;
        let resolution_px = [frame.width as u32, frame.height as u32];
        if resolution_px != rig.config.camera.resolution_px {
            let [width, height] = rig.config.camera.resolution_px;
            return Err(CliError::new(format!(
                "the frames have {} x {} pixels, the rig's camera {width} x {height}",
                frame.width, frame.height
            ))
            .hint("choose the rig that took the frames, or describe the sensor by options"));
        }
        let scale = scale.as_ref().map(|loaded| &loaded.record.values);
        Ok(sensor_noise(&sensor, flat.as_ref(), scale, resolution_px)?)
    }
}
