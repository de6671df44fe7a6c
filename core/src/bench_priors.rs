//! How well a bench is known: the prior of what a fit may refine, and of how wide the edges of
//! shadows are in which nothing is compared.

/// Standard deviations of what a description says about a bench; 0: exactly known.
#[derive(Clone, Debug, PartialEq)]
pub struct BenchPriors {
    /// Each light's direction, each of its two angles, radians.
    pub light_rad: f64,
    /// A rotation of the whole light stage, about each axis, radians: directions of
    /// all lights err together. Counts only where `light_rad` is above 0.
    pub stage_rad: f64,
    /// Each light's intensity, relative.
    pub intensity: f64,
    /// The scale common to all lights, relative; about 1 where only relative radiance
    /// was measured. Counts only where `intensity` is above 0.
    pub common_intensity: f64,
    /// The sample's orientation about each axis, radians.
    pub rotation_rad: f64,
    /// The sample's place along each axis, millimetres.
    pub translation_mm: f64,
    /// Radiance of stray light, one constant per image, unit of the images.
    pub stray_light: f64,
    /// Covariance of a measured pose, rotation about x, y and z (radians), then
    /// translation along them (millimetres); takes the place of the two
    /// deviations above. Must be positive definite.
    pub pose_covariance: Option<[[f64; 6]; 6]>,
}

impl BenchPriors {
    /// A bench that is exactly as described.
    pub const EXACT: Self = Self {
        light_rad: 0.0,
        stage_rad: 0.0,
        intensity: 0.0,
        common_intensity: 0.0,
        rotation_rad: 0.0,
        translation_mm: 0.0,
        stray_light: 0.0,
        pose_covariance: None,
    };
}

impl Default for BenchPriors {
    /// A bench that was set up with care: lights 0.3°, intensities 1%, pose 0.2 mm and
    /// 0.2°, no stray light.
    fn default() -> Self {
        Self {
            light_rad: 0.3f64.to_radians(),
            stage_rad: 0.0,
            intensity: 0.01,
            common_intensity: 0.0,
            rotation_rad: 0.2f64.to_radians(),
            translation_mm: 0.2,
            stray_light: 0.0,
            pose_covariance: None,
        }
    }
}
