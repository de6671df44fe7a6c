//! What can be done with one BRDF from a file, a name or a fit: evaluate it, check it,
//! compare it with another, project it onto a dictionary, draw it alone or over others.

mod angles;
mod check;
mod comparison;
mod errors;
mod named;
#[cfg(feature = "figures")]
pub mod pictures;

use std::path::{Path, PathBuf};
use std::sync::Arc;

pub use angles::{Angles, Evaluated, evaluate, parse_angles, read_angles};
pub use check::{MaterialCheck, SAMPLER_ANGLES_DEG, check_material};
pub use comparison::{
    Comparison, ConstrainedComparison, ConstrainedError, compare, compare_constrained,
};
pub use errors::{Errors, Projected, errors_between, project};
pub use named::Named;

use crate::brdf::environment::EnvironmentMap;
use crate::brdf::projection::ProjectionError;
use crate::brdf::sphere::{GreyCard, sphere_images};
use crate::brdf::{Brdf, BrdfError, nbrdf, source};
use crate::session::fit_record::{self, FitRecordError};

/// Why nothing could be done with a BRDF.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum MaterialError {
    /// The fit that should give it.
    #[error(transparent)]
    Fit(#[from] FitRecordError),
    /// The file or name that should give it.
    #[error(transparent)]
    Brdf(#[from] BrdfError),
    #[error("no embedded material \"{name}\"")]
    UnknownMaterial { name: String },
    /// The projection onto a dictionary.
    #[error(transparent)]
    Projection(#[from] ProjectionError),
    /// A file of angles that could not be read.
    #[error("{}: {fact}", path.display())]
    File { path: PathBuf, fact: String },
    /// A file of angles whose content is wrong.
    #[error("{}: {fact}", path.display())]
    Angles { path: PathBuf, fact: String },
}

/// Pixels a side of a drawn sphere unless other sizes are asked for.
pub const DRAWN_SPHERE_PX: usize = 256;

/// The BRDF that `spec` names: the folder of a fit, a session (its latest fit), or what
/// [`source::load`] takes.
///
/// # Errors
/// A name or file that stands for no BRDF.
pub fn load(spec: &str) -> Result<Arc<dyn Brdf>, MaterialError> {
    let folder = Path::new(spec);
    if folder.is_dir() {
        return Ok(fit_record::find(folder)?.material()?);
    }
    if let Some(name) = spec.strip_prefix("nbrdf:")
        && !nbrdf::NAMES.contains(&name)
    {
        return Err(MaterialError::UnknownMaterial {
            name: name.to_owned(),
        });
    }
    Ok(source::load(spec)?.into())
}

/// Spheres of the material under the environment maps side by side, each `size_px` pixels
/// a side and in the exposure that is neutral under its map.
pub fn spheres(brdf: &dyn Brdf, size_px: usize) -> image::RgbImage {
    let maps = EnvironmentMap::all();
    let mut picture = image::RgbImage::new((size_px * maps.len()) as u32, size_px as u32);
    let images = sphere_images(&[brdf, &GreyCard], &maps, size_px);
    for (column, under) in images.iter().enumerate() {
        let pixels = under[0].to_srgb(under[1].neutral_exposure());
        for (pixel, rgb) in pixels.into_iter().enumerate() {
            let x = (column * size_px + pixel % size_px) as u32;
            picture.put_pixel(x, (pixel / size_px) as u32, image::Rgb(rgb));
        }
    }
    picture
}
