//! `rig calibrate flat`: the relative response of each pixel, and the scale.

use serde::Serialize;

use super::light::attendant;
use super::target::CommonArgs;
use crate::calibrating::FlatRequest;
use crate::calibration::procedure::ProcedureOptions;
use crate::calibration::record::Measured;
use crate::cli::output::{write_json, write_path};
use crate::cli::{CliError, Context, open};

#[derive(clap::Args, Debug)]
pub(super) struct FlatArgs {
    #[command(flatten)]
    common: CommonArgs,
    /// Flats and dark frames, each (1 to 65536); the map's noise falls with their root
    #[arg(long, value_name = "N", default_value_t = ProcedureOptions::FLAT_FRAMES, value_parser = clap::value_parser!(u32).range(1..=65_536))]
    frames: u32,
    /// Subtract frames with the light switched off and the room as it is, instead of dark ones
    #[arg(long)]
    ambient: bool,
    /// Radiance of the light by its certificate, W/(m² sr): makes a scale record too
    #[arg(long, value_name = "L", requires = "radiance_std")]
    radiance: Option<f64>,
    /// Standard uncertainty of that radiance, W/(m² sr)
    #[arg(long, value_name = "U", requires = "radiance")]
    radiance_std: Option<f64>,
}

#[derive(Serialize)]
struct FlatReport {
    flat: String,
    scale: Option<String>,
    std: f64,
    nonuniformity: f64,
    responsivity_e_s: Option<Measured>,
    ambient: Option<Measured>,
}

pub(super) fn run(args: &FlatArgs, context: &Context) -> Result<(), CliError> {
    let rig = args.common.rig.resolve(context)?;
    let mut place = args.common.place(&rig, context)?;
    let certified = args.radiance.zip(args.radiance_std);
    let request = FlatRequest {
        rig: &rig,
        frames: args.frames,
        ambient: args.ambient,
        radiance: certified.map(|(value, std)| Measured { value, std }),
        open: &open::of_port()?,
    };
    let measured = request.measure(&place, attendant(args.common.events, context)?.as_ref())?;
    let (flat, scale, values) = measured.keep(&mut place)?;
    // What was found.
    let (nonuniformity, std) = (measured.fit.nonuniformity(), values.std);
    context.note(format_args!(
        "response varies by {:.2}% between pixels, known to {:.3}%",
        100.0 * nonuniformity,
        100.0 * std
    ));
    if let Some(ambient) = values.ambient {
        context.note(format_args!(
            "the room adds {:.2}% of the light, which was subtracted",
            100.0 * ambient.value
        ));
    }
    if args.common.json {
        return write_json(&FlatReport {
            ambient: values.ambient,
            flat: flat.record.display().to_string(),
            scale: scale.map(|scale| scale.record.display().to_string()),
            std,
            nonuniformity,
            responsivity_e_s: measured.responsivity_e_s,
        });
    }
    write_path(&flat.record)?;
    match scale {
        Some(scale) => write_path(&scale.record),
        None => Ok(()),
    }
}
