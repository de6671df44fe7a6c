//! Signals against what other frames predict for them, summed over pixels, rows and columns.

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

/// Sums over the pixels of a row or a column.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct LineSum {
    signal: f64,
    predicted: f64,
    variance: f64,
}

impl LineSum {
    pub fn take(&mut self, step: &Step) {
        self.signal += step.signal;
        self.predicted += step.predicted;
        self.variance += step.variance;
    }

    pub fn add(&mut self, other: &Self) {
        self.signal += other.signal;
        self.predicted += other.predicted;
        self.variance += other.variance;
    }
}

/// Rows or columns that it takes to speak of them.
const LEAST_LINES: usize = 12;
/// Standard deviations by which they must differ beyond noise.
const LINES_SIGMA: f64 = 5.0;

/// How the ratios of signal to prediction of rows, or of columns, differ: root mean square
/// beyond noise, relative; 0 where noise explains it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct LineScatter {
    /// About a parabola over the image: counts that are not proportional to light, or a lamp
    /// that is moved, change lines smoothly.
    pub sharp: f64,
    /// About the ratio that all have in common, slow changes included.
    pub whole: f64,
}

impl LineScatter {
    pub fn max(self, other: Self) -> Self {
        Self {
            sharp: self.sharp.max(other.sharp),
            whole: self.whole.max(other.whole),
        }
    }
}

/// The scatter of all rows, or of all columns, in their order.
pub(super) fn line_scatter(lines: &[LineSum]) -> LineScatter {
    let seen: Vec<(f64, f64, LineSum)> = (0..)
        .zip(lines)
        .filter(|(_, line)| line.predicted > 0.0)
        .map(|(at, line)| {
            let at = f64::from(at) / lines.len() as f64;
            (at, line.signal / line.predicted, *line)
        })
        .collect();
    if seen.len() < LEAST_LINES {
        return LineScatter::default();
    }
    // The parabola, with weights p².
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    let terms = |at: f64| Vector3::new(1.0, at, at * at);
    for (at, ratio, line) in &seen {
        let weight = line.predicted * line.predicted;
        normal += weight * terms(*at) * terms(*at).transpose();
        right += weight * *ratio * terms(*at);
    }
    let Some(parabola) = normal.cholesky().map(|c| c.solve(&right)) else {
        return LineScatter::default();
    };
    let common = right[0] / normal[(0, 0)];
    // What remains about either, against noise.
    let about = |trend: &dyn Fn(f64) -> f64| {
        let (mut remains, mut noise, mut noise2, mut weights) = (0.0, 0.0, 0.0, 0.0);
        for (at, ratio, line) in &seen {
            let off = line.predicted * (ratio - trend(*at));
            remains += off * off;
            noise += line.variance;
            noise2 += line.variance * line.variance;
            weights += line.predicted * line.predicted;
        }
        match remains > noise + LINES_SIGMA * (2.0 * noise2).sqrt() {
            true => ((remains - noise) / weights).sqrt(),
            false => 0.0,
        }
    };
    LineScatter {
        sharp: about(&|at| parabola.dot(&terms(at))),
        whole: about(&|_| common),
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;

    fn rows(ratio: impl Fn(usize) -> f64) -> Vec<LineSum> {
        let row = |y| LineSum {
            signal: 1000.0 * ratio(y),
            predicted: 1000.0,
            variance: 25.0,
        };
        (0..48).map(row).collect()
    }

    #[test]
    fn rows_that_flicker_differ_and_a_slow_change_is_none() {
        let flicker = |y: usize| 1.0 + 0.3 * (y as f64).sin();
        let found = line_scatter(&rows(flicker)).sharp;
        assert!((found - 0.3 / 2f64.sqrt()).abs() < 0.02, "{found}");
        // One period over the image is slow, and is in the whole.
        for phase in [0.0, 0.8, 1.6] {
            let period = |y: usize| 1.0 + 0.1 * (TAU * y as f64 / 48.0 + phase).sin();
            let LineScatter { sharp, whole } = line_scatter(&rows(period));
            assert!((whole - 0.1 / 2f64.sqrt()).abs() < 0.002, "{whole}");
            assert!(sharp < 0.7 * whole, "{sharp}");
        }
        for (name, still) in [
            ("noise", rows(|y| 1.0 + 0.005 * (y as f64).sin())),
            ("parabola", rows(|y| 1.2 + 1e-4 * (y as f64 - 20.0).powi(2))),
            ("few rows", rows(flicker)[..11].to_vec()),
            ("no light", vec![LineSum::default(); 48]),
        ] {
            assert_eq!(line_scatter(&still).sharp, 0.0, "{name}");
        }
    }
}
