//! A sphere's outline to a small part of a pixel: all pixels around the limb are compared
//! with a blurred edge between a smooth background and a smoothly shaded sphere.

use glam::DVec3;
use nalgebra::{DMatrix, DVector, Vector3};

use super::gauss::Limb;
use super::search::inside;
use super::{Circle, Grey, Sphere, SphereError, mm_per_px, project};
use crate::frames::{Rigid, Sample};
use crate::statistics::{CHI2_1_MEDIAN, median, normal_cdf, normal_density};
use crate::transport::{Camera, Projection};

/// What is known of a sphere before it is seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stated {
    /// Radius, millimetres; > 0.
    pub radius_mm: f64,
    /// Height of its middle above the sample's datum, along the sample's z, millimetres:
    /// what a telecentric camera cannot see.
    pub height_mm: f64,
}

/// Harmonics in the angle around the limb of background and shading: 1, cos φ, …, sin 4φ.
const HARMONICS: usize = 9;
/// Background, shaded base, and the part that follows the sphere's height.
const LINEAR: usize = 3 * HARMONICS;
/// Middle, radius or distance, and blur.
const SHAPE: usize = 4;
const ROUNDS: usize = 60;
/// Sectors of the ring whose residuals count as independent.
const SECTORS: usize = 36;
/// Half the width of the ring that is compared, over the radius, and at least and at most
/// these pixels.
const RING: (f64, [f64; 2]) = (0.15, [4.0, 12.0]);
/// Pixels further off than this many standard deviations lose their weight.
const ROBUST: f64 = 3.0;

/// Where a sphere should appear if its middle were in the middle of the view: its radius
/// in pixels.
pub fn expected_radius_px(camera: &Camera, stated: &Stated) -> f64 {
    let distance_mm = match camera.projection {
        Projection::Orthographic { .. } => 1.0,
        Projection::Perspective { .. } => depth_mm(camera, stated.height_mm, DVec3::ZERO, DVec3::Z),
    };
    stated.radius_mm / mm_per_px(camera, DVec3::Z * distance_mm)
}

/// Fits a sphere near a circle.
///
/// # Errors
/// [`SphereError::OutsideView`], [`SphereError::Unfitted`]; [`SphereError::Radius`] where
/// the camera knows better, by more than 3% and 5 standard deviations.
pub fn fit(
    image: &Grey,
    camera: &Camera,
    stated: &Stated,
    circle: &Circle,
) -> Result<Sphere, SphereError> {
    inside(circle, image)?;
    let start = start(camera, stated, circle);
    let mut fit = Fit {
        image,
        camera,
        sphere: start,
        blur_px: 1.5,
        floor2: 0.0,
    };
    // Once with a wide ring, because the circle is rough, once more where it truly is.
    for widening in [1.5, 1.0] {
        fit.solve(widening)?;
    }
    let sphere = fit.finish()?;
    inside(&sphere.circle, image)?;
    let off_mm = sphere.radius_mm - stated.radius_mm;
    let std_mm = sphere.covariance[(2, 2)].sqrt();
    if matches!(camera.projection, Projection::Orthographic { .. })
        && off_mm.abs() > (0.03 * stated.radius_mm).max(5.0 * std_mm)
    {
        return Err(SphereError::Radius {
            found_mm: sphere.radius_mm,
            std_mm,
            stated_mm: stated.radius_mm,
        });
    }
    Ok(sphere)
}

/// A sphere of the circle's position and size.
fn start(camera: &Camera, stated: &Stated, circle: &Circle) -> Sphere {
    let (origin, direction) = camera.chief_ray(circle.centre_px);
    let (centre_mm, radius_mm) = match camera.projection {
        Projection::Orthographic { .. } => {
            let depth = depth_mm(camera, stated.height_mm, origin, direction);
            let radius_mm = circle.radius_px * mm_per_px(camera, origin);
            (origin + direction * depth, radius_mm)
        }
        Projection::Perspective { .. } => {
            // sin of the angle under which the radius is seen.
            let (_, edge) = camera.chief_ray(circle.centre_px + glam::DVec2::X * circle.radius_px);
            let angle = direction.angle_between(edge).max(1e-6);
            (
                direction * (stated.radius_mm / angle.sin()),
                stated.radius_mm,
            )
        }
    };
    Sphere {
        centre_mm,
        radius_mm,
        covariance: nalgebra::Matrix3::zeros(),
        blur_px: 0.5,
        circle: *circle,
    }
}

/// Length along a camera's ray to a height above the sample's datum; the middle of the
/// view where the ray runs level.
fn depth_mm(camera: &Camera, height_mm: f64, origin: DVec3, direction: DVec3) -> f64 {
    let to_sample: &Rigid<Sample, crate::frames::Camera> = &camera.sample_from_camera;
    let (from, along) = (to_sample.point(origin), to_sample.direction(direction));
    let depth = (height_mm - from.z) / along.z;
    if depth.is_finite() && depth > 0.0 {
        depth
    } else {
        camera.focus_mm
    }
}

/// A pixel near the limb.
struct Pixel {
    position_px: glam::DVec2,
    value: f64,
    variance: f64,
    weight: f64,
}

struct Fit<'a> {
    image: &'a Grey,
    camera: &'a Camera,
    sphere: Sphere,
    blur_px: f64,
    /// Variance beyond the pixels' own: what the smooth shading does not describe.
    floor2: f64,
}

impl Fit<'_> {
    fn unfitted<T>(&self, why: &str) -> Result<T, SphereError> {
        Err(SphereError::Unfitted {
            x: self.sphere.circle.centre_px.x,
            y: self.sphere.circle.centre_px.y,
            why: why.to_owned(),
        })
    }

    /// Half the ring's width, pixels.
    fn reach_px(&self, widening: f64) -> f64 {
        let (part, [least, most]) = RING;
        widening * (part * self.sphere.circle.radius_px).clamp(least, most)
    }

    fn ring(&self, reach_px: f64) -> Vec<Pixel> {
        let Circle {
            centre_px,
            radius_px,
        } = self.sphere.circle;
        let far = radius_px + reach_px + 1.0;
        let limit = |low: f64, n: usize| (low.max(0.0) as usize).min(n);
        let rows = limit(centre_px.y - far, self.image.height)
            ..limit(centre_px.y + far + 1.0, self.image.height);
        let mut ring = Vec::new();
        for y in rows {
            let columns = limit(centre_px.x - far, self.image.width)
                ..limit(centre_px.x + far + 1.0, self.image.width);
            for x in columns {
                let pixel = y * self.image.width + x;
                let position_px = glam::DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
                let off = position_px.distance(centre_px) - radius_px;
                if self.image.valid[pixel] && off.abs() <= reach_px {
                    ring.push(Pixel {
                        position_px,
                        value: self.image.value[pixel],
                        variance: self.image.variance[pixel].max(0.0),
                        weight: 1.0,
                    });
                }
            }
        }
        ring
    }

    /// Distance inside the limb, pixels, and angle around the middle.
    fn position(&self, centre: DVec3, radius: f64, pixel: &Pixel) -> (f64, f64) {
        let (origin, direction) = self.camera.chief_ray(pixel.position_px);
        let offset = origin - centre;
        let nearest = offset - direction * offset.dot(direction);
        let scale = mm_per_px(self.camera, centre);
        let distance_px = (radius - nearest.length()) / scale;
        (distance_px, nearest.y.atan2(nearest.x))
    }

    /// The linear part of the model, one row per pixel.
    fn basis(
        &self,
        delta: Vector3<f64>,
        blur_px: f64,
        ring: &[Pixel],
        reach_px: f64,
    ) -> DMatrix<f64> {
        let (centre, radius) = self.sphere.shifted(self.camera, delta);
        let radius_px = radius / mm_per_px(self.camera, centre);
        let limb = Limb::new(2.0 * reach_px, radius_px, blur_px);
        let mut basis = DMatrix::zeros(ring.len(), LINEAR);
        for (row, pixel) in ring.iter().enumerate() {
            let (distance, angle) = self.position(centre, radius, pixel);
            // A blurred disc's edge lies inside of the disc's, by its curvature.
            let z = distance / blur_px - 0.5 * blur_px / radius_px;
            let step = normal_cdf(z);
            // The distance from the axis over the radius, which light from the side follows.
            let side =
                (1.0 - distance / radius_px) * step - blur_px / radius_px * normal_density(z);
            let height = limb.at(distance);
            for harmonic in 0..HARMONICS {
                let turn = harmonic.div_ceil(2) as f64 * angle;
                let wave = if harmonic % 2 == 0 {
                    turn.cos()
                } else {
                    turn.sin()
                };
                basis[(row, harmonic)] = wave * (1.0 - step);
                basis[(row, HARMONICS + harmonic)] = wave * side;
                basis[(row, 2 * HARMONICS + harmonic)] = wave * height;
            }
        }
        basis
    }

    /// Gauss–Newton steps on shape and linear part together, the latter solved exactly
    /// each time. Pixels, variance floor and weights change with every step, so that there
    /// is no common cost by which [`crate::least_squares`] could accept or reject one; steps
    /// are limited to a pixel instead.
    fn solve(&mut self, widening: f64) -> Result<(), SphereError> {
        for round in 0..ROUNDS {
            let system = self.system(widening)?;
            let solver = system.normal.cholesky();
            let Some(step) = solver.map(|c| c.solve(&system.right)) else {
                return self.unfitted("it has no contrast");
            };
            let scale = mm_per_px(self.camera, self.sphere.centre_mm);
            let depth_scale = self.third_scale();
            let mut shape = [
                step[0] / scale,
                step[1] / scale,
                step[2] / depth_scale,
                step[3],
            ];
            let longest = shape.iter().fold(0.0f64, |a, b| a.max(b.abs()));
            // Robust weights may make it swing: shorter steps end that.
            let most = if round < 10 { 1.0 } else { 0.5 };
            let shrink = (1.0 / longest).min(most);
            shape = shape.map(|s| s * shrink);
            let delta = Vector3::new(shape[0] * scale, shape[1] * scale, shape[2] * depth_scale);
            self.blur_px = (self.blur_px + shape[3]).clamp(0.2, 0.5 * self.reach_px(1.0));
            let (centre, radius) = self.sphere.shifted(self.camera, delta);
            self.sphere.centre_mm = centre;
            self.sphere.radius_mm = radius;
            let radius_px = radius / mm_per_px(self.camera, centre);
            self.sphere.circle = Circle {
                centre_px: project(self.camera, centre),
                radius_px,
            };
            let size = self.image.width.max(self.image.height) as f64;
            if !(4.0..size).contains(&radius_px) {
                return self.unfitted("its size ran away");
            }
            inside(&self.sphere.circle, self.image)?;
            if longest < 1e-4 || (round + 1 == ROUNDS && longest < 1e-2) {
                return Ok(());
            }
        }
        self.unfitted("the fit does not settle")
    }

    /// Millimetres of the third number that move the limb by one pixel.
    fn third_scale(&self) -> f64 {
        let scale = mm_per_px(self.camera, self.sphere.centre_mm);
        match self.camera.projection {
            Projection::Orthographic { .. } => scale,
            // The angular radius is R/z.
            Projection::Perspective { .. } => {
                scale * self.sphere.centre_mm.z / self.sphere.radius_mm
            }
        }
    }

    /// The problem linearised at the present shape.
    fn system(&mut self, widening: f64) -> Result<System, SphereError> {
        let reach_px = self.reach_px(widening);
        let mut ring = self.ring(reach_px);
        let invisible =
            0.75 * 2.0 * std::f64::consts::TAU * self.sphere.circle.radius_px * reach_px;
        if ring.len() < 4 * LINEAR || (ring.len() as f64) < invisible {
            return self.unfitted("too few pixels around it are valid");
        }
        let blur_px = self.blur_px;
        let basis = self.basis(Vector3::zeros(), blur_px, &ring, reach_px);
        let values = DVector::from_iterator(ring.len(), ring.iter().map(|p| p.value));
        let mut linear = DVector::zeros(LINEAR);
        let mut residual = values.clone();
        for pass in 0..3 {
            for (pixel, residual) in ring.iter_mut().zip(residual.iter()) {
                let variance = pixel.variance + self.floor2;
                let pull = residual / variance.max(1e-300).sqrt();
                let robust = match pass {
                    0 => 1.0,
                    _ => (ROBUST / pull.abs()).min(1.0),
                };
                pixel.weight = robust / variance.max(1e-300);
            }
            if pass == 0 && self.floor2 == 0.0 {
                ring.iter_mut().for_each(|p| p.weight = 1.0);
            }
            let weights = DVector::from_iterator(ring.len(), ring.iter().map(|p| p.weight));
            linear = solve_linear(&basis, &values, &weights)
                .map_or_else(|| self.unfitted("it has no contrast"), Ok)?;
            residual = &values - &basis * &linear;
            // A robust estimate of the scatter that the pixels' noise leaves unexplained.
            let squares = residual.iter().map(|r| r * r);
            let scatter2 = median(squares).unwrap_or(0.0) / CHI2_1_MEDIAN;
            let noise2 = median(ring.iter().map(|p| p.variance)).unwrap_or(0.0);
            self.floor2 = (scatter2 - noise2).max(1e-4 * scatter2).max(1e-24);
        }
        let jacobian = self.jacobian(&basis, &linear, &ring, reach_px);
        let weights = DVector::from_iterator(ring.len(), ring.iter().map(|p| p.weight));
        let mut all = jacobian.insert_columns(SHAPE, LINEAR, 0.0);
        all.columns_mut(SHAPE, LINEAR).copy_from(&basis);
        let weighted = scale_rows(&all, &weights);
        let mut normal = all.transpose() * &weighted;
        let right = weighted.transpose() * &residual;
        let trace: f64 = normal.diagonal().iter().skip(SHAPE).sum::<f64>() / LINEAR as f64;
        for i in SHAPE..SHAPE + LINEAR {
            normal[(i, i)] += 1e-9 * trace;
        }
        let sectors = ring.iter().map(|p| {
            let offset = p.position_px - self.sphere.circle.centre_px;
            let turn = offset.y.atan2(offset.x) / std::f64::consts::TAU + 0.5;
            ((turn * SECTORS as f64) as usize).min(SECTORS - 1)
        });
        Ok(System {
            normal,
            right,
            sectors: sectors.collect(),
            weighted,
            residual,
        })
    }

    /// Derivatives of the model by shape (x, y, third in millimetres; blur in pixels).
    fn jacobian(
        &self,
        basis: &DMatrix<f64>,
        linear: &DVector<f64>,
        ring: &[Pixel],
        reach_px: f64,
    ) -> DMatrix<f64> {
        let here = basis * linear;
        let scale = mm_per_px(self.camera, self.sphere.centre_mm);
        let mut jacobian = DMatrix::zeros(ring.len(), SHAPE);
        const STEP_PX: f64 = 0.05;
        for column in 0..SHAPE {
            let mut delta = Vector3::zeros();
            let mut blur_px = self.blur_px;
            let step = match column {
                3 => {
                    blur_px += STEP_PX;
                    STEP_PX
                }
                2 => {
                    delta[2] = STEP_PX * self.third_scale();
                    delta[2]
                }
                _ => {
                    delta[column] = STEP_PX * scale;
                    delta[column]
                }
            };
            let moved = self.basis(delta, blur_px, ring, reach_px) * linear;
            jacobian.set_column(column, &((moved - &here) / step));
        }
        jacobian
    }

    /// The sphere with its covariance.
    fn finish(mut self) -> Result<Sphere, SphereError> {
        let Some(covariance) = self.system(1.0)?.covariance() else {
            return self.unfitted("it has no contrast");
        };
        let scale = mm_per_px(self.camera, self.sphere.centre_mm);
        let std_px = covariance[(0, 0)].max(covariance[(1, 1)]).sqrt() / scale;
        if std_px.is_nan() || std_px > 0.5 {
            return self.unfitted("it is known to no better than half a pixel");
        }
        let mut sphere = self.sphere;
        sphere.covariance = covariance;
        sphere.blur_px = self.blur_px;
        Ok(sphere)
    }
}

/// The problem linearised: shape first, then the linear part.
struct System {
    normal: DMatrix<f64>,
    right: DVector<f64>,
    /// Jacobian times weights, and residuals, a row per pixel.
    weighted: DMatrix<f64>,
    residual: DVector<f64>,
    /// In which part of the ring each pixel is.
    sectors: Vec<usize>,
}

impl System {
    /// Covariance of the shape's first three numbers: from independent pixels, or from the
    /// scatter of whole sectors of the ring (sandwich) where that is larger, because what
    /// the smooth shading does not describe is alike in neighbouring pixels.
    fn covariance(self) -> Option<nalgebra::Matrix3<f64>> {
        let inverse = self.normal.try_inverse()?;
        let mut scores = DMatrix::<f64>::zeros(SHAPE + LINEAR, SECTORS);
        for (row, &sector) in self.sectors.iter().enumerate() {
            for column in 0..SHAPE + LINEAR {
                scores[(column, sector)] += self.weighted[(row, column)] * self.residual[row];
            }
        }
        let moved = &inverse * scores;
        // The linear part takes three numbers of each harmonic from the sectors.
        let freedom = SECTORS as f64 / (SECTORS - HARMONICS) as f64;
        let sandwich = &moved * moved.transpose() * freedom;
        let independent = inverse.fixed_view::<3, 3>(0, 0).into_owned();
        let correlated = sandwich.fixed_view::<3, 3>(0, 0).into_owned();
        let more = (independent.try_inverse()? * correlated).trace() / 3.0;
        Some(independent * more.max(1.0))
    }
}

fn scale_rows(matrix: &DMatrix<f64>, by: &DVector<f64>) -> DMatrix<f64> {
    let mut scaled = matrix.clone();
    for mut column in scaled.column_iter_mut() {
        column.component_mul_assign(by);
    }
    scaled
}

/// Weighted least squares with a slight ridge: harmonics that nothing determines stay 0.
fn solve_linear(
    basis: &DMatrix<f64>,
    values: &DVector<f64>,
    weights: &DVector<f64>,
) -> Option<DVector<f64>> {
    let weighted = scale_rows(basis, weights);
    let mut normal = basis.transpose() * &weighted;
    let ridge = 1e-9 * normal.trace() / LINEAR as f64;
    for i in 0..LINEAR {
        normal[(i, i)] += ridge;
    }
    let right = weighted.transpose() * values;
    Some(normal.cholesky()?.solve(&right))
}
