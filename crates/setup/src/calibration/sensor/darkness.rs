//! What each pixel counts without light.

use nalgebra::{Matrix2, Vector2};

use super::{DarkFit, Level};
use crate::calibration::record::Measured;
use crate::statistics::{STD_OVER_MAD, median};

/// Dark current this many standard deviations above the median makes a pixel hot.
const HOT_SIGMA: f64 = 8.0;

/// Each pixel's dark counts as offset plus slope times exposure.
pub(super) struct Darkness {
    pub offset_dn: Vec<f64>,
    pub slope_dn_s: Vec<f64>,
    /// Covariance of (offset, slope) of one pixel from the temporal noise.
    pub covariance: [[f64; 2]; 2],
}

impl Darkness {
    pub fn fit(dark: &[&Level]) -> Self {
        let pixels: Vec<usize> = (0..dark[0].sum.len()).collect();
        // The middle half: the noise of hot pixels is far larger, and that of the
        // darkest ones smaller.
        let mut means: Vec<(f64, usize)> = pixels
            .iter()
            .map(|&p| (dark[dark.len() - 1].pixel_mean(p), p))
            .collect();
        means.sort_by(|a, b| a.0.total_cmp(&b.0));
        let quarter = if means.len() < 8 { 0 } else { means.len() / 4 };
        let typical: Vec<usize> = means[quarter..means.len() - quarter]
            .iter()
            .map(|&(_, p)| p)
            .collect();
        let weights: Vec<f64> = dark
            .iter()
            .map(|level| {
                let variance = level.temporal_variance(&typical).max(1.0 / 12.0);
                f64::from(level.frames) / variance
            })
            .collect();
        let sum = |power: i32| -> f64 {
            dark.iter()
                .zip(&weights)
                .map(|(level, w)| w * level.exposure_s.powi(power))
                .sum()
        };
        let (s0, s1, s2) = (sum(0), sum(1), sum(2));
        let determinant = s0 * s2 - s1 * s1;
        let covariance = [
            [s2 / determinant, -s1 / determinant],
            [-s1 / determinant, s0 / determinant],
        ];
        let (offset_dn, slope_dn_s) = pixels
            .iter()
            .map(|&p| {
                let (mut r0, mut r1) = (0.0, 0.0);
                for (level, w) in dark.iter().zip(&weights) {
                    let y = level.pixel_mean(p);
                    r0 += w * y;
                    r1 += w * y * level.exposure_s;
                }
                (
                    covariance[0][0] * r0 + covariance[0][1] * r1,
                    covariance[1][0] * r0 + covariance[1][1] * r1,
                )
            })
            .unzip();
        Self {
            offset_dn,
            slope_dn_s,
            covariance,
        }
    }

    pub fn hot_pixels(&self) -> Vec<bool> {
        let slopes = || self.slope_dn_s.iter().copied();
        let middle = median(slopes()).unwrap_or(0.0);
        let deviation = median(slopes().map(|s| (s - middle).abs()));
        let sigma = STD_OVER_MAD * deviation.unwrap_or(0.0);
        let floor = self.covariance[1][1].sqrt();
        let limit = middle + HOT_SIGMA * sigma.max(floor);
        self.slope_dn_s.iter().map(|&s| s > limit).collect()
    }

    /// Each pixel's deviation from the means, `means` and `spreads` being those of
    /// offset (DN) and slope (DN/s): the likeliest where pixels are spread normally
    /// and their measurements have noise. In electrons by `gain_dn_per_e`; 0 at hot
    /// pixels. Also the covariance of what remains unknown.
    pub fn pattern(
        &self,
        means: [f64; 2],
        spreads: [f64; 2],
        hot: &[bool],
        gain_dn_per_e: f64,
    ) -> DarkFit {
        let [[a, b], [_, d]] = self.covariance;
        let noise = Matrix2::new(a, b, b, d);
        let prior = Matrix2::from_diagonal(&Vector2::from(spreads.map(|s| s * s)));
        let kept = (prior + noise)
            .try_inverse()
            .map_or_else(Matrix2::zeros, |inverse| prior * inverse);
        let remaining = prior - kept * prior;
        let deviation = |p: usize| {
            let measured =
                Vector2::new(self.offset_dn[p] - means[0], self.slope_dn_s[p] - means[1]);
            if hot[p] {
                Vector2::zeros()
            } else {
                kept * measured
            }
        };
        let deviations: Vec<Vector2<f64>> = (0..hot.len()).map(deviation).collect();
        let cross = remaining[(0, 1)] / gain_dn_per_e;
        DarkFit {
            offset_dn: deviations.iter().map(|d| d[0]).collect(),
            dark_current_e_s: deviations.iter().map(|d| d[1] / gain_dn_per_e).collect(),
            covariance: [
                [remaining[(0, 0)], cross],
                [cross, remaining[(1, 1)] / gain_dn_per_e.powi(2)],
            ],
        }
    }

    /// Mean over the pixels and the spread that is not measurement noise;
    /// `which` is 0 for offsets and 1 for slopes.
    pub fn statistics(
        &self,
        values: &[f64],
        pixels: &[usize],
        which: usize,
    ) -> (Measured, Measured) {
        let n = pixels.len() as f64;
        let mean = pixels.iter().map(|&p| values[p]).sum::<f64>() / n;
        let variance = pixels
            .iter()
            .map(|&p| (values[p] - mean).powi(2))
            .sum::<f64>()
            / (n - 1.0);
        let own = (variance - self.covariance[which][which]).max(0.0);
        // What noise does to the sum of squares of these pixels' values, carried to
        // its root.
        let noise = self.covariance[which][which];
        let variance_std = ((4.0 * own * noise + 2.0 * noise * noise) / (n - 1.0)).sqrt();
        let spread_std = if own > variance_std {
            0.5 * variance_std / own.sqrt()
        } else {
            variance_std.sqrt()
        };
        (
            Measured {
                value: mean,
                // Of these pixels, not of those that another sensor might have.
                std: (self.covariance[which][which] / n).sqrt(),
            },
            Measured::new(own.sqrt(), spread_std),
        )
    }
}
