//! `rig export`: the fitted BRDF in files that other programs read.

use std::path::PathBuf;

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};

use super::{CliError, Context, as_model, output};
use crate::export::{self, FORMATS, Format};
use crate::session::Session;
use crate::session::fit_record::{self, FitRecord, FitRecordError, Verdict};
use crate::session::layout::{FITS_FOLDER, is_sample_name};
use crate::workflow::{StatedResult, StatedResultError};

/// Writes a fitted BRDF for other programs.
#[derive(clap::Args, Debug)]
pub struct ExportArgs {
    /// A fit's folder, or a session (its latest fit)
    #[arg(value_name = "DIR")]
    dir: PathBuf,
    /// Of a session: which fit, by its number in `fits/`; the latest if not given
    #[arg(long, value_name = "N")]
    fit: Option<u32>,
    /// What to write
    #[arg(long, value_parser = formats())]
    format: Format,
    /// The file to write; if not given the sample's name with the format's usual ending, of a
    /// fit outside a session `brdf`
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Of openpbr, blender and gltf: what the material is called; the sample's name if not given,
    /// of a fit outside a session the file's
    #[arg(long)]
    name: Option<String>,
    /// Of these three: also tints and layers that bring the model hardly nearer
    #[arg(long)]
    closest: bool,
}

/// The names of the formats, with what they write.
fn formats() -> impl TypedValueParser<Value = Format> {
    let names = FORMATS
        .iter()
        .map(|format| PossibleValue::new(format.name).help(format.about));
    PossibleValuesParser::new(names).map(|name| Format::named(&name).expect("one of them"))
}

/// What to do where a session has no such fit.
const LATEST_FIT: &str = "leave --fit out to take the latest";

/// `rig export`.
pub fn run(args: &ExportArgs, context: &Context) -> Result<(), CliError> {
    let format = args.format;
    let to = |sample: Option<&str>| {
        let usual = || format.usual_name(sample.unwrap_or("brdf")).into();
        args.out.clone().unwrap_or_else(usual)
    };
    if let Some(out) = &args.out {
        output::check_ending(out, format.ending)?;
    }
    if format.needs_no_session() {
        let (record, sample) = record(args)?;
        let path = to(sample.as_deref());
        warn_of(&record, context);
        let name = args.name.as_deref().or(sample.as_deref());
        as_model::make(&path, context, |progress| {
            export::export_as(&record, name, args.closest, progress, &format, &path)
        })
    } else {
        let result = StatedResult::load(&args.dir, args.fit).map_err(stated_result_error)?;
        let path = to(called(&result.session).as_deref());
        warn_of(&result.record, context);
        let lacking = result.config.lab.missing();
        if !lacking.is_empty() {
            context.note(format!(
                "\"{}\" in the file: {}; state them in [lab] of the rig file before the capture",
                export::birdf::NOT_STATED,
                lacking.join(", ")
            ));
        }
        as_model::make(&path, context, |_| {
            export::export_session(&result, &format, &path)
        })
    }
}

/// The fit that is asked for, and the name of its sample where it belongs to a session.
fn record(args: &ExportArgs) -> Result<(FitRecord, Option<String>), CliError> {
    let dir = match args.fit {
        Some(number) => &args.dir.join(FITS_FOLDER).join(number.to_string()),
        None => &args.dir,
    };
    let found = || match fit_record::find_in_session(dir)? {
        Some((session, number)) => {
            let record = fit_record::read_in(&session, number)?;
            Ok::<_, FitRecordError>((record, called(&session)))
        }
        None => Ok((fit_record::read(dir)?, None)),
    };
    found().map_err(|error| match (args.fit, &error) {
        (Some(number), FitRecordError::NoFit { .. }) if args.dir.exists() => {
            let session = args.dir.clone();
            stated_result_error(StatedResultError::NoSuchFit { session, number })
        }
        _ => error.into(),
    })
}

/// The name of a session's sample, where a file can have it.
fn called(session: &Session) -> Option<String> {
    Some(session.record().sample.clone()).filter(|name| is_sample_name(name))
}

/// Advice where a result cannot be stated to others.
pub(super) fn stated_result_error(error: StatedResultError) -> CliError {
    match error {
        StatedResultError::NoSession { .. } => {
            CliError::from(error).hint("`rig fit SESSION` fits a captured session; give that")
        }
        StatedResultError::NoSuchFit { .. } => CliError::from(error).hint(LATEST_FIT),
        StatedResultError::Fit(error) => error.into(),
        StatedResultError::Session(error) => error.into(),
        StatedResultError::Config(error) => error.into(),
    }
}

/// What a user of the export must know.
fn warn_of(record: &FitRecord, context: &Context) {
    if record.simulated {
        context.warn("this BRDF comes from a simulated bench; the export is marked as simulated");
    }
    if record.verdict() == Verdict::NotToBeTrusted {
        let reason = record.warnings.first().map(|warning| &warning.what);
        context.warn(match reason {
            Some(reason) => format!("{}: {reason}", record.verdict().sentence()),
            None => record.verdict().sentence().to_owned(),
        });
    }
}
