//! Slices over the half angle at fixed difference angles.

use super::curve::{Curve, decades, pieces};
use super::lobes::line;
use super::{Channel, Named, Panels};
use crate::brdf::HalfDifference;
use crate::plot::{Axis, Chart, Figure, Series, charts};

/// f over θh at φd = 90° for each of these difference angles (degrees, 0..90), one column each.
pub fn slices(all: &[Named], difference_deg: &[f64], channels: &[Channel]) -> Figure {
    let panels = Panels::new(all, channels);
    let mut drawn: Vec<(String, Vec<Curve>)> = Vec::new();
    for row in 0..panels.rows.len() {
        for &theta_d_deg in difference_deg {
            let title = panels.title(row, &format!("difference angle θd = {theta_d_deg}°"));
            let curves = panels.curves(row).map(|(named, channel, color)| {
                (color, pieces(named, channel, over_half_angles(theta_d_deg)))
            });
            drawn.push((title, curves.collect()));
        }
    }
    let scale = decades(drawn.iter().flat_map(|d| d.1.iter().flat_map(|c| &c.1)));
    let legend = panels.legend();
    let chart = |(n, (title, curves)): (usize, &(String, Vec<Curve>))| {
        let lines = curves.iter();
        let lines =
            lines.flat_map(|(color, pieces)| pieces.iter().map(|piece| line(*color, piece)));
        let mut series: Vec<Series> = lines.collect();
        if n == 0 {
            series.extend(legend.iter().cloned());
        }
        Chart {
            title: title.clone(),
            x: Axis::half_angles("half angle θh"),
            y: Axis::decades(scale.clone(), "f / sr⁻¹"),
            series,
        }
    };
    let charted: Vec<Chart> = drawn.iter().enumerate().map(chart).collect();
    charts("slices", difference_deg.len().min(3), &charted)
}

/// Positions on the axis with the angles there; 90° itself lies on the horizon.
fn over_half_angles(theta_d_deg: f64) -> impl Iterator<Item = (f64, HalfDifference)> {
    (0..240).map(move |n| {
        let theta_h_deg = 90.0 * (f64::from(n) / 240.0).powi(2);
        let angles = HalfDifference {
            theta_h_rad: theta_h_deg.to_radians(),
            theta_d_rad: theta_d_deg.to_radians(),
            phi_d_rad: std::f64::consts::FRAC_PI_2,
        };
        (Axis::half_angle(theta_h_deg), angles)
    })
}
