//! One BRDF against another: everywhere, or only where a fit's images constrain it.

use serde::Serialize;

use super::errors::{self, Errors};
use super::named::Named;
use crate::brdf::HalfDifference;
use crate::brdf::plain_error::{self, PeakError, PlainErrors};
use crate::brdf::score::{self, BrdfErrors, Cell};

/// An estimate against the truth, everywhere.
#[derive(Serialize)]
pub struct Comparison {
    /// Of spheres under environment maps, and of the values.
    #[serde(flatten)]
    pub errors: Errors,
    /// As albedo, and as height of the peak.
    #[serde(flatten)]
    pub plain: PlainErrors,
}

/// An estimate against the truth over what the images of a fit constrain.
#[derive(Serialize)]
pub struct ConstrainedComparison {
    /// Part of the cells of (θh, θd, φd) that are compared, by solid angle, 0..=1.
    pub share: f64,
    /// Errors of the values over these cells.
    pub brdf: BrdfErrors,
    /// Height of the peak at those angles of incidence whose mirror direction is constrained.
    pub peak: Vec<PeakError>,
}

/// Nothing can be compared where the images constrain it.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs)]
pub enum ConstrainedError {
    #[error(
        "neither {estimate} nor {truth} is a fit, and only a fit has a table of what its images constrain"
    )]
    NoFit { estimate: String, truth: String },
    #[error("the images constrain no cell of {estimate} and {truth}")]
    NoCell { estimate: String, truth: String },
}

/// `estimate` against `truth`, with spheres of `sphere_px` pixels a side.
pub fn compare(estimate: &Named, truth: &Named, sphere_px: usize) -> Comparison {
    let (a, b) = (&*estimate.brdf, &*truth.brdf);
    Comparison {
        errors: errors::errors_between(a, b, sphere_px),
        plain: plain_error::plain_errors(a, b),
    }
}

/// `estimate` against `truth` over the cells that the images of both constrain; a BRDF that is
/// no fit is constrained everywhere. Environment and albedo errors need the whole BRDF and have
/// no such version.
///
/// # Errors
/// Neither is a fit, or no cell is constrained.
pub fn compare_constrained(
    estimate: &Named,
    truth: &Named,
) -> Result<ConstrainedComparison, ConstrainedError> {
    let names = || (estimate.label.clone(), truth.label.clone());
    if estimate.table.is_none() && truth.table.is_none() {
        let (estimate, truth) = names();
        return Err(ConstrainedError::NoFit { estimate, truth });
    }
    let is_constrained = |theta_h_deg: f64, theta_d_deg: f64| {
        estimate.is_constrained(theta_h_deg, theta_d_deg)
            && truth.is_constrained(theta_h_deg, theta_d_deg)
    };
    let all = score::cells(errors::AZIMUTHS);
    let solid_angle =
        |cells: &[Cell]| -> f64 { cells.iter().map(|cell| f64::from(cell.solid_angle)).sum() };
    let total = solid_angle(&all);
    let mut cells = all;
    cells.retain(|cell| {
        let angles =
            HalfDifference::from_directions(cell.to_light.as_dvec3(), cell.to_viewer.as_dvec3());
        is_constrained(
            angles.theta_h_rad.to_degrees(),
            angles.theta_d_rad.to_degrees(),
        )
    });
    if cells.is_empty() {
        let (estimate, truth) = names();
        return Err(ConstrainedError::NoCell { estimate, truth });
    }
    let (a, b) = (&*estimate.brdf, &*truth.brdf);
    let angles = plain_error::ANGLES_DEG.into_iter();
    Ok(ConstrainedComparison {
        share: solid_angle(&cells) / total,
        brdf: score::brdf_errors(a, b, &cells),
        // A mirror direction has θh = 0 and θd = θi.
        peak: angles
            .filter(|&angle| is_constrained(0.0, angle))
            .map(|angle| plain_error::peak(a, b, angle))
            .collect(),
    })
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::brdf::source;
    use crate::session::fit_record::{AngleTable, Interval};

    fn named(spec: &str, table: Option<AngleTable>) -> Named {
        Named {
            label: spec.to_owned(),
            brdf: Arc::from(source::load(spec).unwrap()),
            table,
        }
    }

    /// Constrained up to this half angle, degrees.
    fn table(up_to_deg: f64) -> AngleTable {
        let theta_h_deg: Vec<f64> = (0..=9).map(|i| 10.0 * f64::from(i)).collect();
        let cells = theta_h_deg.iter().flat_map(|&theta_h_deg| {
            [Interval {
                value: [0.1; 3],
                lower: [0.05; 3],
                upper: [0.2; 3],
                constrained: theta_h_deg <= up_to_deg,
            }; 2]
        });
        AngleTable {
            cells: cells.collect(),
            theta_h_deg: theta_h_deg.clone(),
            theta_d_deg: vec![0.0, 90.0],
        }
    }

    #[test]
    fn only_what_is_constrained_counts() {
        // Two lobes that differ near the peak alone: far from it both are dark.
        let truth = named("ggx:0.1,1.5", None);
        let near = compare_constrained(&named("ggx:0.2,1.5", Some(table(40.0))), &truth).unwrap();
        let whole = compare_constrained(&named("ggx:0.2,1.5", Some(table(90.0))), &truth).unwrap();
        assert!((whole.share - 1.0).abs() < 1e-9);
        // The nearest rows change at 45°; by random half and difference vectors 0.549.
        assert!((near.share - 0.549).abs() < 0.015, "{}", near.share);
        let everywhere = compare(&named("ggx:0.2,1.5", None), &truth, 8).errors.brdf;
        assert_eq!(whole.brdf.cube_root.all, everywhere.cube_root.all);
        assert_ne!(near.brdf.cube_root.all, whole.brdf.cube_root.all);
        assert_eq!(near.peak.len(), 3);
        let error = compare_constrained(&truth, &truth).err();
        assert!(matches!(error, Some(ConstrainedError::NoFit { .. })));
        let nothing = named("ggx:0.2,1.5", Some(table(-1.0)));
        let error = compare_constrained(&nothing, &truth).err();
        assert!(matches!(error, Some(ConstrainedError::NoCell { .. })));
    }
}
