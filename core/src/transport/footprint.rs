//! The part of the sensor's plane that one pixel's value comes from: its unit square,
//! convolved with the Gaussian that lens and sensor spread a sharp point into.

use std::f64::consts::{PI, SQRT_2};
use std::sync::LazyLock;

/// Where along one axis, pixels from the pixel's own corner, the quantile `u` in [0, 1) of
/// its footprint lies, for a point spread of standard deviation `sigma_px` ≥ 0.
///
/// Uniform numbers, stratified or not, become positions distributed as the footprint, so that
/// the mean over them is the pixel's value. Without a spread it is `u` itself.
pub fn position(u: f64, sigma_px: f64) -> f64 {
    if sigma_px <= 0.0 {
        return u;
    }
    // Newton on the cumulative distribution, kept between bounds that hold the position.
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
    let [[first, below_first], [second, below_second]] =
        [x + 0.5, x - 0.5].map(|t| normal(t / sigma_px));
    [
        (sigma_px * (first - second)).clamp(0.0, 1.0),
        below_first - below_second,
    ]
}

/// The integral of the normal distribution up to `z` and the distribution, from a table: both
/// within 1e-9. Rays are spread so often that the exact functions were a third of their cost.
fn normal(z: f64) -> [f64; 2] {
    let at = (z + FARTHEST) * PER_DEVIATION;
    if at < 0.0 {
        return [0.0, 0.0];
    }
    let Some([a, b]) = NORMAL
        .get(at as usize..at as usize + 2)
        .map(|ends| [ends[0], ends[1]])
    else {
        return [z, 1.0];
    };
    // A cubic through values and derivatives at both ends (Hermite): each column's derivative is
    // the next one.
    let t = at.fract();
    let (s, h) = (1.0 - t, 1.0 / PER_DEVIATION);
    std::array::from_fn(|k| {
        let values = s * s * (1.0 + 2.0 * t) * a[k] + t * t * (1.0 + 2.0 * s) * b[k];
        values + h * s * t * (s * a[k + 1] - t * b[k + 1])
    })
}

/// Rows of the table per standard deviation.
const PER_DEVIATION: f64 = 64.0;

/// At ±[`FARTHEST`] and between: integral of the distribution, distribution, density.
static NORMAL: LazyLock<Vec<[f64; 3]>> = LazyLock::new(|| {
    let rows = (2.0 * FARTHEST * PER_DEVIATION) as i32;
    let row = |i: i32| {
        let z = f64::from(i) / PER_DEVIATION - FARTHEST;
        let below = 0.5 * libm::erfc(-z / SQRT_2);
        let density = libm::exp(-0.5 * z * z) / (2.0 * PI).sqrt();
        [z * below + density, below, density]
    };
    (0..=rows).map(row).collect()
});

#[cfg(test)]
mod tests {
    use super::*;

    /// The distribution against a plain sum of normal integrals over the square, and the
    /// positions against the distribution.
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
                let [below, _] = distribution(position(u, sigma) - 0.5, sigma);
                assert!((below - u).abs() < 1e-8, "{sigma} {u}: {below}");
            }
        }
    }

    #[test]
    fn the_table_is_the_normal_distribution() {
        for i in -90_000..=90_000 {
            let z = f64::from(i) * 1e-4;
            let [integral, below] = normal(z);
            let exact = 0.5 * libm::erfc(-z / SQRT_2);
            let density = libm::exp(-0.5 * z * z) / (2.0 * PI).sqrt();
            assert!((below - exact).abs() < 1e-9, "{z}: {below} for {exact}");
            let exact = z * exact + density;
            assert!(
                (integral - exact).abs() < 1e-9,
                "{z}: {integral} for {exact}"
            );
        }
    }

    #[test]
    fn without_a_spread_nothing_changes() {
        for u in [0.0, 0.123_456_789, 1.0 - f64::EPSILON] {
            assert_eq!(position(u, 0.0).to_bits(), u.to_bits());
        }
    }
}
