//! A sphere of a material under an environment map: the picture by which
//! BRDFs are compared.
//!
//! Unit sphere, orthographic view along −z, +y up, direct light only, one sample
//! position per pixel (its centre). The incident directions of each pixel are fixed:
//! [`PER_TECHNIQUE`] of each technique of [`quadrature`] and
//! [`FROM_MAP`] drawn by the map's luminance, combined by the balance heuristic.
//! They don't depend on the material, so two materials are compared with
//! the same rule, and the picture is linear in the BRDF.

use glam::DVec3;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::Brdf;
use super::dictionary::Dictionary;
use super::environment::{EnvironmentMap, MapPosition};
use super::ggx::Cosines;
use super::quadrature::{self, TECHNIQUES};
use crate::random::{Purpose, stream};

/// Directions per technique and pixel.
pub const PER_TECHNIQUE: u32 = 40;
/// Directions per pixel drawn from the map.
pub const FROM_MAP: u32 = 64;

/// The matte grey of photographers' cards, next to which a material is shown: it tells the
/// exposure.
#[derive(Clone, Copy, Debug)]
pub struct GreyCard;

impl GreyCard {
    /// Its albedo.
    pub const REFLECTANCE: f32 = 0.18;
}

impl Brdf for GreyCard {
    fn eval(&self, _: glam::Vec3, _: glam::Vec3) -> [f32; 3] {
        [Self::REFLECTANCE / std::f32::consts::PI; 3]
    }
}

/// Radiance of a sphere over a square image, row 0 at the top.
#[derive(Clone, Debug, PartialEq)]
pub struct SphereImage {
    /// Pixels per side.
    pub size: usize,
    /// R, G, B; zero outside the sphere.
    pub radiance: Vec<[f32; 3]>,
}

impl SphereImage {
    /// The exposure that leaves the brightest 3% of the values to clip.
    pub fn natural_exposure(&self) -> f32 {
        let mut values: Vec<f32> = normals(self.size)
            .into_iter()
            .flat_map(|(pixel, _)| self.radiance[pixel])
            .collect();
        values.sort_by(f32::total_cmp);
        let bright = values.get(values.len() * 97 / 100).copied().unwrap_or(1.0);
        if bright > 0.0 { 1.0 / bright } else { 1.0 }
    }

    /// Of the sphere of a [`GreyCard`]: the exposure under its map that shows it as that grey
    /// where it is brightest, so that a white one is just not too bright. It is the same for
    /// every material, and so a dark one looks dark.
    pub fn neutral_exposure(&self) -> f32 {
        GreyCard::REFLECTANCE * self.natural_exposure()
    }

    /// 8-bit sRGB for looking at, `exposure` × radiance 1 is white; outside the sphere white.
    pub fn to_srgb(&self, exposure: f32) -> Vec<[u8; 3]> {
        let mut pixels = vec![[255; 3]; self.radiance.len()];
        for (pixel, _) in normals(self.size) {
            pixels[pixel] = self.radiance[pixel].map(|x| srgb8(exposure * x));
        }
        pixels
    }
}

/// 8-bit sRGB of a linear value; 1 is white.
pub fn srgb8(x: f32) -> u8 {
    let x = x.clamp(0.0, 1.0);
    let encoded = if x <= 0.003_130_8 {
        12.92 * x
    } else {
        1.055 * x.powf(1.0 / 2.4) - 0.055
    };
    (255.0 * encoded + 0.5) as u8
}

/// Pixels whose centre lies on the sphere, with the normal there.
pub fn normals(size: usize) -> Vec<(usize, DVec3)> {
    let coordinate = |k: usize| (2.0 * k as f64 + 1.0) / size as f64 - 1.0;
    (0..size * size)
        .filter_map(|pixel| {
            let (x, y) = (coordinate(pixel % size), -coordinate(pixel / size));
            let z2 = 1.0 - x * x - y * y;
            (z2 > 0.0).then(|| (pixel, DVec3::new(x, y, z2.sqrt())))
        })
        .collect()
}

/// A direction from which light reaches one pixel's point.
#[derive(Clone, Copy)]
pub(super) struct Incident {
    at: Cosines<f32>,
    pub to_light: glam::Vec3,
    pub to_viewer: glam::Vec3,
}

/// What arrives from there under one of the maps.
#[derive(Clone, Copy)]
pub(super) struct Arriving {
    pub map: usize,
    /// Radiance × cosine × quadrature weight, R, G, B.
    pub irradiance: [f32; 3],
}

/// Hands out the directions of one pixel with what arrives from each. Those of the lobes
/// serve all maps, so that a BRDF is evaluated there once; those drawn from a map serve it
/// alone.
pub(super) fn incident(
    maps: &[EnvironmentMap],
    pixel: usize,
    normal: DVec3,
    mut each: impl FnMut(&Incident, &[Arriving]),
) {
    let mut numbers = stream(0, Purpose::Experiment, 0, pixel as u64, 0);
    let shift = [numbers.uniform(), numbers.uniform()];
    // The local frame: the viewer (+z) lies in its xz plane.
    let tangent = (DVec3::Z - normal * normal.z)
        .try_normalize()
        .unwrap_or(DVec3::X);
    let bitangent = normal.cross(tangent);
    let to_local = |d: DVec3| DVec3::new(d.dot(tangent), d.dot(bitangent), d.dot(normal));
    let to_world = |d: DVec3| d.x * tangent + d.y * bitangent + d.z * normal;
    let viewer = to_local(DVec3::Z);

    let mut arriving = Vec::with_capacity(maps.len());
    let mut hand_out = |local: DVec3, world: DVec3, served: std::ops::Range<usize>| {
        let (to_light, to_viewer) = (local.as_vec3(), viewer.as_vec3());
        let Some(at) = Cosines::new(to_light.to_array(), to_viewer.to_array()) else {
            return;
        };
        let of_lobes =
            f64::from(PER_TECHNIQUE) * TECHNIQUES as f64 * quadrature::density(viewer, local);
        let position = MapPosition::of(world);
        arriving.clear();
        arriving.extend(served.map(|map| {
            let (radiance, map_density) = maps[map].at(position);
            let scale = (local.z / (of_lobes + f64::from(FROM_MAP) * map_density)) as f32;
            Arriving {
                map,
                irradiance: radiance.map(|l| l * scale),
            }
        }));
        let light = Incident {
            at,
            to_light,
            to_viewer,
        };
        each(&light, &arriving);
    };
    for local in quadrature::directions(viewer, PER_TECHNIQUE, shift) {
        hand_out(local, to_world(local), 0..maps.len());
    }
    for (map, of_map) in maps.iter().enumerate() {
        for k in 0..FROM_MAP {
            let world = of_map.sample(quadrature::point(k, FROM_MAP, shift));
            hand_out(to_local(world), world, map..map + 1);
        }
    }
}

/// The sphere of `brdf` under `map`, `size` × `size` pixels.
///
/// ```
/// use rig_core::brdf::environment::EnvironmentMap;
/// use rig_core::brdf::{source, sphere};
///
/// let map = EnvironmentMap::embedded("sunset").expect("one of NAMES");
/// let image = sphere::sphere_image(source::load("ggx:0.1,1.5")?.as_ref(), &map, 8);
/// // 8-bit sRGB, row by row, white around the sphere.
/// let pixels = image.to_srgb(image.natural_exposure());
/// assert_eq!((pixels.len(), pixels[0]), (64, [255; 3]));
/// # Ok::<(), rig_core::brdf::BrdfError>(())
/// ```
pub fn sphere_image(brdf: &dyn Brdf, map: &EnvironmentMap, size: usize) -> SphereImage {
    let mut images = sphere_images(&[brdf], std::slice::from_ref(map), size);
    images.swap_remove(0).swap_remove(0)
}

/// [`sphere_image`] of several BRDFs under several maps, in the time that one takes and
/// little more: per map one image of each.
pub fn sphere_images(
    brdfs: &[&dyn Brdf],
    maps: &[EnvironmentMap],
    size: usize,
) -> Vec<Vec<SphereImage>> {
    images_of(
        &shade(brdfs, maps, &normals(size)),
        [maps.len(), brdfs.len()],
        size,
    )
}

fn images_of(
    shaded: &[(usize, Vec<[f32; 3]>)],
    [maps, brdfs]: [usize; 2],
    size: usize,
) -> Vec<Vec<SphereImage>> {
    let image = |map: usize, brdf: usize| {
        let mut radiance = vec![[0.0; 3]; size * size];
        for (pixel, values) in shaded {
            radiance[*pixel] = values[map * brdfs + brdf];
        }
        SphereImage { size, radiance }
    };
    let under = |map| (0..brdfs).map(|brdf| image(map, brdf)).collect();
    (0..maps).map(under).collect()
}

/// A sphere with the light that reaches each pixel, for the pictures of many BRDFs: each is
/// that of [`sphere_images`] in the time of its evaluations alone. Four maps take 50 kB a
/// pixel.
pub struct LitSphere {
    size: usize,
    maps: usize,
    pixels: Vec<LitPixel>,
}

/// A pixel's index and what reaches it.
type LitPixel = (usize, Vec<(Incident, Box<[Arriving]>)>);

impl LitSphere {
    /// Under some maps, `size` × `size` pixels.
    pub fn new(maps: &[EnvironmentMap], size: usize) -> Self {
        let lit = |(pixel, normal)| {
            let mut lights = Vec::new();
            incident(maps, pixel, normal, |light, arriving| {
                lights.push((*light, arriving.into()));
            });
            (pixel, lights)
        };
        Self {
            size,
            maps: maps.len(),
            pixels: normals(size).into_par_iter().map(lit).collect(),
        }
    }

    /// The sphere of `brdf` under each map.
    pub fn images(&self, brdf: &dyn Brdf) -> Vec<SphereImage> {
        let shade = |(pixel, lights): &LitPixel| {
            let mut sums = vec![[0.0f64; 3]; self.maps];
            for (light, arriving) in lights {
                reflect(&[brdf], light, arriving, &mut sums);
            }
            (*pixel, to_f32(&sums))
        };
        let shaded: Vec<_> = self.pixels.par_iter().map(shade).collect();
        images_of(&shaded, [self.maps, 1], self.size).concat()
    }
}

/// Radiance towards the viewer at +z of surface points, given by a pixel (which keys the
/// quadrature) and a unit normal, without shadows: R, G, B of each BRDF under the first
/// map, then under the others.
pub fn shade(
    brdfs: &[&dyn Brdf],
    maps: &[EnvironmentMap],
    points: &[(usize, DVec3)],
) -> Vec<(usize, Vec<[f32; 3]>)> {
    points
        .par_iter()
        .map(|&(pixel, normal)| {
            let mut sums = vec![[0.0f64; 3]; maps.len() * brdfs.len()];
            incident(maps, pixel, normal, |light, arriving| {
                reflect(brdfs, light, arriving, &mut sums);
            });
            (pixel, to_f32(&sums))
        })
        .collect()
}

/// Adds what each BRDF reflects of one direction's light.
fn reflect(brdfs: &[&dyn Brdf], light: &Incident, arriving: &[Arriving], sums: &mut [[f64; 3]]) {
    for (k, brdf) in brdfs.iter().enumerate() {
        let f = brdf.eval(light.to_light, light.to_viewer);
        for Arriving { map, irradiance } in arriving {
            let sum = &mut sums[map * brdfs.len() + k];
            for c in 0..3 {
                sum[c] += f64::from(f[c] * irradiance[c]);
            }
        }
    }
}

fn to_f32(sums: &[[f64; 3]]) -> Vec<[f32; 3]> {
    sums.iter().map(|sum| sum.map(|s| s as f32)).collect()
}

/// The sphere images of all atoms of a dictionary under one map: the image of a mixture is
/// this matrix times its weights.
#[derive(Clone, Debug)]
pub struct SphereMatrix {
    /// Pixels on the sphere, in the order of the rows.
    pub pixels: Vec<usize>,
    /// Per channel: radiance, pixels on the sphere × atoms.
    pub channels: [DMatrix<f64>; 3],
}

impl SphereMatrix {
    /// A channel of an image of the same size, at the rows' pixels.
    pub fn column_of(&self, image: &SphereImage, channel: usize) -> DVector<f64> {
        DVector::from_iterator(
            self.pixels.len(),
            self.pixels
                .iter()
                .map(|&pixel| f64::from(image.radiance[pixel][channel])),
        )
    }
}

/// [`sphere_image`] of every atom at once.
pub fn sphere_matrix(dictionary: &Dictionary, map: &EnvironmentMap, size: usize) -> SphereMatrix {
    let (mut matrices, _) = sphere_matrices(dictionary, std::slice::from_ref(map), size, &[]);
    matrices.swap_remove(0)
}

/// [`sphere_matrix`] under several maps and, in the same pass, [`sphere_images`] of some
/// BRDFs.
pub fn sphere_matrices(
    dictionary: &Dictionary,
    maps: &[EnvironmentMap],
    size: usize,
    brdfs: &[&dyn Brdf],
) -> (Vec<SphereMatrix>, Vec<Vec<SphereImage>>) {
    let evaluator = dictionary.evaluator();
    let n = dictionary.len();
    let points = normals(size);
    // Per pixel: of each map and channel the atoms, and what the BRDFs reflect.
    let (rows, shaded): (Vec<Vec<f64>>, Vec<_>) = points
        .par_iter()
        .map(|&(pixel, normal)| {
            let mut values = vec![0.0f32; n];
            let mut sums = vec![0.0f64; maps.len() * 3 * n];
            let mut reflected = vec![[0.0f64; 3]; maps.len() * brdfs.len()];
            incident(maps, pixel, normal, |light, arriving| {
                evaluator.eval(&light.at, &mut values);
                for Arriving { map, irradiance } in arriving {
                    let sums = sums[map * 3 * n..].chunks_exact_mut(n);
                    for (sums, irradiance) in sums.zip(irradiance) {
                        for (sum, value) in sums.iter_mut().zip(&values) {
                            *sum += f64::from(value * irradiance);
                        }
                    }
                }
                reflect(brdfs, light, arriving, &mut reflected);
            });
            (sums, (pixel, to_f32(&reflected)))
        })
        .unzip();
    let pixels: Vec<usize> = points.iter().map(|&(pixel, _)| pixel).collect();
    let matrix = |map: usize| SphereMatrix {
        pixels: pixels.clone(),
        channels: [0, 1, 2].map(|c| {
            let first = (3 * map + c) * n;
            DMatrix::from_fn(rows.len(), n, |row, atom| rows[row][first + atom])
        }),
    };
    let matrices = (0..maps.len()).map(matrix).collect();
    (
        matrices,
        images_of(&shaded, [maps.len(), brdfs.len()], size),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::brdf::dictionary::Atom;
    use crate::brdf::mixture::Mixture;
    use std::sync::Arc;

    fn uniform() -> EnvironmentMap {
        EnvironmentMap::new("uniform", 8, 4, vec![[1.0, 2.0, 3.0]; 32]).unwrap()
    }

    #[test]
    fn a_white_sphere_under_a_uniform_sky_is_flat() {
        let dictionary = Dictionary::new("white", vec![Atom::Lambertian { albedo: 1.0 }]).unwrap();
        let white = Mixture::grey(Arc::new(dictionary), vec![1.0]).unwrap();
        let image = sphere_image(&white, &uniform(), 24);
        for (pixel, normal) in normals(24) {
            for (c, want) in [1.0, 2.0, 3.0].into_iter().enumerate() {
                let got = image.radiance[pixel][c];
                assert!(
                    (got / want - 1.0).abs() < 0.06,
                    "{normal}: {got} for {want}"
                );
            }
        }
        assert_eq!(image.radiance[0], [0.0; 3]);
    }

    #[test]
    fn light_from_above_lights_the_top() {
        let mut texels = vec![[0.0; 3]; 32 * 16];
        texels[..32 * 3].fill([1.0; 3]);
        let map = EnvironmentMap::new("above", 32, 16, texels).unwrap();
        let dictionary = Dictionary::new("white", vec![Atom::Lambertian { albedo: 1.0 }]).unwrap();
        let white = Mixture::grey(Arc::new(dictionary), vec![1.0]).unwrap();
        let image = sphere_image(&white, &map, 16);
        let mean = |rows: std::ops::Range<usize>| -> f32 {
            rows.map(|r| image.radiance[r * 16 + 8][0]).sum()
        };
        assert!(mean(1..4) > 10.0 * mean(12..15));
    }

    /// What maps and BRDFs share changes nothing of any image.
    #[test]
    fn several_maps_and_brdfs_in_one_pass_are_each_alone() {
        let dictionary = Arc::new(Dictionary::rig26());
        let maps = EnvironmentMap::all();
        let mixture = |atom: usize| {
            let mut weights = vec![0.0; dictionary.len()];
            weights[atom] = 1.0;
            Mixture::grey(dictionary.clone(), weights).unwrap()
        };
        let (narrow, wide) = (mixture(2), mixture(17));
        let (matrices, images) = sphere_matrices(&dictionary, &maps, 10, &[&narrow, &wide]);
        let together = sphere_images(&[&wide, &narrow], &maps, 10);
        let lit = LitSphere::new(&maps, 10);
        for (k, brdf) in [&wide, &narrow].into_iter().enumerate() {
            let images = lit.images(brdf);
            assert!(
                images
                    .iter()
                    .zip(&together)
                    .all(|(image, under)| *image == under[k])
            );
        }
        for (k, map) in maps.iter().enumerate() {
            let alone = [&narrow, &wide].map(|brdf| sphere_image(brdf, map, 10));
            assert_eq!(images[k], alone, "{}", map.name());
            assert_eq!(together[k], [alone[1].clone(), alone[0].clone()]);
            let matrix = sphere_matrix(&dictionary, map, 10);
            assert_eq!(matrices[k].channels, matrix.channels);
        }
    }

    #[test]
    fn the_matrix_times_weights_is_the_image() {
        let dictionary = Arc::new(Dictionary::paper42());
        let map = EnvironmentMap::embedded("city").unwrap();
        let mut weights = vec![0.0; 42];
        (weights[3], weights[22], weights[40], weights[41]) = (0.2, 0.3, 0.4, 0.1);
        let image = sphere_image(
            &Mixture::grey(dictionary.clone(), weights.clone()).unwrap(),
            &map,
            12,
        );
        let matrix = sphere_matrix(&dictionary, &map, 12);
        for c in 0..3 {
            let product = &matrix.channels[c] * DVector::from_vec(weights.clone());
            let direct = matrix.column_of(&image, c);
            assert!((product - &direct).norm() < 1e-5 * direct.norm());
        }
    }
}
