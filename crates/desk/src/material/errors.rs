//! A BRDF against a known truth, and what a dictionary can reach of it.

use std::sync::Arc;

use serde::Serialize;

use super::MaterialError;
use crate::brdf::environment::EnvironmentMap;
use crate::brdf::projection::{CellMatrix, EnvironmentMatrix, FIT_AZIMUTHS};
use crate::brdf::score::{self, BrdfErrors, EnvironmentError};
use crate::brdf::{Brdf, Dictionary, Mixture, weights};

/// Azimuths φd of the cells: all that a MERL table has.
pub(super) const AZIMUTHS: usize = 180;

/// Errors of one BRDF against the truth.
#[derive(Serialize)]
pub struct Errors {
    /// Of spheres under environment maps.
    pub environment: EnvironmentError,
    /// Of the values themselves.
    pub brdf: BrdfErrors,
}

/// Errors of `estimate` against `truth`, with spheres of `sphere_px` pixels a side.
pub fn errors_between(estimate: &dyn Brdf, truth: &dyn Brdf, sphere_px: usize) -> Errors {
    Errors {
        environment: score::environment_error(estimate, truth, &EnvironmentMap::all(), sphere_px),
        brdf: score::brdf_errors(estimate, truth, &score::cells(AZIMUTHS)),
    }
}

/// What a dictionary can reach of a BRDF.
#[derive(Serialize)]
#[allow(missing_docs)]
pub struct Projected {
    pub dictionary: String,
    /// Pixels a side of the spheres.
    pub sphere_size: usize,
    pub reference_projection: Errors,
    /// The least value of each error that any weights reach.
    pub floor: Errors,
    /// The reference projection's weights by channel.
    pub weights: [Vec<f64>; 3],
    #[serde(skip)]
    mixture: Mixture,
}

impl Projected {
    /// The reference projection as a weights file.
    pub fn weights_csv(&self) -> String {
        weights::to_csv(&self.mixture, None)
    }
}

/// Projects `truth` onto a dictionary (a name or a file).
///
/// # Errors
/// A dictionary that cannot be read, or a projection that fails.
pub fn project(
    truth: &dyn Brdf,
    dictionary: &str,
    sphere_px: usize,
) -> Result<Projected, MaterialError> {
    let dictionary = Arc::new(Dictionary::load(dictionary)?);
    let maps = EnvironmentMap::all();
    let spheres = EnvironmentMatrix::new(dictionary.clone(), &maps, sphere_px);
    let matrix = CellMatrix::new(dictionary.clone(), FIT_AZIMUTHS);
    let mixture = matrix.reference_projection(truth)?;
    let cells = score::cells(AZIMUTHS);
    let target = score::cosine_weighted(truth, &cells);
    let errors =
        |m: &Mixture| score::errors_of_values(&score::cosine_weighted(m, &cells), &target, &cells);
    Ok(Projected {
        dictionary: dictionary.name().to_owned(),
        sphere_size: sphere_px,
        reference_projection: Errors {
            environment: spheres.error(&mixture, truth),
            brdf: errors(&mixture),
        },
        floor: Errors {
            environment: spheres.floor(truth)?.0,
            brdf: BrdfErrors {
                relative: errors(&matrix.relative_floor(truth)?).relative,
                cube_root: errors(&matrix.cube_root_floor(truth)?).cube_root,
            },
        },
        weights: mixture.weights().clone(),
        mixture,
    })
}
