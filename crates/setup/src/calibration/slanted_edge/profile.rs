//! The image of a straight edge across it: pixel, point spread and defocus together.

use crate::transport::footprint::distribution;

/// What blurs an edge, pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Blur {
    /// Variance of the Gaussian point spread, square pixels.
    pub spread_px2: f64,
    /// Radius of the disc of a point out of focus.
    pub disc_px: f64,
    /// Angle between the edge and the nearer axis of the image, radians.
    pub tilt_rad: f64,
}

/// The edge-spread function of a blur, tabulated: 0 far on one side, 1 on the other.
pub struct Profile {
    reach_px: f64,
    /// Value and slope.
    knots: Vec<[f64; 2]>,
}

const KNOTS_PER_PX: f64 = 5.0;

/// Gauss–Legendre nodes and weights on [-1/2, 1/2]: for the pixel's shorter side, along
/// which the profile hardly changes.
const BOX: [[f64; 2]; 3] = [
    [-0.387_298_334_620_742, 5.0 / 18.0],
    [0.0, 8.0 / 18.0],
    [0.387_298_334_620_742, 5.0 / 18.0],
];

impl Profile {
    /// For distances up to `reach_px` from the edge.
    pub fn new(blur: &Blur, reach_px: f64) -> Self {
        let (sin, cos) = blur.tilt_rad.sin_cos();
        let (long, short) = (cos.abs().max(sin.abs()), cos.abs().min(sin.abs()));
        let sigma_px = blur.spread_px2.max(0.0).sqrt();
        let one = |t: f64| {
            let [value, slope] = distribution(t / long, sigma_px / long);
            [value, slope / long]
        };
        let nodes = disc_nodes(blur.disc_px);
        let at = |t: f64| {
            let mut sum = [0.0; 2];
            for [across, part] in &nodes {
                for [place, share] in BOX {
                    let [value, slope] = one(t - across - short * place);
                    sum[0] += part * share * value;
                    sum[1] += part * share * slope;
                }
            }
            sum
        };
        let count = (2.0 * reach_px * KNOTS_PER_PX).ceil() as usize + 1;
        let knots = (0..=count)
            .map(|i| at(i as f64 / KNOTS_PER_PX - reach_px))
            .collect();
        Self { reach_px, knots }
    }

    /// Value and slope at a distance from the edge, pixels; beyond the reach that at its end.
    pub fn at(&self, t_px: f64) -> [f64; 2] {
        let last = self.knots.len() - 2;
        let place = ((t_px + self.reach_px) * KNOTS_PER_PX).clamp(0.0, last as f64 + 0.999_999);
        let knot = (place.floor() as usize).min(last);
        let x = place - knot as f64;
        let ([a, da], [b, db]) = (self.knots[knot], self.knots[knot + 1]);
        let (da, db) = (da / KNOTS_PER_PX, db / KNOTS_PER_PX);
        // Hermite's cubic through values and slopes.
        let (c, d) = (3.0 * (b - a) - 2.0 * da - db, 2.0 * (a - b) + da + db);
        let value = a + x * (da + x * (c + x * d));
        let slope = (da + x * (2.0 * c + 3.0 * x * d)) * KNOTS_PER_PX;
        [value, slope]
    }
}

/// Positions across and weights of a disc seen along an edge: Chebyshev's second rule, exact
/// for polynomials of a degree below twice their number. The wider the disc against the
/// pixel, the more of them.
fn disc_nodes(radius_px: f64) -> Vec<[f64; 2]> {
    if radius_px <= 0.0 {
        return vec![[0.0, 1.0]];
    }
    let count = (4 + (3.0 * radius_px) as usize).min(24);
    let n = (count + 1) as f64;
    (1..=count)
        .map(|i| {
            let (sin, cos) = (i as f64 * std::f64::consts::PI / n).sin_cos();
            [radius_px * cos, 2.0 / n * sin * sin]
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::statistics::normal_cdf;
    use std::f64::consts::TAU;

    /// Against a plain sum over the pixel's square and the disc.
    #[test]
    fn a_profile_is_pixel_spread_and_disc() {
        for (sigma, radius, tilt_deg) in [(0.4, 0.0, 5.0), (0.7, 1.5, 12.0), (0.5, 3.0, 38.0)] {
            let tilt_rad = f64::to_radians(tilt_deg);
            let blur = Blur {
                spread_px2: sigma * sigma,
                disc_px: radius,
                tilt_rad,
            };
            let profile = Profile::new(&blur, 8.0);
            for t in [-4.1, -1.0, -0.3, 0.0, 0.45, 2.0, 3.3] {
                let (mut sum, mut count) = (0.0, 0);
                let places = || (0..24).map(|i| (f64::from(i) + 0.5) / 24.0);
                for (x, y) in places().flat_map(|x| places().map(move |y| (x - 0.5, y - 0.5))) {
                    for (r, phi) in places().flat_map(|r| places().map(move |p| (r, p * TAU))) {
                        let off = radius * r.sqrt() * phi.cos();
                        let place = t + x * tilt_rad.cos() + y * tilt_rad.sin() + off;
                        sum += normal_cdf(place / sigma);
                        count += 1;
                    }
                }
                let [value, slope] = profile.at(t);
                let expected = sum / f64::from(count);
                assert!(
                    (value - expected).abs() < 1e-3,
                    "{blur:?} {t}: {value} {expected}"
                );
                let step = 1e-4;
                let difference = profile.at(t + step)[0] - profile.at(t - step)[0];
                assert!(
                    (slope - difference / (2.0 * step)).abs() < 1e-3,
                    "{blur:?} {t}"
                );
            }
        }
    }
}
