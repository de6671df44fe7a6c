//! A lens that is not perfectly sharp: the image of an edge against the integral of the
//! normal distribution, an interreflecting bowl against its own sharp image convolved, and
//! what a fit evaluates against what is rendered.

use std::f64::consts::PI;
use std::sync::Arc;

use glam::{DVec2, Vec3};
use rig_core::brdf::{Atom, Dictionary, Mixture};
use rig_core::geometry::{Mesh, Shape};
use rig_core::transport::{
    Cache, CacheOptions, Camera, Cells, DirectMatrix, Kernel, Projection, RenderOptions, Scene,
    Shading, render,
};

use super::references::{above, sun};
use super::statistics::{
    anderson_darling, chi2_score, mean_and_error, normal_cdf, normal_score, sidak, two_sided,
};

const ALBEDO: f64 = 0.8;

fn white() -> Mixture {
    let atom = Atom::Lambertian { albedo: ALBEDO };
    Mixture::grey(
        Arc::new(Dictionary::new("white", vec![atom]).unwrap()),
        vec![1.0],
    )
    .unwrap()
}

fn blurred(camera: Camera, point_spread_px: f64) -> Camera {
    Camera {
        point_spread_px,
        ..camera
    }
}

/// A half plane in z = 0 whose edge runs through the origin, turned by `tilt_rad` from y.
fn half_plane(tilt_rad: f64) -> Mesh {
    let (sin, cos) = tilt_rad.sin_cos();
    let corner =
        |u: f64, v: f64| Vec3::new((u * cos - v * sin) as f32, (u * sin + v * cos) as f32, 0.0);
    let corners = vec![
        corner(0.0, -9.0),
        corner(9.0, -9.0),
        corner(9.0, 9.0),
        corner(0.0, 9.0),
    ];
    Mesh::new(corners, vec![[0, 1, 2], [0, 2, 3]]).unwrap()
}

/// Radiance of pixel (x, y) of the half plane under perpendicular light of irradiance 1: the
/// mean over the pixel's square of the normal integral across the edge.
fn edge_spread(tilt_rad: f64, [x, y]: [usize; 2], pixels: usize, sigma_px: f64) -> f64 {
    let steps = 40;
    let position = |cell: usize, i: usize| cell as f64 + (i as f64 + 0.5) / f64::from(steps);
    let (sin, cos) = tilt_rad.sin_cos();
    let half = 0.5 * pixels as f64;
    let mut sum = 0.0;
    for i in 0..steps as usize {
        for j in 0..steps as usize {
            // The image's rows run down, against the sample's y.
            let (across, up) = (position(x, i) - half, half - position(y, j));
            sum += normal_cdf((across * cos + up * sin) / sigma_px);
        }
    }
    ALBEDO / PI * sum / f64::from(steps * steps)
}

/// z of every pixel that has noise: none too large, none too many.
fn assert_unit_normal(z: &[f64], what: &str) {
    let chi2: f64 = z.iter().map(|z| z * z).sum();
    let p = [
        anderson_darling(z),
        two_sided(chi2_score(chi2, z.len() as f64)),
    ];
    assert!(z.len() > 60, "{what}: {} pixels", z.len());
    assert!(
        p.iter().all(|&p| p > sidak(0.01, 6)),
        "{what}: p {p:?}, chi2 {chi2:.1} over {} pixels",
        z.len()
    );
}

#[test]
fn a_slanted_edge_has_the_analytic_spread() {
    let (pixels, tilt_rad) = (16, 8f64.to_radians());
    let mut z = Vec::new();
    for (seed, sigma_px) in [(3, 0.3), (4, 0.9), (5, 1.5)] {
        let camera = blurred(above([pixels; 2]), sigma_px);
        let lights = vec![sun(0.0, 0.0)];
        let scene = Scene::new(half_plane(tilt_rad), Shading::Flat, camera, lights);
        let options = RenderOptions {
            samples_per_pixel: 256,
            max_reflections: 1,
            seed,
            ..RenderOptions::default()
        };
        let image = render(&scene, &white(), &options).remove(0);
        let brdf = white();
        let cells = Cells::of_pixels(scene.camera.resolution_px);
        let direct = DirectMatrix::new(&scene, &cells, brdf.dictionary(), 16, 5);
        let mut worst = 0.0f64;
        for pixel in 0..pixels * pixels {
            let at = [pixel % pixels, pixel / pixels];
            let expected = edge_spread(tilt_rad, at, pixels, sigma_px);
            let full = ALBEDO / PI;
            let part = expected / full;
            worst = worst.max((f64::from(direct.row(pixel, 0)[0]) / full - part).abs());
            // Counts of 256 rays are nearly normal only where both sides are seen by many.
            if (0.1..=0.9).contains(&part) {
                let std = full * (part * (1.0 - part) / 256.0).sqrt();
                z.push((f64::from(image.mean[pixel][0]) - expected) / std);
            }
        }
        // 256 strata: a straight edge crosses about 20 to 30 of them.
        assert!(worst < 0.03, "sigma {sigma_px}: {worst}");
    }
    assert_unit_normal(&z, "edges");
}

const BLUR_PX: f64 = 0.8;
const SIDE: usize = 10;

fn bowl(camera: Camera) -> Scene {
    let mesh = Shape::Bowl {
        radius_mm: 1.0,
        segments: 32,
    };
    Scene::new(
        mesh.mesh().unwrap(),
        Shading::Flat,
        camera,
        vec![sun(20.0, 40.0)],
    )
}

fn options(samples_per_pixel: u32, seed: u64) -> RenderOptions {
    RenderOptions {
        samples_per_pixel,
        max_reflections: 3,
        seed,
        ..RenderOptions::default()
    }
}

/// Silhouettes, creases, edges of shadows and interreflections alike, and light from
/// outside the image's field.
#[test]
fn a_blurred_image_is_the_sharp_one_convolved() {
    let seen = bowl(blurred(above([SIDE; 2]), BLUR_PX));
    let image = render(&seen, &white(), &options(800, 21)).remove(0);
    let (fine, margin) = (6, 5);
    let wide = SIDE + 2 * margin;
    let mut camera = above([wide * fine; 2]);
    camera.projection = Projection::Orthographic {
        extent_mm: DVec2::splat(2.2 * wide as f64 / SIDE as f64),
    };
    let sharp = render(&bowl(camera), &white(), &options(16, 22)).remove(0);
    // Part of a pixel's footprint in each fine pixel along one axis: by the normal
    // integral at the middle of fine steps.
    let share = |coarse: usize| -> Vec<f64> {
        let middle = (margin + coarse) as f64 + 0.5;
        (0..wide * fine)
            .map(|i| {
                let steps = 16;
                let sum: f64 = (0..steps)
                    .map(|k| (i as f64 + (f64::from(k) + 0.5) / f64::from(steps)) / fine as f64)
                    .map(|x| {
                        let [a, b] = [0.5, -0.5].map(|h| normal_cdf((x - middle + h) / BLUR_PX));
                        a - b
                    })
                    .sum();
                sum / f64::from(steps) / fine as f64
            })
            .collect()
    };
    let shares: Vec<Vec<f64>> = (0..SIDE).map(share).collect();
    let mut z = Vec::new();
    for pixel in 0..SIDE * SIDE {
        let (across, down) = (&shares[pixel % SIDE], &shares[pixel / SIDE]);
        let (mut mean, mut variance) = (0.0, 0.0);
        for (row, &b) in down.iter().enumerate() {
            for (column, &a) in across.iter().enumerate() {
                let from = row * wide * fine + column;
                mean += a * b * f64::from(sharp.mean[from][0]);
                variance += (a * b).powi(2) * f64::from(sharp.variance[from][0]);
            }
        }
        let ours = f64::from(image.mean[pixel][0]);
        variance += f64::from(image.variance[pixel][0]);
        if variance > 0.0 && f64::from(image.mean[pixel][0]) > 0.02 {
            z.push((ours - mean) / variance.sqrt());
        }
    }
    assert_unit_normal(&z, "convolved");
}

/// The direct matrix and the path cache together give the rendered image.
#[test]
fn a_fit_sees_the_same_blur() {
    let scene = bowl(blurred(above([SIDE; 2]), BLUR_PX));
    let brdf = white();
    let rendered = render(&scene, &brdf, &options(800, 31)).remove(0);
    let cells = Cells::of_pixels(scene.camera.resolution_px);
    let direct = DirectMatrix::new(&scene, &cells, brdf.dictionary(), 32, 6);
    let groups: Vec<Vec<f64>> = (0..8)
        .map(|group| {
            let how = CacheOptions {
                samples_per_cell: 64,
                max_reflections: 3,
                seed: 100 + group,
                ..CacheOptions::default()
            };
            let cache = Cache::trace(&scene, &cells, brdf.dictionary(), &how).unwrap();
            let mut image = vec![0.0; SIDE * SIDE];
            let rows = cache.evaluate(Kernel::detect(), &[&[1.0]], Vec::new, |out, rows| {
                out.push((
                    rows.cell,
                    0.5 * f64::from(rows.value[0][0] + rows.value[1][0]),
                ));
            });
            for (pixel, value) in rows.concat() {
                image[pixel] = value + f64::from(direct.row(pixel, 0)[0]);
            }
            image
        })
        .collect();
    let (mean, error) = mean_and_error(&groups);
    let mut z = Vec::new();
    for pixel in 0..SIDE * SIDE {
        let theirs = f64::from(rendered.variance[pixel][0]);
        // The direct part's own quadrature, where an edge crosses its 1024 strata.
        let quadrature = (2e-3 * mean[pixel]).powi(2);
        let own = error[pixel].powi(2);
        let sum = own + theirs + quadrature;
        if own > 0.0 && mean[pixel] > 0.02 {
            let freedom = (sum / own).powi(2) * 7.0;
            let t = (f64::from(rendered.mean[pixel][0]) - mean[pixel]) / sum.sqrt();
            z.push(normal_score(t, freedom));
        }
    }
    assert_unit_normal(&z, "cache");
}
