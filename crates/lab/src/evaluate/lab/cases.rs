//! Cases of every material.

use std::sync::Arc;

use super::{Lab, Material};
use crate::evaluate::experiment::{Case, EvaluateError, Row};

/// Measures a material with one variant of an experiment.
type Work<V> = fn(&Lab, &Arc<Material>, V) -> Result<Vec<Row>, EvaluateError>;

/// A case for every material with every variant of the measurement, called
/// `material/variant`.
pub fn of_materials<V: Copy + Send + Sync + 'static>(
    lab: &Lab,
    variants: &[V],
    name: impl Fn(V) -> String,
    work: Work<V>,
) -> Vec<Case> {
    let mut cases = Vec::new();
    for material in &lab.materials {
        for &variant in variants {
            let key = format!("{}/{}", material.name, name(variant));
            let material = material.clone();
            cases.push(Case::new(key, move |lab: &Lab| {
                work(lab, &material, variant)
            }));
        }
    }
    cases
}
