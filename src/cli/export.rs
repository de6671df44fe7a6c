//! `rig export`: the fitted BRDF in files that other programs read.

use std::path::PathBuf;

use clap::ValueEnum;

use super::{CliError, Context, as_model, output};
use crate::export::{self, ExportError, Format};
use crate::session::fit_record::{self, FitRecord, FitRecordError, Verdict};
use crate::session::layout::FITS_FOLDER;
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
    #[arg(long, value_enum)]
    format: FormatArg,
    /// The file to write; `brdf` with the format's usual ending if not given
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum FormatArg {
    /// Dictionary, weights, model discrepancy and the table with its intervals
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
    /// OpenPBR in MaterialX (.mtlx), the nearest of that model; what it loses is printed and drawn
    #[value(name = "openpbr")]
    OpenPbr,
    /// Script that makes the material in Blender 4.0 and later (.py), likewise
    Blender,
    /// Sphere of the material in binary glTF 2.0 (.glb), likewise
    Gltf,
    /// Universal BRDF JSON of the European BRDF projects (BiRD), with expanded uncertainty;
    /// of a fitted session
    Birdf,
}

impl FormatArg {
    fn name(self) -> String {
        let value = self.to_possible_value().expect("no format is hidden");
        value.get_name().to_owned()
    }

    /// As a format of [`export::export`]; none is the one that needs the fit's session.
    fn of_any_fit(self) -> Option<Format> {
        Format::named(&self.name())
    }
}

/// What to do where a session has no such fit.
const LATEST_FIT: &str = "leave --fit out to take the latest";

/// `rig export`.
pub fn run(args: &ExportArgs, context: &Context) -> Result<(), CliError> {
    let Some(format) = args.format.of_any_fit() else {
        return birdf(args, context);
    };
    let ending = format.ending();
    let path = args.out.clone();
    let path = path.unwrap_or_else(|| PathBuf::from(format!("brdf.{ending}")));
    output::check_ending(&path, ending)?;
    let dir = match args.fit {
        Some(number) => args.dir.join(FITS_FOLDER).join(number.to_string()),
        None => args.dir.clone(),
    };
    let record = fit_record::find(&dir).map_err(|error| match (args.fit, &error) {
        (Some(_), FitRecordError::NoFit { .. }) => CliError::from(error).hint(LATEST_FIT),
        _ => error.into(),
    })?;
    warn_of(&record, context);
    as_model::show(&export::export(&record, format, &path)?, context)
}

/// Writes the universal BRDF JSON of a fitted session.
fn birdf(args: &ExportArgs, context: &Context) -> Result<(), CliError> {
    let path = args.out.clone();
    let path = path.unwrap_or_else(|| PathBuf::from("birdf.json"));
    output::check_ending(&path, "json")?;
    let result = StatedResult::load(&args.dir, args.fit).map_err(stated_result_error)?;
    warn_of(&result.record, context);
    let lacking = result.config.lab.missing();
    if !lacking.is_empty() {
        context.note(format!(
            "\"{}\" in the file: {}; state them in [lab] of the rig file before the capture",
            export::birdf::NOT_STATED,
            lacking.join(", ")
        ));
    }
    export::birdf::write(&result, &path).map_err(|error| match error {
        ExportError::Io { path, source } => output::unwritable(&path, &source),
        error => error.into(),
    })?;
    output::write_path(&path)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_format_has_its_name_here() {
        let here = FormatArg::value_variants().iter().map(|of| of.name());
        let mut known: Vec<_> = Format::ALL.map(|(name, _)| name.to_owned()).into();
        known.push("birdf".into());
        assert_eq!(here.collect::<Vec<_>>(), known);
    }
}
