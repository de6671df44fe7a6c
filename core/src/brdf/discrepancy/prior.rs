//! What is known of a discrepancy a priori: how measured materials differ from their mixtures.
//!
//! The covariance of (g₀, g₁) is that of the departures of the embedded measured materials from
//! their reference projections, plus a smooth kernel for what they do not show. It is kept as a
//! factor A with A Aᵀ, whose columns are departures and products of the kernel's eigenvectors.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use nalgebra::{DMatrix, DVector, SymmetricEigen};

use super::{Discrepancy, NODES, Node, THETA_D_DEG, THETA_H_DEG, VALUES, nodes};
use crate::brdf::nbrdf::{NAMES, NeuralBrdf};
use crate::brdf::projection::CellMatrix;
use crate::brdf::score::Cell;
use crate::brdf::{Dictionary, Mixture};

/// Part of the variance that the truncated basis may lack.
const MISSED: f64 = 0.005;

/// Most modes that a prior has.
pub const MOST_MODES: usize = 64;

/// Standard deviation of g below which a part that the basis lacks counts for less.
const NEGLIGIBLE_DEVIATION: f64 = 0.05;

/// Largest departure in ln f that is learned from.
const LARGEST_DEPARTURE: f64 = 3.0;

/// Root mean square difference of ln f between materials, a common factor left out, from which they
/// count as different.
const NEAR_DUPLICATE: f64 = 0.15;

/// A Gaussian prior of discrepancies.
pub struct Prior {
    modes: DMatrix<f64>,
    left_out: Vec<String>,
}

impl Prior {
    /// Learned from all embedded materials but those named and their near duplicates: those whose
    /// ln f differs from theirs by less than 0.15, root mean square over the nodes.
    pub fn without(left_out: &[String]) -> Arc<Self> {
        static KNOWN: OnceLock<Mutex<HashMap<Vec<String>, Arc<Prior>>>> = OnceLock::new();
        let learned = departures();
        let is_named = |of: &&Learned| left_out.iter().any(|name| name == of.name);
        let named: Vec<&Learned> = learned.iter().filter(is_named).collect();
        let is_like = |of: &&Learned| named.iter().any(|n| n.distance(of) < NEAR_DUPLICATE);
        let like = learned.iter().filter(is_like);
        let left_out: Vec<String> = like.map(|of| of.name.to_owned()).collect();
        let known = KNOWN.get_or_init(Mutex::default);
        let mut known = known.lock().unwrap_or_else(PoisonError::into_inner);
        let learn = || Arc::new(Self::learned(left_out.clone()));
        known.entry(left_out.clone()).or_insert_with(learn).clone()
    }

    fn learned(left_out: Vec<String>) -> Self {
        let learned = departures().iter();
        let learned = learned.filter(|of| !left_out.iter().any(|name| name == of.name));
        let columns: Vec<&DVector<f64>> = learned.flat_map(|of| &of.departure).collect();
        let scale = 1.0 / (columns.len().max(1) as f64).sqrt();
        let mut factor: Vec<DVector<f64>> = columns.iter().map(|&c| c * scale).collect();
        factor.extend(smooth_factor());
        let mut factor = DMatrix::from_columns(&factor);
        // A factor common to all angles is left to the weights.
        let common = DVector::from_iterator(VALUES, {
            let inner = |n: Node| n.theta_h_deg < 70.0 && n.theta_d_deg < 72.0;
            let even = nodes().map(move |n| f64::from(u8::from(inner(n))));
            even.chain(std::iter::repeat_n(0.0, NODES))
        });
        let along = factor.tr_mul(&common);
        let weighted = &factor * &along / along.norm_squared().max(f64::MIN_POSITIVE);
        factor -= weighted * along.transpose();
        Self {
            modes: principal(&factor),
            left_out,
        }
    }

    /// Columns of values at the nodes, to be multiplied by independent standard normal
    /// coefficients. A factor common to all angles is projected out: the weights have it.
    pub fn modes(&self) -> &DMatrix<f64> {
        &self.modes
    }

    /// With these modes, for tests.
    #[cfg(test)]
    pub(crate) fn of_modes(modes: DMatrix<f64>) -> Self {
        let left_out = Vec::new();
        Self { modes, left_out }
    }

    /// The embedded materials that it is not learned from.
    pub fn left_out(&self) -> &[String] {
        &self.left_out
    }
}

/// What is learned of one material.
struct Learned {
    name: &'static str,
    /// ln f per channel.
    ln_f: [Discrepancy; 3],
    /// ln f beyond that of its reference projection, per channel.
    departure: [DVector<f64>; 3],
}

impl Learned {
    fn distance(&self, other: &Self) -> f64 {
        let (mut sum, mut square, mut count) = (0.0, 0.0, 0.0);
        for (a, b) in self.ln_f.iter().zip(&other.ln_f) {
            for (a, b) in a.0.iter().zip(b.0.iter()).take(NODES) {
                sum += a - b;
                square += (a - b).powi(2);
                count += 1.0;
            }
        }
        (square / count - (sum / count).powi(2)).max(0.0).sqrt()
    }
}

/// How the embedded materials depart from their projections.
fn departures() -> &'static [Learned] {
    static DEPARTURES: OnceLock<Vec<Learned>> = OnceLock::new();
    DEPARTURES.get_or_init(|| {
        use rayon::prelude::*;
        let dictionary = Arc::new(Dictionary::rig26());
        let cells = nodes().flat_map(|node| {
            node.azimuths().map(|angles| {
                let (i, o) = angles.to_directions();
                Cell {
                    to_light: i.as_vec3(),
                    to_viewer: o.as_vec3(),
                    solid_angle: node.measure as f32,
                }
            })
        });
        let cells = cells.filter(|c| c.to_light.z > 0.02 && c.to_viewer.z > 0.02);
        let projections = CellMatrix::of_cells(dictionary, cells.collect());
        let learned = |name: &&'static str| -> Option<Learned> {
            let material = NeuralBrdf::named(name)?;
            let mixture = projections.reference_projection(&material).ok()?;
            let ln_f = Discrepancy::closest(|at| material.at(at).map(ln));
            let of_mixture = |mixture: &Mixture, at| {
                mixture
                    .of_atoms(&mixture.dictionary().values_of(at))
                    .map(|f| ln(f as f32))
            };
            let departure = Discrepancy::closest(|at| {
                let (f, mixture) = (material.at(at).map(ln), of_mixture(&mixture, at));
                let limit = LARGEST_DEPARTURE;
                [0, 1, 2].map(|c| (f[c] - mixture[c]).clamp(-limit, limit))
            });
            Some(Learned {
                name,
                ln_f,
                departure: departure.map(|d| d.0),
            })
        };
        NAMES.par_iter().filter_map(learned).collect()
    })
}

/// ln f, of black too.
fn ln(f: f32) -> f64 {
    f64::from(f + 1e-5).ln()
}

/// Standard deviation of the kernel's g₀ and g₁.
fn deviations(node: &Node) -> [f64; 2] {
    let (h, d) = (node.theta_h_deg, node.theta_d_deg);
    let even =
        0.06 + 0.2 * (-h).exp() + 0.15 * (h / 82.0).powi(5) + 0.15 * ((d - 80.0) / 7.0).exp();
    [even, even * (10.0 * node.meaning_of_phi()).min(0.7)]
}

/// Correlation of the kernel along the half and along the difference angles of the nodes.
fn correlations() -> &'static [DMatrix<f64>; 2] {
    static CORRELATIONS: OnceLock<[DMatrix<f64>; 2]> = OnceLock::new();
    CORRELATIONS.get_or_init(|| {
        // In these coordinates the process is stationary.
        let by_h = THETA_H_DEG.map(|h| h.sqrt() / 1.2);
        let by_d = THETA_D_DEG.map(|d| -2.5 * (1.0 - d / 100.0).ln());
        let along = |axis: &[f64]| {
            DMatrix::from_fn(axis.len(), axis.len(), |i, j| {
                (-0.5 * (axis[i] - axis[j]).powi(2)).exp()
            })
        };
        [along(&by_h), along(&by_d)]
    })
}

/// The kernel's covariance of g₀ times a vector over the nodes: a smooth change along it, everywhere of
/// one sign where the vector is.
pub fn smoothed(vector: &DVector<f64>) -> DVector<f64> {
    let [by_h, by_d] = correlations();
    let deviation = DVector::from_iterator(NODES, nodes().map(|n| deviations(&n)[0]));
    let scaled = vector.component_mul(&deviation);
    let table = DMatrix::from_column_slice(THETA_D_DEG.len(), THETA_H_DEG.len(), scaled.as_slice());
    let smooth = by_d * table * by_h;
    DVector::from_column_slice(smooth.as_slice()).component_mul(&deviation)
}

/// Columns over the nodes whose outer products add up to the kernel's correlation.
fn correlation_factor() -> Vec<DVector<f64>> {
    let [by_h, by_d] = correlations()
        .each_ref()
        .map(|c| c.clone().symmetric_eigen());
    let mut columns = Vec::new();
    for (h, value_h) in by_h.eigenvalues.iter().enumerate() {
        for (d, value_d) in by_d.eigenvalues.iter().enumerate() {
            let value = value_h * value_d;
            // Of eigenvalues that add up to the number of nodes.
            if value > 1e-2 {
                let column = by_h
                    .eigenvectors
                    .column(h)
                    .kronecker(&by_d.eigenvectors.column(d));
                columns.push(column * value.sqrt());
            }
        }
    }
    columns
}

/// The same for (g₀, g₁), which the kernel takes as independent, with its deviations.
fn smooth_factor() -> Vec<DVector<f64>> {
    let mut columns = Vec::new();
    for column in correlation_factor() {
        let part = |which: usize| {
            let values = column.iter().zip(nodes());
            let values = values.map(move |(v, node)| v * deviations(&node)[which]);
            let mut part = DVector::zeros(VALUES);
            let start = which * NODES;
            for (k, value) in values.enumerate() {
                part[start + k] = value;
            }
            part
        };
        columns.extend([part(0), part(1)]);
    }
    columns
}

/// The modes of a field over the nodes of unit standard deviation, correlated as the kernel is.
pub fn standard_modes() -> &'static DMatrix<f64> {
    static MODES: OnceLock<DMatrix<f64>> = OnceLock::new();
    MODES.get_or_init(|| {
        let mut modes = principal(&DMatrix::from_columns(&correlation_factor()));
        for mut row in modes.row_iter_mut() {
            let deviation = row.norm();
            row /= deviation;
        }
        modes
    })
}

/// Fewer columns whose outer products add up to those of `factor`, except for the fraction
/// [`MISSED`].
fn principal(factor: &DMatrix<f64>) -> DMatrix<f64> {
    // Of the correlation, so that nodes where g is small count as much, unless it is negligible.
    let mut scaled = factor.clone();
    for mut row in scaled.row_iter_mut() {
        let deviation = row.norm().max(NEGLIGIBLE_DEVIATION);
        row /= deviation;
    }
    let eigen = SymmetricEigen::new(scaled.tr_mul(&scaled));
    let mut order: Vec<usize> = (0..eigen.eigenvalues.len()).collect();
    order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
    let total: f64 = eigen.eigenvalues.sum();
    let mut missed = total;
    let kept = order.into_iter().take(MOST_MODES).take_while(|&k| {
        let enough = missed <= MISSED * total;
        missed -= eigen.eigenvalues[k];
        !enough
    });
    factor * eigen.eigenvectors.select_columns(&kept.collect::<Vec<_>>())
}
