//! `rig calibrate white`: the lamp's irradiance from a standard of known
//! reflectance.

use std::path::PathBuf;

use serde::Serialize;

use super::target::CommonArgs;
use crate::calibration::record::{LightsValues, Measured};
use crate::calibration::white::{Region, WhiteStandard, irradiance};
use crate::calibration::white_lights::{LightIntensity, WhiteLights};
use crate::cli::{CliError, Context, HintExt};
use crate::radiance_image::exr;
use crate::workflow::{BenchRecords, session_images};

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
    #[arg(long, value_name = "DEG", default_value_t = WhiteStandard::INCIDENCE_STD_DEG)]
    incidence_std: f64,
    /// Where the standard is in the image (pixels; default: all of it)
    #[arg(long, value_name = "X,Y,WIDTH,HEIGHT", value_parser = parse_region)]
    region: Option<Region>,
    /// Height of the standard's surface above the sample's datum (mm; sessions only)
    #[arg(
        long,
        value_name = "MM",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    height: f64,
    /// How much the radiance factor differs between the lights' directions (standard deviation,
    /// relative; sessions only)
    #[arg(long, value_name = "S", default_value_t = WhiteLights::DIRECTION_STD)]
    direction_std: f64,
}

impl WhiteArgs {
    /// What the record was found from: the images, and the certificate where it is named.
    fn source(&self, images: &str) -> String {
        match &self.certificate {
            Some(certificate) => format!("{images}; standard's certificate {certificate}"),
            None => images.to_owned(),
        }
    }
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
    if !(0.0..=10.0).contains(&args.incidence_std) {
        return Err(
            CliError::new(format!("--incidence-std is {}", args.incidence_std))
                .hint("it must be a number of degrees from 0 to 10"),
        );
    }
    if args.image.is_dir() {
        return of_session(args, context);
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
    let mut place = args.common.place(&rig, context)?;
    place.measurement.source = args.source(&args.image.display().to_string());
    let method = format!(
        "diffuse standard of reflectance {} ± {} at {} degrees",
        args.reflectance, args.reflectance_std, args.incidence
    );
    let values = LightsValues {
        irradiance_w_m2: found,
        lights: Vec::new(),
    };
    let kept = place.keep(values, &method, &[])?;
    let [red, green, blue] = found.map(|m| m.value);
    context.note(format_args!(
        "fits of later captures use an irradiance of {red:.6}, {green:.6}, {blue:.6} W/m², known \
         to {:.2}%",
        100.0 * found[0].std / found[0].value
    ));
    let report = WhiteReport {
        irradiance_w_m2: found,
        lights: &[],
    };
    args.common.show(&kept, &report)
}

/// Intensity and evenness of every light of a session, with the mean irradiance.
fn of_session(args: &WhiteArgs, context: &Context) -> Result<(), CliError> {
    let ranges = [
        ("--height", args.height, -1e4..=1e4),
        ("--direction-std", args.direction_std, 0.0..=0.2),
    ];
    for (name, value, range) in ranges {
        if !range.contains(&value) {
            return Err(CliError::new(format!("{name} is {value}")).hint(format!(
                "it must be from {} to {}",
                range.start(),
                range.end()
            )));
        }
    }
    // The session, and the bench with its measured lens and lights.
    let rig = args.common.rig.resolve(context)?;
    let mut session = session_images(&args.image)?;
    if session.config.name != rig.config.name {
        return Err(CliError::new(format!(
            "the session is of rig {}, the record would be of rig {}",
            session.config.name, rig.config.name
        ))
        .hint(format!(
            "name the session's rig: `--rig {}`",
            session.config.name
        )));
    }
    let read_back = session.places.clone();
    let records = BenchRecords::without_irradiance(&args.image)?;
    let geometry = records
        .apply(&session.config, &mut session.places, context)
        .geometry;
    let places = session.places.iter().zip(read_back);
    let lights: Vec<_> = places
        .map(|(&there, at)| (geometry.light(there), at))
        .collect();
    // The standard under every light.
    let camera = geometry.image_camera();
    let [width, height] = camera.resolution_px;
    let white = WhiteLights {
        camera: &camera,
        region: args.region.unwrap_or(Region {
            x: 0,
            y: 0,
            width,
            height,
        }),
        height_mm: args.height,
        standard: WhiteStandard {
            reflectance: Measured {
                value: args.reflectance,
                std: args.reflectance_std,
            },
            incidence_rad: 0.0,
            incidence_std_rad: args.incidence_std.to_radians(),
        },
        direction_std: args.direction_std,
        lights: &lights,
    };
    let found = white.measure(&session.captured).hint(HINT)?;
    let stated = geometry.light.irradiance_w_m2;
    let values = LightsValues {
        irradiance_w_m2: std::array::from_fn(|c| Measured {
            value: found.strength[c].value * stated[c],
            std: found.strength[c].std * stated[c],
        }),
        lights: found.lights,
    };
    let mut place = args.common.place(&rig, context)?;
    place.measurement.source = args.source(&format!("session {}", args.image.display()));
    let method = format!(
        "diffuse standard of reflectance {} ± {} under {} lights",
        args.reflectance,
        args.reflectance_std,
        values.lights.len()
    );
    let kept = place.keep(values.clone(), &method, &[])?;
    let green = || values.lights.iter().map(|light| light.relative[1]);
    let (low, high) = green().fold((f64::INFINITY, 0.0f64), |(low, high), m| {
        (low.min(m.value), high.max(m.value))
    });
    context.note(format_args!(
        "fits of later captures use the lights' intensities, from {low:.4} to {high:.4} of \
         their mean, known to {:.2}%, and by how unevenly each lights the sample",
        100.0 * green().map(|m| m.std / m.value).fold(0.0, f64::max)
    ));
    let report = WhiteReport {
        irradiance_w_m2: values.irradiance_w_m2,
        lights: &values.lights,
    };
    args.common.show(&kept, &report)
}
