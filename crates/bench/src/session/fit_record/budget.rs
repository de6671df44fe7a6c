//! Where the BRDF's interval comes from, in `fit.toml`.

use serde::{Deserialize, Serialize};

use crate::inverse::{Fit, budget, variance_shares};

/// The error budget at a few angles.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BudgetRecord {
    /// Names of the sources.
    pub sources: Vec<String>,
    /// One row per pair of angles.
    pub row: Vec<BudgetRow>,
}

/// The error budget at one pair of angles, mean over the channels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct BudgetRow {
    pub theta_h_deg: f64,
    pub theta_d_deg: f64,
    /// f, 1/sr.
    pub value: f64,
    /// Standard deviation of f over f, all sources together.
    pub relative_std: f64,
    /// Part of the variance by source, 0..=1; they sum to 1.
    pub share: Vec<f64>,
}

/// Half and difference angles of the error budget, degrees.
const ANGLES_DEG: [[f64; 2]; 8] = [
    [0.0, 10.0],
    [5.0, 10.0],
    [15.0, 10.0],
    [40.0, 10.0],
    [0.0, 50.0],
    [5.0, 50.0],
    [15.0, 50.0],
    [40.0, 50.0],
];

impl BudgetRecord {
    /// Of a fit; `None` without posterior samples.
    pub fn of(fit: &Fit) -> Option<Self> {
        let row = |[theta_h_deg, theta_d_deg]: [f64; 2]| {
            let cell = variance_shares::at(
                &fit.material,
                &fit.posterior_samples,
                theta_h_deg,
                theta_d_deg,
            )?;
            let total: f64 = cell.relative_variance.iter().sum();
            let share = cell.relative_variance.iter();
            Some(BudgetRow {
                theta_h_deg,
                theta_d_deg,
                value: cell.value,
                relative_std: total.sqrt(),
                share: share
                    .map(|v| if total > 0.0 { v / total } else { 0.0 })
                    .collect(),
            })
        };
        let row: Vec<BudgetRow> = ANGLES_DEG.into_iter().filter_map(row).collect();
        (!row.is_empty()).then(|| Self {
            sources: budget::Source::ALL.map(|s| s.name().to_owned()).to_vec(),
            row,
        })
    }

    /// The first figure that cannot be, with its key.
    pub(super) fn bad_value(&self) -> Option<(String, f64)> {
        self.row.iter().enumerate().find_map(|(k, row)| {
            let sum: f64 = row.share.iter().sum();
            let bad = if row.share.len() != self.sources.len() {
                Some(("share", row.share.len() as f64))
            } else if !(row.relative_std.is_finite() && row.relative_std >= 0.0) {
                Some(("relative_std", row.relative_std))
            } else if row.relative_std > 0.0 && (sum - 1.0).abs() > 1e-6 {
                Some(("share", sum))
            } else {
                None
            };
            bad.map(|(key, value)| (format!("budget.row[{k}].{key}"), value))
        })
    }
}
