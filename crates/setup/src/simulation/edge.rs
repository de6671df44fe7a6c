//! Photographs of a slanted edge through a lens of finite aperture, ray by ray.

use glam::{DVec2, DVec3};

use crate::random::{Purpose, stream};
use crate::transport::{Camera, Projection};

/// Pixels along each side of the photographs.
pub const SIDE: usize = 44;
/// Radiance of the dark half.
pub const DARK: f64 = 0.05;
/// Radiance of the bright half.
pub const BRIGHT: f64 = 0.8;

/// A camera 120 mm above the sample that is focused 1.5 mm below it.
pub fn camera(projection: Projection) -> Camera {
    let from = DVec3::new(0.0, 0.0, 120.0);
    let mut camera = Camera::looking_at([SIDE; 2], projection, from, DVec3::ZERO, DVec3::Y)
        .expect("it does not look along its own up");
    camera.point_spread_px = 0.6;
    camera.object_na = 0.05;
    camera.focus_mm = 121.5;
    camera
}

/// One that is telecentric.
pub fn telecentric() -> Camera {
    camera(Projection::Orthographic {
        extent_mm: DVec2::splat(6.6),
    })
}

/// The image of a target across the axis at a height, without noise: bright right of a line
/// near its middle, tilted by `tilt_rad`, under light that falls off over the field.
pub fn photograph(camera: &Camera, height_mm: f64, tilt_rad: f64) -> Vec<f64> {
    let (sin, cos) = tilt_rad.sin_cos();
    // Four numbers of a lattice that fills the unit cube evenly.
    let steps = [
        0.856_674_883_854_503,
        0.733_891_856_627_126,
        0.628_706_721_079_425,
        0.538_596_893_671_371,
    ];
    let seen = |at: DVec2, lens: DVec2| {
        let ray = camera.ray(at, lens);
        let (from, along) = (ray.origin_mm.as_dvec3(), ray.direction.as_dvec3());
        let place = from + along * ((height_mm - from.z) / along.z);
        let light = 1.0 + 0.03 * place.x - 0.02 * place.y;
        (place.x * cos + place.y * sin - 0.05, light)
    };
    (0..SIDE * SIDE)
        .map(|pixel| {
            let corner = DVec2::new((pixel % SIDE) as f64, (pixel / SIDE) as f64);
            // No ray of a pixel this far from the edge crosses it.
            let (distance_mm, _) = seen(corner + 0.5, DVec2::ZERO);
            let rays = if distance_mm.abs() > 1.0 { 16 } else { 500 };
            let mut shift = stream(9, Purpose::Experiment, 0, pixel as u64, height_mm.to_bits());
            let start = [0; 4].map(|_| shift.uniform());
            let ray = |i: i32| {
                let u: [f64; 4] =
                    std::array::from_fn(|k| (start[k] + f64::from(i) * steps[k]).fract());
                let at = camera.in_footprint(corner, DVec2::new(u[0], u[1]));
                let (distance_mm, light) = seen(at, DVec2::new(u[2], u[3]));
                light * if distance_mm > 0.0 { BRIGHT } else { DARK }
            };
            (0..rays).map(ray).sum::<f64>() / f64::from(rays)
        })
        .collect()
}

/// The same with noise of the light itself in addition to a constant one: values and variances.
pub fn noisy(truth: &[f64], seed: u64) -> (Vec<f64>, Vec<f64>) {
    let noisy = |(pixel, &v): (usize, &f64)| {
        let mut random = stream(seed, Purpose::Experiment, 1, pixel as u64, 0);
        let variance = 1e-5 + 8e-4 * v;
        (v + variance.sqrt() * random.normal(), variance)
    };
    truth.iter().enumerate().map(noisy).unzip()
}
