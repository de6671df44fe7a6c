//! Whether the frames of a bracket agree: exposures with the shorter ones,
//! repeats with each other. Something that moved shows as groups of pixels that
//! deviate far beyond their noise; a wrong exposure time or a drifting lamp shows
//! everywhere.
//!
//! All are sums over pixels, so those of bands of rows add up.

use super::comparison::{LineScatter, LineSum, Step, Sums, line_scatter};
use super::rate::{Agreement, Level};
use super::sensor::SensorNoise;

/// How one light exposure, in one colour, agrees with the shorter ones.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
#[allow(missing_docs)]
pub struct ExposureAgreement {
    pub exposure_s: f64,
    pub frames: u32,
    /// Pixels that took it in with full weight, those that moved apart.
    pub pixels: usize,
    /// Signal over the signal that the shorter exposures predict, summed over
    /// those pixels: 1 if exposures and linearity are as stated. 1 for the
    /// shortest.
    pub signal_ratio: f64,
    /// Standard uncertainty of that ratio: noise, as large as the pixels show it, and
    /// what they share, the black level or the response; 0 for the shortest.
    pub signal_ratio_std: f64,
    /// Mean squared deviation from that prediction over its variance; about 1
    /// if the noise model holds. 0 for the shortest.
    pub reduced_chi2: f64,
    /// Relative root mean square by which single pixels deviate, beyond noise, from the
    /// ratio that they have in common, or repeats from each other.
    pub pixel_scatter: f64,
    /// The same of the means of rows, without what changes slowly over the image: a lamp that
    /// flickers under a rolling shutter. 0 where noise explains it.
    pub row_scatter: f64,
    /// The same of rows with what changes slowly over the image, as one period of a flicker.
    pub row_change: f64,
    /// As `row_scatter`, of columns against the shorter exposures.
    pub column_scatter: f64,
    /// As `row_change`, of columns against the shorter exposures.
    pub column_change: f64,
    /// Pixels, in groups, that deviate from the shorter exposures or from earlier
    /// frames of this one although most do not: something moved there, or the
    /// light changed by more than 5% between frames.
    pub moved_pixels: usize,
    /// Relative change of the light over the frames of this exposure, by a
    /// straight line through their levels; 0 for a single frame.
    pub drift: f64,
    /// Standard uncertainty of the drift from noise; 0 for a single frame.
    pub drift_std: f64,
}

/// A pixel deviates where it differs by this many standard deviations ...
const DEPARTURE_SIGMA: f64 = 5.0;
/// ... and by what this relative error of the light, times them, explains.
const TOLERATED: f64 = 0.01;
/// So many of a pixel and its eight neighbours deviate together where something moved.
const GROUP: usize = 3;
/// Repeats are compared where all of them together stay below this part of the
/// usable range.
const REPEAT_BELOW: f64 = 0.9;

/// Whether a difference is beyond noise and tolerance. One electron more of
/// noise allows for the long tail of the Poisson distribution of few.
fn beyond(difference_dn: f64, variance_dn2: f64, signal_dn: f64, gain_dn_per_e: f64) -> bool {
    let tolerated_dn2 = (TOLERATED * signal_dn).powi(2) + gain_dn_per_e * gain_dn_per_e;
    difference_dn * difference_dn > DEPARTURE_SIGMA.powi(2) * (variance_dn2 + tolerated_dn2)
}

/// Whether an exposure deviates from what the shorter ones predict. Beyond the
/// usable range, counts and predictions are only known to be there.
pub(super) fn deviates(noise: &SensorNoise, level: &Level, agreement: &Agreement) -> bool {
    let usable_dn = noise.usable_range_dn();
    let signal_dn = match level.clipped {
        true => usable_dn,
        false => level.signal_dn,
    };
    let difference_dn = signal_dn - agreement.predicted_dn.min(usable_dn);
    let offset_dn = agreement.per_offset * noise.black_level_spread_dn;
    beyond(
        difference_dn,
        agreement.innovation_dn2 + offset_dn * offset_dn,
        agreement.predicted_dn,
        noise.gain_dn_per_e,
    )
}

/// A frame against the mean of the earlier ones of its exposure, summed over pixels.
#[derive(Clone, Debug, Default)]
pub(super) struct Repeat {
    sums: Sums,
    rows: Vec<LineSum>,
}

impl Repeat {
    /// The pixels that follow are of the next row.
    pub fn begin_row(&mut self) {
        self.rows.push(LineSum::default());
    }

    /// Adds a pixel; `variance` is that of the frame's own signal.
    pub fn take(&mut self, signal: f64, before: f64, variance: f64, earlier: u32) {
        let step = Step {
            signal,
            predicted: before,
            variance: variance * (1.0 + 1.0 / f64::from(earlier)),
            common: 0.0,
        };
        self.sums.take(&step, step.chi2());
        if let Some(row) = self.rows.last_mut() {
            row.take(&step);
        }
    }

    /// Adds a pixel's raw count, `sum_dn` being that of the `earlier` frames. Returns
    /// whether the pixel deviates. Which pixels are summed is decided from all
    /// frames together, so that the choice favours neither side.
    pub fn take_count(
        &mut self,
        noise: &SensorNoise,
        count_dn: f64,
        sum_dn: f64,
        earlier: u32,
        counts: bool,
    ) -> bool {
        let frames = f64::from(earlier);
        let before_dn = noise.signal_dn(sum_dn / frames);
        let signal_dn = noise.signal_dn(count_dn);
        let pooled_dn = (frames * before_dn + signal_dn) / (frames + 1.0);
        let variance_dn2 = noise.count_variance_dn2(pooled_dn / noise.gain_dn_per_e);
        if counts && pooled_dn < REPEAT_BELOW * noise.usable_range_dn() {
            self.take(signal_dn, before_dn, variance_dn2, earlier);
        }
        beyond(
            signal_dn - before_dn,
            variance_dn2 * (1.0 + 1.0 / frames),
            pooled_dn,
            noise.gain_dn_per_e,
        )
    }
}

/// Sums over the pixels of one light exposure, by colour.
#[derive(Clone, Debug, Default)]
pub(super) struct ExposureTally {
    exposure_s: f64,
    frames: u32,
    /// One on a monochrome sensor, or red, green and blue.
    pub colours: Vec<ColourTally>,
}

/// Sums over the pixels of one colour.
#[derive(Clone, Debug, Default)]
pub(super) struct ColourTally {
    /// Each frame after the first.
    pub repeats: Vec<Repeat>,
    pub moved_pixels: usize,
    seen: usize,
    deviating: usize,
    steady: Sums,
    unsteady: Sums,
    rows: Vec<LineSum>,
    columns: Vec<LineSum>,
}

impl ColourTally {
    /// The pixels that follow are of the next row.
    pub fn begin_row(&mut self) {
        self.rows.push(LineSum::default());
    }

    /// Takes in a pixel of this column; `step` is how the exposure agreed with the shorter ones,
    /// with its χ², where it counts in full.
    pub fn take_in(&mut self, column: usize, deviates: bool, step: Option<(Step, f64)>) {
        self.seen += 1;
        self.deviating += usize::from(deviates);
        if let Some((step, chi2)) = step {
            let sums = match deviates {
                true => &mut self.unsteady,
                false => &mut self.steady,
            };
            sums.take(&step, chi2);
            if let Some(row) = self.rows.last_mut() {
                row.take(&step);
            }
            if self.columns.len() <= column {
                self.columns.resize(column + 1, LineSum::default());
            }
            self.columns[column].take(&step);
        }
    }

    /// Adds the sums alone.
    fn add_sums(&mut self, other: &Self) {
        self.seen += other.seen;
        self.deviating += other.deviating;
        self.steady.add(&other.steady);
        self.unsteady.add(&other.unsteady);
    }

    fn add(&mut self, other: &Self) {
        self.add_sums(other);
        self.moved_pixels += other.moved_pixels;
        self.rows.extend_from_slice(&other.rows);
        let columns = self.columns.len().max(other.columns.len());
        self.columns.resize(columns, LineSum::default());
        for (mine, theirs) in self.columns.iter_mut().zip(&other.columns) {
            mine.add(theirs);
        }
        for (mine, theirs) in self.repeats.iter_mut().zip(&other.repeats) {
            mine.sums.add(&theirs.sums);
            mine.rows.extend_from_slice(&theirs.rows);
        }
    }

    fn deviates_everywhere(&self) -> bool {
        let off = |(ratio, std): (f64, f64)| (ratio - 1.0).abs() > TOLERATED + 3.0 * std;
        2 * self.deviating > self.seen || self.steady.ratio().is_some_and(off)
    }

    fn agreement(&self, exposure_s: f64, frames: u32) -> ExposureAgreement {
        let mut sums = self.steady;
        if self.deviates_everywhere() {
            sums.add(&self.unsteady);
        }
        let mut all = self.steady;
        all.add(&self.unsteady);
        let reduced_chi2 = sums.reduced_chi2();
        // Where the shorter exposures saw no light, nothing was compared.
        let (pixels, signal_ratio, signal_ratio_std) = match sums.ratio() {
            Some((ratio, std)) => (
                sums.pixels,
                ratio,
                (std * sums.excess()).hypot(sums.common_std()),
            ),
            None => (0, 1.0, 0.0),
        };
        let (drift, drift_std) = self.drift();
        let repeats = || self.repeats.iter();
        let rows = repeats()
            .map(|repeat| line_scatter(&repeat.rows))
            .fold(line_scatter(&self.rows), LineScatter::max);
        let columns = line_scatter(&self.columns);
        ExposureAgreement {
            exposure_s,
            frames,
            pixels,
            signal_ratio,
            signal_ratio_std,
            reduced_chi2,
            pixel_scatter: repeats()
                .map(|repeat| repeat.sums.scatter())
                .fold(all.scatter(), f64::max),
            row_scatter: rows.sharp,
            row_change: rows.whole,
            column_scatter: columns.sharp,
            column_change: columns.whole,
            moved_pixels: self.moved_pixels,
            drift,
            drift_std,
        }
    }

    /// Relative change from the first frame to the last, and its uncertainty.
    fn drift(&self) -> (f64, f64) {
        let mut levels = vec![1.0];
        let mut own_variance = 0.0;
        for Repeat { sums, .. } in &self.repeats {
            if sums.predicted <= 0.0 {
                return (0.0, 0.0);
            }
            let earlier = levels.len() as f64;
            let before = levels.iter().sum::<f64>() / earlier;
            levels.push(before * sums.signal / sums.predicted);
            own_variance += sums.variance / (1.0 + 1.0 / earlier) / sums.predicted.powi(2);
        }
        let n = levels.len() as f64;
        if n < 2.0 {
            return (0.0, 0.0);
        }
        own_variance /= n - 1.0;
        let middle = 0.5 * (n - 1.0);
        let (mut score, mut information) = (0.0, 0.0);
        for (i, level) in levels.iter().enumerate() {
            let at = i as f64 - middle;
            score += at * level;
            information += at * at;
        }
        let whole = n - 1.0;
        (
            whole * score / information,
            whole * (own_variance / information).sqrt(),
        )
    }
}

impl ExposureTally {
    /// No pixel seen yet.
    pub fn of(exposure_s: f64, frames: u32, colours: usize) -> Self {
        Self {
            exposure_s,
            frames,
            colours: vec![ColourTally::default(); colours],
        }
    }

    /// Adds another part of the image, further down.
    pub fn add(&mut self, other: &Self) {
        for (mine, theirs) in self.colours.iter_mut().zip(&other.colours) {
            mine.add(theirs);
        }
    }

    /// Whether the exposure as a whole deviates, so that single pixels prove
    /// nothing: most do, or the others are off together.
    pub fn deviates_everywhere(&self) -> bool {
        let mut all = ColourTally::default();
        for colour in &self.colours {
            all.add_sums(colour);
        }
        all.deviates_everywhere()
    }
}

/// Adds another part of the image, further down, to each exposure.
pub(super) fn add_all(tallies: &mut Vec<ExposureTally>, more: Vec<ExposureTally>) {
    if tallies.is_empty() {
        *tallies = more;
        return;
    }
    for (tally, more) in tallies.iter_mut().zip(&more) {
        tally.add(more);
    }
}

/// How the exposures agree, per colour.
pub(super) fn by_colour(tallies: &[ExposureTally]) -> Vec<Vec<ExposureAgreement>> {
    let colours = tallies.first().map_or(0, |tally| tally.colours.len());
    let of = |colour: usize| {
        let agreement = tallies
            .iter()
            .map(|tally| tally.colours[colour].agreement(tally.exposure_s, tally.frames));
        agreement.collect()
    };
    (0..colours).map(of).collect()
}

/// The exposures, as a set of [`bit`]s, of which single deviating pixels prove something.
pub(super) fn trusted(tallies: &[ExposureTally]) -> u16 {
    (0..tallies.len())
        .filter(|&e| !tallies[e].deviates_everywhere())
        .fold(0, |set, e| set | bit(e))
}

/// Bit of an exposure in a pixel's set of deviating exposures.
pub(super) fn bit(exposure: usize) -> u16 {
    1 << exposure.min(15)
}

/// The exposures of which a pixel deviates together with its neighbours (`step`
/// pixels away), of those in `trusted`.
pub(super) fn moved(
    deviating: &[u16],
    width: usize,
    [x, y]: [usize; 2],
    step: usize,
    trusted: u16,
) -> u16 {
    let here = deviating[y * width + x] & trusted;
    if here == 0 {
        return 0;
    }
    let height = deviating.len() / width;
    let mut counts = [0; 16];
    let around = |at: usize, limit: usize| {
        [at.checked_sub(step), Some(at), at.checked_add(step)]
            .into_iter()
            .flatten()
            .filter(move |&at| at < limit)
    };
    for row in around(y, height) {
        for column in around(x, width) {
            let there = deviating[row * width + column] & here;
            for (bit, count) in counts.iter_mut().enumerate() {
                *count += usize::from(there >> bit & 1);
            }
        }
    }
    (0..16)
        .filter(|&bit| counts[bit] >= GROUP)
        .fold(0, |set, bit| set | 1 << bit)
}
