//! `rig render`: mean and variance images of a scene.

use std::path::{Path, PathBuf};

use super::output::{check_ending, check_writable, write_json, write_path};
use super::progress::Counting;
use super::{CliError, Context, preflight};
use crate::rendering::{RenderError, RenderRequest, Rendering};
use crate::shown::nth;
use crate::transport::{Remainder, RenderOptions};
use crate::workflow::remark_on_facets;

/// Renders a scene file, one image per light.
#[derive(clap::Args, Debug)]
pub struct RenderArgs {
    /// Scene file with camera, lights, sample and [brdf]
    #[arg(long, value_name = "S")]
    scene: PathBuf,
    /// Image to write; with several lights X.exr becomes X_L000.exr, X_L001.exr, …
    #[arg(long, value_name = "EXR")]
    out: PathBuf,
    /// Material of this fit instead of [brdf]: its folder, or a session, whose latest is taken
    #[arg(long, value_name = "DIR")]
    fit: Option<PathBuf>,
    /// Also writes the standard deviation of each pixel over the fit's posterior samples, as R, G,
    /// B of an image that is numbered as --out
    #[arg(long, value_name = "EXR")]
    deviation: Option<PathBuf>,
    /// Light paths per pixel, 2 to 1000000
    #[arg(long, value_name = "N", default_value_t = RenderOptions::default().samples_per_pixel, value_parser = clap::value_parser!(u32).range(2..=1_000_000))]
    spp: u32,
    /// Longest path in surface reflections (1 = direct only), 1 to 64
    #[arg(long, value_name = "K", default_value_t = RenderOptions::default().max_reflections, value_parser = clap::value_parser!(u32).range(1..=64))]
    max_reflections: u32,
    /// Seed of the light paths
    #[arg(long, value_name = "S", default_value_t = RenderOptions::default().seed)]
    seed: u64,
    /// Follow polarisation: lamps are unpolarised, the camera measures intensity (also
    /// `polarised = true` under [render] in the scene file)
    #[arg(long)]
    polarised: bool,
    /// JSON instead of the images' names: also what the longest path cuts off, per light
    #[arg(long)]
    json: bool,
}

/// What `--json` prints.
#[derive(serde::Serialize)]
struct Answer {
    images: Vec<String>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    deviations: Vec<String>,
    polarised: bool,
    max_reflections: u32,
    /// Light that longer paths would bring, per lamp.
    truncation: Vec<Remainder>,
}

/// The least share of the light that is worth a remark if it is cut off.
const TRUNCATION_REMARK: f64 = 1e-4;

/// `rig render`.
pub fn run(args: &RenderArgs, context: &Context) -> Result<(), CliError> {
    let outputs = [Some(&args.out), args.deviation.as_ref()];
    for out in outputs.into_iter().flatten() {
        check_ending(out, "exr")?;
    }
    let request = RenderRequest {
        samples_per_pixel: args.spp,
        max_reflections: args.max_reflections,
        seed: args.seed,
        polarised: args.polarised,
        fit: args.fit.clone(),
        deviation: args.deviation.clone(),
        ..RenderRequest::new(&args.scene, &args.out)
    };
    // Before the work, what is wrong with the scene, and whether the result can be written.
    let rendering = Rendering::load(&request).map_err(advise)?;
    preflight::remark_on_scene(&rendering.scene, &rendering.file, context);
    if let Some(found) = &rendering.coarse_facets {
        context.warn(remark_on_facets(found));
    }
    for out in outputs.into_iter().flatten() {
        let folder = out.parent().filter(|p| !p.as_os_str().is_empty());
        let folder = folder.unwrap_or(Path::new("."));
        if !folder.is_dir() {
            let fact = format!("{} is not a folder", folder.display());
            return Err(CliError::new(fact)
                .hint("create it first, or choose another file with --out or --deviation"));
        }
        check_writable(out)?;
    }
    // The work.
    let bar = context.bar(rendering.rows() as u64, "rows");
    let rendered = rendering.run(&Counting(&bar));
    bar.finish_and_clear();
    let rendered = rendered.map_err(advise)?;
    for (light, cut) in rendered.truncation.iter().enumerate() {
        if cut.share > TRUNCATION_REMARK {
            context.note(format!(
                "{light}: paths of more than {} reflections, not followed, would add {:.2}% ± {:.2}% of the light",
                args.max_reflections,
                100.0 * cut.share,
                100.0 * cut.standard_error, light = nth("light", light)
            ));
        }
    }
    if args.json {
        let shown = |path: &PathBuf| path.display().to_string();
        return write_json(&Answer {
            images: rendered.images.iter().map(shown).collect(),
            deviations: rendered.deviations.iter().map(shown).collect(),
            polarised: rendered.polarised,
            max_reflections: args.max_reflections,
            truncation: rendered.truncation,
        });
    }
    let written = rendered.images.iter().chain(&rendered.deviations);
    written.into_iter().try_for_each(|path| write_path(path))
}

fn advise(error: RenderError) -> CliError {
    match error {
        RenderError::NoBrdf { .. } => CliError::from(error)
            .hint("a scene that is rendered needs a [brdf] table (mixture, dictionary with weights, table, or fit), or --fit"),
        RenderError::NoFit => CliError::from(error)
            .hint("name one by --fit, or by `fit` of the scene's [brdf]"),
        RenderError::NoSamples { .. } => CliError::from(error).hint("fit anew, which writes them"),
        RenderError::Fit(error) => error.into(),
        RenderError::Polarisation(_) => CliError::from(error)
            .hint("polarised light needs a [brdf] of GGX, Lambertian and black atoms, for known bodies too"),
        RenderError::Config(error) => error.into(),
        RenderError::Build(error) => error.into(),
        RenderError::Brdf(error) => error.into(),
        RenderError::Image(error) => error.into(),
    }
}
