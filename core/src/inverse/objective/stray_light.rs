//! Light that comes neither from the lamp nor by way of the sample, as the shadows show it.
//!
//! A model that errs in proportion to its radiance may not err at all where it is black. What the
//! images have there, light of the room, of the holder or of the lens, would count as a
//! relative error of the model, of any size: the lit cells would lose their weight to the
//! shadows, which say nothing of the material. So it is estimated by itself, as an error
//! of the same size in all cells of an image, and allowed for.

use super::{EDGE_FRACTION, Objective, Value};

/// What the shadows of a light show in one channel. With w the weights, r the residual and m the
/// model.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ShadowSums {
    /// Σ w over all values, lit ones as well.
    pub weight: f64,
    /// Σ w over the shadows.
    shadow_weight: f64,
    /// Σ w (r_A r_B − σ²_captured) over the shadows.
    unexplained: f64,
    /// Σ w m_A m_B over the shadows.
    power: f64,
    /// Σ n² over the shadows, with n = w (σ²_captured + ½ (r_A − r_B)²), what noise puts into a
    /// term of `unexplained`: its variance is 2 n² at most.
    noise_square: f64,
}

/// Deviations of the sum over the shadows from which light in them is no noise.
const SIGNIFICANT_DEVIATIONS: f64 = 5.0;

impl ShadowSums {
    pub fn add(&mut self, value: &Value<'_>, is_shadow: bool) {
        let w = value.weight;
        self.weight += w;
        if is_shadow {
            self.shadow_weight += w;
            let [a, b] = value.residual;
            self.unexplained += w * (a * b - value.variance);
            self.power += w * value.model[0] * value.model[1];
            self.noise_square += (w * (value.variance + 0.5 * (a - b).powi(2))).powi(2);
        }
    }

    pub fn join(&mut self, other: &Self) {
        self.weight += other.weight;
        self.shadow_weight += other.shadow_weight;
        self.unexplained += other.unexplained;
        self.power += other.power;
        self.noise_square += other.noise_square;
    }

    /// Variance of the stray light: mean square of what the shadows have beyond noise, where
    /// that is more than interreflections put there. What is less may be an error of theirs.
    pub fn variance(&self) -> f64 {
        let noise = SIGNIFICANT_DEVIATIONS * (2.0 * self.noise_square).sqrt();
        if self.unexplained > noise.max(self.power) {
            self.unexplained / self.shadow_weight
        } else {
            0.0
        }
    }
}

impl Objective<'_> {
    /// Whether the lamp does not reach a value's cell.
    pub(super) fn is_shadow(&self, value: &Value<'_>) -> bool {
        self.direct.lit(value.cell, value.light) <= EDGE_FRACTION
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shadows(unexplained: f64, power: f64) -> ShadowSums {
        ShadowSums {
            weight: 300.0,
            shadow_weight: 200.0,
            unexplained,
            power,
            noise_square: 50.0,
        }
    }

    /// 50 values with the noise that their weights expect, which sums to less than 50.
    #[test]
    fn only_light_beyond_noise_and_interreflection_is_stray() {
        assert_eq!(shadows(400.0, 0.0).variance(), 2.0);
        assert_eq!(shadows(49.0, 0.0).variance(), 0.0);
        assert_eq!(shadows(400.0, 401.0).variance(), 0.0);
        assert_eq!(ShadowSums::default().variance(), 0.0);
    }
}
