//! `rig calibrate camera`: the lens, from views of a checkerboard.

use std::path::{Path, PathBuf};

use clap::ValueEnum;
use serde::Serialize;

use super::target::{CommonArgs, Target};
use crate::calibration::Library;
use crate::calibration::camera::{
    Board, CameraError, CameraOptions, CameraValues, Terms, calibrate, described,
};
use crate::calibration::mirror_sphere::Grey;
use crate::cli::bracket_files;
use crate::cli::output::{write_json, write_path};
use crate::cli::{CliError, Context};
use crate::radiance_image::exr;
use crate::workflow::session_images;

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

#[derive(Serialize)]
struct CameraReport {
    record: String,
    #[serde(flatten)]
    values: CameraValues,
    /// Part of the image that corners cover.
    coverage: f64,
    /// Why views were left out.
    left_out: Vec<String>,
}

/// What to do about it.
fn hint(error: &CameraError) -> &'static str {
    match error {
        CameraError::Impossible { .. } => "correct the value",
        CameraError::NotFound { .. } | CameraError::TooFewViews { .. } => {
            "the whole board, evenly lit, in focus, with squares of 10 pixels or more; --squares \
             counts squares, not corners"
        }
        CameraError::OtherBoard { .. } => "--squares counts squares along each side of the board",
        CameraError::NotWhole { .. } => {
            "name with --datum a view in which the whole board is visible, and check \
             --squares"
        }
        CameraError::Uncovered { .. } => {
            "add views with the board in the corners of the image, or take a larger board"
        }
        CameraError::SameTilt { .. } => {
            "tilt the board by 20 to 40 degrees, in another direction in each view"
        }
        CameraError::Unexplained { .. } => {
            "the board must be flat and stand still, --squares and the lens' model in the rig file \
             right, and a telecentric lens must see it flat; more terms with --distortion all"
        }
        CameraError::Folded(_) => "use fewer terms: --distortion radial, or none",
    }
}

pub(super) fn run(args: &CameraArgs, context: &Context) -> Result<(), CliError> {
    let rig = args.common.rig.resolve(context)?;
    let geometry = &rig.config.geometry;
    let mut images = Vec::new();
    for view in &args.views {
        images.push(read(view)?);
    }
    let (described, cell_px) = described(geometry, [images[0].width, images[0].height]);
    let board = Board {
        squares: args.squares,
        square_mm: args.square,
        square_std_mm: args.square_std,
        tilt_std_deg: args.tilt_std,
    };
    let options = CameraOptions {
        terms: args.distortion.terms(),
        least_views: args.least_views.map(|n| n as usize),
        datum: args.datum.map(|view| view as usize - 1),
    };
    let bar = context.spinner();
    bar.set_message("finding the board");
    let found = calibrate(&images, &described, &board, &options);
    bar.finish_and_clear();
    let (fit, missed) = found.map_err(|error| {
        let hint = hint(&error);
        CliError::new(error.to_string()).hint(format!("{hint}; nothing was kept"))
    })?;
    for missed in &missed {
        context.warn(missed.to_string());
    }
    let values = CameraValues::new(&fit, &described, cell_px);
    let names: Vec<_> = args.views.iter().map(|v| v.display().to_string()).collect();
    let target = Target::new(&rig.config, Library::of_rig(&rig), &args.common, context)?
        .measured_from(names.join(", "), rig.config.camera.resolution_px);
    let [columns, rows] = args.squares;
    let method = format!(
        "{} views of a board of {columns} x {rows} squares of {} mm, corners within {:.3} px",
        fit.views, args.square, values.residual_px
    );
    let path = target.add(values.clone(), &method, &[])?;
    #[cfg(feature = "figures")]
    target.draw(
        &crate::calibration::camera::figure(&fit, described.resolution_px),
        &path,
        context,
    )?;
    let [used, left_out] = values.corners;
    context.note(format_args!(
        "{} views, {used} corners ({left_out} left out) within {:.3} pixels; they cover {:.0}% of \
         the image",
        fit.views,
        values.residual_px,
        100.0 * fit.coverage
    ));
    if args.common.json {
        return write_json(&CameraReport {
            record: path.display().to_string(),
            values,
            coverage: fit.coverage,
            left_out: missed.iter().map(ToString::to_string).collect(),
        });
    }
    write_path(&path)
}

fn read(path: &Path) -> Result<Grey, CliError> {
    if path.is_dir() {
        let images: Vec<Grey> = session_images(path)?
            .captured
            .iter()
            .map(Grey::of)
            .collect();
        let none = || CliError::new(format!("{} has no images", path.display()));
        return Grey::mean(&images).ok_or_else(none);
    }
    // A layer may be named after the ending: view.exr:C.
    let ending = path.extension().unwrap_or_default().to_ascii_lowercase();
    if ending.to_string_lossy().split(':').next() == Some("exr") {
        return Ok(Grey::of(&exr::read(path)?.image));
    }
    Ok(Grey::of_picture(&bracket_files::read_picture(path, None)?))
}
