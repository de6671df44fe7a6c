//! Fits a dictionary to images of a scene: `cargo run --release -p rig-core --example fit_images
//! -- SCENE.toml IMAGE.exr…`, one image per light of the scene. Without arguments the images
//! are rendered of a measured material, and the fit is compared with it.
#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "a program that prints its result"
)]

use std::path::{Path, PathBuf};

use rig_core::brdf;
use rig_core::radiance_image::exr;
use rig_core::{
    Captured, CellOptions, Dictionary, FitOptions, Progress, RenderOptions, SceneFile, inverse,
    render,
};

/// Prints the phases of the fit.
struct Phases;

impl Progress for Phases {
    fn begin(&self, phase: &str, _: Option<usize>) {
        println!("… {phase}");
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/bowl.toml");
    let (scene_file, image_files) = match arguments.split_first() {
        Some((scene, images)) => (scene.as_path(), images),
        None => (example.as_path(), &[][..]),
    };
    let scene = SceneFile::load(scene_file)?.scene()?;
    let truth = brdf::load("nbrdf:red-plastic")?;
    let images = match image_files {
        [] => render(&scene, &*truth, &RenderOptions::default()),
        files => files
            .iter()
            .map(|file| Ok(exr::read(file)?.image))
            .collect::<Result<Vec<_>, exr::ExrError>>()?,
    };

    // The images are averaged over cells as large as the scene's angles allow, then fitted.
    let dictionary = Dictionary::load("rig65")?;
    let captured = Captured::new(&scene, &images, &CellOptions::default())?;
    let options = FitOptions::default();
    let found = inverse::fit_with_progress(&scene, &captured, &dictionary, &options, &Phases)?;

    println!("weights of {} (R, G, B):", dictionary.name());
    let [r, g, b] = found.material.mixture.weights();
    for (n, atom) in found
        .material
        .mixture
        .dictionary()
        .atoms()
        .iter()
        .enumerate()
    {
        if r[n].max(g[n]).max(b[n]) > 0.01 {
            println!("  {:.3} {:.3} {:.3}  {atom:?}", r[n], g[n], b[n]);
        }
    }
    println!("f in 1/sr, red channel, with its 95% interval:");
    for theta_h_deg in [0.0, 5.0, 15.0, 40.0] {
        let f = found.interval(theta_h_deg, 20.0);
        println!(
            "  half angle {theta_h_deg:4}°: {:8.4}  [{:.4}, {:.4}]",
            f.value[0], f.lower[0], f.upper[0]
        );
    }
    if image_files.is_empty() {
        let at = brdf::HalfDifference {
            theta_h_rad: 15f64.to_radians(),
            theta_d_rad: 20f64.to_radians(),
            phi_d_rad: std::f64::consts::FRAC_PI_2,
        };
        let (to_light, to_viewer) = at.to_directions();
        let f = truth.eval(to_light.as_vec3(), to_viewer.as_vec3());
        println!("the material rendered has {:.4} at 15°", f[0]);
    }
    Ok(())
}
