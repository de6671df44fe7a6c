//! Beyond a fixed list of atoms: after a fit, paths are traced again where the fitted
//! material sends light, and lobes beside the active ones are offered in finer and finer
//! steps of alpha and eta (docs/adr/0014).
//!
//! The dictionary only grows from the one that was given, so a refined fit can say all that
//! the first could, and draws of the weights still range over what the images leave open.

use std::sync::Arc;

use super::bench::system::BenchLinearisation;
use super::cells::Captured;
use super::fit::{Fit, FitError, FitOptions, fit_from};
use super::solve::Solution;
use crate::brdf::Mixture;
use crate::brdf::dictionary::{Atom, Dictionary};
use crate::progress::Progress;
use crate::transport::{Proposal, Scene};

/// What follows a first fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Refine {
    /// Trace again with directions proposed by the fitted material: less noise where it is
    /// glossy. The first fit then takes a quarter of the paths.
    pub adapt_paths: bool,
    /// Rounds of new atoms, 0..=8, on paths traced again; each costs a fit with up to
    /// [`MAX_LOBES`] lobes.
    pub rounds: u32,
}

impl Refine {
    /// One fit on paths that suit any material.
    pub const NONE: Self = Self {
        adapt_paths: false,
        rounds: 0,
    };
}

impl Default for Refine {
    fn default() -> Self {
        Self {
            adapt_paths: true,
            ..Self::NONE
        }
    }
}

/// GGX atoms of a refined dictionary.
pub const MAX_LOBES: usize = 64;
/// Probability of a re-traced path's continuation that is left to the default proposal.
pub(super) const DEFENSIVE: f32 = 0.4;
/// First ratio between a new alpha and its parent's, and between η − 1; each round takes the
/// square root.
const FIRST_RATIO: [f64; 2] = [1.35, 1.8];
/// Widths and indices of new atoms.
const ALPHAS: std::ops::RangeInclusive<f64> = 0.008..=1.0;
const ETAS: std::ops::RangeInclusive<f64> = 1.01..=50.0;
/// A weight that counts as active.
const ACTIVE: f64 = 1e-4;
/// New atoms stay where ½χ² falls by more than this many of its own deviations.
const SIGNIFICANT: f64 = 2.0;

/// A fit that goes on from `first`, a solution for the atoms to begin with.
pub(super) fn refine(
    scene: &Scene,
    captured: &Captured,
    first: Solution,
    options: &FitOptions,
    bench: Option<&BenchLinearisation>,
    progress: &dyn Progress,
) -> Result<Fit, FitError> {
    let base = first.dictionary.clone();
    let mut options = options.clone();
    if let Ok(mixture) = Mixture::new(base.clone(), first.weights.clone()) {
        options.cache.proposal = Proposal::resembling(&mixture, DEFENSIVE);
    }
    let again = |dictionary: &Arc<Dictionary>, before: &Solution| {
        let earlier = Some(before);
        fit_from(
            scene, captured, dictionary, earlier, &options, bench, progress,
        )
    };
    // Old and new atoms must be compared on the same paths.
    let (mut best, mut solution) = again(&base, &first)?;
    let mut ratio = FIRST_RATIO;
    for _ in 0..options.refine.rounds {
        let Some(larger) = enlarge(&base, &solution, ratio) else {
            break;
        };
        let (next, solved) = again(&Arc::new(larger), &solution)?;
        let (gain, deviation) = gain(&best, &next);
        log::debug!("refined atoms: gain {gain}, deviation {deviation}");
        if gain > SIGNIFICANT * deviation {
            (best, solution) = (next, solved);
        }
        ratio = ratio.map(f64::sqrt);
    }
    Ok(best)
}

/// `base`, the active atoms of `fitted`, and neighbours of those at `ratio`, the parents that
/// reflect most first, up to [`MAX_LOBES`] lobes; `None` if that adds nothing.
fn enlarge(base: &Dictionary, fitted: &Solution, ratio: [f64; 2]) -> Option<Dictionary> {
    let duplicates = base.duplicate_of();
    let mut atoms: Vec<Atom> = base
        .atoms()
        .iter()
        .zip(&duplicates)
        .filter(|(_, duplicate)| duplicate.is_none())
        .map(|(atom, _)| *atom)
        .collect();
    let mut active: Vec<(f64, Atom)> = fitted
        .dictionary
        .atoms()
        .iter()
        .enumerate()
        .filter_map(|(k, atom)| {
            let weight = fitted.weights.iter().map(|w| w[k]).fold(0.0, f64::max);
            let power = weight * atom.facets()?.power_at_45_deg();
            (weight > ACTIVE).then_some((power, *atom))
        })
        .collect();
    active.sort_by(|a, b| b.0.total_cmp(&a.0));
    let neighbours = active.iter().flat_map(|(_, atom)| beside(atom, ratio));
    let fixed = atoms.len();
    let mut lobes = atoms.iter().filter(|atom| atom.varies()).count();
    for atom in active.iter().map(|(_, atom)| *atom).chain(neighbours) {
        if lobes < MAX_LOBES && !atoms.contains(&atom) {
            atoms.push(atom);
            lobes += 1;
        }
    }
    let added = atoms.len() > fixed;
    let name = format!("{}-refined", base.name());
    added.then(|| Dictionary::new(name, atoms).ok()).flatten()
}

/// The four lobes next to one, to four digits; those out of range are left out.
fn beside(atom: &Atom, [alpha_ratio, eta_ratio]: [f64; 2]) -> Vec<Atom> {
    let (Some(alpha), Some(eta)) = (atom.alpha(), atom.eta()) else {
        return Vec::new();
    };
    let round = |x: f64| (x * 1e4).round() / 1e4;
    [
        (alpha * alpha_ratio, eta),
        (alpha / alpha_ratio, eta),
        (alpha, 1.0 + (eta - 1.0) * eta_ratio),
        (alpha, 1.0 + (eta - 1.0) / eta_ratio),
    ]
    .map(|(alpha, eta)| (round(alpha), round(eta)))
    .into_iter()
    .filter(|(alpha, eta)| ALPHAS.contains(alpha) && ETAS.contains(eta))
    .filter_map(|(alpha, eta)| Atom::from_parts(atom.kind(), Some(alpha), Some(eta), None))
    .collect()
}

/// By how much ½χ² falls from `old` to `new`, and the deviation of that difference, from
/// its scatter over the compared values.
fn gain(old: &Fit, new: &Fit) -> (f64, f64) {
    let (mut sum, mut square) = (0.0, 0.0);
    let images = old.comparison.images.iter().zip(&new.comparison.images);
    for (old, new) in images {
        for (old, after) in old.residual.iter().zip(&new.residual) {
            // Nothing where it was not compared.
            for c in 0..3 {
                let fall = 0.5 * (old[c] * old[c] - after[c] * after[c]);
                sum += fall;
                square += fall * fall;
            }
        }
    }
    (sum, square.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_stay_in_range_and_differ_from_their_parent() {
        let parent = Atom::Ggx {
            alpha: 0.2,
            eta: 1.5,
        };
        let beside_it = beside(&parent, FIRST_RATIO);
        assert_eq!(beside_it.len(), 4);
        assert!(!beside_it.contains(&parent));
        let edge = Atom::Ggx {
            alpha: 0.01,
            eta: 1.01,
        };
        for atom in beside(&edge, FIRST_RATIO) {
            assert!(Dictionary::new("one", vec![atom]).is_ok());
        }
        assert!(beside(&Atom::Black, FIRST_RATIO).is_empty());
    }
}
