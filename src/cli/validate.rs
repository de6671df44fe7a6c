//! `rig validate`: does a fit predict images that it has not seen?

use std::num::NonZeroUsize;
use std::path::PathBuf;

use super::fit_progress::FitProgress;
use super::table::Table;
use super::{CliError, Context, fit, output};
use crate::session::fit_record;
use crate::session::validation::HEADINGS;
use crate::workflow::{
    FitRequest, HoldOut, Validated, Validation, WorkflowError, check_keeps_validations,
    keep_validation, validate_images, validate_session, write_validation,
};

/// Fits a part of the lights and predicts the images of the rest
///
/// A session keeps the result, with a picture of each predicted light, and its report shows it.
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
    /// Lights that are fitted, from 1: 1,3,6; all others are predicted
    #[arg(
        long,
        value_name = "LIGHTS",
        value_delimiter = ',',
        conflicts_with = "hold_out"
    )]
    fit_lights: Option<Vec<NonZeroUsize>>,
    /// Lights that are predicted, evenly spaced in their order (default: a quarter, one at least,
    /// so that the fit keeps most of its images)
    #[arg(long, value_name = "N")]
    hold_out: Option<usize>,
    /// Folder for the result and a picture of each predicted light; it must not exist or be empty.
    /// With SESSION, the result goes there instead of into the session, which is only read
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// The result as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    fit: FitRequest,
}

/// `rig validate`.
pub fn run(args: &ValidateArgs, context: &Context) -> Result<(), CliError> {
    let hold_out = match (&args.fit_lights, args.hold_out) {
        (Some(lights), _) => HoldOut::Fitted(lights.iter().map(|light| light.get() - 1).collect()),
        (None, Some(count)) => HoldOut::Count(count),
        (None, None) => HoldOut::default(),
    };
    // Whether it can be kept, before what may take hours.
    let kept_in = args.session.as_ref().filter(|_| args.out.is_none());
    if let Some(out) = &args.out {
        fit_record::check_folder(out).map_err(WorkflowError::from)?;
    }
    if let Some(session) = kept_in {
        let keeps = check_keeps_validations(session);
        keeps.map_err(|error| fit::elsewhere("validate", session, error))?;
    }
    let progress = FitProgress::new(context, None);
    let validated = validated(args, &hold_out, &progress)?;
    progress.finish(&validated.fit);

    // Where it is kept.
    if let Some(out) = &args.out {
        write_validation(out, &validated)?;
        context.note(format!("validation: {}", out.display()));
    }
    if let Some(session) = kept_in {
        let folder = keep_validation(session, &validated)?;
        context.note(format!("validation: {}", folder.display()));
        fit::report_anew(session, context);
    }
    if args.json {
        return output::write_json(&validated.validation);
    }
    print(&validated.validation, context)
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
fn print(found: &Validation, context: &Context) -> Result<(), CliError> {
    context.note(found.division());
    let mut headings = HEADINGS.map(|heading| format!(" {heading}"));
    headings[0] = HEADINGS[0].to_owned();
    let mut table = Table::new(&headings.each_ref().map(String::as_str));
    found.table().into_iter().for_each(|row| table.row(row));
    table.print()
}
