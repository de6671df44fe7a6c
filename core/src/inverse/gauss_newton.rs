//! Gauss–Newton on the simplex: each step is the exact minimum of the local
//! quadratic over the simplex, damped after Levenberg and Marquardt until the
//! unbiased loss falls.

use nalgebra::DVector;

use super::objective::{Linearised, Objective, ResidualWeights};
use super::ridge::{self, Ridge};
use super::trace::{Observer, Step, Termination};
use crate::simplex::{self, SimplexError};

/// When to stop, how to damp.
#[derive(Clone, Debug, PartialEq)]
pub struct GaussNewton {
    /// Most passes over the paths within one round of weights, 1..=100.
    pub max_steps: usize,
    /// Stop when a step changes the loss by less than this fraction.
    pub tolerance: f64,
    /// First damping, a fraction of the diagonal.
    pub damping: f64,
}

/// A change of ½χ² that no experiment could distinguish from noise.
const NEGLIGIBLE_LOSS: f64 = 0.5;

impl Default for GaussNewton {
    fn default() -> Self {
        Self {
            max_steps: 20,
            tolerance: 1e-3,
            damping: 1e-3,
        }
    }
}

impl GaussNewton {
    /// Improves `mixture` in place for fixed residual weights and prior; each channel group on its own.
    /// Returns the pass at the final mixture and why it ended.
    pub fn minimise(
        &self,
        objective: &Objective<'_>,
        residual_weights: &ResidualWeights,
        ridge: &Ridge,
        mixture: &mut [DVector<f64>],
        observer: &mut dyn Observer,
    ) -> Result<(Linearised, Termination), SimplexError> {
        let groups = objective.groups();
        let mut current = objective.linearise(mixture, residual_weights);
        let shares = current.convex_share(ridge::TOWARDS_CONVEXITY);
        log::debug!("shares of noise in the loss: {shares:?}");
        current.add_noise(&shares);
        let mut penalised = ridge.add_to(&current, mixture);
        let mut damping = vec![self.damping; groups];
        let mut settled = vec![false; groups];
        observer.step(&Step::of(&penalised, "gauss-newton"));
        for _ in 0..self.max_steps {
            let mut candidate = mixture.to_vec();
            for group in (0..groups).filter(|&s| !settled[s]) {
                let q = &penalised[group];
                let mut h = q.h.clone();
                for k in 0..h.nrows() {
                    h[(k, k)] += damping[group] * q.h[(k, k)];
                }
                // In terms of the new point x: ½ (x−w)ᵀh(x−w) − gᵀ(x−w).
                let g = &q.g + &h * &mixture[group];
                candidate[group] = simplex::solve(&h, &g, Some(&mixture[group]))?.x;
            }
            let mut next = objective.linearise(&candidate, residual_weights);
            next.add_noise(&shares);
            let next_penalised = ridge.add_to(&next, &candidate);
            log::trace!("candidate: damping {damping:?}, settled {settled:?}");
            let mut accepted = false;
            let (before, after) = (current, next);
            // A pass holds all sets at one mixture each; a rejected set keeps its old
            // point, so the pass is repeated only where acceptance is mixed.
            let mut verdicts = vec![true; groups];
            for group in 0..groups {
                if settled[group] {
                    continue;
                }
                let (old, new) = (penalised[group].c, next_penalised[group].c);
                let scale = old.abs().max(f64::MIN_POSITIVE);
                if new <= old {
                    accepted = true;
                    damping[group] = (damping[group] * 0.1).max(1e-9);
                    settled[group] = old - new < self.tolerance * scale + NEGLIGIBLE_LOSS;
                } else {
                    verdicts[group] = false;
                    damping[group] *= 10.0;
                    settled[group] = new - old < self.tolerance * scale + NEGLIGIBLE_LOSS
                        || damping[group] > 1e3;
                }
            }
            for group in 0..groups {
                if verdicts[group] {
                    mixture[group].copy_from(&candidate[group]);
                    penalised[group] = next_penalised[group].clone();
                }
            }
            current = match (accepted, verdicts.iter().all(|&v| v)) {
                (_, true) => after,
                (false, false) => before,
                (true, false) => merge(before, after, &verdicts),
            };
            observer.step(&Step::of(&penalised, "gauss-newton"));
            if settled.iter().all(|&s| s) {
                return Ok((current, Termination::Converged));
            }
        }
        Ok((current, Termination::StepLimit))
    }
}

/// Set by set, the pass that belongs to the mixture that was kept. The channels of the
/// image belong to the sets of the same number (one set: never mixed).
fn merge(before: Linearised, mut after: Linearised, keep_after: &[bool]) -> Linearised {
    for (group, _) in keep_after.iter().enumerate().filter(|&(_, &keep)| !keep) {
        after.quadratics[group] = before.quadratics[group].clone();
        after.information[group] = before.information[group].clone();
        after.noise[group] = before.noise[group].clone();
        after.unexplained[group] = before.unexplained[group];
        after.power[group] = before.power[group];
        after.block_scores[group] = before.block_scores[group].clone();
        for (new, old) in after.model.iter_mut().zip(&before.model) {
            new.iter_mut()
                .zip(old)
                .for_each(|(n, o)| n[group] = o[group]);
        }
        for (new, old) in after.stray_light.iter_mut().zip(&before.stray_light) {
            new[group] = old[group];
        }
    }
    after
}
