//! What is found while a capture is prepared, in words for the terminal, with what to do.

use indicatif::ProgressBar;

use super::capture_events::EventLines;
use super::context::Context;
use super::error::CliError;
use super::preflight::{self, Keys};
use super::sharpness;
use crate::calibration::fitness::Concern;
use crate::capture::findings::{Notice, PrepareError};
use crate::config::RigConfig;

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
        if let Notice::Comparing { directions } = notice {
            let spinner = self.context.spinner();
            spinner.set_message(format!("comparing {directions} light directions"));
            self.spinner = Some(spinner);
            return;
        }
        let (fact, remedy) = described(&notice);
        let text = match remedy {
            Some(remedy) => format!("{fact}; {remedy}"),
            None => fact,
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

/// A remark, and what to do about it.
pub(super) fn described(notice: &Notice<'_>) -> (String, Option<String>) {
    match notice {
        Notice::Comparing { directions } => (format!("comparing {directions} directions"), None),
        Notice::Record { kind, concern } => {
            let otherwise = match concern {
                Concern::Changed { .. } => CHANGED_ON_PURPOSE,
                _ => "",
            };
            let remedy = format!("run `rig calibrate {}`{otherwise}", kind.command());
            (format!("{}: {concern}", kind.folder()), Some(remedy))
        }
        Notice::Temperature(concern) => {
            let remedy = "let the camera warm up as it had then, or calibrate anew";
            (concern.to_string(), Some(remedy.to_owned()))
        }
        Notice::WarmUp { needed_s, stated_s } => (
            format!(
                "lamp: it takes {needed_s:.0} s to warm up, and capture.lamp_warm_up_s is {stated_s:.0}"
            ),
            Some(format!("set it to {:.0}", needed_s.ceil())),
        ),
        Notice::TowardsLens { lights } => {
            let each = lights
                .iter()
                .map(|(light, angles, off_deg)| format!("light {light} ({angles}) {off_deg:.0}°"));
            let each = each.collect::<Vec<_>>().join(", ");
            (
                format!(
                    "lights from behind the sample, by their angle to the camera's axis: {each}"
                ),
                Some(BAFFLE.to_owned()),
            )
        }
        Notice::File(remark) => (remark.to_string(), None),
        Notice::View { concern, seen } => (preflight::fact(concern, seen), None),
        Notice::Blur { blur, limit_px } => (
            sharpness::concern(blur, *limit_px),
            Some(sharpness::REMEDY.to_owned()),
        ),
    }
}

/// The error with the advice that needs the rig file.
pub(super) fn advised(error: PrepareError, rig: &RigConfig) -> CliError {
    let keys = Keys::rig(rig);
    match &error {
        PrepareError::View { concern, seen } => CliError::new(preflight::fact(concern, seen))
            .hint(preflight::remedy(concern, seen, keys)),
        PrepareError::Unlit { concern, seen, .. } => {
            let remedy = preflight::remedy(concern, seen, keys);
            CliError::from(error).hint(remedy)
        }
        _ => error.into(),
    }
}
