//! Photographs of edges: what is found in them against what was drawn.

use super::*;
use crate::calibration::mirror_sphere::Grey;
use crate::calibration::record::Values;
use crate::simulation::edge::{self, BRIGHT, DARK, SIDE, camera, photograph, telecentric};
use crate::transport::{Camera, Projection};

/// An image of these values with noise.
fn noisy(truth: &[f64], seed: u64) -> Grey {
    let (value, variance) = edge::noisy(truth, seed);
    Grey {
        width: SIDE,
        height: SIDE,
        variance,
        valid: vec![true; value.len()],
        value,
    }
}

fn stated(camera: &Camera) -> Lens {
    Lens {
        spread_px2: 0.25,
        focus_mm: camera.focus_mm + 1.0,
        tangent2: 1e-4,
    }
}

/// Point spread, focus and aperture from edges at four heights, 8 times with a telecentric
/// and 8 times with a perspective lens: errors over stated uncertainties are a unit normal
/// (their sums of squares between the 1e-4 tails of χ² of 16 degrees of freedom).
#[test]
fn a_lens_is_recovered_within_its_uncertainty() {
    let seeds = 8;
    let (mut chi2, mut mean) = ([0.0; 3], [0.0; 3]);
    let perspective = camera(Projection::Perspective { fov_rad: 0.055 });
    for camera in [telecentric(), perspective] {
        let heights = [-6.0, -2.0, 1.0, 4.0];
        let truths = heights.map(|h| photograph(&camera, h, 0.12 + 0.01 * h));
        for seed in 0..seeds {
            let edges: Vec<Edge> = truths
                .iter()
                .zip(heights)
                .enumerate()
                .map(|(i, (truth, height))| {
                    let image = noisy(truth, 100 * seed + i as u64);
                    locate(i, &image, None, &camera, height).unwrap()
                })
                .collect();
            let found = fit_edges(&edges, stated(&camera)).unwrap();
            let values = FocusValues::new(&edges, &found, 1, 0.0);
            values.check().unwrap();
            let lens = values.lens.unwrap();
            let errors = [
                (values.point_spread_px, camera.point_spread_px),
                (lens.focus_mm, camera.focus_mm),
                (lens.object_na, camera.object_na),
            ];
            for (i, (found, truth)) in errors.into_iter().enumerate() {
                let pull = (found.value - truth) / found.std;
                chi2[i] += pull * pull;
                mean[i] += pull / (2 * seeds) as f64;
                assert!(found.std < [0.04, 0.2, 0.002][i], "{i}: {found:?}");
            }
            let reduced = found.reduced_chi2;
            assert!((0.85..1.15).contains(&reduced), "{reduced}");
        }
    }
    assert!(
        chi2.iter().all(|c| (3.0..45.0).contains(c)),
        "{chi2:.1?}, mean pulls {mean:.2?}"
    );
    println!("chi2 {chi2:.1?} of 16, mean pulls {mean:.2?}");
}

/// One height tells the point spread where focus and aperture are known; a binned
/// mosaic's pixel is two of the sensor's.
#[test]
fn one_edge_determines_the_spread_alone() {
    let camera = telecentric();
    let truth = photograph(&camera, -1.5, 0.2);
    let mut chi2 = 0.0;
    for seed in 0..12 {
        let edge = locate(0, &noisy(&truth, seed), None, &camera, -1.5).unwrap();
        assert!((edge.depth_mm - 121.5).abs() < 1e-9 && (edge.px_per_mm - 44.0 / 6.6).abs() < 1e-6);
        let lens = Lens {
            focus_mm: camera.focus_mm,
            ..stated(&camera)
        };
        let edges = [edge];
        let found = fit_edges(&edges, lens).unwrap();
        let values = FocusValues::new(&edges, &found, 2, 0.0);
        assert!(values.lens.is_none());
        let spread = values.point_spread_px;
        chi2 += ((spread.value - 1.2) / spread.std).powi(2);
    }
    // The 1e-4 tails of χ²(12).
    assert!((1.9..40.0).contains(&chi2), "{chi2}");
}

#[test]
fn what_is_no_slanted_edge_is_refused() {
    let camera = telecentric();
    let good = photograph(&camera, 0.0, 0.15);
    let image = noisy(&good, 1);
    let refuse =
        |image: &Grey, region: Option<Region>| locate(3, image, region, &camera, 0.0).unwrap_err();
    let region = |x, y, width, height| {
        Some(Region {
            x,
            y,
            width,
            height,
        })
    };
    let size = Grey {
        width: SIDE - 1,
        ..image.clone()
    };
    assert!(matches!(
        refuse(&size, None),
        EdgeError::Size { image: 3, .. }
    ));
    let outside = refuse(&image, region(20, 20, 30, 30));
    assert!(matches!(outside, EdgeError::Region { .. }), "{outside}");
    let flat = noisy(&vec![0.5; SIDE * SIDE], 2);
    let flat = refuse(&flat, None);
    assert!(
        matches!(flat, EdgeError::Contrast { .. } | EdgeError::TooFew { .. }),
        "{flat}"
    );
    let straight = refuse(&noisy(&photograph(&camera, 0.0, 0.01), 3), None);
    assert!(matches!(straight, EdgeError::Tilt { .. }), "{straight}");
    let diagonal = refuse(&noisy(&photograph(&camera, 0.0, 0.77), 3), None);
    assert!(matches!(diagonal, EdgeError::Tilt { .. }), "{diagonal}");
    let mut saturated = image.clone();
    for (valid, value) in saturated.valid.iter_mut().zip(&good) {
        *valid = *value < 0.6;
    }
    let saturated = refuse(&saturated, None);
    assert!(matches!(saturated, EdgeError::Masked { .. }), "{saturated}");
    let short = refuse(&image, region(21, 10, 20, 20));
    assert!(matches!(short, EdgeError::TooFew { .. }), "{short}");
    // A second edge across the first.
    let mut cross = good.clone();
    for (pixel, value) in cross.iter_mut().enumerate() {
        if (pixel / SIDE) % 12 < 6 {
            *value = (BRIGHT + DARK - *value).max(0.0);
        }
    }
    let cross = refuse(&noisy(&cross, 4), None);
    assert!(
        matches!(
            cross,
            EdgeError::NotStraight { .. } | EdgeError::Contrast { .. } | EdgeError::Tilt { .. }
        ),
        "{cross}"
    );
}

/// Heights that all lie within the depth of field tell nothing of the aperture.
#[test]
fn a_sharp_lens_has_no_focus_to_find() {
    let mut camera = telecentric();
    camera.object_na = 0.0;
    let edges = [-1.0, 0.0, 1.0].map(|h| {
        let image = noisy(&photograph(&camera, h, 0.15), 40 + (h + 1.0) as u64);
        locate(0, &image, None, &camera, h).unwrap()
    });
    let flat = fit_edges(&edges, stated(&camera)).unwrap_err();
    assert!(matches!(flat, EdgeError::NoDefocus { .. }), "{flat}");
}
