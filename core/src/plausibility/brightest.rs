//! How bright images of a scene can be at most: by direct reflection, what the brightest atom of
//! a dictionary gives; by interreflection, what a surface that absorbs nothing adds to it.

use crate::brdf::Dictionary;
use crate::brdf::atom::cosine_direction;
use crate::random::{Purpose, Stream, stream};
use crate::transport::direct::for_each_seen;
use crate::transport::scene::Surface;
use crate::transport::{Cells, DirectMatrix, Scene};

/// Above this many times a white sample's radiance no material can be: a mirror of GGX alpha
/// 0.002 that returns all light to the camera has 1/(4 alpha²) times.
const MAX_RADIANCE_RATIO: f64 = 1e5;

/// Square root of the rays through a cell.
const STRATA: u32 = 3;
/// Longest path through a hollow, reflections.
const MAX_REFLECTIONS: u32 = 64;
/// Where an atom is this many times as bright as white, camera and light are each other's mirror
/// images, and a narrower lobe than any atom's could be brighter still.
const MIRROR_RATIO: f64 = 3.0;

/// Mean radiance over the cells of the brightest material, per unit of the light's strength and
/// light. `white` is that of a white Lambertian sample by direct reflection.
pub(super) fn brightest(
    scene: &Scene,
    cells: &Cells,
    dictionary: &Dictionary,
    white: &[f64],
) -> Vec<f64> {
    let direct = DirectMatrix::new(scene, cells, dictionary, STRATA, 0);
    let gains = gains(scene, cells);
    let of_light = |light: usize| {
        let mut means = vec![0.0; dictionary.len()];
        for cell in 0..cells.len() {
            for (mean, value) in means.iter_mut().zip(direct.row(cell, light)) {
                *mean += f64::from(*value) / cells.len() as f64;
            }
        }
        let brightest = means.into_iter().fold(white[light], f64::max);
        match brightest > MIRROR_RATIO * white[light] {
            true => MAX_RADIANCE_RATIO * white[light],
            false => brightest * gains[light],
        }
    };
    (0..scene.lights.len()).map(of_light).collect()
}

/// All light of a white Lambertian sample over its direct reflection, by light: at least 1.
fn gains(scene: &Scene, cells: &Cells) -> Vec<f64> {
    let mut sums = vec![[0.0; 2]; scene.lights.len()];
    for cell in 0..cells.len() {
        let mut numbers = stream(0, Purpose::PathDirection, 0, cells.key(cell), 0);
        for_each_seen(scene, cells, cell, STRATA, 0, |surface, _, _| {
            let first = irradiances(scene, surface, &mut numbers);
            for (sum, direct) in sums.iter_mut().zip(first) {
                *sum = [sum[0] + direct, sum[1] + direct];
            }
            let mut place = *surface;
            for _ in 1..MAX_REFLECTIONS {
                let direction = cosine_direction([numbers.uniform(), numbers.uniform()]);
                let Some((next, _)) = scene.next(&place, direction.as_vec3()) else {
                    break;
                };
                let later = irradiances(scene, &next, &mut numbers);
                for (sum, indirect) in sums.iter_mut().zip(later) {
                    sum[1] += indirect;
                }
                place = next;
            }
        });
    }
    let gain = |[direct, all]: [f64; 2]| if direct > 0.0 { all / direct } else { 1.0 };
    sums.into_iter().map(gain).collect()
}

/// Irradiance at a place per unit of each light's strength.
fn irradiances(scene: &Scene, place: &Surface, numbers: &mut Stream) -> Vec<f64> {
    let of_light = |light: usize| {
        let u = [numbers.uniform_f32(), numbers.uniform_f32()];
        let connection = scene.connect(place, light, u);
        connection.map_or(0.0, |connection| f64::from(connection.irradiance))
    };
    (0..scene.lights.len()).map(of_light).collect()
}
