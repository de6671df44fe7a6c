//! Direct reflection, which is linear in the weights: an exact cells × atoms
//! matrix per lamp by dense quadrature over each cell's footprint.

use glam::Vec3;
use rayon::prelude::*;

use super::cell_footprints::Cells;
use super::event::LaneAtoms;
use super::points::{Sampler, SobolSampler};
use super::scene::{Connection, Scene, Surface};
use crate::brdf::dictionary::Dictionary;
use crate::brdf::ggx::Cosines;

/// Radiance by direct reflection per unit weight and unit lamp strength.
///
/// ```
/// # use glam::{DVec2, DVec3};
/// # use rig_core::geometry::Shape;
/// # use rig_core::transport::{Camera, Light, Scene, Shading};
/// # let camera = Camera::above([8, 8], DVec2::splat(16.0), 100.0);
/// # let light = Light::distant(DVec3::Z, [1.0; 3]);
/// # let bowl = Shape::Bowl { radius_mm: 10.0, segments: 32 }.mesh()?;
/// # let scene = Scene::new(bowl, Shading::Smooth, camera, vec![light]);
/// use rig_core::brdf::{Atom, Dictionary};
/// use rig_core::transport::{Cells, DirectMatrix};
///
/// let atoms = vec![Atom::Lambertian { albedo: 1.0 }, Atom::Ggx { alpha: 0.3, eta: 1.5 }];
/// let dictionary = Dictionary::new("two", atoms)?;
/// let cells = Cells::of_pixels(scene.camera.resolution_px);
/// let direct = DirectMatrix::new(&scene, &cells, &dictionary, 4, 1);
/// // Per unit weight: a white bottom under light along its normal has the radiance 1/π, less the
/// // cosine of the slope within the cell.
/// let [white, glossy] = *direct.row(3 * 8 + 3, 0) else { panic!("two atoms") };
/// assert!((0.9..1.0).contains(&(white * std::f32::consts::PI)));
/// assert!(glossy > 0.0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct DirectMatrix {
    /// `[(cell · lights + light) · atoms + atom]`.
    values: Vec<f32>,
    /// Fraction of each cell's footprint that shows the front of the sample, 0..=1.
    pub coverage: Vec<f32>,
    /// Fraction of the seen footprint that the lamp reaches, `[cell · lights + light]`.
    lit: Vec<f32>,
    lights: usize,
    atoms: usize,
}

/// Scramble index of the points of direct reflection, distinct from those of both halves of the
/// paths.
const DIRECT_SCRAMBLE: u32 = u32::MAX;

/// Calls `each` where `strata`² rays through a cell meet the sample, with the direction to
/// the viewer and the sampler for the lamps. The rays are quasi-random points: the error of the
/// sum is not part of the render noise that a fit knows of, so it should be small.
pub fn for_each_seen(
    scene: &Scene,
    cells: &Cells,
    cell: usize,
    strata: u32,
    seed: u64,
    mut each: impl FnMut(&Surface, Vec3, &mut SobolSampler),
) {
    for sample in 0..strata * strata {
        let (mut numbers, ray) =
            SobolSampler::begin_in(&scene.camera, cells, seed, cell, DIRECT_SCRAMBLE, sample);
        if let Some((surface, to_viewer)) = scene.first(&ray).filter(|(hit, _)| hit.is_sample()) {
            each(&surface, to_viewer, &mut numbers);
        }
    }
}

/// Likewise, with each light that reaches the point: its number, how it arrives, and the direction to
/// the viewer.
pub fn for_each_lit(
    scene: &Scene,
    cells: &Cells,
    cell: usize,
    strata: u32,
    seed: u64,
    mut each: impl FnMut(usize, &Connection, Vec3),
) {
    for_each_seen(
        scene,
        cells,
        cell,
        strata,
        seed,
        |surface, to_viewer, numbers| {
            for light in 0..scene.lights.len() {
                if let Some(lamp) = scene.connect(surface, light, numbers.on_lamp()) {
                    each(light, &lamp, to_viewer);
                }
            }
        },
    );
}

impl DirectMatrix {
    /// `strata`² samples per cell.
    pub fn new(
        scene: &Scene,
        cells: &Cells,
        dictionary: &Dictionary,
        strata: u32,
        seed: u64,
    ) -> Self {
        let atoms = LaneAtoms::new(dictionary);
        let (n, lights) = (atoms.atoms(), scene.lights.len());
        let rows: Vec<(Vec<f32>, f32, Vec<f32>)> = (0..cells.len())
            .into_par_iter()
            .map(|cell| {
                let mut sums = vec![0.0f64; lights * n];
                let mut seen = 0u32;
                let mut lit = vec![0u32; lights];
                for_each_seen(
                    scene,
                    cells,
                    cell,
                    strata,
                    seed,
                    |surface, to_viewer, numbers| {
                        seen += 1;
                        for light in 0..lights {
                            let u = numbers.on_lamp();
                            let Some(connection) = scene.connect(surface, light, u) else {
                                continue;
                            };
                            lit[light] += 1;
                            let (i, o) = (connection.to_light.to_array(), to_viewer.to_array());
                            if let Some(cosines) = Cosines::new(i, o) {
                                let row = &mut sums[light * n..(light + 1) * n];
                                atoms.add_values(&cosines, f64::from(connection.irradiance), row);
                            }
                        }
                    },
                );
                let samples = f64::from(strata * strata);
                let row = sums.iter().map(|&v| (v / samples) as f32).collect();
                let lit = lit.iter().map(|&n| n as f32 / seen.max(1) as f32).collect();
                (row, (f64::from(seen) / samples) as f32, lit)
            })
            .collect();
        Self {
            values: rows.iter().flat_map(|(row, ..)| row).copied().collect(),
            coverage: rows.iter().map(|(_, coverage, _)| *coverage).collect(),
            lit: rows.iter().flat_map(|(_, _, lit)| lit).copied().collect(),
            lights,
            atoms: n,
        }
    }

    /// The same for the first atoms alone.
    pub fn of_first(&self, atoms: usize) -> Self {
        let rows = self.values.chunks_exact(self.atoms);
        Self {
            values: rows.flat_map(|row| &row[..atoms]).copied().collect(),
            coverage: self.coverage.clone(),
            lit: self.lit.clone(),
            lights: self.lights,
            atoms,
        }
    }

    /// Fraction of a cell's seen footprint that a lamp reaches, 0..=1: between the two
    /// lies the edge of a shadow.
    pub fn lit(&self, cell: usize, light: usize) -> f32 {
        self.lit[cell * self.lights + light]
    }

    /// The row of one cell under one lamp, one value per atom.
    pub fn row(&self, cell: usize, light: usize) -> &[f32] {
        let start = (cell * self.lights + light) * self.atoms;
        &self.values[start..start + self.atoms]
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec2;

    use super::*;
    use crate::random::{Purpose, stream};

    const STRATA: u32 = 16;
    /// A narrow lobe of the dictionary.
    const NARROW: usize = 1;

    /// As by one point anywhere in each of 16² strata.
    fn by_jittered(scene: &Scene, atoms: &LaneAtoms, pixel: usize, seed: u64) -> f64 {
        let mut row = vec![0.0; atoms.atoms()];
        for sample in 0..STRATA * STRATA {
            let mut numbers = stream(seed, Purpose::Experiment, 0, pixel as u64, sample.into());
            let cell = DVec2::new((sample % STRATA).into(), (sample / STRATA).into());
            let position = cell + DVec2::new(numbers.uniform(), numbers.uniform());
            let position = position / f64::from(STRATA);
            let ray = scene
                .camera
                .ray_of_pixel(pixel, position, DVec2::splat(0.5));
            let seen = scene.first(&ray);
            if let Some((surface, to_viewer)) = &seen
                && let Some(lamp) = scene.connect(surface, 0, [0.5; 2])
                && let Some(at) = Cosines::new(lamp.to_light.to_array(), to_viewer.to_array())
            {
                atoms.add_values(&at, lamp.irradiance.into(), &mut row);
            }
        }
        row[NARROW] / f64::from(STRATA * STRATA)
    }

    /// Two sets of the points differ by a tenth of what two jittered ones do; on average all
    /// see the same.
    #[test]
    fn points_in_a_pixel_are_even() {
        let scene = Scene::bowl(64, [24, 24], 2.4);
        let dictionary = Dictionary::paper42();
        let atoms = LaneAtoms::new(&dictionary);
        let cells = Cells::of_pixels(scene.camera.resolution_px);
        let direct =
            [1, 2].map(|seed| DirectMatrix::new(&scene, &cells, &dictionary, STRATA, seed));
        let (mut even, mut jittered, mut square) = (0.0, 0.0, 0.0);
        let mut sums = [0.0; 2];
        for pixel in 0..scene.camera.pixels() {
            // Edges are another matter.
            if direct.iter().any(|direct| direct.coverage[pixel] < 1.0) {
                continue;
            }
            let of = [0, 1].map(|k| f64::from(direct[k].row(pixel, 0)[NARROW]));
            let by_strata = [1, 2].map(|seed| by_jittered(&scene, &atoms, pixel, seed));
            even += (of[0] - of[1]).powi(2);
            jittered += (by_strata[0] - by_strata[1]).powi(2);
            square += of[0] * of[1];
            sums[0] += of[0] + of[1];
            sums[1] += by_strata[0] + by_strata[1];
        }
        let [even, jittered] = [even, jittered].map(|d: f64| (d / square).sqrt());
        println!("differences: even {even}, jittered {jittered}, sums {sums:?}");
        assert!((sums[0] / sums[1] - 1.0).abs() < jittered, "{sums:?}");
        assert!(even < 0.3 * jittered, "{even} for {jittered}");
    }
}
