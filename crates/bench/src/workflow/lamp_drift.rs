//! The remark on a lamp that drifted during a capture; it concerns the bench, not the fit's
//! verdict.

use crate::session::LampDrift;
use crate::session::drift::FALSE_ALARM_RATE;

/// The largest notable change, if there is any, and what to do.
pub(super) fn remark(drift: &LampDrift) -> Option<String> {
    let notable = drift.notable();
    let largest = notable.first()?;
    let others = match notable.len() {
        1 => String::new(),
        n => format!(", the largest of {n} notable changes"),
    };
    Some(format!(
        "{largest}{others} ({} comparisons; a constant lamp shows one in {:.0} captures); let it \
         warm up (`rig calibrate lamp` finds capture.lamp_warm_up_s), check its supply, or let \
         --refine-bench allow for it",
        drift.changes.len(),
        1.0 / FALSE_ALARM_RATE
    ))
}
