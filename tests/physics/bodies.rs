//! Known bodies beside the sample: a holder lights it, an occluder shadows it, and
//! the cached paths explain both as the plain renderer does.

use std::sync::Arc;

use glam::Vec3;
use rig::brdf::dictionary::Dictionary;
use rig::brdf::mixture::Mixture;
use rig::config::scene::SceneFile;
use rig::geometry::{Mesh, files};
use rig::transport::cache::CacheError;
use rig::transport::{
    Cache, CacheOptions, Cells, DirectMatrix, Kernel, Proposal, RenderOptions, Scene, render,
};

/// A quadrilateral whose front sees `towards`.
fn quad(corners: [[f32; 3]; 4], towards: Vec3) -> Mesh {
    let [a, b, c, d] = corners.map(Vec3::from_array);
    let front = (b - a).cross(c - a).dot(towards - a) > 0.0;
    let corners = if front { [a, b, c, d] } else { [d, c, b, a] };
    Mesh::new(corners.to_vec(), vec![[0, 1, 2], [0, 2, 3]]).unwrap()
}

/// The four inner walls of a box about the z axis, from z = 0 up.
fn walls(half_width: f32, height: f32) -> Mesh {
    let w = half_width;
    let around = [[w, w], [-w, w], [-w, -w], [w, -w], [w, w]];
    let walls: Vec<Mesh> = around
        .windows(2)
        .map(|ends| {
            let [[a, b], [c, d]] = [ends[0], ends[1]];
            let corners = [[a, b, 0.0], [c, d, 0.0], [c, d, height], [a, b, height]];
            quad(corners, Vec3::new(0.0, 0.0, 0.5 * height))
        })
        .collect();
    Mesh::joined(walls.iter())
}

const GREY: &str = "{ mixture = [ { weight = 0.7, lambertian = { albedo = 0.9 } }, { weight = 0.3, ggx = { alpha = 0.4, eta = 2.0 } } ] }";
const RED: &str = "{ mixture = [ { weight = [0.8, 0.1, 0.1], lambertian = { albedo = 1.0 } }, { weight = [0.2, 0.9, 0.9], black = {} } ] }";

/// A bowl of radius 1 under a lamp 25° off the axis, with bodies of these meshes and
/// reflectances, all read from files as the program does.
fn scene(bodies: &[(&Mesh, &str)]) -> Scene {
    let folder = tempfile::tempdir().unwrap();
    let mut text = r#"
[camera]
model = "orthographic"
resolution_px = [24, 24]
extent_mm = [2.2, 2.2]
position_mm = [0.0, 0.0, 5.0]
[[light]]
kind = "directional"
to_light = [0.3971, 0.1445, 0.9063]
[sample]
shape = { kind = "bowl", radius_mm = 1.0, segments = 48 }
"#
    .to_owned();
    for (i, (mesh, brdf)) in bodies.iter().enumerate() {
        files::write(&folder.path().join(format!("{i}.stl")), mesh).unwrap();
        text += &format!("[[body]]\nmesh = \"{i}.stl\"\nbrdf = {brdf}\n");
    }
    let file = SceneFile::parse("scene.toml", folder.path(), &text);
    file.unwrap().scene().unwrap()
}

fn sample() -> (Dictionary, Vec<f64>, Mixture) {
    let dictionary = Dictionary::paper42();
    let mut weights = vec![0.0; dictionary.len()];
    for (atom, weight) in [(27, 0.35), (34, 0.15), (40, 0.4), (41, 0.1)] {
        weights[atom] = weight;
    }
    let mixture = Mixture::grey(Arc::new(dictionary.clone()), weights.clone()).unwrap();
    (dictionary, weights, mixture)
}

/// Every pixel of a scene's image as a cell.
fn pixels_of(scene: &Scene) -> Cells {
    Cells::of_pixels(scene.camera.resolution_px)
}

/// χ² per pixel of cached against rendered radiance over the pixels wholly on the
/// sample, and how many those are.
fn agreement(cached: &Scene, rendered: &Scene) -> (f64, f64) {
    let (dictionary, weights, mixture) = sample();
    let options = RenderOptions {
        samples_per_pixel: 2048,
        max_reflections: 6,
        seed: 5,
        proposal: Proposal::resembling(&mixture, 0.3),
        ..RenderOptions::default()
    };
    let image = render(rendered, &mixture, &options).remove(0);
    let options = CacheOptions {
        samples_per_cell: 2048,
        max_reflections: 6,
        ..CacheOptions::default()
    };
    let cache = Cache::trace(cached, &pixels_of(cached), &dictionary, &options).unwrap();
    let direct = DirectMatrix::new(cached, &pixels_of(cached), &dictionary, 16, 3);
    let pixels: Vec<_> = cache
        .evaluate(Kernel::detect(), &[&weights], Vec::new, |out, rows| {
            let mean = 0.5 * (rows.value[0][0] + rows.value[1][0]);
            out.push((mean, rows.variance[0]));
        })
        .concat();
    let (mut chi2, mut n) = (0.0, 0.0);
    for (i, &(value, variance)) in pixels.iter().enumerate() {
        let row = direct.row(i, 0).iter().zip(&weights);
        let once: f64 = row.map(|(&d, &w)| f64::from(d) * w).sum();
        let (ours, theirs) = (f64::from(value) + once, f64::from(image.mean[i][0]));
        let spread = f64::from(variance) + f64::from(image.variance[i][0]);
        if direct.coverage[i] >= 1.0 && spread > 0.0 && spread.sqrt() < 0.1 * theirs {
            // What is left of the footprint's quadrature, as in core/tests/transport.
            chi2 += (ours - theirs).powi(2) / (spread + (2e-3 * theirs).powi(2));
            n += 1.0;
        }
    }
    (chi2 / n, n)
}

/// The limit is 4.5 standard deviations of a mean χ² of one, √(2/n).
#[test]
fn light_by_way_of_a_holder_is_cached_as_it_is_rendered() {
    let holder = walls(1.3, 1.5);
    let (held, alone) = (scene(&[(&holder, GREY)]), scene(&[]));
    let (chi2, n) = agreement(&held, &held);
    let limit = 1.0 + 4.5 * (2.0 / n).sqrt();
    println!("holder: χ²/n {chi2:.3} of at most {limit:.3} over {n} pixels");
    assert!(n > 250.0 && chi2 < limit, "χ²/n {chi2} over {n} pixels");
    let (without, _) = agreement(&alone, &held);
    println!("without it: χ²/n {without:.1}");
    assert!(without > 10.0 * limit, "the test has no power: {without}");
}

#[test]
fn an_occluder_shadows_the_sample() {
    // On the line from the bowl's bottom to the lamp, beside the camera's view.
    let [x, y] = [3.0f32 * 0.3971 / 0.9063, 3.0 * 0.1445 / 0.9063];
    let corner = |dx: f32, dy: f32| [x + 0.2 * dx, y + 0.2 * dy, 2.0];
    let corners = [
        corner(-1.0, -1.0),
        corner(1.0, -1.0),
        corner(1.0, 1.0),
        corner(-1.0, 1.0),
    ];
    let (dictionary, _, mixture) = sample();
    let middle = 12 * 24 + 12;
    for up in [9.0, -9.0] {
        let shade = quad(corners, Vec3::new(x, y, up));
        let (open, shadowed) = (
            scene(&[]),
            scene(&[(&shade, "{ mixture = [ { weight = 1.0, black = {} } ] }")]),
        );
        let options = RenderOptions {
            samples_per_pixel: 16,
            max_reflections: 1,
            ..RenderOptions::default()
        };
        let radiance = |s: &Scene| render(s, &mixture, &options)[0].mean[middle][1];
        assert!(radiance(&open) > 0.05);
        assert_eq!(radiance(&shadowed), 0.0);
        let direct = DirectMatrix::new(&shadowed, &pixels_of(&shadowed), &dictionary, 4, 1);
        assert_eq!(direct.coverage[middle], 1.0);
        assert!(direct.row(middle, 0).iter().all(|&v| v == 0.0));
    }
}

#[test]
fn pixels_of_a_body_are_none_of_the_sample() {
    // Covers the left half of the view.
    let z = 0.5;
    let lid = quad(
        [
            [-2.0, -2.0, z],
            [0.0, -2.0, z],
            [0.0, 2.0, z],
            [-2.0, 2.0, z],
        ],
        Vec3::Z * 9.0,
    );
    let (dictionary, _, mixture) = sample();
    let grey = scene(&[(&lid, GREY)]);
    let direct = DirectMatrix::new(&grey, &pixels_of(&grey), &dictionary, 4, 1);
    let cache = Cache::trace(
        &grey,
        &pixels_of(&grey),
        &dictionary,
        &CacheOptions::default(),
    )
    .unwrap();
    let seen = rig::capture::region_of_interest::sample_pixels(&grey, &grey.camera);
    let radiance: Vec<f32> = cache
        .evaluate(
            Kernel::Portable,
            &[&[1.0 / 42.0; 42]],
            Vec::new,
            |out, rows| {
                out.push(rows.value[0][0]);
            },
        )
        .concat();
    for row in 0..24 {
        for column in 0..12 {
            let pixel = row * 24 + column;
            assert_eq!(direct.coverage[pixel], 0.0);
            assert!(direct.row(pixel, 0).iter().all(|&v| v == 0.0));
            assert_eq!(radiance[pixel], 0.0);
            assert!(!seen[pixel]);
        }
    }
    assert_eq!(direct.coverage[12 * 24 + 15], 1.0);

    // The renderer shows it in its colour: Lambertian, 0.8 and 0.1 under cos 25°.
    let red = scene(&[(&lid, RED)]);
    let image = render(&red, &mixture, &RenderOptions::default()).remove(0);
    let expected = [0.8, 0.1, 0.1].map(|albedo| albedo * 0.9063 / std::f32::consts::PI);
    let got = image.mean[12 * 24 + 3];
    for channel in 0..3 {
        let relative = got[channel] / expected[channel] - 1.0;
        assert!(relative.abs() < 1e-3, "{got:?} for {expected:?}");
    }
}

#[test]
fn a_coloured_body_cannot_stand_beside_a_fit() {
    let holder = walls(1.3, 1.5);
    let (dictionary, ..) = sample();
    let coloured = scene(&[(&walls(1.4, 0.1), GREY), (&holder, RED)]);
    let error = Cache::trace(
        &coloured,
        &pixels_of(&coloured),
        &dictionary,
        &CacheOptions::default(),
    )
    .err();
    let Some(CacheError::ColouredBody { body: 1 }) = error else {
        panic!("{error:?}");
    };
}
