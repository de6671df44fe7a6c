//! Photon guide: from where the lamps' light arrives after mirror reflections.
//!
//! A wide lobe at one reflection and a narrow one at the next, which must face the lamp, is
//! a chain that continuations drawn from the reflectance almost never find, and the few
//! that do are outliers. Mirror paths sent from the lamps beforehand mark the directions
//! that lead there (photon-guided sampling, Jensen 1995), and how these turn with the position,
//! by neighbouring paths (ray differentials, Igehy 1999); continuations are drawn from them
//! as well, with a known density (docs/adr/0030). The material's weights play no part, so
//! cached paths stay valid while the fit moves.

mod four;

use glam::{IVec3, Mat3, Vec3, Vec4};
use rayon::prelude::*;

use four::Four;

use super::scene::{Scene, Surface};
use crate::random::{Purpose, Stream, Uniform, stream};

/// Mirror paths per lamp.
const PATHS: usize = 8192;
/// Mirror reflections of a path.
const REFLECTIONS: u32 = 3;
/// How much less often directions are drawn whose light was mirrored once more.
const FAINTER: f32 = 0.4;
/// First arrivals of one lamp in a cell, if they were even over the sample.
const PER_CELL: f32 = 16.0;
/// Most cells along a side.
const MOST_CELLS: f32 = 128.0;
/// Most directions of a cell: each costs an evaluation per continuation.
const MOST_LOBES: usize = 24;
/// Directions nearer than this, seen from the middle of a cell, are one, radians.
const APART_RAD: f32 = 0.008;
/// Width of a direction that is known at every position, radians: what half-vectors within
/// the narrowest lobe of the dictionaries make of it.
const NARROWEST_RAD: f32 = 0.006;
/// A direction is drawn from lobes of several widths, each this many times as wide as the
/// one before, for reflectances of every width.
const WIDER: f32 = 3.0;
const WIDTHS: i32 = 3;
/// Distance of the neighbouring paths from a mirror path, over the side of a cell.
const BESIDE: f32 = 0.25;
/// Neighbouring paths that arrive nearer than this to one line with the path, as a sine, hold
/// no information across it.
const LEAST_SINE: f32 = 0.002;
/// A direction that turns by more over a cell, radians, is not followed.
const MOST_TURN_RAD: f32 = 0.6;
/// Width of a direction that is not followed, over the angle under which its cell is seen
/// from where it comes.
const SPREAD: f32 = 0.5;

/// Directions from which light arrives, by position on the sample.
pub struct Guide {
    low_mm: Vec3,
    cell_mm: f32,
    cells: IVec3,
    /// `fours[start[cell]..start[cell + 1]]` arrive in a cell.
    start: Vec<u32>,
    fours: Vec<Four>,
}

/// A direction from which light came, sample frame.
#[derive(Clone, Copy, Debug)]
struct Lobe {
    /// Where it arrived.
    position_mm: Vec3,
    towards: Vec3,
    /// What the direction changes by per millimetre that the position moves.
    turn: Mat3,
    /// Square of the least width.
    alpha2: f32,
    /// Probability within a cell; before, in proportion to it.
    share: f32,
}

impl Lobe {
    #[inline]
    fn towards_from(&self, position_mm: Vec3) -> Vec3 {
        (self.towards + self.turn * (position_mm - self.position_mm)).normalize()
    }
}

/// The end of a mirror path, and the local direction from which its light comes.
type End = (Surface, Vec3);

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
        let paths = PATHS;
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
            fours: Vec::new(),
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
        let at = [root * (1.0 - part), root * part];
        let on_lamp = [numbers.uniform_f32(), numbers.uniform_f32()];
        let mut surface = scene.surface(triangle, at);
        let mut arrivals = Vec::new();
        let Some(connection) = scene.connect(&surface, light, on_lamp) else {
            return arrivals;
        };
        let mut from = connection.to_light;
        let mut neighbours = self.neighbours(scene, triangle, at).map(|surface| {
            let lamp = scene.lights[light].sample(surface.origin_mm, on_lamp);
            Some((surface, surface.local(lamp.direction)))
        });
        let mut share = 1.0;
        for _ in 0..REFLECTIONS {
            let mirror = |(surface, from): End| {
                let mirrored = Vec3::new(-from.x, -from.y, from.z);
                let next = scene.next(&surface, mirrored);
                next.filter(|(next, _)| next.is_sample())
            };
            let Some(next) = mirror((surface, from)) else {
                break;
            };
            neighbours = neighbours.map(|path| path.and_then(mirror));
            let position_mm = next.0.origin_mm;
            let (turn, width_rad) = match self.turn(next, neighbours) {
                Some(turn) => (turn, NARROWEST_RAD),
                None => {
                    let distance_mm = position_mm.distance(surface.origin_mm);
                    let spread_rad = SPREAD * self.cell_mm / distance_mm.max(self.cell_mm);
                    (Mat3::ZERO, spread_rad)
                }
            };
            let lobe = Lobe {
                position_mm,
                towards: next.0.world(next.1),
                turn,
                alpha2: width_rad * width_rad,
                share,
            };
            arrivals.push((self.cell(position_mm), lobe));
            (surface, from) = next;
            share *= FAINTER;
        }
        arrivals
    }

    /// Two points of a triangle next to one at barycentric coordinates `at`, in directions
    /// that differ: towards the two corners that are not the nearest.
    fn neighbours(&self, scene: &Scene, triangle: u32, at: [f32; 2]) -> [Surface; 2] {
        const CORNERS: [[f32; 2]; 3] = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]];
        let position_mm = scene.surface(triangle, at).origin_mm;
        let corners_mm = scene.sample().corners(triangle as usize);
        let weights = [1.0 - at[0] - at[1], at[0], at[1]];
        let nearest = (0..3)
            .max_by(|&a, &b| weights[a].total_cmp(&weights[b]))
            .unwrap_or(0);
        [1, 2].map(|next| {
            let corner = (nearest + next) % 3;
            let away_mm = corners_mm[corner].distance(position_mm);
            let step = (BESIDE * self.cell_mm / away_mm).min(0.5);
            let moved = |k: usize| at[k] + step * (CORNERS[corner][k] - at[k]);
            scene.surface(triangle, [moved(0), moved(1)])
        })
    }

    /// What the direction in which light arrives changes by per millimetre, from where and
    /// how it arrives on the neighbouring paths; `None` if they don't determine it, or it is too much.
    fn turn(&self, (surface, back): End, neighbours: [Option<End>; 2]) -> Option<Mat3> {
        let [a, b] = neighbours;
        let differences = |(other, other_back): End| {
            let towards = surface.world(back);
            let moved_mm = other.origin_mm - surface.origin_mm;
            (moved_mm, other.world(other_back) - towards)
        };
        let ((move_a, turn_a), (move_b, turn_b)) = (differences(a?), differences(b?));
        let across = move_a.cross(move_b);
        let area = across.length();
        let sides = move_a.length() * move_b.length();
        if area <= LEAST_SINE * sides {
            return None;
        }
        // The dual basis: how much of each step a move in their plane is.
        let normal = across / area;
        let (along_a, along_b) = (move_b.cross(normal) / area, normal.cross(move_a) / area);
        let turn = outer(turn_a, along_a) + outer(turn_b, along_b);
        let columns = [turn.x_axis, turn.y_axis, turn.z_axis];
        let most = columns.map(Vec3::length_squared).iter().sum::<f32>().sqrt();
        (most * self.cell_mm < MOST_TURN_RAD).then_some(turn)
    }

    /// Keeps the arrivals by cell, one of each direction; where there are too many, some
    /// that are spread evenly over lamps and positions.
    fn keep(&mut self, arrivals: &[(usize, Lobe)]) {
        let mut order: Vec<usize> = (0..arrivals.len()).collect();
        order.sort_by_key(|&k| arrivals[k].0);
        let mut of_cells = order
            .chunk_by(|&a, &b| arrivals[a].0 == arrivals[b].0)
            .peekable();
        self.start.push(0);
        for cell in 0..self.cells.element_product() as usize {
            if let Some(all) = of_cells.next_if(|all| arrivals[all[0]].0 == cell) {
                let distinct = self.distinct(cell, all.iter().map(|&k| arrivals[k].1));
                let kept = distinct.len().min(MOST_LOBES);
                let mut lobes: Vec<Lobe> = (0..kept)
                    .map(|k| distinct[k * distinct.len() / kept])
                    .collect();
                let sum: f32 = lobes.iter().map(|lobe| lobe.share).sum();
                lobes.iter_mut().for_each(|lobe| lobe.share /= sum);
                self.fours.extend(lobes.chunks(4).map(Four::new));
            }
            self.start.push(self.fours.len() as u32);
        }
    }

    /// Those that differ as seen from the middle of a cell, or are narrower than others
    /// from there.
    fn distinct(&self, cell: usize, lobes: impl Iterator<Item = Lobe>) -> Vec<Lobe> {
        let middle_mm = self.middle_mm(cell);
        let mut distinct: Vec<(Vec3, Lobe)> = Vec::new();
        for lobe in lobes {
            let towards = lobe.towards_from(middle_mm);
            let known = |(other, kept): &(Vec3, Lobe)| {
                kept.alpha2 <= lobe.alpha2 && other.distance(towards) < APART_RAD
            };
            if !distinct.iter().any(known) {
                distinct.push((towards, lobe));
            }
        }
        distinct.into_iter().map(|(_, lobe)| lobe).collect()
    }

    fn middle_mm(&self, cell: usize) -> Vec3 {
        let cell = cell as i32;
        let (row, x) = (cell / self.cells.x, cell % self.cells.x);
        let at = IVec3::new(x, row % self.cells.y, row / self.cells.y);
        self.low_mm + (at.as_vec3() + 0.5) * self.cell_mm
    }

    fn cell(&self, position_mm: Vec3) -> usize {
        let at = ((position_mm - self.low_mm) / self.cell_mm)
            .floor()
            .as_ivec3();
        let at = at.clamp(IVec3::ZERO, self.cells - IVec3::ONE);
        ((at.z * self.cells.y + at.y) * self.cells.x + at.x) as usize
    }

    /// Directions from which light arrives around a point of the sample; `None` where none
    /// is known.
    #[inline]
    pub fn around(&self, surface: &Surface) -> Option<Arrivals<'_>> {
        let cell = self.cell(surface.origin_mm);
        let fours = &self.fours[self.start[cell] as usize..self.start[cell + 1] as usize];
        (!fours.is_empty()).then_some(Arrivals {
            fours,
            position_mm: surface.origin_mm,
        })
    }
}

fn outer(column: Vec3, row: Vec3) -> Mat3 {
    Mat3::from_cols(column * row.x, column * row.y, column * row.z)
}

/// A density over directions of the sample's frame, at one position.
#[derive(Clone, Copy)]
pub struct Arrivals<'a> {
    /// At least one.
    fours: &'a [Four],
    position_mm: Vec3,
}

impl Arrivals<'_> {
    /// Draws a unit direction, from three numbers.
    #[inline]
    pub fn sample(&self, numbers: &mut impl Uniform) -> Vec3 {
        let mut choice = numbers.uniform_f32();
        let mut chosen = 0;
        let shares = self.fours.iter().flat_map(Four::shares);
        for (k, share) in shares.enumerate().take_while(|&(_, share)| share > 0.0) {
            chosen = k;
            if choice < share {
                break;
            }
            choice -= share;
        }
        let lobe = self.fours[chosen / 4].lobe(chosen % 4);
        // What is left of the number is uniform again.
        let width = (choice / lobe.share * WIDTHS as f32) as i32;
        let alpha2 = lobe.alpha2 * (WIDER * WIDER).powi(width.min(WIDTHS - 1));
        let u = numbers.uniform_f32();
        let tan2 = alpha2 * u / (1.0 - u);
        let cos = (1.0 + tan2).sqrt().recip();
        let sin = (tan2 / (1.0 + tan2)).sqrt();
        let (sin_phi, cos_phi) = (std::f32::consts::TAU * numbers.uniform_f32()).sin_cos();
        let towards = lobe.towards_from(self.position_mm);
        let (tangent, bitangent) = towards.any_orthonormal_pair();
        (tangent * cos_phi + bitangent * sin_phi) * sin + towards * cos
    }

    /// Density at a unit direction, 1/sr.
    #[inline]
    pub fn pdf(&self, direction: Vec3) -> f32 {
        let parts = self.fours.iter();
        let sum: Vec4 = parts
            .map(|four| four.density(self.position_mm, direction))
            .sum();
        sum.element_sum() * std::f32::consts::FRAC_1_PI / WIDTHS as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::brdf::chi_square::normal_deviate;
    use std::f32::consts::{PI, TAU};

    fn lobes(arrivals: &Arrivals<'_>) -> Vec<Lobe> {
        let all = arrivals
            .fours
            .iter()
            .flat_map(|four| [0, 1, 2, 3].map(|k| four.lobe(k)));
        all.filter(|lobe| lobe.share > 0.0).collect()
    }

    /// The first surface below a position of the bowl's opening.
    fn below(scene: &Scene, x_mm: f32, y_mm: f32) -> Surface {
        let ray = crate::geometry::Ray {
            origin_mm: Vec3::new(x_mm, y_mm, 5.0),
            direction: -Vec3::Z,
            limit_mm: f32::INFINITY,
        };
        scene.first(&ray).unwrap().0
    }

    /// χ² tests around one direction at four positions, in rings that widen by half each and
    /// eight sectors, and what lies outside; family significance 1% (Šidák).
    #[test]
    fn the_density_belongs_to_the_samples() {
        const CRITICAL: f64 = 2.81;
        const RINGS: usize = 9;
        const SECTORS: usize = 8;
        const DRAWS: u32 = 100_000;
        let edge_rad = |ring: f64| 0.002 * 1.5f64.powf(ring);
        let scene = Scene::bowl(64, [16; 2], 2.0);
        let guide = Guide::new(&scene, 1);
        for (x, y) in [(0.1, 0.0), (0.6, 0.2), (-0.4, 0.7), (0.0, -0.9)] {
            let surface = below(&scene, x, y);
            let arrivals = guide.around(&surface).unwrap();
            let narrowest = |a: &&Lobe, b: &&Lobe| a.alpha2.total_cmp(&b.alpha2);
            let lobes = lobes(&arrivals);
            let lobe = lobes.iter().min_by(narrowest).unwrap();
            let axis = lobe.towards_from(arrivals.position_mm);
            let (tangent, bitangent) = axis.any_orthonormal_pair();
            let mut observed = vec![0.0; RINGS * SECTORS + 1];
            let mut numbers = stream(4, Purpose::Experiment, 0, 0, 0);
            for _ in 0..DRAWS {
                let direction = arrivals.sample(&mut numbers);
                let (p, q) = (direction.dot(tangent), direction.dot(bitangent));
                let ring = (0..RINGS).find(|&ring| {
                    direction.dot(axis) > 0.0
                        && f64::from(p.hypot(q)) < edge_rad(ring as f64 + 1.0).sin()
                });
                let turn = f64::from(q.atan2(p) / TAU).rem_euclid(1.0);
                let sector = ((turn * SECTORS as f64) as usize).min(SECTORS - 1);
                observed[ring.map_or(RINGS * SECTORS, |ring| ring * SECTORS + sector)] += 1.0;
            }
            let mut expected: Vec<f64> = (0..RINGS * SECTORS)
                .map(|cell| {
                    let (ring, sector) = (cell / SECTORS, cell % SECTORS);
                    let (inner, outer) = match ring {
                        0 => (0.0, edge_rad(1.0)),
                        _ => (edge_rad(ring as f64), edge_rad(ring as f64 + 1.0)),
                    };
                    midpoints(16)
                        .flat_map(|u| midpoints(16).map(move |v| (u, v)))
                        .map(|(u, v)| {
                            let theta = inner + u * (outer - inner);
                            let phi = f64::from(TAU) * (sector as f64 + v) / SECTORS as f64;
                            let (p, q) = (phi.cos() as f32, phi.sin() as f32);
                            let aside = (tangent * p + bitangent * q) * theta.sin() as f32;
                            let pdf = arrivals.pdf(aside + axis * theta.cos() as f32);
                            f64::from(pdf) * theta.sin() / 256.0
                        })
                        .sum::<f64>()
                        * (outer - inner)
                        * f64::from(TAU)
                        / SECTORS as f64
                        * f64::from(DRAWS)
                })
                .collect();
            expected.push(f64::from(DRAWS) - expected.iter().sum::<f64>());
            let chi2: f64 = observed
                .iter()
                .zip(&expected)
                .map(|(o, e): (&f64, &f64)| (o - e).powi(2) / e)
                .sum();
            let deviate = normal_deviate(chi2, (RINGS * SECTORS) as f64);
            assert!(
                deviate < CRITICAL,
                "{x}, {y}: {deviate} {observed:?} {expected:?}"
            );
            assert!(
                expected[0] > 10.0 && expected[RINGS * SECTORS] > 10.0,
                "{expected:?}"
            );
        }
    }

    fn midpoints(count: u32) -> impl Iterator<Item = f64> {
        (0..count).map(move |k| (f64::from(k) + 0.5) / f64::from(count))
    }

    /// Light down the axis of a spherical mirror that meets it at an angle t from the axis,
    /// as seen from the centre, goes on in steps of π − 2t round it: after n steps it is at
    /// an angle b if t = (nπ ∓ b)/(2n + 1), from the other side or the same.
    #[test]
    fn light_is_sought_where_a_sphere_mirrors_it() {
        const NEAR_RAD: f32 = 0.01;
        const ROUGHLY_RAD: f32 = 0.05; // at the far side of a cell where directions turn fast
        let scene = Scene::bowl(64, [64; 2], 2.0); // more pixels make a finer guide
        let guide = Guide::new(&scene, 1);
        let (mut positions, mut missed, mut followed, mut elsewhere) = (0, 0, 0, 0);
        for k in 0..400 {
            let b = 0.4 + 0.002 * k as f32;
            let (sin, cos) = (0.7 * k as f32).sin_cos();
            let position = |angle: f32| {
                let r = angle.sin();
                Vec3::new(r * cos, r * sin, -angle.cos())
            };
            let surface = below(&scene, position(b).x, position(b).y);
            let Some(arrivals) = guide.around(&surface) else {
                continue;
            };
            let expected: Vec<Vec3> = (1..=REFLECTIONS)
                .flat_map(|n| {
                    let n = n as f32;
                    [-1.0, 1.0].map(|side| {
                        let t = (n * PI + side * b) / (2.0 * n + 1.0);
                        (position(b + side * (PI - 2.0 * t)) - position(b)).normalize()
                    })
                })
                .collect();
            let sought: Vec<Vec3> = lobes(&arrivals)
                .iter()
                .filter(|lobe| lobe.alpha2 <= NARROWEST_RAD * NARROWEST_RAD)
                .map(|lobe| lobe.towards_from(arrivals.position_mm))
                .collect();
            let is_among = |a: &Vec3, all: &[Vec3], near_rad: f32| {
                all.iter().any(|b| a.angle_between(*b) < near_rad)
            };
            positions += 1;
            missed += expected[..2]
                .iter()
                .filter(|e| !is_among(e, &sought, NEAR_RAD))
                .count();
            followed += sought.len();
            elsewhere += sought
                .iter()
                .filter(|s| !is_among(s, &expected, ROUGHLY_RAD))
                .count();
        }
        assert!(positions > 390, "{positions}");
        assert!(10 * missed < 2 * positions, "{missed} of {}", 2 * positions);
        assert!(10 * elsewhere < followed, "{elsewhere} of {followed}");
    }
}
