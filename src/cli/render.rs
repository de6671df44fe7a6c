//! `rig render`: mean and variance images of a scene.

use std::path::{Path, PathBuf};

use super::output::{check_ending, check_writable, write_json, write_path};
use super::{CliError, Context, HintExt, preflight};
use crate::config::scene::SceneFile;
use crate::progress::Progress;
use crate::radiance_image::exr;
use crate::transport::{
    Remainder, RenderOptions, Steering, render_polarised, render_with_progress, suited_proposal,
    truncation_remainder,
};
use crate::workflow::coarse_facets;

/// Renders a scene file, one image per light.
#[derive(clap::Args, Debug)]
pub struct RenderArgs {
    /// Scene file with camera, lights, sample and [brdf]
    #[arg(long, value_name = "S")]
    scene: PathBuf,
    /// Image to write; with several lights X.exr becomes X_L000.exr, X_L001.exr, …
    #[arg(long, value_name = "EXR")]
    out: PathBuf,
    /// Light paths per pixel, 2 to 1000000
    #[arg(long, value_name = "N", default_value_t = 256, value_parser = clap::value_parser!(u32).range(2..=1_000_000))]
    spp: u32,
    /// Longest path in surface reflections (1 = direct only), 1 to 64
    #[arg(long, value_name = "K", default_value_t = 32, value_parser = clap::value_parser!(u32).range(1..=64))]
    max_reflections: u32,
    /// Seed of the light paths
    #[arg(long, value_name = "S", default_value_t = 0)]
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
    polarised: bool,
    max_reflections: u32,
    /// Light that longer paths would bring, per lamp.
    truncation: Vec<Remainder>,
}

/// Paths per pixel that estimate what the longest path cuts off.
const TRUNCATION_SAMPLES: u32 = 32;

/// The least share of the light that is worth a remark if it is cut off.
const TRUNCATION_REMARK: f64 = 1e-4;

/// A bar over the rows of pixels.
struct Rows<'a>(&'a indicatif::ProgressBar);

impl Progress for Rows<'_> {
    fn advance(&self, rows: usize) {
        self.0.inc(rows as u64);
    }
}

/// `rig render`.
pub fn run(args: &RenderArgs, context: &Context) -> Result<(), CliError> {
    check_ending(&args.out, "exr")?;
    let file = SceneFile::load(&args.scene)?;
    let Some(brdf) = &file.brdf else {
        return Err(CliError::new(format!("{}: [brdf] is missing", args.scene.display()))
            .hint("a scene that is rendered needs a [brdf] table: mixture, dictionary with weights, or table"));
    };
    let scene = file.scene()?;
    preflight::remark_on_scene(&scene, &file, context);
    if let Some(remark) = coarse_facets(&scene, &brdf.atoms()?) {
        context.warn(remark);
    }
    let brdf = brdf.load()?;
    let folder = args
        .out
        .parent()
        .filter(|p| !p.as_os_str().is_empty())
        .unwrap_or(Path::new("."));
    if !folder.is_dir() {
        return Err(
            CliError::new(format!("{} is not a folder", folder.display()))
                .hint("create it first, or choose another --out"),
        );
    }
    check_writable(&args.out)?;
    let polarised = args.polarised || file.polarised;
    let bar = context.bar(scene.camera.resolution_px[1] as u64, "rows");
    let mut options = RenderOptions {
        samples_per_pixel: args.spp,
        max_reflections: args.max_reflections,
        seed: args.seed,
        steering: Steering::default(),
        ..RenderOptions::default()
    };
    options.proposal = suited_proposal(&scene, &*brdf, &options);
    let progress = Rows(&bar);
    let images = if polarised {
        render_polarised(&scene, &*brdf, &options, &progress)
            .map_err(|error| CliError::new(error.to_string()))
            .hint("polarised light needs a [brdf] of GGX, Lambertian and black atoms, for known bodies too")?
    } else {
        render_with_progress(&scene, &*brdf, &options, &progress)
    };
    bar.finish_and_clear();
    let truncation =
        truncation_remainder(&scene, &*brdf, &options, TRUNCATION_SAMPLES.min(args.spp));
    for (light, cut) in truncation.iter().enumerate() {
        if cut.share > TRUNCATION_REMARK {
            context.note(format!(
                "light {light}: paths of more than {} reflections, not followed, would add {:.2}% ± {:.2}% of the light",
                args.max_reflections,
                100.0 * cut.share,
                100.0 * cut.standard_error
            ));
        }
    }
    let mut written = Vec::new();
    for (light, image) in images.iter().enumerate() {
        let path = if images.len() == 1 {
            args.out.clone()
        } else {
            numbered(&args.out, light)
        };
        exr::write(&path, image)?;
        if !args.json {
            write_path(&path)?;
        }
        written.push(path.display().to_string());
    }
    if args.json {
        write_json(&Answer {
            images: written,
            polarised,
            max_reflections: args.max_reflections,
            truncation,
        })?;
    }
    Ok(())
}

fn numbered(path: &Path, light: usize) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!("{stem}_L{light:03}.exr"))
}
