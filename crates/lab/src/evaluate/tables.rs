//! Fig. 8: the recovered BRDFs as (θh, θd) tables.

use std::sync::Arc;

use super::experiment::{Case, EvaluateError, Experiment, Row, Scale, Table};
use super::lab::{Lab, Material, Sample, of_materials};
use crate::brdf::{Brdf, bivariate};
use crate::plot::colors::sequential;
use crate::plot::{Axis, Figure, HeatMap, HeatMaps, heat_maps};

/// Truth, reference projection and estimates.
pub static TABLES: Experiment = Experiment {
    name: "tables",
    shows: "Fig. 8: green-channel (θh, θd) tables of the truth, of its reference projection and of the BRDFs recovered from one image of each shape",
    full: Scale {
        materials: &[
            "nbrdf:blue-acrylic",
            "nbrdf:gold-metallic-paint",
            "nbrdf:pearl-paint",
            "synthetic:pink-ceramic",
        ],
        ..Scale::SINGLE_IMAGE
    },
    quick: Scale {
        materials: &["nbrdf:blue-acrylic", "synthetic:pink-ceramic"],
        ..Scale::QUICK_IMAGE
    },
    cases,
    figures,
};

/// Nodes along each axis: θh = 90°·(i/30)², θd = 3°·j.
const NODES: usize = 30;

const SOURCES: [&str; 5] = [
    "truth",
    "reference projection",
    "sphere",
    "bowl",
    "designed",
];

fn cases(lab: &Lab) -> Result<Vec<Case>, EvaluateError> {
    Ok(of_materials(lab, &SOURCES, str::to_owned, one))
}

fn one(
    lab: &Lab,
    material: &Arc<Material>,
    source: &'static str,
) -> Result<Vec<Row>, EvaluateError> {
    let row = Row::new()
        .with("material", material.name.as_str())
        .with("source", source);
    Ok(match (source, Sample::named(source)) {
        (_, Some(sample)) => rows(&lab.measure(sample, 1, material)?.fit.material, &row),
        ("truth", _) => rows(&*material.brdf, &row),
        _ => rows(&lab.cells().reference_projection(&*material.brdf)?, &row),
    })
}

fn rows(brdf: &dyn Brdf, row: &Row) -> Vec<Row> {
    let table = bivariate::average(brdf, NODES, NODES);
    let nodes = table.values().iter().enumerate();
    nodes
        .map(|(node, f)| {
            let (i, j) = (node / NODES, node % NODES);
            row.clone()
                .with("theta_h_deg", 90.0 * (i as f64 / NODES as f64).powi(2))
                .with("theta_d_deg", 90.0 * j as f64 / NODES as f64)
                .with("f_per_sr", f64::from(f[1]))
        })
        .collect()
}

fn figures(_: &Lab, table: &Table) -> Result<Vec<Figure>, EvaluateError> {
    let range = -2.5..1.5;
    let mut maps = Vec::new();
    for material in table.texts("material") {
        for source in SOURCES {
            let values = table.figures("f_per_sr", |row| {
                row.text("material") == material && row.text("source") == source
            });
            let title = match source {
                "truth" => format!("{material}: truth"),
                "reference projection" => source.to_owned(),
                shape => format!("from one image of the {shape}"),
            };
            let values: Vec<f64> = values.iter().map(|f| f.max(1e-9).log10()).collect();
            let title = title.replace("image of the", "image,");
            maps.push(HeatMap::new(title, NODES, &values, &range));
        }
    }
    let half = [0.0, 10.0, 40.0, 90.0].map(|deg| (Axis::half_angle(deg), format!("{deg}°")));
    let all = HeatMaps {
        columns: SOURCES.len(),
        cell_px: [180.0; 2],
        x: Axis::with_step(0.0..90.0, 30.0, "difference angle θd / °"),
        // Row 0 is the top.
        y: Axis::with_ticks(0.0..1.0, half.into(), "half angle θh").reversed(),
        scale: Axis::decades(range, "f / sr⁻¹"),
        colors: sequential,
        maps: &maps,
    };
    Ok(vec![heat_maps("tables", &all)])
}
