//! The facet distribution that a BRDF looks like it had (after Dupuy & Jakob 2018,
//! Sec. 4.1, and Dupuy et al. 2015).
//!
//! Where light and viewer coincide, a microfacet BRDF of constant Fresnel term is
//! D(m) / (4 σ(m) cos θm) up to a factor, and σ(i) = ∫ D(m) ⟨i, m⟩ dm. Together
//! they make D the leading eigenvector of an integral operator, found by power
//! iteration. Retro-reflection alone hardly shows a dielectric's narrow lobe next to a
//! matte ground, so the mean over a few difference angles θd stands in its place,
//! f·cos²θd, which for facets is the same up to Fresnel and shadowing. Isotropic:
//! everything depends on the polar angle.

use std::f64::consts::{FRAC_PI_2, PI};

use super::warp::cell;
use crate::brdf::{Brdf, HalfDifference};

/// D and σ at angles θ = u²·π/2 for equidistant u in [0, 1].
pub struct Facets {
    /// Distribution of normals D, 1/sr: ∫ D cos θ dω = 1.
    pub ndf: Vec<f32>,
    /// Projected area of the facets seen from θ: σ(0) = 1.
    pub sigma: Vec<f32>,
}

/// Keeps D positive where the material reflects nothing back, 1/sr.
const FAINT: f64 = 1e-6;
/// The operator's second eigenvalue is small; this is far more than needed.
const ITERATIONS: usize = 20;

impl Facets {
    /// At `nodes` angles.
    pub fn of(brdf: &dyn Brdf, nodes: usize) -> Self {
        let last = (nodes - 1) as f64;
        let theta: Vec<f64> = (0..nodes).map(|k| theta_of(k as f64 / last)).collect();
        let back: Vec<f64> = theta
            .iter()
            .map(|&theta_h| {
                let seen = DIFFERENCES_DEG.map(|theta_d_deg| {
                    let f: f64 = across(brdf, theta_h, theta_d_deg).iter().sum();
                    f / 3.0 * theta_d_deg.to_radians().cos().powi(2)
                });
                let mean = seen.iter().sum::<f64>() / seen.len() as f64;
                4.0 * (mean + FAINT) * theta_h.cos().max(0.0)
            })
            .collect();
        // sin θ dθ with θ = u²π/2, by the trapezoidal rule.
        let step: Vec<f64> = (0..nodes)
            .map(|k| {
                let end = if k == 0 || k + 1 == nodes { 0.5 } else { 1.0 };
                end / last * PI * (k as f64 / last) * theta[k].sin()
            })
            .collect();
        let kernel: Vec<f64> = theta
            .iter()
            .flat_map(|&i| {
                theta
                    .iter()
                    .zip(&step)
                    .map(move |(&m, step)| step * around(i, m))
            })
            .collect();
        let mut sigma = vec![1.0; nodes];
        let mut ndf = vec![0.0; nodes];
        for _ in 0..ITERATIONS {
            for ((d, back), sigma) in ndf.iter_mut().zip(&back).zip(&sigma) {
                *d = back * sigma;
            }
            for (sigma, row) in sigma.iter_mut().zip(kernel.chunks_exact(nodes)) {
                *sigma = row.iter().zip(&ndf).map(|(k, d)| k * d).sum();
            }
            let scale = sigma[0].recip();
            ndf.iter_mut().chain(&mut sigma).for_each(|v| *v *= scale);
        }
        let single = |values: Vec<f64>| values.into_iter().map(|v| v as f32).collect();
        Self {
            ndf: single(ndf),
            sigma: single(sigma),
        }
    }

    /// D at the square coordinate u, as a reader of the file interpolates it.
    pub fn ndf_at(&self, u: f64) -> f64 {
        interpolate(&self.ndf, u)
    }

    /// σ at the square coordinate u, likewise.
    pub fn sigma_at(&self, u: f64) -> f64 {
        interpolate(&self.sigma, u)
    }
}

/// Difference angles at which a BRDF is looked at, degrees.
pub const DIFFERENCES_DEG: [f64; 4] = [0.0, 30.0, 55.0, 75.0];

/// f of R, G, B where light and viewer lie on either side of the plane of normal and
/// half vector (φd = 90°), which keeps both above the horizon.
pub fn across(brdf: &dyn Brdf, theta_h_rad: f64, theta_d_deg: f64) -> [f64; 3] {
    let angles = HalfDifference {
        theta_h_rad,
        theta_d_rad: theta_d_deg.to_radians(),
        phi_d_rad: FRAC_PI_2,
    };
    let (i, o) = angles.to_directions();
    brdf.eval(i.as_vec3(), o.as_vec3()).map(f64::from)
}

/// Polar angle of a square coordinate.
pub fn theta_of(u: f64) -> f64 {
    FRAC_PI_2 * u * u
}

/// Square coordinate of a polar angle.
pub fn square_of(theta_rad: f64) -> f64 {
    (theta_rad / FRAC_PI_2).max(0.0).sqrt()
}

fn interpolate(values: &[f32], u: f64) -> f64 {
    let (lower, t) = cell(u, values.len());
    (1.0 - t) * f64::from(values[lower]) + t * f64::from(values[lower + 1])
}

/// ∫ max(0, ⟨i, m⟩) dφm over a turn.
fn around(theta_i: f64, theta_m: f64) -> f64 {
    let (a, b) = (theta_i.cos() * theta_m.cos(), theta_i.sin() * theta_m.sin());
    if a >= b {
        return 2.0 * PI * a;
    }
    let edge = (-a / b).clamp(-1.0, 1.0).acos();
    2.0 * (a * edge + b * edge.sin())
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::brdf::{Atom, Dictionary, Mixture};

    /// Of a GGX lobe seen almost head-on, its own D (Walter et al. 2007, Eq. 33) comes
    /// back, but for the masking at steep angles that D·G mixes in; σ of any surface
    /// falls from 1, and at first like cos θ.
    #[test]
    fn a_narrow_lobe_gives_its_own_distribution_back() {
        for alpha in [0.05, 0.2] {
            let atom = Atom::Ggx { alpha, eta: 20.0 };
            let dictionary = Arc::new(Dictionary::new("one", vec![atom]).unwrap());
            let lobe = Mixture::grey(dictionary, vec![1.0]).unwrap();
            let facets = Facets::of(&lobe, 256);
            for (u, sigma) in [0.0, 0.1, 0.2, 0.3].map(|u| (u, facets.sigma_at(u))) {
                let cos = theta_of(u).cos();
                let tan2 = theta_of(u).tan().powi(2);
                let a2 = alpha * alpha;
                let expected = a2 / (PI * cos.powi(4) * (a2 + tan2).powi(2));
                let got = facets.ndf_at(u);
                assert!(
                    (got / expected - 1.0).abs() < 0.1,
                    "{alpha} {u}: {got} for {expected}"
                );
                assert!((sigma / cos - 1.0).abs() < 0.05, "{alpha} {u}: {sigma}");
            }
        }
    }

    #[test]
    fn black_has_a_distribution_too() {
        let dictionary = Arc::new(Dictionary::new("none", vec![Atom::Black]).unwrap());
        let black = Mixture::grey(dictionary, vec![1.0]).unwrap();
        let facets = Facets::of(&black, 64);
        assert!(
            facets
                .ndf
                .iter()
                .chain(&facets.sigma)
                .all(|v| v.is_finite())
        );
        assert!(facets.ndf[0] > 0.0);
    }
}
