//! `rig merge`: any exposure bracket becomes a radiance image.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::bracket_files::{self, BracketFile, Distinct, read_frame, same_kind};
use super::output::{write_json, write_path};
use super::rig_choice::RigArg;
use super::{CliError, Context, HintExt};
use crate::calibration::noise::sensor_noise;
use crate::calibration::record::{
    FlatValues, ResponseCurve, ResponseValues, ScaleValues, SensorValues,
};
use crate::calibration::{Library, record_in};
use crate::radiance_image::RadianceImage;
use crate::radiance_image::exr;
use crate::radiometry::agreement::ExposureAgreement;
use crate::radiometry::frame_file::{FrameFile, Tone};
use crate::radiometry::mosaic::Mosaic;
use crate::radiometry::plane::MergedPlane;
use crate::radiometry::response::Response;
use crate::radiometry::sensor::SensorNoise;
use crate::radiometry::stack::{Band, Stack};

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
    #[arg(long, value_name = "ORDER", default_value = "none", value_parser = parse_mosaic)]
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

fn parse_mosaic(text: &str) -> Result<Mosaic, String> {
    match text {
        "none" => Ok(Mosaic::None),
        "rggb" => Ok(Mosaic::Rggb),
        "grbg" => Ok(Mosaic::Grbg),
        "gbrg" => Ok(Mosaic::Gbrg),
        "bggr" => Ok(Mosaic::Bggr),
        _ => Err("none, rggb, grbg, gbrg or bggr".into()),
    }
}

/// `rig merge`.
pub fn run(args: &MergeArgs, context: &Context) -> Result<(), CliError> {
    let frames = bracket_files::find(&args.frames, args.exposures.as_deref(), context)?;
    let first_path = frames[0].path.as_path();
    let first = read_frame(first_path)?;
    if args.mosaic != Mosaic::None && first.planes.len() != 1 {
        return Err(CliError::new(format!(
            "{} has {} channels, but a mosaic is one grey channel",
            first_path.display(),
            first.planes.len()
        ))
        .hint("leave --mosaic out for frames that are RGB already"));
    }
    let model = match &args.response {
        Some(path) => Model::Response(responses(path, first_path, &first)?),
        None => Model::Linear(Box::new(args.noise(context, first_path, &first)?)),
    };
    if let Model::Linear(noise) = &model {
        noise.check(first.width * first.height).hint(
            "--gain, --read-noise, --black-level, --saturation and --bit-depth describe the sensor",
        )?;
    }
    let stack = gather(args, &model, &frames, &first)?;
    match &model {
        Model::Linear(noise) => merge_linear(args, context, &stack, noise, &first),
        Model::Response(responses) => merge_response(args, context, &stack, responses, &first),
    }
}

/// What turns counts into radiance.
enum Model {
    /// Raw counts of a sensor with this noise.
    Linear(Box<SensorNoise>),
    /// 8-bit counts through a response per channel.
    Response(Vec<Response>),
}

/// All frames, checked, on disk.
fn gather(
    args: &MergeArgs,
    model: &Model,
    frames: &[BracketFile],
    first: &FrameFile,
) -> Result<Stack, CliError> {
    let folder = args.out.parent().filter(|p| !p.as_os_str().is_empty());
    let folder = folder.unwrap_or(Path::new("."));
    let mut stack =
        Stack::new(folder, first.width, first.height, first.planes.len()).hint(DISK_HINT)?;
    let bits = match model {
        Model::Linear(noise) => noise.bit_depth,
        Model::Response(_) => first.bits,
    };
    let full_scale_dn = ((1u32 << bits) - 1) as u16;
    let mut distinct = Distinct::default();
    for BracketFile {
        path,
        role,
        exposure_s,
    } in frames
    {
        let frame = read_frame(path)?;
        same_kind((&frames[0].path, first), (path, &frame))?;
        distinct.add(path, &frame)?;
        let largest = frame.planes.iter().flatten().max().copied().unwrap_or(0);
        if largest > full_scale_dn {
            return Err(CliError::new(format!(
                "{} has a count of {largest}, but {bits} bits end at {full_scale_dn}",
                path.display(),
            ))
            .hint("set --bit-depth to the significant bits of a count"));
        }
        stack
            .add(*role, *exposure_s, &frame.planes)
            .hint(DISK_HINT)?;
    }
    Ok(stack)
}

fn merge_linear(
    args: &MergeArgs,
    context: &Context,
    stack: &Stack,
    noise: &SensorNoise,
    first: &FrameFile,
) -> Result<(), CliError> {
    let size = match args.mosaic {
        Mosaic::None => [first.width, first.height],
        _ if args.full_resolution => [first.width, first.height],
        _ => [first.width / 2, first.height / 2],
    };
    let margin = usize::from(args.full_resolution);
    let mut bands = stack.bands(noise, args.mosaic, margin);
    let mut masked = 0;
    exr::write_rows(&args.out, size[0], size[1], || {
        let band = bands.next_band().hint(BRACKET_HINT)?;
        let band = band.ok_or_else(|| CliError::new("the frames have no more rows"))?;
        let image = args.image(&band)?;
        masked += image.valid.iter().filter(|&&valid| !valid).count();
        Ok::<_, CliError>(image)
    })?;
    let agreement = bands.agreement();
    for steps in &agreement {
        warn(steps, context);
    }
    args.finish(context, size, masked, agreement)
}

fn merge_response(
    args: &MergeArgs,
    context: &Context,
    stack: &Stack,
    responses: &[Response],
    first: &FrameFile,
) -> Result<(), CliError> {
    let (mut at, mut masked) = (0, 0);
    exr::write_rows(&args.out, first.width, first.height, || {
        let rows = at..(at + stack.band_rows()).min(first.height);
        at = rows.end;
        let image = to_image(&stack.through_response(responses, rows).hint(BRACKET_HINT)?)?;
        masked += image.valid.iter().filter(|&&valid| !valid).count();
        Ok::<_, CliError>(image)
    })?;
    args.finish(context, [first.width, first.height], masked, Vec::new())
}

fn responses(path: &Path, frame: &Path, first: &FrameFile) -> Result<Vec<Response>, CliError> {
    let record = record_in::<ResponseValues>(path)?;
    if first.bits != 8 || record.values.channels.len() != first.planes.len() {
        return Err(CliError::new(format!(
            "{} has {} channels of 8 bits, but {} has {} of {} bits",
            path.display(),
            record.values.channels.len(),
            frame.display(),
            first.planes.len(),
            first.bits
        ))
        .hint("a response belongs to frames of the camera that it was found with"));
    }
    let curve = |curve: ResponseCurve| Response {
        ln_exposure: curve.ln_exposure,
        ln_std: curve.ln_std,
        darkest: curve.darkest,
    };
    Ok(record.values.channels.into_iter().map(curve).collect())
}

fn to_image(planes: &[MergedPlane]) -> Result<RadianceImage, CliError> {
    let image = match planes {
        [red, green, blue] => MergedPlane::to_rgb([red, green, blue]),
        [grey] => Some(grey.to_grey()),
        _ => None,
    };
    image.ok_or_else(|| CliError::new("the frames have neither one channel nor three"))
}

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

/// A frame whose signal departs from the others' prediction by more than this
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
    fn finish(
        &self,
        context: &Context,
        [width, height]: [usize; 2],
        masked_pixels: usize,
        channels: Vec<Vec<ExposureAgreement>>,
    ) -> Result<(), CliError> {
        if masked_pixels > 0 {
            context.note(format_args!(
                "{masked_pixels} of {} pixels are masked: clipped in every exposure, hot, or moving",
                width * height
            ));
        }
        if !self.json {
            return write_path(&self.out);
        }
        write_json(&MergeReport {
            image: self.out.display().to_string(),
            width,
            height,
            masked_pixels,
            channels,
        })
    }

    /// The image of a band without its margins.
    fn image(&self, band: &Band) -> Result<RadianceImage, CliError> {
        let image = match band.planes.as_slice() {
            [grey] if self.full_resolution => grey.demosaiced(self.mosaic),
            [grey] => grey.binned(self.mosaic),
            planes => to_image(planes)?,
        };
        if !self.full_resolution {
            return Ok(image);
        }
        Ok(image.rows(band.above..band.above + band.rows))
    }

    /// The sensor from the rig's records where --rig is given, and the options.
    fn noise(
        &self,
        context: &Context,
        path: &Path,
        frame: &FrameFile,
    ) -> Result<SensorNoise, CliError> {
        match frame.tone {
            Tone::Jpeg => {
                return Err(CliError::new(format!(
                    "{} is a JPEG, whose counts are not proportional to light",
                    path.display()
                ))
                .hint(RESPONSE_HINT));
            }
            Tone::Gamma => context.warn(format_args!(
                "{}: the PNG says that its counts are sRGB or have another gamma, and they are \
                 merged as proportional to light: if a camera or converter has bent them, \
                 {RESPONSE_HINT}",
                path.display()
            )),
            Tone::Unstated => {}
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
