//! What makes a scene unfit to be measured.

use std::fmt;

use super::view::SurfaceSpec;
use crate::transport::visibility::{Concern, Visibility};

/// Which kind of file describes a scene, and so what its keys are called.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DescribedIn {
    /// A rig file, or the session captured with it.
    Rig,
    /// A scene file.
    Scene,
}

/// What makes a scene unfit to be measured, or hard to measure.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneConcern {
    /// The fact.
    pub concern: Concern,
    /// What camera and lights see of the sample.
    pub seen: Visibility,
    /// Where it is described.
    pub file: DescribedIn,
    /// The sample's surface as described.
    pub surface: SurfaceSpec,
}

impl SceneConcern {
    /// All of a scene that was seen like this, the fatal ones first.
    pub fn all(seen: &Visibility, file: DescribedIn, surface: &SurfaceSpec) -> Vec<Self> {
        let concerns = seen.concerns().into_iter();
        concerns
            .map(|concern| Self {
                concern,
                seen: seen.clone(),
                file,
                surface: surface.clone(),
            })
            .collect()
    }
}

impl fmt::Display for SceneConcern {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.concern {
            Concern::Unlit { .. } => self.concern.fmt(out),
            _ => write!(out, "{}; {}", self.concern, extent_in_image(&self.seen)),
        }
    }
}

impl std::error::Error for SceneConcern {}

/// The sample's box, in millimetres and in the image, and the field of view.
pub fn extent_in_image(seen: &Visibility) -> String {
    let [low, high] = seen.bounds_mm;
    let size = high - low;
    let [width, height] = seen.resolution_px;
    let in_image = match seen.projected_px {
        Some([from, to]) => format!(
            "columns {:.0} to {:.0} and rows {:.0} to {:.0} of {width} × {height} px",
            from.x, to.x, from.y, to.y
        ),
        None => format!(
            "no position: a part of it is behind the camera, whose image has {width} × {height} px"
        ),
    };
    format!(
        "its box of {} × {} × {} mm (x {} to {}, y {} to {}, z {} to {}) appears at {in_image}, the field of view is {} × {} mm",
        millimetres(size.x),
        millimetres(size.y),
        millimetres(size.z),
        millimetres(low.x),
        millimetres(high.x),
        millimetres(low.y),
        millimetres(high.y),
        millimetres(low.z),
        millimetres(high.z),
        millimetres(seen.field_mm.x),
        millimetres(seen.field_mm.y),
    )
}

/// A length with about three digits.
pub fn millimetres(length: f64) -> String {
    let digits = match length.abs() {
        1e-6..0.1 => 4,
        0.1..1.0 => 2,
        _ => 1,
    };
    // No negative zero.
    format!("{:.digits$}", length + 0.0)
}
