//! Is a BRDF physical?

use std::path::Path;

use serde::Serialize;

use super::{MaterialError, load};
use crate::brdf::check::{self, PhysicalCheck};
use crate::brdf::chi_square::{ChiSquare, check_lobes};
use crate::brdf::merl;
use crate::brdf::rgl::{AsMeasured, RglBrdf};
use crate::brdf::table::Gaps;
use crate::outside_file::ends_in;

/// Angles of the viewer at which the importance sampler is tested, degrees.
pub const SAMPLER_ANGLES_DEG: [f64; 4] = [0.0, 45.0, 80.0, 88.0];
/// Samples of each test.
const SAMPLES: u64 = 20_000;

/// What a check finds.
#[derive(Serialize)]
pub struct MaterialCheck {
    /// Reciprocity and energy conservation.
    #[serde(flatten)]
    pub physical: PhysicalCheck,
    /// Of a measured file, before both orders of the directions are averaged.
    pub reciprocity_as_measured: Option<f64>,
    /// Of a MERL file: nodes above the horizon that have no value.
    pub gaps: Option<Gaps>,
    /// The importance sampler made from it, at [`SAMPLER_ANGLES_DEG`].
    pub sampler: Vec<ChiSquare>,
}

impl MaterialCheck {
    /// The nodes without a value, where they are too many for a measured table.
    pub fn excessive_gaps(&self) -> Option<&Gaps> {
        self.gaps.as_ref().filter(|gaps| !gaps.are_few())
    }

    /// Largest deviate of the sampler's χ² tests, standard deviations.
    pub fn worst_sampler(&self) -> f64 {
        let deviates = self.sampler.iter().map(|test| test.deviate);
        deviates.fold(f64::NEG_INFINITY, f64::max)
    }
}

/// Checks the BRDF that `spec` names (see [`load`]).
///
/// # Errors
/// As [`load`].
pub fn check_material(spec: &str) -> Result<MaterialCheck, MaterialError> {
    let brdf = load(spec)?;
    let path = Path::new(spec);
    let reciprocity_as_measured = match ends_in(path, "bsdf") {
        true => Some(check::check(&AsMeasured(&RglBrdf::read(path)?)).reciprocity),
        false => None,
    };
    let gaps = match ends_in(path, "binary") {
        true => Some(merl::read(path)?.gaps()),
        false => None,
    };
    Ok(MaterialCheck {
        physical: check::check(brdf.as_ref()),
        reciprocity_as_measured,
        gaps,
        sampler: check_lobes(brdf.as_ref(), &SAMPLER_ANGLES_DEG, SAMPLES),
    })
}
