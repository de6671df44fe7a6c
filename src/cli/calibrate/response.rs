//! `rig calibrate response`: the exposure that each count of a camera that is not linear
//! stands for.

use std::path::PathBuf;

use clap::ValueEnum;

use super::target::{CommonArgs, advised, noted};
use super::white::parse_region;
use crate::calibrating::ResponseRequest;
use crate::calibration::white::Region;
use crate::cli::bracket_files;
use crate::cli::merge_warnings::warn_agreement;
use crate::cli::{CliError, Context};
use crate::radiometry::bracket_doubts::Counts;
use crate::radiometry::response::{Estimator, ResponseOptions};

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

/// Channels of a digital camera share their curve; more than this part is another cause.
const CONTRAST_WARNING: f64 = 0.12;

pub(super) fn run(args: &ResponseArgs, context: &Context) -> Result<(), CliError> {
    if let Some(smoothness) = args.smoothness
        && !(smoothness.is_finite() && smoothness > 0.0)
    {
        return Err(CliError::new(format!("--smoothness is {smoothness}"))
            .hint("it must be a number above 0; larger is smoother"));
    }
    let rig = args.common.rig.resolve(context)?;
    let files = bracket_files::find(&args.frames, args.exposures.as_deref(), false, context)?;
    // The curves.
    let defaults = ResponseOptions::default();
    let request = ResponseRequest {
        files: &files,
        region: args.region,
        options: ResponseOptions {
            estimator: args.method.map_or(defaults.estimator, Method::estimator),
            smoothness: args.smoothness,
            samples: args.samples as usize,
        },
    };
    let measured = request.measure().map_err(advised)?;
    // What no response explains.
    warn_agreement(&measured.agreement, Counts::ThroughResponse, context);
    if measured.contrast_spread > CONTRAST_WARNING {
        context.warn(format_args!(
            "the contrast of the channels' curves differs by {:.0}%: the camera's white balance \
             or the lamp's colour changed from frame to frame, and colours merged with this \
             record are wrong; set the white balance by hand (films may differ so)",
            100.0 * measured.contrast_spread
        ));
    }
    let place = args.common.place(&rig, context)?;
    let kept = noted(measured.keep(&place)?, context);
    args.common.show(&kept, &measured)
}
