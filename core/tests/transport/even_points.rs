//! Renders by evenly spread points against renders by independent ones.

use std::sync::Arc;

use rig_core::brdf::{Dictionary, Mixture};
use rig_core::geometry::Shape;
use rig_core::radiance_image::RadianceImage;
use rig_core::transport::{RenderOptions, Scene, Shading, render};

use super::references::{above, sun};

const SCRAMBLES: u32 = 16;

fn image(scrambles: Option<u32>, seed: u64) -> RadianceImage {
    let bowl = Shape::Bowl {
        radius_mm: 1.0,
        segments: 48,
    };
    let scene = Scene::new(
        bowl.mesh().unwrap(),
        Shading::Smooth,
        above([24, 24]),
        vec![sun(20.0, 30.0)],
    );
    let dictionary = Arc::new(Dictionary::paper42());
    let n = dictionary.len();
    let even = Mixture::grey(dictionary, vec![1.0 / n as f64; n]).unwrap();
    let options = RenderOptions {
        samples_per_pixel: 512,
        max_reflections: 3,
        seed,
        scrambles,
        ..RenderOptions::default()
    };
    render(&scene, &even, &options).remove(0)
}

/// Mean over the lit pixels of the squared difference over the variance that both state, and
/// of the variance of the first.
fn compared(a: &RadianceImage, b: &RadianceImage) -> [f64; 2] {
    let (mut squares, mut variance, mut count) = (0.0, 0.0, 0.0);
    for p in 0..a.mean.len() {
        let stated = f64::from(a.variance[p][0]) + f64::from(b.variance[p][0]);
        if stated > 0.0 {
            squares += f64::from(a.mean[p][0] - b.mean[p][0]).powi(2) / stated;
            variance += f64::from(a.variance[p][0]);
            count += 1.0;
        }
    }
    [squares / count, variance / count]
}

/// Two renders of some 470 pixels by scrambles of their own differ as their variances say: with
/// variances of 16 means each the mean square is 30/28, with a deviation of 0.07; heavy tails raise
/// it. So do one by even points and one by independent ones, which has more noise.
#[test]
fn even_points_scatter_less_and_as_they_say() {
    let [first, second] = [3, 4].map(|seed| image(Some(SCRAMBLES), seed));
    let independent = image(None, 5);
    let [among_even, variance] = compared(&first, &second);
    let [between, of_independent] = compared(&independent, &first);
    println!("{among_even} {between}, variance {variance} for {of_independent}");
    assert!((0.8..1.45).contains(&among_even), "{among_even}");
    assert!((0.8..1.35).contains(&between), "{between}");
    assert!(
        2.0 * variance < of_independent,
        "{variance} for {of_independent}"
    );
}
