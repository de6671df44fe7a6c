//! Lamps and the irradiance they bring to a surface point.

use glam::{DVec3, Vec3};

/// A lamp of known position and strength.
///
/// ```
/// use glam::{DVec3, Vec3};
/// use rig_core::transport::Light;
///
/// let bulb = Light::Point {
///     position_mm: DVec3::new(0.0, 0.0, 200.0),
///     intensity_mm2: [4e4, 4e4, 3e4],
/// };
/// let sample = bulb.sample(Vec3::ZERO, [0.5, 0.5]);
/// assert_eq!(sample.direction, Vec3::Z);
/// // Irradiance at 200 mm: intensity / distance².
/// let irradiance = bulb.strength()[0] * f64::from(sample.relative_irradiance);
/// assert!((irradiance - 1.0).abs() < 1e-6);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Light {
    /// Far away: the same direction everywhere.
    Directional {
        /// Unit vector from the sample towards the lamp's centre.
        to_light: DVec3,
        /// Irradiance on a surface perpendicular to the direction, per channel.
        irradiance: [f64; 3],
        /// Half angle under which the (uniform, round) lamp appears, radians; 0 is a point.
        angular_radius_rad: f64,
    },
    /// A small lamp that radiates evenly, at a finite distance.
    Point {
        /// Where it is, sample frame, millimetres.
        position_mm: DVec3,
        /// Radiant intensity per channel, in irradiance · mm² (irradiance = intensity/distance²).
        intensity_mm2: [f64; 3],
    },
}

/// One drawn connection from a surface point towards a lamp, before visibility.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightSample {
    /// Unit vector towards the lamp.
    pub direction: Vec3,
    /// Distance, millimetres (infinite if directional).
    pub distance_mm: f32,
    /// Irradiance on a perpendicular surface over [`Light::strength`].
    pub relative_irradiance: f32,
}

impl Light {
    /// A point so far away that its light comes from the same direction everywhere (of any
    /// length), with this irradiance on a surface perpendicular to it.
    pub fn distant(to_light: DVec3, irradiance: [f64; 3]) -> Self {
        Self::Directional {
            to_light: to_light.normalize(),
            irradiance,
            angular_radius_rad: 0.0,
        }
    }

    /// The per-channel factor that is the same for every surface point.
    pub fn strength(&self) -> [f64; 3] {
        match self {
            Light::Directional { irradiance, .. } => *irradiance,
            Light::Point { intensity_mm2, .. } => *intensity_mm2,
        }
    }

    /// Half angle under which the lamp appears, radians; 0 of a point.
    pub fn angular_radius_rad(&self) -> f64 {
        match self {
            Light::Directional {
                angular_radius_rad, ..
            } => *angular_radius_rad,
            Light::Point { .. } => 0.0,
        }
    }

    /// Draws a connection from `point_mm`; `u` uniform in [0, 1)², used by extended lamps only.
    #[inline]
    pub fn sample(&self, point_mm: Vec3, u: [f32; 2]) -> LightSample {
        match *self {
            Light::Directional {
                to_light,
                angular_radius_rad,
                ..
            } => {
                let centre = to_light.as_vec3();
                let direction = if angular_radius_rad > 0.0 {
                    cone_direction(centre, angular_radius_rad as f32, u)
                } else {
                    centre
                };
                // Over an even cone of half angle a the mean cosine to the axis is (1 + cos a)/2.
                let mean_cosine = 0.5 * (1.0 + angular_radius_rad.cos());
                LightSample {
                    direction,
                    distance_mm: f32::INFINITY,
                    relative_irradiance: (1.0 / mean_cosine) as f32,
                }
            }
            Light::Point { position_mm, .. } => {
                let offset = (position_mm - point_mm.as_dvec3()).as_vec3();
                let distance2 = offset.length_squared();
                let distance_mm = distance2.sqrt();
                LightSample {
                    direction: offset / distance_mm,
                    distance_mm,
                    relative_irradiance: 1.0 / distance2,
                }
            }
        }
    }
}

/// Uniform over the solid angle of a cone about `axis`; accurate for small angles.
fn cone_direction(axis: Vec3, half_angle_rad: f32, u: [f32; 2]) -> Vec3 {
    let s = (0.5 * half_angle_rad).sin();
    // 1 − cos θ, uniform up to 2 sin²(half/2).
    let versine = 2.0 * s * s * u[1];
    let sin = (versine * (2.0 - versine)).sqrt();
    let (sin_phi, cos_phi) = (std::f32::consts::TAU * u[0]).sin_cos();
    let (x, y) = axis.any_orthonormal_pair();
    (x * (sin * cos_phi) + y * (sin * sin_phi) + axis * (1.0 - versine)).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, stream};

    #[test]
    fn point_light_follows_the_inverse_square() {
        let light = Light::Point {
            position_mm: DVec3::new(0.0, 0.0, 300.0),
            intensity_mm2: [1.0; 3],
        };
        let near = light
            .sample(Vec3::new(0.0, 0.0, 9.0), [0.0; 2])
            .relative_irradiance;
        let far = light
            .sample(Vec3::new(0.0, 0.0, -9.0), [0.0; 2])
            .relative_irradiance;
        // 18 mm of depth at 300 mm change the irradiance by 13%.
        assert!((near / far - (309.0f32 / 291.0).powi(2)).abs() < 1e-5);
    }

    /// Mean cosine of a uniform cone of half angle a is (1 + cos a)/2.
    #[test]
    fn cone_is_uniform() {
        let axis = Vec3::new(0.6, 0.0, 0.8);
        let half = 0.3f32;
        // What the lamp promises, the irradiance across its axis, it brings.
        let lamp = Light::Directional {
            to_light: axis.as_dvec3(),
            irradiance: [1.0; 3],
            angular_radius_rad: f64::from(half),
        };
        let brought = lamp.sample(Vec3::ZERO, [0.1; 2]).relative_irradiance;
        assert!((brought * 0.5 * (1.0 + half.cos()) - 1.0).abs() < 1e-6);
        let mut numbers = stream(5, Purpose::Experiment, 0, 0, 0);
        let n = 100_000;
        let mut mean = 0.0;
        for _ in 0..n {
            let d = cone_direction(axis, half, [numbers.uniform_f32(), numbers.uniform_f32()]);
            let cos = d.dot(axis);
            assert!(cos >= half.cos() - 1e-6);
            mean += f64::from(cos) / f64::from(n);
        }
        let expected = f64::from(0.5 * (1.0 + half.cos()));
        let sigma = f64::from((1.0 - half.cos()) / 12f32.sqrt()) / f64::from(n).sqrt();
        assert!(
            (mean - expected).abs() < 5.0 * sigma,
            "{mean} against {expected} ± {sigma}"
        );
    }
}
