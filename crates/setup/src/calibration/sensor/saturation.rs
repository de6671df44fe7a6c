//! The count at which a sensor saturates.

use super::{Level, SensorFitError};

/// Where counts stop growing.
pub(super) struct Saturation {
    pub plateau_dn: f64,
    pub plateau_std_dn: f64,
    /// Counts from here on are clipped.
    pub count_dn: f64,
}

impl Saturation {
    /// The plateau is the brightest level, if its noise has collapsed to less
    /// than half of the largest (beyond the peak of the curve noise is clipped);
    /// counts within four standard deviations of it are not trusted.
    pub fn find(flats: &[&Level], cold: &[usize], bit_depth: u32) -> Result<Self, SensorFitError> {
        let variances: Vec<f64> = flats.iter().map(|l| l.temporal_variance(cold)).collect();
        let largest = variances.iter().copied().fold(0.0, f64::max);
        let top = flats.len() - 1;
        let plateau_dn = flats[top].mean_over(cold);
        if variances[top] > 0.5 * largest || largest <= 0.0 {
            return Err(SensorFitError::NeverSaturates {
                brightest_dn: plateau_dn,
            });
        }
        let spatial: f64 = cold
            .iter()
            .map(|&p| (flats[top].pixel_mean(p) - plateau_dn).powi(2))
            .sum::<f64>()
            / cold.len() as f64;
        let deviation = (spatial + variances[top]).sqrt();
        let full_scale_dn = ((1u64 << bit_depth.clamp(1, 16)) - 1) as f64;
        Ok(Self {
            plateau_dn,
            plateau_std_dn: deviation,
            count_dn: (plateau_dn - 4.0 * deviation).floor().min(full_scale_dn),
        })
    }
}
