//! Advice on the camera's depth of field over the sample.

use crate::calibration::depth_of_field::DepthOfField;

/// How much of the sample is blurred by more than the limit.
pub(super) fn concern(found: &DepthOfField, limit_px: f64) -> String {
    let sharp = found.sharp_mm.map_or(String::new(), |[low, high]| {
        format!("; only heights from {low:.2} to {high:.2} mm are blurred by less")
    });
    format!(
        "depth of field: {}, which is above {limit_px} px on {:.0}% of it{sharp}",
        ends(found),
        100.0 * found.beyond,
    )
}

/// The remedy.
pub(super) const REMEDY: &str = "stop the lens down, or focus on the middle of the sample's depth \
    and measure that with `rig calibrate focus`: fits include the blur, but it hides detail";

/// The blur at both ends of the sample's depth.
pub(super) fn ends(found: &DepthOfField) -> String {
    let [low, high] = found.ends;
    // Before a tilted camera, nearest and farthest point are neither the lowest nor the highest.
    let between = match found.worst.disc_px > 1.05 * low.disc_px.max(high.disc_px) {
        true => format!(", and by up to {:.2} px elsewhere", found.worst.disc_px),
        false => String::new(),
    };
    format!(
        "the sample is blurred by {:.2} px at {:.2} mm and by {:.2} px at {:.2} mm{between}",
        low.disc_px, low.height_mm, high.disc_px, high.height_mm
    )
}
