//! A capture that knows when it has enough: after each light a quick fit, what is expected of
//! its error, and the light that would lower it most.

use std::path::Path;

use super::FitRequest;
use super::fit_session::fit_captured;
use crate::capture::light_choice::{self, Ranked};
use crate::capture::{Chooser, SinkError};
use crate::session::fit_record::Verdict;
use crate::session::{Decision, Session};

/// Measured environment errors over expected ones, mean of ten designs with three materials each
/// that the prior does not know (1.21 to 1.64; docs/measurements/designs.md). What a capture
/// expects of its error is multiplied by it.
pub const MEASURED_OVER_EXPECTED: f64 = 1.4;
/// Paths per cell of a fit that only tells where to go on.
const QUICK_PATHS: u32 = 64;

/// Chooses by quick fits, of which nothing is kept but the decision.
#[derive(Clone, Copy, Debug, Default)]
pub struct QuickFits;

impl Chooser for QuickFits {
    fn choose(&mut self, root: &Path) -> Result<Decision, SinkError> {
        let session = Session::open(root)?;
        let request = FitRequest {
            samples_per_cell: Some(QUICK_PATHS),
            ..FitRequest::default()
        };
        let (fit, _) = fit_captured(root, &request, &())?;
        let material = fit.material()?;
        let expect = |count| light_choice::after(&session, &*material, count, &mut |_| ());
        let found = expect(0)?;
        let mut decision = Decision {
            seed: fit.settings.seed,
            is_trusted: fit.verdict() != Verdict::NotToBeTrusted,
            expected_error: MEASURED_OVER_EXPECTED * found.error,
            best: None,
            stop: None,
        };
        let spent_s = session.journal().spent_s();
        let until = session.record().plan.until;
        decision.stop = until.and_then(|until| until.enough(&decision, found.taken, spent_s));
        if decision.stop.is_none() {
            let found = expect(1)?;
            decision.expected_error = MEASURED_OVER_EXPECTED * found.error;
            decision.best = found.next.first().map(|best| Ranked {
                error: MEASURED_OVER_EXPECTED * best.error,
                ..*best
            });
            let before = session.journal().decisions().last();
            decision.stop = decision.futile(before.as_ref());
        }
        Ok(decision)
    }
}
