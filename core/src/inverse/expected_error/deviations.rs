//! The error that a wrong description of the bench adds to the expected one.

use std::sync::Arc;

use nalgebra::DVector;
use rayon::prelude::*;

use super::{PredictionError, PredictionOptions, Prospect, Subject, Traced, grid_of, unit, white};
use crate::brdf::Mixture;
use crate::brdf::discrepancy::{Material, Prior};
use crate::inverse::objective::{DiscrepancyModel, ModelImage, Objective, ResidualWeights};
use crate::transport::Scene;

/// A true scene that differs from its description in one parameter.
pub struct Deviation {
    /// The true scene; its lights stand in the order of the description's.
    pub scene: Scene,
    /// Factor of the squared error: 1/k² where the parameter is off by k standard deviations,
    /// divided by n where n scenes are drawn at random for one parameter.
    pub weight: f64,
    /// Whether each light's error is independent of the others'.
    pub by_light: bool,
}

/// For each material the environment error √(Σ bᵀ E b) of a fit that takes the description for true.
///
/// Δ is the true image less the described one, b = C Jᵀ W Δ the resulting error of ln f; C, J, W and E
/// are those of the expected error, to which the result adds in squares. The two b of a product have Δ
/// from independent paths, so that noise of the paths does not add up.
///
/// # Errors
/// Bodies that cannot be taken into account.
pub fn error_by_deviations(
    scene: &Scene,
    deviations: &[Deviation],
    subjects: &[Arc<Subject>],
    options: &PredictionOptions,
) -> Result<Vec<f64>, PredictionError> {
    let grid = grid_of(scene);
    let other_paths = PredictionOptions {
        seed: options.seed.wrapping_add(0x5eed),
        ..options.clone()
    };
    let pairs = [options, &other_paths].map(|options| -> Result<_, PredictionError> {
        let own = Traced::new(scene, grid.clone(), options)?;
        let others: Result<Vec<Traced>, _> = deviations
            .par_iter()
            .map(|deviation| Traced::new(&deviation.scene, grid.clone(), options))
            .collect();
        Ok((own, others?))
    });
    let [first, second] = pairs;
    let (first, second) = (first?, second?);
    let mixture = Mixture::grey(white()?, vec![1.0])?;
    let of_subject = |subject: &Arc<Subject>| {
        // True images less described ones, by either set of paths.
        let material = Material::new(mixture.clone(), std::slice::from_ref(&subject.ln_f));
        let prior = &subject.prior;
        // Images of the material in a scene, by the paths traced there.
        let images = |traced: &Traced, scene: &Scene| {
            let plain = traced.objective(options);
            let model = DiscrepancyModel::of_all(&plain, scene, &material, prior, options.seed);
            let all = plain.with_discrepancy(&model).modelled(&unit());
            all.iter().map(values).collect::<Vec<_>>()
        };
        let differences = |(own, others): &(Traced, Vec<Traced>)| -> Vec<Vec<Vec<f64>>> {
            let described = images(own, scene);
            let of = |(traced, deviation): (&Traced, &Deviation)| {
                let true_images = images(traced, &deviation.scene);
                let pairs = true_images.iter().zip(&described);
                pairs
                    .map(|(a, b)| a.iter().zip(b).map(|(a, b)| a - b).collect())
                    .collect()
            };
            others.iter().zip(deviations).map(of).collect()
        };
        let differences = [differences(&first), differences(&second)];

        // What the fit's estimate makes of them.
        let plain = first.0.objective(options);
        let model = DiscrepancyModel::of_compared(&plain, scene, &material, prior, options.seed);
        let objective = plain.with_discrepancy(&model);
        let weights = super::residual_weights(&objective, options);
        let information = super::of_lights(&objective, prior, &model, &weights);
        let prospect = Prospect {
            subject: subject.clone(),
            information: information.into_iter().map(super::above_noise).collect(),
        };
        let all: Vec<usize> = (0..scene.lights.len()).collect();
        let covariance = prospect.covariance(&all);
        let scores = differences
            .map(|differences| scores(&objective, prior, &model, &weights, &differences));
        let mut square = 0.0;
        for (k, deviation) in deviations.iter().enumerate() {
            let parts = |scores: &[Vec<DVector<f64>>]| -> Vec<DVector<f64>> {
                let of_lights = &scores[k];
                match deviation.by_light {
                    true => of_lights.iter().map(|score| &covariance * score).collect(),
                    false => vec![&covariance * of_lights.iter().sum::<DVector<f64>>()],
                }
            };
            let [a, b] = scores.each_ref().map(|scores| parts(scores));
            let products = a
                .iter()
                .zip(&b)
                .map(|(a, b)| a.dot(&(&subject.curvature * b)));
            square += deviation.weight * products.sum::<f64>();
        }
        square.max(0.0).sqrt()
    };
    Ok(subjects.par_iter().map(of_subject).collect())
}

fn values(image: &ModelImage) -> Vec<f64> {
    image.iter().map(|cell| cell[0].value()).collect()
}

/// Jᵀ W Δ for each deviation and light, the sum over the light's cells; `differences` holds Δ as
/// `[deviation][light][cell]`.
fn scores(
    objective: &Objective<'_>,
    prior: &Prior,
    model: &DiscrepancyModel,
    weights: &ResidualWeights,
    differences: &[Vec<Vec<f64>>],
) -> Vec<Vec<DVector<f64>>> {
    let modes = prior.modes();
    let none = || vec![vec![DVector::zeros(modes.ncols()); objective.lights()]; differences.len()];
    objective.accumulate(
        &unit(),
        weights,
        Some(modes),
        none,
        |sums, value| {
            let direct = model
                .direct
                .by_modes(value.cell, value.light, value.channel);
            let [a, b] = value.by_modes;
            for (sum, difference) in sums.iter_mut().zip(differences) {
                let scale = value.weight * difference[value.light][value.cell];
                let each = sum[value.light].iter_mut().zip(a.iter().zip(b)).zip(direct);
                for ((sum, (&a, &b)), &direct) in each {
                    let indirect = 0.5 * (f64::from(a) + f64::from(b));
                    *sum += scale * (indirect + value.direct * f64::from(direct));
                }
            }
        },
        |total, part| {
            for (total, part) in total.iter_mut().flatten().zip(part.into_iter().flatten()) {
                *total += part;
            }
        },
    )
}
