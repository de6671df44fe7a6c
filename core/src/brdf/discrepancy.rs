//! Model discrepancy: by what a material differs from every mixture of a dictionary.
//!
//! ln f = ln f_mixture + g(θh, θd), where g is a Gaussian process of mean zero over the half and
//! the difference angle (θh, θd), tabulated at nodes and linear between them. Its standard
//! deviation and correlation lengths resemble those of measured materials about the mixtures
//! that explain them best (docs/adr/0032). [`modes`] is its truncated Karhunen–Loève basis.
//!
//! [`Material`] is what a fit reports: a mixture with its discrepancy, itself a [`Brdf`].

use std::sync::OnceLock;

use glam::Vec3;
use nalgebra::{DMatrix, DVector, SymmetricEigen};

use super::{Brdf, Mixture};

/// Half angles of the nodes, degrees.
const THETA_H_DEG: [f64; 12] = [
    0.0, 1.0, 3.0, 6.0, 10.0, 15.0, 22.0, 30.0, 40.0, 52.0, 66.0, 82.0,
];
/// Difference angles of the nodes, degrees.
const THETA_D_DEG: [f64; 11] = [
    0.0, 12.0, 24.0, 35.0, 45.0, 54.0, 62.0, 69.0, 76.0, 82.0, 88.0,
];

/// Nodes of the table, θd fastest.
pub const NODES: usize = THETA_H_DEG.len() * THETA_D_DEG.len();

// A record names its node in eight bits.
const _: () = assert!(NODES <= 256);

/// Fraction of the variance that the truncated basis may lack, where g has unit deviation.
const MISSED: f64 = 0.02;

/// A node of the table.
#[derive(Clone, Copy, Debug)]
pub struct Node {
    /// Half angle, degrees.
    pub theta_h_deg: f64,
    /// Difference angle, degrees.
    pub theta_d_deg: f64,
    /// Its share of the measure of all pairs of directions, up to a common factor.
    pub measure: f64,
}

/// The nodes in the order of the table.
pub fn nodes() -> impl Iterator<Item = Node> {
    (0..NODES).map(|k| {
        let (i, j) = (k / THETA_D_DEG.len(), k % THETA_D_DEG.len());
        // dωi dωo is proportional to sin θh dθh · sin θd cos θd dθd.
        let [low_h, high_h] = cell(&THETA_H_DEG, i).map(|v: f64| v.to_radians().cos());
        let [low_d, high_d] = cell(&THETA_D_DEG, j).map(|v: f64| v.to_radians().sin().powi(2));
        Node {
            theta_h_deg: THETA_H_DEG[i],
            theta_d_deg: THETA_D_DEG[j],
            measure: (low_h - high_h) * (high_d - low_d),
        }
    })
}

/// From halfway to the previous node to halfway to the next.
fn cell(axis: &[f64], k: usize) -> [f64; 2] {
    let before = axis[k.saturating_sub(1)];
    let after = axis[(k + 1).min(axis.len() - 1)];
    [0.5 * (before + axis[k]), 0.5 * (axis[k] + after)]
}

/// Standard deviation of g.
fn deviation(theta_h_deg: f64, theta_d_deg: f64) -> f64 {
    0.13 + 0.3 * (-theta_h_deg).exp()
        + 0.4 * (theta_h_deg / 82.0).powi(5)
        + 0.45 * ((theta_d_deg - 80.0) / 7.0).exp()
}

/// Correlation of g at two nodes.
fn correlation(a: &Node, b: &Node) -> f64 {
    // In these coordinates the process is stationary.
    let position = |n: &Node| {
        [
            n.theta_h_deg.sqrt() / 1.2,
            -2.5 * (1.0 - n.theta_d_deg / 100.0).ln(),
        ]
    };
    let ([a_h, a_d], [b_h, b_d]) = (position(a), position(b));
    (-0.5 * ((a_h - b_h).powi(2) + (a_d - b_d).powi(2))).exp()
}

/// Covariance of g at the nodes, a factor common to all angles included.
pub(super) fn covariance() -> DMatrix<f64> {
    let nodes: Vec<Node> = nodes().collect();
    let deviations: Vec<f64> = nodes
        .iter()
        .map(|n| deviation(n.theta_h_deg, n.theta_d_deg))
        .collect();
    DMatrix::from_fn(NODES, NODES, |i, j| {
        deviations[i] * deviations[j] * correlation(&nodes[i], &nodes[j])
    })
}

/// The modes of g: columns of values at the nodes, to be multiplied by independent standard
/// normal coefficients. A factor common to all angles is projected out: the weights have it.
pub fn modes() -> &'static DMatrix<f64> {
    static MODES: OnceLock<DMatrix<f64>> = OnceLock::new();
    MODES.get_or_init(|| {
        let nodes: Vec<Node> = nodes().collect();
        let covariance = covariance();
        let inner = |n: &Node| n.theta_h_deg < 70.0 && n.theta_d_deg < 72.0;
        let everywhere =
            DVector::from_iterator(NODES, nodes.iter().map(|n| f64::from(u8::from(inner(n)))));
        let along = &covariance * &everywhere;
        let covariance = &covariance - &along * along.transpose() / everywhere.dot(&along);
        principal(&covariance)
    })
}

/// The modes of a field of unit standard deviation at every node, correlated as g is.
pub fn standard_modes() -> &'static DMatrix<f64> {
    static MODES: OnceLock<DMatrix<f64>> = OnceLock::new();
    MODES.get_or_init(|| {
        let nodes: Vec<Node> = nodes().collect();
        let modes = principal(&DMatrix::from_fn(NODES, NODES, |i, j| {
            correlation(&nodes[i], &nodes[j])
        }));
        let deviation = DVector::from_iterator(NODES, modes.row_iter().map(|row| row.norm()));
        DMatrix::from_fn(NODES, modes.ncols(), |i, j| modes[(i, j)] / deviation[i])
    })
}

/// Columns whose outer products add up to a covariance, except for the fraction [`MISSED`].
fn principal(covariance: &DMatrix<f64>) -> DMatrix<f64> {
    let scale = covariance.diagonal().map(f64::sqrt);
    // Of the correlation, so that nodes where g is small count as much.
    let eigen = SymmetricEigen::new(DMatrix::from_fn(NODES, NODES, |i, j| {
        covariance[(i, j)] / (scale[i] * scale[j])
    }));
    let mut order: Vec<usize> = (0..NODES).collect();
    order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
    let total: f64 = eigen.eigenvalues.sum();
    let mut missed = total;
    let kept = order.into_iter().take_while(|&k| {
        let enough = missed <= MISSED * total;
        missed -= eigen.eigenvalues[k];
        !enough
    });
    let columns: Vec<DVector<f64>> = kept
        .map(|k| {
            let root = eigen.eigenvalues[k].sqrt();
            eigen.eigenvectors.column(k).component_mul(&scale) * root
        })
        .collect();
    DMatrix::from_columns(&columns)
}

/// The four nodes around a pair of directions (unit, local frame) with their bilinear weights.
#[inline]
pub fn node_weights(to_light: Vec3, to_viewer: Vec3) -> [(usize, f32); 4] {
    let sum = to_light + to_viewer;
    let theta_h = sum.x.hypot(sum.y).atan2(sum.z);
    let theta_d = (to_light - to_viewer).length().atan2(sum.length());
    around_angles(
        f64::from(theta_h.to_degrees()),
        f64::from(theta_d.to_degrees()),
    )
}

/// The four nodes around half and difference angles with their bilinear weights.
fn around_angles(theta_h_deg: f64, theta_d_deg: f64) -> [(usize, f32); 4] {
    let segment = |axis: &[f64], x: f64| {
        let k = axis.partition_point(|&n| n <= x).clamp(1, axis.len() - 1) - 1;
        let t = (x - axis[k]) / (axis[k + 1] - axis[k]);
        (k, t.clamp(0.0, 1.0) as f32)
    };
    let (h, u) = segment(&THETA_H_DEG, theta_h_deg);
    let (d, v) = segment(&THETA_D_DEG, theta_d_deg);
    let first = h * THETA_D_DEG.len() + d;
    let next = first + THETA_D_DEG.len();
    [
        (first, (1.0 - u) * (1.0 - v)),
        (first + 1, (1.0 - u) * v),
        (next, u * (1.0 - v)),
        (next + 1, u * v),
    ]
}

/// Stochastic rounding of half and difference angles (given as sin² θh and cos θd) to one of the
/// four bilinear nodes around them, with probability equal to its weight, so that sums over many
/// directions are unbiased. The random bits are a hash of the operands.
#[inline]
pub fn node_near(sin2_h: f32, cos_d: f32) -> u8 {
    static POSITIONS: OnceLock<[[f32; 257]; 2]> = OnceLock::new();
    let [by_h, by_d] = POSITIONS.get_or_init(|| {
        let position = |axis: &[f64], deg: f64| {
            let k = axis.partition_point(|&n| n <= deg).clamp(1, axis.len() - 1) - 1;
            let t = (deg - axis[k]) / (axis[k + 1] - axis[k]);
            (k as f64 + t.clamp(0.0, 0.999_999)) as f32
        };
        let root = |k: usize| k as f64 / 256.0;
        [
            std::array::from_fn(|k| {
                position(&THETA_H_DEG, root(k).powi(2).min(1.0).asin().to_degrees())
            }),
            std::array::from_fn(|k| {
                position(&THETA_D_DEG, (1.0 - root(k).powi(2)).acos().to_degrees())
            }),
        ]
    });
    let between = |table: &[f32; 257], root: f32| {
        let at = root.clamp(0.0, 1.0) * 255.999;
        let k = at as usize;
        table[k] + (at - k as f32) * (table[k + 1] - table[k])
    };
    let h = between(by_h, sin2_h.sqrt().sqrt());
    let d = between(by_d, (1.0 - cos_d).sqrt());
    let hash = (sin2_h.to_bits() ^ cos_d.to_bits().rotate_left(16)).wrapping_mul(0x9e37_79b9);
    let hash = (hash ^ hash >> 15).wrapping_mul(0x85eb_ca6b);
    let random = |bits: u32| f32::from(bits as u16) / 65536.0;
    let (h, d) = (
        (h + random(hash)) as usize,
        (d + random(hash >> 16)) as usize,
    );
    (h * THETA_D_DEG.len() + d) as u8
}

/// A discrepancy: g at each node, the natural logarithm of a factor.
#[derive(Clone, Debug, PartialEq)]
pub struct Discrepancy(pub DVector<f64>);

impl Discrepancy {
    /// None: g = 0.
    pub fn none() -> Self {
        Self(DVector::zeros(NODES))
    }

    /// e^g at half and difference angles, linear between the nodes.
    pub fn factor(&self, theta_h_deg: f64, theta_d_deg: f64) -> f64 {
        self.factor_around(around_angles(theta_h_deg, theta_d_deg))
    }

    fn factor_around(&self, around: [(usize, f32); 4]) -> f64 {
        let terms = around.into_iter();
        terms
            .map(|(k, share)| self.0[k].exp() * f64::from(share))
            .sum()
    }
}

/// A mixture of a dictionary's atoms with its discrepancy: the form of a fitted material.
///
/// ```
/// use std::sync::Arc;
/// use rig_core::brdf::discrepancy::{Discrepancy, Material, NODES};
/// use rig_core::brdf::{Brdf, Dictionary, Mixture};
///
/// let dictionary = Arc::new(Dictionary::rig26());
/// let equal = vec![1.0 / 26.0; 26];
/// let mixture = Mixture::new(dictionary, [equal.clone(), equal.clone(), equal])?;
/// let plain = Material::from(mixture.clone());
/// // 10% brighter at all angles, in all channels.
/// let brighter = Discrepancy(nalgebra::DVector::repeat(NODES, 1.1f64.ln()));
/// let material = Material::new(mixture, &[brighter]);
///
/// let (to_light, to_viewer) = (glam::Vec3::Z, glam::Vec3::new(0.6, 0.0, 0.8));
/// let ratio = material.eval(to_light, to_viewer)[0] / plain.eval(to_light, to_viewer)[0];
/// assert!((ratio - 1.1).abs() < 1e-5);
/// # Ok::<(), rig_core::brdf::BrdfError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Material {
    /// The mixture.
    pub mixture: Mixture,
    /// Of R, G and B.
    pub discrepancies: [Discrepancy; 3],
}

impl Material {
    /// `mixture` with these discrepancies: one per channel, or one for all.
    pub fn new(mixture: Mixture, discrepancies: &[Discrepancy]) -> Self {
        Self {
            mixture,
            discrepancies: [0, 1, 2].map(|c| discrepancies[c.min(discrepancies.len() - 1)].clone()),
        }
    }

    /// Per channel, f in 1/sr from the values of the `atoms` (in the dictionary's order) at these
    /// half and difference angles.
    pub fn at(&self, atoms: &[f64], theta_h_deg: f64, theta_d_deg: f64) -> [f64; 3] {
        let around = around_angles(theta_h_deg, theta_d_deg);
        [0, 1, 2].map(|c| {
            let terms = self.mixture.weights()[c].iter().zip(atoms);
            let f: f64 = terms.map(|(weight, atom)| weight * atom).sum();
            f * self.discrepancies[c].factor_around(around)
        })
    }

    /// The mixture's f times the discrepancy's factor between these nodes.
    #[inline]
    fn scaled(&self, f: [f32; 3], around: [(usize, f32); 4]) -> [f32; 3] {
        [0, 1, 2].map(|c| f[c] * self.discrepancies[c].factor_around(around) as f32)
    }
}

/// A mixture without discrepancy.
impl From<Mixture> for Material {
    fn from(mixture: Mixture) -> Self {
        Self::new(mixture, &[Discrepancy::none()])
    }
}

impl Brdf for Material {
    fn eval(&self, to_light: Vec3, to_viewer: Vec3) -> [f32; 3] {
        let f = self.mixture.eval(to_light, to_viewer);
        if f == [0.0; 3] {
            return f;
        }
        self.scaled(f, node_weights(to_light, to_viewer))
    }

    fn as_mixture(&self) -> Option<&Mixture> {
        let exact = self
            .discrepancies
            .iter()
            .all(|d| d.0.iter().all(|&g| g == 0.0));
        exact.then_some(&self.mixture)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::brdf::HalfDifference;

    /// The products of the modes are the covariance, without the part of a common factor.
    #[test]
    fn modes_have_the_stated_deviations() {
        let modes = modes();
        let nodes: Vec<Node> = nodes().collect();
        let covariance = modes * modes.transpose();
        for (k, node) in nodes.iter().enumerate() {
            let stated = deviation(node.theta_h_deg, node.theta_d_deg);
            let found = covariance[(k, k)].sqrt();
            assert!(
                (0.6..1.01).contains(&(found / stated)),
                "{node:?}: {found} for {stated}"
            );
        }
        for mode in modes.column_iter() {
            let inner = nodes.iter().zip(mode.iter());
            let inner = inner.filter(|(n, _)| n.theta_h_deg < 70.0 && n.theta_d_deg < 72.0);
            let sum: f64 = inner.map(|(_, v)| v).sum();
            assert!(sum.abs() < 1e-2, "a common factor: {sum}");
        }
    }

    /// The measures add up to those of all pairs of angles.
    #[test]
    fn nodes_share_all_directions() {
        let sum: f64 = nodes().map(|n| n.measure).sum();
        let [h, d] = [82f64, 88f64].map(f64::to_radians);
        assert!((sum - (1.0 - h.cos()) * d.sin().powi(2)).abs() < 1e-12);
    }

    /// Nodes that stand for pairs of directions give, on average, what interpolation gives.
    #[test]
    fn nodes_near_stand_for_those_around() {
        let function = |k: usize| (k as f64 * 0.7).sin();
        for (h, d) in [
            (0.5f64, 20.0f64),
            (4.0, 3.0),
            (25.0, 58.0),
            (70.0, 40.0),
            (5.0, 85.0),
        ] {
            let (mut near, mut interpolated) = (0.0, 0.0);
            let count = 20_000;
            for k in 0..count {
                // About as many digits change as between paths.
                let (h, d) = (h + 1e-4 * f64::from(k % 141), d + 1e-4 * f64::from(k / 141));
                let (h_rad, d_rad) = (h.to_radians(), d.to_radians());
                let node = node_near(h_rad.sin().powi(2) as f32, d_rad.cos() as f32);
                near += function(usize::from(node));
                let around = around_angles(h, d).into_iter();
                interpolated += around
                    .map(|(k, share)| f64::from(share) * function(k))
                    .sum::<f64>();
            }
            let difference = (near - interpolated) / f64::from(count);
            // Four standard deviations of a mean of values within ±1, and the table's rounding.
            assert!(difference.abs() < 0.03, "{h}, {d}: {difference}");
        }
    }

    /// A function that is linear in both angles is met exactly, whatever φd.
    #[test]
    fn nodes_around_interpolate() {
        let linear = |h: f64, d: f64| 1.3 - 0.01 * h + 0.02 * d;
        let values = nodes().map(|n| linear(n.theta_h_deg, n.theta_d_deg).ln());
        let discrepancy = Discrepancy(DVector::from_iterator(NODES, values));
        for (h, d, phi) in [(0.4, 5.0, 1.0), (17.0, 50.0, 2.0), (60.0, 20.0, 0.3)] {
            assert!((discrepancy.factor(h, d) - linear(h, d)).abs() < 1e-6);
            let angles = HalfDifference {
                theta_h_rad: f64::to_radians(h),
                theta_d_rad: f64::to_radians(d),
                phi_d_rad: phi,
            };
            let (i, o) = angles.to_directions();
            let found = discrepancy.factor_around(node_weights(i.as_vec3(), o.as_vec3()));
            assert!((found - linear(h, d)).abs() < 1e-4, "{found}");
        }
    }
}
