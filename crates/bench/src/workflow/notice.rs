//! What a workflow reports while it runs.

use std::fmt;

use super::{FitWork, UNSTATED_NOISE};
use crate::config::scene_concern::SceneConcern;
use crate::progress::Progress;

/// A fact that is worth knowing before the result is there.
#[derive(Clone, Copy, Debug)]
#[allow(missing_docs)]
pub enum Notice<'a> {
    /// The bench is taken from a calibration record, not from the rig file.
    ByRecord {
        /// What the record measured, such as `irradiance`.
        what: &'static str,
        id: &'a str,
    },
    /// The lens of a record cannot be used.
    UnusableLens { id: &'a str, fact: &'a str },
    /// A record of light directions lacks some of the lights.
    UnmeasuredDirections {
        id: &'a str,
        /// Lights without a measured direction.
        lights: usize,
        /// All lights.
        of: usize,
    },
    /// A record of the irradiance lacks some of the lights.
    UnmeasuredIntensities {
        /// Lights without a measured intensity.
        lights: usize,
        /// All lights.
        of: usize,
    },
    /// The irradiance is only as stated in the rig file.
    ScaleAsDescribed,
    /// A defect of the scene's files that was left out, such as a degenerate facet.
    OfScene(&'a str),
    /// Something of the scene makes it hard to measure.
    Scene(&'a SceneConcern),
    /// An image states no variance.
    AssumedNoise { file: &'a str },
    /// Images whose names carry numbers that are not in order.
    ImageOrder {
        /// The names, in the order in which the images are taken for the lights'.
        given: &'a str,
    },
    /// A fact that the fit's record keeps among its remarks.
    Remark(&'a str),
    /// A cycle of repeated homing is done.
    HomingCycle {
        /// From 1.
        cycle: u32,
        /// All cycles.
        of: u32,
        /// Position found minus expected, of both axes, degrees or mm.
        off: [f64; 2],
    },
    /// How much the fit is going to do.
    Work(FitWork),
    /// The material differs from every mixture of the dictionary.
    Discrepancy {
        dictionary: &'a str,
        /// How much, in units of what measured materials usually do.
        amplitude: f64,
    },
}

impl fmt::Display for Notice<'_> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        use Notice::*;
        match *self {
            ByRecord { what, id } => write!(out, "{what} by record {id}"),
            UnusableLens { id, fact } => write!(out, "record {id}: {fact}"),
            UnmeasuredDirections { id, lights, of } => write!(
                out,
                "record {id} has no direction of {lights} of {of} lights: those of the rig file are used"
            ),
            UnmeasuredIntensities { lights, of } => write!(
                out,
                "intensities of {lights} of {of} lights were not measured: they count as the mean of the others"
            ),
            ScaleAsDescribed => out.write_str(
                "no record of the irradiance: the BRDF's scale, its albedo, is as good as irradiance_w_m2 in the rig file",
            ),
            OfScene(text) | Remark(text) => out.write_str(text),
            Scene(concern) => concern.fmt(out),
            AssumedNoise { file } => write!(
                out,
                "{file}: no variance is stated; a relative noise of {UNSTATED_NOISE} is assumed"
            ),
            ImageOrder { given } => write!(
                out,
                "the numbers in the images' names are not in order: {given} are taken for lights 1, 2, …"
            ),
            HomingCycle { cycle, of, off } => write!(
                out,
                "cycle {cycle} of {of}: off by {:.4} and {:.4}",
                off[0], off[1]
            ),
            Work(work) => work.fmt(out),
            Discrepancy {
                dictionary,
                amplitude,
            } => write!(
                out,
                "the material differs from every mixture of {dictionary} by {amplitude:.1} times what measured materials usually do; table.csv and exports to merl, rgl and pbrt include this, weights and an export to mitsuba do not"
            ),
        }
    }
}

/// Receives the notices and the progress of a workflow; `()` ignores them.
pub trait Observer: Progress {
    /// A fact that is worth knowing now.
    fn notice(&self, notice: Notice<'_>) {
        let _ = notice;
    }

    /// So much of the whole work's time is over, 0 to 1, as far as that is known; of a fit it comes
    /// before each phase and at the end.
    fn part_over(&self, part: f64) {
        let _ = part;
    }
}

/// Ignores everything.
impl Observer for () {}
