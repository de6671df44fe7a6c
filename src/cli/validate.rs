//! `rig validate`: does a fit predict images that it has not seen?

use std::path::PathBuf;

use super::fit_progress::FitProgress;
use super::table::Table;
use super::{CliError, Context, output};
use crate::workflow::{
    FitRequest, HoldOut, LightScore, RegionScore, Validated, validate_images, validate_session,
};

/// Fits a part of the lights and predicts the images of the rest
///
/// Nothing is written; a session is only read.
#[derive(clap::Args, Debug)]
pub struct ValidateArgs {
    /// The session's folder
    #[arg(value_name = "SESSION", required_unless_present = "scene", conflicts_with_all = ["scene", "image"])]
    session: Option<PathBuf>,
    /// Scene file: camera, lights and the sample's shape
    #[arg(long, value_name = "S", requires = "image")]
    scene: Option<PathBuf>,
    /// Image (EXR), one per light of the scene, in its order
    #[arg(long, value_name = "EXR", num_args = 1..)]
    image: Vec<PathBuf>,
    /// Lights that are fitted, from 0: 0,2,5; all others are predicted
    #[arg(
        long,
        value_name = "LIGHTS",
        value_delimiter = ',',
        conflicts_with = "hold_out"
    )]
    fit_lights: Option<Vec<usize>>,
    /// Lights that are predicted, evenly spaced in their order (default: a quarter, one at least,
    /// so that the fit keeps most of its images)
    #[arg(long, value_name = "N")]
    hold_out: Option<usize>,
    /// The result as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    fit: FitRequest,
}

/// `rig validate`.
pub fn run(args: &ValidateArgs, context: &Context) -> Result<(), CliError> {
    let hold_out = match (&args.fit_lights, args.hold_out) {
        (Some(lights), _) => HoldOut::Fitted(lights.clone()),
        (None, Some(count)) => HoldOut::Count(count),
        (None, None) => HoldOut::default(),
    };
    let progress = FitProgress::new(context, None);
    let validated = validated(args, &hold_out, &progress)?;
    progress.finish(&validated.fit);
    if args.json {
        return output::write_json(&validated.validation);
    }
    print(&validated, context)
}

fn validated(
    args: &ValidateArgs,
    hold_out: &HoldOut,
    progress: &FitProgress<'_>,
) -> Result<Validated, CliError> {
    let request = &args.fit;
    match (&args.session, &args.scene) {
        (Some(session), _) => Ok(validate_session(session, hold_out, request, progress)?),
        (None, Some(scene)) => Ok(validate_images(
            scene,
            &args.image,
            hold_out,
            request,
            progress,
        )?),
        (None, None) => Err(CliError::new("neither a session nor a scene is given")),
    }
}

/// The errors as a table.
fn print(validated: &Validated, context: &Context) -> Result<(), CliError> {
    let found = &validated.validation;
    let numbers: Vec<String> = found
        .fitted_lights
        .iter()
        .map(ToString::to_string)
        .collect();
    context.note(format!(
        "lights {} were fitted, the others predicted",
        numbers.join(", ")
    ));
    let mut table = Table::new(&[
        "light",
        " error",
        " θh > 15°",
        " θh ≤ 15°",
        " noise",
        " Lambertian",
        " neighbours",
        " in 95% interval",
        " half width",
        " pixels",
        " left out",
    ]);
    for score in &found.lights {
        table.row(cells(score.light.to_string(), score));
    }
    table.row(cells("all".to_owned(), &found.all));
    table.print()
}

fn cells(name: String, score: &LightScore) -> [String; 11] {
    let percent =
        |value: Option<f64>| value.map_or(String::new(), |v| format!("{:.1}%", 100.0 * v));
    let RegionScore {
        pixels,
        relative_rms,
        noise,
        lambertian,
        neighbours,
    } = score.overall;
    let left_out = score.left_out;
    [
        name,
        percent(relative_rms),
        percent(score.away.relative_rms),
        percent(score.highlight.relative_rms),
        percent(noise),
        percent(lambertian),
        percent(neighbours),
        percent(score.coverage),
        percent(score.median_half_width),
        pixels.to_string(),
        (left_out.masked + left_out.invalid + left_out.unlit).to_string(),
    ]
}
