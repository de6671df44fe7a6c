//! Point spread, focus and aperture by slanted edges at four heights.

use super::{EvaluateError, Recovered, failed};
use crate::calibration::mirror_sphere::Grey;
use crate::calibration::slanted_edge::{Edge, FocusValues, Lens, fit_edges, locate};
use crate::simulation::edge::{SIDE, noisy, photograph, telecentric};

const HEIGHTS_MM: [f64; 4] = [-6.0, -2.0, 1.0, 4.0];

/// One lens.
pub(super) fn focus(seed: u64) -> Result<Vec<Recovered>, EvaluateError> {
    let camera = telecentric();
    let mut edges: Vec<Edge> = Vec::new();
    for (index, height_mm) in HEIGHTS_MM.into_iter().enumerate() {
        // Other places of the edge among the pixels on every bench.
        let tilt_rad = 0.1 + 0.02 * ((7 * seed + index as u64) % 10) as f64;
        let truth = photograph(&camera, height_mm, tilt_rad);
        let (value, variance) = noisy(&truth, 100 * seed + index as u64);
        let image = Grey {
            width: SIDE,
            height: SIDE,
            valid: vec![true; value.len()],
            value,
            variance,
        };
        edges.push(locate(index, &image, None, &camera, height_mm).map_err(failed)?);
    }
    let start = Lens {
        spread_px2: 0.25,
        focus_mm: camera.focus_mm + 1.0,
        tangent2: 1e-4,
    };
    let found = fit_edges(&edges, start).map_err(failed)?;
    let values = FocusValues::new(&edges, &found, 1, 0.0);
    let lens = values.lens.ok_or_else(|| failed("no lens was found"))?;
    let one = |quantity, unit, truth, found| Recovered {
        quantity,
        unit,
        truth,
        found,
    };
    let spread = values.point_spread_px;
    Ok(vec![
        one(
            "point spread in focus",
            "px",
            camera.point_spread_px,
            spread,
        ),
        one(
            "distance of the focus",
            "mm",
            camera.focus_mm,
            lens.focus_mm,
        ),
        one("numerical aperture", "", camera.object_na, lens.object_na),
    ])
}
