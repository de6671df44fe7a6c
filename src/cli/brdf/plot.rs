//! `rig brdf plot`: BRDFs drawn alone or over each other.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

use super::{SPEC_HELP, advise};
use crate::cli::number::within;
use crate::cli::output::{check_ending, write_path};
use crate::cli::{CliError, HintExt, hints};
use crate::material;

const EXAMPLES: &str = "Examples:
  rig brdf plot SESSION --out spheres.png
  rig brdf plot SESSION nbrdf:red-plastic --kind lobes --out lobes.svg
  rig brdf plot SESSION nbrdf:red-plastic --kind slices --channels rgb --out slices.png
  rig brdf plot SESSION nbrdf:red-plastic --kind difference --out difference.png";

/// Plots BRDFs: spheres, lobes, slices, differences; several are overlaid
#[derive(Args, Debug)]
#[command(after_help = format!("{EXAMPLES}\n\n{SPEC_HELP}"))]
pub struct PlotArgs {
    /// One BRDF or more. Of a fit, its 95% interval is a band, and what its images do not
    /// constrain is grey. The last is the reference of spheres and differences
    #[arg(value_name = "BRDF", required = true)]
    brdf: Vec<String>,
    /// The picture: .png, or .svg for all but the spheres of a single BRDF
    #[arg(long, value_name = "FILE.png|FILE.svg")]
    out: PathBuf,
    /// What to draw
    #[arg(long, value_enum, default_value_t = Kind::Spheres)]
    kind: Kind,
    /// Angles of incidence of lobes, difference angles of slices (degrees, 0 to 89; default: 15,45,70 and 5,45,75)
    #[arg(long, value_name = "DEG,…", value_delimiter = ',', value_parser = angle_deg)]
    angles: Vec<f64>,
    /// Of lobes: a half disc, or the viewer's angle as an axis
    #[arg(long, value_enum, default_value_t = AxesArg::Polar)]
    axes: AxesArg,
    /// Channels of lobes and slices, such as `rg` (default: rgb of one BRDF, g of several)
    #[arg(long, value_parser = channel_letters)]
    channels: Option<String>,
    /// Pixels per side of each sphere, 8 to 512
    #[arg(long, default_value_t = material::DRAWN_SPHERE_PX, value_parser = within(8usize, 512))]
    size: usize,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Kind {
    /// Spheres under the four environment maps, a row for each BRDF
    Spheres,
    /// f in the plane of incidence, logarithmic
    Lobes,
    /// f over the half angle at fixed difference angles, logarithmic
    Slices,
    /// f over that of the last BRDF, over half and difference angle
    Difference,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum AxesArg {
    /// Over a half disc, as light leaves the surface
    Polar,
    /// Over the viewer's angle from the normal
    Cartesian,
}

fn angle_deg(text: &str) -> Result<f64, String> {
    match text.trim().parse() {
        Ok(angle) if (0.0..=89.0).contains(&angle) => Ok(angle),
        _ => Err("allowed are 0 to 89 degrees".to_owned()),
    }
}

fn channel_letters(text: &str) -> Result<String, String> {
    let is_letter = |c: char| "rgb".contains(c);
    let mut letters: Vec<char> = text.chars().collect();
    letters.sort_unstable();
    letters.dedup();
    match text.chars().all(is_letter)
        && (1..=3).contains(&text.len())
        && letters.len() == text.len()
    {
        true => Ok(text.to_owned()),
        false => Err("allowed are the letters r, g and b".to_owned()),
    }
}

/// Runs `rig brdf plot`.
pub fn run(args: &PlotArgs) -> Result<(), CliError> {
    if let ([spec], Kind::Spheres) = (args.brdf.as_slice(), args.kind) {
        return one_alone(spec, &args.out, args.size);
    }
    draw(args)
}

/// The spheres alone, without any text.
fn one_alone(spec: &str, path: &Path, size: usize) -> Result<(), CliError> {
    check_ending(path, "png")?;
    let brdf = material::load(spec).map_err(advise)?;
    material::spheres(brdf.as_ref(), size)
        .save(path)
        .map_err(|error| CliError::new(format!("{}: {error}", path.display())))
        .hint(hints::ANOTHER_FILE)?;
    write_path(path)
}

#[cfg(not(feature = "figures"))]
fn draw(_: &PlotArgs) -> Result<(), CliError> {
    Err(
        CliError::new("this program draws only the spheres of a single BRDF")
            .hint("build it with the feature `figures`"),
    )
}

#[cfg(feature = "figures")]
fn draw(args: &PlotArgs) -> Result<(), CliError> {
    use crate::cli::output::unwritable;
    use crate::material::Named;
    use crate::material::pictures::{self, Axes, Channel};
    use crate::whole_file;

    // What is asked for.
    let path = args.out.as_path();
    let is_svg = path
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("svg"));
    if !is_svg {
        check_ending(path, "png")?;
    }
    if args.kind == Kind::Difference && args.brdf.len() < 2 {
        return Err(CliError::new("a difference needs two BRDFs or more")
            .hint("name the reference last: `rig brdf plot FIT nbrdf:red-plastic --kind difference --out FILE.png`"));
    }
    let all: Vec<Named> = (args.brdf.iter())
        .map(|spec| Named::load(spec).map_err(advise))
        .collect::<Result<_, _>>()?;
    let usual = if all.len() == 1 { "rgb" } else { "g" };
    let letters = args.channels.as_deref().unwrap_or(usual);
    let channels: Vec<Channel> = letters
        .chars()
        .map(|letter| match letter {
            'r' => Channel::R,
            'g' => Channel::G,
            _ => Channel::B,
        })
        .collect();
    let angles = |usual: [f64; 3]| match args.angles.as_slice() {
        [] => usual.to_vec(),
        given => given.to_vec(),
    };

    // The picture.
    let figure = match args.kind {
        Kind::Spheres => pictures::sphere_rows(&all, args.size),
        Kind::Lobes => {
            let axes = match args.axes {
                AxesArg::Polar => Axes::Polar,
                AxesArg::Cartesian => Axes::Cartesian,
            };
            pictures::lobes(&all, &angles(pictures::INCIDENCE_DEG), &channels, axes)
        }
        Kind::Slices => pictures::slices(&all, &angles(pictures::DIFFERENCE_DEG), &channels),
        Kind::Difference => pictures::difference(&all),
    };
    let bytes = match is_svg {
        true => figure.svg()?.into_bytes(),
        false => figure.png()?,
    };
    whole_file::replace(path, |file| file.write_all(&bytes))
        .map_err(|error| unwritable(path, &error))?;
    write_path(path)
}
