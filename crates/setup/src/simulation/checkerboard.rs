//! Photographs of a checkerboard by a lens, as light that falls off across it, blur and
//! noise make them.

use std::f64::consts::TAU;

use glam::{DQuat, DVec2, DVec3};

use super::pixels;
use crate::frames::{self, Rigid, Sample};
use crate::radiance_image::RadianceImage;
use crate::random::Stream;
use crate::transport::{Camera, Coefficients, LensSpec, Projection};

/// Size of the photographs, pixels.
pub const SIZE: [usize; 2] = [160, 120];

/// A camera without distortion, 250 mm above the sample's datum.
pub fn described(projection: Projection) -> Camera {
    let from = DVec3::new(0.0, 0.0, 250.0);
    Camera::looking_at(SIZE, projection, from, DVec3::ZERO, DVec3::Y)
        .expect("it does not look along its own up")
}

/// A lens in perspective with distortion.
pub fn perspective() -> Camera {
    let lens = LensSpec {
        principal_offset: DVec2::new(0.02, -0.015),
        aspect: 1.01,
        distortion: Coefficients {
            radial: [-0.15, 0.1, 0.0],
            tangential: [0.002, -0.001],
        },
    };
    described(Projection::Perspective { fov_rad: 0.55 })
        .with_lens(lens)
        .expect("its distortion does not fold")
}

/// A telecentric lens with distortion.
pub fn telecentric() -> Camera {
    let lens = LensSpec {
        distortion: Coefficients {
            radial: [0.02, -0.005, 0.0],
            tangential: [0.001, 0.002],
        },
        ..LensSpec::IDEAL
    };
    let extent_mm = DVec2::new(132.0, 100.0);
    described(Projection::Orthographic { extent_mm })
        .with_lens(lens)
        .expect("its distortion does not fold")
}

/// The camera where it truly stands: turned by some degrees (a telecentric one about its
/// axis alone) and moved by some millimetres, so that corners fall on other places of the
/// pixels.
pub fn displaced(mut camera: Camera, numbers: &mut Stream) -> Camera {
    let mut near = |size: f64| size * (2.0 * numbers.uniform() - 1.0);
    let turn = match camera.projection {
        Projection::Perspective { .. } => DVec3::new(near(0.04), near(0.04), near(0.04)),
        Projection::Orthographic { .. } => DVec3::new(0.0, 0.0, near(0.04)),
    };
    let shift = DVec3::new(near(2.0), near(2.0), 0.0);
    camera.sample_from_camera =
        Rigid::from_rotation_vector(turn, shift) * camera.sample_from_camera;
    camera
}

/// A board of squares with a plain border.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Checkerboard {
    /// Squares along x and y.
    pub squares: [u32; 2],
    /// Side of a square, mm.
    pub square_mm: f64,
    /// Standard deviation of the lens's blur, pixels.
    pub blur_px: f64,
    /// Standard deviation of a pixel's noise; the bright squares have about 0.9.
    pub noise: f64,
}

impl Checkerboard {
    /// 10 by 8 squares of 12 mm.
    pub const TYPICAL: Self = Self {
        squares: [10, 8],
        square_mm: 12.0,
        blur_px: 0.7,
        noise: 0.008,
    };

    /// A photograph of the board where `pose` (camera from board) puts it.
    pub fn photograph(
        &self,
        camera: &Camera,
        pose: &Rigid<frames::Camera, Sample>,
        numbers: &mut Stream,
    ) -> RadianceImage {
        let to_board = pose.inverse();
        let radiance = |at: DVec2| {
            let (origin, direction) = camera.chief_ray(at);
            let (from, along) = (to_board.point(origin), to_board.direction(direction));
            self.radiance((from - along * (from.z / along.z)).truncate())
        };
        let [width, height] = camera.resolution_px;
        let mut image = RadianceImage::new(width, height);
        let means = pixels::means([width, height], self.blur_px, radiance);
        for (pixel, mean) in means.into_iter().enumerate() {
            // A grey camera: three equal channels.
            image.mean[pixel] = [(mean + self.noise * numbers.normal()) as f32; 3];
            image.variance[pixel] = [self.noise.powi(2) as f32; 3];
        }
        image
    }

    /// Radiance at a place of the board, from its middle.
    fn radiance(&self, at_mm: DVec2) -> f64 {
        let half = 0.5 * DVec2::from_array(self.squares.map(f64::from)) * self.square_mm;
        let light = 1.0 + 0.003 * at_mm.x - 0.002 * at_mm.y;
        let outside = (at_mm.abs() - half).max_element();
        if outside > self.square_mm {
            return 0.2;
        }
        if outside > 0.0 {
            return light * 0.9;
        }
        // Edges that are not infinitely sharp: places along a pixel are few.
        let soft_mm = 0.023 * self.square_mm;
        let wave = |x: f64| {
            let nearest = (x / self.square_mm).round();
            let beyond = (x - nearest * self.square_mm) / soft_mm;
            let sign = if nearest.rem_euclid(2.0) < 0.5 {
                1.0
            } else {
                -1.0
            };
            sign * (2.0 * beyond).clamp(-1.0, 1.0)
        };
        let place = at_mm + half;
        light * (0.49 - 0.41 * wave(place.x) * wave(place.y))
    }
}

/// Where the board is in each view, camera from board: at the sample's datum first, then
/// moved about within a few millimetres and, if `tilted`, tilted by 23° in as many directions.
pub fn poses(
    camera: &Camera,
    numbers: &mut Stream,
    views: usize,
    tilted: bool,
) -> Vec<Rigid<frames::Camera, Sample>> {
    let datum = camera.sample_from_camera.inverse();
    let mut poses = vec![datum];
    for k in 1..views {
        let mut near = |size: f64| size * (2.0 * numbers.uniform() - 1.0);
        let angle = TAU * k as f64 / (views - 1) as f64;
        let tilt = match tilted {
            true => 0.4 + near(0.1),
            false => 0.0,
        };
        let axis = DVec3::new(angle.cos(), angle.sin(), 0.0);
        let turn = DQuat::from_rotation_z(near(0.15)) * DQuat::from_axis_angle(axis, tilt);
        let shift = DVec3::new(
            12.0 * angle.cos() + near(3.0),
            9.0 * angle.sin() + near(3.0),
            near(10.0),
        );
        poses.push(datum * Rigid::new(turn, shift));
    }
    poses
}
