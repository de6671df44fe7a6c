//! Spheres under the environment maps, one row for each BRDF and one of the grey that tells
//! the exposure.

use super::Named;
use crate::brdf::Brdf;
use crate::brdf::environment::EnvironmentMap;
use crate::brdf::score::image_error;
use crate::brdf::sphere::{GreyCard, SphereImage, normals, sphere_images};
use crate::plot::{Figure, Picture, Tile, pictures};

/// Spheres of `size_px` pixels a side. Each map has one neutral exposure for all BRDFs; below
/// each is its environment error against the last one.
pub fn sphere_rows(all: &[Named], size_px: usize) -> Figure {
    let maps = EnvironmentMap::all();
    let mut brdfs: Vec<&dyn Brdf> = all.iter().map(|named| &*named.brdf).collect();
    brdfs.push(&GreyCard);
    let images = sphere_images(&brdfs, &maps, size_px);
    let last = all.len() - 1;
    let row = |n: usize| {
        let tiles = images.iter().map(|under| {
            let reference = &under[last];
            let caption = match n {
                n if n == last && last > 0 => "reference".to_owned(),
                n if n >= last => String::new(),
                _ => format!(
                    "off by {:.1}%",
                    100.0 * image_error(&under[n], reference).all
                ),
            };
            Tile {
                caption,
                picture: picture(&under[n], under[all.len()].neutral_exposure()),
                inset: None,
            }
        });
        let label = all.get(n).map_or("18% grey", |named| &named.label);
        (label.to_owned(), tiles.collect())
    };
    let rows: Vec<(String, Vec<Tile>)> = (0..brdfs.len()).map(row).collect();
    let names: Vec<String> = maps.iter().map(|map| map.name().to_owned()).collect();
    pictures("spheres", SHOWN_PX, &names, &rows)
}

/// Side of a sphere, CSS pixels.
const SHOWN_PX: f64 = 180.0;

/// Transparent around the sphere.
fn picture(sphere: &SphereImage, exposure: f32) -> Picture {
    let mut pixels: Vec<[u8; 4]> = vec![[0; 4]; sphere.size * sphere.size];
    let colors = sphere.to_srgb(exposure);
    for (pixel, _) in normals(sphere.size) {
        let [r, g, b] = colors[pixel];
        pixels[pixel] = [r, g, b, 255];
    }
    Picture {
        width: sphere.size,
        height: sphere.size,
        pixels,
    }
}
