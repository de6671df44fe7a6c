//! How the environment error answers small changes of a material.
//!
//! Around a material, ln f + g makes of a sphere's image b the image b + B g, linear in the values g of a
//! [`Discrepancy`]. The mean over the maps of ‖B g‖²/‖b‖² is gᵀ E g: E is half the second
//! derivative of the squared environment error by ln f, and √tr(E C) the error to expect of a
//! material that is known up to the covariance C.

use nalgebra::DMatrix;
use rayon::prelude::*;

use super::discrepancy::{Discrepancy, NODES, Place, VALUES, nodes};
use super::environment::EnvironmentMap;
use super::sphere::{incident, normals};

/// Channel of the maps' light: green.
const CHANNEL: usize = 1;

/// E of a material of one channel.
pub struct ErrorCurvature {
    /// B/‖b‖ of all maps over the square root of their number, pixels × [`VALUES`]: E is its Gram
    /// matrix.
    rows: DMatrix<f64>,
}

impl ErrorCurvature {
    /// Of f = e^`ln_f`, up to a factor that is the same for all angles, on spheres of `size` ×
    /// `size` pixels in green light.
    pub fn new(ln_f: &Discrepancy, maps: &[EnvironmentMap], size: usize) -> Self {
        let points = normals(size);
        // Per map and pixel, the light by value of the table; that of g₀ adds up to the image.
        let by_pixel: Vec<Vec<f64>> = points
            .par_iter()
            .map(|&(pixel, normal)| {
                let mut sums = vec![0.0; maps.len() * VALUES];
                incident(maps, pixel, normal, |light, arriving| {
                    let place = Place::of(light.to_light, light.to_viewer);
                    let cos_2phi = place.cos_2phi;
                    for (node, share) in place.around {
                        let f = f64::from(share) * ln_f.at(node, cos_2phi).exp();
                        for from in arriving {
                            let value = f * f64::from(from.irradiance[CHANNEL]);
                            sums[from.map * VALUES + node] += value;
                            sums[from.map * VALUES + NODES + node] += value * f64::from(cos_2phi);
                        }
                    }
                });
                sums
            })
            .collect();
        let of = |map: usize, pixel: usize| &by_pixel[pixel][map * VALUES..(map + 1) * VALUES];
        let image = |map: usize, pixel: usize| of(map, pixel)[..NODES].iter().sum::<f64>();
        let scales: Vec<f64> = (0..maps.len())
            .map(|map| {
                let squares = (0..points.len()).map(|pixel| image(map, pixel).powi(2));
                1.0 / (maps.len() as f64 * squares.sum::<f64>()).sqrt()
            })
            .collect();
        let rows = DMatrix::from_fn(maps.len() * points.len(), VALUES, |row, value| {
            let (map, pixel) = (row / points.len(), row % points.len());
            scales[map] * of(map, pixel)[value]
        });
        Self { rows }
    }

    /// Of changes along `modes`, whose rows are the table's values, at difference angles in
    /// `theta_d_deg` alone.
    pub fn along(&self, modes: &DMatrix<f64>, theta_d_deg: std::ops::Range<f64>) -> DMatrix<f64> {
        let mut modes = modes.clone();
        for (k, node) in nodes().enumerate() {
            if !theta_d_deg.contains(&node.theta_d_deg) {
                modes.row_mut(k).fill(0.0);
                modes.row_mut(NODES + k).fill(0.0);
            }
        }
        let images = &self.rows * modes;
        images.tr_mul(&images)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::brdf::discrepancy::{Material, Prior};
    use crate::brdf::nbrdf::NeuralBrdf;
    use crate::brdf::score::environment_error;
    use crate::brdf::{Atom, Dictionary, Mixture};

    /// The error that the score finds of a material that differs a little, against the second
    /// derivative, along three modes of what materials differ by.
    #[test]
    fn small_changes_have_the_error_that_the_curvature_says() {
        let measured = NeuralBrdf::named("red-plastic").unwrap();
        let [_, ln_f, _] =
            Discrepancy::closest(|at| measured.at(at).map(|f| f64::from(f + 1e-5).ln()));
        let white = Dictionary::new("white", vec![Atom::Lambertian { albedo: 1.0 }]).unwrap();
        let white = Mixture::grey(Arc::new(white), vec![1.0]).unwrap();
        let material = |g: Discrepancy| Material::new(white.clone(), &[g]);
        let (maps, size) = (EnvironmentMap::all(), 8);
        let curvature = ErrorCurvature::new(&ln_f, &maps, size);
        let prior = Prior::without(&[]);
        for mode in [0, 1, 7] {
            let step = prior.modes().column(mode) * 1e-3;
            let changed = material(Discrepancy(&ln_f.0 + &step));
            let errors = environment_error(&changed, &material(ln_f.clone()), &maps[..1], size);
            let found = errors.mean.channels[CHANNEL];
            let step = DMatrix::from_columns(&[step]);
            let one = ErrorCurvature::new(&ln_f, &maps[..1], size);
            let expected = one.along(&step, 0.0..90.0)[(0, 0)].sqrt();
            assert!(
                (found / expected - 1.0).abs() < 0.01,
                "{mode}: {found} {expected}"
            );
            // Of several maps the mean of the squares; of bands what they add up to or less.
            let each = maps.iter().map(|map| {
                let map = std::slice::from_ref(map);
                ErrorCurvature::new(&ln_f, map, size).along(&step, 0.0..90.0)[(0, 0)]
            });
            let mean = each.sum::<f64>() / maps.len() as f64;
            let all = curvature.along(&step, 0.0..90.0)[(0, 0)];
            assert!((all / mean - 1.0).abs() < 1e-9, "{mode}");
            let bands = [0.0..42.0, 42.0..90.0].map(|band| curvature.along(&step, band)[(0, 0)]);
            assert!(all.sqrt() <= bands.iter().map(|b| b.sqrt()).sum::<f64>() + 1e-12);
        }
    }
}
