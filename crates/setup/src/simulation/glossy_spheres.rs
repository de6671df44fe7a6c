//! Photographs of glossy spheres, ray by ray, from microfacets, a blur and noise of their
//! own: nothing of it is shared with what finds lights in them.

use std::f64::consts::PI;

use glam::{DVec2, DVec3};

use super::pixels;
use crate::radiance_image::RadianceImage;
use crate::random::{Purpose, Stream, stream};
use crate::transport::{Camera, Projection};

/// Size of the photographs, pixels.
pub const SIZE: [usize; 2] = [110, 100];

/// Spheres before a camera, and the lamps that light them one after the other.
#[derive(Clone)]
pub struct GlossySpheres {
    /// Of [`SIZE`].
    pub camera: Camera,
    /// Middles, sample frame, mm.
    pub centres_mm: Vec<DVec3>,
    /// Of all spheres, mm.
    pub radius_mm: f64,
    /// Lamps, sample frame, mm; a large distance is parallel light.
    pub lamps_mm: Vec<DVec3>,
    /// GGX roughness of the coat.
    pub roughness: f64,
    /// Radiance next to the spheres.
    pub background: f64,
    /// Standard deviation of the blur, pixels.
    pub blur_px: f64,
    /// Noise over the root of the radiance, and a constant one.
    pub noise: [f64; 2],
}

/// Where a lamp stands, mm.
pub fn lamp(distance_mm: f64, azimuth_deg: f64, elevation_deg: f64) -> DVec3 {
    let (az, el) = (azimuth_deg.to_radians(), elevation_deg.to_radians());
    DVec3::new(el.cos() * az.cos(), el.cos() * az.sin(), el.sin()) * distance_mm
}

/// A camera 200 mm above the sample that looks down on it.
pub fn camera(projection: Projection) -> Camera {
    let from = DVec3::new(0.0, 0.0, 200.0);
    Camera::looking_at(SIZE, projection, from, DVec3::ZERO, DVec3::Y)
        .expect("it does not look along its own up")
}

impl GlossySpheres {
    /// One sphere of some 9 mm, not quite in the middle of a telecentric camera's view,
    /// under parallel light from six sides.
    pub fn under_six_lights(seed: u64) -> Self {
        let mut random = stream(seed, Purpose::Experiment, 8, 0, 0);
        let mut near = |size: f64| size * (2.0 * random.uniform() - 1.0);
        let lamps = (0..6).map(|k| {
            let azimuth_deg = 60.0 * f64::from(k) + near(25.0);
            lamp(1e9, azimuth_deg, 62.0 + near(25.0))
        });
        let extent_mm = DVec2::new(27.5, 25.0);
        Self {
            lamps_mm: lamps.collect(),
            camera: camera(Projection::Orthographic { extent_mm }),
            centres_mm: vec![DVec3::new(near(1.0), near(1.0), 0.0)],
            radius_mm: 9.0 + near(0.1),
            roughness: 0.015,
            background: 0.0004,
            blur_px: 0.6,
            noise: [0.004, 2e-5],
        }
    }

    /// Two such spheres in perspective, under a lamp that stands 300 mm away.
    pub fn under_a_near_lamp(seed: u64) -> Self {
        let one = Self::under_six_lights(seed);
        // Other places among the pixels on every bench.
        let moved = 0.4 * one.centres_mm[0];
        Self {
            camera: camera(Projection::Perspective { fov_rad: 0.2 }),
            radius_mm: 9.0,
            centres_mm: vec![
                DVec3::new(-9.9, 1.0, 0.0) + moved,
                DVec3::new(9.7, -1.0, 1.0) + moved,
            ],
            lamps_mm: vec![
                lamp(300.0, 20.0, 55.0),
                lamp(300.0, 140.0, 70.0),
                lamp(300.0, 260.0, 60.0),
            ],
            ..one
        }
    }

    /// Radiance along one ray under one lamp: a grey base under a GGX coat.
    fn radiance(&self, at_px: DVec2, lamp: DVec3) -> f64 {
        let ray = self.camera.ray(at_px, DVec2::ZERO);
        let (origin, direction) = (ray.origin_mm.as_dvec3(), ray.direction.as_dvec3());
        let hit = self.centres_mm.iter().find_map(|&centre| {
            let to = origin - centre;
            let b = to.dot(direction);
            let d = b * b - to.length_squared() + self.radius_mm * self.radius_mm;
            (d > 0.0)
                .then(|| origin + direction * (-b - d.sqrt()))
                .map(|p| (p, (p - centre) / self.radius_mm))
        });
        let Some((point, normal)) = hit else {
            return self.background;
        };
        let light = (lamp - point).normalize();
        let half = (light - direction).normalize();
        let (cos_light, cos_view) = (normal.dot(light), -normal.dot(direction));
        if cos_light <= 0.0 {
            return 0.0;
        }
        let a2 = self.roughness * self.roughness;
        let cos2 = normal.dot(half).powi(2);
        let lobe = a2 / (PI * (cos2 * (a2 - 1.0) + 1.0).powi(2));
        let fresnel = 0.04 + 0.96 * (1.0 - half.dot(light)).powi(5);
        cos_light * (0.05 / PI + fresnel * lobe / (4.0 * cos_light * cos_view))
    }

    fn photograph(&self, lamp: DVec3, random: &mut Stream) -> RadianceImage {
        let means = pixels::means(SIZE, self.blur_px, |at| self.radiance(at, lamp));
        let mut image = RadianceImage::new(SIZE[0], SIZE[1]);
        for (p, mean) in means.into_iter().enumerate() {
            let std = self.noise[0] * mean.max(0.0).sqrt() + self.noise[1];
            for channel in 0..3 {
                image.mean[p][channel] = (mean + std * random.normal()) as f32;
                image.variance[p][channel] = (std * std) as f32;
            }
        }
        image
    }

    /// One image per lamp, noisy.
    pub fn photographs(&self, seed: u64) -> Vec<RadianceImage> {
        let mut random = stream(seed, Purpose::Experiment, 9, 0, 0);
        let lamps = self.lamps_mm.iter();
        lamps.map(|&l| self.photograph(l, &mut random)).collect()
    }
}
