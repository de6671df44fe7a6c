//! `rig calibrate focus`: how sharp the camera is over the sample's depth.

use std::num::NonZeroUsize;
use std::path::PathBuf;

use super::target::{self, CommonArgs, noted};
use super::white::parse_region;
use crate::calibrating::{CalibratingError, EdgesRequest};
use crate::calibration::depth_of_field;
use crate::calibration::slanted_edge::EdgeError;
use crate::calibration::white::Region;
use crate::cli::number::within;
use crate::cli::{CliError, Context};

#[derive(clap::Args, Debug)]
pub(super) struct FocusArgs {
    #[command(flatten)]
    common: CommonArgs,
    /// Radiance images of the edge (OpenEXR, by `rig merge`) or sessions captured with the
    /// target in place of the sample: one for each height, or one in which all edges are
    #[arg(value_name = "EXR|SESSION", required = true)]
    input: Vec<PathBuf>,
    /// Heights of the edges above the sample's datum, in the order of the images (mm)
    #[arg(long, value_name = "MM,...", value_delimiter = ',', required = true, allow_hyphen_values = true, value_parser = within(-1e4, 1e4))]
    heights: Vec<f64>,
    /// Standard uncertainty that all heights share (mm)
    #[arg(long, value_name = "MM", default_value_t = 0.0, value_parser = within(0.0, 100.0))]
    height_std: f64,
    /// Where the edge is in the image (pixels; default: all of it); once for all images, or
    /// once for each height
    #[arg(long, value_name = "X,Y,WIDTH,HEIGHT", value_parser = parse_region)]
    region: Vec<Region>,
    /// Which light's image of a session is used, from 1
    #[arg(long, value_name = "N", default_value = "1")]
    light: NonZeroUsize,
}

pub(super) fn run(args: &FocusArgs, context: &Context) -> Result<(), CliError> {
    let rig = args.common.rig.resolve(context)?;
    let request = EdgesRequest {
        rig: &rig.config,
        input: &args.input,
        light: args.light.get() - 1,
        regions: &args.region,
        heights_mm: &args.heights,
        height_std_mm: args.height_std,
    };
    let measured = request.measure().map_err(|error| match error {
        CalibratingError::Focus(error) => advised(error),
        error => target::advised(error),
    })?;
    let place = args.common.place(&rig, context)?;
    let kept = noted(measured.keep(place)?, context);
    let values = &measured.values;
    let spread = values.point_spread_px;
    context.note(format_args!(
        "point spread {:.3} ± {:.3} px",
        spread.value, spread.std
    ));
    match &values.lens {
        Some(lens) => {
            let mut geometry = rig.config.geometry.clone();
            values.apply(&mut geometry);
            let sharp = depth_of_field::heights_mm(&geometry.camera, 1.0).map_or(
                String::new(),
                |[low, high]| {
                    format!("; blurred by less than 1 px at heights from {low:.2} to {high:.2} mm")
                },
            );
            context.note(format_args!(
                "sharp at {:.3} ± {:.3} mm from the camera, numerical aperture {:.5} ± {:.5}{sharp}",
                lens.focus_mm.value, lens.focus_mm.std, lens.object_na.value, lens.object_na.std
            ));
        }
        None => context.note(
            "focus and aperture stay as the rig file has them: edges at three heights determine them",
        ),
    }
    args.common.show(&kept, values)
}

/// An image, of a file or of a session's light.
/// What to do about edges that cannot be used.
fn advised(error: EdgeError) -> CliError {
    let hint = match &error {
        EdgeError::Counts { .. } => {
            "name one image, and with --region one part of it, per height; one image or one region may serve for all"
        }
        EdgeError::OneImage { .. } => {
            "name with --region where each edge is, in the order of the heights"
        }
        EdgeError::Size { .. } => "the images must be of the rig file's camera, without cropping",
        EdgeError::Region { .. } => "name with --region a part of the image around the edge",
        EdgeError::Contrast { .. } => {
            "the target must have a dark and a bright side, lit evenly, in a capture with little noise; --region says where it is"
        }
        EdgeError::NotStraight { .. } => {
            "name with --region a part of the image in which there is one straight edge and nothing else"
        }
        EdgeError::Tilt { .. } => {
            "turn the target until its edge runs 5 to 15 degrees off the pixels' rows or columns"
        }
        EdgeError::TooFew { .. } => {
            "let more of the edge be in the region, with ten pixels and more on either side of it"
        }
        EdgeError::Masked { .. } => "capture with shorter exposures, or clean the target",
        EdgeError::Height { .. } => {
            "check --heights, and position_mm in the rig file's [geometry.camera]"
        }
        EdgeError::NoDefocus { .. } => {
            "spread the heights further, beyond the sample's depth; or give one height alone, which determines the point spread"
        }
        EdgeError::Unfitted(_) => "give more light, more of the edge, or heights further apart",
        EdgeError::NotTheModel { .. } => {
            "the edge must be straight and sharp itself, the target flat and across the camera's axis; check the order of --heights"
        }
    };
    CliError::new(&error).hint(format!("{hint}; nothing was kept"))
}
