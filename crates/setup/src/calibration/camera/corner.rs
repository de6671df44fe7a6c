//! One corner of a checkerboard, to some hundredths of a pixel: two blurred edges that
//! cross, under light that may change across them, fitted to the pixels around.
//!
//! The pattern looks the same turned by 180°, so errors of the model move no corner.

use glam::DVec2;
use nalgebra::{DMatrix, DVector, Matrix2, SMatrix, SVector};

use crate::calibration::mirror_sphere::Grey;
use crate::least_squares::{self, Equations, Options, Problem};
use crate::statistics::{normal_cdf, normal_density};

/// Middle (2), directions of the edges (2), blur, level, contrast, change of the light (2).
const NUMBERS: usize = 9;
type Numbers = SVector<f64, NUMBERS>;
/// The last step moves a corner by some 1e-4 of its uncertainty.
const STEPS: Options = Options {
    rounds: 30,
    damping: 1e-3,
    least_relative_gain: 1e-10,
    least_gain: 0.0,
};
/// Part of a corner's contrast that the pattern must explain.
const LEAST_EXPLAINED: f64 = 0.8;
/// Systematic error of a corner, pixels: sampling, blur that is not round.
const FLOOR_PX: f64 = 0.003;

/// A corner in the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Corner {
    /// Pixels from the top left corner.
    pub at_px: DVec2,
    /// Covariance, square pixels.
    pub covariance: Matrix2<f64>,
}

/// Refines a corner near `start_px` whose edges run at these angles (radians, from +x
/// towards +y), within `radius_px`. `None` where the image shows no such corner.
pub fn refine(
    image: &Grey,
    start_px: DVec2,
    angles_rad: [f64; 2],
    radius_px: f64,
) -> Option<Corner> {
    // Pixels fade out around where the corner is, so that none counts on one side alone.
    let rough = fit(image, start_px, angles_rad, radius_px)?;
    let fine = fit(image, rough.at_px, rough.angles_rad, radius_px)?;
    let near = fine.at_px.distance(start_px) < 0.5 * radius_px.min(4.0);
    near.then_some(Corner {
        at_px: fine.at_px,
        covariance: fine.covariance,
    })
}

struct Fitted {
    at_px: DVec2,
    angles_rad: [f64; 2],
    covariance: Matrix2<f64>,
}

/// Fits the pattern to the pixels around `start_px`.
fn fit(image: &Grey, start_px: DVec2, angles_rad: [f64; 2], radius_px: f64) -> Option<Fitted> {
    // The pixels around, fading out towards the edge of a disc.
    let middle = start_px.floor();
    let reach = radius_px.ceil();
    let low = middle - reach;
    let high = middle + reach;
    let size = DVec2::new(image.width as f64, image.height as f64);
    if low.min_element() < 0.0 || (high - size).max_element() >= 0.0 {
        return None;
    }
    let mut pixels = Vec::new();
    for y in low.y as usize..=high.y as usize {
        for x in low.x as usize..=high.x as usize {
            let at = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
            let index = y * image.width + x;
            let inside = 1.0 - at.distance_squared(start_px) / radius_px.powi(2);
            if image.valid[index] && inside > 0.0 {
                pixels.push(Pixel {
                    at,
                    value: image.value[index],
                    weight: inside * inside,
                });
            }
        }
    }
    if pixels.len() < 3 * NUMBERS {
        return None;
    }
    // The start: level and contrast from mean and scatter.
    let weights: f64 = pixels.iter().map(|p| p.weight).sum();
    let mean = pixels.iter().map(|p| p.weight * p.value).sum::<f64>() / weights;
    let off2 = |p: &Pixel| p.weight * (p.value - mean).powi(2);
    let total: f64 = pixels.iter().map(off2).sum();
    let spread = (total / weights).sqrt();
    let mut numbers = Numbers::from_column_slice(&[
        start_px.x,
        start_px.y,
        angles_rad[0],
        angles_rad[1],
        0.8,
        mean,
        spread,
        0.0,
        0.0,
    ]);
    // Which of the quarters is bright follows from the image.
    let along = |numbers: &Numbers| {
        let dot = |p: &Pixel| p.weight * (value(numbers, p.at).0 - mean) * (p.value - mean);
        pixels.iter().map(dot).sum::<f64>()
    };
    if along(&numbers) < 0.0 {
        numbers[6] = -numbers[6];
    }
    let mut pattern = Pattern { pixels, radius_px };
    let found = least_squares::minimise(&mut pattern, numbers, &STEPS);
    let numbers = found.point;
    let equations = pattern.linearise(&numbers);
    if !found.settled || equations.cost > (1.0 - LEAST_EXPLAINED) * total {
        return None;
    }
    // The covariance. The weights are not those of the noise.
    let count = pattern.pixels.len() as f64;
    let noise2 = equations.cost / weights * count / (count - NUMBERS as f64);
    let mut scatter = SMatrix::<f64, NUMBERS, NUMBERS>::zeros();
    for pixel in &pattern.pixels {
        let (_, by) = value(&numbers, pixel.at);
        scatter += by * by.transpose() * pixel.weight.powi(2);
    }
    let scatter = DMatrix::from_column_slice(NUMBERS, NUMBERS, scatter.as_slice());
    let covariance = equations.sandwich(&scatter)? * noise2;
    let own = covariance.fixed_view::<2, 2>(0, 0) + Matrix2::identity() * FLOOR_PX.powi(2);
    Some(Fitted {
        at_px: DVec2::new(numbers[0], numbers[1]),
        angles_rad: [numbers[2], numbers[3]],
        covariance: 0.5 * (own + own.transpose()),
    })
}

struct Pixel {
    at: DVec2,
    value: f64,
    weight: f64,
}

/// The model at one position in the image, and its derivatives.
fn value(numbers: &Numbers, at: DVec2) -> (f64, Numbers) {
    let offset = at - DVec2::new(numbers[0], numbers[1]);
    let blur = numbers[4];
    let edge = |angle: f64| {
        let along = DVec2::from_angle(angle);
        let u = along.perp_dot(offset) / blur;
        let step = 2.0 * normal_cdf(u) - 1.0;
        (along, u, step, 2.0 * normal_density(u))
    };
    let (a, ua, sa, da) = edge(numbers[2]);
    let (b, ub, sb, db) = edge(numbers[3]);
    let slope = DVec2::new(numbers[7], numbers[8]);
    let light = 1.0 + slope.dot(offset);
    let pattern = numbers[5] + numbers[6] * sa * sb;
    let by_ua = light * numbers[6] * da * sb;
    let by_ub = light * numbers[6] * sa * db;
    let mut by = Numbers::zeros();
    // The distance from an edge along `a` is aₓ·dy − a_y·dx.
    by[0] = (by_ua * a.y + by_ub * b.y) / blur - pattern * slope.x;
    by[1] = -(by_ua * a.x + by_ub * b.x) / blur - pattern * slope.y;
    by[2] = -by_ua * a.dot(offset) / blur;
    by[3] = -by_ub * b.dot(offset) / blur;
    by[4] = -(by_ua * ua + by_ub * ub) / blur;
    by[5] = light;
    by[6] = light * sa * sb;
    by[7] = pattern * offset.x;
    by[8] = pattern * offset.y;
    (light * pattern, by)
}

/// Two crossing edges, and the pixels to which they are fitted.
struct Pattern {
    pixels: Vec<Pixel>,
    radius_px: f64,
}

impl Problem for Pattern {
    type Point = Numbers;

    fn linearise(&mut self, at: &Numbers) -> Equations {
        let mut normal = SMatrix::<f64, NUMBERS, NUMBERS>::zeros();
        let mut right = Numbers::zeros();
        let mut cost = 0.0;
        for pixel in &self.pixels {
            let (model, by) = value(at, pixel.at);
            let off = pixel.value - model;
            normal += by * by.transpose() * pixel.weight;
            right += by * (off * pixel.weight);
            cost += pixel.weight * off * off;
        }
        Equations {
            normal: DMatrix::from_column_slice(NUMBERS, NUMBERS, normal.as_slice()),
            right: DVector::from_column_slice(right.as_slice()),
            cost,
        }
    }

    fn cost(&self, at: &Numbers) -> f64 {
        let square = |p: &Pixel| p.weight * (p.value - value(at, p.at).0).powi(2);
        self.pixels.iter().map(square).sum()
    }

    fn moved(&self, from: &Numbers, step: &DVector<f64>) -> Numbers {
        let mut next = from + Numbers::from_column_slice(step.as_slice());
        next[4] = next[4].clamp(0.2, self.radius_px);
        next
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_derivatives_are_those_of_the_model() {
        let numbers = Numbers::from_column_slice(&[5.2, 4.9, 0.3, 1.7, 0.9, 2.0, 0.7, 0.02, -0.03]);
        let at = DVec2::new(6.1, 4.2);
        let (_, by) = value(&numbers, at);
        for k in 0..NUMBERS {
            let step = 1e-4;
            let shifted = |sign: f64| {
                let mut numbers = numbers;
                numbers[k] += sign * step;
                value(&numbers, at).0
            };
            let expected = (shifted(1.0) - shifted(-1.0)) / (2.0 * step);
            // The integral's approximation is smooth to some 1e-7.
            assert!((by[k] - expected).abs() < 5e-3, "{k}: {} {expected}", by[k]);
        }
    }
}
