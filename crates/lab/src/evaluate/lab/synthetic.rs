//! Bright closed forms that are in no dictionary: targets of strong interreflection.
//!
//! Each is the sum of a rough diffuse part, flatter towards grazing and brighter
//! towards the lamp than Lambert's, and of GGX lobes whose widths and indices lie
//! between those of the dictionaries. Directional albedos lie between 0.6 and 0.95
//! (tested), so that paths of many reflections matter. All are reciprocal.

use glam::Vec3;

use crate::brdf::Brdf;
use crate::brdf::ggx::{self, Cosines};

/// Names of the targets.
pub const NAMES: [&str; 5] = [
    "white-plaster",
    "cream-satin",
    "bright-enamel",
    "satin-metal",
    "pink-ceramic",
];

/// One of the targets.
pub struct Synthetic {
    /// Albedo of the diffuse part at normal incidence per channel, 0..1.
    diffuse: [f32; 3],
    /// Standard deviation of the diffuse part's slopes, radians.
    roughness: f32,
    /// (weight per channel, alpha, eta).
    lobes: &'static [([f32; 3], f32, f32)],
}

/// One of [`NAMES`]; `None` for any other.
pub fn named(name: &str) -> Option<Synthetic> {
    let (diffuse, roughness, lobes): (_, _, &'static [_]) = match name {
        "white-plaster" => ([0.93, 0.91, 0.87], 0.45, &[]),
        "cream-satin" => ([0.80, 0.74, 0.62], 0.25, &[([0.7; 3], 0.23, 1.55)]),
        "bright-enamel" => ([0.70, 0.71, 0.72], 0.10, &[([0.8; 3], 0.045, 1.48)]),
        "satin-metal" => (
            [0.08, 0.07, 0.06],
            0.2,
            &[([0.80, 0.76, 0.70], 0.19, 26.0), ([0.06; 3], 0.07, 11.0)],
        ),
        "pink-ceramic" => (
            [0.72, 0.52, 0.54],
            0.15,
            &[([0.45; 3], 0.075, 1.7), ([0.35; 3], 0.38, 1.42)],
        ),
        _ => return None,
    };
    Some(Synthetic {
        diffuse,
        roughness,
        lobes,
    })
}

impl Brdf for Synthetic {
    fn eval(&self, to_light: Vec3, to_viewer: Vec3) -> [f32; 3] {
        let Some(at) = Cosines::new(to_light.to_array(), to_viewer.to_array()) else {
            return [0.0; 3];
        };
        let rough = rough_diffuse(self.roughness, to_light, to_viewer);
        let mut f = self.diffuse.map(|albedo| albedo * rough);
        for &(weights, alpha, eta) in self.lobes {
            let lobe = ggx::eval(alpha, eta, &at);
            for (f, weight) in f.iter_mut().zip(weights) {
                *f += weight * lobe;
            }
        }
        f
    }
}

/// The qualitative model of Oren and Nayar (1994) in Fujii's form: with
/// s = cos of the angle between the directions − cos θi cos θo, and
/// t = max(cos θi, cos θo) where s > 0, else 1,
/// f = (A + B s/t)/π, A = 1/(1 + (1/2 − 2/(3π)) σ), B = σ A.
fn rough_diffuse(sigma: f32, i: Vec3, o: Vec3) -> f32 {
    use std::f32::consts::{FRAC_1_PI, PI};
    let s = i.dot(o) - i.z * o.z;
    let t = if s > 0.0 { i.z.max(o.z) } else { 1.0 };
    let a = 1.0 / (1.0 + (0.5 - 2.0 / (3.0 * PI)) * sigma);
    FRAC_1_PI * a * (1.0 + sigma * s / t)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::brdf::check;
    use glam::DVec3;

    #[test]
    fn albedos_are_those_of_strong_interreflection_and_reciprocal() {
        for name in NAMES {
            let brdf = named(name).unwrap();
            let mut brightest = 0.0f64;
            for deg in [0.0f64, 30.0, 60.0, 75.0] {
                let theta = deg.to_radians();
                let from = DVec3::new(theta.sin(), 0.0, theta.cos());
                let albedo = check::directional_albedo(&brdf, from, 4096);
                brightest = albedo.into_iter().fold(brightest, f64::max);
                assert!(
                    albedo.iter().all(|&a| a < 0.97),
                    "{name} at {deg}°: {albedo:?}"
                );
            }
            assert!((0.6..=0.95).contains(&brightest), "{name}: {brightest}");
            let (i, o) = (Vec3::new(0.6, 0.0, 0.8), Vec3::new(-0.48, 0.36, 0.8));
            let (there, back) = (brdf.eval(i, o), brdf.eval(o, i));
            assert!((0..3).all(|c| (there[c] - back[c]).abs() < 1e-6 * there[c]));
        }
        assert!(named("gold").is_none());
    }
}
