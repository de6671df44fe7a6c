//! Materials of other programs: their parametric models, a fit of one to any BRDF, and what
//! the fit loses.
//!
//! | model | of | differs in |
//! |---|---|---|
//! | [`OpenPbr`](Model::OpenPbr) | OpenPBR 1.1 in MaterialX | rough diffuse ground, coat that blurs what is below, light between facets given back |
//! | [`Principled`](Model::Principled) | Blender 4.0 and later | Lambertian ground, the same without blur |
//! | [`Gltf`](Model::Gltf) | glTF 2.0 | Schlick's reflectances, nothing given back |
//!
//! All have one list of [`Parameters`]. In all of them α = roughness², facets are GGX with
//! masking that is correlated between light and viewer, and what a layer reflects to the viewer
//! is missing below it; they are not exactly reciprocal. Each was compared with another's
//! program (docs/adr/0044).
//!
//! ```
//! use rig_core::brdf::source;
//! use rig_core::parametric::{Loss, Model, fit};
//!
//! let paint = source::load("nbrdf:dark-red-paint")?;
//! let found = fit(paint.as_ref(), Model::Principled)?;
//! let [red, green, _] = found.parameters.base_color;
//! assert!(red > 2.0 * green);
//! let loss = Loss::of(&found.brdf(), paint.as_ref(), 16);
//! assert!(loss.environment.mean.all < 0.2);
//! # Ok::<_, Box<dyn std::error::Error>>(())
//! ```

mod diffuse;
mod directions;
mod fit;
mod fresnel;
mod gltf;
mod lobe;
mod loss;
mod open_pbr;
mod parameters;
mod principled;
mod residuals;
mod sheen;

use glam::Vec3;

pub use diffuse::RoughDiffuse;
pub use directions::Directions;
pub use fit::{FitError, Fitted, closest, fit, fit_shown};
pub use lobe::{Curve, Lobe};
pub use loss::{AlbedoPair, Loss, WorstAngle};
pub use parameters::{COAT_IOR, COUNT, LEAST_ROUGHNESS, LIMITS, Parameters, USUAL_IOR};
pub use sheen::{Charlie, Microfiber};

use crate::brdf::Brdf;

/// Whose conventions the parameters follow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Model {
    /// OpenPBR Surface 1.1.
    OpenPbr,
    /// Blender's Principled BSDF since 4.0.
    Principled,
    /// glTF 2.0's metallic roughness with extensions.
    Gltf,
}

/// A material of one of the models.
///
/// ```
/// use glam::Vec3;
/// use rig_core::brdf::Brdf;
/// use rig_core::parametric::{Model, ParametricBrdf, Parameters};
///
/// let chalk = Parameters { ior: 1.0, ..Parameters::default() };
/// let [f, ..] = ParametricBrdf::new(Model::Gltf, &chalk).eval(Vec3::Z, Vec3::Z);
/// // The grazing reflectance of Schlick's curve is all that is left of the interface.
/// assert!((f - 0.5 / std::f32::consts::PI).abs() < 1e-6);
/// ```
#[derive(Clone, Debug)]
pub struct ParametricBrdf(Prepared);

#[derive(Clone, Debug)]
enum Prepared {
    OpenPbr(open_pbr::OpenPbr),
    Principled(principled::Principled),
    Gltf(gltf::Gltf),
}

impl ParametricBrdf {
    /// With the tables that these parameters need.
    pub fn new(model: Model, parameters: &Parameters) -> Self {
        Self(match model {
            Model::OpenPbr => Prepared::OpenPbr(open_pbr::OpenPbr::new(parameters, None)),
            Model::Principled => {
                Prepared::Principled(principled::Principled::new(parameters, None))
            }
            Model::Gltf => Prepared::Gltf(gltf::Gltf::new(parameters, None)),
        })
    }

    /// The same model with other parameters; tables that both need are not made again.
    pub fn with(&self, parameters: &Parameters) -> Self {
        Self(match &self.0 {
            Prepared::OpenPbr(old) => {
                Prepared::OpenPbr(open_pbr::OpenPbr::new(parameters, Some(old)))
            }
            Prepared::Principled(old) => {
                Prepared::Principled(principled::Principled::new(parameters, Some(old)))
            }
            Prepared::Gltf(old) => Prepared::Gltf(gltf::Gltf::new(parameters, Some(old))),
        })
    }

    /// f of R, G, B, 1/sr.
    pub fn value(&self, to: &Directions) -> [f64; 3] {
        match &self.0 {
            Prepared::OpenPbr(material) => material.value(to),
            Prepared::Principled(material) => material.value(to),
            Prepared::Gltf(material) => material.value(to),
        }
    }
}

impl Brdf for ParametricBrdf {
    fn eval(&self, to_light: Vec3, to_viewer: Vec3) -> [f32; 3] {
        match Directions::new(to_light.as_dvec3(), to_viewer.as_dvec3()) {
            Some(to) => self.value(&to).map(|f| f as f32),
            None => [0.0; 3],
        }
    }
}

#[cfg(test)]
mod tests;
