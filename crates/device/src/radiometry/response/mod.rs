//! The response of a camera whose counts are not proportional to light: which
//! exposure (radiance times time) each 8-bit count stands for, up to a factor.
//!
//! Two estimators from a bracket of one still scene: [`debevec`] (Debevec and
//! Malik, 1997) and [`robertson`] (Robertson, Borman and Stevenson, 1999, 2003).
//! Both end in the same penalised least squares, which keeps the curve smooth and
//! lets it grow with every count.

mod compare;
mod debevec;
mod merge;
mod robertson;

pub use debevec::debevec;
pub use merge::ResponseMerge;
pub use robertson::robertson;

use std::ops::RangeInclusive;

use nalgebra::{DMatrix, DVector};

use super::frame_file::FrameFile;

/// Counts of 8 bits.
pub const COUNTS: usize = 256;
/// The count at which the relative exposure is 1.
pub const MIDDLE: usize = 128;

/// Pixels of a still scene in all exposures of a bracket.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BracketSamples {
    /// Exposure of each frame, seconds; > 0.
    pub exposures_s: Vec<f64>,
    /// Of each pixel its count in each frame.
    pub counts: Vec<Vec<u8>>,
}

/// The response of one channel.
#[derive(Clone, Debug, PartialEq)]
pub struct Response {
    /// Natural logarithm of the relative exposure for each of the 256 counts;
    /// grows from count to count, 0 at [`MIDDLE`].
    pub ln_exposure: Vec<f64>,
    /// Standard uncertainty of each logarithm from the scatter of the samples.
    pub ln_std: Vec<f64>,
    /// Lowest count that depends on light: those below, where the curve is a guess, are the
    /// camera's or scanner's black.
    pub darkest: u8,
}

/// How a response is estimated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Estimator {
    /// Debevec and Malik (1997).
    #[default]
    Debevec,
    /// Robertson, Borman and Stevenson (2003).
    Robertson,
}

impl Estimator {
    /// The authors.
    pub fn name(self) -> &'static str {
        match self {
            Self::Debevec => "Debevec-Malik",
            Self::Robertson => "Robertson",
        }
    }

    /// Weight of the curve's smoothness where none is chosen.
    pub const fn default_smoothness(self) -> f64 {
        match self {
            Self::Debevec => 10.0,
            Self::Robertson => 30.0,
        }
    }
}

/// How the responses of a bracket are estimated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResponseOptions {
    /// The estimator.
    pub estimator: Estimator,
    /// Weight of the curve's smoothness, > 0; `None`: the estimator's own.
    pub smoothness: Option<f64>,
    /// Largest number of pixels that are used, on a grid over the frames.
    pub samples: usize,
}

impl ResponseOptions {
    /// Usual [`Self::samples`].
    pub const SAMPLES: u32 = 4096;
}

impl Default for ResponseOptions {
    fn default() -> Self {
        Self {
            estimator: Estimator::default(),
            smoothness: None,
            samples: Self::SAMPLES as usize,
        }
    }
}

/// The response of each channel of 8-bit frames of one still scene, with these exposures
/// (seconds).
///
/// # Errors
/// Frames that do not make a curve, see [`ResponseError`].
pub fn responses(
    frames: &[FrameFile],
    exposures_s: &[f64],
    options: &ResponseOptions,
) -> Result<Vec<Response>, ResponseError> {
    let estimator = options.estimator;
    let smoothness = options.smoothness;
    let smoothness = smoothness.unwrap_or(estimator.default_smoothness());
    let channels = frames.first().map_or(0, |frame| frame.planes.len());
    let response = |channel: usize| {
        let counts = frames.iter().map(|f| f.planes[channel].as_slice());
        let counts: Vec<&[u16]> = counts.collect();
        let samples = BracketSamples::on_grid(exposures_s.to_vec(), &counts, options.samples);
        match estimator {
            Estimator::Debevec => debevec(&samples, smoothness),
            Estimator::Robertson => robertson(&samples, smoothness),
        }
    };
    (0..channels).map(response).collect()
}

/// How much the contrast of the curves differs: the largest over the smallest growth of ln
/// exposure over the middle half of the counts, less 1.
pub fn contrast_spread(curves: &[Response]) -> f64 {
    let contrast = |curve: &Response| curve.ln_exposure[192] - curve.ln_exposure[64];
    let all = || curves.iter().map(contrast);
    let (least, most) = (
        all().fold(f64::INFINITY, f64::min),
        all().fold(0.0, f64::max),
    );
    if least > 0.0 && least.is_finite() {
        most / least - 1.0
    } else {
        0.0
    }
}

/// Why samples do not make a response.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)]
pub enum ResponseError {
    /// One exposure does not determine a curve.
    #[error("{found} different exposures, and at least {MIN_EXPOSURES} are needed")]
    TooFewExposures { found: usize },
    #[error(
        "{found} pixels are well exposed in two frames or more, and at least {MIN_SAMPLES} are needed"
    )]
    TooFewSamples { found: usize },
    #[error(
        "the well exposed counts reach from {low} to {high} only, which leaves the rest of the curve unknown"
    )]
    NarrowRange { low: usize, high: usize },
    #[error(
        "counts do not grow with the exposure: longer frames are brighter in {percent:.0}% of the cases only"
    )]
    NotBrighter { percent: f64 },
}

/// Exposures that it takes.
pub const MIN_EXPOSURES: usize = 3;
/// Pixels that it takes.
pub const MIN_SAMPLES: usize = 50;
/// Counts that are neither black nor white for certain: what clips scatters a
/// little around both ends. Where black is brighter than that, the samples show it.
const WELL_EXPOSED: RangeInclusive<u8> = 2..=250;
/// A count below which ...
const HIGHEST_BLACK: u8 = 64;
/// ... longer exposures are brighter in less than this part of the samples is black.
const BRIGHTER: f64 = 0.9;
/// Pairs of samples that it takes to call a count black.
const LEAST_PAIRS: f64 = 20.0;
/// A curve must be seen over this part of its range.
const MIN_RANGE: usize = 128;
/// Least growth of the logarithm from one count to the next.
const LEAST_STEP: f64 = 1e-4;

impl BracketSamples {
    /// Pixels on an even grid, at most `most`, of frames of equal size.
    pub fn on_grid(exposures_s: Vec<f64>, frames: &[&[u16]], most: usize) -> Self {
        let pixels = frames.first().map_or(0, |frame| frame.len());
        // A stride that shares no factor with usual widths wanders over the image.
        let stride = (pixels / most.max(1)).max(1) | 1;
        let counts = (0..pixels)
            .step_by(stride)
            .map(|p| frames.iter().map(|f| f[p].min(255) as u8).collect());
        Self {
            exposures_s,
            counts: counts.collect(),
        }
    }

    /// Checks that a curve can be had, drops the pixels that do not constrain it, and returns
    /// which counts do.
    pub fn checked(mut self) -> Result<(Self, RangeInclusive<u8>), ResponseError> {
        let mut exposures = self.exposures_s.clone();
        exposures.sort_by(f64::total_cmp);
        exposures.dedup_by(|a, b| (*a / *b - 1.0).abs() < 1e-6);
        if exposures.len() < MIN_EXPOSURES {
            let found = exposures.len();
            return Err(ResponseError::TooFewExposures { found });
        }
        let well_exposed = self.without_black()?;
        let well = |count: &&u8| well_exposed.contains(*count);
        self.counts
            .retain(|counts| counts.iter().filter(well).count() >= 2);
        if self.counts.len() < MIN_SAMPLES {
            let found = self.counts.len();
            return Err(ResponseError::TooFewSamples { found });
        }
        let seen: Vec<usize> = self
            .counts
            .iter()
            .flatten()
            .filter(well)
            .map(|&c| usize::from(c))
            .collect();
        let low = seen.iter().copied().min().unwrap_or(0);
        let high = seen.iter().copied().max().unwrap_or(0);
        if high - low < MIN_RANGE {
            return Err(ResponseError::NarrowRange { low, high });
        }
        Ok((self, well_exposed))
    }

    /// The well exposed counts: from above the highest one at which the next longer
    /// exposure is not brighter. Film and scanners give black a count of 10 to 30.
    fn without_black(&self) -> Result<RangeInclusive<u8>, ResponseError> {
        let mut order: Vec<usize> = (0..self.exposures_s.len()).collect();
        order.sort_by(|&a, &b| self.exposures_s[a].total_cmp(&self.exposures_s[b]));
        let next = |&short: &usize| {
            let longer = |&&long: &&usize| self.exposures_s[long] > 1.5 * self.exposures_s[short];
            order.iter().find(longer).map(|&long| (short, long))
        };
        let steps: Vec<(usize, usize)> = order.iter().filter_map(next).collect();
        let (mut grows, mut pairs) = ([0.0; COUNTS], [0.0; COUNTS]);
        for counts in &self.counts {
            for &(short, long) in &steps {
                let (dark, bright) = (counts[short], counts[long]);
                if WELL_EXPOSED.contains(&dark) && WELL_EXPOSED.contains(&bright) {
                    pairs[usize::from(dark)] += 1.0;
                    grows[usize::from(dark)] += f64::from(u8::from(bright > dark));
                }
            }
        }
        let is_black = |&z: &u8| {
            let z = usize::from(z);
            pairs[z] >= LEAST_PAIRS && grows[z] < BRIGHTER * pairs[z]
        };
        let highest = (*WELL_EXPOSED.start()..HIGHEST_BLACK).rev().find(is_black);
        let darkest = highest.map_or(*WELL_EXPOSED.start(), |z| z + 1);
        let above = |by: &[f64; COUNTS]| by[usize::from(darkest)..].iter().sum::<f64>();
        let percent = 100.0 * above(&grows) / above(&pairs).max(1.0);
        if above(&pairs) > 0.0 && percent < 100.0 * BRIGHTER {
            return Err(ResponseError::NotBrighter { percent });
        }
        Ok(darkest..=*WELL_EXPOSED.end())
    }
}

impl Response {
    /// Relative exposure that a count stands for; 1 at [`MIDDLE`].
    pub fn exposure(&self, count: usize) -> f64 {
        self.ln_exposure[count.min(COUNTS - 1)].exp()
    }

    /// The count, not rounded, that a relative exposure would give, from 0 to 255.
    pub fn count(&self, exposure: f64) -> f64 {
        let ln = exposure.max(1e-300).ln();
        let above = self.ln_exposure.partition_point(|&g| g < ln);
        if above == 0 {
            return 0.0;
        }
        if above == COUNTS {
            return (COUNTS - 1) as f64;
        }
        let (low, high) = (self.ln_exposure[above - 1], self.ln_exposure[above]);
        (above - 1) as f64 + (ln - low) / (high - low)
    }

    /// Derivative of the relative exposure by the count, at a count that need not
    /// be whole.
    pub fn slope(&self, count: f64) -> f64 {
        let middle = count.clamp(1.0, (COUNTS - 2) as f64).round() as usize;
        0.5 * (self.exposure(middle + 1) - self.exposure(middle - 1))
    }
}

/// A quadratic form of the curve's 256 logarithms, `gᵀAg − 2bᵀg`.
struct Curve {
    matrix: DMatrix<f64>,
    right: DVector<f64>,
}

impl Curve {
    fn new() -> Self {
        Self {
            matrix: DMatrix::zeros(COUNTS, COUNTS),
            right: DVector::zeros(COUNTS),
        }
    }

    /// Adds `Σ weight(z) g″(z)²`.
    fn smooth(&mut self, weight: impl Fn(usize) -> f64) {
        for z in 1..COUNTS - 1 {
            let stencil = [(z - 1, 1.0), (z, -2.0), (z + 1, 1.0)];
            for (row, a) in stencil {
                for (column, b) in stencil {
                    self.matrix[(row, column)] += weight(z) * a * b;
                }
            }
        }
    }

    /// The curve that minimises the form, is 0 in the middle and grows by at
    /// least [`LEAST_STEP`]; and the inverse matrix. Where the
    /// minimum would fall, the least step is demanded with a weight beyond all
    /// data's (active set).
    fn solve(mut self) -> Option<(Vec<f64>, DMatrix<f64>)> {
        let scale = self.matrix.diagonal().max();
        self.matrix[(MIDDLE, MIDDLE)] += scale;
        let heavy = 1e4 * scale;
        let mut demanded = [false; COUNTS];
        let mut solved = None;
        for _ in 0..COUNTS {
            let cholesky = self.matrix.clone().cholesky()?;
            let curve = cholesky.solve(&self.right);
            let falls: Vec<usize> = (0..COUNTS - 1)
                .filter(|&z| !demanded[z] && curve[z + 1] - curve[z] < 0.5 * LEAST_STEP)
                .collect();
            let settled = falls.is_empty();
            solved = Some((curve, cholesky));
            if settled {
                break;
            }
            for z in falls {
                demanded[z] = true;
                for (row, a) in [(z, -1.0), (z + 1, 1.0)] {
                    self.right[row] += heavy * a * LEAST_STEP;
                    for (column, b) in [(z, -1.0), (z + 1, 1.0)] {
                        self.matrix[(row, column)] += heavy * a * b;
                    }
                }
            }
        }
        let (curve, cholesky) = solved?;
        let middle = curve[MIDDLE];
        let mut curve: Vec<f64> = curve.iter().map(|g| g - middle).collect();
        for z in 1..COUNTS {
            // The penalty holds the step up to rounding.
            curve[z] = curve[z].max(curve[z - 1] + 0.1 * LEAST_STEP);
        }
        let middle = curve[MIDDLE];
        Some((
            curve.iter().map(|g| g - middle).collect(),
            cholesky.inverse(),
        ))
    }
}

#[cfg(test)]
mod tests;
