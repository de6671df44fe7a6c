//! How far long work is, for whoever wants to show it: one trait for every function that
//! takes more than a moment. `&()` shows nothing.

/// Receives the progress of work; its methods may be called from any thread.
///
/// A receiver that wants the work to end unwinds from any of them, by
/// [`std::panic::resume_unwind`]: nothing is written then, and the caller catches it.
///
/// ```
/// use std::sync::Mutex;
/// use rig_core::Progress;
///
/// #[derive(Default)]
/// struct Phases(Mutex<Vec<String>>);
///
/// impl Progress for Phases {
///     fn begin(&self, phase: &str, _: Option<usize>) {
///         self.0.lock().unwrap().push(phase.to_owned());
///     }
/// }
///
/// fn work(progress: &dyn Progress) {
///     progress.begin("rendering", Some(2));
///     progress.advance(1);
///     progress.advance(1);
/// }
///
/// work(&());
/// let phases = Phases::default();
/// work(&phases);
/// assert_eq!(*phases.0.lock().unwrap(), ["rendering"]);
/// ```
pub trait Progress: Sync {
    /// A phase begins, and the one before has ended. `steps` is the number of its equal steps,
    /// where it is known.
    fn begin(&self, phase: &str, steps: Option<usize>) {
        let _ = (phase, steps);
    }

    /// So many more steps of the phase are done.
    fn advance(&self, steps: usize) {
        let _ = steps;
    }

    /// Work goes on within a step, or a phase whose steps are not counted; called often.
    fn pulse(&self) {}
}

/// Shows nothing.
impl Progress for () {}

/// One phase of the whole work, whatever phases are reported within it.
pub struct OnePhase<'a>(&'a dyn Progress);

impl<'a> OnePhase<'a> {
    /// Begins it.
    pub fn begun(progress: &'a dyn Progress, phase: &str, steps: usize) -> Self {
        progress.begin(phase, Some(steps));
        Self(progress)
    }
}

impl Progress for OnePhase<'_> {
    fn advance(&self, steps: usize) {
        self.0.advance(steps);
    }

    fn pulse(&self) {
        self.0.pulse();
    }
}
