//! Fig. 8: the recovered BRDFs as (θh, θd) tables.

use super::experiment::{Case, EvaluateError, Experiment, Row, Scale, Table};
use super::lab::{Lab, Sample};
use crate::brdf::{Brdf, bivariate};
use crate::plot::axis::power_of_ten;
use crate::plot::{Figure, HeatMap, HeatScale, heat_maps};

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
    let mut cases = Vec::new();
    for material in &lab.materials {
        for source in SOURCES {
            let material = material.clone();
            let key = format!("{}/{source}", material.name);
            cases.push(Case::new(key, move |lab: &Lab| {
                let row = Row::new()
                    .with("material", material.name.as_str())
                    .with("source", source);
                let rows = match (source, Sample::named(source)) {
                    (_, Some(sample)) => {
                        rows(&lab.measure(sample, 1, &material.brdf)?.fit.material, &row)
                    }
                    ("truth", _) => rows(&*material.brdf, &row),
                    _ => rows(&lab.cells().reference_projection(&*material.brdf)?, &row),
                };
                Ok(rows)
            }));
        }
    }
    Ok(cases)
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
    let range = [-2.5, 1.5];
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
            maps.push(HeatMap {
                title: title.replace("image of the", "image,"),
                width: NODES,
                values: values
                    .iter()
                    .map(|f| f.max(1e-9).log10().max(range[0]))
                    .collect(),
            });
        }
    }
    let half = [0.0, 10.0, 40.0, 90.0].map(|deg: f64| ((deg / 90.0).sqrt(), format!("{deg}°")));
    let difference = [0.0, 30.0, 60.0, 90.0].map(|deg| (deg / 90.0, format!("{deg}°")));
    let scale = HeatScale {
        range,
        label: "f, 1/sr".to_owned(),
        ticks: (-2..=1).map(|n| (f64::from(n), power_of_ten(n))).collect(),
    };
    Ok(vec![heat_maps(
        "tables",
        SOURCES.len(),
        ["difference angle θd", "half angle θh"],
        [&difference, &half],
        &scale,
        &maps,
    )])
}
