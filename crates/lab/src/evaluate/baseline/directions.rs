//! Where to measure: single pairs of directions, and images of a sphere.
//!
//! Both are chosen over the training materials alone. Pairs have the least condition number of
//! the scaled components' rows; the authors descend along the gradient from random starts, here
//! pairs are exchanged, one at a time, on a coarse grid, which ends at a local optimum as well.
//! The lights of spheres have the least expected error of the ridge regression.

use std::f64::consts::FRAC_PI_2;

use glam::{DVec3, Vec3};
use nalgebra::DMatrix;

use super::components::Components;
use crate::brdf::HalfDifference;
use crate::random::{Purpose, stream};

/// Least cosine of either direction: 80°.
pub const LEAST_COSINE: f32 = 0.173_648;
/// Angles of the candidates: θh in equal steps of its square root, θd and φd evenly.
const CANDIDATES: [usize; 3] = [18, 9, 6];
/// Random starts of an exchange.
const STARTS: u64 = 3;
/// Rounds of an exchange, in each of which every pair may change.
const ROUNDS: usize = 12;
/// Pixels across a sphere when its light is chosen.
const CHOICE_PX: usize = 24;
/// Step and largest angle between light and camera that is tried, degrees.
const LIGHT_STEP_DEG: usize = 5;
/// See [`LIGHT_STEP_DEG`].
const LARGEST_LIGHT_DEG: usize = 120;

/// A pair (to light, to viewer) in the surface's frame, unit.
pub type Pair = (Vec3, Vec3);

/// Pairs with the condition number that chose them.
pub struct Choice {
    /// What was chosen.
    pub chosen: Vec<Pair>,
    /// Largest over smallest singular value.
    pub condition_number: f64,
}

/// All candidates: pairs on a coarse grid of (θh, θd, φd), both directions within 80° of the
/// normal.
pub fn candidates() -> Vec<Pair> {
    let [n_h, n_d, n_phi] = CANDIDATES;
    let mut pairs = Vec::new();
    for i in 0..n_h {
        for j in 0..n_d {
            for k in 0..n_phi {
                let angles = HalfDifference {
                    theta_h_rad: FRAC_PI_2 * (i as f64 / n_h as f64).powi(2),
                    theta_d_rad: FRAC_PI_2 * j as f64 / n_d as f64,
                    phi_d_rad: std::f64::consts::PI * k as f64 / n_phi as f64,
                };
                let (i, o) = angles.to_directions();
                let (i, o) = (i.as_vec3(), o.as_vec3());
                if i.z > LEAST_COSINE && o.z > LEAST_COSINE {
                    pairs.push((i, o));
                }
            }
        }
    }
    pairs
}

/// Largest over smallest singular value of a matrix with at least as many rows as columns.
fn condition_number(gram: DMatrix<f64>) -> f64 {
    let squares = gram.symmetric_eigenvalues();
    (squares.max() / squares.min().max(f64::MIN_POSITIVE)).sqrt()
}

/// The `count` best pairs, whose `count` × `count` matrix of the first components has the
/// least condition number. That of a single pair is 1 for any; it is the pair where the
/// first component is largest.
pub fn best_pairs(components: &Components<'_>, count: usize, seed: u64) -> Choice {
    let pairs = candidates();
    let scaled = components.rows(&pairs).scaled;
    if count == 1 {
        let best = scaled.column(0).iamax();
        return Choice {
            chosen: vec![pairs[best]],
            condition_number: 1.0,
        };
    }
    let width = components.fitted(count);
    let scaled = scaled.columns(0, width).into_owned();
    let number = |chosen: &[usize]| {
        let rows = scaled.select_rows(chosen);
        condition_number(rows.tr_mul(&rows))
    };
    let mut best: (f64, Vec<usize>) = (f64::INFINITY, Vec::new());
    for start in 0..STARTS {
        let mut numbers = stream(seed, Purpose::Experiment, 1, count as u64, start);
        let mut chosen: Vec<usize> = (0..count)
            .map(|_| (numbers.uniform() * pairs.len() as f64) as usize)
            .collect();
        let mut least = number(&chosen);
        for _ in 0..ROUNDS {
            let before = least;
            for position in 0..count {
                for candidate in 0..pairs.len() {
                    let old = std::mem::replace(&mut chosen[position], candidate);
                    let now = number(&chosen);
                    if now < least {
                        least = now;
                    } else {
                        chosen[position] = old;
                    }
                }
            }
            if least > 0.999 * before {
                break;
            }
        }
        if least < best.0 {
            best = (least, chosen);
        }
    }
    Choice {
        chosen: best.1.into_iter().map(|k| pairs[k]).collect(),
        condition_number: best.0,
    }
}

/// The pairs of all pixels of a sphere that fills an orthographic image of `size` × `size`
/// pixels, lit from far away at an angle from the camera, as far as both directions are within
/// 80° of the normal. Nothing is reflected twice.
pub fn sphere_pairs(size: usize, light_deg: f64) -> Vec<Pair> {
    let to_camera = DVec3::Z;
    let (sin, cos) = light_deg.to_radians().sin_cos();
    let to_light = DVec3::new(sin, 0.0, cos);
    let across = |pixel: usize| 2.0 * (pixel as f64 + 0.5) / size as f64 - 1.0;
    let mut pairs = Vec::new();
    for pixel in 0..size * size {
        let (x, y) = (across(pixel % size), across(pixel / size));
        let square = 1.0 - x * x - y * y;
        if square <= 0.0 {
            continue;
        }
        let normal = DVec3::new(x, y, square.sqrt());
        let (tangent, bitangent) = normal.any_orthonormal_pair();
        let local = |d: DVec3| DVec3::new(d.dot(tangent), d.dot(bitangent), d.dot(normal));
        let (i, o) = (local(to_light).as_vec3(), local(to_camera).as_vec3());
        if i.z > LEAST_COSINE && o.z > LEAST_COSINE {
            pairs.push((i, o));
        }
    }
    pairs
}

/// Lights of sphere images with the expected error that chose them.
pub struct Lights {
    /// Angles between light and camera, degrees.
    pub angles_deg: Vec<f64>,
    /// Mean square of the error of mapped values that the ridge expects over the training's
    /// grid, relative to that without a measurement.
    pub expected_error: f64,
}

/// The best one or two images of a sphere, of all angles up to 120° between light and camera.
/// A condition number would ignore how many pixels are lit and prefers thin crescents, so the
/// error that the ridge itself expects decides: the trace of Σ² (QᵀQ + ridge)⁻¹ over that
/// without a measurement.
pub fn best_lights(components: &Components<'_>, images: usize, ridge: f64) -> Lights {
    let angles: Vec<f64> = (0..=LARGEST_LIGHT_DEG)
        .step_by(LIGHT_STEP_DEG)
        .map(|deg| deg as f64)
        .collect();
    let grams: Vec<DMatrix<f64>> = angles
        .iter()
        .map(|&angle| {
            let rows = components.rows(&sphere_pairs(CHOICE_PX, angle)).scaled;
            rows.tr_mul(&rows)
        })
        .collect();
    let squares = components.squares();
    let expected = |mut gram: DMatrix<f64>| {
        gram.iter_mut()
            .step_by(squares.len() + 1)
            .for_each(|diagonal| *diagonal += ridge);
        let inverse = gram.cholesky().map(|factor| factor.inverse().diagonal());
        inverse.map_or(f64::INFINITY, |variances| {
            ridge * variances.dot(squares) / squares.sum()
        })
    };
    let mut best = Lights {
        angles_deg: Vec::new(),
        expected_error: f64::INFINITY,
    };
    for first in 0..angles.len() {
        let others = match images {
            1 => first..first + 1,
            _ => first + 1..angles.len(),
        };
        for second in others {
            let expected_error = expected(match images {
                1 => grams[first].clone(),
                _ => &grams[first] + &grams[second],
            });
            if expected_error < best.expected_error {
                let chosen = &[first, second][..images.min(2)];
                best = Lights {
                    angles_deg: chosen.iter().map(|&k| angles[k]).collect(),
                    expected_error,
                };
            }
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::super::components::Training;
    use super::*;

    #[test]
    fn a_sphere_shows_its_half_angles() {
        // Coaxial light: both directions are one, and every pixel has θd = 0.
        let coaxial = sphere_pairs(32, 0.0);
        assert!(coaxial.len() > 700 && coaxial.iter().all(|(i, o)| (*i - *o).length() < 1e-6));
        // The angle between the directions is that between light and camera.
        let oblique = sphere_pairs(32, 60.0);
        assert!(oblique.len() < coaxial.len() && !oblique.is_empty());
        for (i, o) in oblique {
            assert!((i.dot(o) - 0.5).abs() < 1e-5 && i.z.min(o.z) > LEAST_COSINE);
        }
    }

    #[test]
    fn chosen_pairs_are_conditioned_far_better_than_random_ones() {
        let training = Training::embedded([20, 15, 4]);
        let components = training.without("pvc");
        let choice = best_pairs(&components, 4, 1);
        let rows = components.rows(&choice.chosen).scaled;
        let rows = rows.columns(0, 4).into_owned();
        // The number is that of the rows, here by another decomposition.
        let singular = rows.singular_values();
        let direct = singular.max() / singular.min();
        assert!((choice.condition_number / direct - 1.0).abs() < 1e-6);
        let all = candidates();
        let mut numbers = stream(3, Purpose::Experiment, 0, 0, 0);
        let mut random: Vec<f64> = (0..51)
            .map(|_| {
                let pick = |_| all[(numbers.uniform() * all.len() as f64) as usize];
                let pairs: Vec<Pair> = (0..4).map(pick).collect();
                let rows = components.rows(&pairs).scaled;
                let singular = rows.columns(0, 4).into_owned().singular_values();
                singular.max() / singular.min()
            })
            .collect();
        random.sort_by(f64::total_cmp);
        assert!(
            choice.condition_number < 0.2 * random[25],
            "{direct} {random:?}"
        );
    }

    #[test]
    fn two_images_leave_less_error_than_one() {
        let training = Training::embedded([20, 15, 4]);
        let components = training.without("pvc");
        let [one, two] = [1, 2].map(|images| best_lights(&components, images, 10.0));
        assert_eq!((one.angles_deg.len(), two.angles_deg.len()), (1, 2));
        assert!(0.0 < two.expected_error && two.expected_error < one.expected_error);
        assert!(one.expected_error < 1.0);
        // A ridge without bounds learns nothing from an image.
        let nothing = best_lights(&components, 1, 1e12).expected_error;
        assert!((nothing - 1.0).abs() < 1e-3, "{nothing}");
    }
}
