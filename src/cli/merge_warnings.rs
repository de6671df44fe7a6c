//! What `rig merge` and `rig calibrate response` say of frames that do not agree.

use super::Context;
use crate::radiometry::agreement::ExposureAgreement;
use crate::radiometry::bracket_doubts::{Counts, Deviation, doubts};
use crate::radiometry::filter_order::FilterDoubt;
use crate::radiometry::mosaic::Mosaic;

/// Frames without light are among those of an exposure where hardly any is left.
const NO_LIGHT: f64 = 0.7;

/// Warns of exposures that do not agree, `channels` being one, or red, green and blue.
pub(in crate::cli) fn warn_agreement(
    channels: &[Vec<ExposureAgreement>],
    counts: Counts,
    context: &Context,
) {
    for doubt in doubts(channels, counts) {
        // What moved is a cause itself.
        let mark = match doubt.what {
            Deviation::Moved(..) => ';',
            _ => ':',
        };
        context.warn(format_args!("{doubt}{mark} {}", cause(&doubt.what, counts)));
    }
}

/// What it may come from, and what to do; of what moved, what became of it.
fn cause(what: &Deviation, counts: Counts) -> &'static str {
    use Counts::*;
    match (what, counts) {
        (Deviation::Ratio(_, true), Raw) => {
            "the colours differ: a lamp whose colour drifts, a black level that is off, or counts \
             that are not proportional to light"
        }
        (Deviation::Ratio(_, true), ThroughResponse) => {
            "the colours differ: white balance that the camera chose anew, a lamp whose colour \
             drifts, or a response of another setting"
        }
        (Deviation::Ratio(_, false), Raw) => {
            "a wrong exposure time, a lamp that drifts, or counts that are not proportional to \
             light (--measured-exposures uses what the frames show)"
        }
        (Deviation::Ratio(_, false), ThroughResponse) => {
            "an exposure time that is wrong or that the camera rounded, a lamp that drifts, or a \
             response of another setting (--measured-exposures uses what the frames show)"
        }
        (Deviation::Rows(_), _) => {
            "the lamp flickers (a dimmer, the mains) while the sensor reads row after row: feed \
             it with direct current, or expose for whole periods"
        }
        (Deviation::RowsSlowly(_), _) => {
            "the lamp flickers about once while the sensor reads the image (feed it with direct \
             current, or expose for whole periods), or it was moved"
        }
        (Deviation::Columns(_), _) => {
            "offsets or gains of the sensor's columns that are others at this exposure (take dark \
             frames of each exposure, turn HDR modes off), or, where the image was turned, a lamp \
             that flickers"
        }
        (Deviation::Noise { .. }, _) => {
            "light that changed over the image, counts that were processed, or a gain or read \
             noise that is not the sensor's"
        }
        (Deviation::Scatter(_), _) => {
            "a response that changes from frame to frame (HDR, tone mapping or automatic contrast \
             of the camera), or a scene that moved"
        }
        (Deviation::Drift { change, .. }, _) if change.abs() > NO_LIGHT => {
            "frames without light among them have the role `dark` or `ambient` in the table of \
             exposures"
        }
        (Deviation::Drift { .. }, _) => "let the lamp warm up, or see `rig calibrate lamp`",
        (Deviation::Moved(..), Raw) => "they are masked",
        (Deviation::Moved(..), ThroughResponse) => "they are not masked",
    }
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
