//! Where the lamps' light arrives by way of mirrors.
//!
//! A wide lobe at one reflection and a narrow one at the next, which must face the lamp, is
//! a chain that continuations drawn from the reflectance almost never find, and the few
//! that do are outliers. Mirror paths sent from the lamps beforehand mark the directions
//! that lead there (photon-guided sampling, Jensen 1995); continuations are drawn from them
//! as well, with a known density (docs/adr/0030). The material's weights play no part, so
//! cached paths stay valid while the fit moves.

use glam::{IVec3, Vec3};
use rayon::prelude::*;

use super::scene::{Scene, Surface};
use crate::random::{Purpose, Stream, stream};

/// Mirror paths per lamp and pixel of the image.
const PER_PIXEL: usize = 8;
/// Mirror paths per lamp.
const PATHS: std::ops::RangeInclusive<usize> = 2048..=65_536;
/// Mirror reflections of a path.
const REFLECTIONS: u32 = 3;
/// First arrivals of one lamp in a cell, if they were even over the sample.
const PER_CELL: f32 = 8.0;
/// Most cells along a side.
const MOST_CELLS: f32 = 128.0;
/// Most lobes of a cell: each costs an evaluation per continuation.
const MOST_LOBES: usize = 24;
/// Least width of a lobe, radians.
const NARROWEST_RAD: f32 = 0.01;
/// Width of a lobe over the angle under which its cell is seen from where it comes.
const SPREAD: f32 = 0.5;

/// Directions from which light arrives, by place on the sample.
pub struct Guide {
    low_mm: Vec3,
    cell_mm: f32,
    cells: IVec3,
    /// `lobes[start[cell]..start[cell + 1]]` arrive in a cell.
    start: Vec<u32>,
    lobes: Vec<Lobe>,
}

/// A direction from which light came, sample frame, widened by the GGX density of normals.
#[derive(Clone, Copy, Debug)]
struct Lobe {
    towards: Vec3,
    alpha2: f32,
}

impl Guide {
    /// Sends mirror paths from all lamps of a scene: from points even over the sample to
    /// which a lamp is visible.
    pub fn new(scene: &Scene, seed: u64) -> Self {
        let mesh = scene.sample();
        let mut area_mm2 = 0.0;
        let area_up_to: Vec<f64> = (0..mesh.triangles.len())
            .map(|triangle| {
                let [a, b, c] = mesh.corners(triangle);
                area_mm2 += 0.5 * f64::from((b - a).cross(c - a).length());
                area_mm2
            })
            .collect();
        let paths = PER_PIXEL * scene.camera.pixels();
        let paths = paths.clamp(*PATHS.start(), *PATHS.end());
        let [low_mm, high_mm] = mesh.bounds_mm();
        let size_mm = high_mm - low_mm;
        let cell_mm = (area_mm2 as f32 * PER_CELL / paths as f32)
            .sqrt()
            .max(size_mm.max_element() / MOST_CELLS);
        let mut guide = Self {
            low_mm,
            cell_mm,
            cells: (size_mm / cell_mm).floor().as_ivec3() + IVec3::ONE,
            start: Vec::new(),
            lobes: Vec::new(),
        };
        let arrivals: Vec<(usize, Lobe)> = (0..scene.lights.len() * paths)
            .into_par_iter()
            .flat_map_iter(|k| {
                let (light, path) = (k / paths, k % paths);
                let mut numbers = stream(seed, Purpose::Guide, light as u64, path as u64, 0);
                let at = area_mm2 * (path as f64 + numbers.uniform()) / paths as f64;
                let triangle = area_up_to.partition_point(|&area| area <= at);
                let triangle = triangle.min(area_up_to.len() - 1) as u32;
                guide.mirror_path(scene, light, triangle, &mut numbers)
            })
            .collect();
        guide.keep(&arrivals);
        guide
    }

    /// Where light of a lamp arrives that meets a triangle and goes on as by mirrors.
    fn mirror_path(
        &self,
        scene: &Scene,
        light: usize,
        triangle: u32,
        numbers: &mut Stream,
    ) -> Vec<(usize, Lobe)> {
        let (root, part) = (numbers.uniform_f32().sqrt(), numbers.uniform_f32());
        let mut surface = scene.surface(triangle, [root * (1.0 - part), root * part]);
        let on_lamp = [numbers.uniform_f32(), numbers.uniform_f32()];
        let mut arrivals = Vec::new();
        let Some(connection) = scene.connect(&surface, light, on_lamp) else {
            return arrivals;
        };
        let mut from = connection.to_light;
        for _ in 0..REFLECTIONS {
            let mirrored = Vec3::new(-from.x, -from.y, from.z);
            let Some((next, back)) = scene.next(&surface, mirrored) else {
                break;
            };
            if !next.is_sample() {
                break;
            }
            let distance_mm = next.origin_mm.distance(surface.origin_mm);
            let spread_rad = SPREAD * self.cell_mm / distance_mm.max(self.cell_mm);
            let lobe = Lobe {
                towards: next.world(back),
                alpha2: spread_rad * spread_rad + NARROWEST_RAD * NARROWEST_RAD,
            };
            arrivals.push((self.cell(next.origin_mm), lobe));
            (surface, from) = (next, back);
        }
        arrivals
    }

    /// Keeps the arrivals by cell; where there are too many, some that are spread evenly
    /// over lamps and places.
    fn keep(&mut self, arrivals: &[(usize, Lobe)]) {
        let mut order: Vec<usize> = (0..arrivals.len()).collect();
        order.sort_by_key(|&k| arrivals[k].0);
        let mut of_cells = order
            .chunk_by(|&a, &b| arrivals[a].0 == arrivals[b].0)
            .peekable();
        self.start.push(0);
        for cell in 0..self.cells.element_product() as usize {
            if let Some(all) = of_cells.next_if(|all| arrivals[all[0]].0 == cell) {
                let kept = all.len().min(MOST_LOBES);
                let evenly = (0..kept).map(|k| arrivals[all[k * all.len() / kept]].1);
                self.lobes.extend(evenly);
            }
            self.start.push(self.lobes.len() as u32);
        }
    }

    fn cell(&self, place_mm: Vec3) -> usize {
        let at = ((place_mm - self.low_mm) / self.cell_mm).floor().as_ivec3();
        let at = at.clamp(IVec3::ZERO, self.cells - IVec3::ONE);
        ((at.z * self.cells.y + at.y) * self.cells.x + at.x) as usize
    }

    /// Directions from which light arrives around a point of the sample; `None` where none
    /// is known.
    #[inline]
    pub fn around(&self, surface: &Surface) -> Option<Arrivals<'_>> {
        let cell = self.cell(surface.origin_mm);
        let lobes = &self.lobes[self.start[cell] as usize..self.start[cell + 1] as usize];
        (!lobes.is_empty()).then_some(Arrivals(lobes))
    }
}

/// A density over directions of the sample's frame.
#[derive(Clone, Copy)]
pub struct Arrivals<'a>(&'a [Lobe]);

impl Arrivals<'_> {
    /// Draws a unit direction.
    #[inline]
    pub fn sample(&self, numbers: &mut Stream) -> Vec3 {
        let place = (numbers.uniform_f32() * self.0.len() as f32) as usize;
        let lobe = &self.0[place.min(self.0.len() - 1)];
        let u = numbers.uniform_f32();
        let tan2 = lobe.alpha2 * u / (1.0 - u);
        let cos = (1.0 + tan2).sqrt().recip();
        let sin = (tan2 / (1.0 + tan2)).sqrt();
        let (sin_phi, cos_phi) = (std::f32::consts::TAU * numbers.uniform_f32()).sin_cos();
        let (tangent, bitangent) = lobe.towards.any_orthonormal_pair();
        (tangent * cos_phi + bitangent * sin_phi) * sin + lobe.towards * cos
    }

    /// Density at a unit direction, 1/sr.
    #[inline]
    pub fn pdf(&self, direction: Vec3) -> f32 {
        let mut sum = 0.0;
        for lobe in self.0 {
            let cos = lobe.towards.dot(direction).max(0.0);
            // 1 − cos² without its cancellation.
            let sin2 = 0.5 * (lobe.towards - direction).length_squared() * (1.0 + cos);
            let t = lobe.alpha2 * cos * cos + sin2;
            sum += lobe.alpha2 * cos / (t * t);
        }
        sum * std::f32::consts::FRAC_1_PI / self.0.len() as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::brdf::chi_square::chi_square;
    use glam::DVec3;
    use std::f32::consts::PI;

    /// The first surface below a place of the bowl's opening.
    fn below(scene: &Scene, x_mm: f32, y_mm: f32) -> Surface {
        let ray = crate::geometry::Ray {
            origin_mm: Vec3::new(x_mm, y_mm, 5.0),
            direction: -Vec3::Z,
            limit_mm: f32::INFINITY,
        };
        scene.first(&ray).unwrap().0
    }

    /// χ² tests at four places, family significance 1% (Šidák).
    #[test]
    fn the_density_belongs_to_the_samples() {
        const CRITICAL: f64 = 2.81;
        let scene = Scene::bowl(64, [16; 2], 2.0);
        let guide = Guide::new(&scene, 1);
        for (k, (x, y)) in [(0.1, 0.0), (0.6, 0.2), (-0.4, 0.7), (0.0, -0.9)]
            .into_iter()
            .enumerate()
        {
            let surface = below(&scene, x, y);
            let arrivals = guide.around(&surface).unwrap();
            let found = chi_square(
                DVec3::Z,
                40_000,
                k as u64,
                |numbers| Some(surface.local(arrivals.sample(numbers)).as_dvec3()),
                |to| f64::from(arrivals.pdf(surface.world(to.as_vec3()))),
            );
            assert!(found.deviate < CRITICAL, "{x}, {y}: {found:?}");
        }
    }

    /// Light down the axis of a spherical mirror that meets it at an angle t from the axis,
    /// as seen from the centre, goes on in steps of π − 2t round it: after n steps it is at
    /// an angle b if t = (nπ ∓ b)/(2n + 1), from the other side or the same.
    #[test]
    fn light_is_sought_where_a_sphere_mirrors_it() {
        let scene = Scene::bowl(64, [64; 2], 2.0); // more pixels make a finer guide
        let guide = Guide::new(&scene, 1);
        let mut numbers = stream(3, Purpose::Experiment, 0, 0, 0);
        let (mut drawn, mut near, mut near_others) = (0, 0, 0);
        for k in 0..400 {
            let b = 0.4 + 0.002 * k as f32;
            let (sin, cos) = (0.7 * k as f32).sin_cos();
            let place = |angle: f32| {
                let r = angle.sin();
                Vec3::new(r * cos, r * sin, -angle.cos())
            };
            let surface = below(&scene, place(b).x, place(b).y);
            let Some(arrivals) = guide.around(&surface) else {
                continue;
            };
            let direction = arrivals.sample(&mut numbers);
            let expected = (1..=REFLECTIONS).flat_map(|n| {
                let n = n as f32;
                [-1.0, 1.0].map(|side| {
                    let t = (n * PI + side * b) / (2.0 * n + 1.0);
                    (place(b + side * (PI - 2.0 * t)) - place(b)).normalize()
                })
            });
            let is_near = |aside: Vec3| {
                let mut expected = expected.clone();
                expected.any(|e| direction.angle_between((e + aside).normalize()) < 0.15)
            };
            drawn += 1;
            near += i32::from(is_near(Vec3::ZERO));
            near_others += i32::from(is_near(Vec3::new(-sin, cos, 0.0)));
        }
        assert!(drawn > 380, "{drawn}");
        // Some come from elsewhere in a cell.
        assert!(2 * near > drawn, "{near} of {drawn}");
        assert!(10 * near_others < drawn, "{near_others} of {drawn}");
    }
}
