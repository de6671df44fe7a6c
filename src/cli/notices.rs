//! What a workflow reports, at the terminal: the fact, and what to do about it.

use super::{Context, preflight};
use crate::progress::Progress;
use crate::workflow::{Notice, Observer};

/// Shows no progress.
impl Progress for Context {}

impl Observer for Context {
    fn notice(&self, notice: Notice<'_>) {
        use Notice::*;
        match notice {
            // Of every sound fit; the report and the fit's record state the discrepancy.
            Work(_) | Discrepancy { .. } => tracing::info!("{notice}"),
            ByRecord { .. } | AssumedNoise { .. } | HomingCycle { .. } => self.note(notice),
            ScaleAsDescribed => self.note(format_args!(
                "{notice}; `rig calibrate white` measures it; where it is unknown, \
                 --refine-bench --uncertainty common_intensity=1 allows for that"
            )),
            UnusableLens { .. } | OfScene(_) | Remark(_) => self.warn(notice),
            UnmeasuredDirections { .. } => self.warn(format_args!(
                "{notice}; run `rig calibrate lights` with all of them"
            )),
            UnmeasuredIntensities { .. } => self.warn(format_args!(
                "{notice}; run `rig calibrate white SESSION` with all of them"
            )),
            ImageOrder { .. } => self.warn(format_args!(
                "{notice}; name the images in the order of the scene's lights \
                 (a shell's pattern puts 10 before 2; 02 comes before 10)"
            )),
            Scene(concern) => {
                self.warn(format_args!("{notice}; {}", preflight::remedy_of(concern)))
            }
        }
    }
}
