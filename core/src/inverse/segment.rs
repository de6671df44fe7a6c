//! A log-quadratic density on a segment: its mass, and draws from it.

use std::f64::consts::{SQRT_2, TAU};

use crate::random::Stream;

/// Least curvature, so that a line without one is a normal's far flank: over a segment of
/// weights it changes the log density by less than 1e-6.
const LEAST_CURVATURE: f64 = 1e-6;

/// From so many standard deviations on a normal's flank is an exponential to the last digit
/// of its rate, and differences of squares would lose all of theirs.
const FAR_FLANK: f64 = 1e6;

/// Proposals of which one is accepted with certainty for any practical purpose: the worst case
/// accepts more than half of them.
const PROPOSALS: usize = 1000;

/// Density exp(s·t − ½c·t²) for t in 0..=length.
#[derive(Clone, Copy, Debug)]
pub struct Segment {
    /// Standard deviation of the normal that it is cut from.
    deviation: f64,
    /// The segment's ends from the normal's mean, in standard deviations.
    ends: [f64; 2],
    length: f64,
}

impl Segment {
    /// `slope` s of the log density at 0, its `curvature` c ≥ 0, `length` > 0.
    pub fn new(slope: f64, curvature: f64, length: f64) -> Self {
        let root = curvature.max(LEAST_CURVATURE).sqrt();
        let low = -slope / root;
        Self {
            deviation: 1.0 / root,
            ends: [low, low + length * root],
            length,
        }
    }

    /// Log of the integral over the segment.
    pub fn log_mass(&self) -> f64 {
        let [low, _] = self.ends;
        self.deviation.ln() + 0.5 * TAU.ln() + 0.5 * low * low + log_probability(self.ends)
    }

    /// One draw.
    pub fn draw(&self, numbers: &mut Stream) -> f64 {
        let [low, high] = self.ends;
        let near = low.max(-high);
        if near > FAR_FLANK {
            // From the nearer end, which no rounding of the two may exchange.
            let rate = near / self.deviation;
            let cut = -(-rate * self.length).exp_m1();
            let from_end = -(-numbers.uniform() * cut).ln_1p() / rate;
            let from_end = from_end.min(self.length);
            return if low > 0.0 {
                from_end
            } else {
                self.length - from_end
            };
        }
        let z = if low >= 0.0 {
            flank([low, high], numbers)
        } else if high <= 0.0 {
            -flank([-high, -low], numbers)
        } else {
            middle([low, high], numbers)
        };
        ((z - low) * self.deviation).clamp(0.0, self.length)
    }
}

/// Log probability that a standard normal lies between two numbers.
fn log_probability([low, high]: [f64; 2]) -> f64 {
    if low < 0.0 && high > 0.0 {
        let outside = log_upper(high).exp() + log_upper(-low).exp();
        if outside < 0.5 {
            return (-outside).ln_1p();
        }
    }
    let width = high - low;
    if width * low.abs().max(high.abs()).max(1.0) < 1e-4 {
        let middle = 0.5 * (low + high);
        return width.ln() - 0.5 * middle * middle - 0.5 * TAU.ln();
    }
    if low < 0.0 && high > 0.0 {
        return (0.5 * (libm::erf(high / SQRT_2) - libm::erf(low / SQRT_2))).ln();
    }
    let [near, far] = if low >= 0.0 {
        [low, high]
    } else {
        [-high, -low]
    };
    log_upper(near) + (-(log_upper(far) - log_upper(near)).exp_m1()).ln()
}

/// Log probability that a standard normal exceeds `z` ≥ 0.
fn log_upper(z: f64) -> f64 {
    if z < 20.0 {
        return (0.5 * libm::erfc(z / SQRT_2)).ln();
    }
    // Asymptotic series; the next term is 105/z⁸ < 5e-9.
    let r = 1.0 / (z * z);
    -0.5 * z * z - z.ln() - 0.5 * TAU.ln() + (r * (-1.0 + r * (3.0 - 15.0 * r))).ln_1p()
}

/// A standard normal between two numbers around zero, by rejection.
fn middle([low, high]: [f64; 2], numbers: &mut Stream) -> f64 {
    let narrow = high - low < TAU.sqrt();
    for _ in 0..PROPOSALS {
        let (z, accepted) = if narrow {
            let z = low + (high - low) * numbers.uniform();
            (z, numbers.uniform() < (-0.5 * z * z).exp())
        } else {
            let z = numbers.normal();
            (z, low <= z && z <= high)
        };
        if accepted {
            return z;
        }
    }
    0.0
}

/// A standard normal between two positive numbers, by rejection from an exponential
/// (Robert 1995), itself cut at `high`.
fn flank([low, high]: [f64; 2], numbers: &mut Stream) -> f64 {
    let rate = 0.5 * (low + low.hypot(2.0));
    let cut = -(-rate * (high - low)).exp_m1();
    let best = rate.min(high);
    for _ in 0..PROPOSALS {
        let z = low - (-numbers.uniform() * cut).ln_1p() / rate;
        // Of exp(−½z²) over exp(−rate·z), the largest is at `best`.
        if numbers.uniform() < (0.5 * (best - z) * (best + z) - rate * (best - z)).exp() {
            return z;
        }
    }
    low
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, stream};

    /// Slopes, curvatures and lengths: inside, on either flank, far out, flat, narrow.
    const CASES: [[f64; 3]; 9] = [
        [3.0, 20.0, 0.6],
        [-3.0, 20.0, 0.6],
        [30.0, 20.0, 0.6],
        [-400.0, 100.0, 0.9],
        [900.0, 100.0, 0.9],
        [2.0, 0.0, 0.5],
        [-5.0, 0.0, 1.0],
        [0.5, 1e5, 0.3],
        [1.0, 4.0, 1e-5],
    ];

    /// Log mass and mean by the midpoint rule, relative to the largest value.
    fn by_quadrature([slope, curvature, length]: [f64; 3]) -> [f64; 2] {
        let steps = 200_000;
        let log = |t: f64| slope * t - 0.5 * curvature * t * t;
        let at = |i: usize| length * (i as f64 + 0.5) / steps as f64;
        let largest = (0..steps).map(|i| log(at(i))).fold(f64::MIN, f64::max);
        let (mut sum, mut first) = (0.0, 0.0);
        for t in (0..steps).map(at) {
            let p = (log(t) - largest).exp();
            sum += p;
            first += p * t;
        }
        [largest + (sum * length / steps as f64).ln(), first / sum]
    }

    #[test]
    fn mass_is_the_integral() {
        for case in CASES {
            let [s, c, l] = case;
            let found = Segment::new(s, c, l).log_mass();
            let [expected, _] = by_quadrature(case);
            assert!(
                (found - expected).abs() < 1e-5,
                "{case:?}: {found} for {expected}"
            );
        }
    }

    /// Slopes and curvatures of likelihoods beyond any measurement, and what is not a number,
    /// end, and stay on the segment.
    #[test]
    fn extreme_densities_end() {
        let mut numbers = stream(9, Purpose::Posterior, 0, 0, 0);
        let magnitudes = [0.0, 1.0, 1e9, 1e80, 1e154, 1e200, 1e300, f64::MAX];
        for slope in magnitudes.iter().flat_map(|&m| [m, -m]).chain([f64::NAN]) {
            for curvature in magnitudes {
                let segment = Segment::new(slope, curvature, 0.7);
                for _ in 0..20 {
                    let t = segment.draw(&mut numbers);
                    let inside = (0.0..=0.7 * (1.0 + 1e-9)).contains(&t);
                    assert!(inside || slope.is_nan(), "{slope:e}, {curvature:e}: {t}");
                    // Steep: at the end that it rises to.
                    if slope.abs() > 1e8 && curvature <= 1.0 {
                        let end = if slope > 0.0 { 0.7 } else { 0.0 };
                        assert!((t - end).abs() < 1e-6, "{slope:e}, {curvature:e}: {t}");
                    }
                }
            }
        }
    }

    /// Means within five standard errors, where the deviation is at most the length's.
    #[test]
    fn draws_have_the_mean() {
        let mut numbers = stream(3, Purpose::Posterior, 0, 0, 0);
        for case in CASES {
            let [s, c, l] = case;
            let segment = Segment::new(s, c, l);
            let count = 20_000;
            let (mut sum, mut square) = (0.0, 0.0);
            for _ in 0..count {
                let t = segment.draw(&mut numbers);
                assert!((0.0..=l * (1.0 + 1e-9)).contains(&t), "{case:?}: {t}");
                sum += t;
                square += t * t;
            }
            let mean = sum / f64::from(count);
            let deviation = (square / f64::from(count) - mean * mean).max(0.0).sqrt();
            let [_, expected] = by_quadrature(case);
            let error = (mean - expected).abs() / (deviation / f64::from(count).sqrt());
            assert!(
                error < 5.0,
                "{case:?}: {mean} for {expected}, {error} deviations"
            );
        }
    }
}
