//! The GGX lobe of renderers, which differs from [`crate::brdf::ggx`] in its masking: light
//! and viewer are masked together (height-correlated Smith masking, Heitz 2014, Eq. 99).

use crate::brdf::ggx::{self, Cosines};
use crate::brdf::quadrature;

/// Nodes of a [`Curve`].
const NODES: usize = 16;
/// Facets per node.
const FACETS: u32 = 64;

/// A function of the cosine of the viewer's polar angle, linear between nodes that are denser
/// towards grazing angles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Curve([f64; NODES]);

impl Curve {
    /// From a function of that cosine, (0, 1].
    pub fn new(f: impl Fn(f64) -> f64) -> Self {
        let last = (NODES - 1) as f64;
        Self(std::array::from_fn(|k| {
            f((k as f64 / last).powi(2).max(1e-4))
        }))
    }

    /// The same value everywhere.
    pub fn constant(value: f64) -> Self {
        Self([value; NODES])
    }

    /// At a cosine, [0, 1].
    pub fn at(&self, cos: f64) -> f64 {
        let position = cos.clamp(0.0, 1.0).sqrt() * (NODES - 1) as f64;
        let low = (position as usize).min(NODES - 2);
        let part = position - low as f64;
        self.0[low] + part * (self.0[low + 1] - self.0[low])
    }

    /// Mean over the hemisphere, weighted by the cosine: ∫ 2c·f(c) dc.
    pub fn mean(&self) -> f64 {
        const STEPS: usize = 64;
        let at = |k: usize| {
            let cos = (k as f64 + 0.5) / STEPS as f64;
            2.0 * cos * self.at(cos)
        };
        (0..STEPS).map(at).sum::<f64>() / STEPS as f64
    }
}

/// Facets of one width.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lobe {
    /// Width α.
    pub alpha: f64,
}

impl Lobe {
    /// α = roughness².
    pub fn of_roughness(roughness: f64) -> Self {
        Self {
            alpha: roughness * roughness,
        }
    }

    /// D·G / (4 cos θi cos θo), 1/sr: the lobe without its Fresnel factor.
    pub fn value(&self, at: &Cosines<f64>) -> f64 {
        let alpha2 = self.alpha * self.alpha;
        let root = |cos: f64| (alpha2 + (1.0 - alpha2) * cos * cos).sqrt();
        let masked = at.cos_o * root(at.cos_i) + at.cos_i * root(at.cos_o);
        0.5 * ggx::distribution(self.alpha, at.sin2_h) / masked
    }

    /// What the lobe reflects of light from everywhere, by the viewer's angle: without a
    /// Fresnel factor (what is missing to 1 was masked), and with `fresnel`, a function of
    /// cos θd.
    pub fn albedo(&self, fresnel: impl Fn(f64) -> f64) -> (Curve, Curve) {
        let sums = |cos_o: f64| {
            let mut sums = [0.0; 2];
            for (cos_d, unmasked) in self.visible_facets(cos_o) {
                sums[0] += unmasked;
                sums[1] += unmasked * fresnel(cos_d);
            }
            sums.map(|sum| sum / f64::from(FACETS))
        };
        let nodes = Curve::new(|cos| cos).0.map(|cos| sums(cos.max(1e-4)));
        (
            Curve(nodes.map(|[bare, _]| bare)),
            Curve(nodes.map(|[_, reflecting]| reflecting)),
        )
    }

    /// Facets that a viewer sees, each with cos θd and the share of its light that is not
    /// masked on the way in.
    fn visible_facets(&self, cos_o: f64) -> impl Iterator<Item = (f64, f64)> {
        let alpha = self.alpha;
        let viewer = [(1.0 - cos_o * cos_o).max(0.0).sqrt(), 0.0, cos_o];
        // 1/G1 = 1 + Λ.
        let inverse_masking = move |cos: f64| 0.5 / (cos * ggx::masking_over_two_cos(alpha, cos));
        let of_viewer = inverse_masking(cos_o);
        (0..FACETS).filter_map(move |k| {
            let light =
                ggx::sample_visible(alpha, viewer, quadrature::point(k, FACETS, [0.5, 0.0]));
            if light[2] <= 0.0 {
                return None;
            }
            let cos_2d = light[0] * viewer[0] + light[2] * viewer[2];
            let cos_d = (0.5 * (1.0 + cos_2d)).clamp(0.0, 1.0).sqrt();
            let unmasked = of_viewer / (of_viewer + inverse_masking(light[2]) - 1.0);
            Some((cos_d, unmasked))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    /// The curves against a plain integral over the hemisphere of lights.
    #[test]
    fn albedo_is_the_integral_of_the_lobe() {
        for alpha in [0.05, 0.3, 0.9] {
            let lobe = Lobe { alpha };
            let (bare, glass) = lobe.albedo(|cos_d| ggx::fresnel(1.5, cos_d));
            for theta in [0.0f64, 0.6, 1.1, 1.4] {
                let viewer = DVec3::new(theta.sin(), 0.0, theta.cos());
                let mut want = [0.0; 2];
                for (light, weight) in quadrature::nodes(viewer, 4096, [0.2, 0.4]) {
                    let at = Cosines::new(light.to_array(), viewer.to_array()).unwrap();
                    let reflected = weight * light.z * lobe.value(&at);
                    want[0] += reflected;
                    want[1] += reflected * ggx::fresnel(1.5, at.cos_d);
                }
                let got = [bare.at(viewer.z), glass.at(viewer.z)];
                assert!(
                    (got[0] - want[0]).abs() < 0.012,
                    "{alpha} {theta} {got:?} {want:?}"
                );
                assert!(
                    (got[1] - want[1]).abs() < 0.006,
                    "{alpha} {theta} {got:?} {want:?}"
                );
            }
        }
    }

    /// A smooth surface masks nothing. Of light on a surface of α = 1 a bit more than half
    /// leaves after one reflection (Kulla and Conty 2017, figure of E(μ)).
    #[test]
    fn wide_lobes_lose_light_and_narrow_ones_none() {
        let (narrow, _) = Lobe { alpha: 0.01 }.albedo(|_| 1.0);
        assert!((narrow.mean() - 1.0).abs() < 0.01);
        let (wide, _) = Lobe { alpha: 1.0 }.albedo(|_| 1.0);
        assert!(wide.mean() > 0.4 && wide.mean() < 0.65, "{}", wide.mean());
    }

    #[test]
    fn a_curve_is_linear_between_its_nodes() {
        let line = Curve::new(|cos| 3.0 * cos.sqrt());
        for cos in [0.01, 0.2, 0.77, 1.0] {
            assert!((line.at(cos) - 3.0 * f64::sqrt(cos)).abs() < 1e-9);
        }
        assert!((Curve::constant(0.3).mean() - 0.3).abs() < 1e-12);
    }
}
