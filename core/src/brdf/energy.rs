//! Energy conservation: no material reflects more than arrives.
//!
//! A mixture of a dictionary's atoms conserves energy because its atoms do. A model discrepancy
//! multiplies it by e^g and can break that. The directional albedo
//!
//! > a(θ) = ∫ f(θ, ω) cos ω dω = Σₙₖ aₙₖ(θ) e^(g₀ₙ + g₁ₙ cₖ)
//!
//! is linear in the factors at the discrepancy's nodes n and levels k of cos 2φd, so [`EnergyBound`]
//! tabulates the aₙₖ of every atom once, and [`EnergyBound::bounded`] lowers g₀ where a(θ) exceeds 1.
//! Between nine levels the factor, which is convex, counts as linear: the albedo is never taken for
//! too small, and for |g₁| = 1 at most 0.8% too large. The change of g₀
//! follows a smooth covariance and falls on the angles at which g is known
//! least a priori. Applied to posterior samples this is the projected posterior of Lin and Dunson
//! (2014): samples of the unconstrained posterior moved into the set that the constraint leaves.

use glam::DVec3;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::discrepancy::{Discrepancy, Material, NODES, Place, smoothed};
use super::ggx::Cosines;
use super::{Dictionary, quadrature};

/// Angles of incidence at which the albedo is bounded, degrees: the difference angles of the
/// nodes and, from 45° on, the middles between them, where the albedo of a narrow lobe whose g is
/// large bulges by up to 2%.
const ANGLES_DEG: [f64; 36] = [
    0.0, 6.0, 12.0, 18.0, 24.0, 29.5, 35.0, 40.0, 45.0, 47.2, 49.5, 51.7, 54.0, 56.0, 58.0, 60.0,
    62.0, 63.7, 65.5, 67.2, 69.0, 70.7, 72.5, 74.2, 76.0, 77.5, 79.0, 80.5, 82.0, 84.0, 85.0, 86.0,
    87.0, 88.0, 88.7, 89.3,
];

/// Directions per technique of the albedo's quadrature.
const PER_TECHNIQUE: u32 = 1024;

/// Largest albedo that is left: between the tabulated angles, and by another quadrature, it stays
/// below 1.005.
const LARGEST_ALBEDO: f64 = 0.995;

/// Largest |g|: a factor of 150, more than ten of its standard deviations a priori at most angles.
const LARGEST_LOGARITHM: f64 = 5.0;

/// Largest |g₁|.
const LARGEST_SLOPE: f64 = 2.0;

/// Levels of cos 2φd, from −1 to 1.
const LEVELS: usize = 9;

/// Steps along violated bounds before g is lowered at all nodes alike.
const STEPS: usize = 60;

/// The directional albedo of a dictionary's mixtures, by atom and by node and level of the
/// discrepancy.
pub struct EnergyBound {
    /// Per angle of incidence.
    parts: Vec<Part>,
}

/// The albedo at one angle of incidence.
struct Part {
    /// Node and level of each row, as one number.
    places: Vec<usize>,
    /// What each of them contributes of each atom (column).
    values: DMatrix<f64>,
}

impl Part {
    fn new(dictionary: &Dictionary, angle_deg: f64) -> Self {
        let evaluator = dictionary.evaluator();
        let (sin, cos) = angle_deg.to_radians().sin_cos();
        let to_light = DVec3::new(sin, 0.0, cos);
        let mut values = vec![0.0f32; dictionary.len()];
        let mut all = DMatrix::<f64>::zeros(dictionary.len(), NODES * LEVELS);
        for (to_viewer, weight) in quadrature::nodes(to_light, PER_TECHNIQUE, [0.37, 0.61]) {
            let (i, o) = (to_light.as_vec3(), to_viewer.as_vec3());
            let Some(at) = Cosines::new(i.to_array(), o.to_array()) else {
                continue;
            };
            evaluator.eval(&at, &mut values);
            let place = Place::of(i, o);
            let level = f64::from(place.cos_2phi + 1.0) * 0.5 * (LEVELS - 1) as f64;
            let below = (level as usize).min(LEVELS - 2);
            let above = level - below as f64;
            for (node, share) in place.around {
                for (level, part) in [(below, 1.0 - above), (below + 1, above)] {
                    let weight = weight * to_viewer.z * f64::from(share) * part;
                    let mut column = all.column_mut(node * LEVELS + level);
                    for (sum, value) in column.iter_mut().zip(&values) {
                        *sum += weight * f64::from(*value);
                    }
                }
            }
        }
        // For one angle, φd is a function of the two others: few places have a part.
        let with_part = |k: &usize| all.column(*k).iter().any(|v| *v != 0.0);
        let kept: Vec<usize> = (0..NODES * LEVELS).filter(with_part).collect();
        let mut values = all.select_columns(&kept).transpose();
        // Where a lobe's atom exceeds 1 by the quadrature's own error, it counts as 1.
        for mut column in values.column_iter_mut() {
            let albedo = column.sum();
            if albedo > LARGEST_ALBEDO {
                column *= LARGEST_ALBEDO / albedo;
            }
        }
        Self {
            places: kept,
            values,
        }
    }

    /// What each node contributes for these weights and the factors of g₁ at every place.
    fn by_node(&self, weights: &[f64], factors: &[f64]) -> DVector<f64> {
        // Most weights of a posterior sample are 0.
        let mut parts = DVector::zeros(self.places.len());
        for (atom, weight) in weights.iter().enumerate().filter(|(_, w)| **w != 0.0) {
            parts.axpy(*weight, &self.values.column(atom), 1.0);
        }
        let mut by_node = DVector::zeros(NODES);
        for (place, part) in self.places.iter().zip(parts.iter()) {
            by_node[place / LEVELS] += part * factors[*place];
        }
        by_node
    }
}

impl EnergyBound {
    /// Tabulates the atoms of `dictionary`.
    pub fn new(dictionary: &Dictionary) -> Self {
        let parts = ANGLES_DEG
            .par_iter()
            .map(|angle_deg| Part::new(dictionary, *angle_deg))
            .collect();
        Self { parts }
    }

    /// Per angle, what each node contributes to the albedo without g₀.
    fn by_node(&self, weights: &[f64], discrepancy: &Discrepancy) -> Vec<DVector<f64>> {
        let slopes = &discrepancy.0.as_slice()[NODES..];
        let cosine = |level: usize| 2.0 * level as f64 / (LEVELS - 1) as f64 - 1.0;
        let factors: Vec<f64> = (0..NODES * LEVELS)
            .map(|k| (slopes[k / LEVELS] * cosine(k % LEVELS)).exp())
            .collect();
        let parts = self.parts.iter();
        parts.map(|part| part.by_node(weights, &factors)).collect()
    }

    /// Largest directional albedo of the mixture of these weights with a discrepancy.
    pub fn largest_albedo(&self, weights: &[f64], discrepancy: &Discrepancy) -> f64 {
        let factors = discrepancy.0.rows(0, NODES).map(f64::exp);
        let parts = self.by_node(weights, discrepancy);
        let albedos = parts.iter().map(|part| part.dot(&factors));
        albedos.fold(0.0, f64::max)
    }

    /// The discrepancy, lowered where the mixture of these weights would reflect more than
    /// arrives with it; finite.
    pub fn bounded(&self, weights: &[f64], discrepancy: &Discrepancy) -> Discrepancy {
        let limit = |g: f64| g.clamp(-LARGEST_LOGARITHM, LARGEST_LOGARITHM);
        let mut bounded = discrepancy.clone();
        bounded.0.apply(|g| {
            if g.is_nan() {
                *g = 0.0;
            }
        });
        let mut slopes = bounded.0.rows_mut(NODES, NODES);
        slopes.apply(|g| *g = g.clamp(-LARGEST_SLOPE, LARGEST_SLOPE));
        let parts = self.by_node(weights, &bounded);
        let mut g = bounded.0.rows(0, NODES).map(limit);
        let mut excess = 1.0;
        for step in 0..=STEPS {
            let factors = g.map(f64::exp);
            let albedos = parts.iter().map(|part| part.dot(&factors));
            let worst = albedos.enumerate().max_by(|a, b| a.1.total_cmp(&b.1));
            let Some((angle, albedo)) = worst.filter(|(_, albedo)| *albedo > LARGEST_ALBEDO) else {
                break;
            };
            if step == STEPS {
                excess = albedo / LARGEST_ALBEDO;
                break;
            }
            // A Newton step of ln a(θ) along the covariance: it lowers g₀ everywhere or not at
            // all, and so no other albedo rises.
            let slope = parts[angle].component_mul(&factors);
            let along = smoothed(&slope);
            let length = (albedo / (0.999 * LARGEST_ALBEDO)).ln() * albedo / slope.dot(&along);
            g.axpy(-length, &along, 1.0);
            g.apply(|g| *g = limit(*g));
        }
        g.add_scalar_mut(-excess.ln());
        bounded.0.rows_mut(0, NODES).copy_from(&g);
        bounded
    }

    /// A material of the dictionary with its discrepancies bounded, and the largest directional
    /// albedo that it had in each channel before.
    pub fn bound(&self, material: &Material) -> (Material, [f64; 3]) {
        let mut bounded = material.clone();
        let weights = material.mixture.weights();
        let mut albedo = [0.0; 3];
        for c in 0..3 {
            let discrepancy = &mut bounded.discrepancies[c];
            albedo[c] = self.largest_albedo(&weights[c], discrepancy);
            if discrepancy.0.iter().any(|g| *g != 0.0) {
                *discrepancy = self.bounded(&weights[c], discrepancy);
            }
        }
        (bounded, albedo)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::brdf::check::{check_with, directional_albedo};
    use crate::brdf::discrepancy::{Prior, nodes};
    use crate::brdf::{Atom, Mixture};
    use crate::random::{Purpose, stream};

    fn material(dictionary: &Arc<Dictionary>, seed: u64, strength: f64) -> Material {
        let mut numbers = stream(seed, Purpose::Experiment, 0, 0, 0);
        let weights = [0; 3].map(|_| {
            let raw: Vec<f64> = (0..dictionary.len())
                .map(|_| numbers.uniform().powi(12))
                .collect();
            let sum: f64 = raw.iter().sum();
            raw.iter().map(|w| w / sum).collect()
        });
        let mixture = Mixture::new(dictionary.clone(), weights).unwrap();
        let prior = Prior::without(&[]);
        let modes = prior.modes();
        let discrepancies = [0; 3].map(|_| {
            let z = DVector::from_fn(modes.ncols(), |_, _| strength * numbers.normal());
            Discrepancy(modes * z)
        });
        Material::new(mixture, &discrepancies)
    }

    /// By the independent check's quadrature at its own angles, and at angles between those of the
    /// table: whatever the discrepancy, what is bounded reflects no more than arrives, and what did
    /// so before stays.
    #[test]
    fn whatever_the_discrepancy_no_more_is_reflected_than_arrives() {
        let mut changed = 0;
        for dictionary in [Dictionary::rig26(), Dictionary::paper42()] {
            let dictionary = Arc::new(dictionary);
            let energy = EnergyBound::new(&dictionary);
            for seed in 0..6 {
                let wild = material(&dictionary, seed, [1.0, 8.0][seed as usize % 2]);
                let (bounded, before) = energy.bound(&wild);
                let found = check_with(&bounded, 1024, 200);
                assert!(found.passes(), "{found:?}");
                for angle_deg in [46.0, 53.0, 61.0, 66.5, 71.6, 73.5, 81.0] {
                    let (sin, cos) = f64::to_radians(angle_deg).sin_cos();
                    let to_light = DVec3::new(sin, 0.0, cos);
                    let albedo = directional_albedo(&bounded, to_light, 1024);
                    let largest = albedo.iter().fold(0.0, |a: f64, b| a.max(*b));
                    assert!(largest < 1.005, "seed {seed}, {angle_deg}°: {largest}");
                }
                let small = |g: &f64| g.abs() < LARGEST_LOGARITHM;
                let slopes = |g: &Discrepancy| g.0.rows(NODES, NODES).amax();
                let channels = wild.discrepancies.iter().zip(&bounded.discrepancies);
                for (albedo, (wild, bounded)) in before.iter().zip(channels) {
                    if *albedo > LARGEST_ALBEDO {
                        changed += 1;
                    } else if wild.0.iter().all(small) && slopes(wild) <= LARGEST_SLOPE {
                        assert_eq!(bounded, wild);
                    }
                }
            }
        }
        assert!(changed > 6, "{changed}");
    }

    /// Light that is off by a factor at grazing angles alone is not paid for by the others.
    #[test]
    fn a_bound_changes_what_breaks_it() {
        let dictionary = Arc::new(Dictionary::rig26());
        let mut weights = vec![0.0; dictionary.len()];
        let white = |atom: &Atom| matches!(atom, Atom::Lambertian { .. });
        weights[dictionary.atoms().iter().position(white).unwrap()] = 1.0;
        let energy = EnergyBound::new(&dictionary);
        let grazing = |d: f64| if d > 75.0 { 2.0 } else { -0.3 };
        let g = Discrepancy::even(|n| grazing(n.theta_d_deg));
        let bounded = energy.bounded(&weights, &g);
        assert!(energy.largest_albedo(&weights, &bounded) <= LARGEST_ALBEDO * (1.0 + 1e-9));
        for (k, node) in nodes().enumerate() {
            if node.theta_d_deg < 30.0 && node.theta_h_deg < 45.0 {
                assert!(
                    (bounded.0[k] - g.0[k]).abs() < 0.15,
                    "{node:?}: {}",
                    bounded.0[k]
                );
            }
        }
    }
}
