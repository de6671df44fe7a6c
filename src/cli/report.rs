//! `rig report`: a session as one HTML file.

use std::path::PathBuf;

use super::output::{unwritable, write_path};
use super::{CliError, Context};
use crate::report::load::LoadError;
use crate::report::{self, ReportError, ReportRequest};

/// Writes a session's report: one HTML file that needs no other.
#[derive(clap::Args, Debug)]
pub struct ReportArgs {
    /// The session's folder
    #[arg(value_name = "SESSION")]
    session: PathBuf,
    /// Which fit to show, by its number in `fits/`; the latest if not given
    #[arg(long, value_name = "N")]
    fit: Option<u32>,
    /// Writes here instead of report.html in the session
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// `rig report`.
pub fn run(args: &ReportArgs, context: &Context) -> Result<(), CliError> {
    let request = ReportRequest {
        session: args.session.clone(),
        fit: args.fit,
        out: args.out.clone(),
    };
    let written = report::write(&request).map_err(|error| match error {
        ReportError::Load(error) => advise(error),
        ReportError::Session(error) => error.into(),
        ReportError::Io { path, source } => unwritable(&path, &source),
        error => error.into(),
    })?;
    if !written.has_fit {
        context.note("the session has no fit yet; `rig fit SESSION` makes one");
    }
    write_path(&written.path)
}

fn advise(error: LoadError) -> CliError {
    let hint = match &error {
        LoadError::Fit(_) => "`rig fit SESSION` makes a new fit; --fit N shows another one",
        LoadError::NoSuchFit { .. } => {
            "leave --fit out to show the latest, or run `rig fit SESSION`"
        }
        LoadError::Image(_) => {
            "`rig capture --resume SESSION` makes the merged images again from the raw frames"
        }
        LoadError::Session(error) if error.damaged_file().is_some() => {
            "`rig session verify SESSION` lists every damaged file; `rig capture --resume SESSION` makes merged images again"
        }
        LoadError::Sidecar { .. } | LoadError::Session(_) => {
            "give the folder of a session; `rig session verify SESSION` checks every file of it"
        }
        LoadError::Brdf(_) => "`rig fit SESSION` makes a new fit",
    };
    CliError::from(error).hint(hint)
}
