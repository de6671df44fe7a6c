//! `rig calibrate response`: the exposure that each count of a camera that is not linear
//! stands for.

use std::path::PathBuf;

use clap::ValueEnum;
use serde::Serialize;

use super::target::{CommonArgs, Target};
use super::white::parse_region;
use crate::calibration::Library;
#[cfg(feature = "figures")]
use crate::calibration::figures;
use crate::calibration::record::{ResponseCurve, ResponseValues};
use crate::calibration::white::Region;
use crate::cli::bracket_files;
use crate::cli::merge_warnings::{Counts, warn_agreement};
use crate::cli::output::{write_json, write_path};
use crate::cli::{CliError, Context, HintExt};
use crate::radiometry::bracket_files::{BracketFile, FrameReader};
use crate::radiometry::frame_file::FrameFile;
use crate::radiometry::response::{
    Estimator, Response, ResponseMerge, ResponseOptions, contrast_spread, responses,
};

#[derive(clap::Args, Debug)]
pub(super) struct ResponseArgs {
    #[command(flatten)]
    common: CommonArgs,
    /// Frames of a still scene, or folders of them: 8 bits, at least three exposures
    #[arg(value_name = "FRAMES", required = true)]
    frames: Vec<PathBuf>,
    /// Table of exposures: CSV lines `file,exposure_s`, seconds or fractions such as 1/250
    /// (default: EXIF data or file names)
    #[arg(long, value_name = "CSV")]
    exposures: Option<PathBuf>,
    /// Estimator (default: debevec)
    #[arg(long, value_enum)]
    method: Option<Method>,
    /// Weight of the curve's smoothness (default 10 for debevec, 30 for robertson)
    #[arg(long, value_name = "L")]
    smoothness: Option<f64>,
    /// The part of the frames that is used, without margins and captions (pixels; default: all)
    #[arg(long, value_name = "X,Y,WIDTH,HEIGHT", value_parser = parse_region)]
    region: Option<Region>,
    /// Largest number of pixels that are used
    #[arg(long, value_name = "N", default_value_t = ResponseOptions::SAMPLES, value_parser = clap::value_parser!(u32).range(100..=1_000_000))]
    samples: u32,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Method {
    /// Debevec and Malik (1997)
    Debevec,
    /// Robertson, Borman and Stevenson (2003)
    Robertson,
}

impl Method {
    fn estimator(self) -> Estimator {
        match self {
            Self::Debevec => Estimator::Debevec,
            Self::Robertson => Estimator::Robertson,
        }
    }
}

#[derive(Serialize)]
struct ResponseReport<'a> {
    record: String,
    exposures_s: Vec<f64>,
    values: &'a ResponseValues,
}

const SCENE_HINT: &str = "photograph a still scene of many brightnesses with manual exposure, at \
    least three exposures a factor of two to four apart, from nearly black to nearly white";

/// Channels of a digital camera share their curve; more than this part is another cause.
const CONTRAST_WARNING: f64 = 0.12;

fn inside(region: Region, frame: &FrameFile) -> Result<FrameFile, CliError> {
    let Region {
        x,
        y,
        width,
        height,
    } = region;
    let part = frame.part(x..x.saturating_add(width), y..y.saturating_add(height));
    part.ok_or_else(|| {
        CliError::new(format!(
            "the region of {width} x {height} pixels at ({x}, {y}) is empty or not inside the {} x {} frames",
            frame.width, frame.height
        ))
        .hint("--region takes first column, first row, columns and rows; both count from 0")
    })
}

/// Warns of what no response explains: frames that differ otherwise than by their exposures, and
/// channels that differ from each other.
fn warn_frames(frames: &[FrameFile], exposures_s: &[f64], curves: &[Response], context: &Context) {
    let agreement = |(channel, curve): (usize, &Response)| {
        let counts = frames.iter().map(|frame| frame.planes[channel].as_slice());
        let merged = exposures_s.iter().copied().zip(counts).collect();
        let width = frames.first().map_or(1, |frame| frame.width);
        ResponseMerge::new(curve, width, merged).finish().agreement
    };
    let channels: Vec<_> = curves.iter().enumerate().map(agreement).collect();
    warn_agreement(&channels, Counts::ThroughResponse, context);
    let spread = contrast_spread(curves);
    if spread > CONTRAST_WARNING {
        context.warn(format_args!(
            "the contrast of the channels' curves differs by {:.0}%: the camera's white balance \
             or the lamp's colour changed from frame to frame, and colours merged with this \
             record are wrong; set the white balance by hand (films may differ so)",
            100.0 * spread
        ));
    }
}

pub(super) fn run(args: &ResponseArgs, context: &Context) -> Result<(), CliError> {
    if let Some(smoothness) = args.smoothness
        && !(smoothness.is_finite() && smoothness > 0.0)
    {
        return Err(CliError::new(format!("--smoothness is {smoothness}"))
            .hint("it must be a number above 0; larger is smoother"));
    }
    let rig = args.common.rig.resolve(context)?;
    let files = bracket_files::find(&args.frames, args.exposures.as_deref(), false, context)?;
    // The frames.
    let first_path = files[0].path.as_path();
    let mut reader = FrameReader::default();
    let mut size_px = [0, 0];
    let mut frames = Vec::with_capacity(files.len());
    for BracketFile { path, .. } in &files {
        let frame = reader.read(path).map_err(bracket_files::advised)?;
        if frame.bits != 8 {
            return Err(CliError::new(format!(
                "{} has {} bits, and a response is of 8",
                path.display(),
                frame.bits
            ))
            .hint("cameras that give more bits are linear: `rig calibrate sensor`"));
        }
        size_px = [frame.width as u32, frame.height as u32];
        frames.push(match args.region {
            Some(region) => inside(region, &frame)?,
            None => frame,
        });
    }
    // The curves.
    let exposures_s: Vec<f64> = files.iter().map(|file| file.exposure_s).collect();
    let defaults = ResponseOptions::default();
    let options = ResponseOptions {
        estimator: args.method.map_or(defaults.estimator, Method::estimator),
        smoothness: args.smoothness,
        samples: args.samples as usize,
    };
    let curves = responses(&frames, &exposures_s, &options).hint(SCENE_HINT)?;
    warn_frames(&frames, &exposures_s, &curves, context);
    let values = ResponseValues {
        channels: curves.into_iter().map(ResponseCurve::from).collect(),
    };
    // The record.
    let source = format!("{} frames, {} first", files.len(), first_path.display());
    let mut target = Target::new(&rig.config, Library::of_rig(&rig), &args.common, context)?
        .measured_from(source, size_px);
    target.measurement.settings.bit_depth = Some(8);
    let method = format!(
        "{}, {} exposures of {} to {} s",
        options.estimator.name(),
        exposures_s.len(),
        exposures_s.iter().copied().fold(f64::INFINITY, f64::min),
        exposures_s.iter().copied().fold(0.0, f64::max),
    );
    let path = target.add(values.clone(), &method, &[])?;
    #[cfg(feature = "figures")]
    target.draw(&figures::response(&values), &path, context)?;
    if args.common.json {
        return write_json(&ResponseReport {
            record: path.display().to_string(),
            exposures_s,
            values: &values,
        });
    }
    write_path(&path)
}
