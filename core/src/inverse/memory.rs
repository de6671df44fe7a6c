//! What a fit needs of the machine's memory, known before it begins.
//!
//! In addition to the cached paths, whose room is chosen, a fit needs its values, the direct
//! matrix, what a discrepancy makes of the light, residual weights, modelled values and what a
//! diagnosis compares, in proportion to the cells under every light; and the sums over
//! groups of cells, of which there are at most `GROUPS`. [`Size::values_bytes`] is an upper
//! estimate of all of that at its peak, by counted allocations (`tests/fuzz_corpus/main.rs` counts
//! again) and by the resident memory of whole fits of up to 512² cells with 1 to 4 lights.
//! The images themselves are averaged while they are read.

use crate::brdf::discrepancy::MOST_MODES;

/// Of program, scene, dictionary and threads, bytes.
const PROGRAM_BYTES: u64 = 24 << 20;
/// Per cell and light: values, weights, models, templates of the diagnosis.
const PER_VALUE_BYTES: u64 = 800;
/// Per cell, light and atom: the direct matrix, twice while it is made.
const PER_ATOM_BYTES: u64 = 8;
/// Per cell, light and mode of a discrepancy: derivatives in three channels, twice likewise.
const PER_MODE_BYTES: u64 = 24;
/// Per cell, light and parameter of a bench that is refined.
const PER_PARAMETER_BYTES: u64 = 48;
/// Groups of cells over which an evaluation sums, at most, and cells in each, at least.
const GROUPS: u64 = 256;
const GROUP_CELLS: u64 = 32;
/// A record of a cached reflection, bytes, at most for the dictionaries of the program.
const RECORD_BYTES: u64 = 144;
/// Reflections beyond the first that a path of a bowl has, about, over all cells.
const REFLECTIONS: u64 = 1;
/// Fewest paths per cell: one in each half.
const LEAST_PATHS: u64 = 2;

/// How much there is to fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size {
    /// Cells that are compared.
    pub cells: usize,
    /// Lights, each with its image.
    pub lights: usize,
    /// Atoms of the dictionary, with those that refinement may add.
    pub atoms: usize,
    /// Parameters of the bench that are refined with the weights; 0 where it is exactly known.
    pub bench_parameters: usize,
}

/// A fit that would need more memory than it may have.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "a fit of {lights} images in {cells} cells needs about {} MiB of memory, but {} MiB are allowed{}",
    mebibytes(*needed_bytes),
    allowed_bytes >> 20,
    if *by_machine { " (what the machine has free)" } else { "" }
)]
pub struct TooLittleMemory {
    /// Cells that are compared.
    pub cells: usize,
    /// Lights, each with its image.
    pub lights: usize,
    /// With the fewest paths, bytes.
    pub needed_bytes: u64,
    /// What it may have, bytes.
    pub allowed_bytes: u64,
    /// Whether that is what the machine has free, and not what was asked for.
    pub by_machine: bool,
    /// A number of cells that would fit; `None` if none would.
    pub fitting_cells: Option<usize>,
}

impl TooLittleMemory {
    /// What would do, MiB.
    pub fn needed_mebibytes(&self) -> u64 {
        mebibytes(self.needed_bytes)
    }
}

fn mebibytes(bytes: u64) -> u64 {
    bytes.div_ceil(1 << 20)
}

impl Size {
    /// All that a fit needs but its cached paths, bytes: an upper estimate.
    pub fn values_bytes(&self) -> u64 {
        let (atoms, modes) = (self.atoms as u64, MOST_MODES as u64);
        let per_value = PER_VALUE_BYTES
            + PER_ATOM_BYTES * atoms
            + PER_MODE_BYTES * modes
            + PER_PARAMETER_BYTES * self.bench_parameters as u64;
        // Two matrices for three channels in double precision, and a third of that for scores and
        // the matrices of what was summed before.
        let per_group = 64 * (atoms + modes).pow(2);
        let groups = GROUPS.min((self.cells as u64).div_ceil(GROUP_CELLS));
        let values = self.values().saturating_mul(per_value);
        values.saturating_add(groups * per_group)
    }

    /// Room that the fewest paths take, bytes.
    pub fn least_paths_bytes(&self) -> u64 {
        let records = LEAST_PATHS * REFLECTIONS * (1 + self.lights as u64);
        (self.cells as u64).saturating_mul(records * RECORD_BYTES)
    }

    /// What the fit needs at least, bytes.
    pub fn least_bytes(&self) -> u64 {
        PROGRAM_BYTES
            .saturating_add(self.values_bytes())
            .saturating_add(self.least_paths_bytes())
    }

    fn values(&self) -> u64 {
        (self.cells as u64).saturating_mul(self.lights as u64)
    }

    /// Room for cached paths, bytes, where the whole fit may have `allowed_bytes`.
    ///
    /// # Errors
    /// Not even the fewest paths find room.
    pub fn room_for_paths(&self, allowed_bytes: u64) -> Result<u64, TooLittleMemory> {
        if self.least_bytes() > allowed_bytes {
            return Err(TooLittleMemory {
                cells: self.cells,
                lights: self.lights,
                needed_bytes: self.least_bytes(),
                allowed_bytes,
                by_machine: false,
                fitting_cells: self.fitting(allowed_bytes),
            });
        }
        Ok(allowed_bytes - PROGRAM_BYTES - self.values_bytes())
    }

    /// [`Self::room_for_paths`] where nobody says how much the fit may have: `wanted_bytes` for
    /// paths, or less where the machine has less, of which `free_bytes` are free (`None`: unknown).
    ///
    /// # Errors
    /// Not even the fewest paths find room on the machine.
    pub fn room_on_machine(
        &self,
        wanted_bytes: u64,
        free_bytes: Option<u64>,
    ) -> Result<u64, TooLittleMemory> {
        let Some(free_bytes) = free_bytes else {
            return Ok(wanted_bytes);
        };
        let room = self
            .room_for_paths(free_bytes)
            .map_err(|error| TooLittleMemory {
                by_machine: true,
                ..error
            })?;
        Ok(room.min(wanted_bytes))
    }

    /// The most cells, within some percent, that would fit.
    fn fitting(&self, allowed_bytes: u64) -> Option<usize> {
        let mut size = *self;
        while size.least_bytes() > allowed_bytes {
            size.cells = size.cells / 32 * 31 + size.cells % 32 * 31 / 32;
            if size.cells == 0 {
                return None;
            }
        }
        Some(size.cells)
    }
}

/// What the machine, or the group of processes that this one belongs to, has free; `None` where
/// nobody says.
pub fn free_bytes() -> Option<u64> {
    let read = |path: &str| std::fs::read_to_string(path).ok();
    let available = read("/proc/meminfo").and_then(|text| available_in(&text));
    let group = || {
        let number = |name: &str| -> Option<u64> {
            read(&format!("/sys/fs/cgroup/{name}"))?.trim().parse().ok()
        };
        Some(number("memory.max")?.saturating_sub(number("memory.current")?))
    };
    [available, group()].into_iter().flatten().min()
}

fn available_in(meminfo: &str) -> Option<u64> {
    let line = meminfo
        .lines()
        .find(|line| line.starts_with("MemAvailable:"))?;
    let kibibytes: u64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kibibytes << 10)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn size(side: usize, lights: usize) -> Size {
        Size {
            cells: side * side,
            lights,
            atoms: 26,
            bench_parameters: 0,
        }
    }

    #[test]
    fn usual_fits_find_room_and_large_ones_are_told_what_would_do() {
        let mebi = |n: u64| n << 20;
        // Four lights on 64 x 64 cells leave most of 512 MiB to the paths.
        let room = size(64, 4).room_for_paths(mebi(512)).unwrap();
        assert!(room > mebi(380), "{room}");
        for (side, lights, allowed) in [(512, 2, 512), (4096, 2, 16_384), (128, 4, 64), (64, 1, 16)]
        {
            let size = size(side, lights);
            let error = size.room_for_paths(mebi(allowed)).unwrap_err();
            let enough = mebi(error.needed_mebibytes());
            assert!(size.room_for_paths(enough).is_ok(), "{error}");
            match error.fitting_cells {
                Some(cells) => {
                    let smaller = Size { cells, ..size };
                    assert!(smaller.room_for_paths(mebi(allowed)).is_ok(), "{error:?}");
                }
                None => assert_eq!(allowed, 16),
            }
        }
        let huge = Size {
            cells: usize::MAX,
            ..size(1, 64)
        };
        assert!(huge.room_for_paths(u64::MAX - 1).is_err());
    }

    #[test]
    fn without_a_wish_the_machine_decides() {
        let (wanted, large) = (512 << 20, size(512, 4));
        assert_eq!(large.room_on_machine(wanted, None), Ok(wanted));
        assert_eq!(large.room_on_machine(wanted, Some(64 << 30)), Ok(wanted));
        let some = large.least_bytes() + (1 << 20);
        let room = large.room_on_machine(wanted, Some(some)).unwrap();
        assert!(room < wanted && room >= large.least_paths_bytes());
        let error = large.room_on_machine(wanted, Some(1 << 30)).unwrap_err();
        assert!(
            error.to_string().contains("what the machine has free"),
            "{error}"
        );
        assert_eq!(
            available_in("MemTotal:  9 kB\nMemAvailable:   18679900 kB\n"),
            Some(18_679_900 << 10)
        );
        assert!(free_bytes().is_none_or(|bytes| bytes > 0));
    }
}
