//! `rig brdf compare`: the errors of an estimate against a truth.

use clap::Args;

use super::{SCORE_HEADER, SPEC_HELP, advise, print_scores, score_line};
use crate::brdf::plain_error::{AlbedoError, PeakError};
use crate::brdf::score;
use crate::cli::number::within;
use crate::cli::output::write_json;
use crate::cli::{CliError, HintExt};
use crate::material::{self, Named};
use crate::out;

/// Prints the errors of an estimate against a truth
#[derive(Args, Debug)]
#[command(after_help = SPEC_HELP)]
pub struct CompareArgs {
    /// The BRDF to score
    estimate: String,
    /// The true BRDF
    truth: String,
    /// Only where the images of a fit constrain it: errors of the values, and the peaks there
    #[arg(long)]
    constrained: bool,
    /// Pixels per side of the spheres, 8 to 512; published figures use 128
    #[arg(long, default_value_t = score::SPHERE_SIZE, value_parser = within(8usize, 512))]
    size: usize,
    /// JSON instead of a table
    #[arg(long)]
    json: bool,
}

/// Runs `rig brdf compare`.
pub fn run(args: &CompareArgs) -> Result<(), CliError> {
    let load = |spec: &str| Named::load(spec).map_err(advise);
    let (estimate, truth) = (load(&args.estimate)?, load(&args.truth)?);
    let title = format!("{} against {}", args.estimate, args.truth);
    if args.constrained {
        return constrained(&estimate, &truth, &title, args.json);
    }
    let found = material::compare(&estimate, &truth, args.size);
    if args.json {
        return write_json(&found);
    }
    out!("{SCORE_HEADER}")?;
    print_scores(&title, &found.errors)?;
    print_albedo(&found.plain.albedo)?;
    print_peak(&found.plain.peak)
}

fn constrained(estimate: &Named, truth: &Named, title: &str, json: bool) -> Result<(), CliError> {
    let found = material::compare_constrained(estimate, truth)
        .hint("leave --constrained out to compare everywhere")?;
    if json {
        return write_json(&found);
    }
    out!("{SCORE_HEADER}")?;
    out!(
        "{title}, over the {:.1}% of the cells (by solid angle) that the images constrain",
        100.0 * found.share
    )?;
    score_line("BRDF", &found.brdf.relative)?;
    score_line("cube root", &found.brdf.cube_root)?;
    match found.peak.as_slice() {
        [] => out!("no mirror direction at 8°, 45° or 75° is constrained"),
        peak => print_peak(peak),
    }
}

fn print_albedo(errors: &[AlbedoError]) -> Result<(), CliError> {
    out!("albedo: part of the light that is reflected, less the truth's")?;
    for error in errors {
        let [r, g, b] = error.difference;
        out!(
            "  at {:>3}°                 {r:>+8.4} {g:>+8.4} {b:>+8.4}",
            error.theta_i_deg
        )?;
    }
    Ok(())
}

fn print_peak(errors: &[PeakError]) -> Result<(), CliError> {
    out!("peak: f in the mirror direction, against the truth's")?;
    for error in errors {
        let [r, g, b] = error.relative.map(|part| match part.is_finite() {
            true => format!("{:+.1}%", 100.0 * part),
            false => "not 0".to_owned(),
        });
        out!(
            "  at {:>3}°                 {r:>8} {g:>8} {b:>8}",
            error.theta_i_deg
        )?;
    }
    Ok(())
}
