//! Reflectance: closed forms, dictionaries and their mixtures, measured materials, and how far
//! one BRDF is from another.
//!
//! A BRDF f(i, o) says how much of the irradiance that arrives from direction i leaves as
//! radiance in direction o. Here every BRDF is isotropic and implements [`Brdf`]. Conventions:
//!
//! - Directions are unit vectors in the local frame of the surface (+z is the normal) and point
//!   away from it, the one to the light as well as the one to the viewer.
//! - Values are in 1/sr, without the cosine, in R, G and B; 0 where either direction is below
//!   the horizon. Light with irradiance E on a surface perpendicular to it is reflected as the
//!   radiance L = f(i, o) · E · cos θi.
//! - Tables are over the half angle θh (normal to half vector), the difference angle θd (half
//!   vector to either direction) and φd ([`HalfDifference`]).
//!
//! A fit looks for a material as a mixture of the atoms of a [`Dictionary`],
//!
//! > f(i, o) = Σₙ wₙ fₙ(i, o), wₙ ≥ 0, Σₙ wₙ = 1 in each channel,
//!
//! where an [`Atom`] fₙ is a microfacet lobe, a diffuse surface or black. Radiance that was
//! reflected once is linear in the weights, after k reflections it is a polynomial of degree k.
//!
//! | type or function | what it is |
//! |---|---|
//! | [`Dictionary`], [`Atom`] | a list of closed forms, the basis of a fit |
//! | [`Mixture`] | weights of a dictionary per channel |
//! | [`discrepancy::Material`] | a mixture and by what a material differs from it: what a fit reports |
//! | [`TabulatedBrdf`], [`merl`], [`rgl`], [`nbrdf`] | measured materials |
//! | [`fitted::read`] | what a fit left |
//! | [`source::load`] | any of these by name or file |
//! | [`score`], [`sphere`], [`environment`] | errors between BRDFs, and the pictures behind them |
//! | [`plain_error`] | the same as albedo and height of the peak |
//! | [`check`] | whether a BRDF is physical |
//!
//! ```
//! use std::sync::Arc;
//! use glam::Vec3;
//! use rig_core::brdf::{Brdf, Dictionary, Mixture};
//!
//! let dictionary = Arc::new(Dictionary::paper42());
//! // 30% of a GGX lobe (alpha 0.3, eta 1.45), 50% white Lambertian, the rest black.
//! let mut weights = vec![0.0; dictionary.len()];
//! (weights[29], weights[40], weights[41]) = (0.3, 0.5, 0.2);
//! let material = Mixture::grey(dictionary, weights)?;
//!
//! let to_light = Vec3::new(0.5, 0.0, 0.75f32.sqrt());
//! let mirrored = Vec3::new(-0.5, 0.0, 0.75f32.sqrt());
//! let [highlight, ..] = material.eval(to_light, mirrored);
//! let [elsewhere, ..] = material.eval(to_light, to_light);
//! assert!(highlight > elsewhere && elsewhere > 0.5 / std::f32::consts::PI);
//! # Ok::<(), rig_core::brdf::BrdfError>(())
//! ```

use std::path::PathBuf;

use glam::Vec3;

pub mod atom;
pub mod beckmann;
pub mod bivariate;
pub mod check;
pub mod chi_square;
pub mod coat;
pub mod dictionary;
pub mod discrepancy;
pub mod energy;
pub mod environment;
pub mod error_curvature;
pub mod evaluator;
pub mod fitted;
pub mod ggx;
pub mod half_difference;
pub mod in_span;
pub mod lobe_table;
pub mod merl;
pub mod mixture;
pub mod nbrdf;
pub mod plain_error;
pub mod projection;
pub mod quadrature;
pub mod rgl;
pub mod score;
pub mod source;
pub mod sphere;
pub mod table;
pub mod weights;

pub use dictionary::{Atom, Dictionary};
pub use half_difference::HalfDifference;
pub use lobe_table::LobeTable;
pub use mixture::Mixture;
pub use source::load;
pub use table::TabulatedBrdf;

/// An isotropic BRDF in three colour channels.
///
/// ```
/// use glam::Vec3;
/// use rig_core::brdf::{Brdf, check};
///
/// /// Reflects half of the light, evenly, and red only.
/// struct RedChalk;
///
/// impl Brdf for RedChalk {
///     fn eval(&self, to_light: Vec3, to_viewer: Vec3) -> [f32; 3] {
///         match to_light.z > 0.0 && to_viewer.z > 0.0 {
///             true => [0.5 * std::f32::consts::FRAC_1_PI, 0.0, 0.0],
///             false => [0.0; 3],
///         }
///     }
/// }
///
/// let found = check::check_with(&RedChalk, 64, 100);
/// assert!(found.passes());
/// assert!((found.largest_albedo - 0.5).abs() < 0.01);
/// ```
pub trait Brdf: Send + Sync {
    /// f_r at `to_light` and `to_viewer` (unit, local frame), 1/sr, cosine excluded.
    fn eval(&self, to_light: Vec3, to_viewer: Vec3) -> [f32; 3];

    /// The closed forms it is made of, if it is.
    fn as_mixture(&self) -> Option<&Mixture> {
        None
    }
}

/// Largest table or environment map that is read, bytes: 4096 x 4096 cells of three f64.
const LARGEST_FILE_BYTES: u64 = 1 << 29;
/// Largest list of atoms or weights that is read, bytes.
const LARGEST_TEXT_BYTES: u64 = 1 << 20;

/// What is wrong with a BRDF or with the file that should hold one.
#[derive(Debug, thiserror::Error)]
pub enum BrdfError {
    /// A dictionary's atoms are not usable.
    #[error("dictionary {name}: {fact}")]
    Dictionary {
        /// Its name.
        name: String,
        /// What is wrong, with the value and what is allowed.
        fact: String,
    },
    /// Mixture weights are not on the simplex.
    #[error("mixture weights of channel {channel}: {fact}")]
    Weights {
        /// R, G or B.
        channel: &'static str,
        /// What is wrong, with the value and what is allowed.
        fact: String,
    },
    /// A table's values do not fit its shape.
    #[error("BRDF table: {fact}")]
    Table {
        /// What is wrong.
        fact: String,
    },
    /// A name or file type that no reader claims.
    #[error("\"{spec}\" is no BRDF or dictionary known here (known: {known})")]
    UnknownSource {
        /// As given.
        spec: String,
        /// What would have been understood.
        known: String,
    },
    /// The operating system refused.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Its reason.
        source: std::io::Error,
    },
    /// A file of the RGL database of a kind that is not read.
    #[error("{}: {kind}", path.display())]
    RglKind {
        /// The file.
        path: PathBuf,
        /// Which.
        kind: rgl::RglFault,
    },
    /// A file was read but does not hold what its type promises.
    #[error("{}: {fact}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong, with the value and what is allowed.
        fact: String,
    },
}
