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

use rayon::prelude::*;

use super::mosaic::Mosaic;
use super::rate::{Expectation, Level, RateEstimate, difference, follow};
use super::sensor::{SensorError, SensorNoise};
use crate::radiance_image::RadianceImage;

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
pub enum MergeError {
    /// The noise model is impossible.
    #[error(transparent)]
    Sensor(#[from] SensorError),
    /// A frame of another size than the bracket.
    #[error("the frame has {found} pixels and the bracket {width} x {height}")]
    FrameSize {
        /// Pixels of the frame.
        found: usize,
        /// Pixels per row of the bracket.
        width: usize,
        /// Rows of the bracket.
        height: usize,
    },
    /// An exposure that cannot be.
    #[error("an exposure of {exposure_s} s is not a positive number")]
    Exposure {
        /// As given, seconds.
        exposure_s: f64,
    },
    /// More frames than the sums can hold.
    #[error("more than {MAX_FRAMES} frames at one exposure")]
    TooManyFrames,
    /// A bracket needs at least one light frame.
    #[error("the bracket has no light frame")]
    NoLightFrame,
}

/// Largest number of frames at one exposure: 16-bit counts summed in 32 bits.
const MAX_FRAMES: u32 = 1 << 16;

/// The sums of a bracket while its frames come in.
#[derive(Clone, Debug)]
pub struct BracketMerge<N> {
    noise: N,
    mosaic: Mosaic,
    width: usize,
    height: usize,
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
}

/// Radiance at every sensor pixel. Row 0 is the top.
#[derive(Clone, Debug, PartialEq)]
pub struct MergedPlane {
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Radiance in the unit of the sensor's responsivity; negative values are kept.
    pub mean: Vec<f32>,
    /// Variance of each mean.
    pub variance: Vec<f32>,
    /// `false` where the pixel is hot or clips in every exposure.
    pub valid: Vec<bool>,
    /// How the light exposures agree, shortest first.
    pub agreement: Vec<ExposureAgreement>,
}

/// How one light exposure agrees with the shorter ones.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExposureAgreement {
    /// Exposure, seconds.
    pub exposure_s: f64,
    /// Frames averaged.
    pub frames: u32,
    /// Pixels that took it in with full weight.
    pub pixels: usize,
    /// Signal over the signal that the shorter exposures predict, summed over
    /// those pixels: 1 if exposures and linearity are as stated. 1 for the
    /// shortest.
    pub signal_ratio: f64,
    /// Mean squared deviation from that prediction over its variance; about 1
    /// if the noise model holds. 0 for the shortest.
    pub reduced_chi2: f64,
}

impl<N: Borrow<SensorNoise>> BracketMerge<N> {
    /// An empty bracket of `width * height` pixels. With a mosaic, every pixel
    /// is merged by itself and only compared with neighbours of its own colour.
    pub fn new(noise: N, mosaic: Mosaic, width: usize, height: usize) -> Result<Self, MergeError> {
        noise.borrow().check(width * height)?;
        Ok(Self {
            noise,
            mosaic,
            width,
            height,
            exposures: Vec::new(),
        })
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
                });
                self.exposures.len() - 1
            }
        };
        let exposure = &mut self.exposures[at];
        if exposure.frames == MAX_FRAMES {
            return Err(MergeError::TooManyFrames);
        }
        let noise: &SensorNoise = self.noise.borrow();
        let ceiling_dn = noise.saturation_dn.min(noise.linear_max_dn);
        exposure.frames += 1;
        for ((sum, clipped), &count) in exposure
            .sum_dn
            .iter_mut()
            .zip(&mut exposure.clipped)
            .zip(counts)
        {
            *sum += u32::from(count);
            *clipped |= f64::from(count) >= ceiling_dn;
        }
        Ok(())
    }

    /// Merges what was added.
    ///
    /// # Errors
    /// No light frame.
    pub fn finish(mut self) -> Result<MergedPlane, MergeError> {
        self.exposures
            .sort_by(|a, b| a.exposure_s.total_cmp(&b.exposure_s));
        let bracket = Bracket {
            noise: self.noise.borrow(),
            light: of_role(&self.exposures, FrameRole::Light),
            ambient: of_role(&self.exposures, FrameRole::Ambient),
            dark: of_role(&self.exposures, FrameRole::Dark),
        };
        if bracket.light.is_empty() {
            return Err(MergeError::NoLightFrame);
        }
        let pixels = self.width * self.height;
        let mut first = vec![PixelRates::default(); pixels];
        first
            .par_iter_mut()
            .enumerate()
            .for_each(|(pixel, rates)| *rates = bracket.first_pass(pixel));

        let mut merged = MergedPlane {
            width: self.width,
            height: self.height,
            mean: vec![0.0; pixels],
            variance: vec![0.0; pixels],
            valid: vec![false; pixels],
            agreement: Vec::new(),
        };
        let neighbourhood = Neighbourhood {
            rates: &first,
            width: self.width,
            height: self.height,
            step: self.mosaic.period(),
        };
        let width = self.width.max(1);
        // One tally per row, added in order: the same sum for any thread count.
        let tallies: Vec<Vec<Tally>> = merged
            .mean
            .par_chunks_mut(width)
            .zip(merged.variance.par_chunks_mut(width))
            .zip(merged.valid.par_chunks_mut(width))
            .enumerate()
            .map(|(y, ((mean, variance), valid))| {
                let mut tallies = vec![Tally::default(); bracket.light.len()];
                for x in 0..mean.len() {
                    let expected = neighbourhood.expectations(x, y);
                    let pixel = y * width + x;
                    let result = bracket.second_pass(pixel, &expected, &mut tallies);
                    mean[x] = result.0 as f32;
                    variance[x] = result.1 as f32;
                    valid[x] = first[pixel].usable && bracket.fits_shortest(expected[LIT].rate_e_s);
                }
                tallies
            })
            .collect();
        merged.agreement = bracket.agreement(&tallies);
        Ok(merged)
    }
}

fn of_role(exposures: &[ExposureSum], role: FrameRole) -> Vec<&ExposureSum> {
    exposures.iter().filter(|e| e.role == role).collect()
}

/// Indices into the rates of [`PixelRates`].
const LIT: usize = 0;
const AMBIENT: usize = 1;
const DARK: usize = 2;

/// First-pass rates of one pixel with their variances, e⁻/s.
#[derive(Clone, Copy, Debug, Default)]
struct PixelRates {
    rate_e_s: [f32; 3],
    variance: [f32; 3],
    /// Neither hot nor clipped in the shortest exposures.
    usable: bool,
}

struct Bracket<'a> {
    noise: &'a SensorNoise,
    light: Vec<&'a ExposureSum>,
    ambient: Vec<&'a ExposureSum>,
    dark: Vec<&'a ExposureSum>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Tally {
    pixels: usize,
    signal_dn: f64,
    predicted_dn: f64,
    chi2: f64,
}

impl Bracket<'_> {
    fn levels(&self, exposures: &[&ExposureSum], pixel: usize) -> impl Iterator<Item = Level> {
        let black_dn = self.noise.black_level_dn;
        exposures.iter().map(move |e| Level {
            exposure_s: e.exposure_s,
            frames: e.frames,
            signal_dn: f64::from(e.sum_dn[pixel]) / f64::from(e.frames) - black_dn,
            clipped: e.clipped[pixel],
        })
    }

    fn first_pass(&self, pixel: usize) -> PixelRates {
        let mut rates = PixelRates::default();
        for (index, exposures) in [&self.light, &self.ambient, &self.dark]
            .into_iter()
            .enumerate()
        {
            let levels = self.levels(exposures, pixel);
            if let Some(estimate) = follow(levels, self.noise, None, |_, _, _| {}) {
                rates.rate_e_s[index] = estimate.rate_e_s as f32;
                rates.variance[index] = estimate.variance as f32;
            }
        }
        let clipped =
            |exposures: &[&ExposureSum]| exposures.first().is_some_and(|e| e.clipped[pixel]);
        let hot = self.noise.hot_pixels.as_ref().is_some_and(|hot| hot[pixel]);
        rates.usable = !hot
            && !clipped(&self.light)
            && !clipped(&self.ambient)
            && (!self.ambient.is_empty() || !clipped(&self.dark));
        rates
    }

    /// Whether this lit rate keeps clear of clipping in the shortest exposure.
    fn fits_shortest(&self, lit_e_s: f64) -> bool {
        let electrons = lit_e_s * self.light[0].exposure_s;
        let noise_dn = self.noise.count_variance_dn2(electrons).sqrt();
        electrons * self.noise.gain_dn_per_e + 4.0 * noise_dn <= self.noise.usable_range_dn()
    }

    /// Radiance and variance of one pixel, with variances from `expected` rates.
    fn second_pass(
        &self,
        pixel: usize,
        expected: &[Expectation; 3],
        tallies: &mut [Tally],
    ) -> (f64, f64) {
        let quiet = |_: usize, _: &Level, _| {};
        let from = |exposures: &[&ExposureSum], expected: Expectation| {
            follow(
                self.levels(exposures, pixel),
                self.noise,
                Some(expected),
                quiet,
            )
        };
        let lit = follow(
            self.levels(&self.light, pixel),
            self.noise,
            Some(expected[LIT]),
            |index, level, agreement| {
                if agreement.share == 1.0 {
                    let tally = &mut tallies[index];
                    tally.pixels += 1;
                    tally.signal_dn += level.signal_dn;
                    tally.predicted_dn += agreement.predicted_dn;
                    tally.chi2 += agreement.chi2;
                }
            },
        );
        let Some(lit) = lit else { return (0.0, 0.0) };
        let dark = from(&self.dark, expected[DARK]);
        let ambient = from(&self.ambient, expected[AMBIENT]);
        let by_record = RateEstimate {
            rate_e_s: self.noise.dark_current_e_s,
            variance: self.noise.dark_current_spread_e_s.powi(2),
            per_offset: 0.0,
            offset_information: 0.0,
            offset_score: 0.0,
        };
        let unlit = ambient.or(dark).unwrap_or(by_record);
        let only_for_offset = ambient.and(dark.as_ref());
        let (rate_e_s, variance) = difference(
            &lit,
            &unlit,
            only_for_offset,
            self.noise.black_level_spread_dn,
        );
        let (response, response_std) = match &self.noise.flat_field {
            Some(flat) => (
                f64::from(flat.response[pixel]),
                f64::from(flat.std_dev[pixel]),
            ),
            None => (1.0, 0.0),
        };
        let per_radiance = self.noise.responsivity_e_s * response;
        let radiance = rate_e_s / per_radiance;
        let flat_variance = (radiance * response_std / response).powi(2);
        (radiance, variance / per_radiance.powi(2) + flat_variance)
    }

    fn agreement(&self, rows: &[Vec<Tally>]) -> Vec<ExposureAgreement> {
        self.light
            .iter()
            .enumerate()
            .map(|(index, exposure)| {
                let mut total = Tally::default();
                for row in rows {
                    total.pixels += row[index].pixels;
                    total.signal_dn += row[index].signal_dn;
                    total.predicted_dn += row[index].predicted_dn;
                    total.chi2 += row[index].chi2;
                }
                let known = total.pixels > 0 && total.predicted_dn > 0.0;
                ExposureAgreement {
                    exposure_s: exposure.exposure_s,
                    frames: exposure.frames,
                    pixels: total.pixels,
                    signal_ratio: if known {
                        total.signal_dn / total.predicted_dn
                    } else {
                        1.0
                    },
                    reduced_chi2: total.chi2 / total.pixels.max(1) as f64,
                }
            })
            .collect()
    }
}

/// The first pass's rates around a pixel.
struct Neighbourhood<'a> {
    rates: &'a [PixelRates],
    width: usize,
    height: usize,
    step: usize,
}

/// Neighbours this many places away on each side are pooled ...
const POOL_RADIUS: isize = 2;
/// ... if they lie within this many standard deviations of the pixel.
const POOL_AGREEMENT: f32 = 4.0;

/// ... and speak for it if at least this many do.
const POOL_QUORUM: f64 = 6.0;

impl Neighbourhood<'_> {
    /// What the neighbours that agree with a pixel let expect of its rates, so
    /// that its own noise hardly enters its weights.
    fn expectations(&self, x: usize, y: usize) -> [Expectation; 3] {
        let centre = &self.rates[y * self.width + x];
        let (mut rates, mut variances, mut counts) = ([0.0; 3], [0.0; 3], [0.0; 3]);
        for dy in -POOL_RADIUS..=POOL_RADIUS {
            for dx in -POOL_RADIUS..=POOL_RADIUS {
                if dx == 0 && dy == 0 {
                    continue;
                }
                let (Some(x), Some(y)) = (
                    x.checked_add_signed(dx * self.step as isize),
                    y.checked_add_signed(dy * self.step as isize),
                ) else {
                    continue;
                };
                if x >= self.width || y >= self.height {
                    continue;
                }
                let neighbour = &self.rates[y * self.width + x];
                if !neighbour.usable {
                    continue;
                }
                for i in 0..3 {
                    let apart = neighbour.rate_e_s[i] - centre.rate_e_s[i];
                    let variance = neighbour.variance[i] + centre.variance[i];
                    if apart * apart <= POOL_AGREEMENT * POOL_AGREEMENT * variance {
                        rates[i] += f64::from(neighbour.rate_e_s[i]);
                        variances[i] += f64::from(neighbour.variance[i]);
                        counts[i] += 1.0;
                    }
                }
            }
        }
        std::array::from_fn(|i| Expectation {
            rate_e_s: (rates[i] + f64::from(centre.rate_e_s[i])) / (counts[i] + 1.0),
            around: (counts[i] >= POOL_QUORUM)
                .then(|| (rates[i] / counts[i], variances[i] / (counts[i] * counts[i]))),
        })
    }
}

impl MergedPlane {
    /// The same radiance in all three channels.
    pub fn to_grey(&self) -> RadianceImage {
        RadianceImage {
            width: self.width,
            height: self.height,
            mean: self.mean.iter().map(|&x| [x; 3]).collect(),
            variance: self.variance.iter().map(|&x| [x; 3]).collect(),
            valid: self.valid.clone(),
        }
    }

    /// Red, green and blue from three planes of equal size (one per lamp
    /// channel); a pixel is valid where all three are. `None` if the sizes differ.
    pub fn to_rgb(planes: [&Self; 3]) -> Option<RadianceImage> {
        let [red, green, blue] = planes;
        let size = |plane: &Self| (plane.width, plane.height);
        if size(red) != size(green) || size(red) != size(blue) {
            return None;
        }
        let pixels = 0..red.mean.len();
        Some(RadianceImage {
            width: red.width,
            height: red.height,
            mean: pixels.clone().map(|p| planes.map(|c| c.mean[p])).collect(),
            variance: pixels
                .clone()
                .map(|p| planes.map(|c| c.variance[p]))
                .collect(),
            valid: pixels.map(|p| planes.iter().all(|c| c.valid[p])).collect(),
        })
    }

    /// A mosaic sensor at half resolution: every cell of 2 × 2 becomes one
    /// pixel, the two greens averaged; an odd last row or column is left out.
    /// Nothing is interpolated. A mono sensor keeps its resolution, in grey.
    pub fn binned(&self, mosaic: Mosaic) -> RadianceImage {
        if mosaic == Mosaic::None {
            return self.to_grey();
        }
        let (width, height) = (self.width / 2, self.height / 2);
        let mut image = RadianceImage::new(width, height);
        for y in 0..height {
            for x in 0..width {
                let (mut mean, mut variance, mut count) = ([0.0; 3], [0.0; 3], [0.0f32; 3]);
                for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                    let pixel = (2 * y + dy) * self.width + 2 * x + dx;
                    if let Some(channel) = mosaic.channel(dx, dy)
                        && self.valid[pixel]
                    {
                        mean[channel] += self.mean[pixel];
                        variance[channel] += self.variance[pixel];
                        count[channel] += 1.0;
                    }
                }
                let cell = y * width + x;
                image.valid[cell] = count.iter().all(|&n| n > 0.0);
                for c in 0..3 {
                    let n = count[c].max(1.0);
                    image.mean[cell][c] = mean[c] / n;
                    image.variance[cell][c] = variance[c] / (n * n);
                }
            }
        }
        image
    }
}
