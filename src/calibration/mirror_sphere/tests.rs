//! Photographs of glossy spheres, ray by ray, from microfacets, a blur and noise of the
//! tests' own; what is found in them against what was drawn.

use std::f64::consts::PI;

use nalgebra::{DMatrix, DVector};

use super::light::tangents;
use super::outline::Stated;
use super::*;
use crate::random::{Purpose, Stream, stream};
use crate::transport::{Coefficients, LensSpec};

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
        let count = self.centres.len();
        spheres_in(images, None, &self.camera, &self.stated(), &[], count)
    }

    fn lights(
        &self,
        seed: u64,
        stated_mm: Option<f64>,
    ) -> Result<(Vec<FoundLight>, Option<Measured>), SphereError> {
        let images = self.photographs(seed);
        let spheres = self.spheres(&images)?;
        let stated_mm = vec![stated_mm; images.len()];
        locate_all(&self.camera, &spheres, &images, DVec3::ZERO, &stated_mm)
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

fn angle_deg(found: &FoundLight, truth: DVec3) -> f64 {
    found.to_light.angle_between(truth.normalize()).to_degrees()
}

/// 12 benches of six lights each: every direction within 0.1°, and the errors over their
/// stated uncertainty, the spheres' share included, a unit normal: the mean square of 144
/// numbers within 5 standard deviations of 1.
#[test]
fn directions_are_recovered_within_their_uncertainty() {
    let (mut sum, mut count) = (0.0, 0.0);
    for seed in 0..12 {
        let bench = bench(seed);
        let lights = bench.lights(seed, None).unwrap().0;
        let errors = lights.iter().zip(&bench.lamps).flat_map(|(found, lamp)| {
            let off = angle_deg(found, *lamp);
            assert!(off < 0.1, "seed {seed}: {off}");
            let error = lamp.normalize() - found.to_light;
            tangents(found.to_light).map(|t| t.dot(error))
        });
        let errors = DVector::from_vec(errors.collect());
        // The covariance of all lights together: the sphere's share is common.
        let shared = DMatrix::from_fn(errors.len(), 3, |row, k| {
            lights[row / 2].shared[(row % 2, k)]
        });
        let mut covariance = &shared * shared.transpose();
        for (k, light) in lights.iter().enumerate() {
            let mut own = covariance.fixed_view_mut::<2, 2>(2 * k, 2 * k);
            own += light.own;
        }
        let root = covariance.cholesky().unwrap().l();
        sum += root.solve_lower_triangular(&errors).unwrap().norm_squared();
        count += errors.len() as f64;
    }
    let (mean, std) = (sum / count, (2.0f64 / count).sqrt());
    assert!((mean - 1.0).abs() < 5.0 * std, "{mean} ± {std}");
}

/// Two spheres under a lamp 300 mm away, seen in perspective: its distance and, from the
/// middle of the stage, its direction, though neither sphere is there.
#[test]
fn two_spheres_tell_how_far_the_lamp_is() {
    for seed in 0..3 {
        let mut near = bench(seed);
        near.camera = camera(
            Projection::Perspective { fov_rad: 0.2 },
            DVec3::new(0.0, 0.0, 200.0),
        );
        near.radius_mm = 9.0;
        near.centres = vec![DVec3::new(-9.9, 1.0, 0.0), DVec3::new(9.7, -1.0, 1.0)];
        near.lamps = vec![
            lamp(300.0, 20.0, 55.0),
            lamp(300.0, 140.0, 70.0),
            lamp(300.0, 260.0, 60.0),
        ];
        let (lights, distance) = near.lights(seed, None).unwrap();
        let distance = distance.unwrap();
        let off = (distance.value - 300.0) / distance.std;
        assert!(
            off.abs() < 4.0 && distance.std < 15.0,
            "seed {seed}: {distance:?}"
        );
        for (found, lamp) in lights.iter().zip(&near.lamps) {
            let off = angle_deg(found, *lamp);
            assert!(off < 0.1, "seed {seed}: {off}");
        }
    }
}

/// One sphere under a near lamp: right with the distance, wrong by degrees without.
#[test]
fn a_near_lamp_is_not_far() {
    let mut near = bench(3);
    near.centres = vec![DVec3::new(1.0, -0.5, 4.0)];
    near.lamps = (0..4)
        .map(|k| lamp(300.0, 90.0 * f64::from(k), 60.0))
        .collect();
    let known = near.lights(1, Some(300.0)).unwrap().0;
    let parallel = near.lights(1, None).unwrap().0;
    for ((known, parallel), lamp) in known.iter().zip(&parallel).zip(&near.lamps) {
        assert!(angle_deg(known, *lamp) < 0.1);
        assert!(angle_deg(parallel, *lamp) > 0.3);
    }
}

/// A lens that bends the sphere's outline by pixels, stated as it is.
#[test]
fn a_distorting_lens_is_undone() {
    let mut bent = bench(2);
    let spec = LensSpec {
        principal_offset: DVec2::new(0.05, -0.04),
        aspect: 1.0,
        distortion: Coefficients {
            radial: [-0.03, 0.01, 0.0],
            tangential: [0.003, 0.0],
        },
    };
    bent.camera = bent.camera.with_lens(spec).unwrap();
    bent.lamps.truncate(1);
    let found = bent.lights(1, None).unwrap().0;
    for (found, lamp) in found.iter().zip(&bent.lamps) {
        let off = angle_deg(found, *lamp);
        assert!(off < 0.15, "{off}");
    }
}

#[test]
fn pictures_that_tell_nothing_are_refused_by_name() {
    let good = bench(1);
    let refused = |change: &dyn Fn(&mut Bench)| {
        let mut bench = good.clone();
        change(&mut bench);
        bench.lights(1, None).unwrap_err()
    };
    let outside = refused(&|b| b.centres[0].x = 7.0);
    assert!(
        matches!(outside, SphereError::OutsideView { .. }),
        "{outside}"
    );
    let dull = refused(&|b| b.roughness = 0.8);
    assert!(matches!(dull, SphereError::NoHighlight { .. }), "{dull}");
    let gone = refused(&|b| b.centres[0].x = 1e4);
    assert!(matches!(gone, SphereError::NoOutline { .. }), "{gone}");
    let tiny = refused(&|b| b.radius_mm = 1.0);
    assert!(matches!(tiny, SphereError::Impossible { .. }), "{tiny}");

    let images = good.photographs(1);
    let sphere = &good.spheres(&images).unwrap()[0];
    let highlight = highlight::find(&images[0], sphere, 0).unwrap();
    let at = highlight.position_px.floor();
    let mut saturated = images[0].clone();
    saturated.valid[at.y as usize * WIDTH + at.x as usize] = false;
    let error = highlight::find(&saturated, sphere, 0).unwrap_err();
    assert!(matches!(error, SphereError::Saturated { .. }), "{error}");

    let mut two = images[0].clone();
    for (sum, other) in two.value.iter_mut().zip(&images[2].value) {
        *sum += 0.5 * other;
    }
    let error = highlight::find(&two, sphere, 0).unwrap_err();
    assert!(
        matches!(error, SphereError::TwoHighlights { .. }),
        "{error}"
    );

    let mut small = images.clone();
    small[1].width = WIDTH / 2;
    let stated = good.stated();
    let error = spheres_in(&small, None, &good.camera, &stated, &[], 1).unwrap_err();
    assert!(matches!(error, SphereError::Size { .. }), "{error}");
    // A sphere a tenth larger than stated, pointed at by hand.
    let stated = Stated {
        radius_mm: 0.9 * good.radius_mm,
        ..good.stated()
    };
    let near = [sphere.circle];
    let error = spheres_in(&images, None, &good.camera, &stated, &near, 1).unwrap_err();
    assert!(matches!(error, SphereError::Radius { .. }), "{error}");
}
