//! Which part of a sample shows which difference angle, by light that is reflected once and twice.

use std::f32::consts::TAU;

use glam::{DVec2, Vec3};

use crate::plot::{Axis, Chart, Figure, Mark, Series, charts};
use crate::random::{Purpose, stream};
use crate::transport::Scene;

/// Half the width of the section that is looked at, in radii.
const SECTION: f32 = 0.12;
/// Directions from each point that is seen.
const DIRECTIONS: u32 = 6;

/// Reflections on the sections of named samples of about 2 mm: where they happen along them, and at
/// which difference angle.
pub fn figure(samples: &[(&str, Scene)]) -> Figure {
    let panel = |(name, scene): &(&str, Scene)| {
        let [once, twice] = reflections(scene);
        Chart {
            title: (*name).to_owned(),
            x: Axis::linear(-1.0..1.0, "place across the sample (radii)"),
            y: Axis::linear(0.0..90.0, "difference angle θd (degrees)"),
            series: vec![
                Series::new("light reflected twice", 1, Mark::Dots, twice),
                Series::new("light reflected once", 0, Mark::Dots, once),
            ],
        }
    };
    let panels: Vec<Chart> = samples.iter().map(panel).collect();
    charts("shown-angles", 2, &panels)
}

/// Place and difference angle, degrees, of what is seen of a white sample: by light that is reflected
/// once, and of both reflections of light that is reflected twice.
fn reflections(scene: &Scene) -> [Vec<[f64; 2]>; 2] {
    let [mut once, mut twice] = [Vec::new(), Vec::new()];
    let difference_deg = |a: Vec3, b: Vec3| f64::from(0.5 * a.angle_between(b).to_degrees());
    let lights = 0..scene.lights.len();
    let [width, height] = scene.camera.resolution_px;
    for pixel in 0..width * height {
        let at = DVec2::new((pixel % width) as f64, (pixel / width) as f64);
        let ray = scene.camera.ray(at + 0.5, DVec2::ZERO);
        let Some((surface, to_viewer)) = scene.first(&ray) else {
            continue;
        };
        let place = surface.origin_mm;
        if place.y.abs() > SECTION {
            continue;
        }
        for light in lights.clone() {
            if let Some(lit) = scene.connect(&surface, light, [0.5; 2]) {
                let angle = difference_deg(lit.to_light, to_viewer);
                once.push([f64::from(place.x), angle]);
            }
        }
        let mut numbers = stream(1, Purpose::Experiment, 0, pixel as u64, 0);
        for _ in 0..DIRECTIONS {
            // As a white surface reflects: over the disc beneath the half sphere.
            let [u, v] = [numbers.uniform() as f32, numbers.uniform() as f32];
            let (sin, cos) = (TAU * v).sin_cos();
            let direction = Vec3::new(u.sqrt() * cos, u.sqrt() * sin, (1.0 - u).sqrt());
            let Some((other, back)) = scene.next(&surface, direction) else {
                continue;
            };
            let light = (numbers.uniform() * scene.lights.len() as f64) as usize;
            if let Some(lit) = scene.connect(&other, light, [0.5; 2]) {
                let seen = difference_deg(direction, to_viewer);
                let before = difference_deg(lit.to_light, back);
                twice.push([f64::from(place.x), seen]);
                twice.push([f64::from(other.origin_mm.x), before]);
            }
        }
    }
    [once, twice]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::designs::Design;

    /// Parallel light has one difference angle per lamp, half of its angle from the camera; light that is
    /// reflected twice has those that no lamp of the bowl has.
    #[test]
    fn twice_reflected_light_shows_what_no_lamp_does() {
        let scene = Design::Bowl.scene(4, 40, 128).unwrap();
        let [once, twice] = reflections(&scene);
        let halves = [0.0, 41.41, 28.96, 51.32].map(|deg| 0.5 * deg);
        for [_, angle] in &once {
            let off = halves.iter().map(|half| (half - angle).abs());
            assert!(off.fold(90.0, f64::min) < 0.1, "{angle}");
        }
        let beyond = twice.iter().filter(|[_, angle]| *angle > 30.0).count();
        assert!(beyond * 4 > twice.len(), "{beyond} of {}", twice.len());
    }
}
