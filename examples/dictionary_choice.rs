//! Chooses the atoms of a dictionary from a pool, by how well they explain measured
//! materials: how `rig26` came about (docs/adr/0013).
//!
//! `cargo run --release --example dictionary_choice -- 26 ggx beckmann coated` chooses 26
//! atoms, white and black among them, with lobes of the kinds that are named. Half of the
//! measure is the environment error, half the cube-root error linearised at the truth; the
//! training materials count, the others are held out. Atoms are added one by one, then
//! exchanged two by two while that helps.
#![expect(clippy::print_stdout, reason = "an example prints its result")]

use std::cmp::Ordering;
use std::error::Error;
use std::sync::Arc;

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use rig::brdf::environment::EnvironmentMap;
use rig::brdf::ggx::Cosines;
use rig::brdf::nbrdf::{NAMES, NeuralBrdf};
use rig::brdf::score::Cell;
use rig::brdf::sphere::{SphereMatrix, sphere_image, sphere_matrix};
use rig::brdf::{Atom, Dictionary, score};
use rig::evaluate::lab::materials::MIRRORS;
use rig::simplex::{Quadratic, SimplexError};

const TRAINING: [&str; 12] = [
    "alum-bronze",
    "black-oxidized-steel",
    "blue-acrylic",
    "blue-metallic-paint",
    "cherry-235",
    "dark-red-paint",
    "delrin",
    "gold-metallic-paint",
    "green-latex",
    "light-brown-fabric",
    "pink-jasper",
    "pvc",
];
const SPHERE_PX: usize = 24;
const AZIMUTHS: usize = 6;
/// Environment and cube-root errors that weigh alike.
const TYPICAL: [f64; 2] = [0.05, 0.2];
/// Best candidates by first-order gain that are tried in full.
const TRIED: usize = 10;

/// ½ of a material's squared errors, as quadratics in the weights, per channel.
struct Material {
    training: bool,
    environment: [Quadratic; 3],
    cube_root: [Quadratic; 3],
    both: [Quadratic; 3],
}

/// White and black, then lobes.
fn pool(kinds: &[String]) -> Vec<Atom> {
    let alphas = [
        0.01, 0.018, 0.03, 0.05, 0.075, 0.11, 0.15, 0.2, 0.27, 0.36, 0.5, 0.7, 1.0,
    ];
    let mut lobes = Vec::new();
    for alpha in alphas {
        let etas = [1.05, 1.1, 1.2, 1.35, 1.5, 1.8, 2.5, 5.0, 10.0, 20.0];
        lobes.extend(etas.map(|eta| Atom::Ggx { alpha, eta }));
        if alpha >= 0.03 {
            let etas = [1.1, 1.2, 1.35, 1.5, 1.8, 2.5, 5.0, 20.0];
            lobes.extend(etas.map(|eta| Atom::Beckmann { alpha, eta }));
        }
    }
    lobes.extend([1.1, 1.2, 1.3, 1.4, 1.5, 1.65, 1.8, 2.0, 2.5].map(|eta| Atom::Coated { eta }));
    lobes.retain(|atom| kinds.iter().any(|kind| kind == atom.kind()));
    let mut atoms = vec![Atom::Lambertian { albedo: 1.0 }, Atom::Black];
    atoms.extend(lobes);
    atoms
}

/// The least value over some atoms, and their weights.
fn least(q: &Quadratic, chosen: &[usize]) -> Result<(f64, DVector<f64>), SimplexError> {
    let n = chosen.len();
    let part = Quadratic {
        h: DMatrix::from_fn(n, n, |i, j| q.h[(chosen[i], chosen[j])]),
        g: DVector::from_fn(n, |i, _| q.g[chosen[i]]),
        c: q.c,
    };
    let x = part.minimise()?.x;
    Ok((part.value(&x).max(1e-9), x))
}

/// Mean logarithm of the materials' errors.
fn measure(materials: &[&Material], chosen: &[usize]) -> Result<f64, SimplexError> {
    let logarithms: Vec<f64> = materials
        .par_iter()
        .map(|material| Ok(floor2(&material.both, chosen)?.ln()))
        .collect::<Result<_, SimplexError>>()?;
    Ok(0.5 * logarithms.iter().sum::<f64>() / materials.len() as f64)
}

/// Sum of the channels' least values.
fn floor2(channels: &[Quadratic; 3], chosen: &[usize]) -> Result<f64, SimplexError> {
    let mut sum = 0.0;
    for q in channels {
        sum += least(q, chosen)?.0;
    }
    Ok(sum)
}

/// By how much each atom of the pool would lower the measure, to second order along the
/// line from the weights to that atom.
fn gains(materials: &[&Material], chosen: &[usize], n: usize) -> Result<Vec<f64>, SimplexError> {
    let mut gains = vec![0.0; n];
    for material in materials {
        let total = floor2(&material.both, chosen)?;
        for q in &material.both {
            let (_, x) = least(q, chosen)?;
            let mut weights = DVector::zeros(n);
            for (&atom, &x) in chosen.iter().zip(x.iter()) {
                weights[atom] = x;
            }
            let curved = &q.h * &weights;
            let slope = &q.g - &curved;
            let (along, own) = (slope.dot(&weights), weights.dot(&curved));
            for (atom, gain) in gains.iter_mut().enumerate() {
                let slope = slope[atom] - along;
                let curvature = q.h[(atom, atom)] + own - 2.0 * curved[atom];
                if slope > 0.0 && curvature > 0.0 {
                    let step = (slope / curvature).min(1.0);
                    *gain += step * (slope - 0.5 * curvature * step) / total;
                }
            }
        }
    }
    Ok(gains)
}

/// Of these choices the one with the least measure.
fn best_of(
    materials: &[&Material],
    choices: impl Iterator<Item = Vec<usize>>,
) -> Result<(f64, Vec<usize>), Box<dyn Error>> {
    let measured = choices
        .map(|choice| Ok((measure(materials, &choice)?, choice)))
        .collect::<Result<Vec<_>, SimplexError>>()?;
    let best = measured.into_iter().min_by(|a, b| a.0.total_cmp(&b.0));
    best.ok_or_else(|| "the pool has no more atoms".into())
}

fn with_one_more(
    materials: &[&Material],
    chosen: &[usize],
    n: usize,
) -> Result<(f64, Vec<usize>), Box<dyn Error>> {
    let gains = gains(materials, chosen, n)?;
    let mut order: Vec<usize> = (0..n).filter(|atom| !chosen.contains(atom)).collect();
    order.sort_by(|&a, &b| gains[b].total_cmp(&gains[a]));
    let tried = order.into_iter().take(TRIED);
    best_of(materials, tried.map(|atom| [chosen, &[atom]].concat()))
}

/// White and black stay.
fn with_one_less(
    materials: &[&Material],
    chosen: &[usize],
) -> Result<(f64, Vec<usize>), Box<dyn Error>> {
    let without = |left_out: usize| {
        let kept = chosen.iter().enumerate().filter(|(k, _)| *k != left_out);
        kept.map(|(_, &atom)| atom).collect()
    };
    best_of(materials, (2..chosen.len()).map(without))
}

/// Geometric means of the floors.
fn report(label: &str, materials: &[Material], chosen: &[usize]) -> Result<(), SimplexError> {
    print!("{label}, {} atoms:", chosen.len());
    for (group, training) in [("training", true), ("held out", false)] {
        let (mut environment, mut cube_root, mut count) = (0.0, 0.0, 0.0);
        for material in materials.iter().filter(|m| m.training == training) {
            environment += (2.0 * floor2(&material.environment, chosen)?).sqrt().ln();
            cube_root += (2.0 * floor2(&material.cube_root, chosen)?).sqrt().ln();
            count += 1.0;
        }
        let mean = |sum: f64| (sum / count).exp();
        print!(" {group} {:.4} {:.4}", mean(environment), mean(cube_root));
    }
    println!();
    Ok(())
}

/// cos θi·f of every atom, cells × atoms.
fn cell_matrix(pool: &Dictionary, cells: &[Cell]) -> DMatrix<f64> {
    let (n, evaluator) = (pool.len(), pool.evaluator());
    let mut columns = DMatrix::<f64>::zeros(n, cells.len());
    let by_cell = columns.as_mut_slice().par_chunks_mut(n).zip(cells);
    by_cell.for_each(|(column, cell)| {
        let (i, o) = (cell.to_light.to_array(), cell.to_viewer.to_array());
        if let Some(at) = Cosines::new(i, o) {
            let mut values = vec![0.0f32; n];
            evaluator.eval(&at, &mut values);
            for (entry, value) in column.iter_mut().zip(&values) {
                *entry = f64::from(value * at.cos_i);
            }
        }
    });
    columns.transpose()
}

fn scaled(scale: f64, q: &Quadratic) -> Quadratic {
    let mut sum = Quadratic::zero(q.g.len());
    sum.add_scaled(scale, q);
    sum
}

/// ½ Σ w (∛a − ∛b)² to first order about the truth b, over Σ w (∛b)².
fn cube_root(truth: &NeuralBrdf, cells: &[Cell], atoms: &DMatrix<f64>) -> [Quadratic; 3] {
    let values = score::cosine_weighted(truth, cells);
    let solid_angles = DVector::from_iterator(
        cells.len(),
        cells.iter().map(|cell| f64::from(cell.solid_angle)),
    );
    let mut reference2 = 0.0;
    let channels = [0, 1, 2].map(|c| {
        let b = DVector::from_iterator(cells.len(), values.iter().map(|v| f64::from(v[c])));
        reference2 += b.map(|b| b.max(0.0).cbrt().powi(2)).dot(&solid_angles);
        // Dark cells must not rule by their steep roots.
        let least = 1e-3 * b.mean();
        let slope2 = b
            .map(|b| b.max(least))
            .map(|b| (b.cbrt() / (3.0 * b)).powi(2));
        Quadratic::least_squares(atoms, &b, Some(&slope2.component_mul(&solid_angles)))
    });
    channels.map(|q| scaled(1.0 / reference2, &q))
}

fn environment(
    truth: &NeuralBrdf,
    maps: &[EnvironmentMap],
    spheres: &[SphereMatrix],
    grams: &[[DMatrix<f64>; 3]],
) -> [Quadratic; 3] {
    let n = spheres[0].channels[0].ncols();
    let mut sums = [0, 1, 2].map(|_| Quadratic::zero(n));
    for ((map, matrix), grams) in maps.iter().zip(spheres).zip(grams) {
        let image = sphere_image(truth, map, SPHERE_PX);
        let columns = [0, 1, 2].map(|c| matrix.column_of(&image, c));
        let reference2: f64 = columns.iter().map(DVector::norm_squared).sum();
        for (c, sum) in sums.iter_mut().enumerate() {
            let q = Quadratic {
                h: grams[c].clone(),
                g: matrix.channels[c].tr_mul(&columns[c]),
                c: 0.5 * columns[c].norm_squared(),
            };
            sum.add_scaled(1.0 / (maps.len() as f64 * reference2), &q);
        }
    }
    sums
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (count, kinds) = arguments.split_first().ok_or("usage: N KIND…")?;
    let count: usize = count.parse()?;
    let atoms = pool(kinds);
    let n = atoms.len();
    let pool = Arc::new(Dictionary::new("pool", atoms.clone())?);
    let maps = EnvironmentMap::all();
    let spheres: Vec<_> = maps
        .iter()
        .map(|map| sphere_matrix(&pool, map, SPHERE_PX))
        .collect();
    let grams: Vec<_> = spheres
        .iter()
        .map(|matrix| [0, 1, 2].map(|c| matrix.channels[c].tr_mul(&matrix.channels[c])))
        .collect();
    let cells = score::cells(AZIMUTHS);
    let matrix = cell_matrix(&pool, &cells);
    let materials: Vec<Material> = NAMES
        .into_par_iter()
        .filter(|name| !MIRRORS.contains(name))
        .filter_map(|name| Some((name, NeuralBrdf::named(name)?)))
        .map(|(name, truth)| {
            let environment = environment(&truth, &maps, &spheres, &grams);
            let cube_root = cube_root(&truth, &cells, &matrix);
            let both = [0, 1, 2].map(|c| {
                let mut sum = scaled(TYPICAL[0].powi(-2), &environment[c]);
                sum.add_scaled(TYPICAL[1].powi(-2), &cube_root[c]);
                sum
            });
            Material {
                training: TRAINING.contains(&name),
                environment,
                cube_root,
                both,
            }
        })
        .collect();
    let training: Vec<&Material> = materials.iter().filter(|m| m.training).collect();
    report("pool", &materials, &(0..n).collect::<Vec<_>>())?;
    let (mut value, mut chosen) = (f64::INFINITY, vec![0, 1]);
    while chosen.len() < count {
        (value, chosen) = with_one_more(&training, &chosen, n)?;
    }
    report("added", &materials, &chosen)?;
    loop {
        let (_, less) = with_one_less(&training, &chosen)?;
        let (_, less) = with_one_less(&training, &less)?;
        let (_, more) = with_one_more(&training, &less, n)?;
        let (next, other) = with_one_more(&training, &more, n)?;
        if next > value - 1e-4 {
            break;
        }
        (value, chosen) = (next, other);
    }
    report("exchanged", &materials, &chosen)?;
    let mut list: Vec<Atom> = chosen.iter().map(|&atom| atoms[atom]).collect();
    let key = |a: &Atom| (a.facets().is_none(), a.kind(), a.alpha(), a.eta());
    list.sort_by(|a, b| key(a).partial_cmp(&key(b)).unwrap_or(Ordering::Equal));
    let file = serde_json::json!({ "name": "chosen", "atoms": list });
    println!("{}", serde_json::to_string_pretty(&file)?);
    Ok(())
}
