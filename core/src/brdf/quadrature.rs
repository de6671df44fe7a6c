//! Fixed directions for integrals of a BRDF over the hemisphere.
//!
//! A defensive mixture (Veach & Guibas 1995, balance heuristic) of the cosine and of
//! visible-normal GGX lobes from nearly mirror-like to wide, so that materials of
//! any gloss are integrated by the same directions.

use glam::DVec3;

use super::atom::cosine_direction;
use super::ggx::{self, Cosines};

/// Widths of the lobes, from the narrowest of any dictionary up.
pub const LOBE_ALPHAS: [f64; 4] = [0.01, 0.03, 0.1, 0.3];

/// Techniques of the mixture: the cosine and the lobes.
pub const TECHNIQUES: usize = 1 + LOBE_ALPHAS.len();

/// Number and order of points in a low-discrepancy set: point `k` of `n` in [0, 1)²,
/// shifted on the torus (Hammersley, radical inverse in base 2).
pub fn point(k: u32, n: u32, shift: [f64; 2]) -> [f64; 2] {
    let radical = f64::from(k.reverse_bits()) * 2f64.powi(-32);
    let wrapped = |x: f64| (x + 1e-12).rem_euclid(1.0).min(1.0 - 1e-12);
    [
        wrapped(radical + shift[0]),
        wrapped((f64::from(k) + 0.5) / f64::from(n) + shift[1]),
    ]
}

/// Density of the mixture per solid angle (1/sr, cosine excluded) at `to`, given
/// `from`, both unit and above the horizon.
pub fn density(from: DVec3, to: DVec3) -> f64 {
    let Some(at) = Cosines::new(from.to_array(), to.to_array()) else {
        return 0.0;
    };
    let lobes: f64 = LOBE_ALPHAS
        .iter()
        .map(|&alpha| ggx::pdf_visible(alpha, at.cos_i, at.sin2_h))
        .sum();
    (at.cos_o * std::f64::consts::FRAC_1_PI + lobes) / TECHNIQUES as f64
}

/// `per_technique` directions of each technique; those below the horizon are
/// left out (their weight is not lost: the others estimate the integral
/// without them).
pub fn directions(from: DVec3, per_technique: u32, shift: [f64; 2]) -> impl Iterator<Item = DVec3> {
    (0..TECHNIQUES)
        .flat_map(move |technique| {
            (0..per_technique).map(move |k| {
                let u = point(k, per_technique, shift);
                match technique {
                    0 => cosine_direction(u),
                    lobe => DVec3::from_array(ggx::sample_visible(
                        LOBE_ALPHAS[lobe - 1],
                        from.to_array(),
                        u,
                    )),
                }
            })
        })
        .filter(|to| to.z > 0.0)
}

/// Directions with weights: ∫ g(ω) dω over the hemisphere ≈ Σ weight·g(direction).
pub fn nodes(
    from: DVec3,
    per_technique: u32,
    shift: [f64; 2],
) -> impl Iterator<Item = (DVec3, f64)> {
    let count = f64::from(per_technique) * TECHNIQUES as f64;
    directions(from, per_technique, shift).map(move |to| (to, 1.0 / (count * density(from, to))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::brdf::dictionary::{Atom, Dictionary};

    #[test]
    fn integrates_cosine_and_narrow_lobes() {
        for theta in [0.0f64, 0.7, 1.3] {
            let from = DVec3::new(theta.sin(), 0.0, theta.cos());
            let cosine: f64 = nodes(from, 256, [0.3, 0.7]).map(|(to, w)| w * to.z).sum();
            assert!(
                (cosine / std::f64::consts::PI - 1.0).abs() < 0.01,
                "{theta}: {cosine}"
            );
            // Against a far larger set of the same rule.
            for atom in Dictionary::paper42().atoms() {
                let Atom::Ggx { .. } = atom else { continue };
                let albedo = |n| -> f64 {
                    nodes(from, n, [0.3, 0.7])
                        .filter_map(|(to, w)| {
                            let at = Cosines::new(from.to_array(), to.to_array())?;
                            Some(w * to.z * atom.eval(&at))
                        })
                        .sum()
                };
                let (few, many) = (albedo(128), albedo(2048));
                assert!(
                    (few - many).abs() < 0.03 * many,
                    "{atom:?} {theta}: {few} {many}"
                );
            }
        }
    }
}
