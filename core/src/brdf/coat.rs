//! White diffuse matter under a smooth dielectric interface: what the interface lets in
//! and out again, f_r = T(θi)·T(θo) / (π·T̄) with T = 1 − F and T̄ its cosine-weighted mean.
//!
//! Light that the interface sends back into the matter is scattered again; as nothing is
//! absorbed, all that enters leaves, so the directional albedo is T(θi), and with the
//! interface's own reflection everything returns. Reciprocal. The usual model of smooth
//! plastic and paint; the matter's colour is its weight, next to that of a black atom.

use super::ggx::{Real, fresnel};

/// T̄ = 1 − F̄, the share of diffuse light that enters matter of index `eta` ≥ 1.
///
/// F̄ in closed form (Walsh 1926; Duntley 1942).
pub fn mean_transmittance(eta: f64) -> f64 {
    let n = eta;
    let n2 = n * n;
    let n4 = n2 * n2;
    if n < 1.0 + 1e-4 {
        // The terms below cancel; F̄ vanishes with the contrast.
        return 1.0 - (n - 1.0);
    }
    let mean = 0.5
        + (n - 1.0) * (3.0 * n + 1.0) / (6.0 * (n + 1.0).powi(2))
        + n2 * (n2 - 1.0).powi(2) / (n2 + 1.0).powi(3) * ((n - 1.0) / (n + 1.0)).ln()
        - 2.0 * n * n2 * (n2 + 2.0 * n - 1.0) / ((n2 + 1.0) * (n4 - 1.0))
        + 8.0 * n4 * (n4 + 1.0) / ((n2 + 1.0) * (n4 - 1.0).powi(2)) * n.ln();
    1.0 - mean
}

/// f_r, 1/sr, cosine excluded; `norm` is 1/(π·T̄).
pub fn eval<T: Real>(eta: T, norm: T, cos_i: T, cos_o: T) -> T {
    let one = T::of(1.0);
    norm * (one - fresnel(eta, cos_i)) * (one - fresnel(eta, cos_o))
}

/// 1/(π·T̄).
pub fn norm(eta: f64) -> f64 {
    std::f64::consts::FRAC_1_PI / mean_transmittance(eta)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// ∫ T(θ) cos θ dω / π by quadrature.
    #[test]
    fn the_mean_is_the_integral() {
        for eta in [1.01, 1.1, 1.3, 1.5, 2.0, 3.0, 10.0] {
            let n = 200_000;
            let mean: f64 = (0..n)
                .map(|k| {
                    let cos2: f64 = (f64::from(k) + 0.5) / f64::from(n);
                    (1.0 - fresnel(eta, cos2.sqrt())) / f64::from(n)
                })
                .sum();
            let closed = mean_transmittance(eta);
            assert!((closed - mean).abs() < 1e-5, "{eta}: {closed} {mean}");
        }
    }
}
