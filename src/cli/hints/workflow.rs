//! Advice on fits that could not be made.

use super::{FOR_INVALID_IMAGES, for_implausible};
use crate::cells::BUDGET;
use crate::cli::preflight;
use crate::inverse::memory::TooLittleMemory;
use crate::workflow::{HoldOutError, WorkflowError};

/// The advice that the wrapper itself has; what it wraps is asked after it.
pub(super) fn for_workflow(error: &WorkflowError) -> Option<String> {
    use WorkflowError::*;
    let hint = match error {
        MergedImage { session, .. } => {
            return Some(format!(
                "`rig capture --resume {}` takes what is missing and merges the raw frames again",
                session.display()
            ));
        }
        Mask { .. } => "a mask is a PNG of the images' size, white where pixels are used",
        Scene(concern) => return Some(preflight::remedy_of(concern)),
        NothingValid { .. } => FOR_INVALID_IMAGES,
        Implausible { source, .. } => for_implausible(source),
        Kernel(_) => "`--kernel auto` takes the fastest that it has",
        HoldOut(HoldOutError::Count { .. } | HoldOutError::NoSuchLight { .. }) => {
            "without --hold-out and --fit-lights a quarter of the lights is predicted"
        }
        UnusedUncertainty => "add --refine-bench, or leave --uncertainty out",
        Memory(error) => return Some(for_memory(error)),
        _ => return None,
    };
    Some(hint.to_owned())
}

fn for_memory(error: &TooLittleMemory) -> String {
    let enough = match error.by_machine {
        true => "free some memory or use a larger machine".to_owned(),
        false => format!("`--memory {}` would do", error.needed_mebibytes()),
    };
    let smaller = match error.fitting_cells.filter(|cells| BUDGET.contains(cells)) {
        Some(cells) => format!(", or compare fewer cells (`--cells {cells}`)"),
        None => String::new(),
    };
    format!("{enough}{smaller}")
}
