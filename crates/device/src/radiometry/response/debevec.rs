//! Debevec and Malik's estimator: least squares in the logarithm.

use nalgebra::DMatrix;

use super::{BracketSamples, COUNTS, Curve, Response, ResponseError};

/// Part of the counts' range that an expected count must keep from black and white.
const MARGIN: f64 = 2.0;

/// The curve g = ln(exposure) that minimises
/// `Σ w² (g(z) − ln E − ln t)² + smoothness² Σ w(z)² g″(z)²`
/// over all samples, with their log radiances ln E eliminated and w the triangle of the
/// paper, high in the middle of the counts, but 0 for black and white ones, which stand for
/// all exposures beyond. A `smoothness` of 10 is usual.
///
/// Samples are weighted as in the paper by their own count first, then by the count that
/// the first curve expects: a weight that knows a count's noise favours one side of it,
/// which bends the curve. The uncertainty is of the samples' scatter about the curve,
/// pixel by pixel, whatever the noise is like.
///
/// # Errors
/// Samples that do not make a curve, see [`ResponseError`].
pub fn debevec(samples: &BracketSamples, smoothness: f64) -> Result<Response, ResponseError> {
    let (samples, well_exposed) = samples.clone().checked()?;
    let bracket = Bracket {
        counts: &samples.counts,
        ln_t: samples.exposures_s.iter().map(|t| t.ln()).collect(),
        smoothness,
    };
    let found = samples.counts.len();
    let unsolved = ResponseError::TooFewSamples { found };
    let by_count = |&z: &u8| match well_exposed.contains(&z) {
        true => triangle2(f64::from(z)),
        false => 0.0,
    };
    let own: Vec<Vec<f64>> = samples
        .counts
        .iter()
        .map(|counts| counts.iter().map(by_count).collect())
        .collect();
    let (first, _) = bracket.solve(&own).ok_or(unsolved.clone())?;
    let response = |ln_exposure, ln_std| Response {
        ln_exposure,
        ln_std,
        darkest: *well_exposed.start(),
    };
    let first = response(first, Vec::new());
    let low = f64::from(*well_exposed.start()) + MARGIN;
    let high = f64::from(*well_exposed.end()) - MARGIN;
    let expected: Vec<Vec<f64>> = (0..found)
        .map(|pixel| {
            let ln_radiance = bracket.ln_radiance(pixel, &own[pixel], &first.ln_exposure);
            let weight = |t: &f64| {
                let count = first.count((ln_radiance + t).exp());
                match (low..=high).contains(&count) {
                    true => triangle2(count),
                    false => 0.0,
                }
            };
            bracket.ln_t.iter().map(weight).collect()
        })
        .collect();
    let (ln_exposure, inverse) = bracket.solve(&expected).ok_or(unsolved)?;
    let ln_std = bracket.scatter(&expected, &ln_exposure, &inverse);
    Ok(response(ln_exposure, ln_std))
}

fn triangle2(count: f64) -> f64 {
    (1.0 + count.min((COUNTS - 1) as f64 - count)).powi(2)
}

struct Bracket<'a> {
    counts: &'a [Vec<u8>],
    ln_t: Vec<f64>,
    smoothness: f64,
}

impl Bracket<'_> {
    /// The curve for these weights of every sample, and the inverse of its matrix.
    fn solve(&self, weights: &[Vec<f64>]) -> Option<(Vec<f64>, DMatrix<f64>)> {
        let mut curve = Curve::new();
        for (counts, weights) in self.counts.iter().zip(weights) {
            let total: f64 = weights.iter().sum();
            if total <= 0.0 {
                continue;
            }
            let pairs = || counts.iter().map(|&z| usize::from(z)).zip(weights);
            let mean_ln_t = weighted_mean(&self.ln_t, weights);
            for ((z, &weight), t) in pairs().zip(&self.ln_t) {
                if weight == 0.0 {
                    continue;
                }
                curve.matrix[(z, z)] += weight;
                curve.right[z] += weight * (t - mean_ln_t);
                for (other, &with) in pairs() {
                    curve.matrix[(z, other)] -= weight * with / total;
                }
            }
        }
        let smoothness2 = self.smoothness * self.smoothness;
        curve.smooth(|z| smoothness2 * triangle2(z as f64));
        curve.solve()
    }

    fn ln_radiance(&self, pixel: usize, weights: &[f64], ln_exposure: &[f64]) -> f64 {
        let counts = self.counts[pixel].iter().zip(&self.ln_t);
        let over_t: Vec<f64> = counts
            .map(|(&z, t)| ln_exposure[usize::from(z)] - t)
            .collect();
        weighted_mean(&over_t, weights)
    }

    /// Standard uncertainty of the curve. Where samples are, from what each pixel pulls it
    /// by; beyond, from their mean scatter and the smoothness.
    fn scatter(
        &self,
        weights: &[Vec<f64>],
        ln_exposure: &[f64],
        inverse: &DMatrix<f64>,
    ) -> Vec<f64> {
        let mut pulls = DMatrix::zeros(COUNTS, COUNTS);
        let mut seen = [false; COUNTS];
        let (mut residual2, mut observations) = (0.0, 0.0);
        for (pixel, weights) in weights.iter().enumerate() {
            let counts = &self.counts[pixel];
            let ln_radiance = self.ln_radiance(pixel, weights, ln_exposure);
            let pull: Vec<(usize, f64)> = counts
                .iter()
                .zip(&self.ln_t)
                .zip(weights)
                .filter(|(_, weight)| **weight > 0.0)
                .map(|((&z, t), weight)| {
                    let z = usize::from(z);
                    let residual = ln_exposure[z] - t - ln_radiance;
                    residual2 += weight * residual * residual;
                    seen[z] = true;
                    (z, weight * residual)
                })
                .collect();
            observations += (pull.len() as f64 - 1.0).max(0.0);
            for &(z, a) in &pull {
                for &(other, b) in &pull {
                    pulls[(z, other)] += a * b;
                }
            }
        }
        let freedom = f64::max(observations - COUNTS as f64, 1.0);
        let by_pixels = inverse * pulls * inverse * (observations / freedom).max(1.0);
        let of_weight_1 = residual2 / freedom;
        (0..COUNTS)
            .map(|z| match seen[z] {
                true => by_pixels[(z, z)].max(0.0).sqrt(),
                false => (inverse[(z, z)].max(0.0) * of_weight_1).sqrt(),
            })
            .collect()
    }
}

/// Without any weight 0.
fn weighted_mean(values: &[f64], weights: &[f64]) -> f64 {
    let total: f64 = weights.iter().sum();
    let sum: f64 = values.iter().zip(weights).map(|(v, w)| v * w).sum();
    if total > 0.0 { sum / total } else { 0.0 }
}
