//! Oren and Nayar's rough diffuse surface with its interreflections, as OpenPBR has it:
//! Portsmouth, Kutz and Hill 2024, "EON: A practical energy-preserving rough diffuse BRDF".

use std::f64::consts::{FRAC_1_PI, PI};

/// 1/2 − 2/(3π): how much darker a rough surface of albedo 1 is without interreflections.
const SINGLE: f64 = 0.5 - 2.0 / (3.0 * PI);
/// 2/3 − 28/(15π): the same for the mean albedo.
const MEAN: f64 = 2.0 / 3.0 - 28.0 / (15.0 * PI);

/// A rough diffuse surface of any colour.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RoughDiffuse {
    roughness: f64,
    scale: f64,
    mean_albedo: f64,
}

impl RoughDiffuse {
    /// Roughness 0 (Lambertian) to 1.
    pub fn new(roughness: f64) -> Self {
        let scale = 1.0 / (1.0 + SINGLE * roughness);
        Self {
            roughness,
            scale,
            mean_albedo: scale * (1.0 + MEAN * roughness),
        }
    }

    /// Parts of the reflectance at a pair of directions; `cos_io` is the cosine between them.
    pub fn at(&self, cos_i: f64, cos_o: f64, cos_io: f64) -> RoughDiffuseAt {
        if self.roughness == 0.0 {
            return RoughDiffuseAt {
                once: FRAC_1_PI,
                again: 0.0,
                mean_albedo: 1.0,
            };
        }
        let s = cos_io - cos_i * cos_o;
        let ratio = if s > 0.0 { s / cos_i.max(cos_o) } else { s };
        let dark = |cos: f64| (1.0 - self.albedo(cos)).max(1e-9);
        let between = dark(cos_i) * dark(cos_o) / (1.0 - self.mean_albedo).max(1e-9);
        RoughDiffuseAt {
            once: FRAC_1_PI * self.scale * (1.0 + self.roughness * ratio),
            again: FRAC_1_PI * between,
            mean_albedo: self.mean_albedo,
        }
    }

    /// Reflected once, of light from everywhere, by a surface of colour 1.
    fn albedo(&self, cos: f64) -> f64 {
        let cos = cos.clamp(1e-4, 1.0);
        let sin = (1.0 - cos * cos).max(0.0).sqrt();
        let lune = sin * (cos.acos() - sin * cos)
            + 2.0 / 3.0 * (sin / cos * (1.0 - sin * sin * sin) - sin);
        self.scale * (1.0 + self.roughness * FRAC_1_PI * lune)
    }
}

/// A [`RoughDiffuse`] at one pair of directions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RoughDiffuseAt {
    once: f64,
    again: f64,
    mean_albedo: f64,
}

impl RoughDiffuseAt {
    /// f of a surface of this colour, 1/sr.
    pub fn of_color(&self, color: f64) -> f64 {
        let again = color * color * self.mean_albedo / (1.0 - color * (1.0 - self.mean_albedo));
        color * self.once + again * self.again
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::brdf::quadrature;
    use glam::DVec3;

    /// In a white furnace a white surface does not show, however rough.
    #[test]
    fn a_white_surface_reflects_all_light() {
        for roughness in [0.0, 0.3, 1.0] {
            let surface = RoughDiffuse::new(roughness);
            for theta in [0.0f64, 0.7, 1.3] {
                let viewer = DVec3::new(theta.sin(), 0.0, theta.cos());
                let reflected: f64 = quadrature::nodes(viewer, 4096, [0.2, 0.4])
                    .map(|(light, weight)| {
                        let at = surface.at(light.z, viewer.z, light.dot(viewer));
                        weight * light.z * at.of_color(1.0)
                    })
                    .sum();
                assert!(
                    (reflected - 1.0).abs() < 4e-3,
                    "{roughness} {theta}: {reflected}"
                );
            }
        }
    }

    #[test]
    fn rough_surfaces_are_flatter() {
        let rough = RoughDiffuse::new(1.0);
        let (sin, cos) = 1.2f64.sin_cos();
        let back = rough.at(cos, cos, 1.0).of_color(0.5);
        let forward = rough.at(cos, cos, cos * cos - sin * sin).of_color(0.5);
        assert!(back > 1.5 * forward, "{back} {forward}");
        let smooth = RoughDiffuse::new(0.0).at(cos, cos, 1.0).of_color(0.5);
        assert!((smooth - 0.5 * FRAC_1_PI).abs() < 1e-12);
    }
}
