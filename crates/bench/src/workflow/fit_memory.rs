//! The memory that a fit may take, before it begins.

use super::FitWork;
use super::fit_plan::FitPlan;
use crate::inverse::FitOptions;
use crate::inverse::memory::{Size, TooLittleMemory, free_bytes};

/// Nuisance parameters per light, about: the sample's pose, the light's direction and intensity,
/// stray light in each channel.
const BENCH_PARAMETERS: usize = 12;

/// Cells that a measured bench may add to those of the described one, per cell.
const MORE_CELLS: f64 = 0.25;

/// Memory, MiB, with which a fit has all the room for paths that [`FitOptions`] allow.
pub(super) fn ample_mib(plan: &FitPlan, work: &FitWork) -> u64 {
    let size = Size {
        cells: (work.cells as f64 * (1.0 + MORE_CELLS)) as usize,
        lights: work.lights,
        atoms: plan.dictionary.len(),
        bench_parameters: if work.refines_bench {
            BENCH_PARAMETERS
        } else {
            0
        },
    };
    let paths = plan.options.cache.max_bytes as u64;
    size.least_bytes().saturating_add(paths).div_ceil(1 << 20)
}

/// `options` with the room that the cached paths of a fit of so many cells under so many lights
/// may take. The whole fit may take `memory_mib`; where that is `None`, the options' room as far
/// as the machine has it free.
///
/// # Errors
/// Not even the fewest paths find room.
pub(super) fn bounded(
    options: &FitOptions,
    [cells, lights]: [usize; 2],
    atoms: usize,
    refines_bench: bool,
    memory_mib: Option<u64>,
) -> Result<FitOptions, TooLittleMemory> {
    let size = Size {
        cells,
        lights,
        atoms,
        bench_parameters: if refines_bench { BENCH_PARAMETERS } else { 0 },
    };
    let room = match memory_mib {
        Some(mebibytes) => size.room_for_paths(mebibytes << 20),
        None => size.room_on_machine(options.cache.max_bytes as u64, free_bytes()),
    };
    let mut options = options.clone();
    options.cache.max_bytes = usize::try_from(room?).unwrap_or(usize::MAX);
    Ok(options)
}
