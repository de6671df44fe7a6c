//! The part of a capture that all its commands share: on the devices, from its begin or its
//! interruption to its end or its next interruption.

use std::path::Path;
use std::time::Instant;

use super::capture_progress::Bar;
use super::context::Context;
use super::error::CliError;
use super::{interrupt, open, operator};
use crate::capture::event_lines::EventLines;
use crate::capture::open::{OpenOptions, open_devices};
use crate::capture::prepare::{self, Job};
use crate::capture::{CaptureError, Outcome, Spent};
use crate::interrupt::Interrupt;
use crate::session::layout::QUARANTINE_FOLDER;
use crate::workflow::QuickFits;

/// An interrupted session with its devices.
pub(super) fn resume(
    root: &Path,
    context: &Context,
    lines: Option<&EventLines>,
) -> Result<Job, CliError> {
    let interrupted = prepare::resume(root)?;
    if interrupted.has_quarantined() {
        let quarantine = root.join(QUARANTINE_FOLDER);
        let text = format!(
            "files that no journal record vouches for were moved to {}",
            quarantine.display()
        );
        warn(context, lines, &text);
    }
    let options = OpenOptions {
        begun: interrupted.begun().to_vec(),
        ..open::options_for(interrupted.rig(), || operator::of_capture(lines))?
    };
    let devices = open_devices(interrupted.rig(), &options)?;
    Ok(interrupted.go_on(devices)?)
}

fn warn(context: &Context, lines: Option<&EventLines>, text: &str) {
    context.warn(text);
    if let Some(lines) = lines {
        lines.warn(text);
    }
}

/// What came of a capture.
pub(super) struct Ran {
    pub(super) ended: Result<Outcome, CaptureError>,
    /// How long it took, seconds.
    pub(super) elapsed_s: f64,
    /// On what the time was spent, where it came to that.
    pub(super) spent: Option<Spent>,
}

/// Captures, with a bar; notes the time of a capture that is complete.
pub(super) fn run(
    job: Job,
    interrupt: Interrupt,
    context: &Context,
    lines: Option<&EventLines>,
) -> Ran {
    let is_instant = job.rig().is_instant();
    let lamps = job.rig().stage.measures.iter();
    let lamps = lamps.map(|of| of.colour()).collect();
    let began = Instant::now();
    if job.lacks_watchdog() {
        let text = "the stage's firmware has no watchdog: if the computer or the cable fails, the lamp stays on";
        warn(context, lines, text);
    }
    // Without its thread the capture obeys all the same.
    let announcing = interrupt::announcing(context, &interrupt).ok();
    let mut observers = (lines, Bar::new(context, lamps));
    let job = job.choosing_by(Box::new(QuickFits));
    let ended = job.run(&mut observers, interrupt);
    let (_, bar) = observers;
    drop(announcing);
    bar.finish();
    let (elapsed_s, spent) = (began.elapsed().as_secs_f64(), bar.spent());
    if matches!(ended, Ok(Outcome::Complete)) {
        context.note(format!("captured in {elapsed_s:.1} s"));
        if let Some(spent) = spent.filter(|_| !is_instant) {
            context.note(spent.to_string());
        }
    }
    Ran {
        ended,
        elapsed_s,
        spent,
    }
}

/// What a capture met that cannot go on now; `go_on` says how it can later.
pub(super) fn suspended(error: CaptureError, go_on: &str) -> CliError {
    let error = CliError::from(error);
    let advice = match error.advice() {
        Some(advice) => format!("{advice}; then {go_on}"),
        None => go_on.to_owned(),
    };
    CliError::new(format!("the capture is suspended: {}", error.fact())).hint(advice)
}
