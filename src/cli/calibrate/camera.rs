//! `rig calibrate camera`: the lens, from views of a checkerboard.

use std::path::PathBuf;

use clap::ValueEnum;

use super::target::{CommonArgs, advised, noted};
use crate::calibrating::CameraRequest;
use crate::calibration::camera::{Board, CameraOptions, Terms};
use crate::cli::{CliError, Context};

#[derive(clap::Args, Debug)]
pub(super) struct CameraArgs {
    #[command(flatten)]
    common: CommonArgs,
    /// Views of the board, one each: merged images (OpenEXR), frames (PNG, TIFF, JPEG), or
    /// folders of sessions, whose lights are averaged
    #[arg(value_name = "VIEW", required = true)]
    views: Vec<PathBuf>,
    /// Squares of the board along its two sides (4 to 200 each), as in 10,7
    #[arg(long, value_name = "N,M", value_parser = parse_squares)]
    squares: [u32; 2],
    /// Side of a square (mm)
    #[arg(long, value_name = "MM")]
    square: f64,
    /// Standard uncertainty of that, common to all squares (mm)
    #[arg(long, value_name = "MM", default_value_t = 0.0)]
    square_std: f64,
    /// Standard uncertainty of the tilt of a board that lies flat before a telecentric lens
    /// (degrees; 0 to 10)
    #[arg(long, value_name = "DEG", default_value_t = Board::TILT_STD_DEG)]
    tilt_std: f64,
    /// Which terms of the distortion are sought
    #[arg(long, value_name = "TERMS", value_enum, default_value_t = Distortion::Usual)]
    distortion: Distortion,
    /// Views that must show the board (1 to 1000; default 3, or 1 for a telecentric lens)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1000))]
    least_views: Option<u32>,
    /// The view, from 1, whose board lies at the sample's datum: its middle there, its front
    /// up, its sides along x and y; gives the camera's pose
    #[arg(long, value_name = "VIEW", value_parser = clap::value_parser!(u32).range(1..))]
    datum: Option<u32>,
}

#[derive(ValueEnum, Clone, Copy, Debug)]
enum Distortion {
    /// None
    None,
    /// k1
    Radial,
    /// k1, k2, p1 and p2
    Usual,
    /// k1, k2, k3, p1 and p2
    All,
}

impl Distortion {
    fn terms(self) -> Terms {
        match self {
            Self::None => Terms::None,
            Self::Radial => Terms::Radial,
            Self::Usual => Terms::Usual,
            Self::All => Terms::All,
        }
    }
}

fn parse_squares(text: &str) -> Result<[u32; 2], String> {
    let numbers: Option<Vec<u32>> = text
        .split([',', 'x'])
        .map(|n| n.trim().parse().ok())
        .collect();
    match numbers.as_deref() {
        Some(&[a, b]) => Ok([a, b]),
        _ => Err("two whole numbers: squares along one side and along the other".into()),
    }
}

pub(super) fn run(args: &CameraArgs, context: &Context) -> Result<(), CliError> {
    let rig = args.common.rig.resolve(context)?;
    let request = CameraRequest {
        rig: &rig.config,
        views: &args.views,
        board: Board {
            squares: args.squares,
            square_mm: args.square,
            square_std_mm: args.square_std,
            tilt_std_deg: args.tilt_std,
        },
        options: CameraOptions {
            terms: args.distortion.terms(),
            least_views: args.least_views.map(|n| n as usize),
            datum: args.datum.map(|view| view as usize - 1),
        },
    };
    let bar = context.spinner();
    bar.set_message("finding the board");
    let measured = request.measure();
    bar.finish_and_clear();
    let measured = measured.map_err(advised)?;
    for missed in &measured.left_out {
        context.warn(missed);
    }
    let place = args.common.place(&rig, context)?;
    let kept = noted(measured.keep(&place)?, context);
    let [used, left_out] = measured.values.corners;
    context.note(format_args!(
        "views: {}, corners: {used} ({left_out} left out), within {:.3} pixels; they cover {:.0}% of \
         the image",
        measured.fit.views,
        measured.values.residual_px,
        100.0 * measured.coverage
    ));
    args.common.show(&kept, &measured)
}
