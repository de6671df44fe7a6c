//! glTF 2.0's metallic-roughness material with the extensions KHR_materials_ior, _specular,
//! _clearcoat and _sheen, by the formulas of their specifications: Schlick's reflectances, no
//! compensation for light lost between facets.

use std::f64::consts::FRAC_1_PI;

use super::Directions;
use super::fresnel::{f0_from_ior, schlick, schlick_share};
use super::lobe::{Curve, Lobe};
use super::parameters::{COAT_IOR, Parameters};
use super::sheen::Charlie;

/// A material of glTF.
#[derive(Clone, Debug)]
pub struct Gltf {
    parameters: Parameters,
    fuzz: (f64, Charlie, Curve),
    coat: Lobe,
    base: Lobe,
    /// Share of the dielectric's reflection, at all angles.
    specular_weight: f64,
    /// Its reflectance at normal incidence without that share.
    f0: [f64; 3],
}

impl Gltf {
    /// With the tables that these parameters need, of an `old` material where it has them.
    pub fn new(parameters: &Parameters, old: Option<&Self>) -> Self {
        let p = parameters;
        let (fuzz_weight, _) = p.fuzz_weight_and_color();
        let (specular_weight, specular_color) = p.specular_weight_and_color();
        let fibres = Charlie::new(p.fuzz_roughness);
        let old = old.filter(|old| old.fuzz.0 > 0.0 && old.fuzz.1 == fibres);
        let albedo = match (fuzz_weight > 0.0, old) {
            (true, Some(old)) => old.fuzz.2,
            (true, None) => fibres.albedo(),
            (false, _) => Curve::constant(0.0),
        };
        Self {
            parameters: *p,
            fuzz: (fuzz_weight, fibres, albedo),
            coat: Lobe::of_roughness(p.coat_roughness),
            base: Lobe::of_roughness(p.roughness),
            specular_weight,
            f0: specular_color.map(|tint| tint * f0_from_ior(p.ior)),
        }
    }

    /// f of R, G, B, 1/sr.
    pub fn value(&self, to: &Directions) -> [f64; 3] {
        let p = &self.parameters;
        let at = &to.at;
        // Fibres and coat, and what they leave.
        let (fuzz_weight, fibres, albedo) = &self.fuzz;
        let (mut sheen, mut left) = (0.0, 1.0);
        if *fuzz_weight > 0.0 {
            sheen = fibres.value(to);
            left -= fuzz_weight * albedo.at(at.cos_o);
        }
        let mut coat = 0.0;
        if p.coat_weight > 0.0 {
            // By the viewer's angle, not by the facet's.
            let reflected = p.coat_weight * schlick(f0_from_ior(COAT_IOR), at.cos_o);
            coat = left * reflected * self.coat.value(at);
            left *= 1.0 - reflected;
        }
        // The base.
        let lobe = self.base.value(at);
        let share = schlick_share(at.cos_d);
        let brightest = self.f0.into_iter().fold(0.0, f64::max);
        let passed = 1.0 - self.specular_weight * (brightest + share * (1.0 - brightest));
        let lobe_of_glass = self.specular_weight * lobe;
        [0, 1, 2].map(|c| {
            let metal = lobe * schlick(p.base_color[c], at.cos_d);
            let glass = lobe_of_glass * (self.f0[c] + share * (1.0 - self.f0[c]));
            let dielectric = glass + passed * p.base_color[c] * FRAC_1_PI;
            let base = p.metalness * metal + (1.0 - p.metalness) * dielectric;
            p.fuzz[c] * sheen + coat + left * base
        })
    }
}
