//! The picture next to an exported material: spheres of the material, of the model, and their
//! difference, under each environment map.

use super::model::AsModel;
use crate::brdf::sphere::{SphereImage, normals};
use crate::plot::{Picture, PlotError, Tile, pictures};

/// Width of a sphere, CSS pixels.
const SIDE_PX: f64 = 128.0;

/// The picture, as a PNG.
///
/// # Errors
/// The figure could not be drawn.
pub fn to_png(material: &AsModel) -> Result<Vec<u8>, PlotError> {
    let errors = material.loss.environment.maps.iter();
    let rows: Vec<(String, Vec<Tile>)> = errors
        .zip(&material.loss.spheres)
        .map(|((map, error), [model, truth])| {
            let exposure = truth.natural_exposure();
            let tile = |caption: String, picture: Vec<[u8; 3]>| Tile {
                caption,
                picture: Picture::opaque(truth.size, picture),
                inset: None,
            };
            let tiles = vec![
                tile(String::new(), truth.to_srgb(exposure)),
                tile(
                    format!("error {:.1}%", 100.0 * error),
                    model.to_srgb(exposure),
                ),
                tile(String::new(), difference(model, truth, exposure)),
            ];
            (map.clone(), tiles)
        })
        .collect();
    let columns = ["material", material.format.name(), "model − material"].map(str::to_owned);
    pictures("comparison", SIDE_PX, &columns, &rows).png()
}

/// Grey where both are the same, lighter where the model is brighter; white outside.
fn difference(model: &SphereImage, truth: &SphereImage, exposure: f32) -> Vec<[u8; 3]> {
    let mut pixels = vec![[255; 3]; truth.radiance.len()];
    for (pixel, _) in normals(truth.size) {
        pixels[pixel] = [0, 1, 2].map(|c| {
            let difference = exposure * (model.radiance[pixel][c] - truth.radiance[pixel][c]);
            (127.5 + 127.5 * difference).clamp(0.0, 255.0) as u8
        });
    }
    pixels
}
