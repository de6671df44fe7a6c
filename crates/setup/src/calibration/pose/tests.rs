//! Poses of simulated samples against those that they truly have.

use glam::{DVec2, DVec3};
use nalgebra::{Matrix6, Vector6};

use super::*;
use crate::bench_priors::BenchPriors;
use crate::calibration::record::Values;
use crate::frames::{Rigid, Sample};
use crate::geometry::Shape;
use crate::inverse::nuisance::with_sample_at;
use crate::radiance_image::RadianceImage;
use crate::random::{Purpose, stream};
use crate::simulation::posed_sample::{SIZE, bowl, corner, photographs, scene, telecentric};
use crate::transport::{Projection, Scene};

fn priors() -> BenchPriors {
    with_lights(0.1)
}

/// Priors with lights known to so many degrees.
fn with_lights(light_deg: f64) -> BenchPriors {
    BenchPriors {
        light_rad: light_deg.to_radians(),
        rotation_rad: 0.4f64.to_radians(),
        translation_mm: 0.3,
        ..BenchPriors::default()
    }
}

fn quick() -> PoseOptions {
    PoseOptions {
        subsamples: 4,
        ..PoseOptions::default()
    }
}

/// Truth and estimate of one bench, and the error across the view in pixels.
fn one_bench(
    shape: fn(u32) -> Shape,
    projection: Projection,
    priors: &BenchPriors,
    size: usize,
    seed: u64,
) -> (Vector6<f64>, PoseEstimate, f64) {
    let mut numbers = stream(seed, Purpose::Experiment, 1, 0, 0);
    let turned_rad = [[0; 2]; 2].map(|light| light.map(|_| priors.light_rad * numbers.normal()));
    let scene = |segments, turned_rad| {
        let mut scene = scene(shape(segments).mesh().unwrap(), projection, turned_rad);
        scene.camera.resolution_px = [size; 2];
        scene
    };
    let described = scene(64, [[0.0; 2]; 2]);
    let true_scene = scene(180, turned_rad);
    let mut vector = |s: f64| DVec3::new(numbers.normal(), numbers.normal(), numbers.normal()) * s;
    let rotation = vector(priors.rotation_rad);
    let translation = vector(priors.translation_mm);
    let moved = with_sample_at(true_scene, rotation, translation);
    let found = align(&described, &photographs(&moved, seed), priors, &quick()).unwrap();
    let truth = Vector6::from_vec([rotation.to_array(), translation.to_array()].concat());
    let across_mm = DVec2::new(found.values[3] - truth[3], found.values[4] - truth[4]);
    let across_px = across_mm.length() * size as f64 / 26.0;
    (truth, found, across_px)
}

/// Errors of several benches in units of what was stated for them.
struct Pulls {
    /// Squared length, over all benches.
    chi2: f64,
    /// Root mean square by number, rotation then translation.
    rms: [f64; 6],
    /// Root mean square error along x or y, pixels.
    across_px: f64,
}

fn pulls(
    shape: fn(u32) -> Shape,
    projection: Projection,
    priors: &BenchPriors,
    size: usize,
    seeds: u64,
) -> Pulls {
    let (mut chi2, mut squares, mut across_px2) = (0.0, [0.0; 6], 0.0);
    for seed in 0..seeds {
        let (truth, found, across_px) = one_bench(shape, projection, priors, size, seed);
        let error = Vector6::from(found.values) - truth;
        let covariance = Matrix6::from_fn(|i, j| found.covariance[i][j]);
        chi2 += error.dot(&covariance.cholesky().unwrap().solve(&error));
        for (k, sum) in squares.iter_mut().enumerate() {
            *sum += error[k].powi(2) / covariance[(k, k)];
        }
        across_px2 += across_px.powi(2) / (2 * seeds) as f64;
        assert!(found.explained > 0.9, "{seed}: {}", found.explained);
        let depth = found.held.iter().any(|h| h.contains("translation along z"));
        let telecentric = matches!(projection, Projection::Orthographic { .. });
        assert!(depth || !telecentric, "{seed}: {:?}", found.held);
    }
    Pulls {
        chi2,
        rms: squares.map(|sum| (sum / seeds as f64).sqrt()),
        across_px: across_px2.sqrt(),
    }
}

/// Errors over seeds against their covariance, χ² with six degrees of freedom each; across
/// the view they are a fraction of a pixel. An outline's and shadows' edges (bowl) and creases
/// (corner), telecentric and in perspective.
#[test]
fn poses_are_found_within_their_uncertainty() {
    const SEEDS: u64 = 3;
    // Quantiles of χ² with 18 degrees of freedom at 2.5e-4 and 1 − 2.5e-4.
    const CHI2: [f64; 2] = [4.2, 46.0];
    let perspective = Projection::Perspective { fov_rad: 0.13 };
    for (name, shape, projection, light_deg, size, worst_px) in [
        (
            "bowl, telecentric",
            bowl as fn(u32) -> Shape,
            telecentric(),
            0.1,
            SIZE,
            0.1,
        ),
        (
            "bowl, fine, lights less known",
            bowl,
            telecentric(),
            0.5,
            160,
            0.1,
        ),
        ("corner, perspective", corner, perspective, 0.1, SIZE, 0.25),
    ] {
        let found = pulls(shape, projection, &with_lights(light_deg), size, SEEDS);
        eprintln!(
            "{name}: χ² {:.1} of {}, pulls {:.2?}, along x or y {:.3} px",
            found.chi2,
            6 * SEEDS,
            found.rms,
            found.across_px
        );
        assert!(
            (CHI2[0]..CHI2[1]).contains(&found.chi2),
            "{name}: χ² {}",
            found.chi2
        );
        assert!(found.across_px < worst_px, "{name}: {} px", found.across_px);
    }
}

/// A description 30° and 10 mm off: found as well as one that is nearly right, along the
/// directions that the images tell. What they don't (a bowl's turn about its axis, depth under
/// a telecentric lens) is where it is least off.
#[test]
fn a_pose_is_found_from_far_off() {
    let perspective = Projection::Perspective { fov_rad: 0.17 };
    for (name, shape, projection, axis) in [
        (
            "bowl",
            bowl as fn(u32) -> Shape,
            telecentric(),
            DVec3::new(0.8, -0.6, 0.0),
        ),
        ("corner", corner, perspective, DVec3::new(-0.5, 0.7, 0.5)),
    ] {
        let described = scene(shape(64).mesh().unwrap(), projection, [[0.0; 2]; 2]);
        let true_scene = scene(shape(180).mesh().unwrap(), projection, [[0.0; 2]; 2]);
        let rotation = axis.normalize() * 30f64.to_radians();
        let translation = DVec3::new(6.0, -5.0, 6.2);
        let images = photographs(&with_sample_at(true_scene, rotation, translation), 3);
        let near = align(&described, &images, &priors(), &quick());
        assert!(near.is_err(), "{name}: {near:?}");
        let found = find(&described, &images, &priors(), &quick()).unwrap();
        assert!(found.searched && found.explained > 0.8, "{name}: {found:?}");
        // Where the rim's middle and a point on its axis come to, across the view.
        let pose = |rotation: DVec3, translation: DVec3| {
            let rigid: Rigid<Sample, Sample> = Rigid::from_rotation_vector(rotation, translation);
            [DVec3::ZERO, DVec3::new(0.0, 0.0, -8.0)].map(|p| rigid.point(p).truncate())
        };
        let v = found.values;
        let back = pose(DVec3::new(v[0], v[1], v[2]), DVec3::new(v[3], v[4], v[5]));
        for (was, is) in pose(rotation, translation).into_iter().zip(back) {
            eprintln!("{name}: {was:.3} {is:.3}");
            // A pixel, of 0.65 mm.
            assert!(was.distance(is) < 0.65, "{name}: {was} {is}");
        }
    }
}

/// Each refusal names its reason.
#[test]
fn images_without_a_pose_are_refused() {
    let described = scene(bowl(32).mesh().unwrap(), telecentric(), [[0.0; 2]; 2]);
    let flat = |seed: u64| {
        let mut image = RadianceImage::new(SIZE, SIZE);
        let mut numbers = stream(seed, Purpose::Experiment, 2, 0, 0);
        for (mean, variance) in image.mean.iter_mut().zip(&mut image.variance) {
            *mean = [(); 3].map(|()| 1.0 + 0.01 * numbers.normal() as f32);
            *variance = [1e-4; 3];
        }
        image
    };
    let blank = [flat(1), flat(2)];
    let refused = |scene: &Scene, images: &[RadianceImage], priors: &BenchPriors| {
        align(scene, images, priors, &quick()).unwrap_err()
    };
    let error = refused(&described, &blank, &priors());
    assert!(
        matches!(error, PoseError::NoEdges | PoseError::NotThere { .. }),
        "{error}"
    );
    let error = refused(&described, &blank[..1], &priors());
    assert_eq!(
        error,
        PoseError::ImageCount {
            images: 1,
            lights: 2
        }
    );
    let away = with_sample_at(described.clone(), DVec3::ZERO, DVec3::new(40.0, 0.0, 0.0));
    let error = refused(&away, &blank, &priors());
    assert!(matches!(error, PoseError::OutsideView { .. }), "{error}");
    let exact = BenchPriors {
        rotation_rad: 0.0,
        ..priors()
    };
    assert_eq!(refused(&described, &blank, &exact), PoseError::Exact);
    // Far beyond what the priors allow.
    let moved = with_sample_at(described.clone(), DVec3::ZERO, DVec3::new(4.0, -3.0, 0.0));
    let error = refused(&described, &photographs(&moved, 1), &priors());
    assert!(
        matches!(
            error,
            PoseError::TooFar { .. } | PoseError::NotThere { .. } | PoseError::NoEdges
        ),
        "{error}"
    );
}

#[test]
fn a_record_holds_the_estimate_in_degrees() {
    let found = PoseEstimate {
        values: [0.01, 0.0, -0.02, 0.1, 0.2, 0.3],
        covariance: std::array::from_fn(|i| {
            std::array::from_fn(|j| if i == j { 1e-6 } else { 2e-7 })
        }),
        prior: [0.01; 6],
        held: Vec::new(),
        blur_px2: Measured::new(0.25, 0.01),
        reduced_chi2: 1.0,
        explained: 0.99,
        shifts: Vec::new(),
        pixel_px: 1,
        rounds: 3,
        settled: true,
        searched: false,
    };
    let values = PoseValues::new(&found);
    assert!((values.rotation_deg[0] - 0.572_958).abs() < 1e-6);
    assert!(
        (values.blur_px.value - 0.5).abs() < 1e-12 && (values.blur_px.std - 0.01).abs() < 1e-12
    );
    let back = values.covariance_rad_mm();
    assert!((back[0][3] - 2e-7).abs() < 1e-18 && (back[1][1] - 1e-6).abs() < 1e-18);
    assert!((values.pose()[0].z + 0.02).abs() < 1e-12);
    assert!(values.check().is_ok());
    let mut broken = values.clone();
    broken.covariance[0][1] = 1.0;
    assert_eq!(broken.check().unwrap_err().key, "values.covariance");
    let mut broken = values;
    broken.rotation_deg[1] = f64::NAN;
    assert_eq!(broken.check().unwrap_err().key, "values.rotation_deg");
}
