//! Reflectance: closed forms, the dictionary and its mixtures, measured
//! tables, and the checks that they are physical.
//!
//! All directions are in the local frame of the surface (+z is the normal) and
//! point away from it. Values are in 1/sr, cosine excluded, 0 below the horizon.

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
pub mod environment;
pub mod evaluator;
pub mod ggx;
pub mod half_difference;
pub mod in_span;
pub mod lobe_table;
pub mod merl;
pub mod mixture;
pub mod nbrdf;
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
