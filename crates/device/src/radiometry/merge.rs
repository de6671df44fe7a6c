//! A bracket of raw frames becomes one radiance per pixel, with its variance
//! and a mask.
//!
//! Frames are added one by one and only their sums per exposure are kept. The
//! radiance is the inverse-variance weighted estimate of `rate.rs`, computed
//! twice: first with variances from the frames as they come, then with
//! variances from the rate so found, pooled over exposures and over those
//! neighbours that agree with the pixel. A variance from a pixel's own count
//! would weight low counts more and bias the result. Nothing is normalised:
//! radiance is electrons over (seconds × responsivity × flat field).

use std::borrow::Borrow;
use std::ops::Range;

use rayon::prelude::*;

use super::agreement::{
    ColourTally, ExposureTally, Repeat, bit, by_colour, deviates, moved, trusted,
};
use super::comparison::Step;
use super::mosaic::Mosaic;
use super::neighbourhood::{AMBIENT, DARK, LIT, Neighbourhood, POOL_RADIUS, PixelRates};
use super::plane::MergedPlane;
use super::rate::{Agreement, Expectation, Level, RateEstimate, difference, follow};
use super::sensor::{SensorError, SensorNoise};

/// What light a frame of a bracket has seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum FrameRole {
    /// Lamp on.
    Light,
    /// Lamp off, shutter open: room light and dark current, subtracted.
    Ambient,
    /// No light: dark current and offset; subtracted where no ambient frames are.
    Dark,
}

/// Why a bracket cannot be merged.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)]
pub enum MergeError {
    /// The noise model is impossible.
    #[error(transparent)]
    Sensor(#[from] SensorError),
    #[error("the frame has {found} pixels and the bracket {width} x {height}")]
    FrameSize {
        found: usize,
        /// Pixels per row of the bracket.
        width: usize,
        height: usize,
    },
    #[error("an exposure of {exposure_s} s is not a positive number")]
    Exposure { exposure_s: f64 },
    /// More frames than the sums can hold.
    #[error("more than {MAX_FRAMES} frames at one exposure")]
    TooManyFrames,
    #[error("the bracket has no light frame")]
    NoLightFrame,
}

/// Rows that a thread merges before their sums are added.
pub(super) const ROWS_PER_THREAD: usize = 4;
/// Largest number of frames at one exposure: 16-bit counts summed in 32 bits.
const MAX_FRAMES: u32 = 1 << 16;

/// The sums of a bracket while its frames come in.
#[derive(Clone, Debug)]
pub struct BracketMerge<N> {
    /// One for all pixels, or those of the colours of the mosaic.
    noise: Vec<N>,
    mosaic: Mosaic,
    width: usize,
    height: usize,
    /// Rows that are merged; the others only serve as neighbours.
    rows: Range<usize>,
    /// Those of them that the agreement is about.
    counted: Range<usize>,
    exposures: Vec<ExposureSum>,
}

#[derive(Clone, Debug)]
struct ExposureSum {
    role: FrameRole,
    exposure_s: f64,
    frames: u32,
    sum_dn: Vec<u32>,
    /// Whether any frame clips.
    clipped: Vec<bool>,
    /// Light frames after the first against the earlier ones, by colour.
    repeats: Vec<Vec<Repeat>>,
    /// Whether a pixel deviates in any of them; empty where there are none.
    unsteady: Vec<bool>,
}

/// Rows on each side of a band that its pixels are compared with.
pub(super) fn halo_rows(mosaic: Mosaic) -> usize {
    // A moved pixel depends on its neighbours, and those on theirs.
    (1 + POOL_RADIUS as usize) * mosaic.period()
}

impl<N: Borrow<SensorNoise>> BracketMerge<N> {
    /// An empty bracket of `width * height` pixels. With a mosaic, every pixel
    /// is merged by itself and only compared with neighbours of its own colour.
    pub fn new(noise: N, mosaic: Mosaic, width: usize, height: usize) -> Result<Self, MergeError> {
        Self::with_colours(vec![noise], mosaic, width, height)
    }

    /// [`Self::new`] with one noise for all pixels, or one for each colour of the mosaic: red,
    /// green, blue.
    pub fn with_colours(
        noise: Vec<N>,
        mosaic: Mosaic,
        width: usize,
        height: usize,
    ) -> Result<Self, MergeError> {
        for noise in &noise {
            noise.borrow().check(width * height)?;
        }
        Ok(Self {
            noise,
            mosaic,
            width,
            height,
            rows: 0..height,
            counted: 0..height,
            exposures: Vec::new(),
        })
    }

    /// Of a band of a larger image, merges only `rows` and counts only the
    /// `counted` of them. With [`halo_rows`] more on each side where the image
    /// has them, they are bit for bit those of the image merged whole. A
    /// mosaic's band begins where a cell begins.
    pub(super) fn only(mut self, rows: Range<usize>, counted: Range<usize>) -> Self {
        self.rows = rows.start.min(self.height)..rows.end.min(self.height);
        self.counted = counted;
        self
    }

    /// Adds a frame of raw counts, DN, row by row. Frames of one role and one
    /// exposure are averaged.
    pub fn add(
        &mut self,
        role: FrameRole,
        exposure_s: f64,
        counts: &[u16],
    ) -> Result<(), MergeError> {
        let pixels = self.width * self.height;
        if counts.len() != pixels {
            return Err(MergeError::FrameSize {
                found: counts.len(),
                width: self.width,
                height: self.height,
            });
        }
        if !(exposure_s.is_finite() && exposure_s > 0.0) {
            return Err(MergeError::Exposure { exposure_s });
        }
        let same = |e: &ExposureSum| {
            e.role == role && (e.exposure_s - exposure_s).abs() <= 1e-9 * exposure_s
        };
        let at = match self.exposures.iter().position(same) {
            Some(at) => at,
            None => {
                self.exposures.push(ExposureSum {
                    role,
                    exposure_s,
                    frames: 0,
                    sum_dn: vec![0; pixels],
                    clipped: vec![false; pixels],
                    repeats: Vec::new(),
                    unsteady: Vec::new(),
                });
                self.exposures.len() - 1
            }
        };
        let exposure = &mut self.exposures[at];
        if exposure.frames == MAX_FRAMES {
            return Err(MergeError::TooManyFrames);
        }
        let colours = Colours::new(&self.noise, self.mosaic, self.width);
        if role == FrameRole::Light && exposure.frames > 0 {
            exposure.compare(&colours, counts, &self.counted);
        }
        exposure.frames += 1;
        let ceilings_dn: Vec<f64> = colours
            .noise
            .iter()
            .map(|noise| noise.ceiling_dn())
            .collect();
        for (pixel, &count) in counts.iter().enumerate() {
            exposure.sum_dn[pixel] += u32::from(count);
            let ceiling_dn = match ceilings_dn.as_slice() {
                [one] => *one,
                several => several[colours.of(pixel)],
            };
            exposure.clipped[pixel] |= f64::from(count) >= ceiling_dn;
        }
        Ok(())
    }

    /// Merges what was added.
    ///
    /// # Errors
    /// No light frame.
    pub fn finish(self) -> Result<MergedPlane, MergeError> {
        let (mut plane, tallies) = self.finish_band()?;
        plane.agreement = by_colour(&tallies).concat();
        Ok(plane)
    }

    /// Merges the band, and returns how its light exposures agree, shortest first.
    pub(super) fn finish_band(mut self) -> Result<(MergedPlane, Vec<ExposureTally>), MergeError> {
        self.exposures
            .sort_by(|a, b| a.exposure_s.total_cmp(&b.exposure_s));
        let bracket = Bracket {
            colours: Colours::new(&self.noise, self.mosaic, self.width),
            light: of_role(&self.exposures, FrameRole::Light),
            ambient: of_role(&self.exposures, FrameRole::Ambient),
            dark: of_role(&self.exposures, FrameRole::Dark),
        };
        if bracket.light.is_empty() {
            return Err(MergeError::NoLightFrame);
        }
        // First pass: each pixel's rates by itself; second: with its neighbours'.
        let mut first = vec![PixelRates::default(); self.width * self.height];
        first
            .par_iter_mut()
            .enumerate()
            .for_each(|(pixel, rates)| *rates = bracket.first_pass(pixel));

        let neighbourhood = Neighbourhood {
            rates: &first,
            width: self.width,
            height: self.height,
            step: self.mosaic.period(),
        };
        let width = self.width;
        let line = |y: usize| {
            let counts = self.counted.contains(&y);
            let mut line = Line::new(&bracket, width, counts);
            for x in 0..width {
                let expected = neighbourhood.expectations(x, y);
                let pixel = y * width + x;
                let usable =
                    first[pixel].usable && bracket.fits_shortest(pixel, expected[LIT].rate_e_s);
                bracket.second_pass(pixel, &expected, usable, counts, &mut line);
            }
            line
        };

        // How the exposures agree.
        let mut tallies = bracket.tallies();
        for (tally, exposure) in tallies.iter_mut().zip(&bracket.light) {
            for (colour, part) in tally.colours.iter_mut().enumerate() {
                let repeats = exposure.repeats.iter();
                part.repeats = repeats.map(|repeat| repeat[colour].clone()).collect();
            }
        }
        // One tally per row, added in order: the same sum for any thread count. Each has all
        // columns, so that few of them stand in memory at a time.
        let mut lines = Vec::with_capacity(self.height);
        let at_once = ROWS_PER_THREAD * rayon::current_num_threads();
        for from in (0..self.height).step_by(at_once) {
            let rows = from..(from + at_once).min(self.height);
            let some: Vec<Line> = rows.into_par_iter().map(line).collect();
            for mut line in some {
                for (tally, more) in tallies.iter_mut().zip(&line.tallies) {
                    tally.add(more);
                }
                line.tallies = Vec::new();
                lines.push(line);
            }
        }
        let trusted = trusted(&tallies);
        let deviating: Vec<u16> = lines.iter().flat_map(|l| l.deviating.clone()).collect();
        // The plane, without what moved.
        let mut plane = MergedPlane {
            width,
            height: self.rows.len(),
            mean: Vec::with_capacity(width * self.rows.len()),
            variance: Vec::with_capacity(width * self.rows.len()),
            valid: Vec::with_capacity(width * self.rows.len()),
            agreement: Vec::new(),
        };
        for (y, line) in (0..).zip(lines).filter(|(y, _)| self.rows.contains(y)) {
            plane.mean.extend(line.mean);
            plane.variance.extend(line.variance);
            for (x, valid) in line.valid.into_iter().enumerate() {
                let step = self.mosaic.period();
                let moved = moved(&deviating, width, [x, y], step, trusted);
                let colour = bracket.colours.of(y * width + x);
                for (exposure, tally) in tallies.iter_mut().enumerate() {
                    let counts = valid && self.counted.contains(&y);
                    tally.colours[colour].moved_pixels +=
                        usize::from(counts && moved & bit(exposure) != 0);
                }
                plane.valid.push(valid && moved == 0);
            }
        }
        Ok((plane, tallies))
    }
}

impl ExposureSum {
    /// Compares a further frame with the mean of the earlier ones; sums over the `counted` rows.
    fn compare(&mut self, colours: &Colours<'_>, counts: &[u16], counted: &Range<usize>) {
        self.unsteady.resize(counts.len(), false);
        let mut repeats = vec![Repeat::default(); colours.mosaic.colours()];
        for (y, row) in counts.chunks(colours.width.max(1)).enumerate() {
            let counts = counted.contains(&y);
            if counts {
                repeats.iter_mut().for_each(Repeat::begin_row);
            }
            for (x, &count) in row.iter().enumerate() {
                let pixel = y * colours.width + x;
                let sum_dn = f64::from(self.sum_dn[pixel]);
                let (noise, count_dn) = (colours.noise_of(pixel), f64::from(count));
                self.unsteady[pixel] |= repeats[colours.of(pixel)].take_count(
                    noise,
                    count_dn,
                    sum_dn,
                    self.frames,
                    counts,
                );
            }
        }
        self.repeats.push(repeats);
    }

    fn is_unsteady(&self, pixel: usize) -> bool {
        self.unsteady.get(pixel) == Some(&true)
    }
}

/// A merged row.
struct Line {
    mean: Vec<f32>,
    variance: Vec<f32>,
    valid: Vec<bool>,
    /// Per pixel the exposures that deviate from the shorter ones.
    deviating: Vec<u16>,
    tallies: Vec<ExposureTally>,
}

impl Line {
    fn new(bracket: &Bracket<'_>, width: usize, counts: bool) -> Self {
        let mut tallies = bracket.tallies();
        if counts {
            let colours = tallies.iter_mut().flat_map(|tally| &mut tally.colours);
            colours.for_each(ColourTally::begin_row);
        }
        Self {
            mean: Vec::with_capacity(width),
            variance: Vec::with_capacity(width),
            valid: Vec::with_capacity(width),
            deviating: Vec::with_capacity(width),
            tallies,
        }
    }
}

fn of_role(exposures: &[ExposureSum], role: FrameRole) -> Vec<&ExposureSum> {
    exposures.iter().filter(|e| e.role == role).collect()
}

/// The noise of each pixel.
struct Colours<'a> {
    /// One for all, or red's, green's and blue's.
    noise: Vec<&'a SensorNoise>,
    mosaic: Mosaic,
    width: usize,
}

impl<'a> Colours<'a> {
    fn new<N: Borrow<SensorNoise>>(noise: &'a [N], mosaic: Mosaic, width: usize) -> Self {
        Self {
            noise: noise.iter().map(Borrow::borrow).collect(),
            mosaic,
            width,
        }
    }

    /// A pixel's colour; 0 on a monochrome sensor.
    fn of(&self, pixel: usize) -> usize {
        let colour = match self.mosaic {
            Mosaic::None => None,
            mosaic => mosaic.channel(pixel % self.width, pixel / self.width),
        };
        colour.unwrap_or(0)
    }

    fn noise_of(&self, pixel: usize) -> &'a SensorNoise {
        match self.noise.as_slice() {
            [one] => one,
            several => several[self.of(pixel)],
        }
    }
}

struct Bracket<'a> {
    colours: Colours<'a>,
    light: Vec<&'a ExposureSum>,
    ambient: Vec<&'a ExposureSum>,
    dark: Vec<&'a ExposureSum>,
}

impl Bracket<'_> {
    fn levels(&self, exposures: &[&ExposureSum], pixel: usize) -> impl Iterator<Item = Level> {
        let noise = self.colours.noise_of(pixel);
        let offset_dn = noise.offset_dn(pixel);
        exposures.iter().map(move |e| {
            let mean_dn = f64::from(e.sum_dn[pixel]) / f64::from(e.frames) - offset_dn;
            Level {
                exposure_s: e.exposure_s,
                frames: e.frames,
                signal_dn: noise.signal_dn(mean_dn),
                per_linearity: noise.per_linearity(mean_dn),
                clipped: e.clipped[pixel],
            }
        })
    }

    fn first_pass(&self, pixel: usize) -> PixelRates {
        let noise = self.colours.noise_of(pixel);
        let mut rates = PixelRates::default();
        for (index, exposures) in [&self.light, &self.ambient, &self.dark]
            .into_iter()
            .enumerate()
        {
            let levels = self.levels(exposures, pixel);
            if let Some(estimate) = follow(levels, noise, None, |_, _, _| {}) {
                rates.rate_e_s[index] = estimate.rate_e_s as f32;
                rates.variance[index] = estimate.variance as f32;
            }
        }
        let clipped =
            |exposures: &[&ExposureSum]| exposures.first().is_some_and(|e| e.clipped[pixel]);
        let hot = noise.hot_pixels.as_ref().is_some_and(|hot| hot[pixel]);
        rates.usable = !hot
            && !clipped(&self.light)
            && !clipped(&self.ambient)
            && (!self.ambient.is_empty() || !clipped(&self.dark));
        rates
    }

    /// Whether a pixel's lit rate keeps clear of clipping in the shortest exposure.
    fn fits_shortest(&self, pixel: usize, lit_e_s: f64) -> bool {
        let noise = self.colours.noise_of(pixel);
        let electrons = lit_e_s * self.light[0].exposure_s;
        let noise_dn = noise.count_variance_dn2(electrons).sqrt();
        electrons * noise.gain_dn_per_e + 4.0 * noise_dn <= noise.usable_range_dn()
    }

    /// No pixel seen yet.
    fn tallies(&self) -> Vec<ExposureTally> {
        let colours = self.colours.mosaic.colours();
        let empty = |e: &&ExposureSum| ExposureTally::of(e.exposure_s, e.frames, colours);
        self.light.iter().map(empty).collect()
    }

    /// Appends one pixel to its row, with variances from `expected` rates.
    fn second_pass(
        &self,
        pixel: usize,
        expected: &[Expectation; 3],
        usable: bool,
        counts: bool,
        line: &mut Line,
    ) {
        let mut deviating = 0;
        let (noise, colour) = (self.colours.noise_of(pixel), self.colours.of(pixel));
        let column = pixel % self.colours.width;
        let mut watch = |index: usize, deviates: bool, step: Option<(&Level, &Agreement)>| {
            if deviates {
                deviating |= bit(index);
            }
            if counts && usable {
                let step = step.filter(|(_, agreement)| agreement.share == 1.0);
                let step = step.map(|(level, agreement)| {
                    let step = Step {
                        signal: level.signal_dn,
                        predicted: agreement.predicted_dn,
                        variance: agreement.innovation_dn2,
                        common: agreement.per_offset * noise.black_level_std_dn,
                    };
                    (step, agreement.chi2)
                });
                line.tallies[index].colours[colour].take_in(column, deviates, step);
            }
        };
        watch(0, self.light[0].is_unsteady(pixel), None);
        let lit = follow(
            self.levels(&self.light, pixel),
            noise,
            Some(expected[LIT]),
            |index, level, agreement| {
                let deviates =
                    self.light[index].is_unsteady(pixel) || deviates(noise, level, &agreement);
                watch(index, deviates, Some((level, &agreement)));
            },
        );
        let (mean, variance) = lit.map_or((0.0, 0.0), |lit| self.radiance(pixel, &lit, expected));
        line.mean.push(mean as f32);
        line.variance.push(variance as f32);
        line.valid.push(usable);
        line.deviating.push(deviating);
    }

    /// Radiance and variance of one pixel from its lit rate.
    fn radiance(
        &self,
        pixel: usize,
        lit: &RateEstimate,
        expected: &[Expectation; 3],
    ) -> (f64, f64) {
        let noise = self.colours.noise_of(pixel);
        let from = |exposures: &[&ExposureSum], expected: Expectation| {
            let levels = self.levels(exposures, pixel);
            follow(levels, noise, Some(expected), |_, _, _| {})
        };
        let dark = from(&self.dark, expected[DARK]);
        let ambient = from(&self.ambient, expected[AMBIENT]);
        let by_record = || RateEstimate::by_record(noise, pixel);
        let unlit = ambient.or(dark).unwrap_or_else(by_record);
        let only_for_offset = ambient.and(dark.as_ref());
        let (rate_e_s, variance) = difference(lit, &unlit, only_for_offset, noise);
        let (response, response_std) = match &noise.flat_field {
            Some(flat) => (
                f64::from(flat.response[pixel]),
                f64::from(flat.std_dev[pixel]),
            ),
            None => (1.0, 0.0),
        };
        let per_radiance = noise.responsivity_e_s * response;
        let radiance = rate_e_s / per_radiance;
        let flat_variance = (radiance * response_std / response).powi(2);
        (radiance, variance / per_radiance.powi(2) + flat_variance)
    }
}
