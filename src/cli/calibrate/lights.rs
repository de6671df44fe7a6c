//! `rig calibrate lights`: directions of lights from mirror spheres.

use std::path::{Path, PathBuf};

use glam::DVec2;
use serde::Serialize;

use super::target::CommonArgs;
#[cfg(feature = "figures")]
use super::target::noted;
use crate::calibration::Library;
use crate::calibration::directions::DirectionsValues;
#[cfg(feature = "figures")]
use crate::calibration::figures;
use crate::calibration::mirror_sphere::lights::{
    DirectionsError, DirectionsRequest, MeasuredDirections, measure,
};
use crate::calibration::mirror_sphere::outline::Stated;
use crate::calibration::mirror_sphere::{Circle, Grey, Sphere, SphereError};
use crate::calibration::stage_directions::StageFitError;
use crate::cli::{CliError, Context};
use crate::config::RigConfig;
use crate::device::kinematics::Kinematics;
use crate::radiance_image::{RadianceImage, exr};
use crate::session::layout::CALIBRATION_FOLDER;
use crate::units::StageAngles;
use crate::workflow::{SessionImages, apply_lens, session_images};

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

/// The bench and the pictures of the sphere on it.
struct Pictures {
    config: RigConfig,
    angles: Vec<StageAngles>,
    images: Vec<RadianceImage>,
    source: String,
}

pub(super) fn run(args: &LightsArgs, context: &Context) -> Result<(), CliError> {
    // The images, and the bench with its measured lens.
    let rig = args.common.rig.resolve(context)?;
    let mut pictures = read(&args.input, &rig.config)?;
    let lens = match args.input.as_slice() {
        [root] if root.is_dir() => Library::Folder(root.join(CALIBRATION_FOLDER)).load(None)?,
        _ => Library::of_rig(&rig).load(rig.config.calibration.camera.as_deref())?,
    };
    if let Some(lens) = &lens {
        apply_lens(lens, &mut pictures.config.geometry, context);
    }
    let geometry = &pictures.config.geometry;
    let stated = Stated {
        radius_mm: args.radius,
        height_mm: args.height,
    };
    let images: Vec<Grey> = pictures.images.iter().map(Grey::of).collect();
    let camera = &geometry.image_camera();
    let outline = match &args.outline {
        Some(path) => Some(Grey::of(
            &exr::read_sized(path, camera.resolution_px)?.image,
        )),
        None => None,
    };
    // Spheres and lights.
    let found = measure(&DirectionsRequest {
        geometry,
        kinematics: &pictures.config.stage.kinematics(),
        angles: &pictures.angles,
        images: &images,
        outline: outline.as_ref(),
        stated,
        near: &args.near,
        spheres: args.spheres as usize,
    })
    .map_err(advised)?;
    #[cfg_attr(
        not(feature = "figures"),
        expect(unused_variables, reason = "drawn alone")
    )]
    let MeasuredDirections {
        spheres,
        lights,
        stage,
        values,
    } = found;
    for sphere in &spheres {
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
    // The record.
    let mut place = args.common.place(&rig, context)?;
    place.measurement.source = pictures.source;
    let method = format!(
        "highlights of {} lights on {} mirror sphere(s) of radius {} mm",
        lights.len(),
        spheres.len(),
        args.radius
    );
    let kept = place.keep(values.clone(), &method, &[])?;
    #[cfg(feature = "figures")]
    let kept = {
        let angles = &pictures.angles;
        let figure = figures::light_directions(geometry, angles, &lights, stage.as_ref());
        noted(place.draw(kept, &figure)?, context)
    };
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
    let report = LightsReport {
        spheres: spheres.iter().map(sphere_report).collect(),
        values: &values,
    };
    args.common.show(&kept, &report)
}

fn sphere_report(sphere: &Sphere) -> SphereReport {
    SphereReport {
        middle_px: sphere.circle.centre_px.to_array(),
        radius_px: sphere.circle.radius_px,
        radius_mm: sphere.radius_mm,
        blur_px: sphere.blur_px,
    }
}

fn read(input: &[PathBuf], rig: &RigConfig) -> Result<Pictures, CliError> {
    match input {
        [root] if root.is_dir() => of_session(root, rig),
        files => of_files(files, rig),
    }
}

fn of_session(root: &Path, rig: &RigConfig) -> Result<Pictures, CliError> {
    let SessionImages {
        session,
        config,
        places,
        captured,
    } = session_images(root)?;
    let record = session.record();
    if config.name != rig.name {
        return Err(CliError::new(format!(
            "the session is of rig {}, the record would be of rig {}",
            config.name, rig.name
        ))
        .hint(format!("name the session's rig: `--rig {}`", record.rig)));
    }
    let name = root.file_name().unwrap_or_default().to_string_lossy();
    Ok(Pictures {
        config,
        angles: places,
        images: captured,
        source: format!("session {name}"),
    })
}

fn of_files(files: &[PathBuf], rig: &RigConfig) -> Result<Pictures, CliError> {
    let Kinematics::FixedLights(lights) = rig.stage.kinematics() else {
        return Err(
            CliError::new("images alone do not state the angles of a stage with axes")
                .hint("capture the sphere with `rig capture` and name the session"),
        );
    };
    if files.len() != lights.directions.len() {
        return Err(CliError::new(format!(
            "{} images were named, the rig has {} lights",
            files.len(),
            lights.directions.len()
        ))
        .hint("name one image per light, in the order of the rig file's [[stage.light]] tables"));
    }
    let size = rig.geometry.image_camera().resolution_px;
    let mut images = Vec::new();
    for file in files {
        images.push(exr::read_sized(file, size)?.image);
    }
    let names: Vec<_> = files.iter().map(|f| f.display().to_string()).collect();
    Ok(Pictures {
        config: rig.clone(),
        angles: lights.directions.clone(),
        images,
        source: names.join(", "),
    })
}

/// What to do about images that do not determine the lights.
fn advised(error: DirectionsError) -> CliError {
    match error {
        DirectionsError::Sphere(error) => sphere_advised(error),
        DirectionsError::Stage(error) => stage_advised(error),
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
