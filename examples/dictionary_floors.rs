//! The table of docs/measurements/dictionaries.md: what each dictionary can say about
//! measured materials.
//!
//! `cargo run --release --example dictionary_floors -- [--merl FILE.binary …] [--bsdf FILE.bsdf …]
//! [--bivariate FILE.f32 …]` adds materials to the embedded ones; a bivariate file holds one
//! or more tables of 90 × 90 little-endian f32 over (θh, θd) in MERL's spacing, one channel.
#![expect(clippy::print_stdout, reason = "an example prints its table")]

use std::sync::Arc;

use rig::brdf::environment::EnvironmentMap;
use rig::brdf::nbrdf::{NAMES, NeuralBrdf};
use rig::brdf::projection::{CellMatrix, EnvironmentMatrix};
use rig::brdf::table::TabulatedBrdf;
use rig::brdf::{Brdf, Dictionary, score, source};

/// Azimuths of the cells: isotropic materials change little with φd.
const AZIMUTHS: usize = 4;
/// Pixels per side of the spheres, as `rig brdf project` has them: with 48 the floors of some
/// materials come out a sixth lower.
const SPHERE_PX: usize = 128;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut materials: Vec<(String, Box<dyn Brdf>)> = Vec::new();
    for name in NAMES {
        if let Some(network) = NeuralBrdf::named(name) {
            let table = TabulatedBrdf::tabulate([90, 90, 20], |angles| network.at(angles));
            materials.push((name.to_owned(), Box::new(table)));
        }
    }
    let mut arguments = std::env::args().skip(1);
    while let (Some(kind), Some(path)) = (arguments.next(), arguments.next()) {
        let stem = std::path::Path::new(&path)
            .file_stem()
            .map_or(String::new(), |s| s.to_string_lossy().into_owned());
        if kind == "--bivariate" {
            let bytes = std::fs::read(&path)?;
            let numbers: Vec<f32> = bytes
                .chunks_exact(4)
                .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
                .collect();
            for (k, table) in numbers.chunks_exact(90 * 90).enumerate() {
                let values = table.iter().map(|&v| [v; 3]).collect();
                let table = TabulatedBrdf::new([90, 90, 1], values)?;
                materials.push((format!("{stem} {k}"), Box::new(table)));
            }
        } else {
            materials.push((stem, source::load(&path)?));
        }
    }
    let maps = EnvironmentMap::all();
    let dictionaries: Vec<_> = ["paper42", "rig26"]
        .iter()
        .map(|name| {
            let dictionary = Arc::new(Dictionary::load(name)?);
            let spheres = EnvironmentMatrix::new(dictionary.clone(), &maps, SPHERE_PX);
            Ok((CellMatrix::new(dictionary, AZIMUTHS), spheres))
        })
        .collect::<Result<_, rig::brdf::BrdfError>>()?;
    println!("| material | paper42 | rig26 |\n|---|---|---|");
    let cells = score::cells(AZIMUTHS);
    for (name, truth) in &materials {
        let mut row = format!("| {name} |");
        for (matrix, spheres) in &dictionaries {
            let of = spheres.of(truth.as_ref());
            let reference = matrix.reference_projection(truth.as_ref())?;
            let root = score::brdf_errors(&reference, truth.as_ref(), &cells).cube_root;
            row += &format!(
                " {:.3} / {:.3} / {:.3} |",
                of.floor()?.0.mean.all,
                of.error(&reference).mean.all,
                root.all
            );
        }
        println!("{row}");
    }
    Ok(())
}
