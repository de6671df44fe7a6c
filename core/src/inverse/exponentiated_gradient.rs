//! The paper's optimiser: exponentiated gradient with Adam-style steps.
//!
//! wₙ ← wₙ exp(−η m̂ₙ/(√v̂ₙ + ε)), then normalised (Kivinen & Warmuth 1997; Kingma & Ba
//! 2014). A weight of exactly zero never revives, so the start is mixed with the
//! uniform weights (docs/adr/0002).

use nalgebra::DVector;

use super::objective::{Linearised, Objective, ResidualWeights};
use super::ridge::{self, Ridge};
use super::trace::{Observer, Step, Termination};

/// Step sizes and length of the run.
#[derive(Clone, Debug, PartialEq)]
pub struct ExponentiatedGradient {
    /// Most passes over the paths, 1..=100 000.
    pub max_steps: usize,
    /// Learning rate η, (0, 1].
    pub rate: f64,
    /// Decay of the first moment, [0, 1).
    pub beta1: f64,
    /// Decay of the second moment, [0, 1).
    pub beta2: f64,
    /// Share of the uniform weights in the start, (0, 1].
    pub uniform_share: f64,
}

impl Default for ExponentiatedGradient {
    fn default() -> Self {
        Self {
            max_steps: 300,
            rate: 0.1,
            beta1: 0.9,
            beta2: 0.999,
            uniform_share: 0.05,
        }
    }
}

impl ExponentiatedGradient {
    /// Improves `mixture` in place for fixed residual weights and prior and returns the pass at
    /// the best point seen, which `mixture` then holds.
    pub fn minimise(
        &self,
        objective: &Objective<'_>,
        residual_weights: &ResidualWeights,
        ridge: &Ridge,
        mixture: &mut [DVector<f64>],
        observer: &mut dyn Observer,
    ) -> (Linearised, Termination) {
        let n = objective.atoms();
        let groups = objective.groups();
        for w in mixture.iter_mut() {
            w.apply(|x| *x = *x * (1.0 - self.uniform_share) + self.uniform_share / n as f64);
        }
        let mut first = vec![DVector::<f64>::zeros(n); groups];
        let mut second = vec![DVector::<f64>::zeros(n); groups];
        let mut best: Vec<(f64, DVector<f64>)> =
            mixture.iter().map(|w| (f64::INFINITY, w.clone())).collect();
        let mut shares = Vec::new();
        for step in 1..=self.max_steps {
            let mut pass = objective.linearise(mixture, residual_weights);
            if step == 1 {
                shares = pass.convex_share(ridge::TOWARDS_CONVEXITY);
            }
            pass.add_noise(&shares);
            let penalised = ridge.add_to(&pass, mixture);
            observer.step(&Step::of(&penalised, "exponentiated-gradient"));
            for group in 0..groups {
                let q = &penalised[group];
                if q.c < best[group].0 {
                    best[group] = (q.c, mixture[group].clone());
                }
                let (m, v) = (&mut first[group], &mut second[group]);
                let correction1 = 1.0 - self.beta1.powi(step as i32);
                let correction2 = 1.0 - self.beta2.powi(step as i32);
                // Adam's steps all have one length; what is common to all atoms, which the
                // sum to one takes back, would leave nothing else of them.
                let common = q.g.dot(&mixture[group]);
                for k in 0..n {
                    let gradient = common - q.g[k];
                    m[k] = self.beta1 * m[k] + (1.0 - self.beta1) * gradient;
                    v[k] = self.beta2 * v[k] + (1.0 - self.beta2) * gradient * gradient;
                    let rate = (m[k] / correction1) / ((v[k] / correction2).sqrt() + 1e-300);
                    mixture[group][k] *= (-self.rate * rate).exp();
                }
                let sum = mixture[group].sum();
                mixture[group] /= sum;
            }
        }
        for (w, (_, x)) in mixture.iter_mut().zip(best) {
            *w = x;
        }
        let mut pass = objective.linearise(mixture, residual_weights);
        pass.add_noise(&shares);
        let penalised = ridge.add_to(&pass, mixture);
        observer.step(&Step::of(&penalised, "exponentiated-gradient"));
        (pass, Termination::StepLimit)
    }
}
