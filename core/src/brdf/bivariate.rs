//! The (θh, θd) table: a BRDF averaged over φd, as papers plot it.

use super::Brdf;
use super::half_difference::HalfDifference;
use super::table::TabulatedBrdf;

/// Azimuths averaged over [0, π).
const AZIMUTHS: usize = 36;

/// Mean of `brdf` over the φd whose directions are above the horizon, at
/// `n_h` × `n_d` nodes spaced as [`TabulatedBrdf`] says (MERL: 90 × 90).
pub fn average(brdf: &dyn Brdf, n_h: usize, n_d: usize) -> TabulatedBrdf {
    TabulatedBrdf::tabulate([n_h, n_d, 1], |angles| {
        let mut sum = [0.0f64; 3];
        let mut count = 0;
        for k in 0..AZIMUTHS {
            let turned = HalfDifference {
                phi_d_rad: std::f64::consts::PI * (k as f64 + 0.5) / AZIMUTHS as f64,
                ..angles
            };
            let (i, o) = turned.to_directions();
            if i.z > 0.0 && o.z > 0.0 {
                let f = brdf.eval(i.as_vec3(), o.as_vec3());
                for c in 0..3 {
                    sum[c] += f64::from(f[c]);
                }
                count += 1;
            }
        }
        sum.map(|s| (s / f64::from(count)) as f32)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::brdf::nbrdf::NeuralBrdf;

    #[test]
    fn averaging_keeps_what_does_not_depend_on_the_azimuth() {
        let flat = TabulatedBrdf::tabulate([20, 20, 1], |a| {
            [0.1 + a.theta_h_rad as f32, 1.0, 0.1 + a.theta_d_rad as f32]
        });
        let averaged = average(&flat, 20, 20);
        for (a, b) in flat.values().iter().zip(averaged.values()) {
            for c in 0..3 {
                assert!((a[c] - b[c]).abs() < 1e-3 * a[c], "{a:?} {b:?}");
            }
        }
    }

    #[test]
    fn a_material_peaks_at_the_mirror_direction() {
        let brdf = NeuralBrdf::named("red-plastic").unwrap();
        let table = average(&brdf, 18, 9);
        // Its highlight is white, its body red: blue shows the highlight alone.
        let at = |h: usize| table.values()[h * 9 + 2][2];
        assert!(at(0) > 2.0 * at(9), "{} {}", at(0), at(9));
    }
}
