//! The model discrepancy: ln f beyond every mixture, estimated together with the weights.
//!
//! Around a fit the images change by J δx + G z, with δx a step of the weights and z the
//! modes of a smooth discrepancy ([`crate::brdf::discrepancy`]), standard normal a priori times
//! an amplitude. What z could have made is no evidence about the weights: their information
//! is the Schur complement F_xx − F_xz (F_zz + Λ)⁻¹ F_zx. The amplitude is the one under which
//! the images are most probable, and there is none unless that is much more probable. As a
//! discrepancy is not small where light is reflected twice, the images are then taken to be
//! linear once more, around what was found (docs/adr/0032).

use nalgebra::{Cholesky, DMatrix, DVector};

use std::sync::Arc;

use super::normal_equations::Marginal;
use super::objective::{Linearised, Objective, ResidualWeights};
use crate::brdf::Dictionary;
use crate::brdf::discrepancy::{AZIMUTHS, Discrepancy, NODES, Prior, nodes};
use crate::random::Stream;
use crate::transport::direct_discrepancy::DirectDiscrepancy;

mod amplitude;
mod normal;

use amplitude::amplitude;
use normal::Joint;

/// Variance that the equations of the discrepancy grant the images over what their weights
/// say: they are linear in it, and far from where they were formed the images are not.
const NOISE_INFLATION: f64 = 2.0;

/// Mean square of the modes over their variance a priori up to which they count as found: a sum of
/// some forty squares of standard normal numbers exceeds twice its mean once in 10⁴ times.
const MAX_MEAN_SQUARE: f64 = 2.0;

/// Largest inflation of the noise: nothing is left of the modes then.
const MAX_NOISE_INFLATION: f64 = 1e9;

/// Weights from which an atom counts as in use.
const SIGNIFICANT_WEIGHT: f64 = 1e-3;

/// The discrepancy from the mixture of one channel group.
pub struct Eliminated {
    /// What is known of it a priori.
    prior: Arc<Prior>,
    /// Modes that no change of the weights in use could make: columns in those of all.
    free: DMatrix<f64>,
    /// Deviation of each a priori.
    amplitude: f64,
    /// (F_zz + Λ)⁻¹.
    covariance: DMatrix<f64>,
    /// Root of the same, times the variance that the equations grant the images over what their
    /// weights say.
    root: DMatrix<f64>,
    /// F_xz.
    coupling: DMatrix<f64>,
    /// Gᵀ W r around no discrepancy.
    score: DVector<f64>,
    /// Information of the weights, without what the discrepancy could have made.
    pub information: DMatrix<f64>,
    /// Their score, likewise.
    pub total_score: DVector<f64>,
    /// Parts of the score by block of cells, of the residual that the discrepancy leaves.
    pub block_scores: Vec<DVector<f64>>,
}

/// Where the images are taken to be linear.
pub struct LinearizationPoint<'a> {
    /// The comparison, with the discrepancy applied.
    pub objective: &'a Objective<'a>,
    /// What is known of the discrepancy a priori.
    pub prior: &'a Arc<Prior>,
    /// How the light that is reflected once changes with the discrepancy.
    pub direct: &'a DirectDiscrepancy,
    /// What its values weigh.
    pub residual_weights: &'a ResidualWeights,
    /// The weights per channel group.
    pub mixture: &'a [DVector<f64>],
    /// The pass at them.
    pub pass: &'a Linearised,
}

impl Eliminated {
    /// The discrepancy from the mixture of each channel group, around a fit without one; empty
    /// where the evidence for one is small.
    pub fn first(at: &LinearizationPoint<'_>, dictionary: &Dictionary) -> Vec<Self> {
        let groups = at.mixture.iter();
        let free: Vec<_> = groups
            .map(|x| free_modes(at.prior, dictionary, x))
            .collect();
        let mut joint = normal::equations(at, &free);
        let fitted: Vec<DVector<f64>> = joint
            .iter()
            .zip(&free)
            .map(|(joint, free)| {
                let modes = joint.score.rows_range(joint.weights..);
                free * (joint.covariance(1.0, NOISE_INFLATION) * modes)
            })
            .collect();
        normal::blocks_after(at, &fitted, &free, &mut joint);
        let amplitude = amplitude(&joint, at.mixture);
        log::debug!("amplitude of the model discrepancy: {amplitude}");
        if amplitude == 0.0 {
            return Vec::new();
        }
        let groups = joint.into_iter().zip(free);
        groups
            .map(|(joint, free)| Self::new(joint, at.prior, free, amplitude))
            .collect()
    }

    /// The same around a mixture whose discrepancy in `at` has these `modes`, as
    /// [`Eliminated::modes`] of `earlier` gave them.
    pub fn again(
        at: &LinearizationPoint<'_>,
        earlier: &[Self],
        modes: &[DVector<f64>],
    ) -> Vec<Self> {
        let free: Vec<_> = earlier.iter().map(|e| e.free.clone()).collect();
        let groups = normal::equations(at, &free).into_iter();
        groups
            .zip(free)
            .zip(earlier.iter().zip(modes))
            .map(|((mut joint, free), (earlier, modes))| {
                joint.score += joint.information.columns_range(joint.weights..) * modes;
                Self::new(joint, at.prior, free, earlier.amplitude)
            })
            .collect()
    }

    fn new(joint: Joint, prior: &Arc<Prior>, free: DMatrix<f64>, amplitude: f64) -> Self {
        // Images far from linear in the modes ask for more than the modes can be.
        let of_modes = joint.score.rows_range(joint.weights..);
        let most = MAX_MEAN_SQUARE * amplitude * amplitude * of_modes.len() as f64;
        let mut noise_inflation = NOISE_INFLATION;
        let covariance = loop {
            let covariance = joint.covariance(amplitude, noise_inflation);
            let modes = &covariance * of_modes;
            if modes.norm_squared() <= most || noise_inflation > MAX_NOISE_INFLATION {
                break covariance;
            }
            noise_inflation *= 2.0;
        };
        log::debug!("the discrepancy's noise is inflated by {noise_inflation}");
        let m = of_modes.len();
        let [weights, coupling, _] = joint.parts();
        let marginal = Marginal::new(&weights, &coupling, &covariance);
        Self {
            total_score: marginal.score(&joint.score),
            block_scores: joint.blocks.iter().map(|s| marginal.score(s)).collect(),
            information: marginal.information,
            prior: prior.clone(),
            free,
            amplitude,
            root: Cholesky::new(&covariance * noise_inflation)
                .map_or_else(|| DMatrix::zeros(m, m), |root| root.l()),
            covariance,
            coupling,
            score: joint.score.rows_range(joint.weights..).into_owned(),
        }
    }

    /// Deviation of the modes a priori: 1 is what measured materials have.
    pub fn amplitude(&self) -> f64 {
        self.amplitude
    }

    /// The discrepancy with these of the free modes.
    pub fn discrepancy(&self, modes: &DVector<f64>) -> Discrepancy {
        Discrepancy(self.prior.modes() * (&self.free * modes))
    }

    /// What is expected of the free modes where the weights differ by `step` from those that the
    /// images were linear around.
    pub fn modes(&self, step: &DVector<f64>) -> DVector<f64> {
        &self.covariance * (&self.score - self.coupling.tr_mul(step))
    }

    /// A draw of the discrepancy there.
    pub fn draw(&self, step: &DVector<f64>, numbers: &mut Stream) -> Discrepancy {
        let mut z = self.modes(step);
        let normal = DVector::from_fn(z.len(), |_, _| numbers.normal());
        z += &self.root * normal;
        self.discrepancy(&z)
    }
}

/// The modes that no change of the weights in use could make. What both could make would
/// be shared by the priors alone, far from where the images are linear. As in a projection
/// on the dictionary by cube roots, a discrepancy is orthogonal to the atoms.
pub(super) fn free_modes(
    prior: &Prior,
    dictionary: &Dictionary,
    mixture: &DVector<f64>,
) -> DMatrix<f64> {
    let modes = prior.modes();
    let used: Vec<usize> = (0..mixture.len())
        .filter(|&k| mixture[k] > SIGNIFICANT_WEIGHT)
        .collect();
    let mut rows = DMatrix::<f64>::zeros(used.len(), modes.ncols());
    for (k, node) in nodes().enumerate() {
        // Over φd, how an atom's part goes along with g₀ and with g₁.
        let mut along = vec![[0.0; 2]; used.len()];
        for angles in node.azimuths() {
            let atoms = dictionary.values_of(angles);
            let f: f64 = atoms.iter().zip(mixture.iter()).map(|(a, w)| a * w).sum();
            if f <= 0.0 {
                continue;
            }
            let weight = node.measure / AZIMUTHS as f64 * f.powf(2.0 / 3.0) / f;
            for (along, &atom) in along.iter_mut().zip(&used) {
                along[0] += weight * atoms[atom];
                along[1] += weight * atoms[atom] * (2.0 * angles.phi_d_rad).cos();
            }
        }
        for (row, along) in along.into_iter().enumerate() {
            let mut row = rows.row_mut(row);
            row += along[0] * modes.row(k) + along[1] * modes.row(NODES + k);
        }
    }
    for mut row in rows.row_iter_mut() {
        let norm = row.norm().max(1e-12);
        row /= norm;
    }
    let eigen = rows.tr_mul(&rows).symmetric_eigen();
    let free: Vec<usize> = (0..modes.ncols())
        .filter(|&m| eigen.eigenvalues[m] < 1e-3)
        .collect();
    eigen.eigenvectors.select_columns(&free)
}
