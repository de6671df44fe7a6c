//! From a fit to its figures: which curves, at which angles, on which scales.

use glam::Vec3;

use super::map_scale::MapScale;
use crate::brdf::Brdf;
use crate::plot::colors::{diverging, sequential};
use crate::plot::{
    Axis, Bar, BarRow, Chart, HeatMap, HeatMaps, Lobe, Mark, Picture, PlotError, Series, bars,
    chart, heat_maps, polar,
};
use crate::session::fit_record::lookup::{SMALLEST, nearest_index};
use crate::session::fit_record::{AngleTable, FitRecord, Interval, TracePoint};

/// Angles of incidence of the polar plots, degrees from the normal.
pub const POLAR_THETA_I_DEG: [f64; 3] = [0.0, 30.0, 60.0];
/// Difference angles of the slices, degrees; the nearest of the table are taken.
const SLICE_THETA_D_DEG: [f64; 3] = [5.0, 45.0, 75.0];
/// Colours of the channels R, G, B in the palette, and of what belongs to no channel.
const CHANNELS: [usize; 3] = [1, 2, 0];
const NO_CHANNEL: usize = 3;
const BLACK: usize = 7;
/// Width and height of a figure that has a row to share, and of one that has half a row,
/// CSS pixels.
const THIRD_PX: [f64; 2] = [352.0, 256.0];
const HALF_PX: [f64; 2] = [500.0, 280.0];
/// Logarithmic scales show at most so many powers of ten below the largest value.
const MOST_DECADES: f64 = 4.0;

fn log(value: f64) -> f64 {
    value.max(SMALLEST).log10()
}

/// Whole powers of ten around the values, at most [`MOST_DECADES`] of them.
fn decades(log_values: impl Iterator<Item = f64>) -> std::ops::Range<f64> {
    let (low, high) = log_values
        .filter(|value| value.is_finite())
        .fold((f64::MAX, f64::MIN), |(low, high), x| {
            (low.min(x), high.max(x))
        });
    if low > high {
        return -3.0..0.0;
    }
    let end = (high - 0.02).floor() + 1.0;
    let start = low.floor().max(end - MOST_DECADES).min(end - 2.0);
    start..end
}

/// Directions of light and viewer at (θh, θd) and φd = 90°, local frame.
pub fn directions_at(theta_h_deg: f64, theta_d_deg: f64) -> (Vec3, Vec3) {
    let (sin_h, cos_h) = theta_h_deg.to_radians().sin_cos();
    let (sin_d, cos_d) = theta_d_deg.to_radians().sin_cos();
    let along = |side: f64| {
        Vec3::new(
            (sin_h * cos_d) as f32,
            (side * sin_d) as f32,
            (cos_h * cos_d) as f32,
        )
    };
    (along(1.0), along(-1.0))
}

/// One figure per angle of [`POLAR_THETA_I_DEG`], all on the same scale.
pub fn polar_plots(
    estimate: &dyn Brdf,
    truth: Option<&dyn Brdf>,
    table: &AngleTable,
) -> Result<Vec<String>, PlotError> {
    let sample = |brdf: &dyn Brdf, theta_i_deg: f64| -> Vec<(f64, [f64; 3])> {
        let (sin, cos) = theta_i_deg.to_radians().sin_cos();
        let to_light = Vec3::new(-sin as f32, 0.0, cos as f32);
        let half_degrees = -179..=179;
        half_degrees
            .map(|n| {
                let angle_deg = f64::from(n) / 2.0;
                let (sin, cos) = angle_deg.to_radians().sin_cos();
                let value = brdf.eval(to_light, Vec3::new(sin as f32, 0.0, cos as f32));
                (angle_deg, value.map(|x| log(f64::from(x))))
            })
            .collect()
    };
    let estimates = POLAR_THETA_I_DEG.map(|angle| sample(estimate, angle));
    let truths = truth.map(|brdf| POLAR_THETA_I_DEG.map(|angle| sample(brdf, angle)));
    let all = estimates.iter().chain(truths.iter().flatten());
    let highest = all
        .flatten()
        .flat_map(|(_, values)| *values)
        .fold(f64::MIN, f64::max);
    // The radius ends a little above the largest value; what is much darker is at the centre.
    let scale = highest + 0.1 - MOST_DECADES..highest + 0.1;
    POLAR_THETA_I_DEG
        .iter()
        .enumerate()
        .map(|(n, &theta_i_deg)| {
            let lobes: Vec<Lobe> = (0..3)
                .map(|c| {
                    let pick = |(angle, values): &(f64, [f64; 3])| (*angle, values[c]);
                    let band = estimates[n].iter().filter_map(|(angle, values)| {
                        // In the plane of incidence both half and difference angle are simple.
                        let theta_h_deg = (angle - theta_i_deg).abs() / 2.0;
                        let theta_d_deg = (angle + theta_i_deg).abs() / 2.0;
                        let [low, high] = table.relative_interval([theta_h_deg, theta_d_deg], c)?;
                        Some((*angle, values[c] + low, values[c] + high))
                    });
                    Lobe {
                        color: CHANNELS[c],
                        estimate: estimates[n].iter().map(pick).collect(),
                        band: band.collect(),
                        truth: truths.as_ref().map(|all| all[n].iter().map(pick).collect()),
                    }
                })
                .collect();
            let title = format!("BRDF in the plane of incidence, light at {theta_i_deg}°");
            polar("polar", theta_i_deg, scale.clone(), &lobes).inline(&title)
        })
        .collect()
}

/// f over θh at three difference angles, with interval and truth: (θd in degrees, figure).
pub fn slices(
    table: &AngleTable,
    truth: Option<&dyn Brdf>,
) -> Result<Vec<(f64, String)>, PlotError> {
    let mut columns: Vec<usize> = SLICE_THETA_D_DEG
        .iter()
        .filter_map(|angle| nearest_index(&table.theta_d_deg, *angle))
        .collect();
    columns.dedup();
    let rows = 0..table.theta_h_deg.len();
    let values = columns.iter().flat_map(|&j| {
        let cells = rows.clone().filter_map(move |i| table.cell(i, j));
        cells.flat_map(|cell| cell.value.map(log))
    });
    let scale = decades(values);
    columns
        .iter()
        .map(|&j| {
            let theta_d_deg = table.theta_d_deg[j];
            let x = |i: usize| Axis::half_angle(table.theta_h_deg[i]);
            let mut series = unconstrained_bands(table, j, &scale);
            for (c, color) in CHANNELS.into_iter().enumerate() {
                let cells = rows.clone().filter_map(|i| Some((x(i), table.cell(i, j)?)));
                let points = cells.clone().map(|(x, cell)| [x, log(cell.value[c])]);
                let interval = cells.map(|(x, cell)| [x, log(cell.lower[c]), log(cell.upper[c])]);
                let estimate = Series::new("", color, Mark::Line, points.collect());
                series.push(estimate.within(interval.collect()));
                if let Some(truth) = truth {
                    let fine = (0..=180).map(|n| f64::from(n).powi(2) / 360.0);
                    let last = table.theta_h_deg.last().copied().unwrap_or(0.0);
                    let points = fine.filter(|deg| *deg <= last).map(|deg| {
                        let (to_light, to_viewer) = directions_at(deg, theta_d_deg);
                        let value = truth.eval(to_light, to_viewer)[c];
                        [Axis::half_angle(deg), log(f64::from(value))]
                    });
                    series.push(Series::new("", color, Mark::Dashed, points.collect()));
                }
            }
            let title =
                format!("BRDF over the half angle at a difference angle of {theta_d_deg} degrees");
            let slice = Chart {
                title: String::new(),
                x: Axis::half_angles("half angle θh"),
                y: Axis::decades(scale.clone(), "f / sr⁻¹"),
                series,
            };
            let figure = chart("slice", THIRD_PX, &slice);
            Ok((theta_d_deg, figure.inline(&title)?))
        })
        .collect()
}

/// Shades the half angles of column `j` that the images don't constrain.
fn unconstrained_bands(table: &AngleTable, j: usize, scale: &std::ops::Range<f64>) -> Vec<Series> {
    let count = table.theta_h_deg.len();
    let edge = |i: usize| {
        let here = Axis::half_angle(table.theta_h_deg[i.min(count - 1)]);
        match i {
            0 => 0.0,
            i if i == count => 1.0,
            i => (Axis::half_angle(table.theta_h_deg[i - 1]) + here) / 2.0,
        }
    };
    let constrained = |i: usize| table.cell(i, j).is_none_or(|cell| cell.constrained);
    let rows: Vec<usize> = (0..count).collect();
    rows.chunk_by(|&a, &b| constrained(a) == constrained(b))
        .filter(|run| !constrained(run[0]))
        .map(|run| {
            let ends = [edge(run[0]), edge(run[run.len() - 1] + 1)];
            let band = ends.map(|x| [x, scale.start, scale.end]);
            Series::new("", BLACK, Mark::None, Vec::new()).within(band.into())
        })
        .collect()
}

/// The table as two maps: f, and the half-width of its interval relative to f;
/// both the mean of the channels, hatched where the images don't constrain them.
/// `None` without a table.
pub fn table_maps(table: &AngleTable) -> Result<Option<[String; 2]>, PlotError> {
    const SIDE_PX: usize = 270;
    if table.theta_h_deg.len() < 2 || table.theta_d_deg.len() < 2 {
        return Ok(None);
    }
    // What is mapped, and in which colours.
    let value = |cell: &Interval| log(cell.value.iter().sum::<f64>() / 3.0);
    let width = |cell: &Interval| {
        let relative =
            (0..3).map(|c| (cell.upper[c] - cell.lower[c]) / 2.0 / cell.value[c].max(SMALLEST));
        (relative.sum::<f64>() / 3.0).max(1e-9).log10()
    };
    let cell_at = |x: usize, y: usize| {
        let across = (x as f64 + 0.5) / SIDE_PX as f64;
        let theta_d_deg = 90.0 * (1.0 - (y as f64 + 0.5) / SIDE_PX as f64);
        let cell = table.nearest(90.0 * across * across, theta_d_deg);
        cell.filter(|cell| cell.constrained)
    };
    // A map with its axes.
    let map = |title: &str, label: &str, of: &dyn Fn(&Interval) -> f64| {
        let places = (0..SIDE_PX).flat_map(|y| (0..SIDE_PX).map(move |x| (x, y)));
        let scale = MapScale::new(places.filter_map(|(x, y)| cell_at(x, y).map(of)));
        let picture = Picture::from_fn(SIDE_PX, SIDE_PX, |x, y| match cell_at(x, y) {
            Some(cell) => {
                let [r, g, b] = sequential(scale.place(of(cell)) as f32);
                [r, g, b, 255]
            }
            _ if (x + y) % 8 < 2 => [140, 140, 140, 255],
            _ => [196, 196, 196, 255],
        });
        let map = HeatMap {
            title: String::new(),
            picture,
        };
        let maps = HeatMaps {
            columns: 1,
            cell_px: [330.0, 300.0],
            x: Axis::half_angles("half angle θh"),
            y: Axis::with_step(0.0..90.0, 15.0, "difference angle θd / °"),
            scale: scale.axis(label),
            colors: sequential,
            maps: &[map],
        };
        heat_maps("table", &maps).inline(title)
    };
    Ok(Some([
        map("BRDF over half and difference angle", "f / sr⁻¹", &value)?,
        map(
            "relative half-width of the 95% interval",
            "half-width / f",
            &width,
        )?,
    ]))
}

/// Atoms whose weight reaches this in some channel are drawn, the others counted.
pub const SHOWN_WEIGHT: f64 = 0.005;

/// The weights' bars, heaviest first, and how many atoms are too light to show.
pub fn weight_bars(record: &FitRecord) -> Result<(String, usize), PlotError> {
    let mut shown: Vec<(String, [f64; 3], usize)> = record
        .atoms
        .iter()
        .enumerate()
        .map(|(n, atom)| (atom.label(), [0, 1, 2].map(|c| record.weights[c][n]), n))
        .filter(|(_, weights, _)| weights.iter().any(|weight| *weight >= SHOWN_WEIGHT))
        .collect();
    let total = |weights: &[f64; 3]| weights.iter().sum::<f64>();
    shown.sort_by(|a, b| total(&b.1).total_cmp(&total(&a.1)));
    let mut longest = 0.05f64;
    let rows: Vec<BarRow> = shown
        .into_iter()
        .map(|(label, weights, n)| BarRow {
            label,
            bars: (0..3)
                .map(|c| {
                    let deviation = record.weight_deviations[c][n];
                    longest = longest.max(weights[c] + deviation);
                    Bar {
                        parts: vec![(weights[c], CHANNELS[c])],
                        deviation: Some(deviation),
                        note: String::new(),
                    }
                })
                .collect(),
        })
        .collect();
    let hidden = record.atoms.len() - rows.len();
    let x = Axis::linear(0.0..(longest * 1.04).min(1.1), "weight");
    let figure = bars("weights", &x, 34.0, &rows);
    Ok((figure.inline("mixture weights")?, hidden))
}

/// The loss over the steps; logarithmic if it falls by more than a factor of 20.
/// `None` for fewer than two steps.
pub fn trace_plot(trace: &[TracePoint]) -> Result<Option<String>, PlotError> {
    let (Some(last), true) = (trace.last(), trace.len() > 1) else {
        return Ok(None);
    };
    let (low, high) = trace
        .iter()
        .fold((f64::MAX, f64::MIN), |(low, high), point| {
            (low.min(point.loss), high.max(point.loss))
        });
    let logarithmic = low > 0.0 && high / low > 20.0;
    let y = if logarithmic {
        Axis::decades(low.log10().floor()..high.log10().ceil(), "loss")
    } else {
        let margin = ((high - low) * 0.06).max(high.abs() * 1e-6).max(1e-12);
        Axis::linear(low - margin..high + margin, "loss")
    };
    let height = |loss: f64| if logarithmic { loss.log10() } else { loss };
    let first = trace.first().map_or(0, |point| point.step) as f64;
    let x = Axis::linear(first..(last.step as f64).max(first + 1.0), "step");
    let points = trace.iter().map(|p| [p.step as f64, height(p.loss)]);
    let loss = Chart {
        title: String::new(),
        x,
        y,
        series: vec![Series::new("", NO_CHANNEL, Mark::Line, points.collect())],
    };
    let figure = chart("loss", HALF_PX, &loss);
    figure.inline("loss after each step").map(Some)
}

/// The colour bar of the residual images.
pub fn residual_bar() -> String {
    let colors = (0..128).map(|x| diverging(x as f32 / 63.5 - 1.0));
    Picture::opaque(128, colors).data_uri()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_have_the_angles_they_are_asked_for() {
        for (theta_h_deg, theta_d_deg) in [(0.0, 0.0), (20.0, 35.0), (80.0, 60.0)] {
            let (light, viewer) = directions_at(theta_h_deg, theta_d_deg);
            let half = (light + viewer).normalize();
            let found = (
                half.z.acos().to_degrees(),
                light.dot(half).min(1.0).acos().to_degrees(),
            );
            assert!((f64::from(found.0) - theta_h_deg).abs() < 1e-2, "{found:?}");
            assert!((f64::from(found.1) - theta_d_deg).abs() < 1e-2, "{found:?}");
        }
    }

    #[test]
    fn scales_hold_their_values() {
        assert_eq!(decades([-2.3, 0.4].into_iter()), -3.0..1.0);
        assert_eq!(decades([-9.0, 0.4].into_iter()), -3.0..1.0);
        assert_eq!(decades([0.4].into_iter()), -1.0..1.0);
        assert_eq!(decades(std::iter::empty()), -3.0..0.0);
    }
}
