//! Signals against what other frames predict for them, summed over pixels and over rows.

use nalgebra::{Matrix3, Vector3};

/// One pixel's signal and its prediction.
#[derive(Clone, Copy, Debug)]
pub(super) struct Step {
    pub signal: f64,
    pub predicted: f64,
    /// Variance of the difference.
    pub variance: f64,
    /// Change of the difference if what all pixels share (the black level, the response) were
    /// off by one standard uncertainty.
    pub common: f64,
}

impl Step {
    pub fn chi2(&self) -> f64 {
        (self.signal - self.predicted).powi(2) / self.variance
    }
}

/// Sums over pixels.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Sums {
    pub pixels: usize,
    pub signal: f64,
    pub predicted: f64,
    pub variance: f64,
    pub chi2: f64,
    common: f64,
    /// Σ s², Σ s p, Σ p².
    squares: [f64; 3],
}

impl Sums {
    pub fn take(&mut self, step: &Step, chi2: f64) {
        let (s, p) = (step.signal, step.predicted);
        self.add(&Self {
            pixels: 1,
            signal: s,
            predicted: p,
            variance: step.variance,
            chi2,
            common: step.common,
            squares: [s * s, s * p, p * p],
        });
    }

    pub fn add(&mut self, other: &Self) {
        self.pixels += other.pixels;
        self.signal += other.signal;
        self.predicted += other.predicted;
        self.variance += other.variance;
        self.chi2 += other.chi2;
        self.common += other.common;
        for (mine, theirs) in self.squares.iter_mut().zip(other.squares) {
            *mine += theirs;
        }
    }

    /// Signal over prediction and its uncertainty from noise.
    pub fn ratio(&self) -> Option<(f64, f64)> {
        let known = self.pixels > 0 && self.predicted > 0.0;
        known.then(|| {
            (
                self.signal / self.predicted,
                self.variance.sqrt() / self.predicted,
            )
        })
    }

    /// Uncertainty of the ratio from what all pixels share.
    pub fn common_std(&self) -> f64 {
        self.common.abs() / self.predicted
    }

    pub fn reduced_chi2(&self) -> f64 {
        self.chi2 / self.pixels.max(1) as f64
    }

    /// Sum of the squared differences from the prediction times this ratio.
    fn squared_differences(&self, ratio: f64) -> f64 {
        let [ss, sp, pp] = self.squares;
        ss - 2.0 * ratio * sp + ratio * ratio * pp
    }

    /// How much larger the pixels' differences from the common ratio are than noise explains,
    /// as a factor of its standard deviation; at least 1.
    pub fn excess(&self) -> f64 {
        let Some((ratio, _)) = self.ratio() else {
            return 1.0;
        };
        let excess2 = self.squared_differences(ratio) / self.variance;
        excess2.max(1.0).sqrt()
    }

    /// Root mean square of single pixels' difference from their prediction times the common
    /// ratio, beyond noise, relative to the predictions' root mean square.
    pub fn scatter(&self) -> f64 {
        let Some((ratio, _)) = self.ratio() else {
            return 0.0;
        };
        let beyond_noise = self.squared_differences(ratio) - self.variance;
        (beyond_noise / self.squares[2]).max(0.0).sqrt()
    }
}

/// Sums over a row's pixels.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct RowSum {
    signal: f64,
    predicted: f64,
    variance: f64,
}

impl RowSum {
    pub fn take(&mut self, step: &Step) {
        self.signal += step.signal;
        self.predicted += step.predicted;
        self.variance += step.variance;
    }
}

/// Rows that it takes to speak of them.
const LEAST_ROWS: usize = 12;
/// Standard deviations by which rows must differ beyond noise.
const ROWS_SIGMA: f64 = 5.0;

/// Root mean square of the rows' ratios of signal to prediction about a parabola over the
/// image's height, beyond noise; 0 where noise explains it. A parabola, because counts that
/// are not proportional to light, or a lamp that is moved, change rows smoothly.
pub(super) fn row_scatter(rows: &[RowSum]) -> f64 {
    let seen: Vec<(f64, f64, RowSum)> = (0..)
        .zip(rows)
        .filter(|(_, row)| row.predicted > 0.0)
        .map(|(y, row)| {
            let height = f64::from(y) / rows.len() as f64;
            (height, row.signal / row.predicted, *row)
        })
        .collect();
    if seen.len() < LEAST_ROWS {
        return 0.0;
    }
    // The parabola, with weights p².
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    let terms = |height: f64| Vector3::new(1.0, height, height * height);
    for (height, ratio, row) in &seen {
        let weight = row.predicted * row.predicted;
        normal += weight * terms(*height) * terms(*height).transpose();
        right += weight * *ratio * terms(*height);
    }
    let Some(parabola) = normal.cholesky().map(|c| c.solve(&right)) else {
        return 0.0;
    };
    // What remains, against noise.
    let (mut remains, mut noise, mut noise2, mut weights) = (0.0, 0.0, 0.0, 0.0);
    for (height, ratio, row) in &seen {
        let off = row.predicted * (ratio - parabola.dot(&terms(*height)));
        remains += off * off;
        noise += row.variance;
        noise2 += row.variance * row.variance;
        weights += row.predicted * row.predicted;
    }
    if remains > noise + ROWS_SIGMA * (2.0 * noise2).sqrt() {
        ((remains - noise) / weights).sqrt()
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(ratio: impl Fn(usize) -> f64) -> Vec<RowSum> {
        let row = |y| RowSum {
            signal: 1000.0 * ratio(y),
            predicted: 1000.0,
            variance: 25.0,
        };
        (0..48).map(row).collect()
    }

    #[test]
    fn rows_that_flicker_differ_and_a_slow_change_is_none() {
        let flicker = |y: usize| 1.0 + 0.3 * (y as f64).sin();
        let found = row_scatter(&rows(flicker));
        assert!((found - 0.3 / 2f64.sqrt()).abs() < 0.02, "{found}");
        for (name, still) in [
            ("noise", rows(|y| 1.0 + 0.005 * (y as f64).sin())),
            ("parabola", rows(|y| 1.2 + 1e-4 * (y as f64 - 20.0).powi(2))),
            ("few rows", rows(flicker)[..11].to_vec()),
            ("no light", vec![RowSum::default(); 48]),
        ] {
            assert_eq!(row_scatter(&still), 0.0, "{name}");
        }
    }
}
