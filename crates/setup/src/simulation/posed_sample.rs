//! Photographs of a sample whose pose is sought: rendered with all interreflections, of a
//! material that an alignment does not know, blurred and noisy.

use std::sync::Arc;

use glam::{DQuat, DVec2, DVec3};

use crate::brdf::{Dictionary, Mixture};
use crate::geometry::{Mesh, Shape};
use crate::radiance_image::RadianceImage;
use crate::random::{Purpose, stream};
use crate::transport::{Camera, Light, Projection, RenderOptions, Scene, Shading, render};
use crate::units::StageAngles;

/// Pixels along each side of the photographs.
pub const SIZE: usize = 40;
/// Azimuth and elevation of the lights, degrees.
const LIGHTS: [[f64; 2]; 2] = [[20.0, 50.0], [200.0, 60.0]];

/// A sample under two parallel lights, each turned by these angles (radians) about the
/// sample's z and x.
pub fn scene(mesh: Mesh, projection: Projection, turned_rad: [[f64; 2]; 2]) -> Scene {
    let camera = Camera::looking_at(
        [SIZE; 2],
        projection,
        DVec3::new(0.0, 0.0, 200.0),
        DVec3::ZERO,
        DVec3::Y,
    )
    .expect("it does not look along its own up");
    let light =
        |(&[azimuth_deg, elevation_deg], [z, x]): (&[f64; 2], [f64; 2])| Light::Directional {
            to_light: DQuat::from_rotation_z(z)
                * DQuat::from_rotation_x(x)
                * StageAngles::new(azimuth_deg, elevation_deg).to_light(),
            irradiance: [1.0, 2.0, 0.5],
            angular_radius_rad: 0.0,
        };
    let lights = LIGHTS.iter().zip(turned_rad).map(light).collect();
    Scene::new(mesh, Shading::Smooth, camera, lights)
}

/// A camera that sees 26 mm.
pub fn telecentric() -> Projection {
    Projection::Orthographic {
        extent_mm: DVec2::splat(26.0),
    }
}

/// A glossy mixture of which the alignment knows nothing.
fn material() -> Mixture {
    let dictionary = Arc::new(Dictionary::paper42());
    let mut weights = vec![0.0; dictionary.len()];
    (weights[32], weights[38], weights[40], weights[41]) = (0.2, 0.2, 0.4, 0.2);
    Mixture::grey(dictionary, weights).expect("weights of the dictionary's length")
}

/// Photographs of `truth`: blurred by [1 2 1]/4 along both axes (variance ½ px²), with
/// noise of 1% of the signal and 0.2% of the brightest.
pub fn photographs(truth: &Scene, seed: u64) -> Vec<RadianceImage> {
    let options = RenderOptions {
        samples_per_pixel: 32,
        max_reflections: 4,
        seed,
        ..RenderOptions::default()
    };
    let mut images = render(truth, &material(), &options);
    let mut numbers = stream(seed, Purpose::Experiment, 0, 0, 0);
    for image in &mut images {
        let (width, height) = (image.width, image.height);
        for stride in [1, width] {
            let mean = image.mean.clone();
            for (p, value) in image.mean.iter_mut().enumerate() {
                let at = if stride == 1 { p % width } else { p / width };
                let last = if stride == 1 { width } else { height } - 1;
                let [a, b] = [
                    p - stride * usize::from(at > 0),
                    p + stride * usize::from(at < last),
                ];
                *value =
                    [0, 1, 2].map(|c| 0.25 * mean[a][c] + 0.5 * mean[p][c] + 0.25 * mean[b][c]);
            }
        }
        let brightest = image.mean.iter().map(|m| m[1]).fold(0.0, f32::max);
        for (mean, variance) in image.mean.iter_mut().zip(&mut image.variance) {
            for (m, v) in mean.iter_mut().zip(variance) {
                *v = (0.01 * *m).powi(2) + (0.002 * brightest).powi(2);
                *m += v.sqrt() * numbers.normal() as f32;
            }
        }
    }
    images
}

/// A bowl of 10 mm, tessellated in so many segments.
pub fn bowl(segments: u32) -> Shape {
    Shape::Bowl {
        radius_mm: 10.0,
        segments,
    }
}

/// A concave corner of three faces.
pub fn corner(_: u32) -> Shape {
    Shape::Tetrahedron {
        radius_mm: 10.0,
        depth_mm: 7.0,
    }
}
