//! Captured images averaged over a scene's cells while they are read, a few rows of all lights at
//! a time: no image of a file is ever in memory whole.

use std::io::{Read, Seek};
use std::path::Path;

use super::WorkflowError;
use crate::cells::glare::{BlockSums, Glare};
use crate::cells::{AverageError, Averager, Captured, CellOptions, choose};
use crate::outside_file;
use crate::radiance_image::RadianceImage;
use crate::radiance_image::exr::{ExrError, ExrRows};
use crate::radiometry::frame_file::picture;
use crate::transport::Scene;

/// Rows that are read together.
const ROWS: usize = 16;

/// Relative noise that images without a stated variance are taken to have.
pub const UNSTATED_NOISE: f32 = 0.005;
/// Radiance over the mean below which that noise gets no smaller.
const DARK: f32 = 1e-3;

/// An image, from its first row to its last.
pub(super) trait Rows {
    /// The next rows, at most so many; fewer at the end, none after it.
    fn next_rows(&mut self, count: usize) -> Result<RadianceImage, ExrError>;
}

impl<R: Read + Seek> Rows for ExrRows<R> {
    fn next_rows(&mut self, count: usize) -> Result<RadianceImage, ExrError> {
        ExrRows::next_rows(self, count)
    }
}

/// The rows of an image in memory.
pub(super) struct MemoryRows<'a> {
    image: &'a RadianceImage,
    next: usize,
}

impl<'a> MemoryRows<'a> {
    /// From the first on.
    pub fn of(image: &'a RadianceImage) -> Self {
        Self { image, next: 0 }
    }
}

impl Rows for MemoryRows<'_> {
    fn next_rows(&mut self, count: usize) -> Result<RadianceImage, ExrError> {
        let end = self.image.height.min(self.next.saturating_add(count));
        let rows = self.image.rows(self.next..end);
        self.next = end;
        Ok(rows)
    }
}

/// An image that is about to be read.
pub(super) struct Source<R> {
    pub rows: R,
    /// Its name in messages.
    pub file: String,
    /// Mean radiance, where no variance is stated.
    pub mean_of_unstated: Option<f32>,
}

impl<R: Rows> Source<R> {
    /// Of `rows`, where variances are stated; else `reopen` begins it once more for its mean.
    ///
    /// # Errors
    /// The image cannot be read.
    pub fn new(
        rows: R,
        file: String,
        has_variance: bool,
        reopen: impl FnOnce() -> Result<R, ExrError>,
    ) -> Result<Self, ExrError> {
        let mean_of_unstated = match has_variance {
            true => None,
            false => Some(mean_radiance(&mut reopen()?)?),
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
            assume_noise(&mut rows, mean);
        }
        Ok(rows)
    }
}

/// Sets the variances of an image, or of some of its rows, where none is stated; `mean`: mean
/// radiance of the whole image.
pub(super) fn assume_noise(image: &mut RadianceImage, mean: f32) {
    for (variance, radiance) in image.variance.iter_mut().zip(&image.mean) {
        *variance = radiance.map(|m| (UNSTATED_NOISE * m.abs().max(DARK * mean)).powi(2));
    }
}

fn mean_radiance(rows: &mut impl Rows) -> Result<f32, ExrError> {
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

/// Largest mask, bytes: 250 megapixels of 16-bit RGB, not compressed.
const LARGEST_MASK_BYTES: u64 = 3 << 29;

/// Averages the images of a scene's lights over its cells, without what is dark or transparent in
/// the mask and, where it is known, without the lens' glare.
///
/// # Errors
/// An image or mask that cannot be read or has another size, or of which nothing is valid.
pub(super) fn average<R: Rows>(
    scene: &Scene,
    mut sources: Vec<Source<R>>,
    mask_path: Option<&Path>,
    options: &CellOptions,
    glare: Option<&Glare>,
) -> Result<Captured, WorkflowError> {
    let resolution_px = scene.camera.resolution_px;
    let mask = mask_path.map(|path| read_mask(path, resolution_px));
    let mask = mask.transpose()?;
    let mut averager = Averager::new(scene, choose(scene, options), sources.len())?;

    // The same rows of all images at a time. What is masked scatters as well.
    let mut blocks = vec![BlockSums::new(resolution_px); sources.len()];
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
        if glare.is_some() {
            for (blocks, rows) in blocks.iter_mut().zip(&rows) {
                blocks.add(rows);
            }
        }
        if let Some(mask) = &mask {
            let used = &mask[first_row * resolution_px[0]..];
            for image in &mut rows {
                for (valid, used) in image.valid.iter_mut().zip(used) {
                    *valid &= used;
                }
            }
        }
        averager.add(&rows);
        first_row += height;
    }

    let averaged = averager.finish().map(|mut captured| {
        if let Some(glare) = glare {
            captured.remove_glare(&blocks, glare);
        }
        captured
    });
    averaged.map_err(|source| match source {
        AverageError::NothingValid { image } => WorkflowError::NothingValid {
            file: sources.swap_remove(image).file,
            source,
            mask: mask.as_ref().zip(mask_path).map(|(mask, path)| {
                let left = mask.iter().filter(|used| **used).count();
                let percent = 100.0 * left as f64 / mask.len().max(1) as f64;
                (path.to_owned(), percent)
            }),
        },
        error => error.into(),
    })
}

/// Which pixels a mask leaves, row by row.
pub(super) fn read_mask(
    path: &Path,
    resolution_px: [usize; 2],
) -> Result<Vec<bool>, WorkflowError> {
    let failed = |fact: String| WorkflowError::Mask {
        path: path.to_owned(),
        fact,
    };
    let bytes = outside_file::read_regular(path, LARGEST_MASK_BYTES)
        .map_err(|error| failed(error.to_string()))?;
    let mask = picture(&bytes, Some(resolution_px)).map_err(|error| failed(error.to_string()))?;
    // As over black: what is transparent was not painted.
    let used = |pixel: &[u8]| u16::from(pixel[0]) * u16::from(pixel[1]) >= 128 * 255;
    let mask = mask.to_luma_alpha8();
    Ok(mask.as_raw().chunks_exact(2).map(used).collect())
}
