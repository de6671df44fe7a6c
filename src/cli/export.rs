//! `rig export`: the fitted BRDF in files that other programs read.

use std::path::{Path, PathBuf};

use clap::ValueEnum;

use super::{CliError, Context, HintExt};
use crate::export::{self, Format};
use crate::out;
use crate::session::Session;
use crate::session::fit_record::{self, FitRecord};
use crate::session::layout::{FITS_FOLDER, JOURNAL_FILE};

/// Writes a fitted BRDF for other programs.
#[derive(clap::Args, Debug)]
pub struct ExportArgs {
    /// A fit's folder, or a session (its latest fit)
    #[arg(value_name = "DIR")]
    dir: PathBuf,
    /// What to write
    #[arg(long, value_enum)]
    format: FormatArg,
    /// The file to write; `brdf` with the format's usual ending if not given
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum FormatArg {
    /// Dictionary, weights, departure and the table with its intervals
    Json,
    /// MERL .binary, 90 x 90 x 180 cells
    Merl,
    /// RGL .bsdf in RGB, for Mitsuba 3's `measured`
    Rgl,
    /// RGL .bsdf with spectra, for pbrt-v4's `measured` and spectral Mitsuba 3
    RglSpectral,
    /// Scene fragment for the RGB variants of Mitsuba 3: the mixture of the weights, exactly
    Mitsuba,
    /// Material for pbrt-v4, with the .bsdf it refers to
    Pbrt,
}

/// `rig export`.
pub fn run(args: &ExportArgs, context: &Context) -> Result<(), CliError> {
    let record = read_fit(&args.dir)?;
    let (format, name) = match args.format {
        FormatArg::Json => (Format::Json, "brdf.json"),
        FormatArg::Merl => (Format::Merl, "brdf.binary"),
        FormatArg::Rgl => (Format::Rgl, "brdf.bsdf"),
        FormatArg::RglSpectral => (Format::RglSpectral, "brdf.bsdf"),
        FormatArg::Mitsuba => (Format::Mitsuba, "brdf.xml"),
        FormatArg::Pbrt => (Format::Pbrt, "brdf.pbrt"),
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

/// The fit in a folder of its own, or of a session: there its files must be those
/// that the journal vouches for.
fn read_fit(dir: &Path) -> Result<FitRecord, CliError> {
    let damaged =
        "`rig session verify SESSION` lists every damaged file; `rig fit SESSION` makes a new fit";
    if let Some((root, number)) = fit_of_session(dir) {
        let session = Session::open(&root)?;
        return fit_record::read_in(&session, number).hint(damaged);
    }
    if dir.join("fit.toml").exists() {
        return fit_record::read(dir)
            .hint("`rig fit` makes the folder anew; its files are not meant to be edited");
    }
    let nothing = || {
        CliError::new(format!(
            "{} holds no fit (no fit.toml, no fits/)",
            dir.display()
        ))
        .hint("give the folder that `rig fit --out` wrote, or a session that `rig fit` has fitted")
    };
    if !dir.join(JOURNAL_FILE).exists() {
        return Err(nothing());
    }
    let session = Session::open(dir)?;
    let latest = fit_record::numbers_in(&session).pop().ok_or_else(nothing)?;
    fit_record::read_in(&session, latest).hint(damaged)
}

/// Session and number where `dir` is `SESSION/fits/NUMBER`.
fn fit_of_session(dir: &Path) -> Option<(PathBuf, u32)> {
    let dir = dir.canonicalize().ok()?;
    let number = dir.file_name()?.to_str()?.parse().ok()?;
    let fits = dir.parent()?;
    let root = fits.parent()?;
    let is_session = fits.file_name()? == FITS_FOLDER && root.join(JOURNAL_FILE).exists();
    is_session.then(|| (root.to_owned(), number))
}
