//! The nuisance parameters as a fit refined them, in `fit.toml`.

use serde::{Deserialize, Serialize};

use crate::inverse::nuisance::BenchEstimate;

/// A bench that was not exactly known, as refined.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BenchRecord {
    /// Rounds of refinement.
    pub rounds: u32,
    /// Whether the last step was within the remaining uncertainty.
    pub settled: bool,
    /// Mean squared residual over its variance, on the bench as described. The estimate is
    /// unbiased and can be slightly negative. It uses a quarter of the paths; their noise is
    /// part of the variances.
    pub residual_described: f64,
    /// The same on the refined bench.
    pub residual_refined: f64,
    /// Unobservable combinations, by name: fixed at the description.
    pub held: Vec<String>,
    /// What was refined.
    pub parameter: Vec<BenchParameter>,
}

/// A nuisance parameter: one difference of the bench from its description.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BenchParameter {
    /// In words, which count lights from 1: `azimuth of light 1` or `rotation about x`.
    pub name: String,
    /// Unit of the figures.
    pub unit: String,
    /// The difference.
    pub value: f64,
    /// Its standard deviation after the fit.
    pub deviation: f64,
    /// Its standard deviation as described.
    pub prior_deviation: f64,
}

/// In the units in which parameters are shown.
impl From<&BenchEstimate> for BenchRecord {
    fn from(bench: &BenchEstimate) -> Self {
        let [residual_described, residual_refined] = bench.reduced_chi2;
        let shown = bench.parameters.iter().map(|estimated| {
            let (unit, scale) = estimated.parameter.shown_in();
            BenchParameter {
                name: estimated.parameter.to_string(),
                unit: unit.to_owned(),
                value: estimated.value * scale,
                deviation: estimated.deviation * scale,
                prior_deviation: estimated.prior_deviation * scale,
            }
        });
        Self {
            rounds: bench.rounds as u32,
            settled: bench.settled,
            residual_described,
            residual_refined,
            held: bench.fixed.clone(),
            parameter: shown.collect(),
        }
    }
}

impl BenchRecord {
    /// The first figure that is not finite, or a deviation below 0, with its key.
    pub(super) fn bad_value(&self) -> Option<(String, f64)> {
        let residuals = [
            ("bench.residual_described", self.residual_described),
            ("bench.residual_refined", self.residual_refined),
        ];
        let bad = residuals.into_iter().find(|(_, value)| !value.is_finite());
        if let Some((key, value)) = bad {
            return Some((key.to_owned(), value));
        }
        self.parameter.iter().enumerate().find_map(|(k, p)| {
            let deviations = [
                ("deviation", p.deviation),
                ("prior_deviation", p.prior_deviation),
            ];
            let bad = deviations
                .into_iter()
                .find(|(_, value)| !(value.is_finite() && *value >= 0.0))
                .or((!p.value.is_finite()).then_some(("value", p.value)));
            bad.map(|(key, value)| (format!("bench.parameter[{k}].{key}"), value))
        })
    }
}
