//! Model discrepancy: by what a material differs from every mixture of a dictionary.
//!
//! > ln f = ln f_mixture + g₀(θh, θd) + g₁(θh, θd) cos 2φd
//!
//! where (g₀, g₁) is a Gaussian process of mean zero over half and difference angle, tabulated at
//! nodes; e^g is linear between them. cos 2φd is the first term of a series that swapping light and
//! viewer (φd + π) and mirroring (−φd) leave as it is. g₁ vanishes with sin²θh sin²θd, where φd
//! loses its meaning. What is known of (g₀, g₁) a priori is a [`Prior`] (docs/adr/0032).
//!
//! [`Material`] is what a fit reports: a mixture with its discrepancy, itself a [`Brdf`].

use std::sync::OnceLock;

use glam::Vec3;
use nalgebra::DVector;

use super::{Brdf, HalfDifference, Mixture};

mod prior;
pub mod table;

pub use prior::{MOST_MODES, Prior, smoothed, standard_modes};

/// Half angles of the nodes, degrees.
const THETA_H_DEG: [f64; 25] = [
    0.0, 0.3, 0.6, 1.0, 1.5, 2.2, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.5, 15.0, 18.0, 22.0, 26.0,
    30.0, 35.0, 40.0, 46.0, 52.0, 59.0, 66.0, 82.0,
];
/// Difference angles of the nodes, degrees.
const THETA_D_DEG: [f64; 16] = [
    0.0, 12.0, 24.0, 35.0, 45.0, 49.5, 54.0, 58.0, 62.0, 65.5, 69.0, 72.5, 76.0, 79.0, 82.0, 88.0,
];

/// Half and difference angles of the nodes of tables without φd, degrees: some of today's.
const EARLIER_DEG: ([f64; 12], [f64; 11]) = (
    [
        0.0, 1.0, 3.0, 6.0, 10.0, 15.0, 22.0, 30.0, 40.0, 52.0, 66.0, 82.0,
    ],
    [
        0.0, 12.0, 24.0, 35.0, 45.0, 54.0, 62.0, 69.0, 76.0, 82.0, 88.0,
    ],
);

/// Values of tables without φd, as fits were once written.
pub const EARLIER_VALUES: usize = EARLIER_DEG.0.len() * EARLIER_DEG.1.len();

/// Nodes of the table, θd fastest.
pub const NODES: usize = THETA_H_DEG.len() * THETA_D_DEG.len();

/// Values of the table: g₀ at the nodes, then g₁.
pub const VALUES: usize = 2 * NODES;

/// Levels of cos 2φd from −1 to 1 in a record of a path. Between two, e^(g₁ cos 2φd) is taken as
/// linear, at most g₁²/1900 too large.
pub const LEVELS: usize = 32;

/// Places of a table of factors: a level of cos 2φd at a node, levels fastest.
pub const PLACES: usize = NODES * LEVELS;

// A record names its place in sixteen bits.
const _: () = assert!(PLACES <= 1 << 16);

/// cos 2φd of a level.
#[inline(always)]
pub const fn cos_2phi_of(level: usize) -> f32 {
    level as f32 * (2.0 / (LEVELS - 1) as f32) - 1.0
}

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

/// Azimuths per node at which a function of three angles is looked at.
pub const AZIMUTHS: usize = 5;

impl Node {
    /// sin²θh sin²θd, with which φd loses its meaning.
    fn meaning_of_phi(&self) -> f64 {
        let [h, d] = [self.theta_h_deg, self.theta_d_deg].map(|v| v.to_radians().sin());
        (h * d).powi(2)
    }

    /// The node's angles with azimuths at which both directions are above the horizon.
    pub fn azimuths(self) -> [HalfDifference; AZIMUTHS] {
        let [theta_h_rad, theta_d_rad] = [self.theta_h_deg, self.theta_d_deg].map(f64::to_radians);
        // There |cos φd| < cot θh cot θd.
        let widest = 0.99 / (theta_h_rad.tan() * theta_d_rad.tan()).max(0.99);
        std::array::from_fn(|k| {
            let share = (k as f64 + 0.5) / AZIMUTHS as f64;
            HalfDifference {
                theta_h_rad,
                theta_d_rad,
                phi_d_rad: std::f64::consts::FRAC_PI_2 - share * widest.asin(),
            }
        })
    }
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

/// Between which nodes of an axis an angle lies, and how far.
fn segment(axis: &[f64], deg: f64) -> (usize, f64) {
    let k = axis.partition_point(|&n| n <= deg).clamp(1, axis.len() - 1) - 1;
    let t = (deg - axis[k]) / (axis[k + 1] - axis[k]);
    (k, t.clamp(0.0, 1.0))
}

/// Where a pair of directions lies in the table.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    /// The four nodes around its angles, with their bilinear weights.
    pub around: [(usize, f32); 4],
    /// cos 2φd.
    pub cos_2phi: f32,
}

impl Place {
    /// Of unit vectors in the local frame.
    #[inline]
    pub fn of(to_light: Vec3, to_viewer: Vec3) -> Self {
        let (sum, apart) = (to_light + to_viewer, to_light - to_viewer);
        let tangential = sum.x.hypot(sum.y);
        let theta_h = tangential.atan2(sum.z);
        let theta_d = apart.length().atan2(sum.length());
        let sin2_h = tangential * tangential / sum.length_squared();
        Self::at(
            f64::from(theta_h.to_degrees()),
            f64::from(theta_d.to_degrees()),
            cos_2phi(apart.z, sin2_h, 0.25 * apart.length_squared()),
        )
    }

    /// At half and difference angles and cos 2φd.
    pub fn at(theta_h_deg: f64, theta_d_deg: f64, cos_2phi: f32) -> Self {
        let ((h, u), (d, v)) = (
            segment(&THETA_H_DEG, theta_h_deg),
            segment(&THETA_D_DEG, theta_d_deg),
        );
        let (u, v) = (u as f32, v as f32);
        let first = h * THETA_D_DEG.len() + d;
        let next = first + THETA_D_DEG.len();
        Self {
            around: [
                (first, (1.0 - u) * (1.0 - v)),
                (first + 1, (1.0 - u) * v),
                (next, u * (1.0 - v)),
                (next + 1, u * v),
            ],
            cos_2phi,
        }
    }
}

/// cos 2φd from the difference of the cosines to the normal, 2 sin θh sin θd cos φd, and sin²θh and
/// sin²θd; where φd has no meaning, any.
#[inline(always)]
fn cos_2phi(difference: f32, sin2_h: f32, sin2_d: f32) -> f32 {
    let sines = (2.0 * sin2_h * sin2_d).max(1e-20);
    (difference * difference / sines - 1.0).clamp(-1.0, 1.0)
}

/// Stochastic rounding of a pair of directions (the cosines to the normal, sin² θh and cos θd) to
/// one of the eight places around it, a node and a level of cos 2φd, with probability equal to its
/// trilinear weight, so that sums over many directions are unbiased. The random bits are a hash of
/// the operands.
#[inline]
pub fn place_near(cos_i: f32, cos_o: f32, sin2_h: f32, cos_d: f32) -> u16 {
    const STEPS: usize = 1024;
    static POSITIONS: OnceLock<[[f32; STEPS + 1]; 2]> = OnceLock::new();
    let [by_h, by_d] = POSITIONS.get_or_init(|| {
        let position = |axis: &[f64], deg: f64| {
            let (k, t) = segment(axis, deg);
            (k as f64 + t.min(0.999_999)) as f32
        };
        let root = |k: usize| k as f64 / STEPS as f64;
        [
            std::array::from_fn(|k| {
                position(&THETA_H_DEG, root(k).powi(2).min(1.0).asin().to_degrees())
            }),
            std::array::from_fn(|k| {
                position(&THETA_D_DEG, (1.0 - root(k).powi(2)).acos().to_degrees())
            }),
        ]
    });
    let between = |table: &[f32; STEPS + 1], root: f32| {
        let at = root.clamp(0.0, 1.0) * (STEPS as f32 - 0.001);
        let k = (at as usize).min(STEPS - 1);
        table[k] + (at - k as f32) * (table[k + 1] - table[k])
    };
    let h = between(by_h, sin2_h.sqrt().sqrt());
    let d = between(by_d, (1.0 - cos_d).sqrt());
    let level = cos_2phi(cos_o - cos_i, sin2_h, 1.0 - cos_d * cos_d);
    let level = (level + 1.0) * (0.5 * (LEVELS - 1) as f32);
    let mixed = |bits: u32| {
        let bits = (bits ^ bits >> 15).wrapping_mul(0x85eb_ca6b);
        (bits ^ bits >> 13).wrapping_mul(0xc2b2_ae35)
    };
    let hash = (sin2_h.to_bits() ^ cos_d.to_bits().rotate_left(16)).wrapping_mul(0x9e37_79b9);
    let hash = (hash ^ hash >> 15).wrapping_mul(0x85eb_ca6b);
    let random = |bits: u32| f32::from(bits as u16) / 65536.0;
    let (h, d, level) = (
        (h + random(hash)) as usize,
        (d + random(hash >> 16)) as usize,
        (level + random(mixed(hash ^ cos_i.to_bits()) >> 16)) as usize,
    );
    ((h * THETA_D_DEG.len() + d) * LEVELS + level.min(LEVELS - 1)) as u16
}

/// A discrepancy: g₀ at each node, then g₁ at each, natural logarithms of factors.
#[derive(Clone, Debug, PartialEq)]
pub struct Discrepancy(pub DVector<f64>);

/// How much of g₁ what is known at the azimuths of a node decides: half where its deviation by
/// φd is this over sin²θh sin²θd.
const TRUSTED: f64 = 0.005;

/// Variance of cos 2φd over a node's azimuths at which half of a slope is believed: near the horizon
/// it is small, and what is not seen there is not to be extrapolated.
const LEAST_SQUARE: f64 = 0.002;

impl Discrepancy {
    /// None: g = 0.
    pub fn none() -> Self {
        Self(DVector::zeros(VALUES))
    }

    /// The same for all φd: g₀ by node.
    pub fn even(g: impl Fn(&Node) -> f64) -> Self {
        let mut even = Self::none();
        for (value, node) in even.0.iter_mut().zip(nodes()) {
            *value = g(&node);
        }
        even
    }

    /// Per channel, the one closest to the logarithms `ln_factor` at the azimuths of the nodes.
    pub fn closest(ln_factor: impl Fn(HalfDifference) -> [f64; 3]) -> [Self; 3] {
        let mut closest = [(); 3].map(|()| Self::none());
        for (k, node) in nodes().enumerate() {
            let at = node.azimuths();
            let cosines = at.map(|angles| (2.0 * angles.phi_d_rad).cos());
            let values = at.map(&ln_factor);
            let mean =
                |of: &dyn Fn(usize) -> f64| (0..AZIMUTHS).map(of).sum::<f64>() / AZIMUTHS as f64;
            let cosine = mean(&|p| cosines[p]);
            let square = mean(&|p| (cosines[p] - cosine).powi(2));
            let doubt = (TRUSTED / node.meaning_of_phi().max(1e-12)).powi(2) + LEAST_SQUARE;
            for (c, table) in closest.iter_mut().enumerate() {
                let value = mean(&|p| values[p][c]);
                let along = mean(&|p| (cosines[p] - cosine) * values[p][c]);
                let slope = match node.meaning_of_phi() > 0.0 {
                    true => along / (square + doubt),
                    false => 0.0,
                };
                table.0[k] = value - slope * cosine;
                table.0[NODES + k] = slope;
            }
        }
        closest
    }

    /// From [`VALUES`] values, or from a table of ln factors without φd at fewer nodes (12 half by
    /// 11 difference angles), as fits were once written: the same factor at all angles. `None` for
    /// another number of values.
    pub fn from_values(g: &[f64]) -> Option<Self> {
        if g.len() == VALUES {
            return Some(Self(DVector::from_column_slice(g)));
        }
        let (by_h, by_d) = EARLIER_DEG;
        (g.len() == EARLIER_VALUES).then(|| {
            Self::even(|node| {
                let ((h, u), (d, v)) = (
                    segment(&by_h, node.theta_h_deg),
                    segment(&by_d, node.theta_d_deg),
                );
                let row = |h: usize| {
                    let [low, high] = [0, 1].map(|j| g[h * by_d.len() + d + j].exp());
                    low + v * (high - low)
                };
                (row(h) + u * (row(h + 1) - row(h))).ln()
            })
        })
    }

    /// The half and difference angles of the [`EARLIER_VALUES`], degrees.
    fn earlier_nodes() -> impl Iterator<Item = [f64; 2]> {
        let (by_h, by_d) = EARLIER_DEG;
        by_h.into_iter().flat_map(move |h| by_d.map(|d| [h, d]))
    }

    /// g₀ and g₁ at a node.
    #[inline]
    pub fn at_node(&self, node: usize) -> [f64; 2] {
        [self.0[node], self.0[NODES + node]]
    }

    /// e^g at half and difference angles and φd, degrees.
    pub fn factor(&self, theta_h_deg: f64, theta_d_deg: f64, phi_d_deg: f64) -> f64 {
        let cos_2phi = (2.0 * phi_d_deg).to_radians().cos() as f32;
        self.factor_at(Place::at(theta_h_deg, theta_d_deg, cos_2phi))
    }

    /// e^g.
    #[inline]
    pub fn factor_at(&self, place: Place) -> f64 {
        let terms = place.around.into_iter();
        terms
            .map(|(node, share)| self.at(node, place.cos_2phi).exp() * f64::from(share))
            .sum()
    }

    /// g at a node and cos 2φd.
    #[inline]
    pub fn at(&self, node: usize, cos_2phi: f32) -> f64 {
        let [even, slope] = self.at_node(node);
        even + slope * f64::from(cos_2phi)
    }

    /// e^g at all places.
    pub fn factors(&self) -> Vec<f32> {
        (0..PLACES)
            .map(|k| self.at(k / LEVELS, cos_2phi_of(k % LEVELS)).exp() as f32)
            .collect()
    }
}

/// A mixture of a dictionary's atoms with its discrepancy: the form of a fitted material.
///
/// ```
/// use std::sync::Arc;
/// use rig_core::brdf::discrepancy::{Discrepancy, Material};
/// use rig_core::brdf::{Brdf, Dictionary, Mixture};
///
/// let dictionary = Arc::new(Dictionary::rig26());
/// let equal = vec![1.0 / 26.0; 26];
/// let mixture = Mixture::new(dictionary, [equal.clone(), equal.clone(), equal])?;
/// let plain = Material::from(mixture.clone());
/// // 10% brighter at all angles, in all channels.
/// let brighter = Discrepancy::even(|_| 1.1f64.ln());
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
    /// half and difference angles and φd, degrees.
    pub fn at(
        &self,
        atoms: &[f64],
        theta_h_deg: f64,
        theta_d_deg: f64,
        phi_d_deg: f64,
    ) -> [f64; 3] {
        let f = self.mixture.of_atoms(atoms);
        [0, 1, 2].map(|c| f[c] * self.discrepancies[c].factor(theta_h_deg, theta_d_deg, phi_d_deg))
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
        let place = Place::of(to_light, to_viewer);
        [0, 1, 2].map(|c| f[c] * self.discrepancies[c].factor_at(place) as f32)
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
mod tests;
