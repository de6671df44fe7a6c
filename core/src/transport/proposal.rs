//! The density from which path continuations are drawn: a defensive mixture of a
//! cosine lobe, visible-normal GGX lobes and a measured material's own table. It does
//! not depend on the unknown weights, so cached paths stay valid while the fit moves.

use std::sync::Arc;

use glam::Vec3;

use crate::brdf::mixture::Mixture;
use crate::brdf::{Brdf, LobeTable, ggx};
use crate::random::Uniform;

/// A mixture over directions.
///
/// ```
/// use glam::Vec3;
/// use rig_core::random::{Purpose, stream};
/// use rig_core::transport::Proposal;
///
/// let proposal = Proposal::default();
/// let to_viewer = Vec3::new(0.6, 0.0, 0.8);
/// let mut numbers = stream(1, Purpose::PathDirection, 0, 0, 0);
/// // `None` where the drawn direction is below the horizon.
/// if let Some((direction, density)) = proposal.sample(to_viewer, &mut numbers) {
///     assert!(direction.z > 0.0);
///     assert!((proposal.pdf(to_viewer, direction) / density - 1.0).abs() < 1e-3);
/// }
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Proposal {
    /// Probability of the cosine lobe; all probabilities sum to one.
    cosine: f32,
    /// Width and probability of the GGX lobes, at most [`MAX_LOBES`].
    lobes: Vec<(f32, f32)>,
    /// A material's own lobes and their probability.
    table: Option<(Arc<LobeTable>, f32)>,
}

impl Default for Proposal {
    /// Fits every atom of the usual dictionaries tolerably.
    fn default() -> Self {
        Self::of_lobes([(0.01, 0.15), (0.03, 0.15), (0.1, 0.15), (0.3, 0.25)])
    }
}

/// Most lobes of an adapted proposal: each costs an evaluation per continuation.
const MAX_LOBES: usize = 6;
/// Parts of a proposal: the cosine, the lobes, the table.
pub(super) const PARTS: usize = MAX_LOBES + 2;
const TABLE: usize = PARTS - 1;

impl Proposal {
    /// GGX lobes of given width and probability, at most six; the rest is left to the cosine.
    pub fn of_lobes<const N: usize>(lobes: [(f32, f32); N]) -> Self {
        const { assert!(N <= MAX_LOBES) };
        Self {
            cosine: 1.0 - lobes.iter().map(|lobe| lobe.1).sum::<f32>(),
            lobes: lobes.to_vec(),
            table: None,
        }
    }

    /// Resembles any BRDF, by tabulating it, with `defensive` of the probability, 0.0..=1.0,
    /// left to the cosine.
    pub fn tabulating(brdf: &dyn Brdf, defensive: f32) -> Self {
        Self {
            cosine: defensive,
            lobes: Vec::new(),
            table: Some((Arc::new(LobeTable::new(brdf)), 1.0 - defensive)),
        }
    }

    /// Resembles a mixture (its three channels together), with at least `defensive`
    /// of the probability, 0.0..=1.0, left to the default so that no direction starves.
    pub fn resembling(mixture: &Mixture, defensive: f32) -> Self {
        let mut cosine = 0.0;
        let mut lobes: Vec<(f32, f32)> = Vec::new();
        for (n, atom) in mixture.dictionary().atoms().iter().enumerate() {
            let weight: f64 = mixture.weights().iter().map(|w| w[n]).sum::<f64>() / 3.0;
            if let Some(diffuse) = atom.diffuse() {
                cosine += (weight * diffuse.power_at_45_deg()) as f32;
            }
            if let Some(facets) = atom.facets() {
                lobes.push((
                    facets.alpha as f32,
                    (weight * facets.power_at_45_deg()) as f32,
                ));
            }
        }
        let total: f32 = cosine + lobes.iter().map(|l| l.1).sum::<f32>();
        let default = Self::default();
        if total <= 0.0 {
            return default;
        }
        let share = (1.0 - defensive) / total;
        cosine = cosine * share + default.cosine * defensive;
        lobes.iter_mut().for_each(|l| l.1 *= share);
        lobes.extend(
            default
                .lobes
                .iter()
                .map(|&(alpha, p)| (alpha, p * defensive)),
        );
        lobes.retain(|l| l.1 > 0.0);
        lobes.sort_by(|a, b| a.0.total_cmp(&b.0));
        // Merge the neighbours whose union costs least: probability times squared log ratio.
        while lobes.len() > MAX_LOBES {
            let cost = |k: usize| {
                let ((a, p), (b, q)) = (lobes[k], lobes[k + 1]);
                p.min(q) * (b / a).ln().powi(2)
            };
            let best = (0..lobes.len() - 1)
                .min_by(|&i, &j| cost(i).total_cmp(&cost(j)))
                .unwrap_or(0);
            let ((a, p), (b, q)) = (lobes[best], lobes.remove(best + 1));
            lobes[best] = (((p * a.ln() + q * b.ln()) / (p + q)).exp(), p + q);
        }
        Self {
            cosine,
            lobes,
            table: None,
        }
    }

    /// Draws a direction for the local `to_viewer` with its density per solid angle
    /// (1/sr, cosine excluded). `None` below the horizon.
    #[inline]
    pub fn sample(&self, to_viewer: Vec3, numbers: &mut impl Uniform) -> Option<(Vec3, f32)> {
        let direction = self.draw(&self.probabilities(), to_viewer, numbers)?;
        Some((direction, self.pdf(to_viewer, direction)))
    }

    /// Density at `direction`, per solid angle (1/sr, cosine excluded).
    #[inline]
    pub fn pdf(&self, to_viewer: Vec3, direction: Vec3) -> f32 {
        mixed(&self.probabilities(), &self.densities(to_viewer, direction))
    }

    /// Probability of each part.
    #[inline]
    pub(super) fn probabilities(&self) -> [f32; PARTS] {
        let mut parts = [0.0; PARTS];
        parts[0] = self.cosine;
        for (part, lobe) in parts[1..].iter_mut().zip(&self.lobes) {
            *part = lobe.1;
        }
        parts[TABLE] = self
            .table
            .as_ref()
            .map_or(0.0, |(_, probability)| *probability);
        parts
    }

    /// Draws a direction from parts with these probabilities, by three numbers, five for a
    /// table; `None` below the horizon.
    #[inline]
    pub(super) fn draw(
        &self,
        probabilities: &[f32; PARTS],
        to_viewer: Vec3,
        numbers: &mut impl Uniform,
    ) -> Option<Vec3> {
        let mut choice = numbers.uniform_f32();
        let u = [numbers.uniform_f32(), numbers.uniform_f32()];
        // What rounding leaves over goes to the last part that can be drawn.
        let mut drawn = 0;
        for (part, &probability) in probabilities.iter().enumerate() {
            if probability > 0.0 {
                drawn = part;
                if choice < probability {
                    break;
                }
                choice -= probability;
            }
        }
        let direction = match (drawn, &self.table) {
            (0, _) => {
                let radius = u[1].sqrt();
                let (sin, cos) = (std::f32::consts::TAU * u[0]).sin_cos();
                Vec3::new(radius * cos, radius * sin, (1.0 - u[1]).sqrt())
            }
            (TABLE, Some((table, _))) => {
                let [cell, side] = [0; 2].map(|_| f64::from(numbers.uniform_f32()));
                table.sample(to_viewer, [cell, f64::from(u[0]), f64::from(u[1]), side])?
            }
            (part, _) => {
                let alpha = self.lobes[part - 1].0;
                Vec3::from_array(ggx::sample_visible(alpha, to_viewer.to_array(), u))
            }
        };
        (direction.z > 0.0).then_some(direction)
    }

    /// Density of each part at `direction`, 1/sr.
    #[inline]
    pub(super) fn densities(&self, to_viewer: Vec3, direction: Vec3) -> [f32; PARTS] {
        let mut densities = [0.0; PARTS];
        if direction.z <= 0.0 || to_viewer.z <= 0.0 {
            return densities;
        }
        let half = direction + to_viewer;
        let tangential2 = half.x * half.x + half.y * half.y;
        let sin2_h = tangential2 / (tangential2 + half.z * half.z);
        densities[0] = direction.z * std::f32::consts::FRAC_1_PI;
        for (density, &(alpha, _)) in densities[1..].iter_mut().zip(&self.lobes) {
            *density = ggx::pdf_visible(alpha, to_viewer.z, sin2_h);
        }
        if let Some((table, _)) = &self.table {
            densities[TABLE] = table.pdf(to_viewer, direction);
        }
        densities
    }
}

/// Density of parts drawn with these probabilities.
#[inline]
pub(super) fn mixed(probabilities: &[f32; PARTS], densities: &[f32; PARTS]) -> f32 {
    let parts = probabilities.iter().zip(densities);
    parts
        .map(|(probability, density)| probability * density)
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::brdf::chi_square::chi_square;
    use crate::brdf::dictionary::Dictionary;
    use crate::brdf::nbrdf::NeuralBrdf;
    use glam::DVec3;

    /// A χ² test per proposal and angle, family significance 1% (Šidák over 3 × 5).
    #[test]
    fn densities_belong_to_the_samples() {
        const CRITICAL: f64 = 3.21;
        let dictionary = Arc::new(Dictionary::paper42());
        let n = dictionary.len();
        let even = Mixture::grey(dictionary, vec![1.0 / n as f64; n]).unwrap();
        let measured = NeuralBrdf::named("pvc").unwrap();
        let proposals = [
            Proposal::default(),
            Proposal::resembling(&even, 0.1),
            Proposal::tabulating(&measured, 0.3),
        ];
        for (p, proposal) in proposals.iter().enumerate() {
            for (a, theta) in [0.0f64, 0.5, 1.0, 1.4, 1.55].into_iter().enumerate() {
                let from = DVec3::new(theta.sin(), 0.0, theta.cos());
                let viewer = from.as_vec3();
                let found = chi_square(
                    from,
                    40_000,
                    (p * 5 + a) as u64,
                    |numbers| Some(proposal.sample(viewer, numbers)?.0.as_dvec3()),
                    |to| f64::from(proposal.pdf(viewer, to.as_vec3())),
                );
                assert!(found.deviate < CRITICAL, "{p} at {theta}: {found:?}");
                assert!(found.total < 1.002, "{p} at {theta}: {found:?}");
            }
        }
    }
}
