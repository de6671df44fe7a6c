//! `rig calibrate white`: the lamp's irradiance from a standard of known
//! reflectance.

use std::path::PathBuf;

use serde::Serialize;

use super::target::{CommonArgs, Target};
use crate::calibration::Library;
use crate::calibration::record::{LightsValues, Measured};
use crate::calibration::white::{Region, WhiteStandard, irradiance};
use crate::cli::output::write_json;
use crate::cli::{CliError, Context, HintExt};
use crate::out;
use crate::radiance_image::exr;

#[derive(clap::Args, Debug)]
pub(super) struct WhiteArgs {
    #[command(flatten)]
    common: CommonArgs,
    /// Radiance image of the standard (OpenEXR, by `rig merge` or from a session's derived/)
    #[arg(value_name = "EXR")]
    image: PathBuf,
    /// Radiance factor by the certificate, for these angles (0.02 to 1.2; not percent)
    #[arg(long, value_name = "R")]
    reflectance: f64,
    /// Its standard uncertainty (a certificate's expanded uncertainty is usually twice that)
    #[arg(long, value_name = "U")]
    reflectance_std: f64,
    /// Angle between the standard's normal and the lamp (degrees; 0 to 85)
    #[arg(long, value_name = "DEG", default_value_t = 45.0)]
    incidence: f64,
    /// Standard uncertainty of that angle (degrees)
    #[arg(long, value_name = "DEG", default_value_t = 0.1)]
    incidence_std: f64,
    /// Where the standard is in the image (pixels; default: all of it)
    #[arg(long, value_name = "X,Y,WIDTH,HEIGHT", value_parser = parse_region)]
    region: Option<Region>,
}

pub(super) fn parse_region(text: &str) -> Result<Region, String> {
    let numbers: Option<Vec<usize>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[x, y, width, height]) => Ok(Region {
            x,
            y,
            width,
            height,
        }),
        _ => Err("four whole numbers: first column, first row, columns, rows".into()),
    }
}

#[derive(Serialize)]
struct WhiteReport {
    record: String,
    irradiance_w_m2: [Measured; 3],
}

const HINT: &str = "put the standard where the sample will be, evenly lit, give the certificate's \
    radiance factor as a fraction, and with --region only the standard's own pixels; nothing was kept";

pub(super) fn run(args: &WhiteArgs, context: &Context) -> Result<(), CliError> {
    if !(0.0..=10.0).contains(&args.incidence_std) {
        return Err(
            CliError::new(format!("--incidence-std is {}", args.incidence_std))
                .hint("it must be a number of degrees from 0 to 10"),
        );
    }
    let rig = args.common.rig.resolve(context)?;
    let image = exr::read(&args.image)?.image;
    let whole = Region {
        x: 0,
        y: 0,
        width: image.width,
        height: image.height,
    };
    let standard = WhiteStandard {
        reflectance: Measured {
            value: args.reflectance,
            std: args.reflectance_std,
        },
        incidence_rad: args.incidence.to_radians(),
        incidence_std_rad: args.incidence_std.to_radians(),
    };
    let found = irradiance(&image, args.region.unwrap_or(whole), &standard).hint(HINT)?;
    let mut target = Target::new(&rig.config, Library::of_rig(&rig), &args.common, context);
    target.source = args.image.display().to_string();
    let method = format!(
        "diffuse standard of reflectance {} ± {} at {} degrees",
        args.reflectance, args.reflectance_std, args.incidence
    );
    let values = LightsValues {
        irradiance_w_m2: found,
    };
    let path = target.add(values, &method, &[])?;
    let [red, green, blue] = found.map(|m| m.value);
    context.note(format_args!(
        "fits of later captures go by an irradiance of {red:.6}, {green:.6}, {blue:.6} W/m², known \
         to {:.2}%",
        100.0 * found[0].std / found[0].value
    ));
    if args.common.json {
        return write_json(&WhiteReport {
            record: path.display().to_string(),
            irradiance_w_m2: found,
        });
    }
    out!("{}", path.display())
}
