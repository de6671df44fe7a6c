//! `rig merge`: any exposure bracket becomes a radiance image.

use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::merge_sensor::SensorArgs;
use super::merge_warnings::{warn_agreement, warn_filters};
use super::output::{write_json, write_path};
use super::rig_choice::RigArg;
use super::{CliError, Context, bracket_files};
use crate::calibration::record::ResponseValues;
use crate::calibration::record_in;
use crate::radiometry::bracket_doubts::Counts;
use crate::radiometry::bracket_files::read_frame;
use crate::radiometry::bracket_merge::{
    self, BracketMergeError, CountModel, MergeRequest, Merged, check_linear, check_mosaic,
};
use crate::radiometry::frame_file::Tone;
use crate::radiometry::mosaic::Mosaic;
use crate::radiometry::response::Response;
use crate::radiometry::single_frames;

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
    /// separated by commas, semicolons or tabs; a first line may name the columns, `file`,
    /// `exposure_s` and `role`, which says what was lit: light (the default), ambient (lamp off)
    /// or dark (default: each frame's EXIF data, or its name, such
    /// as scene_20ms.png, scene_0,02s.png or scene_1-250s.jpg)
    #[arg(long, value_name = "CSV")]
    exposures: Option<PathBuf>,
    /// The radiance image to write (OpenEXR)
    #[arg(long, value_name = "EXR", default_value = "radiance.exr")]
    out: PathBuf,
    /// Make every frame an image of its own in this folder, DIR/NAME.exr of NAME.png, for lights
    /// that were photographed with one exposure each; where no frame states its exposure, it is 1
    #[arg(long, value_name = "DIR", conflicts_with_all = ["out", "measured_exposures"])]
    each: Option<PathBuf>,
    /// Colour filters over the sensor: none, rggb, grbg, gbrg or bggr; cells become RGB pixels
    #[arg(long, value_name = "ORDER", default_value = "none")]
    mosaic: Mosaic,
    /// Keep the resolution of a mosaic: a colour that a pixel did not measure is the mean of its
    /// nearest neighbours (default: a cell of 2 x 2 becomes one pixel, nothing is interpolated)
    #[arg(long)]
    full_resolution: bool,
    /// Use the exposures that the frames show in place of the stated ones, the shortest apart
    #[arg(long)]
    measured_exposures: bool,
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
    #[command(flatten)]
    sensor: SensorArgs,
}

/// `rig merge`.
pub fn run(args: &MergeArgs, context: &Context) -> Result<(), CliError> {
    let find = match args.each {
        Some(_) => bracket_files::find_single,
        None => bracket_files::find,
    };
    let table = args.exposures.as_deref();
    let files = find(&args.frames, table, args.response.is_none(), context)?;
    let model = count_model(args, &files[0].path, context)?;
    let request = MergeRequest {
        files: &files,
        model: &model,
        mosaic: args.mosaic,
        full_resolution: args.full_resolution,
        measured_exposures: args.measured_exposures,
        out: &args.out,
    };
    if let Some(folder) = &args.each {
        return merge_each(args, &request, folder, context);
    }
    let merged = bracket_merge::merge(&request, &()).map_err(advised)?;
    warn_merged(&merged, args, context);
    if merged.masked_pixels > 0 {
        let [width, height] = merged.size;
        context.note(format_args!(
            "{} of {} pixels are masked: clipped in every exposure, hot, or moving",
            merged.masked_pixels,
            width * height
        ));
    }
    for used in &merged.exposures {
        context.note(used);
    }
    match args.json {
        true => write_json(&report(&args.out, &merged)),
        false => write_path(&args.out),
    }
}

/// Every light frame by itself.
fn merge_each(
    args: &MergeArgs,
    request: &MergeRequest,
    folder: &Path,
    context: &Context,
) -> Result<(), CliError> {
    let images = single_frames::plan(request.files, folder, &()).map_err(advised)?;
    std::fs::create_dir_all(folder)
        .map_err(|error| CliError::new(format!("{}: {error}", folder.display())))?;
    let (mut reports, mut masked) = (Vec::new(), 0);
    for image in &images {
        let merged = image.merge(request, &()).map_err(advised)?;
        warn_merged(&merged, args, context);
        masked += usize::from(merged.masked_pixels > 0);
        match args.json {
            true => reports.push(report(&image.out, &merged)),
            false => write_path(&image.out)?,
        }
    }
    if masked > 0 {
        context.note(format_args!(
            "{masked} of {} images have masked pixels: clipped or hot",
            images.len()
        ));
    }
    match args.json {
        true => write_json(&reports),
        false => Ok(()),
    }
}

/// What the counts mean.
fn count_model(
    args: &MergeArgs,
    first_path: &Path,
    context: &Context,
) -> Result<CountModel, CliError> {
    let first = read_frame(first_path).map_err(bracket_files::advised)?;
    check_mosaic(first_path, &first, args.mosaic).map_err(advised)?;
    if let Some(path) = &args.response {
        let record = record_in::<ResponseValues>(path)?;
        let curves = record.values.channels.into_iter().map(Response::from);
        return Ok(CountModel::Response(curves.collect()));
    }
    check_linear(first_path, &first).map_err(advised)?;
    if first.tone == Tone::Gamma {
        context.warn(format_args!(
            "{}: the PNG says that its counts are sRGB or have another gamma, and they \
             are merged as proportional to light: if a camera or converter has bent \
             them, {RESPONSE_HINT}",
            first_path.display()
        ));
    }
    args.sensor.model(&args.rig, context, &first)
}

/// What speaks against the result.
fn warn_merged(merged: &Merged, args: &MergeArgs, context: &Context) {
    if let Some(doubt) = &merged.filter_doubt {
        warn_filters(doubt, args.mosaic, context);
    }
    let counts = match args.response {
        Some(_) => Counts::ThroughResponse,
        None => Counts::Raw,
    };
    warn_agreement(&merged.agreement, counts, context);
}

/// What to do about a bracket that cannot be merged.
fn advised(error: BracketMergeError) -> CliError {
    use BracketMergeError::*;
    let hint = match error {
        Files(error) => return bracket_files::advised(error),
        OneName { .. } => "give one of the frames another name, or merge it into another folder",
        Image(error) => return error.into(),
        ColouredMosaic { .. } => "leave --mosaic out for frames that are RGB already",
        NoColours { .. } => "give one value for all pixels, or --mosaic for raw frames in colour",
        Jpeg { .. } => RESPONSE_HINT,
        OtherResponse { .. } => "a response belongs to frames of the camera that it was found with",
        Count { .. } => "set --bit-depth to the significant bits of a count",
        Channels => return CliError::new(error),
        Disk(_) => DISK_HINT,
        Merge(_) => BRACKET_HINT,
    };
    CliError::from(error).hint(hint)
}

const DISK_HINT: &str = "frames wait in the folder of --out while they are merged: make room \
    there, or choose another folder";
const RESPONSE_HINT: &str = "find the camera's response with `rig calibrate response`, then give \
    the record with --response";
const BRACKET_HINT: &str = "mark at least one frame as light in the table (the default)";

/// What `--json` prints: how the exposures agree, per channel of the frames or colour of the
/// mosaic, shortest first; which ones are in use, where measured ones were asked for; and what
/// speaks against the order of colour filters.
fn report(image: &Path, merged: &Merged) -> Value {
    let [width, height] = merged.size;
    json!({
        "image": image.display().to_string(),
        "width": width,
        "height": height,
        "masked_pixels": merged.masked_pixels,
        "channels": merged.agreement,
        "measured_exposures": merged.exposures,
        "filter_doubt": merged.filter_doubt,
    })
}
