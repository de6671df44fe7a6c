//! `rig design`: which sample, tilt of the camera and lamps tell most of an unknown material.

use std::path::{Path, PathBuf};

use serde_json::json;

use super::number::within;
use super::output::{write_json, write_path};
use super::progress::Counting;
use super::rig_choice::RigArg;
use super::table::{Table, percent};
use super::{CliError, Context};
use crate::brdf::nbrdf;
use crate::config::scene::SceneFile;
use crate::design::{self, Design, DesignError, DesignRequest, Lamp, Limits, Reach};
use crate::geometry::shapes::Form;
use crate::inverse::expected_error::{BANDS, BANDS_DEG, ExpectedError, USUAL};
use crate::out;

/// Designs a sample with its camera and lamps, or tells what given ones are expected to leave open
///
/// What counts is the environment error that a fit is expected to have, over some embedded materials.
#[derive(clap::Args, Debug)]
#[command(group(clap::ArgGroup::new("task").required(true).args(["out", "evaluate", "lights_only"])))]
pub struct DesignArgs {
    /// Folder for the design: scene, lamps (`rig capture --lights FILE`), surface (PLY), what to make (STL), drawing (SVG), figures (JSON)
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Instead: the expected errors of these scene files
    #[arg(long, value_name = "SCENE", num_args = 1..)]
    evaluate: Vec<PathBuf>,
    /// Instead: the best lamps for the sample and camera of this scene file, one AZ,EL a line
    #[arg(long, value_name = "SCENE")]
    lights_only: Option<PathBuf>,
    /// Lamps, 1 to 12
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u64).range(1..=12))]
    images: u64,
    /// Turned about its axis, or drawn along a line: sheets can be pressed over the latter alone
    #[arg(long, value_name = "FORM", default_value = "revolved", value_parser = design::form)]
    form: Form,
    /// From the sample's axis to its rim, mm, 1 to 1000
    #[arg(long, value_name = "MM", default_value_t = Limits::default().radius_mm, value_parser = within(1.0, 1e3))]
    radius: f64,
    /// Steepest slope of the sample, degrees, 5 to 85
    #[arg(long, value_name = "DEG", default_value_t = Limits::default().max_slope_deg, value_parser = within(5.0, 85.0))]
    max_slope: f64,
    /// Smallest radius of its profile on the hollow side, mm, 0.01 to 100: of the tool's tip, or to which a sheet bends
    #[arg(long, value_name = "MM", default_value_t = Limits::default().min_radius_mm, value_parser = within(0.01, 100.0))]
    min_radius: f64,
    /// Thickness of the paint or of the sheet, mm, 0 to 100
    #[arg(long, value_name = "MM", default_value_t = Limits::default().thickness_mm, value_parser = within(0.0, 100.0))]
    thickness: f64,
    /// How exactly it is made and placed, standard deviations: surface and place, slope, turn and lamps
    #[arg(long, value_name = "MM,DEG", default_value_t = design::Tolerance::default(), value_parser = design::Tolerance::parse)]
    tolerance: design::Tolerance,
    /// Depth that the camera sees sharp, mm, 0.1 to 1000
    #[arg(long, value_name = "MM", default_value_t = Limits::default().depth_of_field_mm, value_parser = within(0.1, 1e3))]
    depth_of_field: f64,
    /// Lamps stand where the stage of this rig file reaches, past the camera's body
    #[arg(long, value_name = "RIG")]
    rig: Option<String>,
    /// Angle of the camera from the sample's axis, or LOW:HIGH, degrees, 0 to 75 (default 0:60; with --rig as it stands)
    #[arg(long, value_name = "DEG", value_parser = design::tilt_range)]
    camera_tilt: Option<[f64; 2]>,
    /// Lamps stand no lower than this over the rim, degrees, -85 to 80 (default 15 without --rig)
    #[arg(long, value_name = "DEG", allow_negative_numbers = true, value_parser = within(-85.0, 80.0))]
    least_elevation: Option<f64>,
    /// Lamps stand no nearer to the camera's axis than this, degrees, 0 to 60 (default 20 without --rig)
    #[arg(long, value_name = "DEG", value_parser = within(0.0, 60.0))]
    clearance: Option<f64>,
    /// Embedded materials to average over
    #[arg(long, value_name = "NAME,…", value_delimiter = ',', default_values_t = USUAL.map(str::to_owned))]
    materials: Vec<String>,
    /// Rounds of the search, 1 to 100
    #[arg(long, value_name = "N", default_value_t = DesignRequest::default().rounds, value_parser = clap::value_parser!(u32).range(1..=100))]
    rounds: u32,
    /// Seed of the search and its light paths
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// The figures as JSON
    #[arg(long)]
    json: bool,
}

/// `rig design`.
pub fn run(args: &DesignArgs, context: &Context) -> Result<(), CliError> {
    let rig = RigArg {
        rig: args.rig.clone(),
    };
    let reach = match rig.rig {
        Some(_) => Reach::of_rig(&rig.resolve(context)?.config),
        None => Reach::default(),
    };
    let request = DesignRequest {
        images: args.images as usize,
        limits: Limits {
            form: args.form,
            thickness_mm: args.thickness,
            radius_mm: args.radius,
            max_slope_deg: args.max_slope,
            min_radius_mm: args.min_radius,
            depth_of_field_mm: args.depth_of_field,
        },
        tilt_deg: args.camera_tilt.unwrap_or_else(|| reach.tilts_deg()),
        reach: Reach {
            least_elevation_deg: args.least_elevation.unwrap_or(reach.least_elevation_deg),
            clearance_deg: args.clearance.unwrap_or(reach.clearance_deg),
            ..reach
        },
        tolerance: args.tolerance,
        materials: args.materials.clone(),
        rounds: args.rounds,
        seed: args.seed,
        ..DesignRequest::default()
    };
    match (&args.lights_only, &args.out) {
        (Some(file), _) => lights_only(file, &request, args.json),
        (_, Some(folder)) => search(folder, &request, args.json, context),
        _ => evaluate(&args.evaluate, &request, args.json),
    }
}

fn search(
    folder: &Path,
    request: &DesignRequest,
    json: bool,
    context: &Context,
) -> Result<(), CliError> {
    let bar = context.bar(u64::from(request.rounds * request.population), "designs");
    let found = design::design(request, &Counting(&bar));
    bar.finish_and_clear();
    let found = found.map_err(advise)?;
    let written = design::write(folder, &found, request)?;
    let all: Vec<&Design> = std::iter::once(&found.design)
        .chain(&found.others)
        .collect();
    if json {
        return write_json(&json!({ "files": written, "designs": all }));
    }
    let headings = "design| tilt| expected| held out| as made|lamps (azimuth,elevation)";
    let mut table = Table::new(&headings.split('|').collect::<Vec<_>>());
    for design in all {
        let lamps: Vec<_> = design.lights.iter().map(Lamp::to_string).collect();
        table.row([
            design.name.clone(),
            format!("{:.0}°", design.camera_tilt_deg),
            percent(design.error),
            percent(design.error_held_out),
            percent(design.error_as_made),
            lamps.join(" "),
        ]);
    }
    table.print()?;
    written.iter().try_for_each(|path| write_path(path))
}

fn evaluate(files: &[PathBuf], request: &DesignRequest, json: bool) -> Result<(), CliError> {
    let materials = design::subjects(&request.materials).map_err(advise)?;
    let mut all = Vec::new();
    for file in files {
        let scene = SceneFile::load(file)?.scene()?;
        all.push((file, design::evaluate(scene, &materials, request.seed)?));
    }
    if json {
        let of = |(file, errors): &(&PathBuf, Vec<ExpectedError>)| json!({ "scene": file, "error": design::geometric_mean(errors), "materials": errors });
        let scenes: Vec<_> = all.iter().map(of).collect();
        return write_json(&json!({ "theta_d_bands_deg": BANDS_DEG, "scenes": scenes }));
    }
    let bands = (0..BANDS).map(|k| format!(" θd {}–{}°", BANDS_DEG[k], BANDS_DEG[k + 1]));
    let headings = ["scene", "material", " expected"].map(str::to_owned);
    let headings: Vec<String> = headings.into_iter().chain(bands).collect();
    let mut table = Table::new(&headings.iter().map(String::as_str).collect::<Vec<_>>());
    for (file, errors) in &all {
        let shown = file.display().to_string();
        table.row([
            shown.clone(),
            "geometric mean".to_owned(),
            percent(design::geometric_mean(errors)),
        ]);
        for of in errors {
            let first = [shown.clone(), of.material.clone(), percent(of.error)];
            table.row(first.into_iter().chain(of.by_theta_d.map(percent)));
        }
    }
    table.print()
}

fn lights_only(file: &Path, request: &DesignRequest, json: bool) -> Result<(), CliError> {
    let scene = SceneFile::load(file)?.scene()?;
    let chosen = design::lights_only(scene, request).map_err(advise)?;
    if json {
        return write_json(&json!({ "scene": file, "lights": chosen }));
    }
    for lamp in &chosen {
        let angles = lamp.light;
        let expected = percent(lamp.error);
        out!(
            "{},{}  # expected error {expected}",
            angles.azimuth_deg,
            angles.elevation_deg
        )?;
    }
    Ok(())
}

fn advise(error: DesignError) -> CliError {
    let hint = match error {
        DesignError::Material { .. } => format!("known are {}", nbrdf::NAMES.join(", ")),
        DesignError::TooFewLamps { .. } => {
            "lower --least-elevation, --clearance or --images".into()
        }
        DesignError::TooDeep { .. } => {
            "lower --camera-tilt or --radius, or give the lens more --depth-of-field".into()
        }
        _ => return error.into(),
    };
    CliError::from(error).hint(hint)
}
