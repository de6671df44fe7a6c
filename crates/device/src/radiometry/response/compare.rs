//! How the exposures of a bracket agree through a response: each with what the shorter ones
//! predict, and repeats with each other, in relative exposure.

use std::ops::Range;

use rayon::prelude::*;

use super::ResponseMerge;
use super::merge::WHITE;
use crate::radiometry::agreement::{ExposureTally, Repeat, add_all, bit, moved, trusted};
use crate::radiometry::comparison::Step;
use crate::radiometry::merge::ROWS_PER_THREAD;

/// A pixel deviates where it differs by this many standard deviations of noise and ...
const DEPARTURE_SIGMA: f64 = 5.0;
/// ... this relative error of curve and processing.
const TOLERATED: f64 = 0.03;

/// The frames of one exposure.
struct Group<'a> {
    exposure_s: f64,
    frames: Vec<&'a [u16]>,
}

/// Relative exposure that a group shows at a pixel.
struct Seen {
    exposure: f64,
    /// Of one frame.
    variance: f64,
    /// Relative standard uncertainty of the curve there.
    curve_std: f64,
}

/// What the shorter exposures say of a pixel's radiance.
#[derive(Clone, Copy, Default)]
struct Earlier {
    information: f64,
    /// Information times radiance.
    score: f64,
    /// Information times relative uncertainty of the curve.
    curve: f64,
}

impl Earlier {
    /// What they predict for a frame with this share, if they say anything.
    fn step(&self, seen: &Seen, exposure_s: f64, frames: f64) -> Option<Step> {
        let known = self.information > 0.0;
        known.then(|| {
            let predicted = exposure_s * self.score / self.information;
            let curve_std = seen.curve_std.hypot(self.curve / self.information);
            Step {
                signal: seen.exposure,
                predicted,
                variance: seen.variance / frames + exposure_s * exposure_s / self.information,
                common: predicted * curve_std,
            }
        })
    }

    fn take(&mut self, seen: &Seen, exposure_s: f64, frames: f64) {
        let information = exposure_s * exposure_s * frames / seen.variance;
        self.information += information;
        self.score += information * seen.exposure / exposure_s;
        self.curve += information * seen.curve_std;
    }
}

fn deviates(step: &Step) -> bool {
    let tolerated = TOLERATED * step.predicted;
    let allowed2 = step.variance + tolerated * tolerated;
    (step.signal - step.predicted).powi(2) > DEPARTURE_SIGMA * DEPARTURE_SIGMA * allowed2
}

impl ResponseMerge<'_> {
    /// How the exposures agree in the `counted` rows, shortest first; `pooled` radiances decide
    /// which counts are of use. What moved is counted alone.
    pub(super) fn compare(
        &self,
        first: &[f64],
        pooled: &[f64],
        counted: Range<usize>,
    ) -> Vec<ExposureTally> {
        let noise_dn = self.local_noise_dn(first);
        let groups = self.groups();
        // One tally per row, added in order: the same sum for any thread count. Each has all
        // columns, so that few of them stand in memory at a time.
        let mut tallies = Vec::new();
        let mut deviating = Vec::with_capacity(pooled.len());
        let width = self.width.max(1);
        let at_once = ROWS_PER_THREAD * rayon::current_num_threads();
        for (part, pixels) in pooled.chunks(at_once * width).enumerate() {
            let rows: Vec<(Vec<u16>, Vec<ExposureTally>)> = pixels
                .par_chunks(width)
                .enumerate()
                .map(|(y, row)| {
                    let y = part * at_once + y;
                    self.compare_row(&groups, y, row, noise_dn, counted.contains(&y))
                })
                .collect();
            for (off, more) in rows {
                deviating.extend(off);
                add_all(&mut tallies, more);
            }
        }
        // What moved.
        let trusted = trusted(&tallies);
        for y in counted {
            for x in 0..self.width {
                let moved = moved(&deviating, self.width, [x, y], 1, trusted);
                for (exposure, tally) in tallies.iter_mut().enumerate() {
                    tally.colours[0].moved_pixels += usize::from(moved & bit(exposure) != 0);
                }
            }
        }
        tallies
    }

    /// A row's exposures that deviate, per pixel, and its sums if it `counts`.
    fn compare_row(
        &self,
        groups: &[Group],
        y: usize,
        pooled: &[f64],
        noise_dn: f64,
        counts: bool,
    ) -> (Vec<u16>, Vec<ExposureTally>) {
        let tally = |group: &Group| {
            let frames = group.frames.len();
            let mut tally = ExposureTally::of(group.exposure_s, frames as u32, 1);
            tally.colours[0].repeats = vec![Repeat::default(); frames - 1];
            if counts {
                tally.colours[0].begin_row();
                let repeats = &mut tally.colours[0].repeats;
                repeats.iter_mut().for_each(Repeat::begin_row);
            }
            tally
        };
        let mut tallies: Vec<ExposureTally> = groups.iter().map(tally).collect();
        let mut deviating = vec![0; pooled.len()];
        for (x, deviating) in deviating.iter_mut().enumerate() {
            let pixel = y * self.width + x;
            let mut earlier = Earlier::default();
            for (index, group) in groups.iter().enumerate() {
                let Some(seen) = self.seen(group, pixel, pooled[x], noise_dn) else {
                    continue;
                };
                let frames = group.frames.len() as f64;
                let step = earlier.step(&seen, group.exposure_s, frames);
                earlier.take(&seen, group.exposure_s, frames);
                let mut off = step.as_ref().is_some_and(deviates);
                let tally = &mut tallies[index].colours[0];
                off |= self.repeats(group, pixel, &seen, counts.then_some(&mut tally.repeats));
                if off {
                    *deviating |= bit(index);
                }
                if counts {
                    tally.take_in(x, off, step.map(|step| (step, step.chi2())));
                }
            }
        }
        (deviating, tallies)
    }

    /// The frames by their exposure, shortest first.
    fn groups(&self) -> Vec<Group<'_>> {
        let mut groups: Vec<Group<'_>> = Vec::new();
        for &(exposure_s, counts) in &self.frames {
            let same = |g: &&mut Group| (g.exposure_s - exposure_s).abs() <= 1e-9 * exposure_s;
            match groups.iter_mut().find(same) {
                Some(group) => group.frames.push(counts),
                None => groups.push(Group {
                    exposure_s,
                    frames: vec![counts],
                }),
            }
        }
        groups.sort_by(|a, b| a.exposure_s.total_cmp(&b.exposure_s));
        groups
    }

    /// What a group shows at a pixel of this radiance, where that depends on light.
    fn seen(&self, group: &Group, pixel: usize, radiance: f64, noise_dn: f64) -> Option<Seen> {
        let count = self.response.count(radiance * group.exposure_s);
        let clips = || group.frames.iter().any(|counts| counts[pixel] >= WHITE);
        if !self.usable(count) || clips() {
            return None;
        }
        let exposures = group
            .frames
            .iter()
            .map(|counts| self.exposure(counts, pixel));
        Some(Seen {
            exposure: exposures.sum::<f64>() / group.frames.len() as f64,
            variance: (noise_dn * self.response.slope(count)).powi(2),
            curve_std: self.response.ln_std[count.round() as usize],
        })
    }

    fn exposure(&self, counts: &[u16], pixel: usize) -> f64 {
        self.response.exposure(usize::from(counts[pixel]))
    }

    /// Compares each frame of a group with the earlier ones; whether any deviates.
    fn repeats(
        &self,
        group: &Group,
        pixel: usize,
        seen: &Seen,
        mut sums: Option<&mut Vec<Repeat>>,
    ) -> bool {
        let mut sum = 0.0;
        let mut any = false;
        for (earlier, counts) in (0u32..).zip(&group.frames) {
            let signal = self.exposure(counts, pixel);
            if earlier > 0 {
                let before = sum / f64::from(earlier);
                any |= deviates(&Step {
                    signal,
                    predicted: before,
                    variance: seen.variance * (1.0 + 1.0 / f64::from(earlier)),
                    common: 0.0,
                });
                if let Some(sums) = &mut sums {
                    sums[earlier as usize - 1].take(signal, before, seen.variance, earlier);
                }
            }
            sum += signal;
        }
        any
    }
}
