//! Noise at equal time of the ways to find paths: the tables of
//! docs/measurements/sampling.md. `cargo run --release --bin sampling-strategies`.

use std::error::Error;
use std::sync::Arc;

use rig::brdf::{Atom, Dictionary, Mixture};
use rig::transport::Proposal;
use rig_benches::clock::thread_cpu_s;
use rig_benches::scenes;
use rig_benches::strategies::{Setting, Strategy};

const RESOLUTION_PX: usize = 24;
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
        let mut first: Vec<f64> = Vec::new();
        for (label, strategy, adapted) in [
            ("camera paths", Strategy::Camera, false),
            ("light paths", Strategy::Light, false),
            ("both, balance heuristic", Strategy::Both, false),
            ("camera paths, adapted", Strategy::Camera, true),
            ("light paths, adapted", Strategy::Light, true),
            ("both, adapted", Strategy::Both, true),
        ] {
            let mut cells = Vec::new();
            for (k, (_, material)) in materials.iter().enumerate() {
                let proposal = if adapted {
                    Proposal::resembling(material, DEFENSIVE)
                } else {
                    Proposal::default()
                };
                let cost = cost(&setting, strategy, material, &proposal);
                if first.len() == k {
                    first.push(cost);
                    cells.push(format!("{cost:.2e}"));
                } else {
                    cells.push(format!("{:.2}", first[k] / cost));
                }
            }
            println!("| {label} | {} |", cells.join(" | "));
        }
    }
    Ok(())
}

/// Mean over pixels of the variance, over the mean square of the image, times the CPU
/// seconds of one image: what one image would have after a second.
fn cost(setting: &Setting, strategy: Strategy, material: &Mixture, proposal: &Proposal) -> f64 {
    let start = thread_cpu_s();
    let images: Vec<Vec<f64>> = (0..IMAGES)
        .map(|seed| setting.image(strategy, material, proposal, PATHS, seed))
        .collect();
    let seconds = (thread_cpu_s() - start) / IMAGES as f64;
    let n = IMAGES as f64;
    let (mut variance, mut square) = (0.0, 0.0);
    for pixel in 0..setting.pixels() {
        let mean = images.iter().map(|i| i[pixel]).sum::<f64>() / n;
        let spread = images
            .iter()
            .map(|i| (i[pixel] - mean).powi(2))
            .sum::<f64>()
            / (n - 1.0);
        variance += spread;
        // Without the variance of the mean itself.
        square += mean * mean - spread / n;
    }
    variance / square * seconds
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
