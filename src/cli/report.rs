//! `rig report`: a session as one HTML file.

use std::path::PathBuf;
use std::sync::Arc;

use super::output::{unwritable, write_path};
use super::{CliError, Context};
use crate::report::{self, load::LoadError};
use crate::session::commit::SystemDisk;
use crate::session::{SessionWriter, layout};
use crate::whole_file;

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
    let input = report::load::load(&args.session, args.fit).map_err(advise)?;
    if input.fit.is_none() {
        context.note("the session has no fit yet; `rig fit SESSION` makes one");
    }
    let html = report::render(&input)?;
    let path = match &args.out {
        Some(path) => {
            whole_file::replace(path, |file| file.write_all(html.as_bytes()))
                .map_err(|error| unwritable(path, &error))?;
            path.clone()
        }
        None => {
            let mut session = SessionWriter::open(Arc::new(SystemDisk), &args.session)?;
            session.commit_file(layout::REPORT_FILE, html.as_bytes())?;
            session.refresh_manifest()?;
            args.session.join(layout::REPORT_FILE)
        }
    };
    write_path(&path)
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
