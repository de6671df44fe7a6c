//! Gain and read noise from the growth of the variance with the signal.

use super::TransferPoint;
use crate::calibration::record::Measured;

/// Variance against signal: a straight line whose slope is the gain.
pub(super) struct VarianceLine {
    pub at_zero: f64,
    at_zero_std: f64,
    pub slope: f64,
    pub slope_std: f64,
    covariance: f64,
    pub reduced_chi2: f64,
}

impl VarianceLine {
    /// Weighted least squares; the weights come from the line of the round
    /// before, since measured variances would favour low ones. A black level that is off
    /// by `black_std_dn` moves the line along the signal.
    pub fn fit(curve: &mut [TransferPoint], freedom: &[f64], black_std_dn: f64) -> Self {
        let mut expected: Vec<f64> = curve.iter().map(|p| p.variance_dn2.max(1e-3)).collect();
        let mut line = None;
        for _ in 0..4 {
            let (mut s0, mut s1, mut s2, mut r0, mut r1) = (0.0, 0.0, 0.0, 0.0, 0.0);
            for ((point, &f), &e) in curve.iter().zip(freedom).zip(&expected) {
                if !point.fitted {
                    continue;
                }
                let w = f / (2.0 * e * e);
                s0 += w;
                s1 += w * point.signal_dn;
                s2 += w * point.signal_dn.powi(2);
                r0 += w * point.variance_dn2;
                r1 += w * point.variance_dn2 * point.signal_dn;
            }
            let determinant = s0 * s2 - s1 * s1;
            let at_zero = (s2 * r0 - s1 * r1) / determinant;
            let slope = (s0 * r1 - s1 * r0) / determinant;
            let mut chi2 = 0.0;
            let mut points = 0.0;
            for ((point, &f), e) in curve.iter_mut().zip(freedom).zip(&mut expected) {
                *e = (at_zero + slope * point.signal_dn).max(1e-3);
                point.variance_std_dn2 = *e * (2.0 / f).sqrt();
                if point.fitted {
                    chi2 += ((point.variance_dn2 - *e) / point.variance_std_dn2).powi(2);
                    points += 1.0;
                }
            }
            line = Some(Self {
                at_zero,
                at_zero_std: (s2 / determinant).sqrt().hypot(slope * black_std_dn),
                slope,
                slope_std: (s0 / determinant).sqrt(),
                covariance: -s1 / determinant,
                reduced_chi2: chi2 / f64::max(points - 2.0, 1.0),
            });
        }
        line.expect("the loop runs")
    }

    /// Standard deviation of the read noise: what remains at zero signal
    /// without quantisation. Below 0.24 DN² rounding hides it, and 0.40 DN is
    /// its upper limit (EMVA 1288, 6.5), given with an uncertainty of its half.
    pub fn read_noise_e(&self) -> Measured {
        if self.at_zero < 0.24 {
            return Measured::new(0.40 / self.slope, 0.20 / self.slope);
        }
        let sigma_dn = (self.at_zero - 1.0 / 12.0).sqrt();
        // σ_e = σ_dn(v) / K with v and K correlated by the fit.
        let by_v = 0.5 / (sigma_dn * self.slope);
        let by_k = -sigma_dn / self.slope.powi(2);
        let variance = (by_v * self.at_zero_std).powi(2)
            + (by_k * self.slope_std).powi(2)
            + 2.0 * by_v * by_k * self.covariance;
        Measured::new(sigma_dn / self.slope, variance.max(0.0).sqrt())
    }
}
