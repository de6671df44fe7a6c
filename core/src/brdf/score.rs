//! How far an estimate is from the truth, defined once.
//!
//! *Environment error*: spheres under the four maps ([`super::sphere`]), linear
//! RGB; per map ‖a − b‖₂ / ‖b‖₂ over the sphere's pixels and channels, then the
//! mean over the maps.
//!
//! *BRDF error*: ‖cos θi·(f − f̂)‖ / ‖cos θi·f‖ over cells and channels, the
//! squares weighted by the cells' solid angle; *cube-root error*: the weighted mean of
//! |∛a − ∛b| over the weighted mean of ∛b with a = cos θi·f̂, b = cos θi·f. Cells are
//! MERL's with θd ≤ 80° and both cosines above 0.02, taken at their middle.

use glam::Vec3;
use rayon::prelude::*;

use super::Brdf;
use super::environment::EnvironmentMap;
use super::half_difference::HalfDifference;
use super::sphere::{SphereImage, normals, sphere_images};
use super::table::{MERL_SHAPE, node};

/// Pixels per side of the spheres of an environment error where nobody asks for another. Twice as
/// many take four times as long and change the error by at most a twentieth of itself.
pub const SPHERE_SIZE: usize = 64;

/// A figure for all channels together and for each.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct PerChannel {
    /// Over all channels.
    pub all: f64,
    /// R, G, B alone.
    pub channels: [f64; 3],
}

/// The environment error, and the maps it is the mean of.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct EnvironmentError {
    /// Mean over the maps.
    pub mean: PerChannel,
    /// Map name and error over all channels.
    pub maps: Vec<(String, f64)>,
}

/// Relative difference of two sphere images of one size, ‖a − b‖₂ / ‖b‖₂.
pub fn image_error(a: &SphereImage, b: &SphereImage) -> PerChannel {
    let mut difference = [0.0f64; 3];
    let mut reference = [0.0f64; 3];
    for (pixel, _) in normals(b.size) {
        for c in 0..3 {
            let (a, b) = (
                f64::from(a.radiance[pixel][c]),
                f64::from(b.radiance[pixel][c]),
            );
            difference[c] += (a - b) * (a - b);
            reference[c] += b * b;
        }
    }
    relative(difference, reference)
}

fn relative(difference: [f64; 3], reference: [f64; 3]) -> PerChannel {
    PerChannel {
        all: (difference.iter().sum::<f64>() / reference.iter().sum::<f64>()).sqrt(),
        channels: [0, 1, 2].map(|c| (difference[c] / reference[c]).sqrt()),
    }
}

/// Environment error of `estimate` against `truth`; at [`SPHERE_SIZE`] pixels for figures
/// that are compared.
///
/// ```
/// use rig_core::brdf::environment::EnvironmentMap;
/// use rig_core::brdf::{score, source};
///
/// let maps = [EnvironmentMap::embedded("city").expect("one of NAMES")];
/// let [truth, darker] = ["lambertian:0.5", "lambertian:0.4"].map(source::load);
/// let error = score::environment_error(darker?.as_ref(), truth?.as_ref(), &maps, 8);
/// // A fifth less light everywhere.
/// assert!((error.mean.all - 0.2).abs() < 1e-3);
/// # Ok::<(), rig_core::brdf::BrdfError>(())
/// ```
pub fn environment_error(
    estimate: &dyn Brdf,
    truth: &dyn Brdf,
    maps: &[EnvironmentMap],
    size: usize,
) -> EnvironmentError {
    let images = sphere_images(&[estimate, truth], maps, size);
    let errors: Vec<PerChannel> = images
        .iter()
        .map(|under| image_error(&under[0], &under[1]))
        .collect();
    summarise(maps, &errors)
}

/// The environment error of what differs by more than a common factor.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct UpToFactor {
    /// Least environment error of any multiple of the estimate.
    pub error: f64,
    /// The estimate's brightness over that multiple's.
    pub factor: f64,
}

/// Environment error of `estimate`, times the factor that makes it least.
pub fn environment_error_up_to_factor(
    estimate: &dyn Brdf,
    truth: &dyn Brdf,
    maps: &[EnvironmentMap],
    size: usize,
) -> UpToFactor {
    // ‖a‖², a·b and ‖b‖² under each map.
    let products: Vec<[f64; 3]> = sphere_images(&[estimate, truth], maps, size)
        .iter()
        .map(|under| {
            let (a, b) = (&under[0], &under[1]);
            let mut sums = [0.0; 3];
            for (pixel, _) in normals(size) {
                for (a, b) in a.radiance[pixel].iter().zip(b.radiance[pixel]) {
                    let (a, b) = (f64::from(*a), f64::from(b));
                    let products = [a * a, a * b, b * b];
                    sums.iter_mut().zip(products).for_each(|(s, p)| *s += p);
                }
            }
            sums
        })
        .collect();
    let errors = |scale: f64| {
        let square = move |&[aa, ab, bb]: &[f64; 3]| (scale * scale * aa - 2.0 * scale * ab) / bb;
        products
            .iter()
            .map(move |p| (square(p) + 1.0).max(0.0).sqrt())
    };
    // A mean of norms, by reweighted least squares; convex in the scale.
    let mut scale = 1.0;
    for _ in 0..40 {
        let [mut along, mut length] = [0.0; 2];
        for ([aa, ab, bb], error) in products.iter().zip(errors(scale)) {
            let weight = 1.0 / (bb * error.max(1e-9));
            along += weight * ab;
            length += weight * aa;
        }
        if length > 0.0 {
            scale = along / length;
        }
    }
    UpToFactor {
        error: errors(scale).sum::<f64>() / maps.len().max(1) as f64,
        factor: 1.0 / scale,
    }
}

/// The environment error from the errors under each map.
pub fn summarise(maps: &[EnvironmentMap], errors: &[PerChannel]) -> EnvironmentError {
    let mean = |of: &dyn Fn(&PerChannel) -> f64| {
        errors.iter().map(of).sum::<f64>() / errors.len().max(1) as f64
    };
    EnvironmentError {
        mean: PerChannel {
            all: mean(&|e| e.all),
            channels: [0, 1, 2].map(|c| mean(&|e| e.channels[c])),
        },
        maps: maps
            .iter()
            .zip(errors)
            .map(|(map, error)| (map.name().to_owned(), error.all))
            .collect(),
    }
}

/// One cell of the BRDF error.
#[derive(Clone, Copy, Debug)]
pub struct Cell {
    /// At the middle of the cell, local frame.
    pub to_light: Vec3,
    /// At the middle of the cell, local frame.
    pub to_viewer: Vec3,
    /// Solid angle of the half vector's cell times that of the difference vector's, sr².
    pub solid_angle: f32,
}

/// The cells of the BRDF error; `n_phi` is MERL's 180, or fewer (a divisor) for
/// fits, which need the azimuth less finely.
pub fn cells(n_phi: usize) -> Vec<Cell> {
    let [n_h, n_d, _] = MERL_SHAPE;
    let shape = [n_h, n_d, n_phi];
    let mut cells = Vec::new();
    for i in 0..n_h {
        for j in 0..n_d * 80 / 90 {
            let (low, high) = (node(shape, [i, j, 0]), node(shape, [i + 1, j + 1, 1]));
            let band = |a: f64, b: f64| a.cos() - b.cos();
            let width = high.phi_d_rad - low.phi_d_rad;
            let solid_angle = band(low.theta_h_rad, high.theta_h_rad)
                * band(low.theta_d_rad, high.theta_d_rad)
                * width
                * std::f64::consts::TAU;
            for k in 0..n_phi {
                let middle = HalfDifference {
                    theta_h_rad: std::f64::consts::FRAC_PI_2
                        * ((i as f64 + 0.5) / n_h as f64).powi(2),
                    theta_d_rad: 0.5 * (low.theta_d_rad + high.theta_d_rad),
                    phi_d_rad: width * (k as f64 + 0.5),
                };
                let (i, o) = middle.to_directions();
                if i.z > 0.02 && o.z > 0.02 {
                    cells.push(Cell {
                        to_light: i.as_vec3(),
                        to_viewer: o.as_vec3(),
                        solid_angle: solid_angle as f32,
                    });
                }
            }
        }
    }
    cells
}

/// cos θi·f of R, G, B at every cell, 1/sr.
pub fn cosine_weighted(brdf: &dyn Brdf, cells: &[Cell]) -> Vec<[f32; 3]> {
    cells
        .par_iter()
        .map(|cell| {
            brdf.eval(cell.to_light, cell.to_viewer)
                .map(|f| f * cell.to_light.z)
        })
        .collect()
}

/// Both BRDF errors.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct BrdfErrors {
    /// ‖cos θi·(f − f̂)‖ / ‖cos θi·f‖.
    pub relative: PerChannel,
    /// Mean |∛a − ∛b| over mean ∛b.
    pub cube_root: PerChannel,
}

/// Errors of `estimate` against `truth` over `cells`.
///
/// ```
/// use rig_core::brdf::{score, source};
///
/// let [truth, darker] = ["lambertian:0.5", "lambertian:0.4"].map(source::load);
/// let cells = score::cells(3);
/// let errors = score::brdf_errors(darker?.as_ref(), truth?.as_ref(), &cells);
/// assert!((errors.relative.all - 0.2).abs() < 1e-5);
/// # Ok::<(), rig_core::brdf::BrdfError>(())
/// ```
pub fn brdf_errors(estimate: &dyn Brdf, truth: &dyn Brdf, cells: &[Cell]) -> BrdfErrors {
    errors_of_values(
        &cosine_weighted(estimate, cells),
        &cosine_weighted(truth, cells),
        cells,
    )
}

/// [`brdf_errors`] from [`cosine_weighted`] values.
pub fn errors_of_values(a: &[[f32; 3]], b: &[[f32; 3]], cells: &[Cell]) -> BrdfErrors {
    let (mut difference, mut reference) = ([0.0f64; 3], [0.0f64; 3]);
    let (mut root_difference, mut root_reference) = ([0.0f64; 3], [0.0f64; 3]);
    for ((a, b), cell) in a.iter().zip(b).zip(cells) {
        let weight = f64::from(cell.solid_angle);
        for c in 0..3 {
            let (a, b) = (f64::from(a[c]), f64::from(b[c]));
            difference[c] += weight * (a - b) * (a - b);
            reference[c] += weight * b * b;
            root_difference[c] += weight * (a.cbrt() - b.cbrt()).abs();
            root_reference[c] += weight * b.cbrt();
        }
    }
    BrdfErrors {
        relative: relative(difference, reference),
        cube_root: PerChannel {
            all: root_difference.iter().sum::<f64>() / root_reference.iter().sum::<f64>(),
            channels: [0, 1, 2].map(|c| root_difference[c] / root_reference[c]),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::brdf::dictionary::{Atom, Dictionary};
    use crate::brdf::mixture::Mixture;
    use std::sync::Arc;

    fn grey(albedo: f64) -> Mixture {
        let dictionary = Dictionary::new("grey", vec![Atom::Lambertian { albedo }]).unwrap();
        Mixture::grey(Arc::new(dictionary), vec![1.0]).unwrap()
    }

    #[test]
    fn scaling_a_brdf_gives_the_expected_errors() {
        let (truth, estimate) = (grey(0.5), grey(0.4));
        let errors = brdf_errors(&estimate, &truth, &cells(6));
        assert!((errors.relative.all - 0.2).abs() < 1e-5);
        assert!((errors.cube_root.all - (1.0 - 0.8f64.cbrt())).abs() < 1e-5);
        let maps = [EnvironmentMap::embedded("studio").unwrap()];
        let error = environment_error(&estimate, &truth, &maps, 8);
        assert!((error.mean.all - 0.2).abs() < 1e-5);
        assert!(error.mean.channels.iter().all(|e| (e - 0.2).abs() < 1e-5));
        assert_eq!(brdf_errors(&truth, &truth, &cells(6)).relative.all, 0.0);
        let shape = environment_error_up_to_factor(&estimate, &truth, &maps, 8);
        assert!(shape.error < 1e-3, "{}", shape.error);
        assert!((shape.factor - 0.8).abs() < 1e-5, "{}", shape.factor);
    }

    /// That multiple has the error that is said, and no other is nearer.
    #[test]
    fn the_factor_makes_the_error_least() {
        let atoms = vec![
            Atom::Ggx {
                alpha: 0.2,
                eta: 1.5,
            },
            Atom::Lambertian { albedo: 1.0 },
            Atom::Black,
        ];
        let dictionary = Arc::new(Dictionary::new("three", atoms).unwrap());
        let mixture = |[lobe, white]: [f64; 2]| {
            let weights = vec![lobe, white, 1.0 - lobe - white];
            Mixture::grey(dictionary.clone(), weights).unwrap()
        };
        let (truth, estimate) = (mixture([0.3, 0.2]), mixture([0.35, 0.15]));
        let maps = EnvironmentMap::all();
        let least = environment_error_up_to_factor(&estimate, &truth, &maps, 8);
        let of = |factor: f64| {
            let scaled = mixture([0.35, 0.15].map(|weight| weight / factor));
            environment_error(&scaled, &truth, &maps, 8).mean.all
        };
        println!("{least:?}, as it is {}", of(1.0));
        assert!((of(least.factor) - least.error).abs() < 1e-5);
        for other in [0.97, 0.99, 1.01, 1.03] {
            assert!(of(other * least.factor) > least.error, "{other}");
        }
    }

    #[test]
    fn cells_are_merls_and_their_solid_angles_add_up() {
        let all = cells(180);
        assert!(all.len() > 600_000 && all.len() < 90 * 80 * 180);
        let coarse: f64 = cells(36).iter().map(|c| f64::from(c.solid_angle)).sum();
        let fine: f64 = all.iter().map(|c| f64::from(c.solid_angle)).sum();
        assert!((coarse / fine - 1.0).abs() < 2e-3, "{coarse} {fine}");
        // Without the horizon: 2π of half vectors × π(1 − cos 80°) of difference vectors.
        assert!(fine < std::f64::consts::TAU * std::f64::consts::PI * 0.8264);
    }
}
