//! f in the plane of incidence, over a half disc.

use std::ops::Range;

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, VPos};

use super::power_of_ten;
use super::{GRID, MUTED, PlotError, TEXT, UNITS, dashes, draw, stroke, text_style};

/// One channel of a polar plot: angle from the normal in degrees (negative on
/// the light's side) and log10 of the value; the band likewise.
#[derive(Clone, Debug)]
pub struct Lobe {
    /// A placeholder such as one of [`CHANNELS`].
    pub color: RGBColor,
    /// (angle in degrees, log10 f).
    pub estimate: Vec<(f64, f64)>,
    /// (angle in degrees, log10 lower, log10 upper).
    pub band: Vec<(f64, f64, f64)>,
    /// (angle in degrees, log10 f), where the truth is known.
    pub truth: Option<Vec<(f64, f64)>>,
}

/// f in the plane of incidence over a half disc, radius logarithmic over
/// `decades` (powers of ten). The light comes from the left at `theta_i_deg`.
pub fn polar(
    title: &str,
    theta_i_deg: f64,
    decades: Range<f64>,
    lobes: &[Lobe],
) -> Result<String, PlotError> {
    let radius = |log_value: f64| {
        ((log_value - decades.start) / (decades.end - decades.start)).clamp(0.0, 1.0)
    };
    let at = |(angle_deg, log_value): (f64, f64)| {
        let (sin, cos) = angle_deg.to_radians().sin_cos();
        (radius(log_value) * sin, radius(log_value) * cos)
    };
    let rim = |angle_deg: f64, r: f64| {
        let (sin, cos) = angle_deg.to_radians().sin_cos();
        (r * sin, r * cos)
    };
    draw((360, 228), title, |root| {
        let mut chart = ChartBuilder::on(root)
            .margin(2 * UNITS)
            .build_cartesian_2d(-1.2..1.2, -0.26..1.26)?;
        let arc = |r: f64| (-90..=90).step_by(3).map(move |deg| rim(f64::from(deg), r));
        let exponents = (decades.start.ceil() as i32)..=(decades.end.floor() as i32);
        let stride = ((decades.end - decades.start) / 5.0).ceil().max(1.0) as usize;
        for exponent in exponents.step_by(stride) {
            let r = radius(f64::from(exponent));
            if r > 0.0 {
                chart.draw_series(LineSeries::new(arc(r), stroke(GRID, 1.0)))?;
            }
            let style = text_style(MUTED, HPos::Center, VPos::Top);
            for x in if r > 0.0 { vec![r, -r] } else { vec![r] } {
                let text = power_of_ten(exponent);
                chart.draw_series([Text::new(text, (x, -0.04), style.clone())])?;
            }
        }
        for angle_deg in [-90.0, -60.0, -30.0, 0.0, 30.0, 60.0, 90.0f64] {
            let spoke = [(0.0, 0.0), rim(angle_deg, 1.0)];
            chart.draw_series(LineSeries::new(spoke, stroke(GRID, 1.0)))?;
            if angle_deg.abs() < 90.0 {
                let text = format!("{angle_deg}°").replace('-', "−");
                let style = text_style(MUTED, HPos::Center, VPos::Center);
                chart.draw_series([Text::new(text, rim(angle_deg, 1.13), style)])?;
            }
        }
        for lobe in lobes {
            let lower = lobe.band.iter().map(|(angle, low, _)| at((*angle, *low)));
            let upper = lobe
                .band
                .iter()
                .rev()
                .map(|(angle, _, high)| at((*angle, *high)));
            let outline: Vec<_> = lower.chain(upper).collect();
            if !outline.is_empty() {
                chart.draw_series([Polygon::new(outline, lobe.color.mix(0.16))])?;
            }
        }
        for lobe in lobes {
            let points = lobe.estimate.iter().copied().map(at);
            chart.draw_series(LineSeries::new(points, stroke(lobe.color, 1.75)))?;
            if let Some(truth) = &lobe.truth {
                let points = truth.iter().copied().map(at);
                chart.draw_series(dashes(points, stroke(lobe.color, 1.5)))?;
            }
        }
        // The incoming light: an arrow that ends at the surface.
        let (tail, tip) = (rim(-theta_i_deg, 0.96), rim(-theta_i_deg, 0.02));
        chart.draw_series(LineSeries::new([tail, tip], stroke(TEXT, 1.5)))?;
        let barb = |side: f64| {
            let (dx, dy) = rim(-theta_i_deg + side, 0.07);
            [(tip.0 + dx, tip.1 + dy), tip]
        };
        for side in [-22.0, 22.0] {
            chart.draw_series(LineSeries::new(barb(side), stroke(TEXT, 1.5)))?;
        }
        Ok(())
    })
}
