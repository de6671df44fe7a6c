//! `rig brdf`: BRDFs from files and names, looked at, checked, compared, converted.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::{Args, Subcommand};
use glam::DVec3;
use serde::Serialize;

use super::output::{ANOTHER_FILE, check_ending, unwritable, write_json, write_path};
use super::{CliError, Context, HintExt};
use crate::brdf::check::{ALBEDO_ANGLES_DEG, PhysicalCheck, check};
use crate::brdf::chi_square::{ChiSquare, check_lobes};
use crate::brdf::environment::EnvironmentMap;
use crate::brdf::rgl::{AsMeasured, RglBrdf};
use crate::brdf::score::{self, BrdfErrors, EnvironmentError};
use crate::brdf::sphere::sphere_image;
use crate::brdf::table::Gaps;
use crate::brdf::{Brdf, BrdfError, Dictionary, Mixture, merl, nbrdf, source, weights};
use crate::export::rgl;
use crate::inverse::projection::{CellMatrix, EnvironmentMatrix, FIT_AZIMUTHS};
use crate::out;
use crate::session::fit_record;
use crate::{outside_file, outside_table, whole_file};

const SPEC_HELP: &str = "A BRDF is one of: FILE.binary (MERL), FILE.bsdf (RGL), nbrdf:NAME (embedded measured material), \
FIT (the folder of a fit, or a session: its latest), DICTIONARY:WEIGHTS.csv (a mixture, as a fit or a projection writes it; DICTIONARY is rig26, paper42 or a .json or .toml file), \
ggx:ALPHA,ETA, lambertian:ALBEDO.";

/// Evaluates, checks, compares, draws and converts BRDFs
#[derive(Args, Debug)]
#[command(after_help = SPEC_HELP)]
pub struct BrdfArgs {
    #[command(subcommand)]
    command: BrdfCommand,
}

#[derive(Subcommand, Debug)]
enum BrdfCommand {
    /// Prints f in 1/sr (cosine excluded) at given angles, as CSV
    #[command(after_help = SPEC_HELP)]
    Eval {
        /// The BRDF
        #[arg(long)]
        brdf: String,
        /// CSV with columns theta_i_deg, theta_o_deg (0 to 90) and phi_deg (between the two azimuths)
        #[arg(long, value_name = "FILE.csv")]
        angles: PathBuf,
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
    /// Projects onto a dictionary: the reference projection's errors beside the floor of each score
    #[command(after_help = SPEC_HELP)]
    Project {
        /// The BRDF
        brdf: String,
        /// rig26, paper42, or a .json or .toml file
        #[arg(long, default_value = Dictionary::DEFAULT)]
        dictionary: String,
        /// Pixels per side of the spheres, 8 to 512; published figures use 128
        #[arg(long, default_value_t = score::SPHERE_SIZE, value_parser = sphere_size)]
        size: usize,
        /// Writes the reference projection's weights here
        #[arg(long, value_name = "WEIGHTS.csv")]
        out: Option<PathBuf>,
        /// JSON instead of a table
        #[arg(long)]
        json: bool,
    },
    /// Prints the errors of an estimate against a truth
    #[command(after_help = SPEC_HELP)]
    Compare {
        /// The BRDF that is judged
        estimate: String,
        /// The BRDF it should be
        truth: String,
        /// Pixels per side of the spheres, 8 to 512; published figures use 128
        #[arg(long, default_value_t = score::SPHERE_SIZE, value_parser = sphere_size)]
        size: usize,
        /// JSON instead of a table
        #[arg(long)]
        json: bool,
    },
    /// Draws spheres of the material under the four environment maps, as a PNG
    #[command(after_help = SPEC_HELP)]
    Plot {
        /// The BRDF
        brdf: String,
        /// The picture
        #[arg(long, value_name = "FILE.png")]
        out: PathBuf,
        /// Pixels per side of each sphere, 8 to 512
        #[arg(long, default_value_t = 256, value_parser = sphere_size)]
        size: usize,
    },
    /// Writes a MERL table of 90 x 90 x 180 cells, or an RGL file
    #[command(after_help = SPEC_HELP)]
    Convert {
        /// The BRDF
        brdf: String,
        /// The file; its ending says which
        #[arg(long, value_name = "FILE.binary|FILE.bsdf")]
        out: PathBuf,
    },
}

fn sphere_size(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(size) if (8..=512).contains(&size) => Ok(size),
        _ => Err("allowed are 8 to 512".to_owned()),
    }
}

/// Runs `rig brdf`.
pub fn run(args: &BrdfArgs, _context: &Context) -> Result<(), CliError> {
    match &args.command {
        BrdfCommand::Eval { brdf, angles, json } => eval(brdf, angles, *json),
        BrdfCommand::Check { brdf, json } => run_check(brdf, *json),
        BrdfCommand::Project {
            brdf,
            dictionary,
            size,
            out,
            json,
        } => project(brdf, dictionary, *size, out.as_deref(), *json),
        BrdfCommand::Compare {
            estimate,
            truth,
            size,
            json,
        } => compare(estimate, truth, *size, *json),
        BrdfCommand::Plot { brdf, out, size } => plot(brdf, out, *size),
        BrdfCommand::Convert { brdf, out } => convert(brdf, out),
    }
}

fn load(spec: &str) -> Result<Arc<dyn Brdf>, CliError> {
    let folder = Path::new(spec);
    if folder.is_dir() {
        return Ok(fit_record::find(folder)?.material()?);
    }
    if let Some(name) = spec.strip_prefix("nbrdf:")
        && !nbrdf::NAMES.contains(&name)
    {
        return Err(CliError::new(format!("no embedded material \"{name}\""))
            .hint(format!("known are {}", nbrdf::NAMES.join(", "))));
    }
    source::load(spec)
        .map(Arc::from)
        .map_err(|error| match &error {
            BrdfError::UnknownSource { .. }
            | BrdfError::Dictionary { .. }
            | BrdfError::Weights { .. } => {
                CliError::from(error).hint("`rig brdf --help` lists what names a BRDF")
            }
            _ => error.into(),
        })
}

/// Largest angles file, bytes: some millions of lines.
const LARGEST_ANGLES_BYTES: u64 = 1 << 28;

/// One line of an angles file, degrees.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Angles {
    /// Polar angle of the light, 0..=90.
    pub theta_i_deg: f64,
    /// Polar angle of the viewer, 0..=90.
    pub theta_o_deg: f64,
    /// Azimuth between the two.
    pub phi_deg: f64,
}

impl Angles {
    fn directions(self) -> (DVec3, DVec3) {
        let place = |theta_deg: f64, phi_deg: f64| {
            let (sin, cos) = theta_deg.to_radians().sin_cos();
            let (sin_phi, cos_phi) = phi_deg.to_radians().sin_cos();
            DVec3::new(sin * cos_phi, sin * sin_phi, cos)
        };
        (
            place(self.theta_i_deg, 0.0),
            place(self.theta_o_deg, self.phi_deg),
        )
    }
}

/// The lines of an angles file.
///
/// # Errors
/// In words: a column or number that is missing or wrong.
pub fn parse_angles(text: &str) -> Result<Vec<Angles>, String> {
    let rows = outside_table::rows(text).map_err(|error| error.to_string())?;
    let (header, rows) = rows
        .split_first()
        .ok_or("no column theta_i_deg in the first line: it is empty")?;
    let column = |name: &str| {
        let column = header.column(name);
        column.ok_or_else(|| format!("no column {name} in the first line"))
    };
    let columns = [
        column("theta_i_deg")?,
        column("theta_o_deg")?,
        column("phi_deg")?,
    ];
    rows.iter()
        .map(|row| {
            let mut values = [0.0; 3];
            for (value, &column) in values.iter_mut().zip(&columns) {
                *value = outside_table::number(row.field(column))
                    .map_err(|error| format!("line {}: {error}", row.line))?;
            }
            let [theta_i_deg, theta_o_deg, phi_deg] = values;
            for theta in [theta_i_deg, theta_o_deg] {
                if !(0.0..=90.0).contains(&theta) {
                    return Err(format!(
                        "line {}: polar angle {theta}, allowed is 0 to 90",
                        row.line
                    ));
                }
            }
            Ok(Angles {
                theta_i_deg,
                theta_o_deg,
                phi_deg,
            })
        })
        .collect()
}

fn eval(spec: &str, angles: &Path, json: bool) -> Result<(), CliError> {
    #[derive(Serialize)]
    struct Row {
        #[serde(flatten)]
        angles: Angles,
        /// 1/sr.
        f: [f32; 3],
    }
    let brdf = load(spec)?;
    let text = outside_file::read_text(angles, LARGEST_ANGLES_BYTES)
        .map_err(|error| CliError::new(format!("{}: {error}", angles.display())))?;
    let rows: Vec<Row> = parse_angles(&text)
        .map_err(|fact| CliError::new(format!("{}: {fact}", angles.display())))
        .hint("the columns are theta_i_deg,theta_o_deg,phi_deg")?
        .into_iter()
        .map(|angles| {
            let (i, o) = angles.directions();
            Row {
                angles,
                f: brdf.eval(i.as_vec3(), o.as_vec3()),
            }
        })
        .collect();
    if json {
        return write_json(&rows);
    }
    out!("theta_i_deg,theta_o_deg,phi_deg,f_r,f_g,f_b")?;
    for Row {
        angles,
        f: [r, g, b],
    } in rows
    {
        let Angles {
            theta_i_deg,
            theta_o_deg,
            phi_deg,
        } = angles;
        out!("{theta_i_deg},{theta_o_deg},{phi_deg},{r:e},{g:e},{b:e}")?;
    }
    Ok(())
}

/// Angles of the viewer at which the importance sampler is tested, degrees.
const SAMPLER_ANGLES_DEG: [f64; 4] = [0.0, 45.0, 80.0, 88.0];

fn run_check(spec: &str, json: bool) -> Result<(), CliError> {
    #[derive(Serialize)]
    struct Answer {
        #[serde(flatten)]
        found: PhysicalCheck,
        /// Of a measured file, before both orders of the directions are averaged.
        reciprocity_as_measured: Option<f64>,
        /// Of a MERL file: nodes above the horizon that have no value.
        gaps: Option<Gaps>,
        /// The importance sampler made from it, at [`SAMPLER_ANGLES_DEG`].
        sampler: Vec<ChiSquare>,
    }
    let brdf = load(spec)?;
    let found = check(brdf.as_ref());
    let sampler = check_lobes(brdf.as_ref(), &SAMPLER_ANGLES_DEG, 20_000);
    let path = Path::new(spec);
    let reciprocity_as_measured = if path.extension().is_some_and(|e| e == "bsdf") {
        Some(check(&AsMeasured(&RglBrdf::read(path)?)).reciprocity)
    } else {
        None
    };
    let gaps = if path.extension().is_some_and(|e| e == "binary") {
        Some(merl::read(path)?.gaps())
    } else {
        None
    };
    let answer = Answer {
        found,
        reciprocity_as_measured,
        gaps,
        sampler,
    };
    let found = &answer.found;
    if json {
        write_json(&answer)?;
    } else {
        out!("directional albedo (1 is all light reflected)")?;
        out!("  theta_i      R      G      B")?;
        for (theta, [r, g, b]) in ALBEDO_ANGLES_DEG.iter().zip(&found.albedo) {
            out!("  {theta:>5}° {r:>8.4} {g:>6.4} {b:>6.4}")?;
        }
        out!("largest albedo        {:.4}", found.largest_albedo)?;
        out!("reciprocity, worst    {:.2e} relative", found.reciprocity)?;
        if let Some(raw) = answer.reciprocity_as_measured {
            out!("  as measured         {raw:.2e} relative, before both orders are averaged")?;
        }
        out!(
            "invalid values        {} of {} pairs",
            found.invalid,
            found.pairs
        )?;
        if let Some(gaps) = gaps {
            out!(
                "nodes without value   {} not measured, {} undefined or infinite, of {}",
                gaps.negative,
                gaps.not_finite,
                gaps.nodes
            )?;
        }
        let worst = answer.sampler.iter().map(|s| s.deviate);
        out!(
            "sampler, worst χ²     {:+.1} standard deviations at 0, 45, 80 and 88°",
            worst.fold(f64::NEG_INFINITY, f64::max)
        )?;
    }
    if let Some(gaps) = gaps.filter(|gaps| !gaps.are_few()) {
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

/// Errors of one BRDF against the truth.
#[derive(Serialize)]
struct Scores {
    environment: EnvironmentError,
    brdf: BrdfErrors,
}

fn print_scores(name: &str, scores: &Scores) -> Result<(), CliError> {
    let line = |what: &str, error: &score::PerChannel| {
        let [r, g, b] = error.channels;
        out!(
            "  {what:<12} {:>8.4}   {r:>8.4} {g:>8.4} {b:>8.4}",
            error.all
        )
    };
    out!("{name}")?;
    line("environment", &scores.environment.mean)?;
    line("BRDF", &scores.brdf.relative)?;
    line("cube root", &scores.brdf.cube_root)
}

const SCORE_HEADER: &str = "  error             all          R        G        B";

fn project(
    spec: &str,
    dictionary: &str,
    size: usize,
    weights_out: Option<&Path>,
    json: bool,
) -> Result<(), CliError> {
    #[derive(Serialize)]
    struct Answer<'a> {
        dictionary: &'a str,
        sphere_size: usize,
        reference_projection: Scores,
        floor: Scores,
        weights: &'a [Vec<f64>; 3],
    }
    let truth = load(spec)?;
    let dictionary = Arc::new(Dictionary::load(dictionary)?);
    let maps = EnvironmentMap::all();
    let spheres = EnvironmentMatrix::new(dictionary.clone(), &maps, size);
    let matrix = CellMatrix::new(dictionary.clone(), FIT_AZIMUTHS);
    let reference = matrix.reference_projection(truth.as_ref())?;
    let cells = score::cells(180);
    let target = score::cosine_weighted(truth.as_ref(), &cells);
    let errors =
        |m: &Mixture| score::errors_of_values(&score::cosine_weighted(m, &cells), &target, &cells);
    let relative = errors(&matrix.relative_floor(truth.as_ref())?).relative;
    let cube_root = errors(&matrix.cube_root_floor(truth.as_ref())?).cube_root;
    let answer = Answer {
        dictionary: dictionary.name(),
        sphere_size: size,
        reference_projection: Scores {
            environment: spheres.error(&reference, truth.as_ref()),
            brdf: errors(&reference),
        },
        floor: Scores {
            environment: spheres.floor(truth.as_ref())?.0,
            brdf: BrdfErrors {
                relative,
                cube_root,
            },
        },
        weights: reference.weights(),
    };
    if let Some(path) = weights_out {
        let csv = weights::to_csv(&reference, None);
        whole_file::replace(path, |file| file.write_all(csv.as_bytes()))
            .map_err(|error| unwritable(path, &error))?;
    }
    if json {
        return write_json(&answer);
    }
    out!("{spec} on {}", dictionary.name())?;
    out!("{SCORE_HEADER}")?;
    print_scores("reference projection", &answer.reference_projection)?;
    print_scores("floor of each score", &answer.floor)
}

fn compare(estimate: &str, truth: &str, size: usize, json: bool) -> Result<(), CliError> {
    let (a, b) = (load(estimate)?, load(truth)?);
    let scores = Scores {
        environment: score::environment_error(a.as_ref(), b.as_ref(), &EnvironmentMap::all(), size),
        brdf: score::brdf_errors(a.as_ref(), b.as_ref(), &score::cells(180)),
    };
    if json {
        return write_json(&scores);
    }
    out!("{SCORE_HEADER}")?;
    print_scores(&format!("{estimate} against {truth}"), &scores)
}

fn plot(spec: &str, path: &Path, size: usize) -> Result<(), CliError> {
    check_ending(path, "png")?;
    let brdf = load(spec)?;
    let maps = EnvironmentMap::all();
    let mut picture = image::RgbImage::new((size * maps.len()) as u32, size as u32);
    for (column, map) in maps.iter().enumerate() {
        let sphere = sphere_image(brdf.as_ref(), map, size);
        for (pixel, rgb) in sphere
            .to_srgb(sphere.natural_exposure())
            .into_iter()
            .enumerate()
        {
            let x = (column * size + pixel % size) as u32;
            picture.put_pixel(x, (pixel / size) as u32, image::Rgb(rgb));
        }
    }
    picture
        .save(path)
        .map_err(|error| CliError::new(format!("{}: {error}", path.display())))
        .hint(ANOTHER_FILE)?;
    write_path(path)
}

fn convert(spec: &str, path: &Path) -> Result<(), CliError> {
    match path.extension().and_then(|e| e.to_str()) {
        Some("binary") => merl::write(path, load(spec)?.as_ref())?,
        Some("bsdf") => {
            let brdf = load(spec)?;
            let description = format!("{spec}, by rig {}", env!("CARGO_PKG_VERSION"));
            let bytes = rgl::to_bytes(brdf.as_ref(), rgl::Channels::Rgb, &description);
            whole_file::replace(path, |file| file.write_all(&bytes))
                .map_err(|error| unwritable(path, &error))?;
        }
        _ => {
            return Err(CliError::new(format!(
                "{}: neither a .binary nor a .bsdf name",
                path.display()
            ))
            .hint("MERL tables end in .binary, RGL files in .bsdf; `rig export` writes other formats of a fit"));
        }
    }
    write_path(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_are_read_by_column_name() {
        let text = "phi_deg, theta_o_deg,theta_i_deg,note\n180,30,20,x\n\n0,0,90,y\n";
        let rows = parse_angles(text).unwrap();
        assert_eq!(rows.len(), 2);
        assert_eq!(
            (rows[0].theta_i_deg, rows[0].theta_o_deg, rows[0].phi_deg),
            (20.0, 30.0, 180.0)
        );
        for (bad, said) in [
            ("", "no column theta_i_deg"),
            ("theta_i_deg,theta_o_deg,phi_deg\n1,2", "\"\" is no number"),
            (
                "theta_i_deg,theta_o_deg,phi_deg\n1,95,0",
                "line 2: polar angle 95",
            ),
            ("theta_i_deg,theta_o_deg,phi_deg\nnan,9,0", "\"nan\""),
        ] {
            assert!(parse_angles(bad).unwrap_err().contains(said), "{bad}");
        }
    }
}
