//! The deviation of f that no dictionary explains, narrowed where the images look at f.
//!
//! [`unexplained_deviation`] says what images miss where they do not look. Where they do, the
//! residual itself says how far f is from what was fitted: each node of the table of angles that
//! light reflected once reaches is a measurement of ln f there, with the error of the images. It
//! does not fall with the number of cells, because what a model lacks is common to neighbours.

use nalgebra::DVector;
use rayon::prelude::*;

use super::intervals::unexplained_deviation;
use super::objective::{ModelImage, Objective, ResidualWeights};
use crate::brdf::discrepancy::{NODES, node_weights, nodes};
use crate::transport::Scene;
use crate::transport::direct::for_each_seen;
use crate::transport::points::Sampler;

/// Rays per cell, square root: within a cell the angles hardly change.
const STRATA: u32 = 2;

/// Relative deviation of light that was reflected more often, which a value has besides the light
/// that says something of a node.
const INDIRECT_DEVIATION: f64 = 0.3;

/// Deviation of ln f that stays where the images look, over the relative error that they leave.
const DEVIATION_WHERE_SEEN: f64 = 1.0;

/// What the images say of ln f at each node, by light that was reflected once.
pub(super) struct Seen {
    /// 1 over the variance, per channel group and node.
    information: Vec<DVector<f64>>,
}

impl Seen {
    /// By the compared values, as modelled in the end and with the weights that they had.
    pub fn new(
        scene: &Scene,
        objective: &Objective<'_>,
        model: &[ModelImage],
        weights: &ResidualWeights,
        seed: u64,
    ) -> Self {
        let (cells, lights) = (objective.cells(), objective.lights());
        let none = || vec![DVector::zeros(NODES); objective.groups()];
        let of_cell = |mut sums: Vec<DVector<f64>>, cell: usize| {
            let mut shares = vec![[0.0; NODES]; lights];
            for_each_seen(
                scene,
                cells,
                cell,
                STRATA,
                seed,
                |surface, to_viewer, numbers| {
                    for (light, shares) in shares.iter_mut().enumerate() {
                        let Some(lamp) = scene.connect(surface, light, numbers.on_lamp()) else {
                            continue;
                        };
                        for (node, part) in node_weights(lamp.to_light, to_viewer) {
                            shares[node] += f64::from(lamp.irradiance) * f64::from(part);
                        }
                    }
                },
            );
            for (light, shares) in shares.iter().enumerate() {
                let total: f64 = shares.iter().sum();
                for c in 0..3 {
                    let weight = weights[light][cell][c];
                    let modelled = model[light][cell][c];
                    if weight <= 0.0 || total <= 0.0 || modelled.direct <= 0.0 {
                        continue;
                    }
                    let doubt = INDIRECT_DEVIATION * modelled.indirect;
                    let information = modelled.direct.powi(2) / (1.0 / weight + doubt * doubt);
                    let sum = &mut sums[objective.channels().group(c)];
                    for (sum, share) in sum.iter_mut().zip(shares) {
                        *sum += information * share / total;
                    }
                }
            }
            sums
        };
        let compared: Vec<usize> = (0..cells.len())
            .filter(|&cell| (0..lights).any(|light| objective.is_compared(light, cell)))
            .collect();
        // In parts of fixed size, so that sums are the same for any number of threads.
        let parts: Vec<_> = compared
            .par_chunks(256)
            .map(|part| part.iter().copied().fold(none(), of_cell))
            .collect();
        let information = parts.into_iter().fold(none(), |mut sums, part| {
            sums.iter_mut()
                .zip(part)
                .for_each(|(sum, part)| *sum += part);
            sums
        });
        Self { information }
    }

    /// Deviation of ln f at the nodes that nothing explains, of a channel group whose images leave
    /// a relative error of `excess_error`.
    pub fn unexplained(&self, group: usize, excess_error: f64) -> DVector<f64> {
        let floor = (DEVIATION_WHERE_SEEN * excess_error).powi(2);
        let both = nodes().zip(self.information[group].iter());
        let deviations = both.map(|(node, &information)| {
            let prior = unexplained_deviation(excess_error, node.theta_h_deg, node.theta_d_deg);
            // The measurement has the variance floor + 1/information.
            let measured = information / (1.0 + floor * information);
            prior / (1.0 + prior * prior * measured).sqrt()
        });
        DVector::from_iterator(NODES, deviations)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Half of the variance is left where the images are as sure as what is known without them,
    /// all of it where they do not look, and never less than their own error.
    #[test]
    fn what_the_images_look_at_is_known_as_well_as_they_say() {
        const ERROR: f64 = 0.03;
        let priors = nodes().map(|n| unexplained_deviation(ERROR, n.theta_h_deg, n.theta_d_deg));
        let priors = DVector::from_iterator(NODES, priors);
        let given = |information: DVector<f64>| {
            let information = vec![information];
            Seen { information }.unexplained(0, ERROR)
        };
        assert_eq!(given(DVector::zeros(NODES)), priors);
        let floor = DEVIATION_WHERE_SEEN * ERROR;
        let found = given(DVector::repeat(NODES, 1e12));
        for (prior, found) in priors.iter().zip(found.iter()) {
            let expected = (prior.powi(-2) + floor.powi(-2)).powf(-0.5);
            assert!((found / expected - 1.0).abs() < 1e-6, "{found} {expected}");
        }
        let as_sure = priors.map(|p| 1.0 / (p * p - floor * floor));
        let found = given(as_sure).component_div(&priors);
        let wider = priors.iter().zip(found.iter()).filter(|(p, _)| **p > floor);
        wider.for_each(|(_, part)| assert!((part - 0.5f64.sqrt()).abs() < 1e-9, "{part}"));
    }
}
