//! `rig export`: the fitted BRDF in files that other programs read.

use std::path::{Path, PathBuf};

use clap::ValueEnum;

use super::{CliError, Context, HintExt};
use crate::export::{self, Format};
use crate::out;
use crate::session::fit_record;

/// Writes a fitted BRDF for other programs.
#[derive(clap::Args, Debug)]
pub struct ExportArgs {
    /// A fit's folder, or a session (its latest fit)
    #[arg(value_name = "DIR")]
    dir: PathBuf,
    /// What to write
    #[arg(long, value_enum)]
    format: FormatArg,
    /// The file to write; brdf.json, brdf.binary or brdf.xml if not given
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum FormatArg {
    /// Dictionary, weights and the table with its intervals
    Json,
    /// MERL .binary, 90 x 90 x 180 cells
    Merl,
    /// Scene fragment for the RGB variants of Mitsuba 3
    Mitsuba,
}

/// `rig export`.
pub fn run(args: &ExportArgs, context: &Context) -> Result<(), CliError> {
    let folder = fit_folder(&args.dir)?;
    let record = fit_record::read(&folder)
        .hint("`rig fit` makes the folder anew; its files are not meant to be edited")?;
    let (format, name) = match args.format {
        FormatArg::Json => (Format::Json, "brdf.json"),
        FormatArg::Merl => (Format::Merl, "brdf.binary"),
        FormatArg::Mitsuba => (Format::Mitsuba, "brdf.xml"),
    };
    let path = args.out.clone().unwrap_or_else(|| PathBuf::from(name));
    if record.simulated {
        context.warn("this BRDF comes from a simulated bench; the export says so");
    }
    for file in export::export(&record, format, &path)? {
        out!("{}", file.display())?;
    }
    Ok(())
}

/// The folder itself if it is a fit, else the session's latest.
fn fit_folder(dir: &Path) -> Result<PathBuf, CliError> {
    if dir.join("fit.toml").exists() {
        return Ok(dir.to_owned());
    }
    let latest = fit_record::list(dir).pop().map(|(_, folder)| folder);
    latest
        .ok_or_else(|| {
            CliError::new(format!(
                "{} holds no fit (no fit.toml, no fits/)",
                dir.display()
            ))
        })
        .hint("give the folder that `rig fit --out` wrote, or a session that `rig fit` has fitted")
}
