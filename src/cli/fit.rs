//! `rig fit`: weights and error bars from images.

use std::path::{Path, PathBuf};

use super::fit_progress::FitProgress;
use super::{CliError, Context, HintExt, output};
use crate::capture::Progress;
use crate::capture::event_lines::EventLines;
use crate::session::SessionError;
use crate::session::fit_record::Verdict;
use crate::workflow::{
    FitOutcome, FitRequest, ImageFit, WorkflowError, fit_images, fit_session, fit_session_into,
};

/// Fits a BRDF to a session, or to images of a described scene
///
/// A session's report.html is written anew and shows this fit.
#[derive(clap::Args, Debug)]
pub struct FitCommandArgs {
    /// The session's folder
    #[arg(value_name = "SESSION", required_unless_present = "scene", conflicts_with_all = ["scene", "image"])]
    session: Option<PathBuf>,
    /// Scene file: camera, lights and the sample's shape
    #[arg(long, value_name = "S", requires = "image", requires = "out")]
    scene: Option<PathBuf>,
    /// Image (EXR: R, G, B and, where known, var.R, var.G, var.B), one per light of the scene, in its order;
    /// FILE:NAME names one of several parts or layers
    #[arg(long, value_name = "EXR", num_args = 1..)]
    image: Vec<PathBuf>,
    /// Folder for the result; it must not exist or be empty. With SESSION, the fit goes there
    /// instead of into the session, which is only read
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Record of the sample's pose, by `rig calibrate pose` (default: the session's copy, if
    /// its rig file named one); its covariance replaces rotation_deg and translation_mm
    #[arg(long, value_name = "RECORD", conflicts_with = "scene")]
    pose: Option<PathBuf>,
    /// The result as JSON
    #[arg(long)]
    json: bool,
    /// Each event as a JSON line on stdout, for other programs, instead of the path
    #[arg(long, conflicts_with = "json")]
    events: bool,
    #[command(flatten)]
    fit: FitRequest,
}

/// `rig fit`.
pub fn run(args: &FitCommandArgs, context: &Context) -> Result<(), CliError> {
    let lines = args.events.then(EventLines::start).transpose()?;
    let outcome = reported(lines.as_ref(), || {
        fit_what_is_named(args, context, lines.as_ref())
    })?;
    // The session's report is of its latest fit.
    let report = match (&args.session, &args.out) {
        (Some(session), None) => report_anew(session, context),
        _ => None,
    };
    if let Some(lines) = &lines {
        lines.send(&fitted(&outcome, report.as_deref()));
        return Ok(());
    }
    print(args, &outcome)
}

/// The outcome of `fit`, whose failure is an event as well.
fn reported<T>(
    lines: Option<&EventLines>,
    fit: impl FnOnce() -> Result<T, CliError>,
) -> Result<T, CliError> {
    fit().inspect_err(|error| {
        if let Some(lines) = lines {
            lines.fit_failed(error.fact().to_owned(), error.advice().map(str::to_owned));
        }
    })
}

fn fitted(outcome: &FitOutcome, report: Option<&Path>) -> Progress {
    let text = |path: &Path| path.to_string_lossy().into_owned();
    Progress::Fitted {
        verdict: outcome.record.verdict(),
        fit: text(&outcome.folder),
        report: report.map(text),
    }
}

fn fit_what_is_named(
    args: &FitCommandArgs,
    context: &Context,
    lines: Option<&EventLines>,
) -> Result<FitOutcome, CliError> {
    let request = FitRequest {
        pose: args.pose.clone(),
        ..args.fit.clone()
    };
    match (&args.session, &args.scene, &args.out) {
        (Some(session), _, out) => fit(session, out.as_deref(), &request, context, lines),
        (None, Some(scene), Some(out)) => {
            let images = &args.image;
            let files = ImageFit { scene, images, out };
            let progress = FitProgress::new(context, lines);
            let outcome = fit_images(files, &request, &progress)?;
            progress.finish(&outcome.record);
            Ok(outcome)
        }
        _ => Err(CliError::new(
            "neither a session nor a scene with --out is given",
        )),
    }
}

/// Prints the result: its folder, or all of it.
fn print(args: &FitCommandArgs, outcome: &FitOutcome) -> Result<(), CliError> {
    if !args.json {
        return output::write_path(&outcome.folder);
    }
    let record = &outcome.record;
    output::write_json(&serde_json::json!({
        "fit": outcome.folder.display().to_string(),
        "dictionary": record.dictionary,
        "atoms": record.atoms,
        "weights": record.weights,
        "weight_deviations": record.weight_deviations,
        "verdict": record.verdict(),
        "reduced_chi_square": record.reduced_chi_square,
        "discrepancy": record.discrepancy.as_ref().map_or(0.0, |d| d.amplitude),
        "loss": record.loss,
        "termination": record.termination,
        "score": record.score,
        "timings": record.timings,
        "warnings": record.warnings,
        "remarks": record.remarks,
        "bench": record.bench,
    }))
}

/// Fits a session, into it or into a folder, and prints the verdict.
fn fit(
    session: &Path,
    out: Option<&Path>,
    request: &FitRequest,
    context: &Context,
    lines: Option<&EventLines>,
) -> Result<FitOutcome, CliError> {
    let progress = FitProgress::new(context, lines);
    let outcome = match out {
        None => {
            let fitted = fit_session(session, request, &progress);
            fitted.map_err(|error| elsewhere("fit", session, error))
        }
        Some(out) => Ok(fit_session_into(session, out, request, &progress)?),
    }?;
    progress.finish(&outcome.record);
    Ok(outcome)
}

/// The error, with the way out where it is that nothing can be written in the session.
/// `command` is `fit` or another that takes SESSION and --out.
pub(super) fn elsewhere(command: &str, session: &Path, error: WorkflowError) -> CliError {
    use std::io::ErrorKind::{PermissionDenied, ReadOnlyFilesystem};
    let is_closed = matches!(
        &error,
        WorkflowError::Session(SessionError::Io { operation, source, .. })
            if *operation != "read"
                && matches!(source.kind(), ReadOnlyFilesystem | PermissionDenied)
    );
    let error = CliError::from(error);
    match is_closed {
        true => error.hint(format!(
            "`rig {command} {} --out DIR` only reads the session and writes the result elsewhere",
            session.display()
        )),
        false => error,
    }
}

/// Fits a captured session with the rig file's choices, writes its report, returns the verdict.
pub(super) fn fit_and_report(
    session: &Path,
    context: &Context,
    lines: Option<&EventLines>,
) -> Result<Verdict, CliError> {
    let again = format!(
        "the capture is complete; `rig fit {}` fits it",
        session.display()
    );
    let (outcome, report) = reported(lines, || {
        let outcome = fit(session, None, &FitRequest::default(), context, lines).hint(&again)?;
        context.note(format!("fit: {}", outcome.folder.display()));
        let report = report(session, context).hint(&again)?;
        Ok((outcome, report))
    })?;
    if let Some(lines) = lines {
        lines.send(&fitted(&outcome, report.as_deref()));
    }
    Ok(outcome.record.verdict())
}

/// Writes the report of a result that is kept already: a warning where that fails.
pub(super) fn report_anew(session: &Path, context: &Context) -> Option<PathBuf> {
    report(session, context).unwrap_or_else(|error| {
        context.warn(format!("the report was not written: {}", error.fact()));
        None
    })
}

/// Writes the report; where this program can.
#[cfg(feature = "reports")]
fn report(session: &Path, context: &Context) -> Result<Option<PathBuf>, CliError> {
    let request = crate::report::ReportRequest::of(session);
    let written = crate::report::write(&request)?;
    context.note(format!("report: {}", written.path.display()));
    Ok(Some(written.path))
}

#[cfg(not(feature = "reports"))]
fn report(_: &Path, _: &Context) -> Result<Option<PathBuf>, CliError> {
    Ok(None)
}
