//! Whether the camera's depth of field covers the sample, said before a capture.

use super::CliError;
use crate::calibration::depth_of_field::{self, DepthOfField};
use crate::calibration::slanted_edge::FocusValues;
use crate::config::RigConfig;

/// The sample's blur on a rig, by its record of focus where there is one. `None` where
/// no aperture is known or the camera does not see the sample.
pub(super) fn of_rig(
    config: &RigConfig,
    focus: Option<&FocusValues>,
) -> Result<Option<DepthOfField>, CliError> {
    let mut geometry = config.geometry.clone();
    if let Some(focus) = focus {
        focus.apply(&mut geometry);
    }
    if geometry.camera.object_na <= 0.0 {
        return Ok(None);
    }
    let scene = geometry.scene(&[])?;
    let limit_px = config.capture.blur_limit_px;
    Ok(depth_of_field::over_sample(&scene, limit_px))
}

/// What there is to say against it; `None` where the whole sample is sharp enough.
pub(super) fn concern(found: &DepthOfField, limit_px: f64) -> Option<String> {
    if found.worst.disc_px <= limit_px {
        return None;
    }
    let sharp = found.sharp_mm.map_or(String::new(), |[low, high]| {
        format!("; only heights from {low:.2} to {high:.2} mm are blurred by less")
    });
    Some(format!(
        "depth of field: {}, which is above {limit_px} px on {:.0}% of it{sharp}",
        ends(found),
        100.0 * found.beyond,
    ))
}

/// The remedy.
pub(super) const REMEDY: &str = "stop the lens down, or focus on the middle of the sample's depth \
    and measure that with `rig calibrate focus`: fits include the blur, but it hides detail";

/// The blur at both ends of the sample's depth.
pub(super) fn ends(found: &DepthOfField) -> String {
    let [low, high] = found.ends;
    format!(
        "the sample is blurred by {:.2} px at {:.2} mm and by {:.2} px at {:.2} mm",
        low.disc_px, low.height_mm, high.disc_px, high.height_mm
    )
}
