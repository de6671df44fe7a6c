//! Photographs of glossy spheres, ray by ray, from microfacets, a blur and noise of the
//! tests' own; what is found in them against what was drawn.

use std::f64::consts::PI;

use super::highlight::find;
use super::light::{Distance, FoundLight, locate, tangents};
use super::outline::{Stated, expected_radius_px, fit};
use super::search::circles;
use super::*;
use crate::random::{Purpose, Stream, stream};

/// What is photographed.
#[derive(Clone)]
struct Bench {
    camera: Camera,
    /// Middles and radius, sample frame, mm.
    centres: Vec<DVec3>,
    radius_mm: f64,
    /// Lamps; a large distance is parallel light.
    lamps: Vec<DVec3>,
    roughness: f64,
    background: f64,
    blur_px: f64,
    /// Noise over the root of the radiance, and a constant one.
    noise: [f64; 2],
}

const WIDTH: usize = 110;
const HEIGHT: usize = 100;
const SUB: usize = 3;

fn camera(projection: Projection, position_mm: DVec3) -> Camera {
    Camera::looking_at(
        [WIDTH, HEIGHT],
        projection,
        position_mm,
        DVec3::ZERO,
        DVec3::Y,
    )
    .unwrap()
}

fn telecentric() -> Camera {
    let extent_mm = DVec2::new(27.5, 25.0);
    camera(
        Projection::Orthographic { extent_mm },
        DVec3::new(0.0, 0.0, 200.0),
    )
}

fn lamp(distance_mm: f64, azimuth_deg: f64, elevation_deg: f64) -> DVec3 {
    let (az, el) = (azimuth_deg.to_radians(), elevation_deg.to_radians());
    DVec3::new(el.cos() * az.cos(), el.cos() * az.sin(), el.sin()) * distance_mm
}

impl Bench {
    /// Radiance along one ray under one lamp: a grey base under a GGX coat.
    fn radiance(&self, at_px: DVec2, lamp: DVec3) -> f64 {
        let ray = self.camera.ray(at_px, DVec2::ZERO);
        let (origin, direction) = (ray.origin_mm.as_dvec3(), ray.direction.as_dvec3());
        let hit = self.centres.iter().find_map(|&centre| {
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

    /// The image under one lamp: means over each pixel's area, blurred, noisy.
    fn photograph(&self, lamp: DVec3, random: &mut Stream) -> RadianceImage {
        let (w, h) = (WIDTH * SUB, HEIGHT * SUB);
        let fine: Vec<f64> = (0..w * h)
            .map(|i| {
                let at = DVec2::new((i % w) as f64 + 0.5, (i / w) as f64 + 0.5) / SUB as f64;
                self.radiance(at, lamp)
            })
            .collect();
        let blurred = blur(
            &blur(&fine, w, self.blur_px * SUB as f64, 1),
            w,
            self.blur_px * SUB as f64,
            w,
        );
        let mut image = RadianceImage::new(WIDTH, HEIGHT);
        for p in 0..WIDTH * HEIGHT {
            let (x, y) = (p % WIDTH, p / WIDTH);
            let mut mean = 0.0;
            for row in y * SUB..(y + 1) * SUB {
                for column in x * SUB..(x + 1) * SUB {
                    mean += blurred[row * w + column] / (SUB * SUB) as f64;
                }
            }
            for channel in 0..3 {
                let std = self.noise[0] * mean.max(0.0).sqrt() + self.noise[1];
                image.mean[p][channel] = (mean + std * random.normal()) as f32;
                image.variance[p][channel] = (std * std) as f32;
            }
        }
        image
    }

    fn photographs(&self, seed: u64) -> Vec<Grey> {
        let mut random = stream(seed, Purpose::Experiment, 9, 0, 0);
        let images = self
            .lamps
            .iter()
            .map(|&l| Grey::of(&self.photograph(l, &mut random)));
        images.collect()
    }

    fn stated(&self) -> Stated {
        Stated {
            radius_mm: self.radius_mm,
            height_mm: self.centres[0].z,
        }
    }

    fn spheres(&self, images: &[Grey]) -> Result<Vec<Sphere>, SphereError> {
        let mean = Grey::mean(images).unwrap();
        let stated = self.stated();
        let expected = expected_radius_px(&self.camera, &stated);
        let range = match self.camera.projection {
            Projection::Orthographic { .. } => [0.95, 1.05],
            Projection::Perspective { .. } => [0.8, 1.25],
        };
        let found = circles(&mean, expected, range, stated.radius_mm, self.centres.len())?;
        found
            .iter()
            .map(|c| fit(&mean, &self.camera, &stated, c))
            .collect()
    }

    fn lights(&self, seed: u64, distance: Distance) -> Result<Vec<FoundLight>, SphereError> {
        let images = self.photographs(seed);
        let spheres = self.spheres(&images)?;
        let lights = images.iter().enumerate().map(|(index, image)| {
            let highlights: Result<Vec<_>, _> =
                spheres.iter().map(|s| find(image, s, index)).collect();
            locate(
                &self.camera,
                &spheres,
                &highlights?,
                DVec3::ZERO,
                distance,
                index,
            )
        });
        lights.collect()
    }
}

/// Gaussian blur along one axis of a picture whose rows have `width` numbers.
fn blur(values: &[f64], width: usize, sigma: f64, stride: usize) -> Vec<f64> {
    let reach = (4.0 * sigma).ceil() as i64;
    let kernel: Vec<f64> = (-reach..=reach)
        .map(|k| (-0.5 * (k as f64 / sigma).powi(2)).exp())
        .collect();
    let sum: f64 = kernel.iter().sum();
    let height = values.len() / width;
    (0..values.len())
        .map(|i| {
            let (at, count) = match stride {
                1 => (i % width, width),
                _ => (i / width, height),
            };
            let mut total = 0.0;
            for (k, weight) in kernel.iter().enumerate() {
                let wanted = (at as i64 + k as i64 - reach).clamp(0, count as i64 - 1);
                let index = (i as i64 + (wanted - at as i64) * stride as i64) as usize;
                total += weight * values[index];
            }
            total / sum
        })
        .collect()
}

/// One sphere, telecentric, parallel light from all around, not quite in the middle.
fn bench(seed: u64) -> Bench {
    let mut random = stream(seed, Purpose::Experiment, 8, 0, 0);
    let mut near = |size: f64| size * (2.0 * random.uniform() - 1.0);
    let lamps = (0..6).map(|k| {
        let (azimuth_deg, elevation_deg) = (60.0 * f64::from(k) + near(25.0), 62.0 + near(25.0));
        lamp(1e9, azimuth_deg, elevation_deg)
    });
    Bench {
        lamps: lamps.collect(),
        camera: telecentric(),
        centres: vec![DVec3::new(near(1.0), near(1.0), 0.0)],
        radius_mm: 9.0 + near(0.1),
        roughness: 0.015,
        background: 0.0004,
        blur_px: 0.6,
        noise: [0.004, 2e-5],
    }
}

/// Errors over stated uncertainties along both tangents, in whitened numbers.
fn pulls(found: &FoundLight, truth: DVec3) -> [f64; 2] {
    let error = truth - found.to_light;
    let [a, e] = tangents(found.to_light).map(|t| t.dot(error));
    let root = found.covariance().cholesky().unwrap().l();
    let white = root
        .solve_lower_triangular(&nalgebra::Vector2::new(a, e))
        .unwrap();
    [white[0], white[1]]
}

fn angle_deg(found: &FoundLight, truth: DVec3) -> f64 {
    found.to_light.angle_between(truth.normalize()).to_degrees()
}

#[test]
fn look() {
    let mut all = Vec::new();
    let mut sphere_pulls = Vec::new();
    for seed in 0..24 {
        let b = bench(seed);
        let images = b.photographs(seed);
        let t = std::time::Instant::now();
        let spheres = b.spheres(&images).unwrap();
        let took = t.elapsed();
        let s = &spheres[0];
        let truth = b.camera.sample_from_camera.inverse().point(b.centres[0]);
        let e = [
            s.centre_mm.x - truth.x,
            s.centre_mm.y - truth.y,
            s.radius_mm - b.radius_mm,
        ];
        let std: Vec<f64> = (0..3).map(|i| s.covariance[(i, i)].sqrt()).collect();
        eprintln!(
            "{seed} {took:?} err px {:?} std px {:?} blur {}",
            e.map(|v| v * 4.0),
            std.iter().map(|v| v * 4.0).collect::<Vec<_>>(),
            s.blur_px
        );
        for i in 0..3 {
            sphere_pulls.push(e[i] / std[i]);
        }
        let lights = b.lights(seed, Distance::Infinite).unwrap();
        for (l, truth) in lights.iter().zip(&b.lamps) {
            let p = pulls(l, truth.normalize());
            all.extend(p);
            if seed < 6 {
                eprintln!(
                    "   {:.4} deg, pulls {p:?} own {:?} shared {:?}",
                    angle_deg(l, *truth),
                    l.own.diagonal().map(|v| v.sqrt().to_degrees()),
                    (l.covariance() - l.own)
                        .diagonal()
                        .map(|v| v.sqrt().to_degrees())
                );
            }
        }
    }
    eprintln!(
        "sphere chi2/n {}",
        sphere_pulls.iter().map(|p| p * p).sum::<f64>() / sphere_pulls.len() as f64
    );
    eprintln!(
        "chi2/n {}",
        all.iter().map(|p| p * p).sum::<f64>() / all.len() as f64
    );
}
