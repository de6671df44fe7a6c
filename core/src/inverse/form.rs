//! What the form error of an as-made surface adds to the covariance of the score.
//!
//! Deformations of the stated rms are drawn ([`FormError::field`]) and the images' change d
//! with each is traced with shared random numbers. The weights' score changes by JᵀWd;
//! the second moment of that over the samples is the covariance that the mesh adds, every
//! product taken between independent halves of the samples (docs/adr/0029).

use nalgebra::{DMatrix, DVector};

use super::normal_equations::with_eigenvalues;
use super::nuisance::derivatives::{AVERAGED, DerivativeImages, DerivativeOptions};
use super::objective::{Objective, ResidualWeights};
use crate::brdf::Mixture;
use crate::geometry::FormError;
use crate::random::{Purpose, stream};
use crate::transport::{Proposal, Scene, Steering};

/// Deformations that are drawn: the deviation that they give is itself known within an eighth.
const DEFORMATIONS: usize = 32;
/// Deformations that are traced together, which bounds the memory.
const BATCH: usize = 4;
/// Direct reflection: square root of the samples per cell.
const DIRECT_STRATA: u32 = 4;
/// Paths per cell in each half and for each deformation.
const SAMPLES_PER_HALF: u32 = 4;
/// Longest path in surface reflections.
const REFLECTIONS: u32 = 6;

/// Covariance of the score per channel group, N × N each, at `mixture`, whose BRDF is
/// `material`.
pub(super) fn score_covariance(
    objective: &Objective<'_>,
    scene: &Scene,
    error: &FormError,
    residual_weights: &ResidualWeights,
    mixture: &[DVector<f64>],
    material: &Mixture,
    seed: u64,
) -> Vec<DMatrix<f64>> {
    let (n, groups) = (objective.atoms(), objective.groups());
    let wanted = objective.compared_pixels();
    let edge_mm = scene.sample().mean_edge_mm();
    let options = DerivativeOptions {
        samples_per_half: SAMPLES_PER_HALF,
        max_reflections: REFLECTIONS,
        seed: stream(seed, Purpose::FormError, 1, 0, 0).bits(),
        proposal: Proposal::resembling(material, 0.3),
        steering: Steering::NONE,
        direct_strata: DIRECT_STRATA,
        average: AVERAGED,
    };
    let mut covariance = vec![DMatrix::zeros(n, n); groups];
    for first in (0..DEFORMATIONS).step_by(BATCH) {
        let deformed = (first..first + BATCH).map(|deformation| {
            let mut numbers = stream(seed, Purpose::FormError, 0, deformation as u64, 0);
            let field = error.field(edge_mm, &mut numbers);
            [1.0, -1.0].map(|sign| field.deform(scene.sample(), sign))
        });
        let images = DerivativeImages::of_shapes(
            scene,
            objective.cells(),
            deformed.collect(),
            material,
            &wanted,
            &options,
        );
        let scores = scores(objective, &images, residual_weights, mixture);
        for (covariance, scores) in covariance.iter_mut().zip(scores) {
            for [a, b] in scores {
                covariance.ger(0.5 / DEFORMATIONS as f64, &a, &b, 1.0);
                covariance.ger(0.5 / DEFORMATIONS as f64, &b, &a, 1.0);
            }
        }
    }
    // Not the rule of `above_noise`: a slight form error would vanish in whole, and eigenvalues
    // that are noise make intervals a little wider, not narrower.
    let positive = |covariance| with_eigenvalues(covariance, |v| v.max(0.0));
    covariance.into_iter().map(positive).collect()
}

/// JᵀWd per group, deformation and half.
fn scores(
    objective: &Objective<'_>,
    images: &DerivativeImages,
    residual_weights: &ResidualWeights,
    mixture: &[DVector<f64>],
) -> Vec<Vec<[DVector<f64>; 2]>> {
    let (n, groups) = (objective.atoms(), objective.groups());
    objective.accumulate(
        mixture,
        residual_weights,
        None,
        || vec![vec![[DVector::zeros(n), DVector::zeros(n)]; BATCH]; groups],
        |sums, value| {
            let changes = images.at(value.cell);
            for (deformation, _, change) in changes.filter(|(_, l, _)| *l == value.light) {
                for (half, sum) in sums[value.group][deformation].iter_mut().enumerate() {
                    let factor = value.weight * f64::from(change.halves[half][value.channel]);
                    for (sum, derivative) in sum.iter_mut().zip(value.by_weights[half]) {
                        *sum += factor * derivative;
                    }
                }
            }
        },
        |total, part| {
            let total = total.iter_mut().flatten().flatten();
            for (sum, part) in total.zip(part.into_iter().flatten().flatten()) {
                *sum += part;
            }
        },
    )
}

#[cfg(test)]
pub(super) mod tests {
    use std::sync::Arc;

    use glam::DVec3;

    use super::*;
    use crate::brdf::dictionary::{Atom, Dictionary};
    use crate::cells::{Captured, CellOptions};
    use crate::inverse::options::FitOptions;
    use crate::inverse::solve::{Paths, solve};
    use crate::radiance_image::RadianceImage;
    use crate::transport::{Light, RenderOptions, render};

    /// A bowl under two lights, photographed with this many cells per side.
    pub(in crate::inverse) fn bowl(cells: usize) -> Scene {
        let mut scene = Scene::bowl(48, [cells; 2], 2.2);
        let aside = DVec3::new(0.4, 0.1, 1.0);
        scene.lights.push(Light::distant(aside, [1.0; 3]));
        scene
    }

    /// Fits of samples with the stated form error scatter as the covariance says,
    /// at several angles. The images are made by the renderer, which shares nothing with
    /// the derivatives but the field; their noise is common and cancels.
    #[test]
    fn fits_of_deformed_samples_scatter_as_predicted() {
        let atoms = vec![
            Atom::Lambertian { albedo: 1.0 },
            Atom::Ggx {
                alpha: 0.3,
                eta: 1.5,
            },
            Atom::Black,
        ];
        let dictionary = Arc::new(Dictionary::new("three", atoms).unwrap());
        let weights = std::array::from_fn(|_| vec![0.4, 0.4, 0.2]);
        let truth = Mixture::new(dictionary.clone(), weights).unwrap();
        // On coarser images cells along the rim, where 1° is no small change, are outliers to the
        // fit, which scatters less than predicted.
        let scene = bowl(48);
        let photograph = |scene: &Scene| -> Vec<RadianceImage> {
            let options = RenderOptions {
                samples_per_pixel: 64,
                max_reflections: 3,
                seed: 71,
                proposal: Proposal::resembling(&truth, 0.1),
                ..RenderOptions::default()
            };
            render(scene, &truth, &options)
        };
        let mut options = FitOptions {
            rounds: 1,
            ..FitOptions::default()
        };
        options.cache.samples_per_cell = 64;
        options.cache.max_reflections = 3;
        let quiet = &();
        let averaged = |images: &[RadianceImage]| {
            Captured::new(&scene, images, &CellOptions::default()).unwrap()
        };
        let images = photograph(&scene);
        let cells = averaged(&images).cells;
        let paths = Paths::trace(&scene, &cells, &dictionary, None, &options, quiet).unwrap();
        let fitted = |images: &[RadianceImage]| {
            let images = averaged(images);
            let objective = paths.objective(&images, &options);
            solve(&paths, &objective, None, &options, &()).unwrap()
        };
        let base = fitted(&images);
        let images = averaged(&images);
        let objective = paths.objective(&images, &options);
        let error = FormError::new(0.004, 1f64.to_radians()).unwrap();
        let covariance = score_covariance(
            &objective,
            &scene,
            &error,
            &base.residual_weights,
            &base.mixture,
            &truth,
            5,
        );
        // Steps that keep the sum: two directions.
        let tangent = DMatrix::from_row_slice(3, 2, &[1.0, 0.0, 0.0, 1.0, -1.0, -1.0]);
        let information = tangent.tr_mul(&base.pass.information[1]) * &tangent;
        let answer = &tangent * information.try_inverse().unwrap() * tangent.transpose();

        let edge_mm = scene.sample().mean_edge_mm();
        let found: Vec<DVector<f64>> = (0..16)
            .map(|k| {
                let mut numbers = stream(9, Purpose::Experiment, 0, k, 0);
                let field = error.field(edge_mm, &mut numbers);
                let made = scene.deformed(field.deform(scene.sample(), 1.0));
                fitted(&photograph(&made)).mixture[1].clone()
            })
            .collect();
        for [theta_h, theta_d] in [[0.0, 10.0], [10.0, 20.0], [40.0, 30.0]] {
            let g = DVector::from_vec(dictionary.values_at(theta_h, theta_d));
            let predicted = g.dot(&(&answer * &covariance[1] * &answer * &g)).sqrt();
            let square = found.iter().map(|x| g.dot(&(x - &base.mixture[1])).powi(2));
            let seen = (square.sum::<f64>() / found.len() as f64).sqrt();
            println!("{theta_h}, {theta_d}: predicted {predicted:.3e}, seen {seen:.3e}");
            // Either is known within a fifth.
            assert!(
                (0.6..1.7).contains(&(predicted / seen)),
                "{predicted} for {seen}"
            );
        }
    }
}
