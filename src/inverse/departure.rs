//! How the material departs from every mixture, estimated together with the weights.
//!
//! Around a fit the images change by J δx + G z, with δx a step of the weights and z the
//! modes of a smooth departure ([`crate::brdf::departure`]), standard normal a priori times
//! an amplitude. What z could have made is no evidence about the weights: their information
//! is the Schur complement F_xx − F_xz (F_zz + Λ)⁻¹ F_zx. The amplitude is the one under which
//! the images are most probable, and nothing departs unless that is much more probable
//! (docs/adr/0032).

use nalgebra::{Cholesky, DMatrix, DVector};

use super::intervals::atom_values;
use super::objective::{Linearised, Objective, ResidualWeights};
use crate::brdf::departure::{self, Departure};
use crate::brdf::{Dictionary, Mixture};
use crate::random::{Purpose, Stream, stream};
use crate::transport::render::RenderOptions;
use crate::transport::sensitivity::Sensitivity;
use crate::transport::{Cache, Proposal, Scene, Steering};

mod amplitude;
mod normal;

use amplitude::amplitude;
use normal::Values;

/// Paths over all pixels, and per pixel at most and at least.
const PATHS: usize = 1 << 18;
const SAMPLES_PER_PIXEL: [usize; 2] = [8, 64];

/// Longest path.
const REFLECTIONS: u32 = 16;

/// Variance that the equations of the departure grant the images over what their weights
/// say: they are linear in it, and the images are that only as long as it is small.
const CAUTION: f64 = 10.0;

/// Weights from which an atom counts as in use.
const IN_USE: f64 = 1e-3;

/// The departure beside one set of weights.
pub struct Eliminated {
    /// Modes that no change of the weights in use could make: columns in those of all.
    free: DMatrix<f64>,
    /// (F_zz + Λ)⁻¹.
    covariance: DMatrix<f64>,
    /// F_xz.
    coupling: DMatrix<f64>,
    /// Gᵀ W r.
    score: DVector<f64>,
    /// Information of the weights, without what the departure could have made.
    pub information: DMatrix<f64>,
    /// Their score, likewise.
    pub total_score: DVector<f64>,
    /// Parts of the score by block of pixels, of the residual that the departure leaves.
    pub block_scores: Vec<DVector<f64>>,
}

/// What a departure needs to know of a fit.
pub struct At<'a> {
    /// The comparison.
    pub objective: &'a Objective<'a>,
    /// Its paths.
    pub cache: &'a Cache,
    /// What its values weigh.
    pub residual_weights: &'a ResidualWeights,
    /// The fitted weights per set.
    pub mixture: &'a [DVector<f64>],
    /// The pass at them.
    pub pass: &'a Linearised,
}

impl Eliminated {
    /// The departure beside each set of weights, around the fitted `material`; nothing where the
    /// images hardly ask for one.
    pub fn all(at: &At<'_>, scene: &Scene, material: &Mixture, seed: u64) -> Vec<Self> {
        let modes = departure::modes();
        let lights = at.objective.lights();
        let pixels = scene.camera.pixels();
        let wanted: Vec<bool> = (0..pixels)
            .map(|pixel| (0..lights).any(|light| at.objective.is_compared(light, pixel)))
            .collect();
        let [least, most] = SAMPLES_PER_PIXEL;
        let options = RenderOptions {
            samples_per_pixel: (PATHS / pixels).clamp(least, most) as u32,
            max_reflections: REFLECTIONS,
            seed: stream(seed, Purpose::Sensitivity, 0, 0, 0).bits(),
            proposal: Proposal::resembling(material, 0.3),
            steering: Steering::default(),
        };
        let images = Sensitivity::trace(scene, material, modes, &wanted, &options);
        let dictionary = material.dictionary();
        let free: Vec<_> = at
            .mixture
            .iter()
            .map(|x| free_modes(dictionary, x))
            .collect();
        let values = Values {
            at,
            images: &images,
        };
        let normal = values.normal_equations(&free);
        let fitted: Vec<DVector<f64>> = normal
            .iter()
            .zip(&free)
            .map(|(normal, free)| free * (normal.covariance(1.0) * &normal.score))
            .collect();
        let blocks = values.blocks(&fitted, &free);
        let amplitude = amplitude(&normal, &blocks, at);
        tracing::debug!(amplitude, "departure");
        if amplitude == 0.0 {
            return Vec::new();
        }
        let parts = normal
            .into_iter()
            .zip(free)
            .zip(blocks)
            .zip(at.pass.scores());
        parts
            .map(|(((normal, free), blocks), score)| {
                let covariance = normal.covariance(amplitude);
                let through = &normal.coupling * &covariance;
                let left = |step: [DVector<f64>; 2]| &step[0] - &through * &step[1];
                let information = &normal.information - &through * normal.coupling.transpose();
                Self {
                    information: 0.5 * (&information + information.transpose()),
                    total_score: score - &through * &normal.score,
                    block_scores: blocks.into_iter().map(left).collect(),
                    free,
                    covariance,
                    coupling: normal.coupling,
                    score: normal.score,
                }
            })
            .collect()
    }

    /// The expected departure where the weights differ from the fitted ones by `step`.
    pub fn expected(&self, step: &DVector<f64>) -> Departure {
        Departure(departure::modes() * (&self.free * self.modes(step)))
    }

    /// A draw of it.
    pub fn draw(&self, step: &DVector<f64>, numbers: &mut Stream) -> Departure {
        let mut z = self.modes(step);
        if let Some(root) = Cholesky::new(&self.covariance * CAUTION) {
            let normal = DVector::from_iterator(z.len(), (0..z.len()).map(|_| numbers.normal()));
            z += root.l() * normal;
        }
        Departure(departure::modes() * (&self.free * z))
    }

    fn modes(&self, step: &DVector<f64>) -> DVector<f64> {
        &self.covariance * (&self.score - self.coupling.tr_mul(step))
    }
}

/// The modes that no change of the weights in use could make. What both could make would
/// be shared by the priors alone, far from where the images are linear. As in a projection
/// on the dictionary by cube roots, a departure is orthogonal to the atoms.
fn free_modes(dictionary: &Dictionary, mixture: &DVector<f64>) -> DMatrix<f64> {
    let modes = departure::modes();
    let used: Vec<usize> = (0..mixture.len())
        .filter(|&k| mixture[k] > IN_USE)
        .collect();
    let mut rows = DMatrix::<f64>::zeros(used.len(), modes.ncols());
    for (k, node) in departure::nodes().enumerate() {
        let atoms = atom_values(dictionary, node.theta_h_deg, node.theta_d_deg);
        let f: f64 = atoms.iter().zip(mixture.iter()).map(|(a, w)| a * w).sum();
        if f <= 0.0 {
            continue;
        }
        let weight = node.measure * f.powf(2.0 / 3.0);
        for (row, &atom) in used.iter().enumerate() {
            let mut row = rows.row_mut(row);
            row += weight * atoms[atom] / f * modes.row(k);
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

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::brdf::departure::Departed;
    use crate::brdf::{Atom, Brdf};
    use crate::inverse::fit::FitOptions;
    use crate::inverse::form::tests::bowl;
    use crate::inverse::solve::{Paths, per_channel, solve};
    use crate::radiance_image::RadianceImage;
    use crate::transport::render;

    fn photograph(scene: &Scene, material: &dyn Brdf) -> Vec<RadianceImage> {
        let options = RenderOptions {
            samples_per_pixel: 1024,
            max_reflections: 8,
            seed: 71,
            proposal: Proposal::tabulating(material, 0.3),
            ..RenderOptions::default()
        };
        render(scene, material, &options, &|_| {})
    }

    /// Images of a mixture ask for no departure; those of one that departs do, and with what is
    /// found f comes closer to the truth where light is reflected once.
    #[test]
    fn a_departure_is_found_where_there_is_one() {
        let scene = bowl(16);
        let atoms = vec![
            Atom::Lambertian { albedo: 1.0 },
            Atom::Ggx {
                alpha: 0.3,
                eta: 3.0,
            },
            Atom::Black,
        ];
        let dictionary = Arc::new(Dictionary::new("three", atoms).unwrap());
        let truth = Mixture::grey(dictionary.clone(), vec![0.4, 0.4, 0.2]).unwrap();
        let weights = DVector::from_column_slice(&truth.weights()[0]);
        // Of the widest modes, what the weights cannot make.
        let free = free_modes(&dictionary, &weights);
        let mut z = DVector::zeros(free.nrows());
        z.rows_mut(0, 4).copy_from_slice(&[1.5, -1.5, 1.5, 1.5]);
        let g = Departure(departure::modes() * (&free * free.tr_mul(&z)));
        let departed = Departed {
            mixture: &truth,
            departures: [&g; 3],
        };
        let mut options = FitOptions::default();
        options.cache.samples_per_pixel = 128;
        let found = |material: &dyn Brdf| {
            let captured = photograph(&scene, material);
            let paths = Paths::trace(&scene, &dictionary, None, &options, &mut |_| {}).unwrap();
            let objective = paths.objective(&captured, &options);
            let solved = solve(&paths, &objective, None, &options, &mut |_| {}).unwrap();
            let fitted = Mixture::new(dictionary.clone(), per_channel(&solved.mixture)).unwrap();
            let at = At {
                objective: &objective,
                cache: &paths.cache,
                residual_weights: &solved.residual_weights,
                mixture: &solved.mixture,
                pass: &solved.pass,
            };
            let found = Eliminated::all(&at, &scene, &fitted, 3);
            let none = DVector::zeros(3);
            (fitted, found.first().map(|found| found.expected(&none)))
        };
        assert!(found(&truth).1.is_none(), "a mixture departs");
        let (fitted, found) = found(&departed);
        let found = found.unwrap();
        let ln = |mixture: &Mixture, theta_h_deg, theta_d_deg| {
            let atoms = atom_values(&dictionary, theta_h_deg, theta_d_deg);
            let terms = atoms.iter().zip(&mixture.weights()[0]);
            terms.map(|(f, w)| f * w).sum::<f64>().ln()
        };
        let mut squares = [0.0, 0.0];
        for (k, node) in departure::nodes().enumerate() {
            let (h, d) = (node.theta_h_deg, node.theta_d_deg);
            if !(1.0..60.0).contains(&h) || d > 15.0 {
                continue;
            }
            let error = ln(&fitted, h, d) - ln(&truth, h, d) - g.0[k];
            squares[0] += error.powi(2);
            squares[1] += (error + found.0[k]).powi(2);
        }
        let left = (squares[1] / squares[0]).sqrt();
        println!("{:.3} of the error {:.3} is left", left, squares[0].sqrt());
        // As the equations are cautious, a part remains; 0.69 here.
        assert!(left < 0.8, "{left} of {}", squares[0].sqrt());
    }
}
