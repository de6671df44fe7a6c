//! Scratch: fits of rendered images beside the reference projection.
use glam::{DVec2, DVec3};
use nalgebra::DVector;
use rig::brdf::environment::EnvironmentMap;
use rig::brdf::half_difference::HalfDifference;
use rig::brdf::nbrdf::{NAMES, NeuralBrdf};
use rig::brdf::table::TabulatedBrdf;
use rig::brdf::{Brdf, Dictionary, Mixture, in_span};
use rig::geometry::{Shape, shapes::Form};
use rig::inverse::Channels;
use rig::inverse::objective::{Linearised, Objective, ResidualWeights};
use rig::inverse::projection::{CellMatrix, EnvironmentMatrix};
use rig::inverse::simplex;
use rig::radiance_image::RadianceImage;
use rig::transport::render::quietest_proposal;
use rig::transport::*;
use std::collections::HashMap;
use std::sync::Arc;

struct Args(HashMap<String, String>);
impl Args {
    fn get<T: std::str::FromStr>(&self, key: &str, default: T) -> T {
        self.0
            .get(key)
            .and_then(|v| v.parse().ok())
            .unwrap_or(default)
    }
    fn text(&self, key: &str, default: &str) -> String {
        self.0.get(key).cloned().unwrap_or(default.into())
    }
}

fn scene(shape: &str, size: usize, lights: usize) -> Scene {
    let camera = Camera::looking_at(
        [size, size],
        Projection::Orthographic {
            extent_mm: DVec2::splat(2.2),
        },
        DVec3::new(0.0, 0.0, 5.0),
        DVec3::ZERO,
        DVec3::Y,
    )
    .unwrap();
    let (mesh, smooth) = match shape {
        "bowl" => (
            Shape::Bowl {
                radius_mm: 1.0,
                segments: 256,
            },
            true,
        ),
        "designed" => (
            Shape::Designed {
                radius_mm: 0.32,
                offset: 0.5,
                phi_min_deg: 45.0,
                form: Form::Extruded,
                length_mm: 2.0,
                segments: 256,
            },
            true,
        ),
        _ => (
            Shape::Tetrahedron {
                radius_mm: 1.0,
                depth_mm: std::f32::consts::FRAC_1_SQRT_2,
            },
            false,
        ),
    };
    let place = |theta: f64, phi: f64| {
        let (t, p) = (theta.to_radians(), phi.to_radians());
        DVec3::new(t.sin() * p.cos(), t.sin() * p.sin(), t.cos())
    };
    let directions: Vec<DVec3> = if shape == "corner" {
        vec![place(25.0, 20.0)]
    } else {
        vec![
            DVec3::Z,
            place(45.0, 20.0),
            place(45.0, 140.0),
            place(45.0, 260.0),
        ][..lights]
            .to_vec()
    };
    let lights = directions
        .into_iter()
        .map(|to_light| Light::Directional {
            to_light,
            irradiance: [1.0; 3],
            angular_radius_rad: 0.0,
        })
        .collect();
    Scene::new(
        mesh.mesh().unwrap(),
        if smooth {
            Shading::Smooth
        } else {
            Shading::Flat
        },
        camera,
        lights,
    )
}

fn minimise(
    objective: &Objective<'_>,
    weights: &ResidualWeights,
    mixture: &mut [DVector<f64>],
    settled: f64,
    tolerance: f64,
    prior: f64,
) -> (Linearised, usize) {
    let mut current = objective.linearise(mixture, weights);
    let mut damping = 1e-3;
    let n = mixture[0].len();
    let penalty =
        |m: &[DVector<f64>]| -> f64 { m.iter().map(|w| 0.5 * prior * w.norm_squared()).sum() };
    for step in 0..20 {
        let candidate: Vec<DVector<f64>> = mixture
            .iter()
            .zip(&current.quadratics)
            .map(|(w, q)| {
                let mut h = q.h.clone();
                for k in 0..n {
                    h[(k, k)] += damping * q.h[(k, k)] + prior;
                }
                let g = &q.g - w * prior + &h * w;
                simplex::solve(&h, &g, Some(w)).unwrap().x
            })
            .collect();
        let next = objective.linearise(&candidate, weights);
        let total = |p: &Linearised, m: &[DVector<f64>]| {
            p.quadratics.iter().map(|q| q.c).sum::<f64>() + penalty(m)
        };
        let (old, new) = (total(&current, mixture), total(&next, &candidate));
        if new <= old {
            for (m, c) in mixture.iter_mut().zip(candidate) {
                *m = c;
            }
            current = next;
            damping = (damping * 0.1f64).max(1e-9);
        } else {
            damping *= 10.0;
        }
        if (new - old).abs() < tolerance * old.abs() + settled || damping > 1e3 {
            return (current, step + 1);
        }
    }
    (current, 20)
}

fn main() {
    let args = Args(
        std::env::args()
            .skip(1)
            .map(|a| {
                let (k, v) = a.split_once('=').unwrap();
                (k.to_string(), v.to_string())
            })
            .collect(),
    );
    let clock = std::time::Instant::now();
    let (shape, size, lights) = (
        args.text("shape", "bowl"),
        args.get("size", 32),
        args.get("lights", 1),
    );
    let scene = scene(&shape, size, lights);
    let lights = scene.lights.len();
    let dictionary = Arc::new(Dictionary::load(&args.text("dictionary", "grid42")).unwrap());
    let in_span = args.text("set", "in") == "in";
    let dictionary = if in_span {
        Arc::new(Dictionary::paper42())
    } else {
        dictionary
    };
    let reflections = args.get("reflections", 16u32);
    let options = CacheOptions {
        samples_per_pixel: args.get("spp", 256),
        max_reflections: reflections,
        seed: 1,
        max_bytes: 2 << 30,
        ..CacheOptions::default()
    };
    let strata = args.get("strata", 16);
    let direct = DirectMatrix::new(&scene, &dictionary, strata, 1);
    let cache = Cache::trace(&scene, &dictionary, &options).unwrap();
    eprintln!(
        "traced {:.1} s, {} records",
        clock.elapsed().as_secs_f64(),
        cache.size().0
    );
    let truth_spp = args.get("truth", 1024u32);
    // the truth's images
    let from: usize = args.get("from", 0);
    let to: usize = args.get("to", 100);
    let step: usize = args.get("step", 1);
    let mut materials: Vec<(String, Box<dyn Brdf>, Vec<RadianceImage>)> = vec![];
    if in_span {
        let passes = (truth_spp / options.samples_per_pixel).max(1);
        let set: Vec<_> = in_span::set()
            .into_iter()
            .skip(from)
            .take(to - from)
            .step_by(step)
            .collect();
        let mut sums: Vec<Vec<Vec<[f64; 2]>>> =
            vec![vec![vec![[0.0; 2]; size * size]; lights]; set.len()];
        for pass in 0..passes {
            let cache = Cache::trace(
                &scene,
                &dictionary,
                &CacheOptions {
                    seed: 1000 + u64::from(pass),
                    ..options.clone()
                },
            )
            .unwrap();
            let direct = DirectMatrix::new(&scene, &dictionary, strata, 1000 + u64::from(pass));
            for (m, material) in set.iter().enumerate() {
                let w = material.mixture().weights()[0].clone();
                let parts = cache.evaluate(
                    Kernel::detect(),
                    &[&w],
                    Vec::new,
                    |part: &mut Vec<(usize, Vec<[f64; 2]>)>, rows| {
                        part.push((
                            rows.pixel,
                            (0..lights)
                                .map(|l| {
                                    let d: f64 = direct
                                        .row(rows.pixel, l)
                                        .iter()
                                        .zip(&w)
                                        .map(|(&d, &w)| f64::from(d) * w)
                                        .sum();
                                    [
                                        d + 0.5 * f64::from(rows.value[0][l] + rows.value[1][l]),
                                        f64::from(rows.variance[l]),
                                    ]
                                })
                                .collect(),
                        ));
                    },
                );
                for (pixel, values) in parts.into_iter().flatten() {
                    for l in 0..lights {
                        for k in 0..2 {
                            sums[m][l][pixel][k] += values[l][k];
                        }
                    }
                }
            }
        }
        for (m, material) in set.into_iter().enumerate() {
            let images = (0..lights)
                .map(|l| {
                    let mut image = RadianceImage::new(size, size);
                    for p in 0..size * size {
                        let n = f64::from(passes);
                        image.mean[p] = [(sums[m][l][p][0] / n) as f32; 3];
                        image.variance[p] = [(sums[m][l][p][1] / (n * n)) as f32; 3];
                    }
                    image
                })
                .collect();
            materials.push((material.name.clone(), Box::new(material.mixture()), images));
        }
    } else {
        let mut all: Vec<(String, Box<dyn Brdf>)> = vec![];
        for name in NAMES.iter().skip(from).take(to - from).step_by(step) {
            let network = NeuralBrdf::named(name).unwrap();
            all.push((
                name.to_string(),
                Box::new(TabulatedBrdf::tabulate(
                    [90, 90, 20],
                    |a: HalfDifference| network.at(a),
                )),
            ));
        }
        for (name, brdf) in all {
            let render_options = RenderOptions {
                samples_per_pixel: truth_spp,
                max_reflections: reflections,
                seed: 77,
                proposal: Proposal::default(),
            };
            let proposal = quietest_proposal(
                &scene,
                brdf.as_ref(),
                &render_options,
                vec![
                    Proposal::default(),
                    Proposal {
                        cosine: 0.6,
                        lobes: vec![(0.1, 0.2), (0.3, 0.2)],
                    },
                ],
            );
            let images = render(
                &scene,
                brdf.as_ref(),
                &RenderOptions {
                    proposal,
                    ..render_options
                },
                &|_| {},
            );
            materials.push((name, brdf, images));
        }
    }
    eprintln!("truth {:.1} s", clock.elapsed().as_secs_f64());
    let maps = EnvironmentMap::all();
    let spheres = EnvironmentMatrix::new(dictionary.clone(), &maps, args.get("sphere", 48));
    let cells = (!in_span).then(|| CellMatrix::new(dictionary.clone(), 4));
    eprintln!("spheres {:.1} s", clock.elapsed().as_secs_f64());
    let channels = if in_span {
        Channels::Shared
    } else {
        Channels::Separate
    };
    let (mut errors, mut ratios) = (vec![], vec![]);
    for (name, truth, images) in &materials {
        let same;
        let images = if args.get("same", 0) == 1 {
            let w = in_span::set()
                .into_iter()
                .find(|m| m.name == *name)
                .unwrap()
                .mixture()
                .weights()[0]
                .clone();
            let parts = cache.evaluate(
                Kernel::detect(),
                &[&w],
                Vec::new,
                |part: &mut Vec<Vec<f64>>, rows| {
                    part.push(
                        (0..lights)
                            .map(|l| {
                                let d: f64 = direct
                                    .row(rows.pixel, l)
                                    .iter()
                                    .zip(&w)
                                    .map(|(&d, &w)| f64::from(d) * w)
                                    .sum();
                                d + 0.5 * f64::from(rows.value[0][l] + rows.value[1][l])
                            })
                            .collect(),
                    );
                },
            );
            same = (0..lights)
                .map(|l| {
                    let mut i = RadianceImage::new(size, size);
                    for (p, v) in parts.iter().flatten().enumerate() {
                        i.mean[p] = [v[l] as f32; 3];
                    }
                    i
                })
                .collect::<Vec<_>>();
            &same
        } else {
            images
        };
        let tau = args.get("tau", 0.02);
        let rounds = args.get("rounds", 3);
        let mut info = String::new();
        if args.get("fit", 0) == 1 {
            let options = rig::inverse::FitOptions {
                cache: options.clone(),
                direct_strata: strata,
                channels,
                model_error: tau,
                draws: 0,
                refine: rig::inverse::Refine {
                    adapt_paths: args.get("adapt", 0) > 0,
                    rounds: args.get("refine", 0),
                },
                ..Default::default()
            };
            let start = std::time::Instant::now();
            let fit =
                rig::inverse::fit(&scene, images, &dictionary, &options, &mut |_| {}).unwrap();
            let fitted = Mixture::new(fit.dictionary.clone(), fit.weights.clone()).unwrap();
            let error = rig::brdf::score::environment_error(
                &fitted,
                truth.as_ref(),
                &maps,
                args.get("sphere", 48),
            )
            .mean
            .all;
            errors.push(error);
            if let Some(cells) = &cells {
                let of = spheres.of(truth.as_ref());
                let reference = of
                    .error(&cells.reference_projection(truth.as_ref()).unwrap())
                    .mean
                    .all;
                ratios.push(error / reference);
                println!(
                    "{name:24} {error:.4} reference {reference:.4} floor {:.4} ratio {:.2} {} {:.1} s",
                    of.floor().unwrap().0.mean.all,
                    error / reference,
                    fit.dictionary.name(),
                    start.elapsed().as_secs_f64()
                );
            } else {
                println!(
                    "{name:24} {error:.4} {} {:.1} s",
                    fit.dictionary.name(),
                    start.elapsed().as_secs_f64()
                );
            }
            continue;
        }
        let mut mixture: Option<Vec<DVector<f64>>> = None;
        let mut adapted: Option<(Cache, DirectMatrix)> = None;
        for outer in 0..=args.get("adapt", 0) {
            if outer > 0 {
                let m = mixture.as_ref().unwrap();
                let now = Mixture::new(
                    dictionary.clone(),
                    std::array::from_fn(|c| m[c.min(m.len() - 1)].as_slice().to_vec()),
                )
                .unwrap();
                let proposal = Proposal::resembling(&now, args.get("defensive", 0.4));
                let o = CacheOptions {
                    proposal,
                    samples_per_pixel: args.get("adaptspp", options.samples_per_pixel),
                    ..options.clone()
                };
                adapted = Some((
                    Cache::trace(&scene, &dictionary, &o).unwrap(),
                    DirectMatrix::new(&scene, &dictionary, strata, 1),
                ));
            }
            let (cache, direct) = adapted.as_ref().map_or((&cache, &direct), |(c, d)| (c, d));
            let objective =
                Objective::new(cache, direct, images, None, channels, Kernel::detect(), tau);
            let mut weights = match &mixture {
                None => objective.weights(None),
                Some(m) => {
                    let w = objective.weights(None);
                    objective.weights(Some(&objective.linearise(m, &w).model))
                }
            };
            if mixture.is_none() {
                mixture = Some(
                    objective
                        .single_bounce(&weights)
                        .iter()
                        .map(|q| q.minimise().unwrap().x)
                        .collect(),
                );
            }
            let mixture = mixture.as_mut().unwrap();
            for round in 0..rounds {
                let pass = minimise(
                    &objective,
                    &weights,
                    mixture,
                    args.get("settled", 0.5),
                    args.get("tolerance", 1e-3),
                    args.get("prior", 0.0),
                );
                let count: usize = (0..lights)
                    .map(|l| {
                        (0..size * size)
                            .filter(|&p| objective.is_compared(l, p))
                            .count()
                    })
                    .sum();
                if round + 1 < rounds {
                    weights = objective.weights(Some(&pass.0.model));
                } else {
                    info += &format!(
                        " loss {} ({})",
                        pass.0
                            .quadratics
                            .iter()
                            .map(|q| format!(
                                "{:.3}",
                                2.0 * q.c / count as f64 * if in_span { 1.0 / 3.0 } else { 1.0 }
                            ))
                            .collect::<Vec<_>>()
                            .join(" "),
                        pass.1
                    );
                }
            }
        }
        let mixture = mixture.unwrap();
        let fitted = Mixture::new(
            dictionary.clone(),
            std::array::from_fn(|c| mixture[c.min(mixture.len() - 1)].as_slice().to_vec()),
        )
        .unwrap();
        let of = spheres.of(truth.as_ref());
        let error = of.error(&fitted).mean.all;
        errors.push(error);
        if let Some(cells) = &cells {
            let reference = of
                .error(&cells.reference_projection(truth.as_ref()).unwrap())
                .mean
                .all;
            let floor = of.floor().unwrap().0.mean.all;
            ratios.push(error / reference);
            println!(
                "{name:24} {error:.4} reference {reference:.4} floor {floor:.4} ratio {:.2} {info}",
                error / reference
            );
        } else {
            println!("{name:24} {error:.4} {info}");
        }
    }
    let stats = |v: &mut Vec<f64>| {
        v.sort_by(f64::total_cmp);
        format!(
            "mean {:.4} median {:.4} max {:.4}",
            v.iter().sum::<f64>() / v.len() as f64,
            v[v.len() / 2],
            v[v.len() - 1]
        )
    };
    println!(
        "{shape} {size} lights {lights} errors {}",
        stats(&mut errors)
    );
    if !ratios.is_empty() {
        println!("ratios {}", stats(&mut ratios));
    }
    eprintln!("done {:.1} s", clock.elapsed().as_secs_f64());
}
