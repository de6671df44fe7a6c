//! Noise at equal time of several path sampling strategies: the tables of
//! docs/measurements/sampling.md. `cargo run --release --bin sampling-strategies`.

use std::error::Error;
use std::sync::Arc;

use rig::brdf::{Atom, Dictionary, Mixture};
use rig::transport::Proposal;
use rig_benches::clock::thread_cpu_s;
use rig_benches::scenes;
use rig_benches::strategies::{Setting, Strategy};

const RESOLUTION_PX: usize = 20;
const PATHS: u32 = 32;
const IMAGES: u64 = 8;
const LONGEST: u32 = 8;
/// Share of the default proposal in an adapted one.
const DEFENSIVE: f32 = 0.1;

fn main() -> Result<(), Box<dyn Error>> {
    let materials = materials()?;
    println!(
        "{RESOLUTION_PX}² pixels, {PATHS} paths per pixel, {IMAGES} images, 2 to {LONGEST} reflections. \
        First row: relative variance × CPU seconds; others: how many times less."
    );
    for (name, mesh, lamp_deg) in [
        ("bowl, coaxial lamp", scenes::bowl()?, 0.0),
        ("bowl, lamp at 30°", scenes::bowl()?, 30.0),
        ("corner, lamp at 25°", scenes::corner()?, 25.0),
        ("designed, coaxial lamp", scenes::designed()?, 0.0),
    ] {
        let scene = scenes::scene(mesh, RESOLUTION_PX, &[lamp_deg]);
        let setting = Setting::new(scene, LONGEST).ok_or("not a measurable scene")?;
        let head: Vec<&str> = materials.iter().map(|m| m.0.as_str()).collect();
        println!("\n| {name} | {} |", head.join(" | "));
        println!("|---|{}", "---:|".repeat(head.len()));
        let strategies = [
            ("camera paths", Strategy::Camera, false),
            ("light paths", Strategy::Light, false),
            ("both, balance heuristic", Strategy::Both, false),
            ("camera paths, adapted", Strategy::Camera, true),
            ("both, adapted", Strategy::Both, true),
        ];
        // cells[strategy][material]
        let mut cells = vec![Vec::new(); strategies.len()];
        for (_, material) in &materials {
            let found: Vec<Found> = strategies
                .iter()
                .map(|&(_, strategy, adapted)| {
                    let proposal = if adapted {
                        Proposal::resembling(material, DEFENSIVE)
                    } else {
                        Proposal::default()
                    };
                    measure(&setting, strategy, material, &proposal)
                })
                .collect();
            // The quietest strategy's square for all: a noisy one's is mostly noise.
            let square = found[found.len() - 1].square;
            let first = found[0].variance * found[0].seconds;
            cells[0].push(format!("{:.1e}", first / square));
            for (cells, found) in cells[1..].iter_mut().zip(&found[1..]) {
                cells.push(format!("{:.2}", first / (found.variance * found.seconds)));
            }
        }
        for ((label, ..), cells) in strategies.iter().zip(&cells) {
            println!("| {label} | {} |", cells.join(" | "));
        }
    }
    Ok(())
}

/// What images of one strategy show: the sum over pixels of the variance of one image
/// and of the squared mean, and the CPU seconds of one image.
struct Found {
    variance: f64,
    square: f64,
    seconds: f64,
}

fn measure(
    setting: &Setting,
    strategy: Strategy,
    material: &Mixture,
    proposal: &Proposal,
) -> Found {
    let start = thread_cpu_s();
    let images: Vec<Vec<f64>> = (0..IMAGES)
        .map(|seed| setting.image(strategy, material, proposal, PATHS, seed))
        .collect();
    let n = IMAGES as f64;
    let mut found = Found {
        variance: 0.0,
        square: 0.0,
        seconds: (thread_cpu_s() - start) / n,
    };
    for pixel in 0..setting.pixels() {
        let mean = images.iter().map(|i| i[pixel]).sum::<f64>() / n;
        let spread = images
            .iter()
            .map(|i| (i[pixel] - mean).powi(2))
            .sum::<f64>()
            / (n - 1.0);
        found.variance += spread;
        // Without the variance of the mean itself.
        found.square += mean * mean - spread / n;
    }
    found
}

fn materials() -> Result<Vec<(String, Mixture)>, Box<dyn Error>> {
    let mut materials = Vec::new();
    for eta in [20.0, 1.5] {
        for alpha in [0.02, 0.06, 0.17, 0.45] {
            let dictionary = Dictionary::new("one", vec![Atom::Ggx { alpha, eta }])?;
            let mixture = Mixture::grey(Arc::new(dictionary), vec![1.0])?;
            materials.push((format!("α {alpha}, η {eta}"), mixture));
        }
    }
    let enamel = vec![
        Atom::Ggx {
            alpha: 0.06,
            eta: 1.5,
        },
        Atom::Lambertian { albedo: 1.0 },
        Atom::Black,
    ];
    let metal = vec![
        Atom::Ggx {
            alpha: 0.06,
            eta: 20.0,
        },
        Atom::Ggx {
            alpha: 0.2,
            eta: 20.0,
        },
        Atom::Black,
    ];
    for (name, atoms, weights) in [
        ("enamel", enamel, vec![0.4, 0.5, 0.1]),
        ("brushed metal", metal, vec![0.3, 0.5, 0.2]),
    ] {
        let dictionary = Arc::new(Dictionary::new(name, atoms)?);
        materials.push((name.to_owned(), Mixture::grey(dictionary, weights)?));
    }
    Ok(materials)
}
