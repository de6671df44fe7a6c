//! What many figures have in common.

use crate::random::{Purpose, stream};
use crate::statistics::quantile;

/// Mean and median with 95% confidence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// Arithmetic mean.
    pub mean: f64,
    /// Its 95% percentile-bootstrap interval, lower and upper end.
    pub mean_95: [f64; 2],
    /// Median.
    pub median: f64,
    /// Its 95% percentile-bootstrap interval.
    pub median_95: [f64; 2],
}

/// Resamples of the bootstrap.
const RESAMPLES: u64 = 1000;

/// Mean and median of `values` over materials, with how far they would move for another
/// sample of as many materials. `None` without values.
pub fn spread(values: &[f64]) -> Option<Spread> {
    if values.is_empty() {
        return None;
    }
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
    let (mut means, mut medians) = (Vec::new(), Vec::new());
    for resample in 0..RESAMPLES {
        let mut numbers = stream(0, Purpose::Experiment, 0, resample, 0);
        let drawn: Vec<f64> = values
            .iter()
            .map(|_| values[(numbers.uniform() * values.len() as f64) as usize])
            .collect();
        means.push(mean(&drawn));
        medians.push(quantile(&drawn, 0.5));
    }
    let interval = |v: &[f64]| [quantile(v, 0.025), quantile(v, 0.975)];
    Some(Spread {
        mean: mean(values),
        mean_95: interval(&means),
        median: quantile(values, 0.5),
        median_95: interval(&medians),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_values_have_no_spread() {
        let spread = spread(&[1.0, 1.0, 1.0]).unwrap();
        assert_eq!(spread.mean_95, [1.0, 1.0]);
    }

    /// The bootstrap interval of a mean covers it about as often as stated: of 200
    /// samples of 40 uniform numbers, fewer than 175 or more than 199 covering has a
    /// probability below 1e-3 at 93 to 95% coverage.
    #[test]
    fn the_interval_of_the_mean_covers() {
        let covering = (0..200)
            .filter(|&sample| {
                let mut numbers = stream(5, Purpose::Experiment, 1, sample, 0);
                let values: Vec<f64> = (0..40).map(|_| numbers.uniform()).collect();
                let [low, high] = spread(&values).unwrap().mean_95;
                (low..=high).contains(&0.5)
            })
            .count();
        assert!((175..=199).contains(&covering), "{covering} of 200");
    }
}
