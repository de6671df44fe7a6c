//! The Beckmann reflection lobe: facet slopes that are normally distributed, so that
//! its tails end where those of [`ggx`](super::ggx) go on.
//!
//! Walter et al. 2007: distribution D (Eq. 25) of width `alpha`, Smith's masking by
//! their rational approximation (Eq. 27, within 0.35% of the exact form).

use super::ggx::Real;

/// Distribution of facet normals D(θh), 1/sr; `sin2_h` = sin² θh.
pub fn distribution<T: Real>(alpha: T, sin2_h: T) -> T {
    let cos2_h = T::of(1.0) - sin2_h;
    let alpha2 = alpha * alpha;
    let tan2_over_alpha2 = sin2_h / (cos2_h * alpha2);
    // Beyond, single precision has no normal number left; at 90° it is no number.
    if tan2_over_alpha2 < T::of(80.0) {
        let norm = T::of(std::f64::consts::PI) * alpha2 * cos2_h * cos2_h;
        (-tan2_over_alpha2).exp() / norm
    } else {
        T::of(0.0)
    }
}

/// G1(θ) / (2 cos θ), finite at the horizon; G1 is Smith's masking function.
pub fn masking_over_two_cos<T: Real>(alpha: T, cos: T) -> T {
    let one = T::of(1.0);
    let sin2 = one - cos * cos;
    // The argument a = 1/(α tan θ) is cos/spread.
    let spread = alpha * (if sin2 > T::of(0.0) { sin2 } else { T::of(0.0) }).sqrt();
    if cos >= T::of(1.6) * spread {
        return T::of(0.5) / cos;
    }
    let a = cos / spread;
    let over_a = T::of(3.535) + T::of(2.181) * a;
    let below = one + (T::of(2.276) + T::of(2.577) * a) * a;
    T::of(0.5) * over_a / (below * spread)
}

/// D·G1(i)·G1(o) / (4 cos θi cos θo), 1/sr: the lobe without its Fresnel factor.
pub fn d_g<T: Real>(alpha: T, cos_i: T, cos_o: T, sin2_h: T) -> T {
    distribution(alpha, sin2_h)
        * masking_over_two_cos(alpha, cos_i)
        * masking_over_two_cos(alpha, cos_o)
}

/// A facet normal (unit, local frame) with density D·cos θh; `u` is uniform in [0, 1)².
pub fn sample_normal(alpha: f64, u: [f64; 2]) -> [f64; 3] {
    let tan2 = -alpha * alpha * (1.0 - u[1]).ln();
    let cos = 1.0 / (1.0 + tan2).sqrt();
    let (sin_phi, cos_phi) = (std::f64::consts::TAU * u[0]).sin_cos();
    let sin = (tan2 / (1.0 + tan2)).sqrt();
    [sin * cos_phi, sin * sin_phi, cos]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// ∫ D cos θh dω = 1.
    #[test]
    fn facets_cover_the_surface_once() {
        for alpha in [0.01, 0.1, 0.5, 1.0] {
            let n = 400_000;
            let sum: f64 = (0..n)
                .map(|k| {
                    let sin2: f64 = (f64::from(k) + 0.5) / f64::from(n);
                    std::f64::consts::PI * distribution(alpha, sin2) / f64::from(n)
                })
                .sum();
            assert!((sum - 1.0).abs() < 1e-3, "{alpha}: {sum}");
        }
    }

    /// Smith's G1 in closed form, 2/(1 + erf a + exp(−a²)/(a√π)).
    #[test]
    fn masking_is_within_its_stated_error() {
        for alpha in [0.01f64, 0.1, 0.3, 0.6, 1.0] {
            for deg in [1.0f64, 30.0, 60.0, 80.0, 88.0, 89.9] {
                let theta = deg.to_radians();
                let a = 1.0 / (alpha * theta.tan());
                let exact =
                    2.0 / (1.0 + libm::erf(a) + (-a * a).exp() / (a * std::f64::consts::PI.sqrt()));
                let double = masking_over_two_cos(alpha, theta.cos()) * 2.0 * theta.cos();
                let single = f64::from(masking_over_two_cos(alpha as f32, theta.cos() as f32))
                    * 2.0
                    * theta.cos();
                assert!(
                    (double / exact - 1.0).abs() < 3.6e-3,
                    "{alpha} {deg}: {double} {exact}"
                );
                assert!(
                    (single / double - 1.0).abs() < 1e-4,
                    "{alpha} {deg}: {single} {double}"
                );
            }
        }
    }
}
