use glam::{DVec2, DVec3};

use super::*;
use crate::geometry::Shape;
use crate::radiance_image::RadianceImage;
use crate::random::{Purpose, stream};
use crate::transport::{Camera, Coefficients, LensSpec, Light, Projection, Shading};

fn sun(to_light: DVec3) -> Light {
    Light::distant(to_light, [1.0, 2.0, 0.5])
}

/// A bowl under two lights, as a perspective camera with a lens that distorts and blurs sees it.
pub(crate) fn bowl(resolution_px: [usize; 2]) -> Scene {
    let shape = Shape::Bowl {
        radius_mm: 10.0,
        segments: 96,
    };
    let camera = Camera::looking_at(
        resolution_px,
        Projection::Perspective { fov_rad: 0.25 },
        DVec3::new(0.0, 0.0, 100.0),
        DVec3::ZERO,
        DVec3::Y,
    )
    .unwrap()
    .with_lens(LensSpec {
        distortion: Coefficients {
            radial: [0.5, 0.0, 0.0],
            tangential: [0.0; 2],
        },
        ..LensSpec::IDEAL
    })
    .unwrap();
    let camera = Camera {
        point_spread_px: 0.8,
        ..camera
    };
    let lights = vec![sun(DVec3::Z), sun(DVec3::new(0.5, 0.2, 1.0))];
    Scene::new(shape.mesh().unwrap(), Shading::Smooth, camera, lights)
}

fn grid(scene: &Scene, budget: usize) -> Grid {
    let options = CellOptions {
        budget,
        ..CellOptions::exact()
    };
    choose(scene, &options)
}

/// Cells do not overlap, keep the budget but for what edges ask for, are finest where a highlight
/// can be, and stay off the silhouette; the same for any number of threads.
#[test]
fn the_grid_follows_the_scene() {
    let scene = bowl([320, 240]);
    for budget in [400, 1500] {
        let grid = grid(&scene, budget);
        let mut covered = vec![false; 320 * 240];
        for cell in &grid.cells {
            for [x, y] in cell.each_pixel() {
                assert!(!std::mem::replace(&mut covered[y * 320 + x], true));
            }
        }
        assert!(
            2 * grid.cells.len() <= 3 * budget, // edges take a few more
            "{} of {budget}",
            grid.cells.len()
        );
        assert!(
            3 * grid.cells.len() > budget,
            "{} of {budget}",
            grid.cells.len()
        );
        // Under the coaxial light the highlight is in the middle of the bowl.
        let at = |x: u32, y: u32| {
            let covers = |cell: &&Cell| {
                let [left, top] = cell.corner_px;
                (left..left + cell.side_px).contains(&x) && (top..top + cell.side_px).contains(&y)
            };
            grid.cells.iter().find(covers).map(|cell| cell.side_px)
        };
        let sides: Vec<u32> = grid.cells.iter().map(|cell| cell.side_px).collect();
        let largest = sides.iter().max().unwrap();
        assert!(at(160, 120).unwrap() * 2 <= *largest, "{budget}");
        // Nothing within a pixel of what is not the sample.
        let seen = |x: usize, y: usize| {
            let place = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
            let ray = scene.camera.ray(place, DVec2::ZERO);
            scene.first(&ray).is_some()
        };
        for y in 1..239 {
            for x in (1..319).filter(|x| covered[y * 320 + x]) {
                assert!(seen(x - 1, y) && seen(x + 1, y) && seen(x, y - 1) && seen(x, y + 1));
            }
        }
    }
    let with_threads = |count: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(count).build();
        pool.unwrap().install(|| grid(&scene, 700).cells)
    };
    assert_eq!(with_threads(1), with_threads(3));
}

/// Rows given a few at a time make the same means, and dust and hot pixels are left out of large
/// cells before averaging.
#[test]
fn images_are_averaged_row_by_row_without_dust() {
    let scene = bowl([320, 240]);
    let mut numbers = stream(6, Purpose::Experiment, 0, 0, 0);
    let mut image = |level: f32| {
        let mut image = RadianceImage::new(320, 240);
        for (mean, variance) in image.mean.iter_mut().zip(&mut image.variance) {
            *mean = [(); 3].map(|()| level * (1.0 + 0.01 * numbers.normal() as f32));
            *variance = [(0.01 * level).powi(2); 3];
        }
        image
    };
    let mut images = vec![image(1.0), image(3.0)];
    let clean = Captured::new(&scene, &images, &CellOptions::exact()).unwrap();
    assert_eq!(clean.outliers, 0);
    // Hot and dead pixels far from the highlights, in two of which cells may be single pixels.
    let large = clean.cells.iter().filter(|cell| cell.side_px >= 8);
    let spots: Vec<usize> = large
        .step_by(5)
        .map(|cell| {
            let [x, y] = cell.middle_px().to_array().map(|at| at as usize);
            y * 320 + x
        })
        .collect();
    assert!(spots.len() > 10);
    for (k, &spot) in spots.iter().enumerate() {
        images[k % 2].mean[spot] = if k % 3 == 0 { [0.0; 3] } else { [40.0; 3] };
    }
    let dusty = Captured::new(&scene, &images, &CellOptions::exact()).unwrap();
    assert_eq!(dusty.outliers, spots.len());
    assert_eq!(dusty.len(), clean.len());
    for light in 0..2 {
        let both = clean.images[light]
            .mean
            .iter()
            .zip(&dusty.images[light].mean);
        for (before, after) in both {
            assert!(
                (after[1] / before[1] - 1.0).abs() < 0.01,
                "{before:?} {after:?}"
            );
        }
    }
    for rows in [1, 7, 240] {
        let grid = choose(&scene, &CellOptions::exact());
        let mut averager = Averager::new(&scene, grid, 2).unwrap();
        for first in (0..240).step_by(rows) {
            let rows = first..(first + rows).min(240);
            let some: Vec<_> = images
                .iter()
                .map(|image| image.rows(rows.clone()))
                .collect();
            averager.add(&some);
        }
        assert_eq!(averager.finish().unwrap().images, dusty.images, "{rows}");
    }
}

/// The variance of a mean is that of independent pixels, and a cell of which too little is valid
/// is dropped, under all lights.
#[test]
fn variances_shrink_and_blind_cells_are_dropped() {
    let scene = bowl([320, 240]);
    let mut images = vec![RadianceImage::new(320, 240), RadianceImage::new(320, 240)];
    for image in &mut images {
        image.mean.fill([1.0; 3]);
        image.variance.fill([0.04; 3]);
    }
    let all = Captured::new(&scene, &images, &CellOptions::exact()).unwrap();
    for (k, cell) in all.cells.iter().enumerate() {
        let expected = 0.04 / cell.pixels() as f64;
        assert!((all.images[0].variance[k][2] / expected - 1.0).abs() < 1e-6);
    }
    // The left half of one image is saturated.
    for pixel in (0..320 * 240).filter(|pixel| pixel % 320 < 160) {
        images[1].valid[pixel] = false;
    }
    let half = Captured::new(&scene, &images, &CellOptions::exact()).unwrap();
    assert!(
        half.cells
            .iter()
            .all(|cell| cell.corner_px[0] + cell.side_px / 2 >= 160)
    );
    images[1].valid.fill(false);
    assert_eq!(
        Captured::new(&scene, &images, &CellOptions::exact()).err(),
        Some(AverageError::NothingValid { image: 1 })
    );
}
