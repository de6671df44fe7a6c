//! Cameras: from a position on the sensor to a ray into the scene.

use glam::{DVec2, DVec3};

use super::distortion::Folded;
use super::footprint;
use super::lens::{Lens, LensSpec};
use crate::frames::{self, Rigid, Sample};
use crate::geometry::Ray;

/// How the lens maps the scene onto the sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Projection {
    /// Telecentric: parallel rays; the field of view in millimetres, width × height.
    Orthographic {
        /// Width and height of the field of view.
        extent_mm: DVec2,
    },
    /// Pinhole; the full horizontal angle of view.
    Perspective {
        /// Full horizontal angle of view of the ideal lens in front of the image's middle,
        /// radians, (0, π): states the focal length.
        fov_rad: f64,
    },
}

/// A camera in the sample frame. Row 0 of the image is the top.
///
/// ```
/// use glam::{DVec2, DVec3};
/// use rig_core::transport::{Camera, Projection};
///
/// let camera = Camera::looking_at(
///     [640, 480],
///     Projection::Perspective { fov_rad: 30f64.to_radians() },
///     DVec3::new(0.0, -200.0, 300.0),
///     DVec3::ZERO,
///     DVec3::Z,
/// )
/// .expect("`up` is not along the view");
/// // The point it looks at appears in the middle of the image.
/// let middle = camera.position_px(DVec3::ZERO).expect("in front of the camera");
/// assert!(middle.distance(DVec2::new(320.0, 240.0)) < 1e-6);
/// // And the ray of that position meets it.
/// let (origin, direction) = camera.chief_ray(middle);
/// assert!(origin.length() < 1e-9 && direction.distance(DVec3::Z) < 1e-9);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Pixels, width × height.
    pub resolution_px: [usize; 2],
    /// The lens.
    pub projection: Projection,
    /// How it differs from an ideal one in front of the image's middle.
    pub lens: Lens,
    /// Pose: the camera looks along its +z, x right, y down.
    pub sample_from_camera: Rigid<Sample, frames::Camera>,
    /// Distance at which the image is sharp, millimetres.
    pub focus_mm: f64,
    /// Sine of the half angle of the cone of rays that meet in a sharp point; 0 is a pinhole.
    pub object_na: f64,
    /// Standard deviation of the Gaussian into which lens and sensor spread a point in
    /// focus, along either axis of the image, pixels; 0 is perfectly sharp.
    pub point_spread_px: f64,
}

impl Camera {
    /// A camera at `position_mm` that looks at `look_at_mm`, sharp there, with a
    /// pinhole lens. `None` if position, target and `up` are degenerate.
    pub fn looking_at(
        resolution_px: [usize; 2],
        projection: Projection,
        position_mm: DVec3,
        look_at_mm: DVec3,
        up: DVec3,
    ) -> Option<Self> {
        Some(Self {
            resolution_px,
            projection,
            lens: Lens::IDEAL,
            sample_from_camera: frames::look_at(position_mm, look_at_mm, up)?,
            focus_mm: position_mm.distance(look_at_mm),
            object_na: 0.0,
            point_spread_px: 0.0,
        })
    }

    /// A telecentric camera straight above the sample, +y up in its image: width and height of
    /// the field of view, millimetres, and the distance from the sample's origin, millimetres.
    ///
    /// # Panics
    /// If the distance is not positive.
    pub fn above(resolution_px: [usize; 2], extent_mm: DVec2, distance_mm: f64) -> Self {
        let projection = Projection::Orthographic { extent_mm };
        let position_mm = DVec3::new(0.0, 0.0, distance_mm);
        Self::looking_at(
            resolution_px,
            projection,
            position_mm,
            DVec3::ZERO,
            DVec3::Y,
        )
        .expect("the camera is above the sample")
    }

    /// Width and height of what an ideal lens shows at the depth of a point of the sample's
    /// frame, millimetres; nothing behind the camera.
    pub fn field_mm(&self, point_mm: DVec3) -> DVec2 {
        let depth_mm = self.sample_from_camera.inverse().point(point_mm).z;
        self.field_at_depth_mm(depth_mm.max(0.0))
    }

    /// Width and height of what an ideal lens shows so many millimetres before the camera;
    /// negative behind a perspective camera.
    pub fn field_at_depth_mm(&self, depth_mm: f64) -> DVec2 {
        let [width, height] = self.resolution_px.map(|n| n as f64);
        match self.projection {
            Projection::Orthographic { extent_mm } => extent_mm,
            Projection::Perspective { fov_rad } => {
                let across = 2.0 * depth_mm * (0.5 * fov_rad).tan();
                DVec2::new(across, across * height / width)
            }
        }
    }

    /// The camera with a lens that is not ideal.
    ///
    /// # Errors
    /// [`Folded`] where two rays would meet in one point of the image.
    pub fn with_lens(self, spec: LensSpec) -> Result<Self, Folded> {
        let lens = Lens::new(spec, self.resolution_px, self.scale_px())?;
        Ok(Self { lens, ..self })
    }

    /// Pixels across and down that a slope of one spans (perspective), or half the width of
    /// the field (telecentric), for an ideal lens.
    pub fn scale_px(&self) -> DVec2 {
        let [width, height] = self.resolution_px.map(|n| n as f64);
        match self.projection {
            Projection::Orthographic { extent_mm } => {
                DVec2::new(0.5 * width, 0.5 * extent_mm.x * height / extent_mm.y)
            }
            Projection::Perspective { fov_rad } => {
                DVec2::splat(0.5 * width / (0.5 * fov_rad).tan())
            }
        }
    }

    /// Sensor position that the uniform numbers `u` in [0, 1)² choose in the footprint of
    /// the pixel with this top left corner: its unit square convolved with the point
    /// spread. May lie outside the pixel, and outside the image.
    pub fn in_footprint(&self, corner_px: DVec2, u: DVec2) -> DVec2 {
        corner_px
            + DVec2::new(
                footprint::position(u.x, self.point_spread_px),
                footprint::position(u.y, self.point_spread_px),
            )
    }

    /// The ray that begins in the footprint of a pixel (its index, row by row), at a position and
    /// a point of the lens that uniform numbers in [0, 1)² choose.
    pub fn ray_of_pixel(&self, pixel: usize, position: DVec2, lens: DVec2) -> Ray {
        let width = self.resolution_px[0];
        let corner = DVec2::new((pixel % width) as f64, (pixel / width) as f64);
        self.ray(self.in_footprint(corner, position), lens)
    }

    /// Radius of the disc into which a point at this distance along the camera's axis is
    /// blurred by the lens, millimetres in the plane of the point.
    pub fn defocus_mm(&self, depth_mm: f64) -> f64 {
        let tangent = self.object_na / (1.0 - self.object_na * self.object_na).sqrt();
        tangent * (depth_mm - self.focus_mm).abs()
    }

    /// Number of pixels.
    pub fn pixels(&self) -> usize {
        self.resolution_px[0] * self.resolution_px[1]
    }

    /// Sensor position, pixels from the top left corner, at which a point of the
    /// sample's frame appears through the middle of the lens; `None` behind a
    /// perspective camera. May lie outside the image.
    pub fn position_px(&self, point_mm: DVec3) -> Option<DVec2> {
        self.position_of_px(self.sample_from_camera.inverse().point(point_mm))
    }

    /// As [`Self::position_px`], of a point of the camera's own frame.
    pub fn position_of_px(&self, p: DVec3) -> Option<DVec2> {
        let [width, height] = self.resolution_px.map(|n| n as f64);
        if !self.lens.is_ideal() {
            let ideal = match self.projection {
                Projection::Orthographic { extent_mm } => 2.0 * p.truncate() / extent_mm.x,
                Projection::Perspective { .. } if p.z > 0.0 => p.truncate() / p.z,
                Projection::Perspective { .. } => return None,
            };
            let scale_px = self.scale_px();
            return Some(self.lens.position_px(ideal, self.resolution_px, scale_px));
        }
        match self.projection {
            Projection::Orthographic { extent_mm } => Some(DVec2::new(
                (p.x / extent_mm.x + 0.5) * width,
                (p.y / extent_mm.y + 0.5) * height,
            )),
            Projection::Perspective { fov_rad } => {
                let focal_px = 0.5 * width / (0.5 * fov_rad).tan();
                (p.z > 0.0).then(|| {
                    DVec2::new(
                        0.5 * width + focal_px * p.x / p.z,
                        0.5 * height + focal_px * p.y / p.z,
                    )
                })
            }
        }
    }

    /// The ray of a sensor position (pixels from the top left corner) through the middle
    /// of the lens, in the camera's own frame: origin, millimetres, and unit direction.
    pub fn chief_ray(&self, position_px: DVec2) -> (DVec3, DVec3) {
        let [width, height] = self.resolution_px.map(|n| n as f64);
        if !self.lens.is_ideal() {
            let scale_px = self.scale_px();
            let ideal = self.lens.ideal(position_px, self.resolution_px, scale_px);
            return match self.projection {
                Projection::Orthographic { extent_mm } => {
                    ((0.5 * extent_mm.x * ideal).extend(0.0), DVec3::Z)
                }
                Projection::Perspective { .. } => (DVec3::ZERO, ideal.extend(1.0).normalize()),
            };
        }
        match self.projection {
            Projection::Orthographic { extent_mm } => {
                let x = (position_px.x / width - 0.5) * extent_mm.x;
                let y = (position_px.y / height - 0.5) * extent_mm.y;
                (DVec3::new(x, y, 0.0), DVec3::Z)
            }
            Projection::Perspective { fov_rad } => {
                let half = (0.5 * fov_rad).tan();
                let x = (2.0 * position_px.x / width - 1.0) * half;
                let y = (2.0 * position_px.y - height) / width * half;
                (DVec3::ZERO, DVec3::new(x, y, 1.0).normalize())
            }
        }
    }

    /// The ray of a sensor position in pixels from the top left corner through a point of the lens, both numbers of
    /// `lens` uniform in [0, 1).
    pub fn ray(&self, position_px: DVec2, lens: DVec2) -> Ray {
        let (mut origin, mut direction) = self.chief_ray(position_px);
        if self.object_na > 0.0 {
            let focus = origin + direction * (self.focus_mm / direction.z);
            let radius =
                self.object_na / (1.0 - self.object_na * self.object_na).sqrt() * self.focus_mm;
            let (sin, cos) = (std::f64::consts::TAU * lens.x).sin_cos();
            origin += DVec3::new(cos, sin, 0.0) * radius * lens.y.sqrt();
            direction = (focus - origin).normalize();
        }
        Ray {
            origin_mm: self.sample_from_camera.point(origin).as_vec3(),
            direction: self.sample_from_camera.direction(direction).as_vec3(),
            limit_mm: f32::INFINITY,
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::distortion::Coefficients;
    use super::*;

    fn camera(projection: Projection) -> Camera {
        Camera::looking_at(
            [64, 32],
            projection,
            DVec3::new(0.0, 0.0, 5.0),
            DVec3::ZERO,
            DVec3::Y,
        )
        .unwrap()
    }

    #[test]
    fn top_left_pixel_is_left_and_up() {
        let ray = camera(Projection::Orthographic {
            extent_mm: DVec2::new(2.0, 1.0),
        })
        .ray(DVec2::ZERO, DVec2::ZERO);
        assert!((ray.origin_mm.as_dvec3() - DVec3::new(-1.0, 0.5, 5.0)).length() < 1e-6);
        assert!((ray.direction.as_dvec3() + DVec3::Z).length() < 1e-6);
    }

    #[test]
    fn perspective_corner_spans_the_angle_of_view() {
        let camera = camera(Projection::Perspective { fov_rad: 1.0 });
        let left = camera.ray(DVec2::new(0.0, 16.0), DVec2::ZERO).direction;
        let right = camera.ray(DVec2::new(64.0, 16.0), DVec2::ZERO).direction;
        assert!((left.angle_between(right) - 1.0).abs() < 1e-5);
    }

    #[test]
    fn points_of_a_ray_appear_where_it_left() {
        let extent_mm = DVec2::new(2.0, 1.5);
        for projection in [
            Projection::Orthographic { extent_mm },
            Projection::Perspective { fov_rad: 0.7 },
        ] {
            let camera = camera(projection);
            let at = DVec2::new(11.5, 27.25);
            let ray = camera.ray(at, DVec2::ZERO);
            let point = ray.origin_mm.as_dvec3() + ray.direction.as_dvec3() * 4.0;
            let back = camera.position_px(point).unwrap();
            assert!((back - at).length() < 1e-3, "{projection:?}: {back}");
        }
        let behind = camera(Projection::Perspective { fov_rad: 0.7 });
        assert!(behind.position_px(DVec3::new(0.0, 0.0, 6.0)).is_none());
    }

    #[test]
    fn rays_through_a_lens_meet_at_the_focus() {
        let mut camera = camera(Projection::Orthographic {
            extent_mm: DVec2::new(2.0, 1.0),
        });
        camera.object_na = 0.1;
        for lens in [DVec2::new(0.1, 0.9), DVec2::new(0.7, 0.4)] {
            let ray = camera.ray(DVec2::new(48.0, 16.0), lens);
            let t = -ray.origin_mm.z / ray.direction.z;
            let at = ray.origin_mm + ray.direction * t;
            assert!((at.x - 0.5).abs() < 1e-5 && at.y.abs() < 1e-5, "{at}");
        }
    }

    proptest! {
        /// Pixel to ray to pixel, anywhere in the image, for any lens that is accepted.
        #[test]
        fn rays_and_positions_are_inverse(
            telecentric in any::<bool>(),
            x in 0.0..640.0,
            y in 0.0..480.0,
            depth_mm in 1.0..500.0,
            offset in [-0.1..0.1, -0.1..0.1f64],
            aspect in 0.9..1.1,
            radial in [-0.3..0.3, -0.3..0.3, -0.3..0.3f64],
            tangential in [-0.02..0.02, -0.02..0.02f64],
        ) {
            let projection = match telecentric {
                true => Projection::Orthographic { extent_mm: DVec2::new(40.0, 31.0) },
                false => Projection::Perspective { fov_rad: 0.9 },
            };
            let mut ideal = camera(projection);
            ideal.resolution_px = [640, 480];
            let lensed = ideal.with_lens(LensSpec {
                principal_offset: DVec2::from_array(offset),
                aspect,
                distortion: Coefficients { radial, tangential },
            });
            if let Ok(camera) = lensed {
                let at = DVec2::new(x, y);
                let (origin, direction) = camera.chief_ray(at);
                let back = camera.position_of_px(origin + direction * depth_mm).unwrap();
                prop_assert!((back - at).length() < 1e-9, "{at} {back}");
            }
        }
    }

    /// Principal point, aspect and distortion where they are expected, against numbers
    /// worked out by hand.
    #[test]
    fn a_lens_moves_points_as_it_says() {
        let ideal = camera(Projection::Orthographic {
            extent_mm: DVec2::new(2.0, 1.0),
        });
        let spec = LensSpec {
            principal_offset: DVec2::new(0.25, -0.125),
            aspect: 1.5,
            distortion: Coefficients {
                radial: [0.1, 0.0, 0.0],
                ..Coefficients::default()
            },
        };
        let camera = ideal.with_lens(spec).unwrap();
        // Half the field's width is 1 mm or 32 pixels; the point is 0.5 units off each way.
        let seen = camera.position_of_px(DVec3::new(0.5, 0.5, 3.0)).unwrap();
        let expected = DVec2::new(48.0 + 16.0 * 1.05, 12.0 + 24.0 * 1.05);
        assert!((seen - expected).length() < 1e-12, "{seen}");
        let folded = LensSpec {
            distortion: Coefficients {
                radial: [-1.0, 0.0, 0.0],
                ..Coefficients::default()
            },
            ..LensSpec::IDEAL
        };
        assert!(ideal.with_lens(folded).is_err());
    }

    /// An ideal lens gives the very same numbers as before there were others.
    #[test]
    fn an_ideal_lens_changes_nothing() {
        for projection in [
            Projection::Orthographic {
                extent_mm: DVec2::new(2.0, 1.5),
            },
            Projection::Perspective { fov_rad: 0.7 },
        ] {
            let plain = camera(projection);
            assert_eq!(plain.with_lens(LensSpec::IDEAL).unwrap(), plain);
        }
    }
}
