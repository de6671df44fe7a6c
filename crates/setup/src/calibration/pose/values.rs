//! What a record of a pose holds.

use nalgebra::{Matrix6, Vector3};
use serde::{Deserialize, Serialize};

use super::PoseEstimate;
use crate::calibration::record::{BadValue, Kind, Measured, Values, must};

/// The sample's pose against the rig file's description: turned about its datum, then moved.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseValues {
    /// Rotation vector, axis times angle, degrees.
    pub rotation_deg: [f64; 3],
    /// Translation, millimetres.
    pub translation_mm: [f64; 3],
    /// Covariance of rotation (degrees), then translation (millimetres).
    pub covariance: [[f64; 6]; 6],
    /// What the images do not determine, by name: as the rig file has it.
    pub held: Vec<String>,
    /// Blur of the images, standard deviation, pixels.
    pub blur_px: Measured,
    /// Patches of the images in which edges were compared.
    pub patches: u32,
    /// Root mean square shift of the edges that is left, pixels.
    pub residual_px: f64,
    /// Part of the contrast around edges that outline, creases and shadows explain.
    pub explained: f64,
}

impl PoseValues {
    /// The values of an estimate.
    pub fn new(found: &PoseEstimate) -> Self {
        let shown = |i: usize| if i < 3 { 1f64.to_degrees() } else { 1.0 };
        let blur = found.blur_px2.value.max(0.0).sqrt();
        let shifts = &found.shifts;
        let mean_square =
            |f: &dyn Fn(&super::ResidualShift) -> f64| -> f64 { shifts.iter().map(f).sum::<f64>() };
        // Patches are weighted by their information.
        let weights = mean_square(&|s| s.std_px.powi(-2));
        let squares = mean_square(&|s| (s.shift_px / s.std_px).powi(2));
        Self {
            rotation_deg: std::array::from_fn(|i| found.values[i].to_degrees()),
            translation_mm: std::array::from_fn(|i| found.values[3 + i]),
            covariance: std::array::from_fn(|i| {
                std::array::from_fn(|j| found.covariance[i][j] * shown(i) * shown(j))
            }),
            held: found.held.clone(),
            blur_px: Measured {
                value: blur,
                // σ = √v: half of the relative deviation.
                std: 0.5 * found.blur_px2.std / blur.max(found.blur_px2.std.sqrt()),
            },
            patches: shifts.len() as u32,
            residual_px: (squares / weights.max(1e-300)).sqrt(),
            explained: found.explained,
        }
    }

    /// Rotation vector in radians and translation in millimetres.
    pub fn pose(&self) -> [glam::DVec3; 2] {
        [
            glam::DVec3::from_array(self.rotation_deg.map(f64::to_radians)),
            glam::DVec3::from_array(self.translation_mm),
        ]
    }

    /// The covariance in radians and millimetres.
    pub fn covariance_rad_mm(&self) -> [[f64; 6]; 6] {
        let unit = |i: usize| if i < 3 { 1f64.to_radians() } else { 1.0 };
        std::array::from_fn(|i| std::array::from_fn(|j| self.covariance[i][j] * unit(i) * unit(j)))
    }

    /// Standard deviations, degrees and millimetres.
    pub fn deviations(&self) -> [f64; 6] {
        std::array::from_fn(|i| self.covariance[i][i].sqrt())
    }
}

impl Values for PoseValues {
    const KIND: Kind = Kind::Pose;

    fn check(&self) -> Result<(), BadValue> {
        let turned = Vector3::from(self.rotation_deg).norm();
        let value = format!("{:?}", self.rotation_deg);
        let allowed = "a vector of at most 45 degrees";
        must(turned <= 45.0, "rotation_deg", value, allowed)?;
        let moved = Vector3::from(self.translation_mm).norm();
        let value = format!("{:?}", self.translation_mm);
        let allowed = "a vector of at most 1e4 mm";
        must(moved <= 1e4, "translation_mm", value, allowed)?;
        let covariance = Matrix6::from_fn(|i, j| self.covariance[i][j]);
        let symmetric = (covariance - covariance.transpose()).amax() <= 1e-9 * covariance.amax();
        let possible = symmetric && covariance.cholesky().is_some();
        let allowed = "6 x 6 numbers, symmetric and positive definite";
        must(possible, "covariance", "another matrix", allowed)
    }
}
