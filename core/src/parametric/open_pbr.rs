//! OpenPBR Surface 1.1, as MaterialX 1.39's `open_pbr_surface` computes it.
//!
//! From the top: fibres, a clear coat, and a base that is metal or a dielectric over a rough
//! diffuse ground. What a layer reflects to the viewer is missing below it. `specular_weight`
//! and `base_weight` are 1, `coat_color` is white and `coat_darkening` 0: base colours are
//! those seen under the coat.

use super::Directions;
use super::diffuse::RoughDiffuse;
use super::fresnel::f82;
use super::lobe::{Curve, Lobe};
use super::parameters::{COAT_IOR, Parameters};
use super::sheen::Fuzz;
use crate::brdf::ggx;

/// A material of OpenPBR.
#[derive(Clone, Debug)]
pub struct OpenPbr {
    parameters: Parameters,
    fuzz: Fuzz,
    coat: Option<Layer>,
    base: Layer,
    diffuse: RoughDiffuse,
}

/// An interface of a dielectric, or of a metal of the same roughness.
#[derive(Clone, Debug)]
struct Layer {
    lobe: Lobe,
    ior: f64,
    /// Light lost between facets over light that is not, by the viewer's angle: Turquin 2019
    /// gives it back in the colour of the reflection.
    lost: Curve,
    /// What passes the dielectric interface.
    passed: Curve,
}

impl Layer {
    fn new(roughness: f64, ior: f64, old: Option<&Self>) -> Self {
        let lobe = Lobe::of_roughness(roughness);
        if let Some(old) = old.filter(|old| old.lobe == lobe && old.ior == ior) {
            return old.clone();
        }
        let (bare, reflected) = lobe.albedo(|cos_d| ggx::fresnel(ior, cos_d));
        let lost = Curve::new(|cos| (1.0 - bare.at(cos)) / bare.at(cos));
        let passed = Curve::new(|cos| {
            let mean_fresnel = reflected.at(cos) / bare.at(cos);
            1.0 - reflected.at(cos) * (1.0 + mean_fresnel * lost.at(cos))
        });
        Self {
            lobe,
            ior,
            lost,
            passed,
        }
    }

    /// f of a reflectance F at these facets, 1/sr.
    fn value(lobe: f64, lost: f64, fresnel: f64) -> f64 {
        lobe * fresnel * (1.0 + fresnel * lost)
    }
}

impl OpenPbr {
    /// With the tables that these parameters need, of an `old` material where it has them.
    pub fn new(parameters: &Parameters, old: Option<&Self>) -> Self {
        let p = parameters;
        let mix = |a: f64, b: f64| a + p.coat_weight * (b - a);
        // A rough coat blurs what is below, and the base's contrast is to the coat, not to air.
        let blurred = (p.roughness.powi(4) + 2.0 * p.coat_roughness.powi(4)).min(1.0);
        let below = (p.ior / COAT_IOR).max(COAT_IOR / p.ior);
        let (roughness, ior) = (mix(p.roughness, blurred.powf(0.25)), mix(p.ior, below));
        let old_coat = old.and_then(|old| old.coat.as_ref());
        Self {
            parameters: *p,
            fuzz: Fuzz::of(p),
            coat: (p.coat_weight > 0.0).then(|| Layer::new(p.coat_roughness, COAT_IOR, old_coat)),
            base: Layer::new(roughness, ior, old.map(|old| &old.base)),
            diffuse: RoughDiffuse::new(p.diffuse_roughness),
        }
    }

    /// f of R, G, B, 1/sr.
    pub fn value(&self, to: &Directions) -> [f64; 3] {
        let p = &self.parameters;
        let (at, cos_o) = (&to.at, to.at.cos_o);
        // Fibres and coat, and what they leave.
        let (fuzz, mut left) = self.fuzz.value(to);
        let mut coat = 0.0;
        if let Some(layer) = &self.coat {
            let fresnel = ggx::fresnel(layer.ior, at.cos_d);
            coat = Layer::value(layer.lobe.value(at), layer.lost.at(cos_o), fresnel);
            coat *= p.coat_weight * left;
            left *= 1.0 - p.coat_weight * (1.0 - layer.passed.at(cos_o));
        }
        // The base.
        let layer = &self.base;
        let (lobe, lost) = (layer.lobe.value(at), layer.lost.at(cos_o));
        let glass = Layer::value(lobe, lost, ggx::fresnel(layer.ior, at.cos_d));
        let passed = layer.passed.at(cos_o);
        let diffuse = self.diffuse.at(at.cos_i, cos_o, to.cos_io);
        [0, 1, 2].map(|c| {
            let (color, tint) = (p.base_color[c], p.specular_color[c]);
            let metal = Layer::value(lobe, lost, f82(color, tint, at.cos_d));
            let dielectric = tint * glass + passed * diffuse.of_color(color);
            let base = p.metalness * metal + (1.0 - p.metalness) * dielectric;
            fuzz[c] + coat + left * base
        })
    }
}
