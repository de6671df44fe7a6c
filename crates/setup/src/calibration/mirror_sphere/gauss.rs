//! The fall of a sphere's shading towards its limb, behind a blur.

/// √(1 − (1 − d/R)²) for a distance d inside the limb, 0 outside, blurred: the height of a
/// sphere over its radius, which the shading of a diffuse one follows.
pub struct Limb {
    first_px: f64,
    step_px: f64,
    values: Vec<f64>,
}

const NODES: usize = 32;

impl Limb {
    /// For distances from `-reach_px` to `reach_px`, a radius and a blur, pixels.
    pub fn new(reach_px: f64, radius_px: f64, blur_px: f64) -> Self {
        let step_px = blur_px / 12.0;
        let first_px = -reach_px - step_px;
        let count = (2.0 * (reach_px + 2.0 * step_px) / step_px).ceil() as usize + 1;
        let height = |d: f64| {
            let rise = (d / radius_px).min(1.0);
            (rise * (2.0 - rise)).max(0.0).sqrt()
        };
        let values = (0..count).map(|i| {
            let d = first_px + i as f64 * step_px;
            let low = (d - 5.0 * blur_px).max(0.0).sqrt();
            let high = (d + 5.0 * blur_px).max(0.0).sqrt();
            // With t² for the distance the root at the limb is smooth: midpoint rule.
            let width = (high - low) / NODES as f64;
            let density = |t: f64| {
                let z = (d - t * t) / blur_px;
                2.0 * t * height(t * t) * (-0.5 * z * z).exp()
            };
            let sum: f64 = (0..NODES)
                .map(|k| density(low + (k as f64 + 0.5) * width))
                .sum();
            sum * width / (blur_px * (2.0 * std::f64::consts::PI).sqrt())
        });
        Self {
            first_px,
            step_px,
            values: values.collect(),
        }
    }

    /// The blurred height at a distance inside the limb, pixels.
    pub fn at(&self, distance_px: f64) -> f64 {
        let position = ((distance_px - self.first_px) / self.step_px).max(0.0);
        let index = (position as usize).min(self.values.len().saturating_sub(2));
        let part = (position - index as f64).min(1.0);
        self.values[index] * (1.0 - part) + self.values[index + 1] * part
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against a plain sum over small steps of the blur's own variable.
    #[test]
    fn the_blurred_limb_is_the_integral() {
        let (radius, blur) = (30.0, 0.8);
        let limb = Limb::new(6.0, radius, blur);
        for d in [-3.0, -0.7, 0.0, 0.4, 2.0, 5.5] {
            let (mut sum, mut weight) = (0.0, 0.0);
            for k in -4000..=4000 {
                let z = f64::from(k) * 1.5e-3;
                let w = (-0.5 * z * z).exp();
                let rise: f64 = ((d - blur * z) / radius).max(0.0);
                sum += w * (rise * (2.0 - rise)).sqrt();
                weight += w;
            }
            let expected = sum / weight;
            assert!(
                (limb.at(d) - expected).abs() < 1e-3,
                "{d}: {} {expected}",
                limb.at(d)
            );
        }
    }
}
