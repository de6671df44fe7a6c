//! What a fit is going to cost, said before it begins, and how far it is.

use std::sync::{Mutex, PoisonError};

use super::Context;
use super::progress::StagedBar;
use crate::progress::Progress;

/// How much a fit does.
#[derive(Clone, Copy, Debug, serde::Serialize)]
pub struct Work {
    /// Cells that are compared.
    pub cells: usize,
    /// Lights, each with its image.
    pub lights: usize,
    /// Light paths per cell.
    pub paths_per_cell: u32,
    /// Whether the bench is refined first.
    pub refines_bench: bool,
}

/// Processor time of a fit by `docs/measurements/size.md`: of all, and of each path from a cell
/// with its connection to each light, seconds.
const FIXED_CPU_S: f64 = 0.7;
const PATH_CPU_S: f64 = 6.0e-6;
const CONNECTION_CPU_S: f64 = 1.7e-6;
/// Refining the bench over the fit itself, likewise.
const REFINING: f64 = 9.0;
/// Memory by the same measurements: of the program, of each cell, and of each path from a cell
/// to a light, bytes.
const FIXED_BYTES: f64 = 25e6;
const CELL_BYTES: f64 = 18e3;
const PATH_BYTES: f64 = 78.0;
/// Memory of a refinement over that of the fit itself.
const REFINING_MEMORY: f64 = 3.2;

impl Work {
    /// Processor time that it takes, about, seconds.
    pub fn expected_cpu_s(&self) -> f64 {
        let paths = self.cells as f64 * f64::from(self.paths_per_cell);
        let each = PATH_CPU_S + CONNECTION_CPU_S * self.lights as f64;
        let fit_s = FIXED_CPU_S + paths * each;
        let refining_s = if self.refines_bench {
            REFINING * fit_s
        } else {
            0.0
        };
        fit_s + refining_s
    }
}

impl Work {
    /// Memory that it holds at its peak, about, bytes.
    pub fn expected_bytes(&self) -> f64 {
        let paths = self.lights as f64 * f64::from(self.paths_per_cell);
        let fit = self.cells as f64 * (CELL_BYTES + paths * PATH_BYTES);
        let refining = if self.refines_bench {
            REFINING_MEMORY
        } else {
            1.0
        };
        FIXED_BYTES + refining * fit
    }
}

impl std::fmt::Display for Work {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            out,
            "{} cells, {} light paths each, about {:.0} s of processor time and {:.0} MB",
            self.cells,
            self.paths_per_cell,
            self.expected_cpu_s().max(1.0),
            self.expected_bytes() / 1e6
        )
    }
}

/// Stages of a fit as the library names them, and the part of its time that is over when each
/// begins; a first, quick solution comes before the one on all paths.
const STAGES: [(&str, f64); 10] = [
    ("direct reflection", 0.0),
    ("tracing paths", 0.06),
    ("optimising", 0.14),
    ("direct reflection", 0.18),
    ("tracing paths", 0.18),
    ("optimising", 0.6),
    ("uncertainty", 0.74),
    ("diagnosis", 0.88),
    ("scoring", 0.9),
    ("longer paths", 0.96),
];
/// Part of the time that the rounds of a refinement take, and their number until it settles,
/// usually.
const ROUNDS_PART: f64 = 0.85;
const USUAL_ROUNDS: f64 = 6.0;

/// A bar that follows a fit's stages.
pub struct FitProgress {
    bar: StagedBar,
    refines_bench: bool,
    at: Mutex<Position>,
}

#[derive(Default)]
struct Position {
    rounds: u32,
    next: usize,
}

impl FitProgress {
    /// At the beginning.
    pub fn new(context: &Context, refines_bench: bool) -> Self {
        Self {
            bar: context.staged_bar(),
            refines_bench,
            at: Mutex::default(),
        }
    }

    /// Clears the line.
    pub fn finish(self) {
        self.bar.finish();
    }
}

impl Progress for FitProgress {
    fn begin(&self, stage: &str, _: Option<usize>) {
        let mut at = self.at.lock().unwrap_or_else(PoisonError::into_inner);
        let place = STAGES[at.next..]
            .iter()
            .position(|(name, _)| *name == stage);
        let done = match place {
            Some(ahead) => {
                at.next += ahead;
                let (_, done) = STAGES[at.next];
                at.next += 1;
                if self.refines_bench {
                    ROUNDS_PART + (1.0 - ROUNDS_PART) * done
                } else {
                    done
                }
            }
            // A round of the refinement: each takes some of what is left.
            None => {
                at.rounds += 1;
                let over = f64::from(at.rounds - 1) / USUAL_ROUNDS;
                ROUNDS_PART * (1.0 - (-over).exp())
            }
        };
        self.bar.at(stage, done);
    }
}
