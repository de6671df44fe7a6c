//! Form error: how far an as-made surface deviates from its mesh, and random surfaces that do.
//!
//! The deviation is a smooth random field u(p) with independent Gaussian components and
//! the autocorrelation exp(−r²/2ℓ²). Its height above the mesh then has the rms of one
//! component, and its slope the rms √2 times that over ℓ: the two figures that a
//! certificate or a comparison with a better scan gives determine the field
//! (docs/adr/0029). It is a function of position alone, so no crack opens where corners are
//! stored twice, and along the surface it moves nothing but creases.

use std::f64::consts::{SQRT_2, TAU};

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use super::Mesh;
use crate::random::Stream;

/// Rms deviation of a surface from its mesh.
///
/// ```
/// use rig_core::geometry::FormError;
///
/// // 10 µm of height, 1° of slope: the surface changes over a few tenths of a millimetre.
/// let turned = FormError::new(0.01, 1f64.to_radians()).expect("both above 0");
/// assert!((0.3..2.0).contains(&turned.correlation_mm()));
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FormError {
    height_mm: f64,
    slope_rad: f64,
}

/// Cosine waves per component of a field; many enough to be nearly Gaussian.
const WAVES: usize = 48;

impl FormError {
    /// From the rms height along the normal, mm, and the rms angle between the true
    /// normal and the mesh's, radians; `None` unless both are finite and above 0.
    pub fn new(height_mm: f64, slope_rad: f64) -> Option<Self> {
        let usable = |v: f64| v.is_finite() && v > 0.0;
        (usable(height_mm) && usable(slope_rad)).then_some(Self {
            height_mm,
            slope_rad,
        })
    }

    /// Rms height along the normal, mm.
    pub fn height_mm(&self) -> f64 {
        self.height_mm
    }

    /// Rms angle of the normal, radians.
    pub fn slope_rad(&self) -> f64 {
        self.slope_rad
    }

    /// Length ℓ over which the deviation stays alike (correlation length), mm.
    pub fn correlation_mm(&self) -> f64 {
        SQRT_2 * self.height_mm / self.slope_rad
    }

    /// A random deviation of a surface whose triangles have edges of `edge_mm`: a field
    /// that changes over less cannot be held by them, so ℓ is at least that long and the
    /// slope, which counts more, is kept.
    pub fn field(&self, edge_mm: f64, numbers: &mut Stream) -> FormField {
        let length_mm = self.correlation_mm().max(edge_mm);
        let rms_mm = self.slope_rad * length_mm / SQRT_2;
        let amplitude = rms_mm * (2.0 / WAVES as f64).sqrt();
        let mut wave = || Wave {
            per_mm: DVec3::from_array(std::array::from_fn(|_| numbers.normal())) / length_mm,
            phase: TAU * numbers.uniform(),
        };
        FormField {
            amplitude,
            components: std::array::from_fn(|_| (0..WAVES).map(|_| wave()).collect()),
        }
    }
}

/// One random deviation.
pub struct FormField {
    amplitude: f64,
    components: [Vec<Wave>; 3],
}

struct Wave {
    per_mm: DVec3,
    phase: f64,
}

impl FormField {
    /// The displacement at a position, mm, and its gradient (columns: by x, y and z).
    pub fn at(&self, position_mm: DVec3) -> (DVec3, DMat3) {
        let mut value = [0.0; 3];
        let mut gradient = [DVec3::ZERO; 3];
        for ((value, gradient), waves) in value.iter_mut().zip(&mut gradient).zip(&self.components)
        {
            for wave in waves {
                let (sin, cos) = (wave.per_mm.dot(position_mm) + wave.phase).sin_cos();
                *value += self.amplitude * cos;
                *gradient -= self.amplitude * sin * wave.per_mm;
            }
        }
        let [x, y, z] = gradient;
        let rows = DMat3::from_cols(x, y, z);
        (DVec3::from_array(value), rows.transpose())
    }

    /// The mesh with `factor` times the displacement.
    pub fn deform(&self, mesh: &Mesh, factor: f64) -> Mesh {
        let moved = mesh.positions_mm.par_iter().enumerate().map(|(k, p)| {
            let (displacement, gradient) = self.at(p.as_dvec3());
            let position = (p.as_dvec3() + factor * displacement).as_vec3();
            // Normals go by the inverse transpose of the map's derivative.
            let normal = mesh.normals.as_ref().map(|normals| {
                let stretch = DMat3::IDENTITY + factor * gradient;
                let normal = stretch.inverse().transpose() * normals[k].as_dvec3();
                normal.normalize_or(normals[k].as_dvec3()).as_vec3()
            });
            (position, normal)
        });
        let (positions_mm, normals): (Vec<_>, Vec<_>) = moved.unzip();
        Mesh {
            positions_mm,
            triangles: mesh.triangles.clone(),
            normals: normals.into_iter().collect(),
            remarks: mesh.remarks.clone(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, stream};
    use glam::Vec3;

    /// A flat square of 8 mm in steps of 0.1 mm.
    fn plane() -> Mesh {
        let n = 81u32;
        let at = |k: u32| (k as f32) * 0.1 - 4.0;
        let positions = (0..n * n)
            .map(|v| Vec3::new(at(v % n), at(v / n), 0.0))
            .collect();
        let triangles = (0..(n - 1) * (n - 1))
            .flat_map(|q| {
                let a = q / (n - 1) * n + q % (n - 1);
                [[a, a + 1, a + n], [a + 1, a + n + 1, a + n]]
            })
            .collect();
        Mesh::new(positions, triangles).unwrap()
    }

    /// Heights of corners and angles of facets have the stated rms over 24 fields; the
    /// facets know nothing of the gradient in the code.
    #[test]
    fn height_and_slope_are_as_stated() {
        let mesh = plane();
        let error = FormError::new(0.004, 0.012).unwrap();
        let (mut height, mut slope, fields) = (0.0, 0.0, 24);
        for k in 0..fields {
            let mut numbers = stream(5, Purpose::FormError, 0, k, 0);
            let moved = error.field(0.1, &mut numbers).deform(&mesh, 1.0);
            let square = moved.positions_mm.iter().map(|p| f64::from(p.z).powi(2));
            height += square.sum::<f64>() / moved.positions_mm.len() as f64;
            let angle = |t| f64::from(moved.face_normal(t).dot(Vec3::Z)).acos();
            let n = moved.triangles.len();
            slope += (0..n).map(|t| angle(t).powi(2)).sum::<f64>() / n as f64;
        }
        let height = (height / fields as f64).sqrt();
        let slope = (slope / fields as f64).sqrt();
        // Some 300 independent patches per field.
        assert!((height / 0.004 - 1.0).abs() < 0.05, "height {height}");
        assert!((slope / 0.012 - 1.0).abs() < 0.05, "slope {slope}");
    }

    /// Smooth normals turn as the facets around them do.
    #[test]
    fn normals_follow_the_surface() {
        let mut mesh = plane();
        mesh.normals = Some(vec![Vec3::Z; mesh.positions_mm.len()]);
        let error = FormError::new(0.02, 0.03).unwrap();
        let mut numbers = stream(6, Purpose::FormError, 0, 0, 0);
        let moved = error.field(0.1, &mut numbers).deform(&mesh, 1.0);
        let normals = moved.normals.as_ref().unwrap();
        let (mut apart, mut tilt) = (0.0f64, 0.0f64);
        for (t, corners) in moved.triangles.iter().enumerate() {
            let facet = moved.face_normal(t).as_dvec3();
            let mean: DVec3 = corners.map(|v| normals[v as usize].as_dvec3()).iter().sum();
            apart = apart.max(facet.cross(mean.normalize()).length());
            tilt = tilt.max(facet.cross(DVec3::Z).length());
        }
        assert!(tilt > 0.03, "tilt {tilt}");
        assert!(apart < 0.1 * tilt, "apart {apart}, tilt {tilt}");
    }

    /// Triangles too large for the field keep the slope.
    #[test]
    fn coarse_triangles_keep_the_slope() {
        let mesh = plane();
        let error = FormError::new(0.0005, 0.02).unwrap();
        assert!(error.correlation_mm() < 0.05);
        let mut slope = 0.0;
        for k in 0..4 {
            let mut numbers = stream(7, Purpose::FormError, 0, k, 0);
            let moved = error.field(0.1, &mut numbers).deform(&mesh, 1.0);
            let angle = |t| f64::from(moved.face_normal(t).dot(Vec3::Z)).acos();
            let n = moved.triangles.len();
            slope += (0..n).map(|t| angle(t).powi(2)).sum::<f64>() / n as f64 / 4.0;
        }
        let slope = slope.sqrt() / 0.02;
        assert!((0.7..1.05).contains(&slope), "{slope}");
    }

    #[test]
    fn only_positive_figures_make_a_form_error() {
        assert!(FormError::new(0.0, 0.1).is_none());
        assert!(FormError::new(0.1, 0.0).is_none());
        assert!(FormError::new(f64::NAN, 0.1).is_none());
        let error = FormError::new(0.02, 0.01).unwrap();
        assert!((error.correlation_mm() - 2.0 * SQRT_2).abs() < 1e-12);
    }
}
