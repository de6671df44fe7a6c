//! Lobes in the plane of incidence.

use glam::DVec3;

use super::curve::{Curve, Piece, decades, pieces};
use super::{Channel, Named, Panels};
use crate::brdf::HalfDifference;
use crate::plot::{Axis, Chart, Figure, Lobe, Mark, NEUTRAL, PolarPanel, Series, charts, polars};

/// How a lobe is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axes {
    /// Over a half disc, as light leaves the surface.
    Polar,
    /// Over the angle from the normal, where values can be read.
    Cartesian,
}

/// f in the plane of incidence for light at each of these angles (degrees, 0..90), one column
/// each; the light comes from the left.
pub fn lobes(all: &[Named], incidence_deg: &[f64], channels: &[Channel], axes: Axes) -> Figure {
    let panels = Panels::new(all, channels);
    // Every curve of every panel, in rows of angles.
    let mut drawn: Vec<(String, f64, Vec<Curve>)> = Vec::new();
    for row in 0..panels.rows.len() {
        for &theta_i_deg in incidence_deg {
            let title = panels.title(row, &format!("light at θi = {theta_i_deg}°"));
            let curves = panels.curves(row).map(|(named, channel, color)| {
                let line = plane_of_incidence(theta_i_deg);
                (color, pieces(named, channel, line))
            });
            drawn.push((title, theta_i_deg, curves.collect()));
        }
    }
    let scale = decades(drawn.iter().flat_map(|d| d.2.iter().flat_map(|c| &c.1)));
    let columns = incidence_deg.len().min(3);
    match axes {
        Axes::Polar => {
            // The darkest values are not at the centre, where curves cannot be distinguished.
            let scale = scale.start - 0.2 * (scale.end - scale.start)..scale.end;
            let polar = drawn.iter().map(|(title, theta_i_deg, curves)| PolarPanel {
                title: title.clone(),
                theta_i_deg: *theta_i_deg,
                lobes: curves
                    .iter()
                    .flat_map(|(color, pieces)| pieces.iter().map(|piece| lobe(*color, piece)))
                    .collect(),
            });
            let polar: Vec<_> = polar.collect();
            polars("lobes", columns, scale, &polar, &panels.legend())
        }
        Axes::Cartesian => {
            let legend = panels.legend();
            let chart = |(n, (title, theta_i_deg, curves)): (usize, &(String, f64, Vec<_>))| {
                let mut series: Vec<Series> = curves
                    .iter()
                    .flat_map(|(color, pieces): &Curve| {
                        pieces.iter().map(|piece| line(*color, piece))
                    })
                    .collect();
                // Where the mirror direction is.
                let mirror = [*theta_i_deg, *theta_i_deg];
                let mirror = [[mirror[0], scale.start], [mirror[1], scale.end]];
                series.push(Series::new(
                    "mirror direction",
                    7,
                    Mark::Dashed,
                    mirror.into(),
                ));
                if n == 0 {
                    series.extend(legend.iter().cloned());
                }
                Chart {
                    title: title.clone(),
                    x: Axis::with_step(-90.0..90.0, 30.0, "viewer, degrees from the normal"),
                    y: Axis::decades(scale.clone(), "f / sr⁻¹"),
                    series,
                }
            };
            let charted: Vec<Chart> = drawn.iter().enumerate().map(chart).collect();
            charts("lobes", columns, &charted)
        }
    }
}

/// Viewer's angles from the normal (degrees, negative on the light's side) with the angles of
/// the table there; finer around the mirror direction.
fn plane_of_incidence(theta_i_deg: f64) -> impl Iterator<Item = (f64, HalfDifference)> {
    let coarse = (-179..=179).map(|n| 0.5 * f64::from(n));
    let fine = (-100..=100).map(move |n| theta_i_deg + 0.05 * f64::from(n));
    let mut angles: Vec<f64> = coarse.chain(fine.filter(|deg| deg.abs() < 89.6)).collect();
    angles.sort_by(f64::total_cmp);
    angles.dedup_by(|a, b| (*a - *b).abs() < 1e-6);
    let to_light = in_plane(-theta_i_deg);
    angles.into_iter().map(move |deg| {
        (
            deg,
            HalfDifference::from_directions(to_light, in_plane(deg)),
        )
    })
}

fn in_plane(angle_deg: f64) -> DVec3 {
    let (sin, cos) = angle_deg.to_radians().sin_cos();
    DVec3::new(sin, 0.0, cos)
}

fn lobe(color: usize, piece: &Piece) -> Lobe {
    Lobe {
        color: if piece.constrained { color } else { NEUTRAL },
        estimate: piece.points.iter().map(|&[x, y]| (x, y)).collect(),
        band: piece
            .band
            .iter()
            .map(|&[x, low, high]| (x, low, high))
            .collect(),
        truth: None,
    }
}

/// Shared with the slices.
pub(super) fn line(color: usize, piece: &Piece) -> Series {
    let color = if piece.constrained { color } else { NEUTRAL };
    Series::new("", color, Mark::Line, piece.points.clone()).within(piece.band.clone())
}
