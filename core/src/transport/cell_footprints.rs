//! The parts of an image that a fit compares: squares of whole camera pixels.
//!
//! What a fit costs depends on the number of cells, never on the camera. A cell's value is the
//! mean over its pixels, and its footprint on the sensor's plane is theirs: the square, or what
//! is valid of it, convolved with the point spread.

use std::collections::HashMap;
use std::sync::Arc;

use glam::DVec2;

use super::camera::Camera;
use super::footprint;
use crate::geometry::Ray;

/// A square of pixels, or the valid ones of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Cell {
    /// Its top left pixel: column and row.
    pub corner_px: [u32; 2],
    /// Pixels along a side, at least 1.
    pub side_px: u32,
    /// Offsets from the corner of the pixels that belong to it; `None` if all do.
    part: Option<Arc<[[u16; 2]]>>,
}

impl Cell {
    /// All pixels of a square.
    pub fn square(corner_px: [u32; 2], side_px: u32) -> Self {
        Self {
            corner_px,
            side_px,
            part: None,
        }
    }

    /// These pixels of a square, by their offsets from its corner; `None` if there are none.
    pub fn part_of(corner_px: [u32; 2], side_px: u32, offsets: Vec<[u16; 2]>) -> Option<Self> {
        let all = offsets.len() == (side_px as usize).pow(2);
        (!offsets.is_empty()).then(|| Self {
            corner_px,
            side_px,
            part: (!all).then(|| offsets.into()),
        })
    }

    /// Number of pixels that belong to it.
    pub fn pixels(&self) -> usize {
        self.part
            .as_ref()
            .map_or((self.side_px as usize).pow(2), |part| part.len())
    }

    /// Column and row of the pixels that belong to it.
    pub fn each_pixel(&self) -> impl Iterator<Item = [usize; 2]> + '_ {
        let [x, y] = self.corner_px.map(|at| at as usize);
        let side = self.side_px as usize;
        let offset = move |k: usize| match &self.part {
            Some(part) => part[k].map(usize::from),
            None => [k % side, k / side],
        };
        (0..self.pixels()).map(move |k| {
            let [dx, dy] = offset(k);
            [x + dx, y + dy]
        })
    }

    /// Middle of the square, pixels from the image's top left corner.
    pub fn middle_px(&self) -> DVec2 {
        let [x, y] = self.corner_px.map(f64::from);
        DVec2::new(x, y) + 0.5 * f64::from(self.side_px)
    }

    /// Sensor position that the uniform numbers `u` in [0, 1)² choose in the cell's footprint.
    fn position_px(&self, u: DVec2, point_spread_px: f64) -> DVec2 {
        let [x, y] = self.corner_px.map(f64::from);
        let corner = DVec2::new(x, y);
        match &self.part {
            None => {
                let side = f64::from(self.side_px);
                let along = |u| side * footprint::position(u, point_spread_px / side);
                corner + DVec2::new(along(u.x), along(u.y))
            }
            // One number chooses the pixel and, by what is left of it, the column within.
            Some(part) => {
                let at = u.x * part.len() as f64;
                let pixel = (at as usize).min(part.len() - 1);
                let within = |u| footprint::position(u, point_spread_px);
                let [dx, dy] = part[pixel].map(f64::from);
                let column = (at - pixel as f64).clamp(0.0, 1.0 - f64::EPSILON);
                corner + DVec2::new(dx + within(column), dy + within(u.y))
            }
        }
    }
}

/// Cells of an image, none of which overlap.
///
/// ```
/// use rig_core::transport::Cells;
/// use rig_core::transport::cell_footprints::Cell;
///
/// // One cell of 2 × 2 pixels, and one of a single pixel.
/// let cells = Cells::new([16, 16], vec![Cell::square([4, 4], 2), Cell::square([9, 3], 1)]);
/// assert_eq!((cells.len(), cells.cell(0).pixels()), (2, 4));
/// assert_eq!(cells.at(glam::DVec2::new(9.5, 3.5)), Some(1));
/// ```
#[derive(Clone, Debug)]
pub struct Cells {
    resolution_px: [usize; 2],
    cells: Vec<Cell>,
    index: Index,
    /// `near[start[k]..start[k + 1]]` touch cell k, corners included.
    start: Vec<u32>,
    near: Vec<u32>,
}

/// Which cell covers a pixel.
#[derive(Clone, Debug)]
struct Index {
    by_corner: HashMap<[u32; 2], u32>,
    /// The sides that occur: few.
    sides_px: Vec<u32>,
}

impl Index {
    fn new(cells: &[Cell]) -> Self {
        let mut sides_px: Vec<u32> = cells.iter().map(|cell| cell.side_px).collect();
        sides_px.sort_unstable();
        sides_px.dedup();
        let corners = (0..).zip(cells).map(|(k, cell)| (cell.corner_px, k));
        Self {
            by_corner: corners.collect(),
            sides_px,
        }
    }

    fn covering(&self, cells: &[Cell], pixel: [u32; 2]) -> Option<u32> {
        self.sides_px.iter().find_map(|&side| {
            let corner = pixel.map(|at| at / side * side);
            let &k = self.by_corner.get(&corner)?;
            (cells[k as usize].side_px == side).then_some(k)
        })
    }
}

/// Parts of the field of view's width that a length of one pixel was at 64 × 64 pixels, on
/// which the lengths of a fit were tuned.
pub const FIELD_PARTS: f64 = 64.0;

impl Cells {
    /// Of an image of this size; the cells must not overlap, and the corner of each must be a
    /// multiple of its side.
    pub fn new(resolution_px: [usize; 2], cells: Vec<Cell>) -> Self {
        let index = Index::new(&cells);
        let mut pairs: Vec<(u32, u32)> = Vec::new();
        for (k, cell) in (0..).zip(&cells) {
            let [x, y] = cell.corner_px.map(i64::from);
            let side = i64::from(cell.side_px);
            let rim = (-1..=side).flat_map(|d| {
                [
                    [x + d, y - 1],
                    [x + d, y + side],
                    [x - 1, y + d],
                    [x + side, y + d],
                ]
            });
            for [i, j] in rim {
                let (Ok(i), Ok(j)) = (u32::try_from(i), u32::try_from(j)) else {
                    continue;
                };
                if let Some(other) = index.covering(&cells, [i, j]) {
                    pairs.extend([(k, other), (other, k)]);
                }
            }
        }
        pairs.sort_unstable();
        pairs.dedup();
        let mut start = vec![0u32; cells.len() + 1];
        pairs.iter().for_each(|&(k, _)| start[k as usize + 1] += 1);
        for k in 0..cells.len() {
            start[k + 1] += start[k];
        }
        Self {
            resolution_px,
            cells,
            index,
            start,
            near: pairs.into_iter().map(|(_, other)| other).collect(),
        }
    }

    /// Every pixel of an image of this size by itself.
    pub fn of_pixels(resolution_px: [usize; 2]) -> Self {
        let [width, height] = resolution_px;
        let pixels = (0..width * height)
            .map(|pixel| Cell::square([(pixel % width) as u32, (pixel / width) as u32], 1));
        Self::new(resolution_px, pixels.collect())
    }

    /// Number of cells.
    pub fn len(&self) -> usize {
        self.cells.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.cells.is_empty()
    }

    /// Pixels per row and rows of the image.
    pub fn resolution_px(&self) -> [usize; 2] {
        self.resolution_px
    }

    /// One of them.
    pub fn cell(&self, cell: usize) -> &Cell {
        &self.cells[cell]
    }

    /// All of them, in order.
    pub fn iter(&self) -> impl Iterator<Item = &Cell> {
        self.cells.iter()
    }

    /// The cell whose square covers a sensor position, pixels from the top left corner.
    pub fn at(&self, position_px: DVec2) -> Option<usize> {
        let at = position_px.to_array().map(f64::floor);
        let pixel = at.iter().all(|&v| v >= 0.0).then(|| at.map(|v| v as u32))?;
        let cell = self.index.covering(&self.cells, pixel)?;
        Some(cell as usize)
    }

    /// Cells whose middles lie within a square of this half side around a cell's middle, parts
    /// of the image's width; itself among them.
    pub fn within(&self, cell: usize, reach: f64) -> impl Iterator<Item = usize> + '_ {
        let middle = self.middle(cell);
        (0..self.len())
            .filter(move |&other| (self.middle(other) - middle).abs().max_element() <= reach)
    }

    /// The cells that touch one, without itself; of single pixels the eight around it.
    pub fn around(&self, cell: usize) -> impl Iterator<Item = usize> + Clone + '_ {
        let near = self.start[cell] as usize..self.start[cell + 1] as usize;
        self.near[near].iter().map(|&k| k as usize)
    }

    /// Key of a cell's random numbers: the number of its first pixel, row by row.
    pub fn key(&self, cell: usize) -> u64 {
        let [x, y] = self.cells[cell].corner_px;
        u64::from(y) * self.resolution_px[0] as u64 + u64::from(x)
    }

    /// The ray that begins in a cell's footprint, at a position and a point of the lens that
    /// uniform numbers in [0, 1)² choose.
    pub fn ray(&self, camera: &Camera, cell: usize, position: DVec2, lens: DVec2) -> Ray {
        let position_px = self.cells[cell].position_px(position, camera.point_spread_px);
        camera.ray(position_px, lens)
    }

    /// Middle of a cell over the width of the image; row 0 is the top.
    pub fn middle(&self, cell: usize) -> DVec2 {
        self.cells[cell].middle_px() / self.resolution_px[0] as f64
    }

    /// Side of the largest cells, part of the image's width; 0 without cells.
    pub fn largest_side(&self) -> f64 {
        let side_px = self.index.sides_px.last().copied().unwrap_or(0);
        f64::from(side_px) / self.resolution_px[0] as f64
    }

    /// Area of a cell over that of a pixel at 64 pixels across the field of view.
    pub fn area(&self, cell: usize) -> f64 {
        let scale = FIELD_PARTS / self.resolution_px[0] as f64;
        self.cells[cell].pixels() as f64 * scale * scale
    }

    /// Number of the block, an eighth of the image's width on either side, in which the middle
    /// of a cell lies: model errors within are taken as correlated.
    pub fn block(&self, cell: usize) -> usize {
        let [x, y] = (BLOCKS as f64 * self.middle(cell))
            .to_array()
            .map(|at| at as usize);
        y * BLOCKS + x
    }

    /// Blocks of the image.
    pub fn blocks(&self) -> usize {
        let [width, height] = self.resolution_px;
        BLOCKS * (BLOCKS * height).div_ceil(width)
    }
}

/// Blocks across an image.
const BLOCKS: usize = 8;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn single_pixels_touch_their_eight_neighbours() {
        let cells = Cells::new(
            [3, 3],
            (0..9).map(|k| Cell::square([k % 3, k / 3], 1)).collect(),
        );
        assert_eq!(cells.around(4).count(), 8);
        assert_eq!(cells.around(0).collect::<Vec<_>>(), [1, 3, 4]);
        assert_eq!([cells.key(0), cells.key(7)], [0, 7]);
    }

    /// A large cell next to small ones: touching goes both ways.
    #[test]
    fn cells_of_all_sizes_touch() {
        let mut squares = vec![Cell::square([0, 0], 2)];
        squares.extend([[2, 0], [3, 0], [2, 1], [3, 1]].map(|at| Cell::square(at, 1)));
        squares.push(Cell::square([0, 2], 2));
        let cells = Cells::new([4, 4], squares);
        assert_eq!(cells.around(0).collect::<Vec<_>>(), [1, 3, 5]);
        assert_eq!(cells.around(5).collect::<Vec<_>>(), [0, 3]);
        assert_eq!(cells.around(3).collect::<Vec<_>>(), [0, 1, 2, 4, 5]);
    }

    /// The mean over the positions is the mean over the pixels' footprints, also of a part.
    #[test]
    fn places_are_those_of_the_pixels() {
        let offsets = vec![[0, 0], [1, 0], [2, 0], [0, 2], [2, 2]];
        let part = Cell::part_of([6, 3], 3, offsets).unwrap();
        let whole = Cell::square([6, 3], 3);
        for (cell, spread) in [(&part, 0.0), (&part, 0.7), (&whole, 0.0), (&whole, 0.7)] {
            let n = 300;
            let mut found = [DVec2::ZERO; 2];
            for k in 0..n * n {
                let u = DVec2::new(f64::from(k % n), f64::from(k / n)) + 0.5;
                let at = cell.position_px(u / f64::from(n), spread);
                found[0] += at;
                found[1] += at * at;
            }
            let count = f64::from(n * n);
            let pixels: Vec<DVec2> = cell
                .each_pixel()
                .map(|[x, y]| DVec2::new(x as f64, y as f64) + 0.5)
                .collect();
            let mean = pixels.iter().sum::<DVec2>() / pixels.len() as f64;
            let square: DVec2 = pixels.iter().map(|&p| p * p).sum();
            // A pixel's own square has a variance of 1/12.
            let square = square / pixels.len() as f64 + 1.0 / 12.0 + spread * spread;
            assert!((found[0] / count - mean).length() < 1e-2, "{cell:?}");
            assert!((found[1] / count - square).length() < 0.1, "{cell:?}");
        }
    }
}
