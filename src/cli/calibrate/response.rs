//! `rig calibrate response`: which exposure each count of a camera stands for
//! that is not linear.

use std::path::PathBuf;

use clap::ValueEnum;
use serde::Serialize;

use super::target::{CommonArgs, Target};
use super::white::parse_region;
use crate::calibration::Library;
#[cfg(feature = "figures")]
use crate::calibration::figures;
use crate::calibration::record::{ResponseCurve, ResponseValues, Settings};
use crate::calibration::white::Region;
use crate::cli::bracket_files::{self, BracketFile, Distinct, read_frame, same_kind};
use crate::cli::output::{write_json, write_path};
use crate::cli::{CliError, Context, HintExt};
use crate::radiometry::frame_file::FrameFile;
use crate::radiometry::response::{BracketSamples, Response, debevec, robertson};

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
    /// Estimator
    #[arg(long, value_enum, default_value_t = Method::Debevec)]
    method: Method,
    /// Weight of the curve's smoothness (default 10 for debevec, 30 for robertson)
    #[arg(long, value_name = "L")]
    smoothness: Option<f64>,
    /// The part of the frames that is gone by, without margins and captions (pixels; default: all)
    #[arg(long, value_name = "X,Y,WIDTH,HEIGHT", value_parser = parse_region)]
    region: Option<Region>,
    /// Largest number of pixels that are looked at
    #[arg(long, value_name = "N", default_value_t = 4096, value_parser = clap::value_parser!(u32).range(100..=1_000_000))]
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
    fn name(self) -> &'static str {
        match self {
            Self::Debevec => "Debevec-Malik",
            Self::Robertson => "Robertson",
        }
    }

    fn solve(
        self,
        samples: &BracketSamples,
        smoothness: Option<f64>,
    ) -> Result<Response, crate::radiometry::response::ResponseError> {
        match self {
            Self::Debevec => debevec(samples, smoothness.unwrap_or(10.0)),
            Self::Robertson => robertson(samples, smoothness.unwrap_or(30.0)),
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

pub(super) fn run(args: &ResponseArgs, context: &Context) -> Result<(), CliError> {
    if let Some(smoothness) = args.smoothness
        && !(smoothness.is_finite() && smoothness > 0.0)
    {
        return Err(CliError::new(format!("--smoothness is {smoothness}"))
            .hint("it must be a number above 0; larger is smoother"));
    }
    let rig = args.common.rig.resolve(context)?;
    let files = bracket_files::find(&args.frames, args.exposures.as_deref(), context)?;
    let first_path = files[0].path.as_path();
    let first = read_frame(first_path)?;
    if first.bits != 8 {
        return Err(CliError::new(format!(
            "{} has {} bits, and a response is of 8",
            first_path.display(),
            first.bits
        ))
        .hint("cameras that give more bits are linear: `rig calibrate sensor`"));
    }
    let mut frames = Vec::with_capacity(files.len());
    let mut distinct = Distinct::default();
    for BracketFile { path, .. } in &files {
        let frame = read_frame(path)?;
        same_kind((first_path, &first), (path, &frame))?;
        distinct.add(path, &frame)?;
        frames.push(match args.region {
            Some(region) => inside(region, &frame)?,
            None => frame,
        });
    }
    let exposures_s: Vec<f64> = files.iter().map(|file| file.exposure_s).collect();
    let channels = (0..first.planes.len())
        .map(|channel| {
            let counts: Vec<&[u16]> = frames
                .iter()
                .map(|f| f.planes[channel].as_slice())
                .collect();
            let samples =
                BracketSamples::on_grid(exposures_s.clone(), &counts, args.samples as usize);
            let curve = args.method.solve(&samples, args.smoothness)?;
            Ok(ResponseCurve {
                ln_exposure: curve.ln_exposure,
                ln_std: curve.ln_std,
                darkest: curve.darkest,
            })
        })
        .collect::<Result<Vec<_>, CliError>>()
        .hint(SCENE_HINT)?;
    let values = ResponseValues { channels };
    let mut target = Target::new(&rig.config, Library::of_rig(&rig), &args.common, context)?;
    target.source = format!("{} frames, {} first", files.len(), first_path.display());
    target.settings = Settings {
        bit_depth: Some(8),
        resolution_px: Some([first.width as u32, first.height as u32]),
        ..Settings::default()
    };
    let method = format!(
        "{}, {} exposures of {} to {} s",
        args.method.name(),
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
