//! The memory that a fit may take, before it begins.

use super::CliError;
use crate::inverse::FitOptions;
use crate::inverse::cells::BUDGET;
use crate::inverse::memory::{Size, TooLittleMemory, free_bytes};

/// What may differ from the description of a bench, about, per light: the sample's pose, the
/// light's direction and intensity, stray light in each channel.
const BENCH_PARAMETERS: usize = 12;

/// `options` with the room that the cached paths of a fit of so many cells under so many lights
/// may take, where the whole
/// fit may take `memory_mib`; where nobody says, the options' room as far as the machine has it.
pub(super) fn bounded(
    options: &FitOptions,
    [cells, lights]: [usize; 2],
    atoms: usize,
    refines_bench: bool,
    memory_mib: Option<u64>,
) -> Result<FitOptions, CliError> {
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
    options.cache.max_bytes = usize::try_from(room.map_err(refused)?).unwrap_or(usize::MAX);
    Ok(options)
}

fn refused(error: TooLittleMemory) -> CliError {
    let enough = match error.by_machine {
        true => "free some memory or use a larger machine".to_owned(),
        false => format!("`--memory {}` would do", error.needed_mebibytes()),
    };
    let smaller = match error.fitting_cells.filter(|cells| BUDGET.contains(cells)) {
        Some(cells) => format!(", or compare fewer cells (`--cells {cells}`)"),
        None => String::new(),
    };
    CliError::new(error).hint(format!("{enough}{smaller}"))
}
