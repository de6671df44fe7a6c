//! Which parts of the images a fit compares: cells as large as the scene allows.
//!
//! The radiance of a cell shows a lobe's shape as long as the half and difference angles inside
//! differ by little against the lobe. So the grid follows from the scene alone: squares are
//! halved where these angles vary most, under any of the lights and after up to two mirror
//! reflections, until they vary little or the budget is spent (`probe.rs`). All lights
//! share one grid, because they share the paths from the camera. Edges of shadows and
//! silhouettes are left out, not resolved: an error of pose or light direction far below a pixel
//! changes the radiance there by any amount.

mod captured;
pub mod glare;
mod probe;

use std::collections::BinaryHeap;

use crate::bench_priors::BenchPriors;
use crate::brdf::{Atom, Dictionary};
use crate::transport::Scene;
use crate::transport::cell_footprints::{Cell, FIELD_PARTS};

pub(crate) use captured::check_count;
pub use captured::{AverageError, Averager, Captured, CellImage};
use probe::{Lattice, Level};

/// What a grid of cells follows from, in addition to the scene.
#[derive(Clone, Debug, PartialEq)]
pub struct CellOptions {
    /// Most cells, within [`BUDGET`]; edges may take a few more.
    pub budget: usize,
    /// Roughness α of the narrowest lobe that is to be distinguished from wider ones.
    pub narrowest_alpha: f64,
    /// How well pose and lights are known, which says how wide edges are.
    pub known: BenchPriors,
}

/// Cells of a fit unless another number is asked for.
pub const DEFAULT_CELLS: usize = 2500;

/// How many cells may be asked for.
pub const BUDGET: std::ops::RangeInclusive<usize> = 64..=100_000;

impl Default for CellOptions {
    fn default() -> Self {
        Self {
            budget: DEFAULT_CELLS,
            narrowest_alpha: NARROWEST_ALPHA,
            known: BenchPriors::default(),
        }
    }
}

impl CellOptions {
    /// As by default, on a bench that is exactly known.
    pub fn exact() -> Self {
        Self {
            known: BenchPriors::EXACT,
            ..Self::default()
        }
    }

    /// For a fit of this dictionary on a bench that is known so well.
    pub fn new(dictionary: &Dictionary, known: &BenchPriors) -> Self {
        let widths = dictionary.atoms().iter().filter_map(Atom::alpha);
        let narrowest = widths.fold(f64::INFINITY, f64::min);
        Self {
            narrowest_alpha: if narrowest.is_finite() {
                narrowest.max(NARROWEST_ALPHA)
            } else {
                1.0
            },
            known: known.clone(),
            ..Self::default()
        }
    }
}

/// The narrowest lobe of the dictionaries that the program brings.
const NARROWEST_ALPHA: f64 = 0.01;

/// Parts of the image's width that a cell is at most wide: what a diagnosis must see varies
/// no faster.
const MIN_CELLS_ACROSS: usize = 32;
/// Variation of the angles within a cell, in widths of the narrowest lobe that it can resolve,
/// below which it is not halved.
const HALVING_VARIATION: f64 = 0.5;

/// The cells of a scene, in the order of their first pixels, and what is known of each.
#[derive(Clone, Debug)]
pub struct Grid {
    /// Pixels per row and rows of the image.
    pub resolution_px: [usize; 2],
    /// The cells.
    pub cells: Vec<Cell>,
    /// Lights, as bits, near the edge of whose shadow a cell lies.
    pub edges: Vec<u64>,
}

/// Chooses the cells of a scene.
pub fn choose(scene: &Scene, options: &CellOptions) -> Grid {
    let lattice = Lattice::look(scene, options);
    let levels = lattice.levels();
    let root = root_level(&lattice, &levels, options.budget);
    let finest_at_edges = edge_level(&lattice).max(root.saturating_sub(1));

    // Halve what must be, then where the angles vary most, until the budget is spent.
    let mut heap = BinaryHeap::new();
    let mut done: Vec<Square> = Vec::new();
    let mut pending: Vec<Square> = levels[root].squares(root).collect();
    let mut count = 0;
    loop {
        while let Some(square) = pending.pop() {
            let of = levels[square.level].at(square.at);
            if of.valid == 0 {
                continue;
            }
            let whole = 1u64 << (2 * square.level);
            let mixed = u64::from(of.valid) < whole || of.some_edges != of.all_edges;
            if mixed && square.level > finest_at_edges {
                pending.extend(square.quarters(&levels));
            } else if 2 * u64::from(of.valid) >= whole {
                count += 1;
                let variation = of.variation(square.level);
                if square.level > 0 && variation > HALVING_VARIATION {
                    heap.push(Candidate {
                        gain: variation * variation * f64::from(1u32 << square.level),
                        square,
                    });
                } else {
                    done.push(square);
                }
            } else if square.level > 0 && square.level + 1 > finest_at_edges {
                pending.extend(square.quarters(&levels));
            }
        }
        let Some(Candidate { square, .. }) = heap.pop() else {
            break;
        };
        if count + 3 > options.budget {
            done.push(square);
            done.extend(heap.drain().map(|candidate| candidate.square));
            break;
        }
        count -= 1;
        pending.extend(square.quarters(&levels));
    }
    let mut found: Vec<(Cell, u64)> = done
        .into_iter()
        .filter_map(|square| {
            let edges = levels[square.level].at(square.at).some_edges;
            Some((lattice.cell(square)?, edges))
        })
        .collect();
    found.sort_by_key(|(cell, _)| [cell.corner_px[1], cell.corner_px[0]]);
    let (cells, edges) = found.into_iter().unzip();
    Grid {
        resolution_px: scene.camera.resolution_px,
        cells,
        edges,
    }
}

/// A square of 2^level lattice points on either side.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Square {
    level: usize,
    /// Column and row among the squares of its level.
    at: [u32; 2],
}

impl Square {
    fn quarters(self, levels: &[Level]) -> impl Iterator<Item = Square> {
        let level = self.level - 1;
        let [x, y] = self.at.map(|at| 2 * at);
        let within = {
            let [columns, rows] = levels[level].size;
            move |&[x, y]: &[u32; 2]| x < columns && y < rows
        };
        [[x, y], [x + 1, y], [x, y + 1], [x + 1, y + 1]]
            .into_iter()
            .filter(within)
            .map(move |at| Square { level, at })
    }
}

/// A square that could be halved, and what that would gain.
struct Candidate {
    gain: f64,
    square: Square,
}

impl Ord for Candidate {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        let gain = self.gain.total_cmp(&other.gain);
        gain.then_with(|| other.square.cmp(&self.square))
    }
}

impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Candidate {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Candidate {}

/// The level of the largest squares: larger ones where the budget asks for it.
fn root_level(lattice: &Lattice, levels: &[Level], budget: usize) -> usize {
    let points = lattice.size[0] as usize / MIN_CELLS_ACROSS;
    let usual = (points.max(1).ilog2() as usize).min(levels.len() - 1);
    let fits = |&level: &usize| 2 * levels[level].seen() <= budget;
    (usual..levels.len()).find(fits).unwrap_or(levels.len() - 1)
}

/// The level down to which squares are halved that an edge crosses: about a 64th of the
/// image's width.
fn edge_level(lattice: &Lattice) -> usize {
    let points = f64::from(lattice.size[0]) / FIELD_PARTS;
    points.max(1.0).log2().round() as usize
}

#[cfg(test)]
pub(crate) mod tests;
