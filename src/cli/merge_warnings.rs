//! What `rig merge` and `rig calibrate response` say of frames that do not agree.

use super::Context;
use crate::radiometry::agreement::ExposureAgreement;
use crate::radiometry::filter_order::FilterDoubt;
use crate::radiometry::mosaic::Mosaic;

/// What the counts are.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(in crate::cli) enum Counts {
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

/// A change of the light over the frames of one exposure beyond this is reported, ...
const DRIFT_WARNING: f64 = 0.005;
/// ... as frames without light where hardly any is left.
const NO_LIGHT: f64 = 0.7;
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

/// Warns of exposures that do not agree, `channels` being one, or red, green and blue.
pub(in crate::cli) fn warn_agreement(
    channels: &[Vec<ExposureAgreement>],
    counts: Counts,
    context: &Context,
) {
    let exposures = channels.iter().map(Vec::len).min().unwrap_or(0);
    for index in 0..exposures {
        let steps: Vec<&ExposureAgreement> = channels.iter().map(|c| &c[index]).collect();
        let explained = warn_ratio(&steps, counts, context) | warn_rows(&steps, context);
        if !explained {
            // Curves that change with the scene's brightness look as slow changes do.
            let _ = match counts {
                Counts::Raw => {
                    warn_lines(&steps, counts, context) || warn_deviations(&steps, counts, context)
                }
                Counts::ThroughResponse => {
                    warn_deviations(&steps, counts, context) || warn_lines(&steps, counts, context)
                }
            };
        }
        warn_drift(&steps, context);
        warn_moved(&steps, counts, context);
    }
}

/// An exposure, seconds, with six significant digits.
pub(super) fn shown_s(exposure_s: f64) -> f64 {
    let scale = 10f64.powf(5.0 - exposure_s.log10().floor());
    (exposure_s * scale).round() / scale
}

/// Value and standard uncertainty, this with two significant digits.
fn plus_minus(value: f64, std: f64) -> String {
    let decimals = match std > 0.0 {
        true => (1.0 - std.log10().floor()).clamp(2.0, 6.0) as usize,
        false => 3,
    };
    format!("{value:.decimals$} ± {std:.decimals$}")
}

fn warn_ratio(steps: &[&ExposureAgreement], counts: Counts, context: &Context) -> bool {
    let limit = counts.ratio_limit();
    let is_off = |difference: f64, std: f64| difference.abs() > limit.max(5.0 * std);
    let off = |step: &&ExposureAgreement| is_off(step.signal_ratio - 1.0, step.signal_ratio_std);
    if !steps.iter().any(off) {
        return false;
    }
    let ratio = |step: &ExposureAgreement| plus_minus(step.signal_ratio, step.signal_ratio_std);
    let ratios = match steps {
        [red, green, blue] => format!(
            "{} (red), {} (green) and {} (blue)",
            ratio(red),
            ratio(green),
            ratio(blue)
        ),
        steps => steps.iter().map(|step| ratio(step)).collect(),
    };
    let differ = |a: &ExposureAgreement, b: &ExposureAgreement| {
        let std = a.signal_ratio_std.hypot(b.signal_ratio_std);
        is_off(a.signal_ratio - b.signal_ratio, std)
    };
    let cause = match (
        counts,
        steps.iter().any(|a| steps.iter().any(|b| differ(a, b))),
    ) {
        (Counts::Raw, true) => {
            "the colours differ: a lamp whose colour drifts, a black level that is off, or counts \
             that are not proportional to light"
        }
        (Counts::ThroughResponse, true) => {
            "the colours differ: white balance that the camera chose anew, a lamp whose colour \
             drifts, or a response of another setting"
        }
        (Counts::Raw, false) => {
            "a wrong exposure time, a lamp that drifts, or counts that are not proportional to \
             light (--measured-exposures uses what the frames show)"
        }
        (Counts::ThroughResponse, false) => {
            "an exposure time that is wrong or that the camera rounded, a lamp that drifts, or a \
             response of another setting (--measured-exposures uses what the frames show)"
        }
    };
    context.warn(format_args!(
        "the exposure of {} s collected {ratios} times what the shorter ones predict: {cause}",
        shown_s(steps[0].exposure_s)
    ));
    true
}

fn warn_rows(steps: &[&ExposureAgreement], context: &Context) -> bool {
    let flickers = |step: &&&ExposureAgreement| {
        step.row_scatter > ROW_WARNING
            && step.row_scatter.powi(2) > ROW_SHARE * step.pixel_scatter.powi(2)
    };
    let by_rows =
        |a: &&&ExposureAgreement, b: &&&ExposureAgreement| a.row_scatter.total_cmp(&b.row_scatter);
    let Some(step) = steps.iter().filter(flickers).max_by(by_rows) else {
        return false;
    };
    context.warn(format_args!(
        "rows of the exposure of {} s differ by {:.1}% from the other frames': the lamp flickers \
         (a dimmer, the mains) while the sensor reads row after row: feed it with direct current, \
         or expose for whole periods",
        shown_s(step.exposure_s),
        100.0 * step.row_scatter
    ));
    true
}

/// Warns of rows that differ slowly over the image, and of columns.
fn warn_lines(steps: &[&ExposureAgreement], counts: Counts, context: &Context) -> bool {
    let worst = |change: fn(&ExposureAgreement) -> f64, other: fn(&ExposureAgreement) -> f64| {
        let off = steps.iter().filter(|step| {
            change(step) > counts.line_limit()
                && change(step).powi(2) > ROW_SHARE * step.pixel_scatter.powi(2)
                && other(step) < OTHER_LINES * change(step)
        });
        off.max_by(|a, b| change(a).total_cmp(&change(b)))
    };
    let exposure = format!("of the exposure of {} s", shown_s(steps[0].exposure_s));
    if let Some(step) = worst(|step| step.row_change, |step| step.column_change) {
        context.warn(format_args!(
            "rows {exposure} differ by {:.1}% from the other frames', slowly over the image's \
             height: the lamp flickers about once while the sensor reads the image (feed it with \
             direct current, or expose for whole periods), or it was moved",
            100.0 * step.row_change
        ));
        return true;
    }
    if let Some(step) = worst(|step| step.column_scatter, |step| step.row_change) {
        context.warn(format_args!(
            "columns {exposure} differ by {:.1}% from the other frames': offsets or gains of the \
             sensor's columns that are others at this exposure (take dark frames of each exposure, \
             turn HDR modes off), or, where the image was turned, a lamp that flickers",
            100.0 * step.column_scatter
        ));
        return true;
    }
    false
}

fn warn_deviations(steps: &[&ExposureAgreement], counts: Counts, context: &Context) -> bool {
    let seen = steps.iter().filter(|step| step.pixels >= LEAST_PIXELS);
    match counts {
        Counts::Raw => {
            let worst = seen.max_by(|a, b| a.reduced_chi2.total_cmp(&b.reduced_chi2));
            if let Some(step) = worst.filter(|step| step.reduced_chi2 > CHI2_WARNING) {
                context.warn(format_args!(
                    "pixels of the exposure of {} s deviate by {:.1} times their noise from what \
                     the shorter ones predict (reduced chi-square {:.1}; {:.1}% of the signal): \
                     light that changed over the image, counts that were processed, or a gain or \
                     read noise that is not the sensor's",
                    shown_s(step.exposure_s),
                    step.reduced_chi2.sqrt(),
                    step.reduced_chi2,
                    100.0 * step.pixel_scatter
                ));
                return true;
            }
        }
        Counts::ThroughResponse => {
            let worst = seen.max_by(|a, b| a.pixel_scatter.total_cmp(&b.pixel_scatter));
            if let Some(step) = worst.filter(|step| step.pixel_scatter > SCATTER_WARNING) {
                context.warn(format_args!(
                    "pixels of the exposure of {} s deviate by {:.0}% from what the shorter ones \
                     predict, which no exposure explains: a response that changes from frame to \
                     frame (HDR, tone mapping or automatic contrast of the camera), or a scene \
                     that moved",
                    shown_s(step.exposure_s),
                    100.0 * step.pixel_scatter
                ));
                return true;
            }
        }
    }
    false
}

fn warn_drift(steps: &[&ExposureAgreement], context: &Context) {
    let drifts =
        |step: &&&ExposureAgreement| step.drift.abs() > DRIFT_WARNING.max(5.0 * step.drift_std);
    let by_drift =
        |a: &&&ExposureAgreement, b: &&&ExposureAgreement| a.drift.abs().total_cmp(&b.drift.abs());
    let Some(step) = steps.iter().filter(drifts).max_by(by_drift) else {
        return;
    };
    let cause = match step.drift.abs() > NO_LIGHT {
        true => {
            "frames without light among them have the role `dark` or `ambient` in the table of \
             exposures"
        }
        false => "let the lamp warm up, or see `rig calibrate lamp`",
    };
    context.warn(format_args!(
        "the light changed by {:.1}% over the {} frames of {} s: {cause}",
        100.0 * step.drift,
        step.frames,
        shown_s(step.exposure_s)
    ));
}

fn warn_moved(steps: &[&ExposureAgreement], counts: Counts, context: &Context) {
    let moved: usize = steps.iter().map(|step| step.moved_pixels).sum();
    if moved == 0 {
        return;
    }
    let (what, fate) = match counts {
        Counts::Raw => ("pixels", "they are masked"),
        Counts::ThroughResponse => ("values", "they are not masked"),
    };
    context.warn(format_args!(
        "{moved} {what} of the exposure of {} s differ from the other frames: something moved; \
         {fate}",
        shown_s(steps[0].exposure_s)
    ));
}

/// Warns of an order of colour filters that the frames contradict.
pub(super) fn warn_filters(doubt: &FilterDoubt, stated: Mosaic, context: &Context) {
    match doubt {
        FilterDoubt::OtherDiagonal {
            difference,
            orders: [one, other],
        } => context.warn(format_args!(
            "the two greens of the order {} differ by {:.0}%, and the other two pixels of each \
             cell agree: the order of the filters is {} or {} (--mosaic)",
            stated.name(),
            100.0 * difference,
            one.name(),
            other.name()
        )),
        FilterDoubt::Mosaic {
            difference,
            orders: [one, other],
        } => context.warn(format_args!(
            "neighbouring pixels differ by {:.0}% and every second one agrees, as under colour \
             filters: merged as a monochrome sensor; a raw colour sensor needs --mosaic {} or {}",
            100.0 * difference,
            one.name(),
            other.name()
        )),
    }
}
