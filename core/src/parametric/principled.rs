//! Blender's Principled BSDF since 4.0, as Cycles computes it.
//!
//! Its distribution is "Multiscatter GGX". The coat has no compensation for light lost between
//! facets, the base has that of Kulla and Conty 2017. The dielectric's reflectance runs between
//! tinted value at normal incidence and 1 as the real one does. `Specular IOR Level` is 0.5,
//! `Diffuse Roughness` (of later versions) 0.

use std::f64::consts::FRAC_1_PI;

use super::Directions;
use super::fresnel::{dielectric_share, dielectric_share_mean, f0_from_ior, f82, f82_mean};
use super::lobe::{Curve, Lobe};
use super::parameters::{COAT_IOR, Parameters};
use super::sheen::Fuzz;
use crate::brdf::ggx;

/// A material of the Principled BSDF.
#[derive(Clone, Debug)]
pub struct Principled {
    parameters: Parameters,
    fuzz: Fuzz,
    /// The coat, and the mean reflectance of its visible facets.
    coat: Option<(Lobe, Curve)>,
    base: Lobe,
    /// Its albedo, without a Fresnel factor and with the dielectric's share.
    albedos: (Curve, Curve),
    /// Light lost between the base's facets over light that is not.
    lost: Curve,
    /// How much of that returns, by channel.
    metal_returns: [f64; 3],
    dielectric_returns: [f64; 3],
    /// What passes the dielectric interface.
    passed: Curve,
}

impl Principled {
    /// With the tables that these parameters need, of an `old` material where it has them.
    pub fn new(parameters: &Parameters, old: Option<&Self>) -> Self {
        let p = parameters;
        let coat = (p.coat_weight > 0.0).then(|| {
            let coat = Lobe::of_roughness(p.coat_roughness);
            if let Some(old) = old.and_then(|old| old.coat).filter(|old| old.0 == coat) {
                return old;
            }
            let (bare, reflected) = coat.albedo(|cos_d| ggx::fresnel(COAT_IOR, cos_d));
            (coat, Curve::new(|cos| reflected.at(cos) / bare.at(cos)))
        });
        let base = Lobe::of_roughness(p.roughness);
        let old = old.filter(|old| old.base == base && old.parameters.ior == p.ior);
        let albedos = || base.albedo(|cos_d| dielectric_share(p.ior, cos_d));
        let (bare, weighted_share) = old.map_or_else(albedos, |old| old.albedos);
        let mean_bare = bare.mean();
        let returns = |mean: f64| mean * mean_bare / (1.0 - mean * (1.0 - mean_bare));
        let f0 = p.specular_color.map(|tint| tint * f0_from_ior(p.ior));
        let share = dielectric_share_mean(p.ior);
        let brightest = f0.into_iter().fold(0.0, f64::max);
        Self {
            parameters: *p,
            fuzz: Fuzz::of(p),
            coat,
            base,
            albedos: (bare, weighted_share),
            lost: Curve::new(|cos| (1.0 - bare.at(cos)) / bare.at(cos)),
            metal_returns: [0, 1, 2]
                .map(|c| returns(f82_mean(p.base_color[c], p.specular_color[c]))),
            dielectric_returns: f0.map(|f0| returns(f0 + share * (1.0 - f0))),
            passed: Curve::new(|cos| {
                let share = weighted_share.at(cos) / bare.at(cos);
                1.0 - (brightest + share * (1.0 - brightest))
            }),
        }
    }

    /// f of R, G, B, 1/sr.
    pub fn value(&self, to: &Directions) -> [f64; 3] {
        let p = &self.parameters;
        let (at, cos_o) = (&to.at, to.at.cos_o);
        // Fibres and coat, and what they leave.
        let (fuzz, mut left) = self.fuzz.value(to);
        let mut coat = 0.0;
        if let Some((lobe, reflects)) = &self.coat {
            coat = left * p.coat_weight * ggx::fresnel(COAT_IOR, at.cos_d) * lobe.value(at);
            left *= 1.0 - p.coat_weight * reflects.at(cos_o);
        }
        // The base.
        let (lobe, lost) = (self.base.value(at), self.lost.at(cos_o));
        let (f0, share) = (f0_from_ior(p.ior), dielectric_share(p.ior, at.cos_d));
        let passed = self.passed.at(cos_o);
        [0, 1, 2].map(|c| {
            let (color, tint) = (p.base_color[c], p.specular_color[c]);
            let metal = f82(color, tint, at.cos_d) * (1.0 + self.metal_returns[c] * lost);
            let glass = tint * f0 + share * (1.0 - tint * f0);
            let glass = lobe * glass * (1.0 + self.dielectric_returns[c] * lost);
            let dielectric = glass + passed * color * FRAC_1_PI;
            let base = p.metalness * lobe * metal + (1.0 - p.metalness) * dielectric;
            fuzz[c] + coat + left * base
        })
    }
}
