//! The experiments of `rig evaluate`: estimates compared with a known truth.

mod defects;
mod diagnosis;
mod error;
pub mod experiment;
mod intervals;
pub mod lab;

mod accuracy;
mod atoms;
mod baseline;
mod calibration;
mod designs;
mod dictionary_size;
mod form;
mod gallery;
pub mod growth;
mod light_count;
mod misalignment;
mod next_light;
mod noise;
mod optimisers;
mod plans;
mod rank;
mod realism;
mod shape_construction;
mod shapes;
mod shown_angles;
mod table_visits;
mod tables;
mod tolerance;

use experiment::{EvaluateError, Experiment};

/// All experiments, in the order of `rig evaluate --list`.
pub static EXPERIMENTS: &[&Experiment] = &[
    &atoms::ATOMS,
    &accuracy::ACCURACY,
    &baseline::BASELINE,
    &designs::DESIGNS,
    &shapes::SHAPES,
    &dictionary_size::DICTIONARY_SIZE,
    &light_count::LIGHT_COUNT,
    &next_light::NEXT_LIGHT,
    &plans::PLANS,
    &shape_construction::SHAPE_CONSTRUCTION,
    &gallery::GALLERY,
    &tables::TABLES,
    &table_visits::TABLE_VISITS,
    &rank::RANK,
    &optimisers::OPTIMISERS,
    &noise::NOISE,
    &realism::REALISM,
    &intervals::INTERVALS,
    &diagnosis::DIAGNOSIS,
    &misalignment::MISALIGNMENT,
    &form::FORM,
    &tolerance::TOLERANCE,
    &calibration::CALIBRATION,
];

/// The experiment of a name.
pub fn find(name: &str) -> Result<&'static Experiment, EvaluateError> {
    let found = EXPERIMENTS.iter().find(|e| e.name == name);
    found
        .copied()
        .ok_or_else(|| EvaluateError::UnknownExperiment {
            name: name.to_owned(),
            known: EXPERIMENTS
                .iter()
                .map(|e| e.name)
                .collect::<Vec<_>>()
                .join(", "),
        })
}
