//! Photographs of a level white standard under a far and two near lamps, whose strengths and
//! falloffs are not as described.

use std::f64::consts::PI;

use glam::{DVec2, DVec3};

use crate::radiance_image::RadianceImage;
use crate::random::{Purpose, stream};
use crate::transport::{Camera, Light};
use crate::units::StageAngles;

/// Pixels along each side of the photographs.
pub const SIDE: usize = 60;
/// Height of the standard's surface, mm.
pub const HEIGHT_MM: f64 = 2.0;
/// Irradiance at the datum that all lights are described with.
const STATED: [f64; 3] = [3.0, 2.5, 1.2];
/// True strength of each light over the described one.
pub const FACTORS: [f64; 3] = [1.06, 0.97, 1.01];
/// Distance of the near lamps, mm.
const NEAR_MM: f64 = 250.0;
/// What the camera sees, mm.
const EXTENT_MM: f64 = 24.0;

/// A telecentric camera above the standard.
pub fn camera() -> Camera {
    Camera::above([SIDE; 2], DVec2::splat(EXTENT_MM), 200.0)
}

/// Set-points of a lamp, degrees.
pub fn at(azimuth_deg: f64, elevation_deg: f64) -> StageAngles {
    StageAngles::new(azimuth_deg, elevation_deg)
}

/// A far lamp and two near ones as they are described.
pub fn lights() -> Vec<(Light, StageAngles)> {
    let near = |angles: StageAngles| Light::Point {
        position_mm: angles.to_light() * NEAR_MM,
        intensity_mm2: STATED.map(|e| e * NEAR_MM * NEAR_MM),
    };
    let far = at(0.0, 60.0);
    let sun = Light::Directional {
        to_light: far.to_light(),
        irradiance: STATED,
        angular_radius_rad: 0.0,
    };
    let near = [at(120.0, 50.0), at(240.0, 70.0)].map(|angles| (near(angles), angles));
    [(sun, far), near[0], near[1]].to_vec()
}

/// By hand: the lamp's inverse square and cosine at each pixel's middle, times the
/// light's own strength and falloff, on a standard of this reflectance; noise of 2%.
pub fn photograph(light: usize, factor: f64, reflectance: f64, seed: u64) -> RadianceImage {
    let mut image = RadianceImage::new(SIDE, SIDE);
    let pixel_mm = EXTENT_MM / SIDE as f64;
    let lamp = lights()[light].0;
    for pixel in 0..SIDE * SIDE {
        let x = ((pixel % SIDE) as f64 + 0.5) * pixel_mm - 0.5 * EXTENT_MM;
        let y = 0.5 * EXTENT_MM - ((pixel / SIDE) as f64 + 0.5) * pixel_mm;
        let lit = match lamp {
            Light::Directional { to_light, .. } => to_light.z,
            Light::Point { position_mm, .. } => {
                let way = position_mm - DVec3::new(x, y, HEIGHT_MM);
                NEAR_MM * NEAR_MM * way.z / way.length().powi(3)
            }
        };
        let uneven = 1.0 + shape(light)[0] * x + shape(light)[1] * x * y;
        for (channel, stated) in STATED.into_iter().enumerate() {
            let truth = reflectance / PI * stated * lit * factor * uneven;
            let std = 0.02 * truth;
            let key = (light * 3 + channel) as u64;
            let mut random = stream(seed, Purpose::Experiment, key, pixel as u64, 0);
            image.mean[pixel][channel] = (truth + std * random.normal()) as f32;
            image.variance[pixel][channel] = (std * std) as f32;
        }
    }
    image
}

/// True falloff of a light: slope along x (1/mm) and curvature of xy (1/mm²).
pub fn shape(light: usize) -> [f64; 2] {
    [[0.004, 0.0], [-0.002, 2e-4], [0.0, -1e-4]][light]
}
