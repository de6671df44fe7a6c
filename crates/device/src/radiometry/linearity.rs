//! How far a sensor's counts are from proportional to light, and the correction.

use serde::{Deserialize, Serialize};

/// A smooth correction of counts: with the signal `y` above the black level, in
/// DN, and `u = y / scale_dn`, the proportional signal is
/// `x = y (1 + c₁ u + c₂ u²)`. It leaves small signals as they are.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Linearity {
    /// Signal at which `u` is 1, DN; > 0.
    pub scale_dn: f64,
    /// c₁ and c₂.
    pub coefficients: [f64; 2],
    /// Their covariance.
    pub covariance: [[f64; 2]; 2],
}

impl Linearity {
    /// Counts that are proportional already; changes no bit of them.
    pub const NONE: Self = Self {
        scale_dn: 1.0,
        coefficients: [0.0; 2],
        covariance: [[0.0; 2]; 2],
    };

    /// The proportional signal of one above the black level, DN.
    pub fn proportional_dn(&self, signal_dn: f64) -> f64 {
        let [c1, c2] = self.coefficients;
        let u = signal_dn / self.scale_dn;
        signal_dn * (1.0 + c1 * u + c2 * u * u)
    }

    /// Derivative of [`Self::proportional_dn`].
    pub fn slope(&self, signal_dn: f64) -> f64 {
        let [c1, c2] = self.coefficients;
        let u = signal_dn / self.scale_dn;
        1.0 + 2.0 * c1 * u + 3.0 * c2 * u * u
    }

    /// Derivatives of [`Self::proportional_dn`] by the two coefficients, DN.
    pub fn per_coefficient(&self, signal_dn: f64) -> [f64; 2] {
        let u = signal_dn / self.scale_dn;
        [signal_dn * u, signal_dn * u * u]
    }

    /// Variance that the coefficients' uncertainty gives to a quantity with
    /// these derivatives.
    pub fn variance(&self, per_coefficient: [f64; 2]) -> f64 {
        let [a, b] = per_coefficient;
        let c = &self.covariance;
        (a * a * c[0][0] + 2.0 * a * b * c[0][1] + b * b * c[1][1]).max(0.0)
    }

    /// Whether the proportional signal grows with the counts from darkness to
    /// `end_dn` above the black level.
    pub fn grows_up_to(&self, end_dn: f64) -> bool {
        let [c1, c2] = self.coefficients;
        // The slope is a parabola: lowest at an end or at its vertex.
        let vertex_dn = -c1 / (3.0 * c2) * self.scale_dn;
        let lowest = [0.0, end_dn, vertex_dn]
            .into_iter()
            .filter(|y| (0.0..=end_dn).contains(y))
            .map(|y| self.slope(y))
            .fold(f64::INFINITY, f64::min);
        self.scale_dn > 0.0 && lowest.is_finite() && lowest > 0.0
    }

    /// Whether the covariance can be one.
    pub fn has_covariance(&self) -> bool {
        let [[a, b], [c, d]] = self.covariance;
        let finite = [a, b, c, d].iter().all(|x| x.is_finite());
        finite && b == c && a >= 0.0 && d >= 0.0 && a * d - b * b >= -1e-9 * a * d
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BENT: Linearity = Linearity {
        scale_dn: 4000.0,
        coefficients: [0.02, -0.004],
        covariance: [[4e-6, -1e-6], [-1e-6, 1e-6]],
    };

    #[test]
    fn derivatives_are_those_of_the_curve() {
        for y in [-5.0, 1.0, 900.0, 3990.0] {
            let h = 0.01;
            let numeric = (BENT.proportional_dn(y + h) - BENT.proportional_dn(y - h)) / (2.0 * h);
            assert!((BENT.slope(y) - numeric).abs() < 1e-8, "{y}");
            for (i, derivative) in BENT.per_coefficient(y).into_iter().enumerate() {
                let mut other = BENT;
                other.coefficients[i] += 1e-6;
                let numeric = (other.proportional_dn(y) - BENT.proportional_dn(y)) / 1e-6;
                assert!((derivative - numeric).abs() < 1e-5 * y.abs(), "{y}, {i}");
            }
        }
        assert_eq!(Linearity::NONE.proportional_dn(0.1 + 0.2), 0.1 + 0.2);
    }

    #[test]
    fn a_curve_that_turns_back_is_noticed() {
        assert!(Linearity::NONE.grows_up_to(65_535.0));
        assert!(BENT.grows_up_to(4200.0));
        let with = |coefficients| Linearity {
            coefficients,
            ..BENT
        };
        assert!(!with([-0.6, 0.0]).grows_up_to(4000.0));
        // Lowest in the middle: 1 - 2u + 3 (0.3) u² at u = 1.11.
        assert!(!with([-1.0, 0.3]).grows_up_to(8000.0));
        assert!(!with([f64::NAN, 0.0]).grows_up_to(4000.0));
        assert!(BENT.has_covariance());
        let mut impossible = BENT;
        impossible.covariance = [[1e-6, 2e-6], [2e-6, 1e-6]];
        assert!(!impossible.has_covariance());
    }
}
