//! Photographs of glossy spheres: what is found in them against what was drawn.

use nalgebra::{DMatrix, DVector};

use super::light::tangents;
use super::outline::Stated;
use super::*;
use crate::simulation::glossy_spheres::{GlossySpheres, SIZE, lamp};
use crate::transport::{Coefficients, LensSpec};

const WIDTH: usize = SIZE[0];

fn photographs(bench: &GlossySpheres, seed: u64) -> Vec<Grey> {
    bench.photographs(seed).iter().map(Grey::of).collect()
}

fn stated(bench: &GlossySpheres) -> Stated {
    Stated {
        radius_mm: bench.radius_mm,
        height_mm: bench.centres_mm[0].z,
    }
}

fn spheres(bench: &GlossySpheres, images: &[Grey]) -> Result<Vec<Sphere>, SphereError> {
    let count = bench.centres_mm.len();
    spheres_in(images, None, &bench.camera, &stated(bench), &[], count)
}

fn lights(
    bench: &GlossySpheres,
    seed: u64,
    stated_mm: Option<f64>,
) -> Result<(Vec<FoundLight>, Option<Measured>), SphereError> {
    let images = photographs(bench, seed);
    let spheres = spheres(bench, &images)?;
    let stated_mm = vec![stated_mm; images.len()];
    locate_all(&bench.camera, &spheres, &images, DVec3::ZERO, &stated_mm)
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
        let bench = GlossySpheres::under_six_lights(seed);
        let found = lights(&bench, seed, None).unwrap().0;
        let errors = found.iter().zip(&bench.lamps_mm).flat_map(|(found, lamp)| {
            let off = angle_deg(found, *lamp);
            assert!(off < 0.1, "seed {seed}: {off}");
            let error = lamp.normalize() - found.to_light;
            tangents(found.to_light).map(|t| t.dot(error))
        });
        let errors = DVector::from_vec(errors.collect());
        // The covariance of all lights together: the sphere's share is common.
        let shared = DMatrix::from_fn(errors.len(), 3, |row, k| {
            found[row / 2].shared[(row % 2, k)]
        });
        let mut covariance = &shared * shared.transpose();
        for (k, light) in found.iter().enumerate() {
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
fn two_spheres_determine_the_distance_of_the_lamp() {
    for seed in 0..3 {
        let near = GlossySpheres::under_a_near_lamp(seed);
        let (found, distance) = lights(&near, seed, None).unwrap();
        let distance = distance.unwrap();
        let off = (distance.value - 300.0) / distance.std;
        assert!(
            off.abs() < 4.0 && distance.std < 15.0,
            "seed {seed}: {distance:?}"
        );
        for (found, lamp) in found.iter().zip(&near.lamps_mm) {
            let off = angle_deg(found, *lamp);
            assert!(off < 0.1, "seed {seed}: {off}");
        }
    }
}

/// One sphere under a near lamp: right with the distance, wrong by degrees without.
#[test]
fn a_near_lamp_is_not_far() {
    let mut near = GlossySpheres::under_six_lights(3);
    near.centres_mm = vec![DVec3::new(1.0, -0.5, 4.0)];
    near.lamps_mm = (0..4)
        .map(|k| lamp(300.0, 90.0 * f64::from(k), 60.0))
        .collect();
    let known = lights(&near, 1, Some(300.0)).unwrap().0;
    let parallel = lights(&near, 1, None).unwrap().0;
    for ((known, parallel), lamp) in known.iter().zip(&parallel).zip(&near.lamps_mm) {
        assert!(angle_deg(known, *lamp) < 0.1);
        assert!(angle_deg(parallel, *lamp) > 0.3);
    }
}

/// A lens that bends the sphere's outline by pixels, stated as it is.
#[test]
fn a_distorting_lens_is_undone() {
    let mut bent = GlossySpheres::under_six_lights(2);
    let spec = LensSpec {
        principal_offset: DVec2::new(0.05, -0.04),
        aspect: 1.0,
        distortion: Coefficients {
            radial: [-0.03, 0.01, 0.0],
            tangential: [0.003, 0.0],
        },
    };
    bent.camera = bent.camera.with_lens(spec).unwrap();
    bent.lamps_mm.truncate(1);
    let found = lights(&bent, 1, None).unwrap().0;
    for (found, lamp) in found.iter().zip(&bent.lamps_mm) {
        let off = angle_deg(found, *lamp);
        assert!(off < 0.15, "{off}");
    }
}

/// The image with these pixels masked, as a merge masks those that saturate every exposure.
fn clipped_within(image: &Grey, clipped: impl Fn(DVec2) -> bool) -> Grey {
    let mut masked = image.clone();
    for pixel in 0..masked.valid.len() {
        if clipped(image.position(pixel)) {
            masked.valid[pixel] = false;
            masked.value[pixel] = 0.0;
        }
    }
    masked
}

/// A highlight that saturates the shortest exposure has its middle where the whole one has
/// it, within the uncertainty that the cut adds, whatever part of it is cut off.
#[test]
fn a_clipped_core_keeps_its_middle() {
    let (mut sum, mut count) = (0.0, 0.0);
    for seed in 0..8 {
        let mut bench = GlossySpheres::under_six_lights(seed);
        // From a polished ball to a satin one.
        bench.roughness = [0.004, 0.015, 0.03, 0.05][seed as usize % 4];
        let images = photographs(&bench, seed);
        let sphere = &spheres(&bench, &images).unwrap()[0];
        for (index, image) in images.iter().enumerate() {
            let whole = highlight::find(image, sphere, index).unwrap();
            let peak = image.value.iter().copied().fold(0.0, f64::max);
            for level in [0.7, 0.3, 0.1] {
                let mut cut = image.clone();
                for pixel in 0..cut.valid.len() {
                    if image.value[pixel] > level * peak {
                        (cut.valid[pixel], cut.value[pixel]) = (false, 0.0);
                    }
                }
                let found = match highlight::find(&cut, sphere, index) {
                    Ok(found) => found,
                    Err(SphereError::Saturated { pixels, .. }) if pixels > 30 => continue,
                    Err(error) => panic!("seed {seed}, image {index}, {level}: {error}"),
                };
                let off = found.position_px - whole.position_px;
                let variance =
                    0.5 * (found.covariance_px2.x_axis.x + found.covariance_px2.y_axis.y);
                assert!(off.length() < 0.5, "seed {seed}, {level}: {off}");
                sum += 0.5 * off.length_squared() / variance;
                count += 1.0;
            }
        }
    }
    // The uncertainty is stated for hard edges; skirts of the blur make it smaller.
    let mean = sum / count;
    assert!(
        count > 80.0 && (0.02..1.2).contains(&mean),
        "{mean} of {count}"
    );
}

#[test]
fn unusable_pictures_are_refused_by_name() {
    let good = GlossySpheres::under_six_lights(1);
    let refused = |change: &dyn Fn(&mut GlossySpheres)| {
        let mut bench = good.clone();
        change(&mut bench);
        lights(&bench, 1, None).unwrap_err()
    };
    let outside = refused(&|b| b.centres_mm[0].x = 7.0);
    assert!(
        matches!(outside, SphereError::OutsideView { .. }),
        "{outside}"
    );
    let dull = refused(&|b| b.roughness = 0.8);
    assert!(matches!(dull, SphereError::NoHighlight { .. }), "{dull}");
    let gone = refused(&|b| b.centres_mm[0].x = 1e4);
    assert!(matches!(gone, SphereError::NoOutline { .. }), "{gone}");
    let tiny = refused(&|b| b.radius_mm = 1.0);
    assert!(matches!(tiny, SphereError::Impossible { .. }), "{tiny}");

    let images = photographs(&good, 1);
    let sphere = &spheres(&good, &images).unwrap()[0];
    let highlight = highlight::find(&images[0], sphere, 0).unwrap();
    // Glare over a fifth of the sphere's radius, and a stripe of the sensor.
    let glare = clipped_within(&images[0], |place| {
        place.distance(highlight.position_px) < 0.2 * sphere.circle.radius_px
    });
    let error = highlight::find(&glare, sphere, 0).unwrap_err();
    assert!(matches!(error, SphereError::Saturated { .. }), "{error}");
    let saturated = clipped_within(&images[0], |place| {
        let from = place - highlight.position_px;
        from.x.abs() < 0.6 && from.y.abs() < 6.0
    });
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
    let error = spheres_in(&small, None, &good.camera, &stated(&good), &[], 1).unwrap_err();
    assert!(matches!(error, SphereError::Size { .. }), "{error}");
    // A sphere a tenth larger than stated, pointed at by hand.
    let stated = Stated {
        radius_mm: 0.9 * good.radius_mm,
        ..stated(&good)
    };
    let near = [sphere.circle];
    let error = spheres_in(&images, None, &good.camera, &stated, &near, 1).unwrap_err();
    assert!(matches!(error, SphereError::Radius { .. }), "{error}");
}
