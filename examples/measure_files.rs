//! Measures a material from radiance images: `cargo run --release --example measure_files --
//! SCENE.toml OUT IMAGE.exr…`, one image for each light of the scene, in its order. Without
//! arguments the images are made first: a bowl of red plastic under one light.
#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "a program that prints its result"
)]

use std::path::{Path, PathBuf};

use rig::radiance_image::exr;
use rig::session::fit_record::Verdict;
use rig::workflow::{FitRequest, ImageFit, fit_images};
use rig_core::example;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    if arguments.is_empty() {
        arguments = made_up(&std::env::temp_dir().join("rig-measure-files"))?;
    }
    let [scene, out, images @ ..] = arguments.as_slice() else {
        return Err("usage: measure_files SCENE.toml OUT IMAGE.exr…".into());
    };

    // What is not chosen here is the library's default.
    let request = FitRequest {
        dictionary: Some("paper42".to_owned()),
        ..FitRequest::default()
    };
    let fitted = fit_images(ImageFit { scene, images, out }, &request, &())?;
    let record = &fitted.record;
    println!("{}", record.verdict().sentence());
    if record.verdict() == Verdict::NotToBeTrusted {
        return Ok(());
    }
    println!("wrote {}", fitted.folder.display());
    let table = &record.table;
    println!(
        "f in 1/sr with its 95% interval, red channel, difference angle {}°:",
        table.theta_d_deg[0]
    );
    let columns = table.theta_d_deg.len();
    let rows = table
        .theta_h_deg
        .iter()
        .zip(table.cells.iter().step_by(columns));
    for (theta_h_deg, f) in rows.step_by(5) {
        println!(
            "  half angle {theta_h_deg:5.1}° {:9.4} [{:.4}, {:.4}]",
            f.value[0], f.lower[0], f.upper[0]
        );
    }
    Ok(())
}

/// Scene, folder for the result, and image, in a folder for temporary files.
fn made_up(folder: &Path) -> Result<Vec<PathBuf>, Box<dyn std::error::Error>> {
    if folder.exists() {
        std::fs::remove_dir_all(folder)?;
    }
    std::fs::create_dir_all(folder)?;
    let scene = folder.join("bowl.toml");
    std::fs::write(&scene, example::BOWL)?;
    let image = folder.join("bowl.exr");
    exr::write(&image, &example::red_plastic(&example::bowl(), 256)[0])?;
    Ok(vec![scene, folder.join("fit"), image])
}
