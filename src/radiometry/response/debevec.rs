//! Debevec and Malik's estimator: least squares in the logarithm.

use super::{BracketSamples, COUNTS, Curve, Response, ResponseError};

/// The curve g = ln(exposure) that minimises
/// `Σ w(z)² (g(z) − ln E − ln t)² + smoothness² Σ w(z)² g″(z)²`
/// over all samples, with their log radiances ln E eliminated and w the
/// triangle of the paper, high in the middle of the counts, but 0 for black and
/// white ones, which stand for all exposures beyond. A `smoothness` of 10 is usual.
///
/// # Errors
/// Samples that do not make a curve, see [`ResponseError`].
pub fn debevec(samples: &BracketSamples, smoothness: f64) -> Result<Response, ResponseError> {
    let (samples, well_exposed) = samples.clone().checked()?;
    let triangle2 = |z: usize| (1 + z.min(COUNTS - 1 - z)).pow(2) as f64;
    let weight2 = |z: usize| match well_exposed.contains(&(z as u8)) {
        true => triangle2(z),
        false => 0.0,
    };
    let ln_t: Vec<f64> = samples.exposures_s.iter().map(|t| t.ln()).collect();
    let mut curve = Curve::new();
    for counts in &samples.counts {
        let total: f64 = counts.iter().map(|&z| weight2(usize::from(z))).sum();
        let mean_ln_t = weighted_mean(counts, &ln_t, weight2);
        for (&z, &t) in counts.iter().zip(&ln_t) {
            let z = usize::from(z);
            curve.matrix[(z, z)] += weight2(z);
            curve.right[z] += weight2(z) * (t - mean_ln_t);
            for &other in counts {
                let other = usize::from(other);
                curve.matrix[(z, other)] -= weight2(z) * weight2(other) / total;
            }
        }
    }
    curve.smooth(|z| smoothness * smoothness * triangle2(z));
    let solved = curve.solve();
    let found = samples.counts.len();
    let (ln_exposure, variance) = solved.ok_or(ResponseError::TooFewSamples { found })?;

    let (mut residual2, mut observations) = (0.0, 0.0);
    for counts in &samples.counts {
        let over_t: Vec<f64> = counts
            .iter()
            .zip(&ln_t)
            .map(|(&z, t)| ln_exposure[usize::from(z)] - t)
            .collect();
        let ln_radiance = weighted_mean(counts, &over_t, weight2);
        for (&z, value) in counts.iter().zip(&over_t) {
            residual2 += weight2(usize::from(z)) * (value - ln_radiance).powi(2);
        }
        observations += counts
            .iter()
            .filter(|&&z| weight2(usize::from(z)) > 0.0)
            .count() as f64
            - 1.0;
    }
    let variance_of_weight_1 = residual2 / f64::max(observations - COUNTS as f64, 1.0);
    Ok(Response {
        ln_exposure,
        ln_std: variance
            .iter()
            .map(|v| (v.max(0.0) * variance_of_weight_1).sqrt())
            .collect(),
        darkest: *well_exposed.start(),
    })
}

fn weighted_mean(counts: &[u8], values: &[f64], weight: impl Fn(usize) -> f64) -> f64 {
    let (mut sum, mut total) = (0.0, 0.0);
    for (&z, value) in counts.iter().zip(values) {
        sum += weight(usize::from(z)) * value;
        total += weight(usize::from(z));
    }
    sum / total
}
