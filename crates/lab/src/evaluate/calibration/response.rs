//! The response of a camera with a display's gamma, from a bracket of a scene of three
//! decades.

use super::{EvaluateError, Recovered, failed};
use crate::calibration::record::Measured;
use crate::radiometry::response::{
    BracketSamples, MIDDLE, Response, ResponseError, debevec, robertson,
};
use crate::random::{Purpose, stream};

const EXPOSURES: u32 = 9;
const PIXELS: u64 = 3000;
const GAMMA: f64 = 2.2;
/// Standard deviation of a count before rounding.
const NOISE_DN: f64 = 0.8;
const COUNTS: [(usize, &str); 4] = [
    (30, "ln exposure of count 30"),
    (70, "ln exposure of count 70"),
    (190, "ln exposure of count 190"),
    (235, "ln exposure of count 235"),
];

/// By Debevec and Malik's estimator.
pub(super) fn debevec_malik(seed: u64) -> Result<Vec<Recovered>, EvaluateError> {
    one(seed, |samples| debevec(samples, 10.0))
}

/// By Robertson, Borman and Stevenson's.
pub(super) fn robertson_and_others(seed: u64) -> Result<Vec<Recovered>, EvaluateError> {
    one(seed, |samples| robertson(samples, 30.0))
}

fn one(
    seed: u64,
    find: impl Fn(&BracketSamples) -> Result<Response, ResponseError>,
) -> Result<Vec<Recovered>, EvaluateError> {
    let exposures_s: Vec<f64> = (0..EXPOSURES).map(|k| 0.5f64.powi(k as i32)).collect();
    let counts = (0..PIXELS).map(|pixel| {
        let mut random = stream(seed, Purpose::Experiment, 4, pixel, 0);
        // Clips in 0.1 to 100 s.
        let radiance = 10f64.powf(3.0 * random.uniform() - 1.0);
        let count = |t: &f64| {
            let dn = 255.0 * (radiance * t).min(1.0).powf(1.0 / GAMMA);
            (dn + NOISE_DN * random.normal()).round().clamp(0.0, 255.0) as u8
        };
        exposures_s.iter().map(count).collect()
    });
    let samples = BracketSamples {
        counts: counts.collect(),
        exposures_s: exposures_s.clone(),
    };
    let found = find(&samples).map_err(failed)?;
    let of = |(count, quantity): (usize, &'static str)| Recovered {
        quantity,
        unit: "",
        truth: GAMMA * (count as f64 / MIDDLE as f64).ln(),
        found: Measured {
            value: found.ln_exposure[count],
            std: found.ln_std[count],
        },
    };
    Ok(COUNTS.map(of).into())
}
