//! `rig calibrate white`: the lamp's irradiance from a standard of known
//! reflectance.

use std::path::PathBuf;

use serde::Serialize;

use super::target::{self, CommonArgs};
use crate::calibrating::{CalibratingError, WhiteRequest};
use crate::calibration::record::Measured;
use crate::calibration::white::{Region, WhiteStandard};
use crate::calibration::white_lights::{LightIntensity, WhiteLights};
use crate::cli::number::within;
use crate::cli::{CliError, Context};

#[derive(clap::Args, Debug)]
pub(super) struct WhiteArgs {
    #[command(flatten)]
    common: CommonArgs,
    /// Radiance image of the standard (OpenEXR, by `rig merge`), or a session captured with
    /// the standard in place of the sample, which gives each light's intensity as well
    #[arg(value_name = "EXR|SESSION")]
    image: PathBuf,
    /// Radiance factor by the certificate, for these angles (0.02 to 1.2; not percent)
    #[arg(long, value_name = "R")]
    reflectance: f64,
    /// Its standard uncertainty (a certificate's expanded uncertainty is usually twice that)
    #[arg(long, value_name = "U")]
    reflectance_std: f64,
    /// The certificate's number, laboratory and date: named as the source in the record and in
    /// every certificate that rests on it
    #[arg(long, value_name = "TEXT", value_parser = certificate)]
    certificate: Option<String>,
    /// Angle between the standard's normal and the lamp (degrees; 0 to 85); of a session each
    /// light's own is taken
    #[arg(long, value_name = "DEG", default_value_t = WhiteStandard::INCIDENCE_DEG)]
    incidence: f64,
    /// Standard uncertainty of that angle (degrees)
    #[arg(long, value_name = "DEG", default_value_t = WhiteStandard::INCIDENCE_STD_DEG, value_parser = within(0.0, 10.0))]
    incidence_std: f64,
    /// Where the standard is in the image (pixels; default: all of it)
    #[arg(long, value_name = "X,Y,WIDTH,HEIGHT", value_parser = parse_region)]
    region: Option<Region>,
    /// Height of the standard's surface above the sample's datum (mm; sessions only)
    #[arg(
        long,
        value_name = "MM",
        default_value_t = 0.0,
        allow_negative_numbers = true,
        value_parser = within(-1e4, 1e4)
    )]
    height: f64,
    /// How much the radiance factor differs between the lights' directions (standard deviation,
    /// relative; sessions only)
    #[arg(long, value_name = "S", default_value_t = WhiteLights::DIRECTION_STD, value_parser = within(0.0, 0.2))]
    direction_std: f64,
}

fn certificate(text: &str) -> Result<String, String> {
    let text = text.trim();
    match (1..=200).contains(&text.chars().count()) && !text.contains(char::is_control) {
        true => Ok(text.to_owned()),
        false => Err("allowed are 1 to 200 characters on one line".to_owned()),
    }
}

pub(super) fn parse_region(text: &str) -> Result<Region, String> {
    let numbers: Option<Vec<usize>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[x, y, width, height]) => Ok([x, y, width, height].into()),
        _ => Err("four whole numbers: first column, first row, columns, rows".into()),
    }
}

#[derive(Serialize)]
struct WhiteReport<'a> {
    irradiance_w_m2: [Measured; 3],
    #[serde(skip_serializing_if = "<[_]>::is_empty")]
    lights: &'a [LightIntensity],
}

const HINT: &str = "put the standard where the sample will be, evenly lit, give the certificate's \
    radiance factor as a fraction, and with --region only the standard's own pixels; nothing was kept";

pub(super) fn run(args: &WhiteArgs, context: &Context) -> Result<(), CliError> {
    let rig = args.common.rig.resolve(context)?;
    let request = WhiteRequest {
        rig: &rig.config,
        images: &args.image,
        reflectance: Measured::new(args.reflectance, args.reflectance_std),
        incidence_deg: args.incidence,
        incidence_std_deg: args.incidence_std,
        certificate: args.certificate.as_deref(),
        region: args.region,
        height_mm: args.height,
        direction_std: args.direction_std,
    };
    let measured = request.measure(context).map_err(|error| match error {
        CalibratingError::White(error) => CliError::from(error).hint(HINT),
        error => target::advised(error),
    })?;
    let kept = measured.keep(args.common.place(&rig, context)?)?;
    let irradiance = measured.values.irradiance_w_m2;
    if args.image.is_dir() {
        let ([low, high], worst) = measured.intensities();
        context.note(format_args!(
            "fits of later captures use the lights' intensities, from {low:.4} to {high:.4} of \
             their mean, known to {:.2}%, and by how unevenly each lights the sample",
            100.0 * worst
        ));
    } else {
        let [red, green, blue] = irradiance.map(|m| m.value);
        context.note(format_args!(
            "fits of later captures use an irradiance of {red:.6}, {green:.6}, {blue:.6} W/m², \
             known to {:.2}%",
            100.0 * irradiance[0].std / irradiance[0].value
        ));
    }
    let report = WhiteReport {
        irradiance_w_m2: irradiance,
        lights: &measured.values.lights,
    };
    args.common.show(&kept, &report)
}
