//! Renders a scene in a material and says how much of the light has met the surface more than
//! once: `cargo run --release -p rig-core --example render -- SCENE.toml MATERIAL OUT`, one
//! image `OUT_L000.exr`, … for each light. Without arguments, the example's bowl in matte
//! white.
#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "a program that prints its result"
)]

use std::path::{Path, PathBuf};

use rig_core::radiance_image::exr;
use rig_core::{RadianceImage, RenderOptions, SceneFile, brdf, render};

/// Mean over the pixels that are valid, all channels together.
fn mean(image: &RadianceImage) -> f64 {
    let seen = image
        .mean
        .iter()
        .zip(&image.valid)
        .filter(|(_, valid)| **valid);
    let sums = seen.map(|(radiance, _)| f64::from(radiance.iter().sum::<f32>()));
    sums.sum::<f64>() / image.mean.len() as f64
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let bowl = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/bowl.toml");
    let scene_file = arguments.next().map_or(bowl, PathBuf::from);
    let material = arguments
        .next()
        .unwrap_or("nbrdf:white-diffuse-bball".to_owned());
    let out = arguments.next();

    let scene = SceneFile::load(&scene_file)?.scene()?;
    let material = brdf::load(&material)?;
    let all = RenderOptions::default();
    let direct = RenderOptions {
        max_reflections: 1,
        ..all.clone()
    };
    let images = render(&scene, &*material, &all);
    let direct_images = render(&scene, &*material, &direct);
    for (light, (image, direct)) in images.iter().zip(&direct_images).enumerate() {
        let indirect = 1.0 - mean(direct) / mean(image);
        println!(
            "light {light}: {:.1}% of the light that is seen was reflected more than once",
            100.0 * indirect
        );
        if let Some(out) = &out {
            let file = format!("{out}_L{light:03}.exr");
            exr::write(Path::new(&file), image)?;
            println!("wrote {file}");
        }
    }
    Ok(())
}
