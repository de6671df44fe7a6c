//! The in-span set: twenty fixed mixtures of `paper42`'s atoms, on which a fit has no
//! model error and must find the truth.
//!
//! The file `data/in_span_paper42.json` is what experiments read ([`set`]);
//! [`draw`] says how it was made, and a test compares the two.

use std::sync::Arc;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::check::directional_albedo;
use super::dictionary::{Atom, Dictionary};
use super::mixture::Mixture;
use crate::random::{Purpose, Stream, stream};

/// Which demand a mixture was drawn under.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Stratum {
    /// At least 0.05 of the weight on atoms with alpha ≤ 0.05.
    Narrow,
    /// Albedo above 0.7.
    Bright,
    /// Albedo above 0.05.
    Any,
}

/// Weight of one atom.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Share {
    /// Index in the dictionary.
    pub atom: usize,
    /// Its weight, (0, 1].
    pub weight: f64,
}

/// One material of the set; grey (all channels alike).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct InSpan {
    /// `in-span-01` and so on.
    pub name: String,
    /// What was demanded of it.
    pub stratum: Stratum,
    /// Reflected over incident power under a uniform sky, to three digits.
    pub albedo: f64,
    /// Four reflecting atoms, then black; the weights sum to one.
    pub shares: Vec<Share>,
}

/// The file.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InSpanFile {
    /// Whose atoms the shares count.
    pub dictionary: String,
    /// How they were drawn.
    pub drawn: String,
    /// The materials.
    pub materials: Vec<InSpan>,
}

const TEXT: &str = include_str!("../../data/in_span_paper42.json");
const SEED: u64 = 2026;
const STRATA: [(Stratum, usize); 3] = [
    (Stratum::Narrow, 5),
    (Stratum::Bright, 5),
    (Stratum::Any, 10),
];

/// The set, in the order of the file.
pub fn set() -> Vec<InSpan> {
    let file: InSpanFile = serde_json::from_str(TEXT).expect("the embedded set is valid (tested)");
    file.materials
}

impl InSpan {
    /// As a mixture of [`Dictionary::paper42`].
    pub fn mixture(&self) -> Mixture {
        let dictionary = Arc::new(Dictionary::paper42());
        let mut weights = vec![0.0; dictionary.len()];
        for share in &self.shares {
            weights[share.atom] = share.weight;
        }
        Mixture::grey(dictionary, weights).expect("shares of the embedded set sum to one (tested)")
    }

    /// Smallest alpha among its atoms; 1 if none is a lobe.
    pub fn smallest_alpha(&self) -> f64 {
        let dictionary = Dictionary::paper42();
        self.shares
            .iter()
            .filter_map(|share| dictionary.atoms()[share.atom].alpha())
            .fold(1.0, f64::min)
    }
}

/// Draws the set: per material four atoms without repetition among the 40 that are distinct
/// and reflect, and weights for them and black from a uniform Dirichlet distribution, rounded
/// to four digits, again until the stratum's demand is met.
pub fn draw() -> InSpanFile {
    let dictionary = Dictionary::paper42();
    let duplicates = dictionary.duplicate_of();
    let (reflecting, black): (Vec<usize>, Vec<usize>) = (0..dictionary.len())
        .filter(|&k| duplicates[k].is_none())
        .partition(|&k| dictionary.atoms()[k] != Atom::Black);
    let albedos: Vec<f64> = dictionary.atoms().iter().map(sky_albedo).collect();
    let mut materials = Vec::new();
    for (stratum, count) in STRATA {
        for _ in 0..count {
            let index = materials.len() as u64;
            let shares = (0..)
                .map(|attempt| {
                    let numbers = stream(SEED, Purpose::Experiment, 0, index, attempt);
                    candidate(&reflecting, black[0], numbers)
                })
                .find(|shares| is_met(stratum, shares, &dictionary, &albedos))
                .unwrap_or_default();
            materials.push(InSpan {
                name: format!("in-span-{:02}", index + 1),
                stratum,
                albedo: (1e3 * albedo(&shares, &albedos)).round() / 1e3,
                shares,
            });
        }
    }
    InSpanFile {
        dictionary: dictionary.name().to_owned(),
        drawn: format!("rig::brdf::in_span::draw, seed {SEED}"),
        materials,
    }
}

fn candidate(reflecting: &[usize], black: usize, mut numbers: Stream) -> Vec<Share> {
    let mut left = reflecting.to_vec();
    let mut atoms: Vec<usize> = (0..4)
        .map(|_| left.swap_remove((numbers.uniform() * left.len() as f64) as usize))
        .collect();
    atoms.push(black);
    let exponential: Vec<f64> = atoms
        .iter()
        .map(|_| -(1.0 - numbers.uniform()).ln())
        .collect();
    let sum: f64 = exponential.iter().sum();
    let mut counts: Vec<u32> = exponential
        .iter()
        .map(|e| (1e4 * e / sum).round() as u32)
        .collect();
    // Black takes the rounding.
    let others: u32 = counts[..4].iter().sum();
    counts[4] = 10_000u32.saturating_sub(others);
    atoms
        .into_iter()
        .zip(counts)
        .map(|(atom, count)| Share {
            atom,
            weight: f64::from(count) / 1e4,
        })
        .collect()
}

fn is_met(stratum: Stratum, shares: &[Share], dictionary: &Dictionary, albedos: &[f64]) -> bool {
    let sum: f64 = shares.iter().map(|s| s.weight).sum();
    let all_there = (sum - 1.0).abs() < 1e-9 && shares.iter().all(|s| s.weight > 0.0);
    let narrow: f64 = shares
        .iter()
        .filter(|s| matches!(dictionary.atoms()[s.atom], Atom::Ggx { alpha, .. } if alpha <= 0.05))
        .map(|s| s.weight)
        .sum();
    let albedo = albedo(shares, albedos);
    all_there
        && match stratum {
            Stratum::Narrow => narrow >= 0.05 && albedo > 0.05,
            Stratum::Bright => albedo > 0.7,
            Stratum::Any => albedo > 0.05,
        }
}

fn albedo(shares: &[Share], albedos: &[f64]) -> f64 {
    shares.iter().map(|s| s.weight * albedos[s.atom]).sum()
}

/// Reflected over incident power under a uniform sky: 16 directions of equal projected
/// solid angle.
fn sky_albedo(atom: &Atom) -> f64 {
    const RINGS: u32 = 16;
    let dictionary = match Dictionary::new("one", vec![*atom]) {
        Ok(dictionary) => Arc::new(dictionary),
        Err(_) => return 0.0,
    };
    let Ok(mixture) = Mixture::grey(dictionary, vec![1.0]) else {
        return 0.0;
    };
    let sum: f64 = (0..RINGS)
        .map(|ring| {
            let sin2 = (f64::from(ring) + 0.5) / f64::from(RINGS);
            let to_light = DVec3::new(sin2.sqrt(), 0.0, (1.0 - sin2).sqrt());
            directional_albedo(&mixture, to_light, 512)[0]
        })
        .sum();
    sum / f64::from(RINGS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_file_is_what_is_drawn() {
        let file: InSpanFile = serde_json::from_str(TEXT).unwrap();
        let drawn = draw();
        let text = serde_json::to_string_pretty(&drawn).unwrap();
        assert!(file == drawn, "the generator now gives:\n{text}");
    }

    #[test]
    fn the_set_is_as_varied_as_it_says() {
        let set = set();
        assert_eq!(set.len(), 20);
        let narrow = set.iter().filter(|m| m.smallest_alpha() <= 0.05).count();
        let bright = set.iter().filter(|m| m.albedo > 0.7).count();
        assert!(narrow >= 5 && bright >= 5, "{narrow} {bright}");
        for material in &set {
            assert_eq!(material.shares.len(), 5);
            let sum: f64 = material.mixture().weights()[0].iter().sum();
            assert!((sum - 1.0).abs() < 1e-12);
        }
    }
}
