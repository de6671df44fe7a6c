//! From highlights to a light: each is a ray mirrored at a sphere; the rays of one lamp
//! meet there.

use glam::{DVec2, DVec3};
use nalgebra::{DMatrix, DVector, Matrix2, Matrix2x3, Vector3};

use super::highlight::Highlight;
use super::{Sphere, SphereError, mm_per_px};
use crate::least_squares::{self, Equations, Options, Problem};
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

/// A light found from its highlights, sample frame.
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

/// A mirrored ray in the sample's frame, with its derivatives by the highlight's position (2)
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

/// The lamp as it is sought: direction from the reference point, and inverse distance.
#[derive(Clone, Copy)]
struct Lamp {
    direction: DVec3,
    inverse: f64,
}

/// The rays of one lamp.
struct Rays<'a> {
    rays: &'a [MirroredRay],
    spheres: &'a [Sphere],
    highlights: &'a [Highlight],
    reference_mm: DVec3,
    /// Inverse distance and its standard uncertainty, 1/mm, where it is sought.
    stated: Option<[f64; 2]>,
    /// Inverse covariances of the rays at the last linearisation.
    weight: DMatrix<f64>,
}

/// Unit of inverse distances, 1/mm, so that all unknowns are of the size of angles.
const INVERSE_UNIT: f64 = 1.0 / 100.0;

/// The last step moves no unknown by more than some 1e-10 of its uncertainty.
const STEPS: Options = Options {
    rounds: 30,
    damping: 0.0,
    least_relative_gain: 0.0,
    least_gain: 1e-20,
};

impl Rays<'_> {
    fn unknowns(&self) -> usize {
        2 + usize::from(self.stated.is_some())
    }

    /// Direction from a point on a sphere to the lamp.
    fn expected(&self, lamp: &Lamp, point: DVec3) -> DVec3 {
        (lamp.direction - (point - self.reference_mm) * lamp.inverse).normalize()
    }

    /// Residuals along two tangents per ray, then that of the stated distance.
    fn residual(&self, lamp: &Lamp) -> DVector<f64> {
        let off = self.rays.iter().flat_map(|ray| {
            let here = self.expected(lamp, ray.point);
            tangents(here).map(|across| across.dot(ray.direction - here))
        });
        let stated = self.stated.iter();
        let distance = stated.map(|[stated, _]| (stated - lamp.inverse) / INVERSE_UNIT);
        DVector::from_vec(off.chain(distance).collect())
    }

    fn jacobian(&self, lamp: &Lamp) -> DMatrix<f64> {
        const STEP: f64 = 1e-6;
        let unknowns = self.unknowns();
        let rows = 2 * self.rays.len() + unknowns - 2;
        let mut jacobian = DMatrix::zeros(rows, unknowns);
        for (k, ray) in self.rays.iter().enumerate() {
            let here = self.expected(lamp, ray.point);
            let across = tangents(here);
            for unknown in 0..unknowns {
                let mut step = DVector::zeros(unknowns);
                step[unknown] = STEP;
                let by = (self.expected(&self.moved(lamp, &step), ray.point) - here) / STEP;
                for a in 0..2 {
                    jacobian[(2 * k + a, unknown)] = across[a].dot(by);
                }
            }
        }
        if self.stated.is_some() {
            jacobian[(rows - 1, 2)] = 1.0;
        }
        jacobian
    }

    /// Inverse covariances of the rows.
    fn weight_at(&self, lamp: &Lamp) -> DMatrix<f64> {
        let rows = 2 * self.rays.len() + self.unknowns() - 2;
        let mut weight = DMatrix::zeros(rows, rows);
        for (k, ray) in self.rays.iter().enumerate() {
            let across = tangents(self.expected(lamp, ray.point));
            let share = sphere_share(ray, &self.spheres[k], across);
            let covariance =
                highlight_covariance(ray, &self.highlights[k], across) + share * share.transpose();
            let inverse = covariance.try_inverse().unwrap_or(Matrix2::zeros());
            weight.view_mut((2 * k, 2 * k), (2, 2)).copy_from(&inverse);
        }
        if let Some([_, std]) = self.stated {
            weight[(rows - 1, rows - 1)] = (INVERSE_UNIT / std).powi(2);
        }
        weight
    }
}

impl Problem for Rays<'_> {
    type Point = Lamp;

    fn linearise(&mut self, at: &Lamp) -> Equations {
        self.weight = self.weight_at(at);
        let jacobian = self.jacobian(at);
        let weighted = jacobian.transpose() * &self.weight;
        Equations {
            right: &weighted * self.residual(at),
            normal: weighted * jacobian,
            cost: self.cost(at),
        }
    }

    fn cost(&self, at: &Lamp) -> f64 {
        let residual = self.residual(at);
        (&self.weight * &residual).dot(&residual)
    }

    fn moved(&self, from: &Lamp, step: &DVector<f64>) -> Lamp {
        let [azimuth, elevation] = tangents(from.direction);
        let by_distance = step.get(2).map_or(0.0, |step| step * INVERSE_UNIT);
        Lamp {
            direction: (from.direction + azimuth * step[0] + elevation * step[1]).normalize(),
            inverse: from.inverse + by_distance,
        }
    }
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
    // What cannot determine a light.
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
    let (inverse, stated) = match distance {
        Distance::Infinite => (0.0, None),
        Distance::Stated(mm, std) => {
            let std = (std / (mm * mm)).max(1e-12);
            (1.0 / mm, Some([1.0 / mm, std]))
        }
        Distance::Unknown => (0.0, Some([0.0, f64::INFINITY])),
    };
    // The lamp that fits all rays best.
    let mut problem = Rays {
        rays: &rays,
        spheres,
        highlights,
        reference_mm,
        stated,
        weight: DMatrix::zeros(0, 0),
    };
    let direction = rays.iter().map(|r| r.direction).sum::<DVec3>().normalize();
    let start = Lamp { direction, inverse };
    let lamp = least_squares::minimise(&mut problem, start, &STEPS).point;
    let equations = problem.linearise(&lamp);
    let Some(variance) = equations.covariance() else {
        let allowed = "enough to determine the distance";
        let what = "the distance between the spheres";
        return Err(impossible(what, "0".to_owned(), allowed));
    };
    let gain = &variance * problem.jacobian(&lamp).transpose() * &problem.weight;
    let Lamp { direction, inverse } = lamp;
    let chi2 = equations.cost;
    let inverse_std = match stated {
        Some(_) => variance[(2, 2)].sqrt() * INVERSE_UNIT,
        None => 0.0,
    };
    // Whether it is one lamp before the spheres.
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
    // The uncertainty: of this image alone, and that of the spheres.
    let mut own = Matrix2::zeros();
    let mut shared = DMatrix::zeros(2, 3 * rays.len());
    for (k, (ray, highlight)) in rays.iter().zip(highlights).enumerate() {
        let across = tangents(problem.expected(&lamp, ray.point));
        let gain = Matrix2::from_fn(|i, j| gain[(i, 2 * k + j)]);
        own += gain * highlight_covariance(ray, highlight, across) * gain.transpose();
        let share = gain * sphere_share(ray, &spheres[k], across);
        shared.view_mut((0, 3 * k), (2, 3)).copy_from(&share);
    }
    if let Some([_, std]) = stated.filter(|[_, std]| std.is_finite()) {
        let last = gain.ncols() - 1;
        let column = Matrix2::from_fn(|i, j| gain[(i, last)] * gain[(j, last)]);
        own += column * (std / INVERSE_UNIT).powi(2);
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
