//! `rig calibrate lights`: directions of lights from mirror spheres.

use std::path::PathBuf;

use glam::DVec2;
use serde::Serialize;

use super::target::{CommonArgs, noted};
use crate::calibrating::{CalibratingError, SpheresRequest};
use crate::calibration::directions::DirectionsValues;
use crate::calibration::mirror_sphere::lights::DirectionsError;
use crate::calibration::mirror_sphere::outline::Stated;
use crate::calibration::mirror_sphere::{Circle, Sphere, SphereError};
use crate::calibration::stage_directions::StageFitError;
use crate::cli::{CliError, Context};

#[derive(clap::Args, Debug)]
pub(super) struct LightsArgs {
    #[command(flatten)]
    common: CommonArgs,
    /// Session captured with the sphere in place of the sample; or, of a bench with fixed
    /// lights, one merged image (OpenEXR) per light, in the rig file's order
    #[arg(value_name = "SESSION|EXR", required = true)]
    input: Vec<PathBuf>,
    /// Radius of the sphere, by its certificate or a calliper (mm)
    #[arg(long, value_name = "MM")]
    radius: f64,
    /// How many equal spheres are in the image; two also give the lamp's distance
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=2))]
    spheres: u32,
    /// Height of the spheres' middles above the sample's datum (mm), which a telecentric
    /// camera does not see
    #[arg(
        long,
        value_name = "MM",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    height: f64,
    /// Roughly where a sphere is in the image: middle and radius (pixels); searched if not
    /// given
    #[arg(long, value_name = "X,Y,R", value_parser = parse_circle)]
    near: Vec<Circle>,
    /// Merged image in which the outline is found (default: all lights' images, each
    /// on the side that its light shines on)
    #[arg(long, value_name = "EXR")]
    outline: Option<PathBuf>,
}

fn parse_circle(text: &str) -> Result<Circle, String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[x, y, radius_px]) if radius_px > 0.0 => Ok(Circle {
            centre_px: DVec2::new(x, y),
            radius_px,
        }),
        _ => Err("three numbers: column and row of the middle, radius above 0".into()),
    }
}

#[derive(Serialize)]
struct SphereReport {
    middle_px: [f64; 2],
    radius_px: f64,
    radius_mm: f64,
    blur_px: f64,
}

#[derive(Serialize)]
struct LightsReport<'a> {
    spheres: Vec<SphereReport>,
    values: &'a DirectionsValues,
}

pub(super) fn run(args: &LightsArgs, context: &Context) -> Result<(), CliError> {
    let rig = args.common.rig.resolve(context)?;
    let request = SpheresRequest {
        rig: &rig,
        input: &args.input,
        outline: args.outline.as_deref(),
        stated: Stated {
            radius_mm: args.radius,
            height_mm: args.height,
        },
        near: &args.near,
        spheres: args.spheres as usize,
    };
    let measured = request.measure(context).map_err(advised)?;
    let spheres = &measured.found.spheres;
    for sphere in spheres {
        let circle = sphere.circle;
        context.note(format_args!(
            "sphere at ({:.2}, {:.2}), radius {:.2} pixels, {:.4} mm; blur {:.2} pixels",
            circle.centre_px.x,
            circle.centre_px.y,
            circle.radius_px,
            sphere.radius_mm,
            sphere.blur_px
        ));
    }
    let place = args.common.place(&rig, context)?;
    let kept = noted(measured.keep(place)?, context);
    let values = &measured.found.values;
    if let Some(stage) = &values.stage {
        let [x, y, z] = stage.rotation_deg;
        context.note(format_args!(
            "the stage is turned by ({x:.3}, {y:.3}, {z:.3})° against the sample, its elevations \
             count {:+.3}°; lights scatter by {:.3}° about that",
            stage.elevation_offset_deg, stage.scatter_deg
        ));
    }
    if let Some(distance) = values.distance_mm {
        context.note(format_args!(
            "the lamp is {:.1} ± {:.1} mm away",
            distance.value, distance.std
        ));
    }
    let spheres = spheres.iter().map(sphere_report).collect();
    args.common.show(&kept, &LightsReport { spheres, values })
}

fn sphere_report(sphere: &Sphere) -> SphereReport {
    SphereReport {
        middle_px: sphere.circle.centre_px.to_array(),
        radius_px: sphere.circle.radius_px,
        radius_mm: sphere.radius_mm,
        blur_px: sphere.blur_px,
    }
}

/// What to do about images that do not determine the lights.
fn advised(error: CalibratingError) -> CliError {
    match error {
        CalibratingError::Lights(DirectionsError::Sphere(error)) => sphere_advised(error),
        CalibratingError::Lights(DirectionsError::Stage(error)) => stage_advised(error),
        error => super::target::advised(error),
    }
}

fn sphere_advised(error: SphereError) -> CliError {
    use SphereError::*;
    let hint = match &error {
        Impossible { .. } => "correct the value",
        Size { .. } => "the images must be of the rig file's camera, without cropping",
        NoOutline { .. } => {
            "put a background behind the sphere that is clearly darker or brighter than its rim (a polished ball into a hole of a white card, halfway), check --radius and the camera's scale, or say with --near X,Y,R where the sphere is"
        }
        OutsideView { .. } => {
            "move the sphere or the camera until the whole sphere is in the image"
        }
        Unfitted { .. } => {
            "give the rim more contrast, or a better start with --near X,Y,R; an image of the unlit sphere before a bright card can be named with --outline"
        }
        Radius { .. } => {
            "check --radius (not the diameter), and the camera's extent_mm in the rig file"
        }
        NoHighlight { .. } => {
            "the sphere must be glossy, and no light may be hidden from it by the camera or its own height; leave such lights out of the capture"
        }
        Saturated { .. } => {
            "capture with shorter exposures: a lower capture.shortest_ms or a weaker lamp; a rougher sphere also has dimmer highlights"
        }
        TwoHighlights { .. } => {
            "only one lamp may light the sphere: cover windows, screens and mirrored parts of the bench"
        }
        NotOneLamp { .. } => {
            "check that both spheres have the stated radius, stand still, and are lit by the same lamp"
        }
    };
    CliError::new(&error).hint(format!("{hint}; nothing was kept"))
}

fn stage_advised(error: StageFitError) -> CliError {
    let hint = match &error {
        StageFitError::TooFew { .. } => {
            "capture the sphere under more lights: `rig capture --lights 12`"
        }
        StageFitError::OtherStage { .. } => {
            "check the sense of the stage's axes and geometry.sample_from_stage in the rig file, and that the sphere did not move"
        }
    };
    CliError::new(&error).hint(format!("{hint}; nothing was kept"))
}
