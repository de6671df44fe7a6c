//! A BRDF whose values at grazing directions are those a little above the horizon.
//!
//! RGL files hold f·cos θo. At their nodes next to the horizon, f is what their interpolation
//! leaves over a cosine of almost 0, and a table of f would spread such values over a degree.

use glam::Vec3;

use crate::brdf::Brdf;

/// The least cosine of either direction: that from which the BRDF errors are counted.
const LEAST_COSINE: f32 = 0.02;

/// Evaluates at directions that are raised to the least cosine.
pub(super) struct AboveHorizon<'a>(pub &'a dyn Brdf);

impl Brdf for AboveHorizon<'_> {
    fn eval(&self, to_light: Vec3, to_viewer: Vec3) -> [f32; 3] {
        if !(to_light.z > 0.0 && to_viewer.z > 0.0) {
            return [0.0; 3];
        }
        self.0.eval(raised(to_light), raised(to_viewer))
    }
}

/// Of the same azimuth.
fn raised(direction: Vec3) -> Vec3 {
    if direction.z >= LEAST_COSINE {
        return direction;
    }
    let across = (1.0 - LEAST_COSINE * LEAST_COSINE).sqrt() / direction.x.hypot(direction.y);
    Vec3::new(direction.x * across, direction.y * across, LEAST_COSINE)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 1 over both cosines, as what is left of a product with a cosine.
    struct Blown;

    impl Brdf for Blown {
        fn eval(&self, to_light: Vec3, to_viewer: Vec3) -> [f32; 3] {
            [1.0 / (to_light.z * to_viewer.z); 3]
        }
    }

    #[test]
    fn what_blows_up_at_the_horizon_does_not() {
        let grazing = Vec3::new(0.6, 0.8, 1e-6);
        let [f, ..] = AboveHorizon(&Blown).eval(grazing, Vec3::Z);
        assert!((f * LEAST_COSINE - 1.0).abs() < 1e-3, "{f}");
        let turned = raised(grazing);
        assert!(
            (turned.length() - 1.0).abs() < 1e-5 && (turned.y / turned.x - 4.0 / 3.0).abs() < 1e-5
        );
        let high = Vec3::new(0.6, 0.0, 0.8);
        assert_eq!(
            AboveHorizon(&Blown).eval(high, high),
            Blown.eval(high, high)
        );
    }
}
