//! Files of the MERL database (Matusik et al. 2003): `.binary`.
//!
//! Three little-endian i32 (cells in θh, θd, φd), then R, G and B as planes of
//! little-endian f64 in order θh, θd, φd (fastest), scaled by 1500, 1500/1.15 and
//! 1500/1.66; negative values mark directions below the horizon.

use std::path::Path;

use super::table::{MERL_SHAPE, TabulatedBrdf, node};
use super::{Brdf, BrdfError};
use crate::{outside_file, whole_file};

/// 1/sr per stored unit, R, G, B.
pub const SCALE: [f64; 3] = [1.0 / 1500.0, 1.15 / 1500.0, 1.66 / 1500.0];

/// Reads a `.binary` file of any cell counts; its size must be the one its header implies.
pub fn read(path: &Path) -> Result<TabulatedBrdf, BrdfError> {
    let bytes = outside_file::read_regular(path, super::LARGEST_FILE_BYTES).map_err(|source| {
        BrdfError::Io {
            path: path.into(),
            source,
        }
    })?;
    parse(&bytes).map_err(|fact| BrdfError::File {
        path: path.into(),
        fact,
    })
}

/// [`read`] from memory.
pub fn parse(bytes: &[u8]) -> Result<TabulatedBrdf, String> {
    let (header, body) = bytes
        .split_at_checked(12)
        .ok_or_else(|| format!("{} bytes, a MERL file has at least 12", bytes.len()))?;
    let words = header.as_chunks::<4>().0;
    let fit = |of: fn([u8; 4]) -> i32| words.iter().all(|word| (1..=4096).contains(&of(*word)));
    if !fit(i32::from_le_bytes) && fit(i32::from_be_bytes) {
        return Err("its numbers are big-endian; those of a MERL file are little-endian".into());
    }
    let mut shape = [0usize; 3];
    for (axis, word) in words.iter().enumerate() {
        let count = i32::from_le_bytes(*word);
        shape[axis] = usize::try_from(count)
            .ok()
            .filter(|count| (1..=4096).contains(count))
            .ok_or_else(|| format!("{count} cells along axis {axis}, allowed are 1 to 4096"))?;
    }
    let cells = shape[0] * shape[1] * shape[2];
    if body.len() != cells * 24 {
        let how = match body.len() {
            short if short == cells * 12 => "numbers of 32 instead of 64 bits",
            short if short < cells * 24 => "cut short",
            _ => "too long",
        };
        return Err(format!(
            "{how}: {} bytes after the header, {} x {} x {} cells need {}",
            body.len(),
            shape[0],
            shape[1],
            shape[2],
            cells * 24
        ));
    }
    let stored = body.as_chunks::<8>().0;
    let values = (0..cells)
        .map(|cell| {
            [0, 1, 2].map(|c| (f64::from_le_bytes(stored[c * cells + cell]) * SCALE[c]) as f32)
        })
        .collect();
    TabulatedBrdf::new(shape, values).map_err(|error| error.to_string())
}

/// The bytes of a `.binary` file of `brdf` in the database's own cell counts.
pub fn to_bytes(brdf: &dyn Brdf) -> Vec<u8> {
    table_to_bytes(&TabulatedBrdf::from_brdf(MERL_SHAPE, brdf))
}

/// The bytes of a `.binary` file of a table in its own cell counts. [`parse`] gives
/// every value back bit for bit.
pub fn table_to_bytes(table: &TabulatedBrdf) -> Vec<u8> {
    let (shape, values) = (table.shape(), table.values());
    let [_, n_d, n_phi] = shape;
    let mut bytes = Vec::with_capacity(12 + values.len() * 24);
    for count in shape {
        bytes.extend((count as i32).to_le_bytes());
    }
    // Marked are directions below the horizon whose value the reader restores from
    // the next smaller θd.
    let marked: Vec<bool> = (0..values.len())
        .map(|cell| {
            let (j, k) = (cell / n_phi % n_d, cell % n_phi);
            let (i, o) = node(shape, [cell / (n_d * n_phi), j, k]).to_directions();
            let nearer = match j {
                0 => [0.0; 3],
                _ => values[cell - n_phi],
            };
            !(i.z > 0.0 && o.z > 0.0) && values[cell] == nearer
        })
        .collect();
    for channel in 0..3 {
        for (value, &marked) in values.iter().zip(&marked) {
            let stored = if marked {
                -1.0
            } else {
                f64::from(value[channel]) / SCALE[channel]
            };
            bytes.extend(stored.to_le_bytes());
        }
    }
    bytes
}

/// Writes a `.binary` file, 35 MB, in place of any file of that name.
pub fn write(path: &Path, brdf: &dyn Brdf) -> Result<(), BrdfError> {
    let bytes = to_bytes(brdf);
    whole_file::replace(path, |out| out.write_all(&bytes)).map_err(|source| BrdfError::Io {
        path: path.into(),
        source,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, stream};
    use proptest::prelude::*;

    fn small() -> Vec<u8> {
        let mut bytes = Vec::new();
        for count in [2i32, 3, 1] {
            bytes.extend(count.to_le_bytes());
        }
        for value in 0..18 {
            bytes.extend(f64::from(value * 150).to_le_bytes());
        }
        bytes
    }

    #[test]
    fn planes_and_scales() {
        let table = parse(&small()).unwrap();
        assert_eq!(table.shape(), [2, 3, 1]);
        let [r, g, b] = table.values()[4];
        for (got, want) in [(r, 0.4), (g, 1.0 * 1.15), (b, 1.6 * 1.66)] {
            assert!((got - want).abs() < 1e-6, "{got} {want}");
        }
    }

    #[test]
    fn what_is_written_reads_back() {
        let original = TabulatedBrdf::tabulate([4, 4, 1], |a| {
            [0.1 + a.theta_h_rad as f32, 0.2, 0.3 + a.theta_d_rad as f32]
        });
        let fine = TabulatedBrdf::from_brdf(MERL_SHAPE, &original);
        assert_eq!(parse(&to_bytes(&original)).unwrap(), fine);
        // A measured table may hold values below the horizon, and has no smooth ones.
        let mut numbers = stream(1, Purpose::Experiment, 0, 0, 0);
        let values = (0..10 * 12 * 8).map(|_| [0; 3].map(|_| numbers.uniform_f32()));
        let noise = TabulatedBrdf::new([10, 12, 8], values.collect()).unwrap();
        assert_eq!(parse(&table_to_bytes(&noise)).unwrap(), noise);
    }

    proptest! {
        #[test]
        fn no_bytes_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let _ = parse(&bytes);
        }

        #[test]
        fn no_header_panics(header in any::<[i32; 3]>(), rest in 0usize..100) {
            let mut bytes: Vec<u8> = header.iter().flat_map(|c| c.to_le_bytes()).collect();
            bytes.resize(12 + rest, 0);
            let _ = parse(&bytes);
        }

        #[test]
        fn every_other_length_is_refused(length in 0usize..200) {
            let mut bytes = small();
            prop_assume!(length != bytes.len());
            bytes.resize(length, 0);
            prop_assert!(parse(&bytes).is_err());
        }
    }
}
