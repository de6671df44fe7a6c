//! What the exposures of a bracket say against each other, beyond what noise explains.

use std::fmt;

use super::agreement::ExposureAgreement;

/// What the counts are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Counts {
    /// Proportional to light.
    Raw,
    /// Of a camera with a response curve.
    ThroughResponse,
}

impl Counts {
    /// A frame whose signal differs from the others' prediction by more than this part is
    /// reported: a wrong exposure, or counts that are not linear. Response curves and the times
    /// that cameras round are not so exact.
    fn ratio_limit(self) -> f64 {
        match self {
            Self::Raw => 0.01,
            Self::ThroughResponse => 0.025,
        }
    }

    /// Rows or columns that differ by more than this are reported, also where they do so slowly.
    fn line_limit(self) -> f64 {
        match self {
            Self::Raw => 0.02,
            Self::ThroughResponse => 0.05,
        }
    }
}

/// A change of the light over the frames of one exposure beyond this is reported.
const DRIFT_WARNING: f64 = 0.005;
/// Rows that differ by more than this are reported, ...
const ROW_WARNING: f64 = 0.02;
/// ... if they explain this part of the pixels' squared deviations, ...
const ROW_SHARE: f64 = 0.5;
/// ... and columns, or rows, differ by less than this part of it: else the whole image does.
const OTHER_LINES: f64 = 0.5;
/// Deviations are reported where their mean square is this many times what noise explains; ...
const CHI2_WARNING: f64 = 4.0;
/// ... with a response, whose noise is only known from the frames, where they are this part of
/// the signal.
const SCATTER_WARNING: f64 = 0.1;
/// Pixels that it takes to speak of a mean square.
const LEAST_PIXELS: usize = 16;

/// What speaks against an exposure.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs)]
pub struct BracketDoubt {
    pub exposure_s: f64,
    pub what: Deviation,
}

/// How an exposure deviates from the others. Parts are relative to the signal.
#[derive(Clone, Debug, PartialEq)]
pub enum Deviation {
    /// Its signal over what the shorter ones predict, with its standard uncertainty, of the one
    /// colour or of red, green and blue; and whether the colours differ.
    Ratio(Vec<(f64, f64)>, bool),
    /// Rows differ from neighbouring ones.
    Rows(f64),
    /// Rows differ slowly over the image.
    RowsSlowly(f64),
    /// Columns differ.
    Columns(f64),
    /// Pixels deviate beyond their noise.
    #[allow(missing_docs)]
    Noise { reduced_chi2: f64, scatter: f64 },
    /// Pixels deviate through a response, whose noise is not known.
    Scatter(f64),
    /// The light changed over its frames.
    #[allow(missing_docs)]
    Drift { change: f64, frames: u32 },
    /// Something moved over so many pixels, or values of colours.
    Moved(usize, Counts),
}

/// What speaks against the exposures of a bracket, `channels` being one, or red, green and blue.
pub fn doubts(channels: &[Vec<ExposureAgreement>], counts: Counts) -> Vec<BracketDoubt> {
    let exposures = channels.iter().map(Vec::len).min().unwrap_or(0);
    let mut found = Vec::new();
    for index in 0..exposures {
        let steps: Vec<&ExposureAgreement> = channels.iter().map(|c| &c[index]).collect();
        let mut all: Vec<_> = ratio(&steps, counts)
            .into_iter()
            .chain(rows(&steps))
            .collect();
        if all.is_empty() {
            // Curves that change with the scene's brightness look as slow changes do.
            all.extend(match counts {
                Counts::Raw => lines(&steps, counts).or_else(|| deviations(&steps, counts)),
                Counts::ThroughResponse => {
                    deviations(&steps, counts).or_else(|| lines(&steps, counts))
                }
            });
        }
        all.extend(drift(&steps));
        let moved: usize = steps.iter().map(|step| step.moved_pixels).sum();
        all.extend((moved > 0).then_some(Deviation::Moved(moved, counts)));
        let exposure_s = steps[0].exposure_s;
        let of_it = all
            .into_iter()
            .map(|what| BracketDoubt { exposure_s, what });
        found.extend(of_it);
    }
    found
}

/// The step of which something is largest, of those that have it at all.
fn worst<'a>(
    steps: &[&'a ExposureAgreement],
    has: impl Fn(&ExposureAgreement) -> bool,
    size: impl Fn(&ExposureAgreement) -> f64,
) -> Option<&'a ExposureAgreement> {
    let having = steps.iter().copied().filter(|step| has(step));
    having.max_by(|a, b| size(a).total_cmp(&size(b)))
}

fn ratio(steps: &[&ExposureAgreement], counts: Counts) -> Option<Deviation> {
    let limit = counts.ratio_limit();
    let is_off = |difference: f64, std: f64| difference.abs() > limit.max(5.0 * std);
    let off = |step: &&ExposureAgreement| is_off(step.signal_ratio - 1.0, step.signal_ratio_std);
    if !steps.iter().any(off) {
        return None;
    }
    let differ = |a: &ExposureAgreement, b: &ExposureAgreement| {
        let std = a.signal_ratio_std.hypot(b.signal_ratio_std);
        is_off(a.signal_ratio - b.signal_ratio, std)
    };
    let ratios = steps
        .iter()
        .map(|step| (step.signal_ratio, step.signal_ratio_std));
    let colours_differ = steps.iter().any(|a| steps.iter().any(|b| differ(a, b)));
    Some(Deviation::Ratio(ratios.collect(), colours_differ))
}

fn rows(steps: &[&ExposureAgreement]) -> Option<Deviation> {
    let flickers = |step: &ExposureAgreement| {
        step.row_scatter > ROW_WARNING
            && step.row_scatter.powi(2) > ROW_SHARE * step.pixel_scatter.powi(2)
    };
    let step = worst(steps, flickers, |step| step.row_scatter)?;
    Some(Deviation::Rows(step.row_scatter))
}

/// Rows that differ slowly over the image, and columns.
fn lines(steps: &[&ExposureAgreement], counts: Counts) -> Option<Deviation> {
    let largest = |change: fn(&ExposureAgreement) -> f64, other: fn(&ExposureAgreement) -> f64| {
        let is_off = |step: &ExposureAgreement| {
            change(step) > counts.line_limit()
                && change(step).powi(2) > ROW_SHARE * step.pixel_scatter.powi(2)
                && other(step) < OTHER_LINES * change(step)
        };
        worst(steps, is_off, change).map(change)
    };
    let rows = largest(|step| step.row_change, |step| step.column_change);
    let columns = || largest(|step| step.column_scatter, |step| step.row_change);
    rows.map(Deviation::RowsSlowly)
        .or_else(|| columns().map(Deviation::Columns))
}

fn deviations(steps: &[&ExposureAgreement], counts: Counts) -> Option<Deviation> {
    let seen = |step: &ExposureAgreement| step.pixels >= LEAST_PIXELS;
    match counts {
        Counts::Raw => {
            let step = worst(steps, seen, |step| step.reduced_chi2)?;
            let noise = Deviation::Noise {
                reduced_chi2: step.reduced_chi2,
                scatter: step.pixel_scatter,
            };
            (step.reduced_chi2 > CHI2_WARNING).then_some(noise)
        }
        Counts::ThroughResponse => {
            let scatter = worst(steps, seen, |step| step.pixel_scatter)?.pixel_scatter;
            (scatter > SCATTER_WARNING).then_some(Deviation::Scatter(scatter))
        }
    }
}

fn drift(steps: &[&ExposureAgreement]) -> Option<Deviation> {
    let drifts =
        |step: &ExposureAgreement| step.drift.abs() > DRIFT_WARNING.max(5.0 * step.drift_std);
    let step = worst(steps, drifts, |step| step.drift.abs())?;
    Some(Deviation::Drift {
        change: step.drift,
        frames: step.frames,
    })
}

/// An exposure, seconds, with six significant digits.
pub fn shown_s(exposure_s: f64) -> f64 {
    let scale = 10f64.powf(5.0 - exposure_s.log10().floor());
    (exposure_s * scale).round() / scale
}

/// Value and standard uncertainty, this with two significant digits.
fn plus_minus(&(value, std): &(f64, f64)) -> String {
    let decimals = match std > 0.0 {
        true => (1.0 - std.log10().floor()).clamp(2.0, 6.0) as usize,
        false => 3,
    };
    format!("{value:.decimals$} ± {std:.decimals$}")
}

impl fmt::Display for BracketDoubt {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        use Deviation::*;
        let exposure = format!("exposure of {} s", shown_s(self.exposure_s));
        let percent = |part: &f64| 100.0 * part;
        match &self.what {
            Ratio(ratios, _) => {
                let shown: Vec<_> = ratios.iter().map(plus_minus).collect();
                let ratios = match &shown[..] {
                    [red, green, blue] => format!("{red} (red), {green} (green) and {blue} (blue)"),
                    shown => shown.concat(),
                };
                write!(
                    out,
                    "the {exposure} collected {ratios} times what the shorter ones predict"
                )
            }
            Rows(part) => write!(
                out,
                "rows of the {exposure} differ by {:.1}% from the other frames'",
                percent(part)
            ),
            RowsSlowly(part) => write!(
                out,
                "rows of the {exposure} differ by {:.1}% from the other frames', slowly over the \
                 image's height",
                percent(part)
            ),
            Columns(part) => write!(
                out,
                "columns of the {exposure} differ by {:.1}% from the other frames'",
                percent(part)
            ),
            Noise {
                reduced_chi2,
                scatter,
            } => write!(
                out,
                "pixels of the {exposure} deviate by {:.1} times their noise from what the shorter \
                 ones predict (reduced chi-square {reduced_chi2:.1}; {:.1}% of the signal)",
                reduced_chi2.sqrt(),
                percent(scatter)
            ),
            Scatter(part) => write!(
                out,
                "pixels of the {exposure} deviate by {:.0}% from what the shorter ones predict, \
                 which no exposure explains",
                percent(part)
            ),
            Drift { change, frames } => write!(
                out,
                "the light changed by {:.1}% over the {frames} frames of {} s",
                percent(change),
                shown_s(self.exposure_s)
            ),
            Moved(moved, counts) => {
                let what = match counts {
                    Counts::Raw => "pixels",
                    Counts::ThroughResponse => "values",
                };
                write!(
                    out,
                    "{moved} {what} of the {exposure} differ from the other frames: something moved"
                )
            }
        }
    }
}
