//! Do the intervals hold what they promise? Coverage over many simulated captures.

use std::sync::Arc;

use super::small_bench::SmallBench;
use crate::brdf::{Brdf, Dictionary, HalfDifference};
use crate::inverse::intervals::{self, Interval};
use crate::inverse::{FitError, FitOptions, fit};
use crate::transport::Proposal;

/// What one capture said about every cell.
pub struct Trial {
    /// f at the cells, per channel.
    pub truth: Vec<[f64; 3]>,
    /// Its intervals.
    pub intervals: Vec<Interval>,
    /// Reduced χ² of the fit, per light and channel.
    pub reduced_chi2: Vec<[f64; 3]>,
}

/// f of a BRDF at the cells of [`intervals::table`].
pub fn truth_at(brdf: &dyn Brdf, theta_h_deg: &[f64], theta_d_deg: &[f64]) -> Vec<[f64; 3]> {
    let mut cells = Vec::new();
    for &h in theta_h_deg {
        for &d in theta_d_deg {
            let angles = HalfDifference {
                theta_h_rad: h.to_radians(),
                theta_d_rad: d.to_radians(),
                phi_d_rad: std::f64::consts::FRAC_PI_2,
            };
            let (i, o) = angles.to_directions();
            cells.push(brdf.eval(i.as_vec3(), o.as_vec3()).map(f64::from));
        }
    }
    cells
}

/// Captures, fits, and compares.
pub fn trial(
    bench: &SmallBench,
    brdf: &dyn Brdf,
    proposal: &Proposal,
    dictionary: &Arc<Dictionary>,
    options: &FitOptions,
    theta: [&[f64]; 2],
    seed: u64,
) -> Result<Trial, FitError> {
    let scene = bench.scene().unwrap();
    let truth = bench.true_scene(None).unwrap();
    let images = bench.capture(&truth, brdf, proposal, None, seed);
    let mut options = options.clone();
    options.cache.seed = seed.wrapping_add(1_000_000);
    let fit = fit(&scene, &images, dictionary, &options, &mut |_| {})?;
    Ok(Trial {
        truth: truth_at(brdf, theta[0], theta[1]),
        intervals: intervals::table(dictionary, &fit.weights, &fit.draws, theta[0], theta[1]),
        reduced_chi2: fit.reduced_chi2,
    })
}
