//! Edges and their fit as a figure.

use super::fit::Fitted;
use super::locate::Edge;
use crate::plot::{Axis, Chart, Figure, Mark, Series, charts};

/// Most pixels of an edge that are drawn.
const DOTS: usize = 300;
/// Most edges whose profiles are drawn.
const PROFILES: usize = 3;

/// Each edge's profile with its fit, and the blur's width over height.
pub fn figure(edges: &[Edge], found: &Fitted) -> Figure {
    let mut profiles = Vec::new();
    let mut reach = 1.0f64;
    for (i, (edge, fit)) in edges.iter().zip(&found.edges).enumerate() {
        // The first, the last and one between, in the order given.
        let chosen = edges.len() <= PROFILES || [0, edges.len() / 2, edges.len() - 1].contains(&i);
        if !chosen {
            continue;
        }
        reach = reach.max(edge.reach_px);
        let color = profiles.len() / 2;
        let label = format!("{} mm", edge.height_mm);
        let step = fit.measured.len().div_ceil(DOTS).max(1);
        let dots = fit.measured.iter().step_by(step).copied().collect();
        profiles.push(Series::new(&label, color, Mark::Dots, dots));
        profiles.push(Series::new("fit", color, Mark::Line, fit.fitted.clone()));
    }
    let spread = Chart {
        title: "Edge-spread function".to_owned(),
        x: Axis::linear(-reach..reach, "distance from the edge (px)"),
        y: Axis::linear(-0.15..1.15, "radiance, dark 0 to bright 1"),
        series: profiles,
    };
    let heights = || edges.iter().map(|e| e.height_mm);
    let (low, high) = (
        heights().fold(f64::INFINITY, f64::min),
        heights().fold(f64::NEG_INFINITY, f64::max),
    );
    let margin = 0.1 * (high - low).max(1.0);
    let widths = || edges.iter().zip(&found.edges);
    let top = widths().map(|(_, f)| f.width_px[0] + f.width_px[1]);
    let top = 1.2 * top.fold(0.5, f64::max);
    let points = widths().map(|(e, f)| [e.height_mm, f.width_px[0]]);
    let bars = widths().map(|(e, f)| {
        let [width, std] = f.width_px;
        [e.height_mm, width - std, width + std]
    });
    let measured = Series::new("each edge by itself", 0, Mark::Dots, points.collect());
    let mut series = vec![measured.within(bars.collect())];
    if found.defocus {
        let curve =
            (0..=60).map(|i| low - margin + (high - low + 2.0 * margin) * f64::from(i) / 60.0);
        let curve = curve.map(|height| [height, model(edges, found, height)]);
        series.push(Series::new(
            "one lens for all",
            1,
            Mark::Line,
            curve.collect(),
        ));
    }
    let width = Chart {
        title: "Width of the blur".to_owned(),
        x: Axis::linear(low - margin..high + margin, "height above the datum (mm)"),
        y: Axis::linear(0.0..top, "standard deviation (px)"),
        series,
    };
    charts("slanted-edge", 2, &[spread, width])
}

/// Width of the Gaussian with the variance of point spread and disc, at a height between
/// or beyond the edges.
fn model(edges: &[Edge], found: &Fitted, height_mm: f64) -> f64 {
    let n = edges.len() as f64;
    let mean = |of: &dyn Fn(&Edge) -> f64| edges.iter().map(of).sum::<f64>() / n;
    let (height, depth) = (mean(&|e| e.height_mm), mean(&|e| e.depth_mm));
    let both = mean(&|e| (e.height_mm - height) * (e.depth_mm - depth));
    let own = mean(&|e| (e.height_mm - height).powi(2));
    let depth_mm = depth + both / own.max(f64::MIN_POSITIVE) * (height_mm - height);
    let scale = mean(&|e| e.px_per_mm);
    let off_px = (depth_mm - found.lens.focus_mm) * scale;
    (found.lens.spread_px2 + 0.25 * found.lens.tangent2 * off_px * off_px).sqrt()
}
