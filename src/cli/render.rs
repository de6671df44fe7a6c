//! `rig render`: mean and variance images of a scene.

use std::path::{Path, PathBuf};

use super::{CliError, Context, HintExt, facets};
use crate::config::scene::SceneFile;
use crate::out;
use crate::radiance_image::exr;
use crate::transport::{RenderOptions, render};

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
}

/// `rig render`.
pub fn run(args: &RenderArgs, context: &Context) -> Result<(), CliError> {
    let file = SceneFile::load(&args.scene)?;
    let Some(brdf) = &file.brdf else {
        return Err(CliError::new(format!("{}: [brdf] is missing", args.scene.display()))
            .hint("a scene that is rendered needs a [brdf] table: mixture, dictionary with weights, or table"));
    };
    let scene = file.scene()?;
    facets::warn_if_coarse(&scene, &brdf.atoms()?, context);
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
    let bar = context.bar(scene.camera.resolution_px[1] as u64, "rows");
    let options = RenderOptions {
        samples_per_pixel: args.spp,
        max_reflections: args.max_reflections,
        seed: args.seed,
        ..RenderOptions::default()
    };
    let images = render(&scene, &*brdf, &options, &|rows| {
        bar.set_position(rows as u64)
    });
    bar.finish_and_clear();
    for (light, image) in images.iter().enumerate() {
        let path = if images.len() == 1 {
            args.out.clone()
        } else {
            numbered(&args.out, light)
        };
        exr::write(&path, image)
            .map_err(CliError::from)
            .hint("choose an --out in a folder that can be written")?;
        out!("{}", path.display())?;
    }
    Ok(())
}

fn numbered(path: &Path, light: usize) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!("{stem}_L{light:03}.exr"))
}
