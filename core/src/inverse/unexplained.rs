//! The deviation of f that no dictionary explains, narrowed where the images look at f.
//!
//! [`unexplained_deviation`] says what images miss where they do not look. Where they do, the
//! residual itself says how far f is from what was fitted: each node of the table of angles that
//! light reflected once reaches is a measurement of ln f there, with the error that the images
//! leave at that node. It does not fall with the number of cells, because what a model lacks is
//! common to neighbours.

use nalgebra::DVector;
use rayon::prelude::*;

use super::intervals::unexplained_deviation;
use super::objective::{ModelImage, Modelled, Objective, ResidualWeights};
use crate::brdf::discrepancy::{NODES, Place, nodes};
use crate::transport::Scene;
use crate::transport::direct::for_each_lit;

/// Rays per cell, square root: within a cell the angles hardly change.
const STRATA: u32 = 2;

/// Relative deviation of light that was reflected more often, which a value has besides the light
/// that says something of a node.
const INDIRECT_DEVIATION: f64 = 0.3;

/// Largest square of a relative residual that counts: what is further off is dust.
const MAX_SQUARE: f64 = 0.25;

/// Least number of values at a node, for a residual.
const LEAST_VALUES: f64 = 1e-3;

/// What the images say of ln f at each node, by light that was reflected once.
pub(super) struct Seen {
    /// Per channel group.
    groups: Vec<OfNodes>,
}

/// Of one channel group, sums by node over the values that see it.
#[derive(Clone)]
struct OfNodes {
    /// 1 over the variance of ln f that noise and light reflected more often leave.
    information: DVector<f64>,
    /// Number of values.
    values: DVector<f64>,
    /// Squares of their relative residuals, without that of noise.
    squares: DVector<f64>,
}

impl OfNodes {
    fn none() -> Self {
        let none = DVector::zeros(NODES);
        let [information, values, squares] = [none.clone(), none.clone(), none];
        Self {
            information,
            values,
            squares,
        }
    }

    /// Adds a value, as captured with its variance and as modelled, its weight, and the share that
    /// each node has in its direct light.
    fn add(
        &mut self,
        [captured, variance]: [f64; 2],
        modelled: Modelled,
        weight: f64,
        shares: impl Iterator<Item = f64>,
    ) {
        let doubt = INDIRECT_DEVIATION * modelled.indirect;
        let information = modelled.direct.powi(2) / (1.0 / weight + doubt * doubt);
        let value = modelled.value();
        let noise = variance + modelled.variance;
        let square = ((captured - value).powi(2) - noise) / value.powi(2);
        for (node, share) in shares.enumerate() {
            self.information[node] += information * share;
            self.values[node] += share;
            self.squares[node] += square.min(MAX_SQUARE) * share;
        }
    }

    fn join(&mut self, other: &Self) {
        self.information += &other.information;
        self.values += &other.values;
        self.squares += &other.squares;
    }

    /// Variance of ln f that the images leave at a node, however many values see it.
    fn floor(&self, node: usize) -> f64 {
        (self.squares[node] / self.values[node].max(LEAST_VALUES)).max(0.0)
    }
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
        let none = || vec![OfNodes::none(); objective.groups()];
        let of_cell = |mut sums: Vec<OfNodes>, cell: usize| {
            let mut shares = vec![[0.0; NODES]; lights];
            for_each_lit(
                scene,
                cells,
                cell,
                STRATA,
                seed,
                |light, lamp, to_viewer| {
                    for (node, part) in Place::of(lamp.to_light, to_viewer).around {
                        shares[light][node] += f64::from(lamp.irradiance) * f64::from(part);
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
                    let [target, variance] = objective.captured(light, cell);
                    let captured = [target[c], variance[c]];
                    let shares = shares.iter().map(|share| share / total);
                    sums[objective.channels().group(c)].add(captured, modelled, weight, shares);
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
        let groups = parts.into_iter().fold(none(), |mut sums, part| {
            let both = sums.iter_mut().zip(&part);
            both.for_each(|(sum, part)| sum.join(part));
            sums
        });
        Self { groups }
    }

    /// Deviation of ln f at the nodes that nothing explains, of a channel group whose images leave
    /// a relative error of `excess_error`.
    pub fn unexplained(&self, group: usize, excess_error: f64) -> DVector<f64> {
        let seen = &self.groups[group];
        let deviations = nodes().enumerate().map(|(k, node)| {
            let prior = unexplained_deviation(excess_error, node.theta_h_deg, node.theta_d_deg);
            let information = seen.information[k];
            let measured = information / (1.0 + seen.floor(k) * information);
            prior / (1.0 + prior * prior * measured).sqrt()
        });
        DVector::from_iterator(NODES, deviations)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All of the variance is left where the images do not look, half of it where they are as
    /// sure as what is known without them, and where they look long what their residual says.
    #[test]
    fn what_the_images_look_at_is_known_as_well_as_they_say() {
        const ERROR: f64 = 0.03;
        const RESIDUAL: f64 = 0.02;
        let priors = nodes().map(|n| unexplained_deviation(ERROR, n.theta_h_deg, n.theta_d_deg));
        let priors = DVector::from_iterator(NODES, priors);
        let given = |information: DVector<f64>| {
            let squares = DVector::repeat(NODES, 9.0 * RESIDUAL * RESIDUAL);
            let values = DVector::repeat(NODES, 9.0);
            let groups = vec![OfNodes {
                information,
                values,
                squares,
            }];
            Seen { groups }.unexplained(0, ERROR)
        };
        assert_eq!(given(DVector::zeros(NODES)), priors);
        let found = given(DVector::repeat(NODES, 1e12));
        for (prior, found) in priors.iter().zip(found.iter()) {
            let expected = (prior.powi(-2) + RESIDUAL.powi(-2)).powf(-0.5);
            assert!((found / expected - 1.0).abs() < 1e-6, "{found} {expected}");
        }
        let as_sure = priors.map(|p| 1.0 / (p * p - RESIDUAL * RESIDUAL));
        let found = given(as_sure).component_div(&priors);
        assert!(priors.min() > RESIDUAL);
        let half = |part: &f64| (part - 0.5f64.sqrt()).abs() < 1e-9;
        assert!(found.iter().all(half), "{found}");
    }

    /// A node that no value sees keeps all that is not known of it.
    #[test]
    fn nothing_seen_says_nothing() {
        let groups = vec![OfNodes::none()];
        let found = Seen { groups }.unexplained(0, 0.01);
        let node = nodes().next().unwrap();
        let prior = unexplained_deviation(0.01, node.theta_h_deg, node.theta_d_deg);
        assert_eq!(found[0], prior);
    }
}
