//! Captured images averaged over a scene's cells while they are read: a few rows of all lights
//! at a time, so that no image is ever in memory whole.

use std::io::{Read, Seek};
use std::path::Path;

use super::{CliError, HintExt, bracket_files, hints};
use crate::inverse::cells::{AverageError, Averager, Captured, CellOptions, choose};
use crate::radiance_image::RadianceImage;
use crate::radiance_image::exr::{ExrError, ExrRows};
use crate::transport::Scene;

/// Rows that are read together.
const ROWS: usize = 16;

/// Relative noise that images without a stated variance are taken to have.
pub const UNSTATED_NOISE: f32 = 0.005;
/// Radiance over the mean below which that noise is no smaller: nothing is known without any
/// error.
const DARK: f32 = 1e-3;

/// An image that is about to be read.
pub struct Source<R> {
    /// Its rows.
    pub rows: ExrRows<R>,
    /// Its name in messages.
    pub file: String,
    /// Mean radiance, where the file states no variance.
    pub mean_of_unstated: Option<f32>,
}

impl<R: Read + Seek> Source<R> {
    /// Of a reader whose file states variances, or of one whose whole image `again` reads.
    ///
    /// # Errors
    /// The image cannot be read.
    pub fn new(
        rows: ExrRows<R>,
        file: String,
        again: impl FnOnce() -> Result<ExrRows<R>, ExrError>,
    ) -> Result<Self, ExrError> {
        let mean_of_unstated = match rows.has_variance() {
            true => None,
            false => Some(mean_radiance(&mut again()?)?),
        };
        Ok(Self {
            rows,
            file,
            mean_of_unstated,
        })
    }

    fn next_rows(&mut self) -> Result<RadianceImage, ExrError> {
        let mut rows = self.rows.next_rows(ROWS)?;
        if let Some(mean) = self.mean_of_unstated {
            for (variance, radiance) in rows.variance.iter_mut().zip(&rows.mean) {
                *variance = radiance.map(|m| (UNSTATED_NOISE * m.abs().max(DARK * mean)).powi(2));
            }
        }
        Ok(rows)
    }
}

fn mean_radiance<R: Read + Seek>(rows: &mut ExrRows<R>) -> Result<f32, ExrError> {
    let (mut sum, mut count) = (0.0f64, 0usize);
    loop {
        let rows = rows.next_rows(ROWS)?;
        if rows.height == 0 {
            return Ok((sum / count.max(1) as f64) as f32);
        }
        let values = rows.mean.iter().flatten().filter(|v| v.is_finite());
        sum += values.map(|v| f64::from(v.abs())).sum::<f64>();
        count += 3 * rows.mean.len();
    }
}

/// Averages the images of a scene's lights over its cells, without what is dark in `mask`.
pub fn average<R: Read + Seek>(
    scene: &Scene,
    mut sources: Vec<Source<R>>,
    mask_path: Option<&Path>,
    options: &CellOptions,
) -> Result<Captured, CliError> {
    let resolution_px = scene.camera.resolution_px;
    let mask = mask_path
        .map(|path| {
            bracket_files::read_picture(path, Some(resolution_px))
                .hint("a mask is a PNG of the images' size, white where pixels are used")
        })
        .transpose()?
        .map(|picture| picture.to_luma8());
    let mut averager = Averager::new(scene, choose(scene, options), sources.len())?;
    let mut first_row = 0;
    while first_row < resolution_px[1] {
        let mut rows = Vec::with_capacity(sources.len());
        for source in &mut sources {
            rows.push(source.next_rows()?);
        }
        let height = rows.first().map_or(0, |rows| rows.height);
        if height == 0 {
            break;
        }
        if let Some(mask) = &mask {
            let used = &mask.as_raw()[first_row * resolution_px[0]..];
            for image in &mut rows {
                for (valid, used) in image.valid.iter_mut().zip(used) {
                    *valid &= *used >= 128;
                }
            }
        }
        averager.add(&rows);
        first_row += height;
    }
    averager.finish().map_err(|error| match error {
        AverageError::NothingValid { image } => {
            let masked = mask.as_ref().zip(mask_path).map(|(mask, path)| {
                let left = mask.as_raw().iter().filter(|used| **used >= 128).count();
                let part = 100.0 * left as f64 / mask.as_raw().len().max(1) as f64;
                format!("; --mask {} leaves {part:.1}% of it", path.display())
            });
            let masked = masked.unwrap_or_default();
            let fact = format!("{}: {error}{masked}", sources[image].file);
            CliError::new(fact).hint(hints::FOR_INVALID_IMAGES)
        }
        error => error.into(),
    })
}
