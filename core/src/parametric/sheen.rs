//! Fibres that stand on a surface: the sheen of fabrics.
//!
//! [`Microfiber`] is Zeltner, Burley and Chiang 2022, "Practical Multiple-Scattering Sheen
//! Using Linearly Transformed Cosines", which OpenPBR and Blender have; its three functions are
//! tabulated there, and here are the closed forms of those tables that MaterialX uses
//! (coefficients are theirs). [`Charlie`] is Estevez and Kulla 2017, "Production Friendly
//! Microfacet Sheen BRDF", which glTF has.

use std::f64::consts::{FRAC_1_PI, PI};

use glam::DVec3;

use super::Directions;
use super::lobe::Curve;
use super::parameters::Parameters;
use crate::brdf::quadrature;

/// The sheen of OpenPBR and Blender, of colour 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Microfiber {
    roughness: f64,
}

impl Microfiber {
    /// Roughness 0.1 to 1; below, the closed forms are not those of the tables.
    pub fn new(roughness: f64) -> Self {
        Self { roughness }
    }

    /// Share of light from everywhere that is reflected to a viewer.
    pub fn albedo(&self, cos_o: f64) -> f64 {
        let (x, y) = (cos_o, self.roughness);
        let width = y * (0.0206607 + 1.58491 * y) / (0.0379424 + y * (1.32227 + y));
        let centre =
            y * (-0.193854 + y * (-1.14885 + y * (1.7932 - 0.95943 * y * y))) / (0.046391 + y);
        let floor =
            y * (0.000654023 + (-0.0207818 + 0.119681 * y) * y) / (1.26264 + y * (-1.92021 + y));
        let z = (x - centre) / width;
        ((-0.5 * z * z).exp() / (width * (2.0 * PI).sqrt()) + floor).max(0.0)
    }

    /// f, 1/sr.
    pub fn value(&self, to: &Directions) -> f64 {
        let (x, y) = (to.at.cos_o, self.roughness);
        let scale = (2.58126 * x + 0.813703 * y) * y / (1.0 + 0.310327 * x * x + 2.60994 * x * y);
        let shear = (1.0 - x).max(0.0).sqrt() * (y - 1.0) * y * y * y
            / (0.0000254053 + 1.71228 * x - 1.71506 * x * y + 1.34174 * y * y);
        // The light, sheared and scaled back to a cosine lobe.
        let [along, across, up] = to.light_beside_viewer;
        let sheared = scale * along + shear * up;
        let length2 = sheared * sheared + (scale * across).powi(2) + up * up;
        self.albedo(x) * FRAC_1_PI * (scale / length2).powi(2)
    }
}

/// The fibres of OpenPBR and Blender over a material, in their colour and weight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fuzz {
    weight: f64,
    color: [f64; 3],
    fibres: Microfiber,
}

impl Fuzz {
    /// Those of a material.
    pub fn of(parameters: &Parameters) -> Self {
        let (weight, color) = parameters.fuzz_weight_and_color();
        let fibres = Microfiber::new(parameters.fuzz_roughness);
        Self {
            weight,
            color,
            fibres,
        }
    }

    /// f of R, G, B, 1/sr, and the share of light that they leave to what is below.
    pub fn value(&self, to: &Directions) -> ([f64; 3], f64) {
        if self.weight == 0.0 {
            return ([0.0; 3], 1.0);
        }
        let value = self.weight * self.fibres.value(to);
        let left = 1.0 - self.weight * self.fibres.albedo(to.at.cos_o);
        (self.color.map(|color| color * value), left)
    }
}

/// The sheen of glTF, of colour 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Charlie {
    /// Width α = roughness².
    alpha: f64,
}

impl Charlie {
    /// Roughness 0.1 to 1.
    pub fn new(roughness: f64) -> Self {
        Self {
            alpha: roughness * roughness,
        }
    }

    /// f, 1/sr.
    pub fn value(&self, to: &Directions) -> f64 {
        let exponent = 1.0 / self.alpha;
        let distribution = (2.0 + exponent) * to.at.sin2_h.powf(0.5 * exponent) / (2.0 * PI);
        let masking = 1.0 + self.lambda(to.at.cos_i) + self.lambda(to.at.cos_o);
        distribution / (4.0 * to.at.cos_i * to.at.cos_o * masking)
    }

    /// Λ of the masking, a curve through their numerical integrals.
    fn lambda(&self, cos: f64) -> f64 {
        if cos < 0.5 {
            self.log_lambda(cos).exp()
        } else {
            (2.0 * self.log_lambda(0.5) - self.log_lambda(1.0 - cos)).exp()
        }
    }

    fn log_lambda(&self, x: f64) -> f64 {
        let smooth = (1.0 - self.alpha).powi(2);
        let between = |rough: f64, fine: f64| rough + smooth * (fine - rough);
        let a = between(21.5473, 25.3245);
        let b = between(3.82987, 3.32435);
        let c = between(0.19823, 0.16801);
        let d = between(-1.97760, -1.27393);
        let e = between(-4.32054, -4.85967);
        a / (1.0 + b * x.powf(c)) + d * x + e
    }

    /// Share of light from everywhere that is reflected to a viewer, by its angle.
    pub fn albedo(&self) -> Curve {
        const DIRECTIONS: u32 = 256;
        Curve::new(|cos_o| {
            let viewer = DVec3::new((1.0 - cos_o * cos_o).max(0.0).sqrt(), 0.0, cos_o);
            // Lights evenly over the hemisphere: the lobe is at grazing angles.
            let sum: f64 = (0..DIRECTIONS)
                .filter_map(|k| {
                    let [u, height] = quadrature::point(k, DIRECTIONS, [0.5, 0.0]);
                    let (sin_phi, cos_phi) = (2.0 * PI * u).sin_cos();
                    let sin = (1.0 - height * height).sqrt();
                    let light = DVec3::new(sin * cos_phi, sin * sin_phi, height);
                    Some(height * self.value(&Directions::new(light, viewer)?))
                })
                .sum();
            (2.0 * PI * sum / f64::from(DIRECTIONS)).min(1.0)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn albedo(value: impl Fn(&Directions) -> f64, theta: f64) -> f64 {
        let viewer = DVec3::new(theta.sin(), 0.0, theta.cos());
        quadrature::nodes(viewer, 4096, [0.2, 0.4])
            .filter_map(|(light, weight)| {
                Some(weight * light.z * value(&Directions::new(light, viewer)?))
            })
            .sum()
    }

    /// A sheared cosine lobe reflects what its albedo says, but for what falls below the horizon.
    #[test]
    fn albedo_is_the_integral() {
        for roughness in [0.2, 0.5, 1.0] {
            for theta in [0.1, 0.8, 1.3] {
                let fibres = Microfiber::new(roughness);
                let want = albedo(|to| fibres.value(to), theta);
                let got = fibres.albedo(theta.cos());
                assert!(
                    (got - want).abs() < 0.01 * want,
                    "{roughness} {theta}: {got} {want}"
                );
                let charlie = Charlie::new(roughness);
                let want = albedo(|to| charlie.value(to), theta);
                let got = charlie.albedo().at(theta.cos());
                assert!(
                    (got - want).abs() < 0.02,
                    "{roughness} {theta}: {got} {want}"
                );
            }
        }
    }

    /// Sheen is brightest at grazing angles, and of little weight where one looks straight.
    #[test]
    fn fibres_shine_at_grazing_angles() {
        let fibres = Microfiber::new(0.3);
        assert!(fibres.albedo(0.1) > 4.0 * fibres.albedo(1.0));
        let charlie = Charlie::new(0.5).albedo();
        assert!(charlie.at(0.1) > 2.0 * charlie.at(1.0));
    }
}
