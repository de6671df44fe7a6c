//! Bowls that are turned: shaded by formulas of their own, because the library's materials
//! are all isotropic.

use std::f64::consts::PI;

use super::*;
use crate::geometry::Shape;
use crate::random::{Purpose, stream};
use crate::transport::{Camera, Light, Shading};

const SIZE: usize = 40;
const REPEATABILITY: f64 = 0.01;

fn scene(shape: Shape) -> Scene {
    let camera = Camera::above([SIZE, SIZE], DVec2::splat(24.0), 200.0);
    let light = |k: i32| {
        let (sin, cos) = (2.1 * f64::from(k)).sin_cos();
        Light::distant(DVec3::new(0.5 * cos, 0.5 * sin, 0.866), [1.0; 3])
    };
    let lights = (0..3).map(light).collect();
    Scene::new(shape.mesh().unwrap(), Shading::Flat, camera, lights)
}

fn bowl() -> Scene {
    scene(Shape::Bowl {
        radius_mm: 10.0,
        segments: 64,
    })
}

/// What the sample is made of.
#[derive(Clone, Copy)]
struct Material {
    /// Roughness along and across its grain.
    roughness: [f64; 2],
    /// How much brighter one half is, relative.
    halves: f64,
}

const GOOD: Material = Material {
    roughness: [0.3, 0.3],
    halves: 0.0,
};

/// Diffuse base under Ward's anisotropic lobe, its grain along the sample's x, on a sphere
/// around the origin seen from above; seated 0.02 mm off, under a lamp that changed by 2%.
fn photographs(scene: &Scene, material: Material, angle_deg: f64, seed: u64) -> Vec<RadianceImage> {
    let mut numbers = stream(seed, Purpose::Experiment, 30, angle_deg.to_bits(), 0);
    let surface = Surface::of(scene);
    let turn = DQuat::from_rotation_z(angle_deg.to_radians());
    let lamp = 1.0 + 0.02 * numbers.normal();
    let seat = DVec3::new(numbers.normal(), numbers.normal(), 0.0) * 0.02;
    let images = scene.lights.iter().map(|light| {
        let Light::Directional { to_light, .. } = light else {
            panic!("another light");
        };
        let mut image = RadianceImage::new(SIZE, SIZE);
        for (pixel, point) in surface.points.iter().enumerate() {
            let value = point.map_or(0.0, |point| {
                // Back to where it was before the turn.
                let own = turn.inverse() * (point - seat);
                let light = turn.inverse() * *to_light;
                let normal = -own.normalize();
                let grain = (DVec3::X - normal * normal.x).normalize();
                let half = (light + DVec3::Z).normalize();
                let across = normal.cross(grain);
                let tilt = |axis: DVec3, width: f64| (half.dot(axis) / width).powi(2);
                let [along, wide] = material.roughness;
                let lobe = (-(tilt(grain, along) + tilt(across, wide)) / half.dot(normal).powi(2))
                    .exp()
                    / (4.0 * PI * along * wide);
                let base = 0.3 * (1.0 + material.halves * own.x.signum()) / PI;
                lamp * normal.dot(light).max(0.0) * (base + 0.2 * lobe)
            });
            for channel in 0..3 {
                let std = 0.01 * value + 1e-4;
                image.mean[pixel][channel] = (value + std * numbers.normal()) as f32;
                image.variance[pixel][channel] = (std * std) as f32;
            }
        }
        image
    });
    images.collect()
}

fn turned(scene: &Scene, material: Material, seed: u64) -> RotationTest {
    let angles = [0.0, 90.0, 180.0];
    let images: Vec<_> = angles
        .iter()
        .map(|angle| photographs(scene, material, *angle, seed))
        .collect();
    let turns: Vec<Turn> = angles
        .iter()
        .zip(&images)
        .map(|(&angle_deg, images)| Turn { angle_deg, images })
        .collect();
    compare(scene, &turns, REPEATABILITY).unwrap()
}

/// Good samples pass, at least as often as the significance says: 30 trials at 5% have more
/// than 6 false alarms once in 500.
#[test]
fn a_good_sample_passes() {
    let scene = bowl();
    let alarms = (0..30).filter(|&seed| !turned(&scene, GOOD, seed).passes(0.05));
    let alarms = alarms.count();
    eprintln!("{alarms} false alarms of 30 at 5%");
    assert!(alarms <= 6, "{alarms}");
}

/// A grain is found as one, two halves as such.
#[test]
fn a_grain_and_two_materials_are_flagged() {
    let scene = bowl();
    for seed in 0..5 {
        let grain = Material {
            roughness: [0.2, 0.4],
            ..GOOD
        };
        let test = turned(&scene, grain, seed);
        assert!(test.isotropy.p < 1e-3, "{test:?}");
        let halves = Material {
            halves: 0.06,
            ..GOOD
        };
        let test = turned(&scene, halves, seed);
        assert!(test.uniformity.p < 1e-3, "{test:?}");
        assert!(test.uniformity.p <= test.isotropy.p, "{test:?}");
    }
}

#[test]
fn what_cannot_be_compared_is_refused() {
    let scene = bowl();
    let images = photographs(&scene, GOOD, 0.0, 1);
    let turn = |angle_deg| Turn {
        angle_deg,
        images: &images,
    };
    assert_eq!(
        compare(&scene, &[turn(0.0)], 0.01).unwrap_err(),
        RotationError::TooFew { found: 1 }
    );
    let short = Turn {
        angle_deg: 90.0,
        images: &images[..1],
    };
    assert_eq!(
        compare(&scene, &[turn(0.0), short], 0.01).unwrap_err(),
        RotationError::Differs { index: 1 }
    );
    let corner = self::scene(Shape::Tetrahedron {
        radius_mm: 10.0,
        depth_mm: 7.0,
    });
    let refused = compare(&corner, &[turn(0.0), turn(90.0)], 0.01).unwrap_err();
    assert!(
        matches!(refused, RotationError::NotSymmetric { angle_deg, .. } if angle_deg == 90.0),
        "{refused}"
    );
    // A three-sided corner is the same after a third of a turn, and dark images say nothing.
    let dark = [(); 3].map(|()| RadianceImage::new(SIZE, SIZE));
    let turn = |angle_deg| Turn {
        angle_deg,
        images: &dark,
    };
    let refused = compare(&corner, &[turn(0.0), turn(120.0)], 0.01).unwrap_err();
    assert!(
        matches!(refused, RotationError::NothingSeen { .. }),
        "{refused}"
    );
}
