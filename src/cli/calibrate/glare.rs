//! `rig calibrate glare`: the light that the lens scatters, from black traps on a white card.

use std::num::NonZeroUsize;
use std::path::PathBuf;

use super::light::attendant;
use super::target::{CommonArgs, advised};
use super::white::parse_region;
use crate::calibrating::{CardRequest, image_of};
use crate::calibration::glare::GlareRequest;
use crate::calibration::procedure::ProcedureOptions;
use crate::calibration::record::Measured;
use crate::calibration::white::Region;
use crate::cli::number::within;
use crate::cli::{CliError, Context, open};

#[derive(clap::Args, Debug)]
pub(super) struct GlareArgs {
    #[command(flatten)]
    common: CommonArgs,
    /// Radiance image of the card (OpenEXR, by `rig merge`) or session captured with it in place
    /// of the sample; if not given, the camera takes frames now
    #[arg(value_name = "EXR|SESSION")]
    input: Option<PathBuf>,
    /// A part of the image inside a trap, away from its edge (pixels); once for each trap. The
    /// simulated card has two, which need not be named
    #[arg(long, value_name = "X,Y,WIDTH,HEIGHT", value_parser = parse_region)]
    trap: Vec<Region>,
    /// What the traps reflect over what the card does
    #[arg(long, value_name = "R", default_value_t = GlareRequest::TRAP_REFLECTANCE, value_parser = within(0.0, 0.1))]
    trap_reflectance: f64,
    /// Standard uncertainty of that
    #[arg(long, value_name = "U", default_value_t = GlareRequest::TRAP_REFLECTANCE_STD, value_parser = within(0.0, 0.1))]
    trap_reflectance_std: f64,
    /// Which light's image of a session is used, from 1
    #[arg(long, value_name = "N", default_value = "1")]
    light: NonZeroUsize,
    /// Frames of the card and dark frames, each (1 to 65536)
    #[arg(long, value_name = "N", default_value_t = ProcedureOptions::FLAT_FRAMES, value_parser = clap::value_parser!(u32).range(1..=65_536))]
    frames: u32,
}

pub(super) fn run(args: &GlareArgs, context: &Context) -> Result<(), CliError> {
    let rig = args.common.rig.resolve(context)?;
    let mut place = args.common.place(&rig, context)?;
    let request = CardRequest {
        rig: &rig.config,
        traps: &args.trap,
        trap_reflectance: Measured::new(args.trap_reflectance, args.trap_reflectance_std),
        frames: args.frames,
        open: &open::of_port()?,
    };
    let measured = match &args.input {
        Some(path) => {
            let image = image_of(path, args.light.get() - 1, &rig.config.name).map_err(advised)?;
            let source = path.display().to_string();
            place = place.measured_from(source, rig.config.camera.resolution_px);
            request.measure_image(&image)?
        }
        None => request.measure(attendant(args.common.events, context)?.as_ref())?,
    };
    let kept = measured.keep(&place)?;
    let values = &measured.values;
    for (what, share) in [
        ("evenly", values.uniform),
        ("into a halo", values.halo),
        ("in all", values.total()),
    ] {
        context.note(format_args!(
            "the lens scatters {:.3} ± {:.3}% of the light {what}",
            100.0 * share.value,
            100.0 * share.std
        ));
    }
    args.common.show(&kept, values)
}
