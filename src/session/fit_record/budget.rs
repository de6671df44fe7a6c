//! Where the BRDF's interval comes from, in `fit.toml`.

use serde::{Deserialize, Serialize};

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
pub struct BudgetRow {
    /// Half angle, degrees.
    pub theta_h_deg: f64,
    /// Difference angle, degrees.
    pub theta_d_deg: f64,
    /// f, 1/sr.
    pub value: f64,
    /// Standard deviation of f over f, all sources together.
    pub relative_std: f64,
    /// Part of the variance by source, 0..=1; they sum to 1.
    pub share: Vec<f64>,
}

impl BudgetRecord {
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
