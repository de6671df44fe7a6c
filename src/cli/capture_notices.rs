//! What is found while a capture is prepared, in words for the terminal, with what to do.

use indicatif::ProgressBar;

use super::context::Context;
use super::preflight::FOR_BLUR;
use crate::calibration::fitness::Concern;
use crate::calibration::record::Kind;
use crate::capture::event_lines::EventLines;
use crate::capture::findings::Notice;

/// What else to do about a record that does not match its checksum.
const CHANGED_ON_PURPOSE: &str =
    ", or remove the record's line `checksum` if it was changed on purpose";

/// What to do about light that goes straight into the lens.
const BAFFLE: &str = "a baffle must keep each out of the lens and leave the sample in its light: a black card beside the sample, outside the image, in whose shadow the lens lies";

/// Shows notices as they come: warnings, and a spinner while directions are compared.
pub(super) struct Terminal<'a> {
    context: &'a Context,
    lines: Option<&'a EventLines>,
    spinner: Option<ProgressBar>,
}

impl<'a> Terminal<'a> {
    /// On stderr, and warnings among the events.
    pub(super) fn new(context: &'a Context, lines: Option<&'a EventLines>) -> Self {
        Self {
            context,
            lines,
            spinner: None,
        }
    }

    pub(super) fn show(&mut self, notice: Notice<'_>) {
        self.finish();
        if let Notice::Comparing { .. } = notice {
            let spinner = self.context.spinner();
            spinner.set_message(notice.to_string());
            self.spinner = Some(spinner);
            return;
        }
        let text = match remedy(&notice) {
            Some(remedy) => format!("{notice}; {remedy}"),
            None => notice.to_string(),
        };
        if let Some(lines) = self.lines {
            lines.warn(&text);
        }
        self.context.warn(text);
    }

    /// Ends the spinner.
    pub(super) fn finish(&mut self) {
        if let Some(spinner) = self.spinner.take() {
            spinner.finish_and_clear();
        }
    }
}

/// What to do about it.
fn remedy(notice: &Notice<'_>) -> Option<String> {
    match notice {
        Notice::Comparing { .. } | Notice::File(_) | Notice::View(_) => None,
        Notice::Record { kind, concern } => Some(for_record(*kind, concern)),
        Notice::Temperature(_) => {
            Some("let the camera warm up as it had then, or calibrate anew".to_owned())
        }
        Notice::TowardsLens { .. } => Some(BAFFLE.to_owned()),
        Notice::WarmUp { needed_s, .. } => Some(for_warm_up(*needed_s)),
        Notice::Blur { .. } => Some(FOR_BLUR.to_owned()),
    }
}

/// What to do about a record that should be measured anew.
pub(super) fn for_record(kind: Kind, concern: &Concern) -> String {
    let otherwise = match concern {
        Concern::Changed { .. } => CHANGED_ON_PURPOSE,
        _ => "",
    };
    format!("run `rig calibrate {}`{otherwise}", kind.command())
}

/// What to do about a lamp that takes longer to warm up than the rig file waits.
pub(super) fn for_warm_up(needed_s: f64) -> String {
    format!("set it to {:.0}", needed_s.ceil())
}
