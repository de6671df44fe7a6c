//! What a fit is going to cost, known before it begins.

use crate::units::size;

/// How much a fit does.
#[derive(Clone, Copy, Debug, serde::Serialize)]
pub struct FitWork {
    /// Cells that are compared.
    pub cells: usize,
    /// Lights, each with its image.
    pub lights: usize,
    /// Light paths per cell.
    pub paths_per_cell: u32,
    /// Whether the bench is refined first.
    pub refines_bench: bool,
}

/// Processor time of a fit as measured in `docs/measurements/size.md`, seconds: fixed, of each
/// path from a cell, and of each of its connections to a light.
const FIXED_CPU_S: f64 = 0.7;
const PATH_CPU_S: f64 = 6.0e-6;
const CONNECTION_CPU_S: f64 = 1.7e-6;
/// Time of a refinement of the bench over that of the fit itself.
const REFINING: f64 = 9.0;
/// Memory by the same measurements, bytes: fixed, of each cell, and of each path from a cell to
/// a light.
const FIXED_BYTES: f64 = 25e6;
const CELL_BYTES: f64 = 18e3;
const PATH_BYTES: f64 = 78.0;
/// Memory of a refinement over that of the fit itself.
const REFINING_MEMORY: f64 = 3.2;

impl FitWork {
    /// Estimated processor time, seconds.
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

    /// Estimated memory at its peak, bytes.
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

impl std::fmt::Display for FitWork {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            out,
            "{} cells, {} light paths each, about {:.0} s of processor time and {} of memory",
            self.cells,
            self.paths_per_cell,
            self.expected_cpu_s().max(1.0),
            size(self.expected_bytes() as u64)
        )
    }
}
