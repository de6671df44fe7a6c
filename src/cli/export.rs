//! `rig export`: the fitted BRDF in files that other programs read.

use std::path::PathBuf;

use clap::ValueEnum;

use super::{CliError, Context, as_model, output};
use crate::export::{self, Format, ModelFormat};
use crate::session::fit_record::{self, Verdict};

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
}

/// `rig export`.
pub fn run(args: &ExportArgs, context: &Context) -> Result<(), CliError> {
    let record = fit_record::find(&args.dir)?;
    let format = match args.format {
        FormatArg::Json => Format::Json,
        FormatArg::Merl => Format::Merl,
        FormatArg::Rgl => Format::Rgl,
        FormatArg::RglSpectral => Format::RglSpectral,
        FormatArg::Mitsuba => Format::Mitsuba,
        FormatArg::Pbrt => Format::Pbrt,
        FormatArg::OpenPbr => Format::Model(ModelFormat::OpenPbr),
        FormatArg::Blender => Format::Model(ModelFormat::Blender),
        FormatArg::Gltf => Format::Model(ModelFormat::Gltf),
    };
    let ending = format.ending();
    let path = args.out.clone();
    let path = path.unwrap_or_else(|| PathBuf::from(format!("brdf.{ending}")));
    output::check_ending(&path, ending)?;
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
    as_model::show(&export::export(&record, format, &path)?, context)
}
