//! How far predictions are from images, next to what else predicts them.

use super::validate_baselines::Neighbours;
use super::validate_pixels::Pixel;
use crate::radiance_image::RadianceImage;
use crate::session::validation::{LeftOut, LightScore, RegionScore};
use crate::statistics::{quantile, two_sided_normal_quantile};

/// Sums of squares over pixels and channels.
#[derive(Clone, Copy, Default)]
struct Sums {
    pixels: usize,
    captured: f64,
    error: f64,
    noise: f64,
    lambertian: f64,
    /// Of the pixels that have neighbours: their error, and captured.
    neighbours: Option<[f64; 2]>,
}

impl Sums {
    fn add(&mut self, other: &Self) {
        self.pixels += other.pixels;
        self.captured += other.captured;
        self.error += other.error;
        self.noise += other.noise;
        self.lambertian += other.lambertian;
        if let Some(more) = other.neighbours {
            let [error, captured] = self.neighbours.get_or_insert_default();
            *error += more[0];
            *captured += more[1];
        }
    }

    fn score(&self) -> RegionScore {
        let ratio = |sum: f64, all: f64| (all > 0.0).then(|| (sum / all).sqrt());
        let relative = |sum: f64| ratio(sum, self.captured);
        RegionScore {
            pixels: self.pixels,
            relative_rms: relative(self.error),
            noise: relative(self.noise),
            lambertian: relative(self.lambertian),
            neighbours: self
                .neighbours
                .and_then(|[error, captured]| ratio(error, captured)),
        }
    }
}

/// What is known of a light before it is scored.
pub(super) struct Compared<'a> {
    pub pixels: &'a [Pixel],
    pub left_out: LeftOut,
    pub captured: &'a RadianceImage,
    pub predicted: &'a RadianceImage,
    /// Standard deviation by the posterior samples; `None` without any.
    pub deviations: Option<&'a [[f32; 3]]>,
    /// Albedo over π.
    pub lambertian: [f64; 3],
}

/// A light's sums, of which those of several lights can be added.
#[derive(Default)]
pub(super) struct Tally {
    away: Sums,
    highlight: Sums,
    inside: usize,
    half_widths: Vec<f64>,
    left_out: LeftOut,
}

impl Tally {
    /// Of one light.
    pub fn of(compared: &Compared<'_>, neighbours: &mut Option<Neighbours>) -> Self {
        let quantile = two_sided_normal_quantile(0.05);
        let mut tally = Self {
            left_out: compared.left_out,
            ..Self::default()
        };
        for pixel in compared.pixels {
            let captured = compared.captured.mean[pixel.index].map(f64::from);
            let variance = compared.captured.variance[pixel.index].map(f64::from);
            let predicted = compared.predicted.mean[pixel.index].map(f64::from);
            let of_paths = compared.predicted.variance[pixel.index].map(f64::from);
            let near = neighbours.as_mut().and_then(|all| all.at(pixel));
            let mut sums = Sums {
                pixels: 1,
                ..Sums::default()
            };
            for c in 0..3 {
                let to = |value: f64| (value - captured[c]).powi(2);
                sums.captured += captured[c] * captured[c];
                sums.error += to(predicted[c]);
                sums.noise += variance[c];
                sums.lambertian += to(compared.lambertian[c] * pixel.irradiance[c]);
                if let Some(near) = near {
                    let [error, all] = sums.neighbours.get_or_insert_default();
                    *error += to(near[c] * pixel.irradiance[c]);
                    *all += captured[c] * captured[c];
                }
                if let Some(deviations) = compared.deviations {
                    let deviation = f64::from(deviations[pixel.index][c]);
                    let total = (deviation * deviation + variance[c] + of_paths[c]).sqrt();
                    tally.inside += usize::from(to(predicted[c]).sqrt() <= quantile * total);
                    if predicted[c] > 0.0 {
                        tally.half_widths.push(quantile * total / predicted[c]);
                    }
                }
            }
            match pixel.is_highlight() {
                true => tally.highlight.add(&sums),
                false => tally.away.add(&sums),
            }
        }
        tally
    }

    /// With those of another light.
    pub fn join(&mut self, other: Self) {
        self.away.add(&other.away);
        self.highlight.add(&other.highlight);
        self.inside += other.inside;
        self.half_widths.extend(other.half_widths);
        self.left_out += other.left_out;
    }

    /// What they come to. `light`: its number, or how many they are.
    pub fn score(&self, light: usize, has_intervals: bool) -> LightScore {
        let mut overall = self.away;
        overall.add(&self.highlight);
        let values = 3 * overall.pixels;
        let stated = has_intervals && values > 0;
        LightScore {
            light,
            overall: overall.score(),
            away: self.away.score(),
            highlight: self.highlight.score(),
            coverage: stated.then(|| self.inside as f64 / values as f64),
            median_half_width: (stated && !self.half_widths.is_empty())
                .then(|| quantile(&self.half_widths, 0.5)),
            left_out: self.left_out,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, stream};

    #[test]
    fn coverage_tells_intervals_that_are_too_wide_right_or_too_narrow() {
        const DEVIATION: f32 = 0.05;
        let mut numbers = stream(1, Purpose::Experiment, 0, 0, 0);
        let mut captured = RadianceImage::new(100, 40);
        let mut predicted = captured.clone();
        for (c, p) in captured.mean.iter_mut().zip(&mut predicted.mean) {
            *p = [1.0; 3];
            *c = p.map(|p| p + DEVIATION * numbers.normal() as f32);
        }
        let pixel = |index| Pixel {
            index,
            theta_h_rad: 0.01 * index as f64 / 40.0,
            theta_d_rad: 0.2,
            irradiance: [1.0; 3],
        };
        let pixels: Vec<Pixel> = (0..4000).map(pixel).collect();
        // Of a normal variable, the part within 1.96 times 3, 1 and 1/3 deviations.
        for (factor, expected) in [(3.0, 1.0), (1.0, 0.95), (1.0 / 3.0, 0.4865)] {
            let stated = vec![[factor * DEVIATION; 3]; 4000];
            let compared = Compared {
                pixels: &pixels,
                left_out: LeftOut::default(),
                captured: &captured,
                predicted: &predicted,
                deviations: Some(&stated),
                lambertian: [1.0; 3],
            };
            let score = Tally::of(&compared, &mut None).score(0, true);
            // Three deviations of the scatter of 12000 values.
            let coverage = score.coverage.unwrap();
            assert!((coverage - expected).abs() < 0.014, "{factor}: {coverage}");
            let half_width = 1.96 * f64::from(factor * DEVIATION);
            assert!((score.median_half_width.unwrap() / half_width - 1.0).abs() < 1e-3);
            assert!((score.overall.relative_rms.unwrap() - 0.05).abs() < 0.002);
        }
    }
}
