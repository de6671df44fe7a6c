//! What a fit compares: cube roots of f·cos θi at fixed directions.
//!
//! Nodes in half and difference angle, denser in θh towards the mirror direction, as MERL's
//! cells are, and counted once each: so a narrow lobe has as many as the rest, and the cube
//! root keeps its peak from outweighing all else (Löw et al. 2012 compare such measures).

use rayon::prelude::*;

use super::{Directions, Model, Parameters, ParametricBrdf};
use crate::brdf::{Brdf, HalfDifference};

/// Nodes in θh, θd and φd.
const SHAPE: [usize; 3] = [24, 12, 6];
/// Largest θd, degrees: beyond, measured tables hold noise.
const THETA_D_DEG: f64 = 80.0;
/// Added to f·cos θi before the root is taken, 1/sr: differences below do not count.
const FLOOR: f64 = 3e-4;
/// Least cosine of both directions.
const LEAST_COS: f64 = 0.03;

/// A material at the nodes.
pub struct Target {
    nodes: Vec<Directions>,
    /// ∛(f·cos θi) of R, G, B.
    roots: Vec<[f64; 3]>,
}

impl Target {
    /// Of any BRDF.
    pub fn of(brdf: &dyn Brdf) -> Self {
        let nodes: Vec<Directions> = nodes().collect();
        let roots = nodes.par_iter().map(|to| {
            let [along, across, up] = to.light_beside_viewer;
            let light = glam::DVec3::new(along, across, up).as_vec3();
            let sin_o = (1.0 - to.at.cos_o * to.at.cos_o).max(0.0).sqrt();
            let viewer = glam::DVec3::new(sin_o, 0.0, to.at.cos_o).as_vec3();
            brdf.eval(light, viewer)
                .map(|f| root(f64::from(f), to))
        });
        let roots = roots.collect();
        Self { nodes, roots }
    }

    /// Values compared.
    pub fn len(&self) -> usize {
        3 * self.nodes.len()
    }

    /// Whether every value is finite.
    pub fn is_finite(&self) -> bool {
        self.roots.iter().flatten().all(|root| root.is_finite())
    }

    /// Whether anything is reflected.
    pub fn is_black(&self) -> bool {
        let black = FLOOR.cbrt();
        self.roots.iter().flatten().all(|&root| root <= black + 1e-9)
    }

    /// Measured less modelled, three values for each node.
    pub fn residuals(&self, model: Model, parameters: &Parameters) -> Vec<f64> {
        let brdf = ParametricBrdf::new(model, parameters);
        let pairs = self.nodes.iter().zip(&self.roots);
        let of_node = |(to, want): (&Directions, &[f64; 3])| {
            let got = brdf.value(to);
            [0, 1, 2].map(|c| want[c] - root(got[c], to))
        };
        pairs.flat_map(of_node).collect()
    }

    /// Per channel, π·f where a lobe shows least: a first guess of the diffuse colour.
    pub fn diffuse_guess(&self) -> [f64; 3] {
        let far = |to: &Directions| to.at.sin2_h > 0.3 && to.at.cos_d > 0.8;
        let pairs = self.nodes.iter().zip(&self.roots);
        let values: Vec<[f64; 3]> = pairs
            .filter(|(to, _)| far(to))
            .map(|(to, roots)| {
                roots.map(|root| (root.powi(3) - FLOOR) / to.at.cos_i * std::f64::consts::PI)
            })
            .collect();
        [0, 1, 2].map(|c| {
            let of_channel = values.iter().map(|value| value[c]);
            crate::statistics::median(of_channel).unwrap_or(0.5)
        })
    }
}

fn root(f: f64, to: &Directions) -> f64 {
    (f.max(0.0) * to.at.cos_i + FLOOR).cbrt()
}

fn nodes() -> impl Iterator<Item = Directions> {
    let [n_h, n_d, n_phi] = SHAPE;
    (0..n_h * n_d * n_phi).filter_map(move |k| {
        let middle = |index: usize, count: usize| (index as f64 + 0.5) / count as f64;
        let angles = HalfDifference {
            theta_h_rad: std::f64::consts::FRAC_PI_2
                * middle(k / (n_d * n_phi), n_h).powi(2),
            theta_d_rad: THETA_D_DEG.to_radians() * middle(k / n_phi % n_d, n_d),
            // The other half turn swaps light and viewer: by symmetry it is in these, too.
            phi_d_rad: std::f64::consts::PI * middle(k % n_phi, n_phi),
        };
        let (to_light, to_viewer) = angles.to_directions();
        let to = Directions::new(to_light, to_viewer)?;
        (to.at.cos_i > LEAST_COS && to.at.cos_o > LEAST_COS).then_some(to)
    })
}
