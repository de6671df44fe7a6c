//! From highlights to a light: each is a ray mirrored at a sphere; the rays of one lamp
//! meet there.

use glam::{DVec2, DVec3};
use nalgebra::{DMatrix, DVector, Matrix2, Matrix2x3, Vector3};

use super::highlight::Highlight;
use super::{Sphere, SphereError, mm_per_px};
use crate::transport::Camera;

/// What is known of a lamp's distance from the point that its direction is stated for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Distance {
    /// Parallel light.
    Infinite,
    /// Known: millimetres and standard uncertainty.
    Stated(f64, f64),
    /// To be found; takes two spheres.
    Unknown,
}

/// A light as its highlights tell, sample frame.
#[derive(Clone, Debug, PartialEq)]
pub struct FoundLight {
    /// Unit vector from the reference point towards the light.
    pub to_light: DVec3,
    /// Inverse of its distance from there, 1/mm, and its standard uncertainty.
    pub inverse_distance: [f64; 2],
    /// Covariance of the direction along [`tangents`], rad², from this image alone.
    pub own: Matrix2<f64>,
    /// What the spheres' own uncertainty adds, rad: a column for each of three independent
    /// unit normals per sphere. Other lights of the same spheres share these numbers.
    pub shared: DMatrix<f64>,
    /// How far the rays of two spheres miss each other, in standard deviations.
    pub miss: f64,
}

impl FoundLight {
    /// Covariance of the direction along [`tangents`], rad².
    pub fn covariance(&self) -> Matrix2<f64> {
        let shared = &self.shared * self.shared.transpose();
        self.own
            + Matrix2::new(
                shared[(0, 0)],
                shared[(0, 1)],
                shared[(1, 0)],
                shared[(1, 1)],
            )
    }
}

/// Unit vectors across a direction, towards larger azimuth and larger elevation about the
/// sample's z; straight above the sample azimuth counts as 0.
pub fn tangents(direction: DVec3) -> [DVec3; 2] {
    let azimuth = match direction.x.hypot(direction.y) > 1e-6 {
        true => DVec3::Z.cross(direction).normalize(),
        false => DVec3::Y,
    };
    [azimuth, direction.cross(azimuth)]
}

/// Where the ray of a sensor position meets a sphere (camera frame), and where it is
/// mirrored to.
fn mirrored(camera: &Camera, centre: DVec3, radius: f64, at_px: DVec2) -> Option<(DVec3, DVec3)> {
    let (origin, direction) = camera.chief_ray(at_px);
    let offset = origin - centre;
    let along = offset.dot(direction);
    let inside = along * along - (offset.length_squared() - radius * radius);
    if inside.is_nan() || inside <= 0.0 {
        return None;
    }
    let point = origin + direction * (-along - inside.sqrt());
    let normal = (point - centre) / radius;
    Some((point, direction - normal * (2.0 * direction.dot(normal))))
}

/// A mirrored ray in the sample's frame, with its derivatives by the highlight's place (2)
/// and the sphere's numbers (3).
struct MirroredRay {
    point: DVec3,
    direction: DVec3,
    by_highlight: [DVec3; 2],
    by_sphere: [DVec3; 3],
}

fn ray(camera: &Camera, sphere: &Sphere, highlight: &Highlight) -> Option<MirroredRay> {
    let to_sample = &camera.sample_from_camera;
    let at = |px: DVec2, delta: Vector3<f64>| {
        let (centre, radius) = sphere.shifted(camera, delta);
        let (point, direction) = mirrored(camera, centre, radius, px)?;
        Some((to_sample.point(point), to_sample.direction(direction)))
    };
    let px = highlight.position_px;
    let (point, direction) = at(px, Vector3::zeros())?;
    const STEP_PX: f64 = 1e-3;
    let step_mm = STEP_PX * mm_per_px(camera, sphere.centre_mm);
    let mut by_highlight = [DVec3::ZERO; 2];
    for (axis, derivative) in by_highlight.iter_mut().enumerate() {
        let step = [DVec2::X, DVec2::Y][axis] * STEP_PX;
        let (_, high) = at(px + step, Vector3::zeros())?;
        let (_, low) = at(px - step, Vector3::zeros())?;
        *derivative = (high - low) / (2.0 * STEP_PX);
    }
    let mut by_sphere = [DVec3::ZERO; 3];
    for (axis, derivative) in by_sphere.iter_mut().enumerate() {
        let mut step = Vector3::zeros();
        step[axis] = step_mm;
        let (_, high) = at(px, step)?;
        let (_, low) = at(px, -step)?;
        *derivative = (high - low) / (2.0 * step_mm);
    }
    Some(MirroredRay {
        point,
        direction,
        by_highlight,
        by_sphere,
    })
}

/// Finds the light of image number `index` from one highlight per sphere. Its direction is
/// stated for `reference_mm` (sample frame): the middle of the light stage.
///
/// # Errors
/// Rays that do not belong to one lamp, or an unknown distance with one sphere.
pub fn locate(
    camera: &Camera,
    spheres: &[Sphere],
    highlights: &[Highlight],
    reference_mm: DVec3,
    distance: Distance,
    index: usize,
) -> Result<FoundLight, SphereError> {
    let impossible = |what, value: String, allowed| SphereError::Impossible {
        what,
        value,
        allowed,
    };
    if spheres.is_empty() || spheres.len() != highlights.len() {
        let value = format!("{} and {}", spheres.len(), highlights.len());
        let allowed = "equal and at least 1";
        return Err(impossible(
            "the number of spheres and highlights",
            value,
            allowed,
        ));
    }
    if distance == Distance::Unknown && spheres.len() < 2 {
        let allowed = "at least 2 where the lamp's distance is not known";
        return Err(impossible("the number of spheres", "1".to_owned(), allowed));
    }
    let pairs = spheres.iter().zip(highlights);
    let rays: Option<Vec<_>> = pairs.map(|(s, h)| ray(camera, s, h)).collect();
    let Some(rays) = rays else {
        let allowed = "on the sphere";
        return Err(impossible("a highlight", "outside".to_owned(), allowed));
    };
    let (stated, stated_std) = match distance {
        Distance::Infinite => (0.0, None),
        Distance::Stated(mm, std) => (1.0 / mm, Some((std / (mm * mm)).max(1e-12))),
        Distance::Unknown => (0.0, Some(f64::INFINITY)),
    };
    let mut direction = rays.iter().map(|r| r.direction).sum::<DVec3>().normalize();
    let mut inverse = stated;
    // So that all unknowns are of the size of angles.
    let scale = 1.0 / 100.0;
    let free = usize::from(stated_std.is_some());
    let unknowns = 2 + free;
    let rows = 2 * rays.len() + free;
    let expected = |direction: DVec3, inverse: f64, point: DVec3| {
        (direction - (point - reference_mm) * inverse).normalize()
    };
    let mut last = None;
    for _ in 0..30 {
        let axes = tangents(direction);
        let mut jacobian = DMatrix::zeros(rows, unknowns);
        let mut residual = DVector::zeros(rows);
        let mut weight = DMatrix::zeros(rows, rows);
        for (k, (ray, highlight)) in rays.iter().zip(highlights).enumerate() {
            let here = expected(direction, inverse, ray.point);
            let across = tangents(here);
            let pull = ray.direction - here;
            const STEP: f64 = 1e-6;
            let changed = [
                expected((direction + axes[0] * STEP).normalize(), inverse, ray.point),
                expected((direction + axes[1] * STEP).normalize(), inverse, ray.point),
                expected(direction, inverse + STEP * scale, ray.point),
            ];
            for (a, across) in across.iter().enumerate() {
                residual[2 * k + a] = across.dot(pull);
                for (unknown, changed) in changed.iter().enumerate().take(unknowns) {
                    jacobian[(2 * k + a, unknown)] = across.dot(*changed - here) / STEP;
                }
            }
            let covariance = highlight_covariance(ray, highlight, across)
                + sphere_share(ray, &spheres[k], across)
                    * sphere_share(ray, &spheres[k], across).transpose();
            let inverse = covariance.try_inverse().unwrap_or(Matrix2::zeros());
            weight.view_mut((2 * k, 2 * k), (2, 2)).copy_from(&inverse);
        }
        if let Some(std) = stated_std {
            let row = rows - 1;
            jacobian[(row, 2)] = 1.0;
            residual[row] = (stated - inverse) / scale;
            weight[(row, row)] = (scale / std).powi(2);
        }
        let weighted = jacobian.transpose() * &weight;
        let Some(solver) = (&weighted * &jacobian).cholesky() else {
            let allowed = "enough to tell the distance";
            return Err(impossible(
                "the distance between the spheres",
                "0".to_owned(),
                allowed,
            ));
        };
        let gain = solver.solve(&weighted);
        let step = &gain * &residual;
        let chi2 = (residual.transpose() * &weight * &residual)[(0, 0)];
        direction = (direction + axes[0] * step[0] + axes[1] * step[1]).normalize();
        if free == 1 {
            inverse += step[2] * scale;
        }
        let variance = solver.inverse();
        last = Some((gain, chi2, variance));
        if step.norm() < 1e-12 {
            break;
        }
    }
    let Some((gain, chi2, variance)) = last else {
        return Err(impossible("the light", "nowhere".to_owned(), "somewhere"));
    };
    let inverse_std = if free == 1 {
        variance[(2, 2)].sqrt() * scale
    } else {
        0.0
    };
    // One ray too many in one direction: a single number must be zero.
    let miss = if rays.len() > 1 { chi2.sqrt() } else { 0.0 };
    let behind = inverse < -5.0 * inverse_std.max(1e-9);
    if miss > 6.0 || behind {
        let deviations = if behind {
            -inverse / inverse_std.max(1e-9)
        } else {
            miss
        };
        return Err(SphereError::NotOneLamp {
            image: index,
            deviations,
        });
    }
    let mut own = Matrix2::zeros();
    let mut shared = DMatrix::zeros(2, 3 * rays.len());
    for (k, (ray, highlight)) in rays.iter().zip(highlights).enumerate() {
        let across = tangents(expected(direction, inverse, ray.point));
        let gain = Matrix2::from_fn(|i, j| gain[(i, 2 * k + j)]);
        own += gain * highlight_covariance(ray, highlight, across) * gain.transpose();
        let share = gain * sphere_share(ray, &spheres[k], across);
        shared.view_mut((0, 3 * k), (2, 3)).copy_from(&share);
    }
    if let Some(std) = stated_std.filter(|std| std.is_finite()) {
        let column = Matrix2::from_fn(|i, j| gain[(i, rows - 1)] * gain[(j, rows - 1)]);
        own += column * (std / scale).powi(2);
    }
    Ok(FoundLight {
        to_light: direction,
        inverse_distance: [inverse, inverse_std],
        own,
        shared,
        miss,
    })
}

/// Covariance of a mirrored ray from its highlight's, along two unit vectors.
fn highlight_covariance(
    ray: &MirroredRay,
    highlight: &Highlight,
    across: [DVec3; 2],
) -> Matrix2<f64> {
    let by = Matrix2::from_fn(|i, j| across[i].dot(ray.by_highlight[j]));
    let c = highlight.covariance_px2;
    let covariance = Matrix2::new(c.x_axis.x, c.y_axis.x, c.x_axis.y, c.y_axis.y);
    by * covariance * by.transpose()
}

/// How a mirrored ray moves with three independent unit normals of its sphere.
fn sphere_share(ray: &MirroredRay, sphere: &Sphere, across: [DVec3; 2]) -> Matrix2x3<f64> {
    let by = Matrix2x3::from_fn(|i, j| across[i].dot(ray.by_sphere[j]));
    let root = sphere
        .covariance
        .cholesky()
        .map_or_else(nalgebra::Matrix3::zeros, |c| c.l());
    by * root
}
