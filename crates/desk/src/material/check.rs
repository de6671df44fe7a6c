//! Is a BRDF physical?

use std::path::Path;

use serde::Serialize;

use super::{MaterialError, load};
use crate::brdf::check::{self, ALBEDO_ANGLES_DEG, PhysicalCheck};
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
    /// The findings for a person, line by line.
    pub fn lines(&self) -> Vec<String> {
        let found = &self.physical;
        let mut lines = vec![
            "directional albedo (1 is all light reflected)".to_owned(),
            "  theta_i      R      G      B".to_owned(),
        ];
        let albedo = ALBEDO_ANGLES_DEG.iter().zip(&found.albedo);
        lines.extend(
            albedo.map(|(theta, [r, g, b])| format!("  {theta:>5}° {r:>8.4} {g:>6.4} {b:>6.4}")),
        );
        lines.push(format!("largest albedo        {:.4}", found.largest_albedo));
        lines.push(format!(
            "reciprocity, worst    {:.2e} relative",
            found.reciprocity
        ));
        lines.extend(self.reciprocity_as_measured.map(|raw| {
            format!("  as measured         {raw:.2e} relative, before both orders are averaged")
        }));
        let (invalid, pairs) = (found.invalid, found.pairs);
        lines.push(format!("invalid values        {invalid} of {pairs} pairs"));
        lines.extend(self.gaps.as_ref().map(|gaps| {
            format!(
                "nodes without value   {} not measured, {} undefined or infinite, of {}",
                gaps.negative, gaps.not_finite, gaps.nodes
            )
        }));
        lines.push(format!(
            "sampler, worst χ²     {:+.1} standard deviations at 0, 45, 80 and 88°",
            self.worst_sampler()
        ));
        lines
    }

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
