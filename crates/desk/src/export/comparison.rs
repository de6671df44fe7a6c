//! The picture next to an exported material: spheres of the material, of the model, and their
//! difference, under each environment map, and the grey that tells the exposure.

use super::model::AsModel;
use crate::brdf::sphere::{SphereImage, normals};
use crate::plot::colors::diverging;
use crate::plot::{Picture, PlotError, Tile, pictures, scale_of};

/// Width of a sphere, CSS pixels.
const SIDE_PX: f64 = 128.0;

/// The picture, as a PNG.
///
/// # Errors
/// The figure could not be drawn.
pub fn to_png(material: &AsModel) -> Result<Vec<u8>, PlotError> {
    let spheres = &material.loss.spheres;
    let size = spheres.first().map_or(0, |[_, truth]| truth.size);
    let differences: Vec<Vec<f64>> = spheres.iter().map(difference).collect();
    let range = scale_of(differences.iter().flatten().copied());
    let percent = 100.0 * range;
    let errors = material.loss.environment.maps.iter();
    let rows = errors.zip(spheres).zip(&material.greys).zip(&differences);
    let rows = rows.map(|((((map, error), [model, truth]), grey), difference)| {
        let exposure = grey.neutral_exposure();
        let tile = |caption: String, picture: Vec<[u8; 3]>| Tile {
            caption,
            picture: Picture::opaque(size, picture),
            inset: None,
        };
        let error = format!("error {:.1}%", 100.0 * error);
        let scale = format!("blue −{percent}%, red +{percent}%");
        let tiles = vec![
            tile(String::new(), truth.to_srgb(exposure)),
            tile(error, model.to_srgb(exposure)),
            tile(scale, colours(difference, range, size)),
            tile(String::new(), grey.to_srgb(exposure)),
        ];
        (map.clone(), tiles)
    });
    let rows: Vec<(String, Vec<Tile>)> = rows.collect();
    let model = material.format.name();
    let columns = ["material", model, "model − material", "18% grey"].map(str::to_owned);
    pictures("comparison", SIDE_PX, &columns, &rows).png()
}

/// Model less material over the sphere's pixels, the mean of the channels over the material's
/// root mean square, which the environment error is relative to as well.
fn difference([model, truth]: &[SphereImage; 2]) -> Vec<f64> {
    let places = normals(truth.size);
    let squares = places.iter().flat_map(|(pixel, _)| truth.radiance[*pixel]);
    let squares: f64 = squares.map(|x| f64::from(x).powi(2)).sum();
    let rms = (squares / (3 * places.len().max(1)) as f64).sqrt();
    let at = |pixel: usize| {
        let sum: f32 = (0..3)
            .map(|c| model.radiance[pixel][c] - truth.radiance[pixel][c])
            .sum();
        f64::from(sum) / 3.0 / rms.max(f64::MIN_POSITIVE)
    };
    places.iter().map(|(pixel, _)| at(*pixel)).collect()
}

/// Of differences over the sphere's pixels; white outside.
fn colours(differences: &[f64], range: f64, size: usize) -> Vec<[u8; 3]> {
    let mut pixels = vec![[255; 3]; size * size];
    for ((pixel, _), difference) in normals(size).into_iter().zip(differences) {
        pixels[pixel] = diverging((difference / range) as f32);
    }
    pixels
}
