//! Energy conservation: no material reflects more than arrives.
//!
//! A mixture of a dictionary's atoms conserves energy because its atoms do. A model discrepancy
//! multiplies it by e^g and can break that. The directional albedo
//!
//! > a(θ) = ∫ f(θ, ω) cos ω dω = Σₙ aₙ(θ) e^(gₙ)
//!
//! is linear in the factors e^(gₙ) of the discrepancy's nodes n, so [`EnergyBound`] tabulates the
//! aₙ of every atom once, and [`EnergyBound::bounded`] lowers g where a(θ) exceeds 1. The change
//! follows the covariance of g, so that it is smooth and falls on the angles at which g is known
//! least a priori. Applied to posterior samples this is the projected posterior of Lin and Dunson
//! (2014): samples of the unconstrained posterior moved into the set that the constraint leaves.

use std::sync::OnceLock;

use glam::DVec3;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::discrepancy::{Discrepancy, Material, NODES, covariance, node_weights};
use super::ggx::Cosines;
use super::{Dictionary, quadrature};

/// Angles of incidence at which the albedo is bounded, degrees: the difference angles of the
/// nodes, between which a narrow lobe's albedo is about linear, and some between them.
const ANGLES_DEG: [f64; 26] = [
    0.0, 6.0, 12.0, 18.0, 24.0, 29.5, 35.0, 40.0, 45.0, 49.5, 54.0, 58.0, 62.0, 65.5, 69.0, 72.5,
    76.0, 79.0, 82.0, 84.0, 85.0, 86.0, 87.0, 88.0, 88.7, 89.3,
];

/// Directions per technique of the albedo's quadrature.
const PER_TECHNIQUE: u32 = 1024;

/// Largest albedo that is left: between the tabulated angles, and by another quadrature, it stays
/// below 1.005.
const LARGEST_ALBEDO: f64 = 0.996;

/// Largest |g|: a factor of 150, more than ten of its standard deviations a priori at most angles.
const LARGEST_LOGARITHM: f64 = 5.0;

/// Steps along violated bounds before g is lowered at all nodes alike.
const STEPS: usize = 60;

/// The directional albedo of a dictionary's mixtures, by atom and node of the discrepancy.
pub struct EnergyBound {
    /// Per angle: what each node (row) contributes of each atom (column).
    parts: Vec<DMatrix<f64>>,
}

impl EnergyBound {
    /// Tabulates the atoms of `dictionary`.
    pub fn new(dictionary: &Dictionary) -> Self {
        let parts = ANGLES_DEG
            .par_iter()
            .map(|angle_deg| Self::at_angle(dictionary, *angle_deg))
            .collect();
        Self { parts }
    }

    fn at_angle(dictionary: &Dictionary, angle_deg: f64) -> DMatrix<f64> {
        let evaluator = dictionary.evaluator();
        let (sin, cos) = angle_deg.to_radians().sin_cos();
        let to_light = DVec3::new(sin, 0.0, cos);
        let mut values = vec![0.0f32; dictionary.len()];
        let mut part = DMatrix::zeros(NODES, dictionary.len());
        for (to_viewer, weight) in quadrature::nodes(to_light, PER_TECHNIQUE, [0.37, 0.61]) {
            let (i, o) = (to_light.as_vec3(), to_viewer.as_vec3());
            let Some(at) = Cosines::new(i.to_array(), o.to_array()) else {
                continue;
            };
            evaluator.eval(&at, &mut values);
            for (node, share) in node_weights(i, o) {
                let weight = weight * to_viewer.z * f64::from(share);
                for (atom, value) in values.iter().enumerate() {
                    part[(node, atom)] += weight * f64::from(*value);
                }
            }
        }
        // Where a lobe's atom exceeds 1 by the quadrature's own error, it counts as 1.
        for mut column in part.column_iter_mut() {
            let albedo = column.sum();
            if albedo > LARGEST_ALBEDO {
                column *= LARGEST_ALBEDO / albedo;
            }
        }
        part
    }

    /// Largest directional albedo of the mixture of these weights with a discrepancy.
    pub fn largest_albedo(&self, weights: &[f64], discrepancy: &Discrepancy) -> f64 {
        let factors = discrepancy.0.map(f64::exp);
        let weights = DVector::from_column_slice(weights);
        let albedo = |part: &DMatrix<f64>| (part * &weights).dot(&factors);
        self.parts.iter().map(albedo).fold(0.0, f64::max)
    }

    /// The discrepancy, lowered where the mixture of these weights would reflect more than
    /// arrives with it; finite.
    pub fn bounded(&self, weights: &[f64], discrepancy: &Discrepancy) -> Discrepancy {
        let limit = |g: f64| g.clamp(-LARGEST_LOGARITHM, LARGEST_LOGARITHM);
        let mut g = discrepancy
            .0
            .map(|g| if g.is_nan() { 0.0 } else { limit(g) });
        let weights = DVector::from_column_slice(weights);
        let parts: Vec<DVector<f64>> = self.parts.iter().map(|part| part * &weights).collect();
        for _ in 0..STEPS {
            let factors = g.map(f64::exp);
            let albedos = parts.iter().map(|part| part.dot(&factors));
            let worst = albedos.enumerate().max_by(|a, b| a.1.total_cmp(&b.1));
            let Some((angle, albedo)) = worst.filter(|(_, albedo)| *albedo > LARGEST_ALBEDO) else {
                return Discrepancy(g);
            };
            // A Newton step of ln a(θ) along the covariance: it lowers g everywhere or not at
            // all, and so no other albedo rises.
            let slope = parts[angle].component_mul(&factors);
            let along = prior_covariance() * &slope;
            let length = (albedo / (0.999 * LARGEST_ALBEDO)).ln() * albedo / slope.dot(&along);
            g.axpy(-length, &along, 1.0);
            g.apply(|g| *g = limit(*g));
        }
        let left = Discrepancy(g);
        let excess = self.largest_albedo(weights.as_slice(), &left) / LARGEST_ALBEDO;
        Discrepancy(left.0.add_scalar(-excess.max(1.0).ln()))
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

/// Covariance of g a priori, a common factor included.
fn prior_covariance() -> &'static DMatrix<f64> {
    static COVARIANCE: OnceLock<DMatrix<f64>> = OnceLock::new();
    COVARIANCE.get_or_init(covariance)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::brdf::check::check_with;
    use crate::brdf::{Atom, Mixture, discrepancy::nodes};
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
        let modes = crate::brdf::discrepancy::modes();
        let discrepancies = [0; 3].map(|_| {
            let z = DVector::from_fn(modes.ncols(), |_, _| strength * numbers.normal());
            Discrepancy(modes * z)
        });
        Material::new(mixture, &discrepancies)
    }

    /// By the independent check's quadrature at its own angles, and more of them: whatever the
    /// discrepancy, what is bounded reflects no more than arrives, and what did so before stays.
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
                let small = |g: &f64| g.abs() < LARGEST_LOGARITHM;
                let channels = wild.discrepancies.iter().zip(&bounded.discrepancies);
                for (albedo, (wild, bounded)) in before.iter().zip(channels) {
                    if *albedo > LARGEST_ALBEDO {
                        changed += 1;
                    } else if wild.0.iter().all(small) {
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
        let g = DVector::from_iterator(NODES, nodes().map(|n| grazing(n.theta_d_deg)));
        let bounded = energy.bounded(&weights, &Discrepancy(g.clone()));
        assert!(energy.largest_albedo(&weights, &bounded) <= LARGEST_ALBEDO * (1.0 + 1e-9));
        for (k, node) in nodes().enumerate() {
            if node.theta_d_deg < 30.0 && node.theta_h_deg < 45.0 {
                assert!(
                    (bounded.0[k] - g[k]).abs() < 0.15,
                    "{node:?}: {}",
                    bounded.0[k]
                );
            }
        }
    }
}
