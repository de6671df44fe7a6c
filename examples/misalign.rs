#![allow(unused, dead_code, missing_docs, clippy::all)]
pub use rig::{brdf, radiance_image, random, transport, frames, geometry, units};
#[path="../src/inverse/mod.rs"] pub mod inverse;
#[path="../src/evaluate/misalignment.rs"] pub mod misalignment;
use std::sync::Arc;
use glam::{DVec2, DVec3};
use rig::brdf::{Brdf, Dictionary, Mixture, source};
use misalignment::*;
use rig::geometry::Shape;
use inverse::{FitOptions, RefineOptions};
use rig::transport::*;
fn cpu() -> f64 {
    let t = std::fs::read_to_string("/proc/self/stat").unwrap();
    let f: Vec<&str> = t.rsplit(')').next().unwrap().split_whitespace().collect();
    (f[11].parse::<f64>().unwrap() + f[12].parse::<f64>().unwrap()) / 100.0
}
fn main() {
    tracing_subscriber::fmt().with_max_level(if std::env::var("V").is_ok() {tracing::Level::DEBUG} else {tracing::Level::WARN}).with_writer(std::io::stderr).init();
    let a: Vec<String> = std::env::args().collect();
    let (shape, material, size, lights, spp): (&str, &str, usize, usize, u32) = (&a[1], &a[2], a[3].parse().unwrap(), a[4].parse().unwrap(), a[5].parse().unwrap());
    let seeds: Vec<u64> = a[6].split(',').map(|s| s.parse().unwrap()).collect();
    let scale: f64 = a.get(7).map_or(1.0, |s| s.parse().unwrap());
    let tau: f64 = a.get(8).map_or(0.02, |s| s.parse().unwrap());
    let shape = |segments: u32| match shape {
        "bowl" => Shape::Bowl { radius_mm: 25.0, segments },
        "corner" => Shape::Tetrahedron { radius_mm: 25.0, depth_mm: 25.0 / 2f32.sqrt() },
        _ => Shape::Designed { radius_mm: 8.0, offset: 0.5, phi_min_deg: 45.0, form: rig::geometry::shapes::Form::Extruded, length_mm: 50.0, segments },
    };
    let camera = Camera::looking_at([size, size], Projection::Orthographic { extent_mm: DVec2::splat(54.0) }, DVec3::new(0., 0., 150.), DVec3::ZERO, DVec3::Y).unwrap();
    let dirs: Vec<DVec3> = (0..lights).map(|l| {
        let (az, el) = ([20f64, 110., 200., 290., 65., 155., 245., 335.][l].to_radians(), [80f64, 65., 50., 70., 75., 60., 45., 85.][l].to_radians());
        DVec3::new(az.cos() * el.cos(), az.sin() * el.cos(), el.sin())
    }).collect();
    let scene = |segments| {
        let ls = dirs.iter().map(|d| Light::Directional { to_light: *d, irradiance: [1.0; 3], angular_radius_rad: 0.0 }).collect();
        Scene::new(shape(segments).mesh().unwrap(), Shading::Smooth, camera, ls)
    };
    let dictionary = Arc::new(Dictionary::load("paper42").unwrap());
    let brdf: Box<dyn Brdf> = if let Some(w) = material.strip_prefix("mix:") {
        let mut x = vec![0.0; dictionary.len()];
        for p in w.split(',') { let (i, w) = p.split_once('=').unwrap(); x[i.parse::<usize>().unwrap()] = w.parse().unwrap(); }
        Box::new(Mixture::grey(dictionary.clone(), x).unwrap())
    } else { source::load(material).unwrap() };
    let mut fit = FitOptions { model_error: tau, draws: 0, ..FitOptions::default() };
    fit.cache.samples_per_pixel = spp;
    fit.cache.max_reflections = 12;
    let mut refine = RefineOptions::default();
    if let Ok(r) = std::env::var("ROUNDS") { refine.rounds = r.parse().unwrap(); }
    if let Ok(r) = std::env::var("RSPP") { refine.samples_per_pixel = r.parse().unwrap(); }
    if let Ok(r) = std::env::var("DSPP") { refine.derivative_samples = r.parse().unwrap(); }
    let settings = Settings { dictionary, fit, refine, true_samples: 1024, sphere_px: 48 };
    let (d, f) = (scene(128), scene(256));
    let mut zs = vec![];
    for seed in seeds {
        let t = cpu();
        let env = |k: &str, d: f64| std::env::var(k).map_or(d, |v| v.parse().unwrap());
        let mis = Misalignment { light_deg: 0.5 * scale, intensity: 0.02 * scale, rotation_deg: 0.3 * scale, translation_mm: 0.3 * scale };
        let truth = env("TRUTH", 1.0);
        let mut priors = mis.priors();
        priors.light_rad *= env("PL", 1.0); priors.intensity *= env("PI", 1.0); priors.rotation_rad *= env("PR", 1.0); priors.translation_mm *= env("PT", 1.0);
        let mis = Misalignment { light_deg: mis.light_deg * truth, intensity: mis.intensity * truth, rotation_deg: mis.rotation_deg * truth, translation_mm: mis.translation_mm * truth };
        let o = judge(&Case { described: &d, fine: &f, material: &*brdf, misalignment: mis, priors, seed }, &settings).unwrap();
        println!("seed {seed}: known {:.4} unrefined {:.4} ({:.2}x) refined {:.4} ({:.2}x) rounds {} settled {} chi2 {:.3?} refine {:.1}s total cpu {:.1}s", o.known, o.unrefined, o.unrefined / o.known, o.refined, o.refined / o.known, o.estimate.rounds, o.estimate.settled, o.estimate.reduced_chi2, o.refine_s, cpu() - t);
        if std::env::var("P").is_ok() {
            for (p, t) in o.estimate.parameters.iter().zip(&o.truth) {
                let (unit, k) = p.parameter.shown_in();
                println!("   {:24} true {:8.4} est {:8.4} ± {:.4} (prior {:.4}) {unit} z {:.2}", p.parameter.to_string(), t * k, p.value * k, p.deviation * k, p.prior_deviation * k, (p.value - t) / p.deviation);
            }
            println!("   held: {:?}", o.estimate.held);
        }
        zs.extend(o.estimate.parameters.iter().zip(&o.truth).map(|(p, t)| (p.value - t) / p.deviation));
    }
    println!("rms z {:.2}", (zs.iter().map(|z| z * z).sum::<f64>() / zs.len() as f64).sqrt());
}
