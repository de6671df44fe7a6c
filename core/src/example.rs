//! A small scene and images of it, for examples, tests and first attempts.

use std::path::Path;

use crate::brdf;
use crate::cells::{Captured, CellOptions};
use crate::config::scene::SceneFile;
use crate::radiance_image::RadianceImage;
use crate::transport::{RenderOptions, Scene, render};

/// The scene file of [`bowl`], `examples/bowl.toml`.
pub const BOWL: &str = include_str!("../examples/bowl.toml");

/// A bowl of 20 mm, seen from above by 32 × 32 pixels, under one light from the side.
///
/// ```
/// let scene = rig_core::example::bowl();
/// assert_eq!(scene.camera.resolution_px, [32, 32]);
/// assert_eq!(scene.lights.len(), 1);
/// ```
pub fn bowl() -> Scene {
    let file = SceneFile::parse("examples/bowl.toml", Path::new(""), BOWL);
    file.expect("the example is valid")
        .scene()
        .expect("it has a shape")
}

/// What a camera would see of this scene in red plastic, with the noise of so many light paths
/// per pixel.
pub fn red_plastic(scene: &Scene, paths_per_pixel: u32) -> Vec<RadianceImage> {
    let material = brdf::load("nbrdf:red-plastic").expect("it is built in");
    let options = RenderOptions {
        samples_per_pixel: paths_per_pixel,
        ..RenderOptions::default()
    };
    render(scene, &*material, &options)
}

/// [`bowl`] in [`red_plastic`], averaged for a fit.
pub fn captured_bowl() -> (Scene, Captured) {
    let scene = bowl();
    let images = red_plastic(&scene, 64);
    let captured = Captured::new(&scene, &images, &CellOptions::exact());
    (scene, captured.expect("the images are those of the scene"))
}
