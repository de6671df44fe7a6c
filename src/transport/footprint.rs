//! The part of the sensor's plane that one pixel's value comes from: its unit square,
//! convolved with the Gaussian that lens and sensor spread a sharp point into.

use std::f64::consts::{PI, SQRT_2};

/// Where along one axis, pixels from the pixel's own corner, the quantile `u` in [0, 1) of
/// its footprint lies, for a point spread of standard deviation `sigma_px` ≥ 0.
///
/// Uniform numbers, stratified or not, become places distributed as the footprint, so that
/// the mean over them is the pixel's value. Without a spread it is `u` itself.
pub fn place(u: f64, sigma_px: f64) -> f64 {
    if sigma_px <= 0.0 {
        return u;
    }
    // Newton on the cumulative distribution, kept between bounds that hold the place.
    let reach = 0.5 + FARTHEST * sigma_px;
    let (mut low, mut high) = (-reach, reach);
    let mut x = u - 0.5;
    for _ in 0..MOST_STEPS {
        let [below, density] = distribution(x, sigma_px);
        let off = below - u;
        if off > 0.0 {
            high = x;
        } else {
            low = x;
        }
        let newton = x - off / density;
        let next = if newton > low && newton < high {
            newton
        } else {
            0.5 * (low + high)
        };
        let step = (next - x).abs();
        x = next;
        if step < CLOSE_PX {
            break;
        }
    }
    0.5 + x
}

/// Standard deviations beyond the square that still count: less than 1e-15 lies farther.
const FARTHEST: f64 = 8.0;
const MOST_STEPS: usize = 64;
const CLOSE_PX: f64 = 1e-9;

/// Part of the footprint up to `x`, pixels from the pixel's middle, and its density there.
/// Also the image of an edge, for a pixel `x` beyond it: the edge-spread function and the
/// line-spread function, pixel included.
pub fn distribution(x: f64, sigma_px: f64) -> [f64; 2] {
    if sigma_px <= 0.0 {
        let inside = if x.abs() < 0.5 { 1.0 } else { 0.0 };
        return [(x + 0.5).clamp(0.0, 1.0), inside];
    }
    let ends = [x + 0.5, x - 0.5].map(|t| {
        let z = t / sigma_px;
        let below = 0.5 * libm::erfc(-z / SQRT_2);
        let density = libm::exp(-0.5 * z * z) / (2.0 * PI).sqrt();
        [t * below + sigma_px * density, below]
    });
    [
        (ends[0][0] - ends[1][0]).clamp(0.0, 1.0),
        ends[0][1] - ends[1][1],
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The distribution against a plain sum of normal integrals over the square, and the
    /// places against the distribution.
    #[test]
    fn places_are_quantiles_of_square_and_gaussian() {
        for sigma in [0.02, 0.3, 1.0, 2.5] {
            for x in [-3.0, -0.7, -0.5, 0.0, 0.2, 1.4] {
                let steps = 4000;
                let sum: f64 = (0..steps)
                    .map(|i| x - 0.5 + (f64::from(i) + 0.5) / f64::from(steps))
                    .map(|t| 0.5 * (1.0 + libm::erf(t / sigma / SQRT_2)))
                    .sum();
                let [below, _] = distribution(x, sigma);
                let expected = sum / f64::from(steps);
                assert!((below - expected).abs() < 1e-5, "{sigma} {x}: {below}");
            }
            for u in [0.0, 1e-12, 1e-3, 0.25, 0.5, 0.77, 0.999, 1.0 - 1e-12] {
                let [below, _] = distribution(place(u, sigma) - 0.5, sigma);
                assert!((below - u).abs() < 1e-8, "{sigma} {u}: {below}");
            }
        }
    }

    #[test]
    fn without_a_spread_nothing_changes() {
        for u in [0.0, 0.123_456_789, 1.0 - f64::EPSILON] {
            assert_eq!(place(u, 0.0).to_bits(), u.to_bits());
        }
    }
}
