//! Captured images averaged over cells, while they are read.

use std::collections::VecDeque;
use std::sync::Arc;

use super::{CellOptions, Grid, choose};
use crate::radiance_image::RadianceImage;
use crate::shown::nth;
use crate::transport::Scene;
use crate::transport::cell_footprints::{Cell, Cells};
use crate::transport::event::MAX_LIGHTS;

/// What is compared: for each light the mean over every cell.
#[derive(Clone, Debug)]
pub struct Captured {
    /// The cells, none of which is empty.
    pub cells: Arc<Cells>,
    /// One image for each light.
    pub images: Vec<CellImage>,
    /// Errors that all values have in common: what one standard deviation of each changes them
    /// by, `[error][light][cell]`.
    pub common_errors: Vec<Vec<Vec<[f64; 3]>>>,
    /// Per cell: lights, as bits, near the edge of whose shadow it lies.
    pub edges: Vec<u64>,
    /// Pixels that were left out as hot, dead or dusty.
    pub outliers: usize,
}

/// An image by cells, R, G, B.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CellImage {
    /// Radiance: plain mean over the cell's pixels.
    pub mean: Vec<[f64; 3]>,
    /// Variance of each mean, from those of the pixels.
    pub variance: Vec<[f64; 3]>,
}

/// Images that cannot be those of a scene.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)]
pub enum AverageError {
    #[error("{images} images for {lights} lights of the scene")]
    ImageCount { images: usize, lights: usize },
    #[error("{lights} lights; at most {MAX_LIGHTS} can be fitted together")]
    TooManyLights { lights: usize },
    #[error(
        "{image} is {width} × {height}; the scene's camera has {} × {}", expected[0], expected[1], image = nth("image", *image)
    )]
    ImageSize {
        image: usize,
        width: usize,
        height: usize,
        /// The camera's width and height.
        expected: [usize; 2],
    },
    #[error("no part of the sample is seen away from its edges")]
    NothingSeen,
    #[error("no cell of {image} has enough valid pixels on the sample", image = nth("image", *image))]
    NothingValid {
        /// Index of the image with the fewest valid pixels.
        image: usize,
    },
}

impl Captured {
    /// Averages one image per light of the scene over cells chosen for it.
    ///
    /// # Errors
    /// Images of another number or size, or nothing in them to compare.
    ///
    /// ```
    /// # use rig_core::cells::{Captured, CellOptions};
    /// # fn of(scene: &rig_core::transport::Scene, images: &[rig_core::radiance_image::RadianceImage]) {
    /// let captured = Captured::new(scene, images, &CellOptions::default());
    /// # let _ = captured;
    /// # }
    /// ```
    pub fn new(
        scene: &Scene,
        images: &[RadianceImage],
        options: &CellOptions,
    ) -> Result<Self, AverageError> {
        let expected = scene.camera.resolution_px;
        for (image, of_light) in images.iter().enumerate() {
            let (width, height) = (of_light.width, of_light.height);
            if [width, height] != expected {
                return Err(AverageError::ImageSize {
                    image,
                    width,
                    height,
                    expected,
                });
            }
        }
        let mut averager = Averager::new(scene, choose(scene, options), images.len())?;
        averager.add(images);
        averager.finish()
    }

    /// Every pixel by itself, in order; those that are not valid in all images, or not `wanted`,
    /// are not compared.
    pub fn of_pixels(images: &[RadianceImage], wanted: impl Fn(usize) -> bool) -> Self {
        let size = images
            .first()
            .map_or([0, 0], |image| [image.width, image.height]);
        let cells = Cells::of_pixels(size);
        let double = |values: &[[f32; 3]]| values.iter().map(|v| v.map(f64::from)).collect();
        let of_light = |image: &RadianceImage| CellImage {
            mean: double(&image.mean),
            variance: double(&image.variance),
        };
        let edges = (0..cells.len())
            .map(|pixel| match wanted(pixel) {
                true if images.iter().all(|image| image.valid[pixel]) => 0,
                _ => u64::MAX,
            })
            .collect();
        Self {
            cells: Arc::new(cells),
            images: images.iter().map(of_light).collect(),
            common_errors: Vec::new(),
            edges,
            outliers: 0,
        }
    }

    /// Number of cells.
    pub fn len(&self) -> usize {
        self.cells.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.cells.is_empty()
    }

    /// Whether a cell lies away from the edges of a light's shadows.
    pub fn is_even(&self, cell: usize, light: usize) -> bool {
        self.edges[cell] >> light & 1 == 0
    }
}

/// Whether there are as many images as lights, and no more than a fit takes.
pub(crate) fn check_count(scene: &Scene, images: usize) -> Result<(), AverageError> {
    let lights = scene.lights.len();
    if images != lights || images == 0 {
        return Err(AverageError::ImageCount { images, lights });
    }
    if lights > MAX_LIGHTS {
        return Err(AverageError::TooManyLights { lights });
    }
    Ok(())
}

/// Pixels of a row that belong to one cell.
struct Run {
    columns: std::ops::Range<u32>,
    cell: u32,
}

/// Sums over cells while rows of all images come by, from the top.
pub struct Averager {
    grid: Grid,
    /// `runs[row_start[y]..row_start[y + 1]]` lie in row y.
    row_start: Vec<u32>,
    runs: Vec<Run>,
    /// `[light][cell]`.
    sums: Vec<CellImage>,
    /// Pixels of each cell that are left out.
    left_out: Vec<Vec<[u16; 2]>>,
    /// Pixels of cells that are not valid, by light.
    invalid: Vec<usize>,
    outliers: usize,
    /// The last rows of all images: the one to be added, and those before and after.
    rows: VecDeque<Vec<RadianceImage>>,
    /// Number of the next row to be added.
    next: usize,
}

/// Sides of cells, pixels, from which on a single pixel that differs from those around it is
/// dust or a defect: in smaller ones it may be a highlight.
const MIN_OUTLIER_SIDE_PX: u32 = 4;
/// How far a pixel must differ from the median around it, in standard deviations of noise and
/// in spreads of the eight pixels around it.
const OUTLIER_DEVIATIONS: f32 = 8.0;
/// The same as a part of the median: what a smooth image varies by between neighbours.
const MIN_OUTLIER_CONTRAST: f32 = 0.05;

impl Averager {
    /// For the images of a scene's lights, over its cells.
    ///
    /// # Errors
    /// Another number of images than of lights, or too many.
    pub fn new(scene: &Scene, grid: Grid, images: usize) -> Result<Self, AverageError> {
        check_count(scene, images)?;
        let mut by_row: Vec<(u32, Run)> = Vec::new();
        for (k, cell) in (0..).zip(&grid.cells) {
            let mut pixels = cell.each_pixel().map(|[x, y]| [x as u32, y as u32]);
            let Some([x, y]) = pixels.next() else {
                continue;
            };
            let mut run = (y, x..x + 1);
            for [x, y] in pixels {
                if y == run.0 && x == run.1.end {
                    run.1.end += 1;
                } else {
                    let columns = std::mem::replace(&mut run.1, x..x + 1);
                    let row = std::mem::replace(&mut run.0, y);
                    by_row.push((row, Run { columns, cell: k }));
                }
            }
            let (row, columns) = run;
            by_row.push((row, Run { columns, cell: k }));
        }
        by_row.sort_by_key(|(row, run)| (*row, run.columns.start));
        let mut row_start = vec![0u32; grid.resolution_px[1] + 1];
        for (row, _) in &by_row {
            row_start[*row as usize + 1] += 1;
        }
        for row in 0..grid.resolution_px[1] {
            row_start[row + 1] += row_start[row];
        }
        let none = CellImage {
            mean: vec![[0.0; 3]; grid.cells.len()],
            variance: vec![[0.0; 3]; grid.cells.len()],
        };
        Ok(Self {
            row_start,
            runs: by_row.into_iter().map(|(_, run)| run).collect(),
            sums: vec![none; images],
            left_out: vec![Vec::new(); grid.cells.len()],
            invalid: vec![0; images],
            outliers: 0,
            rows: VecDeque::new(),
            next: 0,
            grid,
        })
    }

    /// Takes the next rows: the same ones of every light's image.
    pub fn add(&mut self, rows: &[RadianceImage]) {
        let height = rows.first().map_or(0, |rows| rows.height);
        for y in 0..height {
            let row = rows.iter().map(|image| image.rows(y..y + 1)).collect();
            self.rows.push_back(row);
            // A row is added when the one below is known.
            match self.rows.len() {
                2 if self.next == 0 => self.add_row(0),
                3 => {
                    self.add_row(1);
                    self.rows.pop_front();
                }
                _ => {}
            }
        }
    }

    /// Adds the next row, which is the one `at` of those kept.
    fn add_row(&mut self, at: usize) {
        let y = self.next;
        self.next += 1;
        let runs = self.row_start[y] as usize..self.row_start[y + 1] as usize;
        for run in &self.runs[runs] {
            let index = run.cell as usize;
            let cell = &self.grid.cells[index];
            let [left, top] = cell.corner_px;
            for x in run.columns.clone() {
                let column = x as usize;
                let mut all_valid = true;
                for (invalid, image) in self.invalid.iter_mut().zip(&self.rows[at]) {
                    let valid = is_valid(image, column);
                    *invalid += usize::from(!valid);
                    all_valid &= valid;
                }
                if all_valid && cell.side_px >= MIN_OUTLIER_SIDE_PX {
                    let mut lights = 0..self.sums.len();
                    if lights.any(|light| is_outlying(&self.rows, at, light, column)) {
                        self.outliers += 1;
                        all_valid = false;
                    }
                }
                if !all_valid {
                    let offset = [x - left, y as u32 - top].map(|d| d as u16);
                    self.left_out[index].push(offset);
                    continue;
                }
                for (sum, image) in self.sums.iter_mut().zip(&self.rows[at]) {
                    for c in 0..3 {
                        sum.mean[index][c] += f64::from(image.mean[column][c]);
                        sum.variance[index][c] += f64::from(image.variance[column][c]);
                    }
                }
            }
        }
    }

    /// The means, when all rows have been added.
    ///
    /// # Errors
    /// Nothing is left to compare.
    pub fn finish(mut self) -> Result<Captured, AverageError> {
        if self.next < self.grid.resolution_px[1] && !self.rows.is_empty() {
            self.add_row(self.rows.len() - 1);
        }
        if self.grid.cells.is_empty() {
            return Err(AverageError::NothingSeen);
        }
        let Self {
            grid,
            sums,
            left_out,
            invalid,
            outliers,
            ..
        } = self;
        let mut cells = Vec::with_capacity(grid.cells.len());
        let mut edges = Vec::with_capacity(grid.cells.len());
        let mut images = vec![CellImage::default(); sums.len()];
        for (k, (cell, left_out)) in grid.cells.into_iter().zip(left_out).enumerate() {
            let Some(cell) = without(cell, left_out) else {
                continue;
            };
            let count = cell.pixels() as f64;
            for (image, sums) in images.iter_mut().zip(&sums) {
                image.mean.push(sums.mean[k].map(|v| v / count));
                image
                    .variance
                    .push(sums.variance[k].map(|v| v / (count * count)));
            }
            cells.push(cell);
            edges.push(grid.edges[k]);
        }
        if cells.is_empty() {
            let image = (0..invalid.len()).rev().max_by_key(|&light| invalid[light]);
            return Err(AverageError::NothingValid {
                image: image.unwrap_or(0),
            });
        }
        Ok(Captured {
            cells: Arc::new(Cells::new(grid.resolution_px, cells)),
            images,
            common_errors: Vec::new(),
            edges,
            outliers,
        })
    }
}

/// A cell without some of its pixels; `None` if under half of its square is left.
fn without(cell: Cell, mut left_out: Vec<[u16; 2]>) -> Option<Cell> {
    if left_out.is_empty() {
        return Some(cell);
    }
    let half = (cell.side_px as usize).pow(2).div_ceil(2);
    left_out.sort_unstable();
    let [left, top] = cell.corner_px.map(|at| at as usize);
    let offsets: Vec<[u16; 2]> = cell
        .each_pixel()
        .map(|[x, y]| [(x - left) as u16, (y - top) as u16])
        .filter(|offset| left_out.binary_search(offset).is_err())
        .collect();
    if offsets.len() < half {
        return None;
    }
    Cell::part_of(cell.corner_px, cell.side_px, offsets)
}

fn is_valid(row: &RadianceImage, column: usize) -> bool {
    let mut values = row.mean[column].iter().chain(&row.variance[column]);
    row.valid[column] && values.all(|v| v.is_finite())
}

/// Whether a pixel differs in any channel from the eight around it, which agree.
fn is_outlying(
    rows: &VecDeque<Vec<RadianceImage>>,
    at: usize,
    light: usize,
    column: usize,
) -> bool {
    let near_rows = at.saturating_sub(1)..(at + 2).min(rows.len());
    let width = rows[at][light].width;
    let columns = column.saturating_sub(1)..(column + 2).min(width);
    let row = &rows[at][light];
    (0..3).any(|c| {
        let value = row.mean[column][c];
        let noise = row.variance[column][c].max(0.0).sqrt();
        // Most pixels are like the one next to them.
        let neighbour = row.mean[column.saturating_sub(1)][c];
        if (value - neighbour).abs()
            <= (0.5 * OUTLIER_DEVIATIONS * noise).max(0.5 * MIN_OUTLIER_CONTRAST * value)
        {
            return false;
        }
        let mut near = [0.0f32; 8];
        let mut count = 0;
        for j in near_rows.clone() {
            let row = &rows[j][light];
            for i in columns.clone() {
                if (j, i) != (at, column) && is_valid(row, i) {
                    near[count] = row.mean[i][c];
                    count += 1;
                }
            }
        }
        if count < 5 {
            return false;
        }
        let near = &mut near[..count];
        near.sort_unstable_by(f32::total_cmp);
        let median = near[count / 2];
        // Without the outermost on either side, of which one may be dust as well.
        let spread = near[count - 2] - near[1];
        let limit =
            (OUTLIER_DEVIATIONS * noise.max(spread)).max(MIN_OUTLIER_CONTRAST * median.abs());
        (value - median).abs() > limit
    })
}
