//! Robertson, Borman and Stevenson's estimator: the likeliest radiances and
//! curve in turn.

use super::{BracketSamples, COUNTS, Curve, MIDDLE, Response, ResponseError, debevec};

/// At most so many rounds ...
const ROUNDS: usize = 300;
/// ... until the curve's values change by less than this on average.
const SETTLED: f64 = 1e-5;
/// Errors that counts share through the radiances, over those of the curve that the rounds
/// start from: on simulated benches they are up to twice as large.
const SHARED: f64 = 2.0;
/// Smoothness of the curve that they start from.
const START_SMOOTHNESS: f64 = 10.0;

/// Alternates the likeliest radiance of each sample, `Σ w t I / Σ w t²`, and the
/// likeliest exposure I of each count, the mean of t times radiance where it
/// occurs, with the paper's bell of weights; then smooths the logarithm with the
/// weight of `smoothness` occurrences per squared second difference.
///
/// # Errors
/// Samples that do not make a curve, see [`ResponseError`].
pub fn robertson(samples: &BracketSamples, smoothness: f64) -> Result<Response, ResponseError> {
    let (samples, well_exposed) = samples.clone().checked()?;
    let weights: Vec<f64> = (0..COUNTS)
        .map(|z| match well_exposed.contains(&(z as u8)) {
            true => bell(z),
            false => 0.0,
        })
        .collect();
    // The rounds converge slowly over a wide bracket, so they begin near the end.
    let start = debevec(&samples, START_SMOOTHNESS)?;
    let mut exposure: Vec<f64> = (0..COUNTS).map(|z| start.exposure(z)).collect();
    let mut occurrences = [0.0; COUNTS];
    for &z in samples.counts.iter().flatten() {
        occurrences[usize::from(z)] += 1.0;
    }
    let radiance = |counts: &[u8], exposure: &[f64]| {
        let (mut sum, mut total) = (0.0, 0.0);
        for (&z, t) in counts.iter().zip(&samples.exposures_s) {
            let z = usize::from(z);
            sum += weights[z] * t * exposure[z];
            total += weights[z] * t * t;
        }
        if total > 0.0 { sum / total } else { 0.0 }
    };
    for _ in 0..ROUNDS {
        let mut next = [0.0; COUNTS];
        for counts in &samples.counts {
            let radiance = radiance(counts, &exposure);
            for (&z, t) in counts.iter().zip(&samples.exposures_s) {
                next[usize::from(z)] += t * radiance;
            }
        }
        let mut seen: Vec<f64> = (0..COUNTS)
            .map(|z| next[z] / f64::max(occurrences[z], 1.0))
            .collect();
        fill(&mut seen, &occurrences);
        let middle = seen[MIDDLE];
        let change: f64 = seen
            .iter_mut()
            .zip(&exposure)
            .map(|(new, old)| {
                *new /= middle;
                (*new - old).abs()
            })
            .sum();
        exposure = seen;
        if change < SETTLED * COUNTS as f64 {
            break;
        }
    }

    // Scatter of t times radiance about each count's exposure.
    let mut scatter2 = [0.0; COUNTS];
    for counts in &samples.counts {
        let radiance = radiance(counts, &exposure);
        for (&z, t) in counts.iter().zip(&samples.exposures_s) {
            let z = usize::from(z);
            // Black and white counts stand for all exposures beyond.
            if well_exposed.contains(&(z as u8)) {
                scatter2[z] += (t * radiance / exposure[z].max(1e-12) - 1.0).powi(2);
            }
        }
    }
    let mut curve = Curve::new();
    for z in 0..COUNTS {
        let certain = occurrences[z] * weights[z];
        if exposure[z] > 0.0 {
            curve.matrix[(z, z)] += certain;
            curve.right[z] += certain * exposure[z].ln();
        }
    }
    curve.smooth(|_| smoothness);
    let found = samples.counts.len();
    let solved = curve.solve();
    let (ln_exposure, _) = solved.ok_or(ResponseError::TooFewSamples { found })?;
    let well = usize::from(*well_exposed.start())..=usize::from(*well_exposed.end());
    let whole = scatter2.iter().sum::<f64>() / occurrences[well].iter().sum::<f64>();
    let ln_std = (0..COUNTS)
        .map(|z| {
            let n = occurrences[z];
            // Few occurrences borrow the scatter of all.
            let own2 = (scatter2[z] + whole) / (n + 1.0) / f64::max(n, 1.0);
            own2.sqrt().hypot(SHARED * start.ln_std[z])
        })
        .collect();
    Ok(Response {
        ln_exposure,
        ln_std,
        darkest: *well_exposed.start(),
    })
}

/// A bell over the counts, 1 in the middle and 0 at both ends.
fn bell(z: usize) -> f64 {
    let quarter = (COUNTS - 1) as f64 / 4.0;
    let x = z as f64 / quarter - 2.0;
    let edge = (-4.0f64).exp();
    (((-x * x).exp() - edge) / (1.0 - edge)).max(0.0)
}

/// Counts that never occur lie on a line between those that do.
fn fill(values: &mut [f64], occurrences: &[f64]) {
    let known: Vec<usize> = (0..values.len())
        .filter(|&z| occurrences[z] > 0.0)
        .collect();
    for pair in known.windows(2) {
        let (low, high) = (pair[0], pair[1]);
        for z in low + 1..high {
            let part = (z - low) as f64 / (high - low) as f64;
            values[z] = values[low] + part * (values[high] - values[low]);
        }
    }
    if let (Some(&first), Some(&last)) = (known.first(), known.last()) {
        for z in 0..first {
            values[z] = values[first] * (z as f64 + 0.5) / (first as f64 + 0.5);
        }
        for z in last + 1..values.len() {
            values[z] = values[last] * z as f64 / last as f64;
        }
    }
}
