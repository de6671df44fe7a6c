//! `rig brdf`: BRDFs from files and names, looked at, checked, compared, converted.

mod compare;
mod plot;
pub(super) mod spec;

use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};

use spec::{advise, load};

use super::number::within;
use super::output::{unwritable, write_json, write_path};
use super::{CliError, Context, as_model};
use crate::brdf::{Dictionary, nbrdf, score};
use crate::export::{self, ModelFormat, TableFormat};
use crate::material::{self, Angles, Errors, MaterialError};
use crate::out;
use crate::whole_file;

const SPEC_HELP: &str = "A BRDF is one of: FILE.binary (MERL), FILE.bsdf (RGL), nbrdf:NAME (embedded measured material, see `rig brdf list`), \
FIT (the folder of a fit, or a session: its latest), DICTIONARY:WEIGHTS.csv (a mixture, as a fit or a projection writes it; DICTIONARY is rig65, rig26, paper42 or a .json or .toml file), \
ggx:ALPHA,ETA, lambertian:ALBEDO.";

const EXAMPLES: &str = "Examples:
  rig brdf list                                              the embedded measured materials
  rig brdf eval nbrdf:red-plastic --at 30,30,180             f of one, light and viewer at 30°, opposite
  rig brdf convert gold.binary --out gold.bsdf               MERL to RGL, for Mitsuba and pbrt
  rig brdf convert gold.bsdf --out gold.binary               RGL to MERL
  rig brdf compare SESSION nbrdf:red-plastic                 how far a fit is from a material
  rig brdf plot SESSION nbrdf:red-plastic --kind lobes --out lobes.png

Recipes for these and more: docs/recipes.md.";

const CONVERT_HELP: &str = "Examples:
  rig brdf convert gold.binary --out gold.bsdf      MERL to RGL
  rig brdf convert gold.bsdf --out gold.binary      RGL to MERL
  rig brdf convert SESSION --out sample.binary      a fit to MERL

Either way the values at the file's nodes are exact; between them they are interpolated. What a \
conversion loses stands in docs/recipes.md, and `rig brdf compare NEW OLD` measures it.";

/// Lists, evaluates, checks, compares, draws and converts BRDFs
#[derive(Args, Debug)]
#[command(after_help = format!("{EXAMPLES}\n\n{SPEC_HELP}"))]
pub struct BrdfArgs {
    #[command(subcommand)]
    command: BrdfCommand,
}

#[derive(Subcommand, Debug)]
enum BrdfCommand {
    /// Lists the embedded measured materials, one a line
    List {
        /// JSON instead of lines
        #[arg(long)]
        json: bool,
    },
    /// Prints f in 1/sr (cosine excluded) at given angles, as CSV
    #[command(after_help = SPEC_HELP)]
    Eval {
        /// The BRDF
        #[arg(value_name = "BRDF", required_unless_present = "named")]
        brdf: Option<String>,
        /// The same
        #[arg(long = "brdf", hide = true, conflicts_with = "brdf")]
        named: Option<String>,
        /// Polar angles of light and viewer (0 to 90) and the azimuth between them, degrees:
        /// 30,30,180 is the mirror direction. Repeat it for more
        #[arg(
            long,
            value_name = "THETA_I,THETA_O,PHI",
            required_unless_present = "angles"
        )]
        at: Vec<Angles>,
        /// CSV with columns theta_i_deg, theta_o_deg (0 to 90) and phi_deg (between the two azimuths)
        #[arg(long, value_name = "FILE.csv", conflicts_with = "at")]
        angles: Option<PathBuf>,
        /// JSON instead of a table
        #[arg(long)]
        json: bool,
    },
    /// Reports reciprocity and energy conservation; fails if either is violated
    #[command(after_help = SPEC_HELP)]
    Check {
        /// The BRDF
        brdf: String,
        /// JSON instead of a table
        #[arg(long)]
        json: bool,
    },
    /// Projects onto a dictionary: the errors of the reference projection, and the floor of each score
    #[command(after_help = SPEC_HELP)]
    Project {
        /// The BRDF
        brdf: String,
        /// rig65, rig26, paper42, or a .json or .toml file
        #[arg(long, default_value = Dictionary::DEFAULT)]
        dictionary: String,
        /// Pixels per side of the spheres, 8 to 512; published figures use 128
        #[arg(long, default_value_t = score::SPHERE_SIZE, value_parser = within(8usize, 512))]
        size: usize,
        /// Writes the reference projection's weights here
        #[arg(long, value_name = "WEIGHTS.csv")]
        out: Option<PathBuf>,
        /// JSON instead of a table
        #[arg(long)]
        json: bool,
    },
    Compare(compare::CompareArgs),
    Plot(plot::PlotArgs),
    /// Converts any BRDF to a file: MERL to RGL, RGL to MERL, a fit to either, or to the nearest
    /// material of another program's model
    #[command(after_help = format!("{CONVERT_HELP}\n\n{SPEC_HELP}"))]
    Convert {
        /// The BRDF
        brdf: String,
        /// The file; its ending chooses the format
        #[arg(long, value_name = "FILE.binary|.bsdf|.mtlx|.py|.glb")]
        out: PathBuf,
        /// Of .mtlx, .py and .glb: also tints and layers that bring the model hardly nearer
        #[arg(long)]
        closest: bool,
    },
}

/// Runs `rig brdf`.
pub fn run(args: &BrdfArgs, context: &Context) -> Result<(), CliError> {
    match &args.command {
        BrdfCommand::List { json } => list(*json),
        BrdfCommand::Eval {
            brdf,
            named,
            at,
            angles,
            json,
        } => {
            let spec = brdf.as_deref().or(named.as_deref()).unwrap_or("");
            eval(spec, at, angles.as_deref(), *json)
        }
        BrdfCommand::Check { brdf, json } => run_check(brdf, *json),
        BrdfCommand::Project {
            brdf,
            dictionary,
            size,
            out,
            json,
        } => project(brdf, dictionary, *size, out.as_deref(), *json),
        BrdfCommand::Compare(args) => compare::run(args),
        BrdfCommand::Plot(args) => plot::run(args),
        BrdfCommand::Convert { brdf, out, closest } => match ModelFormat::of(out) {
            Some(format) => as_model::convert(brdf, format, out, *closest, context),
            None => convert(brdf, out),
        },
    }
}

fn list(json: bool) -> Result<(), CliError> {
    let names = nbrdf::specs();
    match json {
        true => write_json(&names),
        false => names.iter().try_for_each(|name| out!("{name}")),
    }
}

fn eval(spec: &str, at: &[Angles], file: Option<&Path>, json: bool) -> Result<(), CliError> {
    let brdf = load(spec)?;
    let angles = match file {
        Some(file) => material::read_angles(file).map_err(advise)?,
        None => at.to_vec(),
    };
    let rows = material::evaluate(brdf.as_ref(), angles);
    if json {
        return write_json(&rows);
    }
    out!("theta_i_deg,theta_o_deg,phi_deg,f_r,f_g,f_b")?;
    for row in rows {
        let (at, [r, g, b]) = (row.angles, row.f);
        let [i, o, phi] = [at.theta_i_deg, at.theta_o_deg, at.phi_deg];
        out!("{i},{o},{phi},{r:e},{g:e},{b:e}")?;
    }
    Ok(())
}

fn run_check(spec: &str, json: bool) -> Result<(), CliError> {
    let answer = material::check_material(spec).map_err(advise)?;
    let found = &answer.physical;
    match json {
        true => write_json(&answer)?,
        false => answer.lines().iter().try_for_each(|line| out!("{line}"))?,
    }
    if let Some(gaps) = answer.excessive_gaps() {
        return Err(CliError::new(format!(
            "{spec} is no measured table: of its {} nodes, {} above the horizon are undefined or infinite (allowed 0), {} are marked as not measured (allowed half)",
            gaps.nodes, gaps.not_finite, gaps.negative
        ))
        .hint("restore the file from where it came: what stands in these nodes was made up from their neighbours"));
    }
    if found.passes() {
        return Ok(());
    }
    Err(CliError::new(format!(
        "{spec} is not physical: reciprocity {:.2e} (allowed 1e-2), largest albedo {:.4} (allowed 1.005), {} invalid values",
        found.reciprocity, found.largest_albedo, found.invalid
    ))
    .hint("measured tables can break these by noise at grazing angles; a fit to the dictionary never does"))
}

fn print_scores(name: &str, scores: &Errors) -> Result<(), CliError> {
    out!("{name}")?;
    score_line("environment", &scores.environment.mean)?;
    score_line("BRDF", &scores.brdf.relative)?;
    score_line("cube root", &scores.brdf.cube_root)
}

fn score_line(what: &str, error: &score::PerChannel) -> Result<(), CliError> {
    let [r, g, b] = error.channels;
    out!(
        "  {what:<12} {:>8.4}   {r:>8.4} {g:>8.4} {b:>8.4}",
        error.all
    )
}

const SCORE_HEADER: &str = "  error             all          R        G        B";

fn project(
    spec: &str,
    dictionary: &str,
    size: usize,
    weights_out: Option<&Path>,
    json: bool,
) -> Result<(), CliError> {
    let truth = load(spec)?;
    let answer =
        material::project(truth.as_ref(), dictionary, size).map_err(|error| match error {
            MaterialError::Brdf(error) => error.into(),
            error => advise(error),
        })?;
    if let Some(path) = weights_out {
        let csv = answer.weights_csv();
        whole_file::replace(path, |file| file.write_all(csv.as_bytes()))
            .map_err(|error| unwritable(path, &error))?;
    }
    if json {
        return write_json(&answer);
    }
    out!("{spec} on {}", answer.dictionary)?;
    out!("{SCORE_HEADER}")?;
    print_scores("reference projection", &answer.reference_projection)?;
    print_scores("floor of each score", &answer.floor)
}

fn convert(spec: &str, path: &Path) -> Result<(), CliError> {
    let format = TableFormat::of(path).ok_or_else(|| {
        CliError::new(format!(
            "{}: the name ends in none of .binary, .bsdf, .mtlx, .py, .glb",
            path.display()
        ))
        .hint("MERL tables end in .binary, RGL files in .bsdf, OpenPBR in .mtlx, scripts for Blender in .py, glTF in .glb; `rig export` writes other formats of a fit")
    })?;
    export::table(load(spec)?.as_ref(), spec, format, path)?;
    write_path(path)
}
