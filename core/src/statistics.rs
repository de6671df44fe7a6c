//! Order statistics and the normal and χ² distributions.

use std::f64::consts::{PI, SQRT_2};

/// Standard deviation of a normal distribution over its median absolute deviation.
pub const STD_OVER_MAD: f64 = 1.4826;
/// Median of χ² with one degree of freedom.
pub const CHI2_1_MEDIAN: f64 = 0.4549;
/// Median of χ² with two degrees of freedom.
pub const CHI2_2_MEDIAN: f64 = 1.386;

/// The middle value; of an even number of values the larger of the two in the middle.
/// `None` without values.
pub fn median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.into_iter().collect();
    let middle = values.len() / 2;
    select(&mut values, middle)
}

/// The value with a fraction `p` (0 to 1) of the others below it, rounded down to one of
/// the values. `None` without values.
pub fn order_statistic(values: impl IntoIterator<Item = f64>, p: f64) -> Option<f64> {
    let mut values: Vec<f64> = values.into_iter().collect();
    let last = values.len().saturating_sub(1);
    select(&mut values, (p.clamp(0.0, 1.0) * last as f64) as usize)
}

fn select(values: &mut [f64], index: usize) -> Option<f64> {
    if values.is_empty() {
        return None;
    }
    Some(*values.select_nth_unstable_by(index, f64::total_cmp).1)
}

/// The `p` quantile (0 to 1), linear between order statistics; NaN without values.
///
/// ```
/// assert_eq!(rig_core::statistics::quantile(&[3.0, 1.0, 2.0, 10.0], 0.5), 2.5);
/// ```
pub fn quantile(values: &[f64], p: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let Some(last) = sorted.len().checked_sub(1) else {
        return f64::NAN;
    };
    let at = p.clamp(0.0, 1.0) * last as f64;
    let low = at.floor() as usize;
    let high = (low + 1).min(last);
    sorted[low] + (at - low as f64) * (sorted[high] - sorted[low])
}

/// Density of the standard normal distribution.
pub fn normal_density(z: f64) -> f64 {
    (-0.5 * z * z).exp() / (2.0 * PI).sqrt()
}

/// Probability that a standard normal variable is below `z`.
pub fn normal_cdf(z: f64) -> f64 {
    0.5 * libm::erfc(-z / SQRT_2)
}

/// The z that a standard normal variable exceeds in magnitude with probability `p`
/// (0 to 1), to 1e-17; at most 10.
pub fn two_sided_normal_quantile(p: f64) -> f64 {
    // Bisection: the tail falls with z.
    let (mut low, mut high) = (0.0, 10.0);
    for _ in 0..60 {
        let middle: f64 = 0.5 * (low + high);
        match libm::erfc(middle / SQRT_2) > p {
            true => low = middle,
            false => high = middle,
        }
    }
    high
}

/// Probability that χ² with `freedom` degrees of freedom exceeds `value`, by Wilson and
/// Hilferty's approximation (1931); 1 below half a degree of freedom.
pub fn chi2_tail(value: f64, freedom: f64) -> f64 {
    if freedom < 0.5 {
        return 1.0;
    }
    let spread = 2.0 / (9.0 * freedom);
    let z = ((value / freedom).cbrt() - (1.0 - spread)) / spread.sqrt();
    1.0 - normal_cdf(z)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn order_statistics_are_values_and_quantiles_lie_between_them() {
        let values = [3.0, 1.0, 2.0, 10.0];
        assert_eq!(median(values), Some(3.0));
        assert_eq!(median([]), None);
        assert_eq!(order_statistic(values, 0.5), Some(2.0));
        assert_eq!(order_statistic(values, 1.0), Some(10.0));
        assert_eq!(quantile(&values, 0.5), 2.5);
        assert_eq!(quantile(&[3.0, 1.0, 2.0], 1.0), 3.0);
        assert!(quantile(&[], 0.5).is_nan());
    }

    #[test]
    fn tails_are_those_of_tables() {
        assert!((normal_cdf(1.96) - 0.975_002).abs() < 1e-6);
        assert!((two_sided_normal_quantile(0.05) - 1.959_964).abs() < 1e-6);
        // χ² with 10 degrees of freedom exceeds 18.307 with probability 0.05.
        assert!((chi2_tail(18.307, 10.0) - 0.05).abs() < 5e-4);
        assert!((normal_density(1.0) - 0.241_971).abs() < 1e-6);
    }
}
