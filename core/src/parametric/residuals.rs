//! What a fit compares: cube roots of f·cos θi at fixed directions.
//!
//! Nodes in half and difference angle, denser in θh towards the mirror direction, as MERL's
//! cells are. The cube root keeps peaks from outweighing all else (Löw et al. 2012 compare such
//! measures). A square counts by cos θo, as a sphere shows it, and by (sin θh · sin θd)^(3/4):
//! with the nodes' spacing that is a bit less than by solid angle, so that narrow lobes count.
//! The exponent is the one that made environment errors least
//! (docs/measurements/parametric.md).

use glam::DVec3;
use rayon::prelude::*;

use super::{Directions, ParametricBrdf};
use crate::brdf::{Brdf, HalfDifference};

/// Nodes in θh, θd and φd.
const SHAPE: [usize; 3] = [20, 10, 4];
/// Largest θd, degrees: beyond, measured tables hold noise.
const THETA_D_DEG: f64 = 80.0;
/// Added to f·cos θi before the root is taken, 1/sr: differences below do not count.
const FLOOR: f64 = 3e-4;
/// Of sin θh · sin θd in a square's weight.
const SINE_EXPONENT: f64 = 0.75;
/// Difference of the channels, of the brightest, from which a material has a colour.
const TINTED: f64 = 0.15;
/// Least cosine of both directions.
const LEAST_COS: f64 = 0.03;

/// A material at the nodes.
pub struct Target {
    nodes: Vec<Node>,
    /// ∛(f·cos θi) of R, G, B.
    roots: Vec<[f64; 3]>,
    /// f·cos θi where it is largest, 1/sr; NaN or infinite if some value is.
    brightest: f64,
}

/// Where values are compared.
struct Node {
    to: Directions,
    /// Of a difference of roots.
    weight: f64,
}

impl Target {
    /// Of any BRDF.
    pub fn of(brdf: &dyn Brdf) -> Self {
        let nodes: Vec<Node> = nodes().collect();
        let values: Vec<[f64; 3]> = nodes
            .par_iter()
            .map(|node| {
                let at = &node.to.at;
                let sin_o = (1.0 - at.cos_o * at.cos_o).max(0.0).sqrt();
                let to_light = DVec3::from_array(node.to.light_beside_viewer);
                let to_viewer = DVec3::new(sin_o, 0.0, at.cos_o);
                let f = brdf.eval(to_light.as_vec3(), to_viewer.as_vec3());
                f.map(|f| f64::from(f) * at.cos_i)
            })
            .collect();
        let mut all = values.iter().flatten();
        let brightest = match all.all(|value| value.is_finite()) {
            true => values.iter().flatten().copied().fold(0.0, f64::max),
            false => f64::NAN,
        };
        Self {
            nodes,
            roots: values.into_iter().map(|value| value.map(root)).collect(),
            brightest,
        }
    }

    /// Values compared.
    pub fn len(&self) -> usize {
        3 * self.nodes.len()
    }

    /// Whether every value is finite.
    pub fn is_finite(&self) -> bool {
        self.brightest.is_finite()
    }

    /// Whether nothing is reflected.
    pub fn is_black(&self) -> bool {
        self.brightest <= 0.0
    }

    /// Measured less modelled, times the node's weight; three values for each node.
    pub fn residuals(&self, brdf: &ParametricBrdf) -> Vec<f64> {
        let pairs = self.nodes.iter().zip(&self.roots);
        let of_node = |(node, want): (&Node, &[f64; 3])| {
            let got = brdf.value(&node.to);
            [0, 1, 2].map(|c| node.weight * (want[c] - root(got[c] * node.to.at.cos_i)))
        };
        pairs.flat_map(of_node).collect()
    }

    /// Whether the material has a colour where a lobe shows least; the noise of measurements
    /// is none.
    pub fn is_tinted(&self) -> bool {
        let [r, g, b] = self.diffuse_guess();
        let brightest = r.max(g).max(b);
        brightest - r.min(g).min(b) > TINTED * brightest
    }

    /// Per channel, π·f where a lobe shows least: a first guess of the diffuse colour.
    pub fn diffuse_guess(&self) -> [f64; 3] {
        let pairs = self.nodes.iter().zip(&self.roots);
        let values: Vec<[f64; 3]> = pairs
            .filter(|(node, _)| node.to.at.sin2_h > 0.3 && node.to.at.cos_d > 0.8)
            .map(|(node, roots)| {
                let scale = std::f64::consts::PI / node.to.at.cos_i;
                roots.map(|root| scale * (root.powi(3) - FLOOR))
            })
            .collect();
        [0, 1, 2].map(|c| {
            let of_channel = values.iter().map(|value| value[c]);
            crate::statistics::median(of_channel).unwrap_or(0.5)
        })
    }
}

/// ∛(f·cos θi).
fn root(reflected: f64) -> f64 {
    (reflected.max(0.0) + FLOOR).cbrt()
}

fn nodes() -> impl Iterator<Item = Node> {
    let [n_h, n_d, n_phi] = SHAPE;
    (0..n_h * n_d * n_phi).filter_map(move |k| {
        let middle = |index: usize, count: usize| (index as f64 + 0.5) / count as f64;
        let angles = HalfDifference {
            theta_h_rad: std::f64::consts::FRAC_PI_2 * middle(k / (n_d * n_phi), n_h).powi(2),
            theta_d_rad: THETA_D_DEG.to_radians() * middle(k / n_phi % n_d, n_d),
            // The other half turn swaps light and viewer: by symmetry it is in these, too.
            phi_d_rad: std::f64::consts::PI * middle(k % n_phi, n_phi),
        };
        let (to_light, to_viewer) = angles.to_directions();
        let to = Directions::new(to_light, to_viewer)?;
        let sines = angles.theta_h_rad.sin() * angles.theta_d_rad.sin();
        let weight = (sines.powf(SINE_EXPONENT) * to.at.cos_o).sqrt();
        let is_above = to.at.cos_i > LEAST_COS && to.at.cos_o > LEAST_COS;
        is_above.then_some(Node { to, weight })
    })
}
