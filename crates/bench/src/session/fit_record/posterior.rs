//! Posterior samples of a fit as a file: `posterior.npy`, an array of NumPy of single precision.

use std::path::Path;

use super::{FitRecord, FitRecordError, out_of_range};
use crate::brdf::discrepancy::{Discrepancy, EARLIER_VALUES, Material, VALUES};
use crate::brdf::{BrdfError, Mixture};
use crate::inverse::Fit;

/// Samples that are kept: their standard deviation is then known within 13%.
const KEPT: usize = 32;
/// What every such file begins with: NumPy's mark and version 1.0 of its format.
const MAGIC: &[u8] = b"\x93NUMPY\x01\x00";
/// The header's length is a multiple of this.
const ALIGNMENT: usize = 64;

/// Posterior samples of a material, thinned evenly over the chain.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PosteriorRecord {
    /// Of each sample, of R, G and B: the weight of each atom, then, where the fit has a model
    /// discrepancy, g₀ at each node and g₁ at each (fits of before: g₀ at the nodes of their time).
    pub samples: Vec<[Vec<f32>; 3]>,
}

impl PosteriorRecord {
    /// Of a fit; `None` where it drew none.
    pub fn of(fit: &Fit) -> Option<Self> {
        let groups = &fit.posterior_samples;
        let drawn = groups.iter().map(|group| group.posterior.len()).min()?;
        let count = KEPT.min(drawn);
        let of_channel = |at: usize, c: usize| {
            let group = &groups[c.min(groups.len() - 1)];
            let weights = group.posterior[at].iter();
            let discrepancy = group.discrepancies.get(at);
            let values = discrepancy.into_iter().flat_map(|found| found.0.iter());
            weights.chain(values).map(|&value| value as f32).collect()
        };
        let samples = (0..count).map(|k| [0, 1, 2].map(|c| of_channel(k * drawn / count, c)));
        let mut samples: Vec<[Vec<f32>; 3]> = samples.collect();
        // Of channels of which only some have a discrepancy, the others have 0.
        let columns = samples.iter().flatten().map(Vec::len).max()?;
        for row in samples.iter_mut().flatten() {
            row.resize(columns, 0.0);
        }
        Some(Self { samples })
    }

    /// The bytes of `posterior.npy`, of shape (samples, 3, atoms and values of the discrepancy).
    pub(super) fn to_npy(&self) -> Vec<u8> {
        let (samples, columns) = (self.samples.len(), self.columns());
        let mut header = format!(
            "{{'descr': '<f4', 'fortran_order': False, 'shape': ({samples}, 3, {columns}), }}"
        );
        let unpadded = MAGIC.len() + 2 + header.len() + 1;
        header += &" ".repeat(unpadded.next_multiple_of(ALIGNMENT) - unpadded);
        header.push('\n');
        let mut bytes = MAGIC.to_vec();
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.as_bytes());
        let values = self.samples.iter().flatten().flatten();
        bytes.extend(values.flat_map(|value| value.to_le_bytes()));
        bytes
    }

    /// Reads what [`Self::to_npy`] wrote.
    ///
    /// # Errors
    /// Another array, or one that is cut short.
    pub(super) fn from_npy(path: &Path, bytes: &[u8]) -> Result<Self, FitRecordError> {
        let wrong = |key: &str, allowed: &str| out_of_range(path, key, "something else", allowed);
        let after_magic = bytes.strip_prefix(MAGIC);
        let split = after_magic.and_then(|rest| {
            let (length, rest) = rest.split_first_chunk::<2>()?;
            rest.split_at_checked(usize::from(u16::from_le_bytes(*length)))
        });
        let (header, data) = split.ok_or_else(|| wrong("header", "that of an array of NumPy"))?;
        let header = String::from_utf8_lossy(header);
        let shape = header
            .split_once("'<f4', 'fortran_order': False, 'shape': (")
            .and_then(|(_, rest)| rest.split_once(')'))
            .map(|(shape, _)| shape.split(", ").map(str::parse::<usize>));
        let shape: Option<Vec<usize>> =
            shape.and_then(|shape| shape.collect::<Result<_, _>>().ok());
        let Some(&[samples, 3, columns]) = shape.as_deref() else {
            return Err(wrong("header", "'<f4' of shape (samples, 3, values)"));
        };
        let expected = samples
            .checked_mul(12)
            .and_then(|rows| rows.checked_mul(columns));
        if expected != Some(data.len()) || columns == 0 {
            let allowed = format!("those of {samples} x 3 x {columns} values");
            return Err(out_of_range(path, "number of bytes", data.len(), &allowed));
        }
        let (values, _) = data.as_chunks::<4>();
        let values: Vec<f32> = values
            .iter()
            .map(|&four| f32::from_le_bytes(four))
            .collect();
        if values.iter().any(|value| !value.is_finite()) {
            return Err(out_of_range(
                path,
                "a value",
                "not finite",
                "a finite number",
            ));
        }
        let rows = values
            .chunks_exact(3 * columns)
            .map(|sample| [0, 1, 2].map(|c| sample[c * columns..(c + 1) * columns].to_vec()));
        Ok(Self {
            samples: rows.collect(),
        })
    }

    fn columns(&self) -> usize {
        self.samples.first().map_or(0, |sample| sample[0].len())
    }

    /// Whether the samples have the atoms of a fit.
    pub(super) fn check(&self, path: &Path, atoms: usize) -> Result<(), FitRecordError> {
        let (columns, whole, earlier) = (self.columns(), atoms + VALUES, atoms + EARLIER_VALUES);
        if self.samples.is_empty() || ![atoms, whole, earlier].contains(&columns) {
            let allowed = format!("{atoms}, or {whole} (once {earlier}) with a model discrepancy");
            return Err(out_of_range(path, "values of a sample", columns, &allowed));
        }
        Ok(())
    }
}

impl FitRecord {
    /// Materials by up to `count` of the posterior samples, evenly spread; none where the fit
    /// has none.
    ///
    /// # Errors
    /// Samples that are no mixtures of the fit's atoms.
    pub fn sampled_materials(&self, count: usize) -> Result<Vec<Material>, BrdfError> {
        let Some(PosteriorRecord { samples }) = &self.posterior else {
            return Ok(Vec::new());
        };
        let dictionary = self.dictionary()?;
        let (atoms, count) = (dictionary.len(), count.min(samples.len()));
        let material = |k: usize| {
            let sample = &samples[k * samples.len() / count];
            let weights = [0, 1, 2].map(|c| {
                let weights = sample[c].iter().take(atoms).map(|&w| f64::from(w));
                let weights: Vec<f64> = weights.collect();
                // Single precision leaves a sum that is not quite 1.
                let sum: f64 = weights.iter().sum();
                weights.into_iter().map(|weight| weight / sum).collect()
            });
            let mixture = Mixture::new(dictionary.clone(), weights)?;
            let discrepancies = [0, 1, 2].map(|c| {
                let values = sample[c].iter().skip(atoms);
                let values: Vec<f64> = values.map(|&value| f64::from(value)).collect();
                Discrepancy::from_values(&values).unwrap_or_else(Discrepancy::none)
            });
            Ok(Material::new(mixture, &discrepancies))
        };
        (0..count).map(material).collect()
    }
}
