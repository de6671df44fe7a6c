//! A pose as a figure: where edges were compared, and the residual shift of each patch.

use super::{PoseEstimate, ResidualShift};
use crate::plot::{Axis, Chart, Figure, Mark, Series, charts};

/// Shifts, in pixels, above which patches have another colour.
const CLASSES_PX: [f64; 2] = [0.1, 0.3];

/// The patches in the image of `resolution_px`, and their shifts with error bars.
pub fn figure(found: &PoseEstimate, resolution_px: [usize; 2]) -> Figure {
    let [width, height] = resolution_px.map(|n| n as f64);
    let class = |s: &ResidualShift| {
        CLASSES_PX
            .iter()
            .filter(|px| s.shift_px.abs() > **px)
            .count()
    };
    let labels = [
        format!("within {} px", CLASSES_PX[0]),
        format!("within {} px", CLASSES_PX[1]),
        format!("beyond {} px", CLASSES_PX[1]),
    ];
    let of = |wanted: usize| {
        found
            .shifts
            .iter()
            .enumerate()
            .filter(move |(_, s)| class(s) == wanted)
    };
    let positions = (0..3).map(|k| {
        // Row 0 is the top.
        let points = of(k)
            .map(|(_, s)| [s.at_px[0], height - s.at_px[1]])
            .collect();
        Series::new(&labels[k], k, Mark::Dots, points)
    });
    let positions = Chart {
        title: "Where edges were compared".to_owned(),
        x: Axis::linear(0.0..width, "column (px)"),
        y: Axis::linear(0.0..height, "row from below (px)"),
        series: positions.collect(),
    };
    let far = found.shifts.iter().map(|s| s.shift_px.abs() + s.std_px);
    let far = 1.1 * far.fold(0.1, f64::max).min(2.0);
    let count = found.shifts.len() as f64;
    let shifts = (0..3).map(|k| {
        let points = of(k)
            .map(|(i, s)| [i as f64, s.shift_px.clamp(-far, far)])
            .collect();
        let bars = of(k).map(|(i, s)| {
            let [low, high] = [-1.0, 1.0].map(|d| (s.shift_px + d * s.std_px).clamp(-far, far));
            [i as f64, low, high]
        });
        Series::new(&labels[k], k, Mark::Dots, points).within(bars.collect())
    });
    let shifts = Chart {
        title: "Residual shift".to_owned(),
        x: Axis::linear(-1.0..count, "patch"),
        y: Axis::linear(-far..far, "shift (px)"),
        series: shifts.collect(),
    };
    charts("pose", 2, &[positions, shifts])
}
