//! What it adds to the expected error that a bench is not as described.

use std::sync::Arc;

use nalgebra::DVector;
use rayon::prelude::*;

use super::{PredictionError, PredictionOptions, Prospect, Subject, Traced, unit, white};
use crate::brdf::Mixture;
use crate::brdf::discrepancy::{Material, Prior};
use crate::inverse::objective::{DiscrepancyModel, ModelImage, Objective, ResidualWeights};
use crate::transport::Scene;

/// A scene as it may be in truth: one of its parameters is off.
pub struct Deviation {
    /// With as many lights as the scene that it departs from.
    pub scene: Scene,
    /// Its square counts by 1 over this: of n that are drawn for one parameter n, times the squared number
    /// of standard deviations.
    pub among: f64,
    /// Whether each light deviates on its own.
    pub by_light: bool,
}

/// For each material the error √(Σ bᵀ E b) that deviations cause which the fit does not know of, with
/// b = C Jᵀ W Δ what a departure Δ of the images does to ln f. It adds to the expected error in squares.
/// Δ comes from two independent sets of paths, so that their noise does not count as a departure.
///
/// # Errors
/// Bodies that cannot be taken into account.
pub fn error_by_deviations(
    scene: &Scene,
    deviations: &[Deviation],
    subjects: &[Arc<Subject>],
    options: &PredictionOptions,
) -> Result<Vec<f64>, PredictionError> {
    let other_paths = PredictionOptions {
        seed: options.seed.wrapping_add(0x5eed),
        ..options.clone()
    };
    let pairs = [options, &other_paths].map(|options| -> Result<_, PredictionError> {
        let own = Traced::new(scene, scene, options)?;
        let others: Result<Vec<Traced>, _> = deviations
            .par_iter()
            .map(|deviation| Traced::new(&deviation.scene, scene, options))
            .collect();
        Ok((own, others?))
    });
    let [first, second] = pairs;
    let (first, second) = (first?, second?);
    let mixture = Mixture::grey(white()?, vec![1.0])?;
    let of_subject = |subject: &Arc<Subject>| {
        let material = Material::new(mixture.clone(), std::slice::from_ref(&subject.ln_f));
        let prior = &subject.prior;
        // Images of the material in a scene, by the paths traced there.
        let images = |traced: &Traced, scene: &Scene| {
            let plain = traced.objective(options);
            let model = DiscrepancyModel::of_all(&plain, scene, &material, prior, options.seed);
            let all = plain.with_discrepancy(&model).modelled(&unit());
            all.iter().map(values).collect::<Vec<_>>()
        };
        let departures = |(own, others): &(Traced, Vec<Traced>)| -> Vec<Vec<Vec<f64>>> {
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
        let departures = [departures(&first), departures(&second)];

        // What the estimate makes of them.
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
        let scores =
            departures.map(|departures| scores(&objective, prior, &model, &weights, &departures));
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
            square += products.sum::<f64>() / deviation.among;
        }
        square.max(0.0).sqrt()
    };
    Ok(subjects.par_iter().map(of_subject).collect())
}

fn values(image: &ModelImage) -> Vec<f64> {
    image.iter().map(|cell| cell[0].value()).collect()
}

/// Jᵀ W Δ of each departure (`[deviation][light][cell]`) and light.
fn scores(
    objective: &Objective<'_>,
    prior: &Prior,
    model: &DiscrepancyModel,
    weights: &ResidualWeights,
    departures: &[Vec<Vec<f64>>],
) -> Vec<Vec<DVector<f64>>> {
    let modes = prior.modes();
    let none = || vec![vec![DVector::zeros(modes.ncols()); objective.lights()]; departures.len()];
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
            for (sum, departure) in sums.iter_mut().zip(departures) {
                let scale = value.weight * departure[value.light][value.cell];
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
