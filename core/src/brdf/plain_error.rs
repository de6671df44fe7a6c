//! Errors that people can picture: how much light is reflected in all directions together,
//! and how high the specular peak is.
//!
//! *Albedo error*: the directional-hemispherical reflectance ρ(θi) = ∫ f cos θo dωo of the
//! estimate less that of the truth; −0.03 means that three hundredths of the light are missing.
//!
//! *Peak error*: f of the estimate over that of the truth, less one, where light and viewer
//! stand in mirror directions; −0.2 means a highlight that is a fifth too dim.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::Brdf;
use super::check::directional_albedo;

/// Angles of incidence of both errors, degrees: 8° is that of reflectance standards (8°/di).
pub const ANGLES_DEG: [f64; 3] = [8.0, 45.0, 75.0];

/// Directions per technique of an albedo's quadrature; its error is below half a percent.
const PER_TECHNIQUE: u32 = 2048;

/// Directional-hemispherical reflectance of two BRDFs at one angle of incidence.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct AlbedoError {
    /// Of the light, degrees from the normal.
    pub theta_i_deg: f64,
    /// R, G, B of the estimate, 0..=1.
    pub estimate: [f64; 3],
    /// R, G, B of the truth, 0..=1.
    pub truth: [f64; 3],
    /// Estimate less truth.
    pub difference: [f64; 3],
}

/// f of two BRDFs in the mirror direction at one angle of incidence.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PeakError {
    /// Of the light, degrees from the normal.
    pub theta_i_deg: f64,
    /// R, G, B of the estimate, 1/sr.
    pub estimate: [f64; 3],
    /// R, G, B of the truth, 1/sr.
    pub truth: [f64; 3],
    /// Estimate over truth, less one; infinite where the truth alone is black, 0 where both are.
    pub relative: [f64; 3],
}

/// Both at [`ANGLES_DEG`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlainErrors {
    /// How much light is reflected.
    pub albedo: Vec<AlbedoError>,
    /// How high the peak is.
    pub peak: Vec<PeakError>,
}

impl PlainErrors {
    /// The largest difference of albedo, sign kept.
    pub fn worst_albedo(&self) -> f64 {
        worst(self.albedo.iter().flat_map(|error| error.difference))
    }

    /// The largest relative difference of a peak, sign kept.
    pub fn worst_peak(&self) -> f64 {
        worst(self.peak.iter().flat_map(|error| error.relative))
    }
}

fn worst(values: impl Iterator<Item = f64>) -> f64 {
    values.fold(0.0, |worst: f64, value| match value.abs() > worst.abs() {
        true => value,
        false => worst,
    })
}

/// Both errors of `estimate` against `truth`.
///
/// ```
/// use rig_core::brdf::{plain_error, source};
///
/// let [truth, darker] = ["lambertian:0.5", "lambertian:0.4"].map(source::load);
/// let errors = plain_error::plain_errors(darker?.as_ref(), truth?.as_ref());
/// assert!((errors.worst_albedo() + 0.1).abs() < 2e-3, "a tenth of the light is missing");
/// assert!((errors.worst_peak() + 0.2).abs() < 1e-6, "a fifth less");
/// # Ok::<(), rig_core::brdf::BrdfError>(())
/// ```
pub fn plain_errors(estimate: &dyn Brdf, truth: &dyn Brdf) -> PlainErrors {
    PlainErrors {
        albedo: ANGLES_DEG
            .map(|angle| albedo(estimate, truth, angle))
            .into(),
        peak: ANGLES_DEG.map(|angle| peak(estimate, truth, angle)).into(),
    }
}

/// The albedo error at one angle of incidence, degrees.
pub fn albedo(estimate: &dyn Brdf, truth: &dyn Brdf, theta_i_deg: f64) -> AlbedoError {
    let of = |brdf| directional_albedo(brdf, direction(theta_i_deg), PER_TECHNIQUE);
    let (estimate, truth) = (of(estimate), of(truth));
    AlbedoError {
        theta_i_deg,
        estimate,
        truth,
        difference: [0, 1, 2].map(|c| estimate[c] - truth[c]),
    }
}

/// The peak error at one angle of incidence, degrees.
pub fn peak(estimate: &dyn Brdf, truth: &dyn Brdf, theta_i_deg: f64) -> PeakError {
    let (to_light, mirrored) = (direction(theta_i_deg), direction(-theta_i_deg));
    let of = |brdf: &dyn Brdf| {
        let f = brdf.eval(to_light.as_vec3(), mirrored.as_vec3());
        f.map(f64::from)
    };
    let (estimate, truth) = (of(estimate), of(truth));
    let relative = |c: usize| match estimate[c] == truth[c] {
        true => 0.0,
        false => estimate[c] / truth[c] - 1.0,
    };
    PeakError {
        theta_i_deg,
        estimate,
        truth,
        relative: [0, 1, 2].map(relative),
    }
}

fn direction(theta_deg: f64) -> DVec3 {
    let (sin, cos) = theta_deg.to_radians().sin_cos();
    DVec3::new(sin, 0.0, cos)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::brdf::source::load;

    /// Against the closed form D G F / (4 cos² θ) of a lobe in the mirror direction, where
    /// D = 1/(π α²), and the reflectance of a plane of the same index, which a narrow lobe has.
    #[test]
    fn a_narrow_lobe_reflects_as_its_plane_and_peaks_as_its_formula() {
        let (alpha, eta) = (0.02f64, 1.5f64);
        let lobe = load("ggx:0.02,1.5").unwrap();
        let black = load("lambertian:0").unwrap();
        let errors = plain_errors(&*lobe, &*black);
        for (albedo, peak) in errors.albedo.iter().zip(&errors.peak) {
            let (sin, cos) = albedo.theta_i_deg.to_radians().sin_cos();
            let cos_t = (1.0 - (sin / eta).powi(2)).sqrt();
            let across = ((cos - eta * cos_t) / (cos + eta * cos_t)).powi(2);
            let along = ((eta * cos - cos_t) / (eta * cos + cos_t)).powi(2);
            let fresnel = 0.5 * (across + along);
            let difference = albedo.difference[1];
            assert!(
                (difference / fresnel - 1.0).abs() < 0.03,
                "{albedo:?} {fresnel}"
            );
            let tan2 = (sin / cos).powi(2);
            let shadowing = 2.0 / (1.0 + (1.0 + alpha * alpha * tan2).sqrt());
            let lobe = fresnel * shadowing * shadowing
                / (std::f64::consts::PI * alpha * alpha * 4.0 * cos * cos);
            assert!(
                (peak.estimate[1] / lobe - 1.0).abs() < 1e-3,
                "{peak:?} {lobe}"
            );
            assert!(peak.relative[1].is_infinite() && peak.truth == [0.0; 3]);
        }
        assert_eq!(plain_errors(&*black, &*black).worst_peak(), 0.0);
    }
}
