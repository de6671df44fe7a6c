//! Images on coarser and finer pixels, and how far a pose moves the sample in them.

use nalgebra::DVector;

use super::PoseOptions;
use super::patches::{SIDE, Target};
use super::regions::Grid;
use crate::bench_priors::BenchPriors;
use crate::inverse::nuisance::Nuisance;
use crate::radiance_image::RadianceImage;
use crate::transport::Scene;

/// Relative error of a region's smooth radiance that counts as noise.
const ROUGHNESS: f64 = 0.005;
/// How much of an image's bright end counts as noise everywhere.
const DARK: f64 = 1e-3;

/// Sizes of the pixels on which poses are compared, coarse first: on the coarsest the
/// sample is at most about a pixel away, the finest have at most the options' number.
pub fn factors(scene: &Scene, priors: &BenchPriors, options: &PoseOptions) -> Vec<usize> {
    let [width, height] = scene.camera.resolution_px;
    let bench = Nuisance::new(scene, priors);
    let off_px = bench
        .of_light(None)
        .into_iter()
        .map(|k| {
            let mut values = DVector::zeros(bench.parameters().len());
            values[k] = bench.prior_deviation(k);
            moved_px(&bench, &values).powi(2)
        })
        .sum::<f64>()
        .sqrt();
    let finest = width.max(height).div_ceil(options.widest_px.max(1));
    let coarsest = (width.min(height) / (4 * SIDE)).max(1);
    let mut factors = vec![finest];
    while let Some(&factor) = factors.last() {
        let next = 2 * factor;
        if off_px / factor as f64 <= 1.0 || next > coarsest {
            break;
        }
        factors.push(next);
    }
    factors.reverse();
    factors
}

/// Root mean square shift of the mesh's corners in the image against the description, in
/// the camera's pixels.
pub fn moved_px(bench: &Nuisance, values: &DVector<f64>) -> f64 {
    let described = bench.scene(&DVector::zeros(values.len()));
    let moved = bench.scene(values);
    let corners = &described.sample().positions_mm;
    let every = (corners.len() / 500).max(1);
    let squares: Vec<f64> = corners
        .iter()
        .step_by(every)
        .filter_map(|p| {
            let [a, b] = [&described, &moved].map(|s| s.camera.position_px(p.as_dvec3()));
            Some(a?.distance_squared(b?))
        })
        .collect();
    (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt()
}

/// The image on the grid, its channels together.
pub fn target(image: &RadianceImage, grid: Grid) -> Target {
    let n = 3.0 * (grid.factor * grid.factor) as f64;
    let mut mean = vec![0.0; grid.pixels()];
    let mut variance = mean.clone();
    let mut valid = vec![true; grid.pixels()];
    for pixel in 0..grid.pixels() {
        let [x, y] = [pixel % grid.width, pixel / grid.width].map(|i| i * grid.factor);
        for row in y..y + grid.factor {
            for column in x..x + grid.factor {
                let from = row * image.width + column;
                mean[pixel] += image.mean[from].iter().map(|&v| f64::from(v)).sum::<f64>() / n;
                let sum: f64 = image.variance[from].iter().map(|&v| f64::from(v)).sum();
                variance[pixel] += sum / (n * n);
                valid[pixel] &= image.valid[from];
            }
        }
    }
    let mut sorted = mean.clone();
    sorted.sort_by(f64::total_cmp);
    let bright = sorted[(sorted.len() - 1) * 99 / 100].max(0.0);
    let weight = (0..grid.pixels())
        .map(|p| {
            let model = (ROUGHNESS * mean[p]).powi(2) + (DARK * bright).powi(2);
            let all = variance[p] + model;
            let usable = valid[p] && mean[p].is_finite() && all.is_finite() && all > 0.0;
            if usable { 1.0 / all } else { 0.0 }
        })
        .collect();
    Target { mean, weight }
}
