//! A camera's calibration as a figure: the positions of the corners, and their residuals.

use super::{CameraFit, Residual};
use crate::plot::{Axis, Chart, Figure, Mark, Series, charts};

/// The corners in an image of `resolution_px`, their residuals, and the radial residuals against the
/// distance from the image's middle.
pub fn figure(fit: &CameraFit, resolution_px: [usize; 2]) -> Figure {
    let [width, height] = resolution_px.map(|n| n as f64);
    let of = |used: bool| fit.residuals.iter().filter(move |r| r.used == used);
    let both = |at: &dyn Fn(&Residual) -> [f64; 2]| {
        [(true, 0, "in the fit"), (false, 1, "left out")]
            .map(|(used, color, label)| {
                Series::new(label, color, Mark::Dots, of(used).map(at).collect())
            })
            .to_vec()
    };
    let far = of(true).map(|r| r.off_px.abs().max_element());
    let far = 1.1 * far.fold(0.01, f64::max);
    let positions = Chart {
        title: format!("{} views of the board", fit.views),
        x: Axis::linear(0.0..width, "column (px)"),
        y: Axis::linear(0.0..height, "row from below (px)"),
        // Row 0 is the top.
        series: both(&|r| [r.at_px.x, height - r.at_px.y]),
    };
    let clamped = |v: f64| v.clamp(-far, far);
    let residuals = Chart {
        title: format!("Residuals: {:.3} px (rms)", fit.rms_px),
        x: Axis::linear(-far..far, "across (px)"),
        y: Axis::linear(-far..far, "down (px)"),
        series: both(&|r| [clamped(r.off_px.x), clamped(r.off_px.y)]),
    };
    let middle = 0.5 * glam::DVec2::new(width, height);
    let radial = Chart {
        title: "Radial residual".to_owned(),
        x: Axis::linear(0.0..middle.length(), "distance from the middle (px)"),
        y: Axis::linear(-far..far, "outwards (px)"),
        series: both(&|r| {
            let from = r.at_px - middle;
            [
                from.length(),
                clamped(r.off_px.dot(from.normalize_or_zero())),
            ]
        }),
    };
    charts("camera", 3, &[positions, residuals, radial])
}
