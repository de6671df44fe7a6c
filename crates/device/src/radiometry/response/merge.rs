//! Merging frames whose counts go through a response.
//!
//! The noise of such a camera is known only roughly: one standard deviation in
//! counts, taken from how much the frames differ. As in the merge of raw frames,
//! a frame is weighted by what the pixel's pooled radiance predicts for it, never
//! by its own count.

use std::ops::Range;

use rayon::prelude::*;

use super::{COUNTS, Response};
use crate::radiometry::agreement::{ExposureTally, by_colour};
use crate::radiometry::plane::MergedPlane;
use crate::statistics::{STD_OVER_MAD, median};

/// Predicted counts outside of this range have no weight: near black, rounding
/// and the camera's processing rule; near white, clipping.
const USABLE: std::ops::RangeInclusive<f64> = 4.0..=248.0;
/// Counts at or above this are clipped.
pub(super) const WHITE: u16 = (COUNTS - 1) as u16;
/// Least standard deviation of a count: rounding.
const ROUNDING_DN: f64 = 0.288_675;

/// The frames of one channel, with the response that they share.
#[derive(Clone, Debug)]
pub struct ResponseMerge<'a> {
    pub(super) response: &'a Response,
    pub(super) width: usize,
    /// Exposure, seconds, and counts of each frame.
    pub(super) frames: Vec<(f64, &'a [u16])>,
}

impl<'a> ResponseMerge<'a> {
    /// Frames of equal size, `width` pixels per row.
    pub fn new(response: &'a Response, width: usize, frames: Vec<(f64, &'a [u16])>) -> Self {
        Self {
            response,
            width,
            frames,
        }
    }

    /// Relative radiance (relative exposure per second) with its variance.
    pub fn finish(&self) -> MergedPlane {
        let (mut plane, tallies) = self.finish_band(0..usize::MAX);
        plane.agreement = by_colour(&tallies).concat();
        plane
    }

    /// [`Self::finish`], with how the exposures agree in the `counted` rows, shortest first, in
    /// place of the plane's agreement.
    pub(in crate::radiometry) fn finish_band(
        &self,
        counted: Range<usize>,
    ) -> (MergedPlane, Vec<ExposureTally>) {
        let pixels = self.frames.first().map_or(0, |(_, counts)| counts.len());
        let first: Vec<f64> = (0..pixels)
            .into_par_iter()
            .map(|pixel| self.estimate(pixel, None, ROUNDING_DN).0)
            .collect();
        let noise_dn = self.noise_dn(&first);
        let pooled: Vec<f64> = (0..pixels)
            .into_par_iter()
            .map(|pixel| self.pooled(&first, pixel))
            .collect();
        let results: Vec<(f64, f64, bool)> = (0..pixels)
            .into_par_iter()
            .map(|pixel| self.estimate(pixel, Some(pooled[pixel]), noise_dn))
            .collect();
        let plane = MergedPlane {
            width: self.width,
            height: pixels / self.width.max(1),
            mean: results.iter().map(|r| r.0 as f32).collect(),
            variance: results.iter().map(|r| r.1 as f32).collect(),
            valid: results.iter().map(|r| r.2).collect(),
            agreement: Vec::new(),
        };
        let rows = counted.start..counted.end.min(plane.height);
        let tallies = self.compare(&first, &pooled, rows);
        (plane, tallies)
    }

    /// Whether a predicted count depends on light.
    pub(super) fn usable(&self, predicted: f64) -> bool {
        USABLE.contains(&predicted) && predicted >= f64::from(self.response.darkest)
    }

    /// Radiance, variance and whether any frame is of use. Without a pooled
    /// radiance the frames' own counts decide.
    fn estimate(&self, pixel: usize, pooled: Option<f64>, noise_dn: f64) -> (f64, f64, bool) {
        let (mut sum, mut total) = (0.0, 0.0);
        for &(exposure_s, counts) in &self.frames {
            let count = counts[pixel];
            let predicted = pooled.map_or(f64::from(count), |radiance| {
                self.response.count(radiance * exposure_s)
            });
            if count >= WHITE || !self.usable(predicted) {
                continue;
            }
            let std = noise_dn * self.response.slope(predicted) / exposure_s;
            let weight = 1.0 / (std * std);
            sum += weight * self.response.exposure(usize::from(count)) / exposure_s;
            total += weight;
        }
        if total > 0.0 {
            return (sum / total, 1.0 / total, true);
        }
        self.beyond(pixel, noise_dn)
    }

    /// Darker than all frames can measure: the longest, with its uncertainty.
    /// Brighter: the shortest, and not valid.
    fn beyond(&self, pixel: usize, noise_dn: f64) -> (f64, f64, bool) {
        let by_exposure = |a: &&(f64, &[u16]), b: &&(f64, &[u16])| a.0.total_cmp(&b.0);
        let open = |frame: &&(f64, &[u16])| frame.1[pixel] < WHITE;
        let longest = self.frames.iter().filter(open).max_by(by_exposure);
        let any = longest.or_else(|| self.frames.iter().min_by(by_exposure));
        let Some(&(exposure_s, counts)) = any else {
            return (0.0, 0.0, false);
        };
        let count = counts[pixel];
        let std = noise_dn * self.response.slope(f64::from(count)) / exposure_s;
        let radiance = self.response.exposure(usize::from(count)) / exposure_s;
        let darkest = f64::from(self.response.darkest).max(*USABLE.start());
        let dark = f64::from(count) < darkest;
        (radiance, std * std, dark)
    }

    /// Mean of the radiances of the pixel and of those neighbours within 10% of it.
    fn pooled(&self, first: &[f64], pixel: usize) -> f64 {
        let (x, y) = (pixel % self.width, pixel / self.width);
        let height = first.len() / self.width;
        let own = first[pixel];
        let (mut sum, mut count) = (0.0, 0.0);
        for row in y.saturating_sub(1)..(y + 2).min(height) {
            for column in x.saturating_sub(1)..(x + 2).min(self.width) {
                let near = first[row * self.width + column];
                if (near - own).abs() <= 0.1 * own.abs() {
                    sum += near;
                    count += 1.0;
                }
            }
        }
        if count > 0.0 { sum / count } else { own }
    }

    /// Standard deviation of a count about what the merged radiance predicts,
    /// from the median of the absolute deviations, so that what moved has no weight.
    fn noise_dn(&self, first: &[f64]) -> f64 {
        let stride = (first.len() / 4096).max(1);
        let deviations = (0..first.len()).step_by(stride).flat_map(|pixel| {
            self.frames.iter().filter_map(move |&(exposure_s, counts)| {
                let predicted = self.response.count(first[pixel] * exposure_s);
                let usable = self.usable(predicted) && counts[pixel] < WHITE;
                usable.then(|| (f64::from(counts[pixel]) - predicted).abs())
            })
        });
        self.std_dn(deviations)
    }

    /// The same from how these deviations differ from one pixel to the next: an exposure, a
    /// curve or a processing of the image that is off moves neighbours alike.
    pub(super) fn local_noise_dn(&self, first: &[f64]) -> f64 {
        let stride = (first.len() / 4096).max(1);
        let deviation = |pixel: usize, exposure_s: f64, counts: &[u16]| {
            let predicted = self.response.count(first[pixel] * exposure_s);
            let usable = self.usable(predicted) && counts[pixel] < WHITE;
            usable.then(|| f64::from(counts[pixel]) - predicted)
        };
        let differences = (1..first.len()).step_by(stride).flat_map(|pixel| {
            self.frames.iter().filter_map(move |&(exposure_s, counts)| {
                let before = deviation(pixel - 1, exposure_s, counts)?;
                let difference = deviation(pixel, exposure_s, counts)? - before;
                Some(difference.abs() / f64::sqrt(2.0))
            })
        });
        self.std_dn(differences)
    }

    /// Standard deviation of a count from absolute deviations.
    fn std_dn(&self, deviations: impl Iterator<Item = f64>) -> f64 {
        let Some(median) = median(deviations) else {
            return 1.0;
        };
        let n = self.frames.len() as f64;
        // One degree of freedom per pixel went into its radiance.
        let lost = (n / f64::max(n - 1.0, 1.0)).sqrt();
        (STD_OVER_MAD * median * lost).max(ROUNDING_DN)
    }
}
