//! Fig. 10: which entries of the (θh, θd) table the paths of one image touch.

use glam::DVec2;

use super::experiment::{Case, EvaluateError, Experiment, Row, Scale, Table};
use super::lab::{Lab, Sample};
use crate::brdf::HalfDifference;
use crate::plot::colors::sequential;
use crate::plot::{Axis, Figure, HeatMap, HeatMaps, heat_maps};
use crate::random::{Purpose, stream};
use crate::transport::{Proposal, Scene};

/// Visits by paths of one, and of one and two reflections.
pub static TABLE_VISITS: Experiment = Experiment {
    name: "table-visits",
    shows: "Fig. 10: how often paths of one reflection, and of one and two, visit each entry of the (θh, θd) table under one light",
    full: Scale {
        resolution_px: 64,
        samples_per_pixel: 1024,
        ..Scale::NONE
    },
    quick: Scale {
        resolution_px: 32,
        samples_per_pixel: 64,
        ..Scale::NONE
    },
    cases,
    figures,
};

/// Cells along each axis, 3° wide.
const CELLS: usize = 30;
const WIDTH_DEG: f64 = 90.0 / CELLS as f64;

/// Visits by cell, θh first.
type Visits = Vec<u64>;

fn cases(_: &Lab) -> Result<Vec<Case>, EvaluateError> {
    let case = |sample: Sample| {
        Case::new(sample.name(), move |lab: &Lab| {
            let scene = sample.scene(lab.settings.resolution_px, sample.lights(1))?;
            let [one, two] = count(lab, &scene);
            let both: Visits = one.iter().zip(&two).map(|(a, b)| a + b).collect();
            let rows = [(1u32, &one), (2, &both)].map(|(reflections, visits)| {
                let visited = visits.iter().enumerate().filter(|(_, n)| **n > 0);
                visited
                    .map(|(cell, &n)| {
                        Row::new()
                            .with("shape", sample.name())
                            .with("reflections_up_to", reflections)
                            .with("theta_h_deg", (cell / CELLS) as f64 * WIDTH_DEG)
                            .with("theta_d_deg", (cell % CELLS) as f64 * WIDTH_DEG)
                            .with("visits", n)
                    })
                    .collect::<Vec<_>>()
            });
            Ok(rows.concat())
        })
    };
    Ok(Sample::ALL.into_iter().map(case).collect())
}

/// Visits by paths of exactly one and of exactly two reflections, from the lamp to the
/// camera.
fn count(lab: &Lab, scene: &Scene) -> [Visits; 2] {
    let proposal = Proposal::default();
    let width = scene.camera.resolution_px[0];
    let mut visits = [vec![0; CELLS * CELLS], vec![0; CELLS * CELLS]];
    for pixel in 0..scene.camera.pixels() {
        let corner = DVec2::new((pixel % width) as f64, (pixel / width) as f64);
        for sample in 0..lab.settings.samples_per_pixel {
            let key = |purpose| {
                stream(
                    lab.settings.seed,
                    purpose,
                    0,
                    pixel as u64,
                    u64::from(sample),
                )
            };
            let mut position = key(Purpose::PixelPosition);
            let at = corner + DVec2::new(position.uniform(), position.uniform());
            let Some((first, to_viewer)) = scene.first(&scene.camera.ray(at, DVec2::ZERO)) else {
                continue;
            };
            if let Some(lamp) = scene.connect(&first, 0, [0.5; 2]) {
                visits[0][cell(lamp.to_light, to_viewer)] += 1;
            }
            let mut directions = key(Purpose::PathDirection);
            let Some((onwards, _)) = proposal.sample(to_viewer, &mut directions) else {
                continue;
            };
            let Some((second, back)) = scene.next(&first, onwards) else {
                continue;
            };
            if let Some(lamp) = scene.connect(&second, 0, [0.5; 2]) {
                visits[1][cell(onwards, to_viewer)] += 1;
                visits[1][cell(lamp.to_light, back)] += 1;
            }
        }
    }
    visits
}

fn cell(a: glam::Vec3, b: glam::Vec3) -> usize {
    let angles = HalfDifference::from_directions(a.as_dvec3(), b.as_dvec3());
    let index = |rad: f64| ((rad.to_degrees() / WIDTH_DEG) as usize).min(CELLS - 1);
    index(angles.theta_h_rad) * CELLS + index(angles.theta_d_rad)
}

fn figures(_: &Lab, table: &Table) -> Result<Vec<Figure>, EvaluateError> {
    let mut maps = Vec::new();
    let mut most = 1.0f64;
    for reflections in [1.0, 2.0] {
        for sample in Sample::ALL {
            let mut values = vec![f64::NAN; CELLS * CELLS];
            for row in &table.rows {
                let here = row.text("shape") == sample.name()
                    && row.number("reflections_up_to") == Some(reflections);
                let entry = (
                    row.number("theta_h_deg"),
                    row.number("theta_d_deg"),
                    row.number("visits"),
                );
                if let (true, (Some(h), Some(d), Some(n))) = (here, entry) {
                    let index = |deg: f64| ((deg / WIDTH_DEG).round() as usize).min(CELLS - 1);
                    values[index(h) * CELLS + index(d)] = n.log10();
                    most = most.max(n.log10());
                }
            }
            let seen = values.iter().filter(|v| !v.is_nan()).count();
            let paths = if reflections == 1.0 {
                "K = 1"
            } else {
                "K ≤ 2"
            };
            maps.push((format!("{}, {paths}: {seen} cells", sample.name()), values));
        }
    }
    let maps: Vec<HeatMap> = maps
        .into_iter()
        .map(|(title, values)| HeatMap::new(title, CELLS, &values, &(0.0..most)))
        .collect();
    let all = HeatMaps {
        columns: 5,
        cell_px: [180.0; 2],
        x: Axis::with_step(0.0..90.0, 30.0, "difference angle θd / °"),
        // Row 0 is the top.
        y: Axis::with_step(0.0..90.0, 30.0, "half angle θh / °").reversed(),
        scale: Axis::decades(0.0..most, "visits"),
        colors: sequential,
        maps: &maps,
    };
    Ok(vec![heat_maps("table-visits", &all)])
}
