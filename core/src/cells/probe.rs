//! A look at the scene on a lattice of sensor positions: what is seen, which lights reach it,
//! and how fast the angles change from one position to the next.

use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;

use super::{CellOptions, Square};
use crate::transport::Scene;
use crate::transport::cell_footprints::{Cell, FIELD_PARTS};
use crate::transport::scene::Surface;

/// Most lattice points along the longer side of an image.
const MAX_POINTS: usize = 768;
/// Reflections at which the half angle is looked at, the first and after mirror reflections,
/// and how much each counts: less light comes by way of more.
const REFLECTIONS: [f32; 3] = [1.0, 0.5, 0.25];
/// Change of the difference angle that counts like a change of the half angle by the width of
/// the narrowest lobe that can be resolved there, radians.
const DIFFERENCE_RAD: f32 = 0.17;
/// Most that a change between neighbouring points counts: at a crease it says nothing of how
/// much finer cells would show.
const MAX_CHANGE: f32 = 1.0;
/// Half width of what is left out at an edge, in standard deviations of where the edge is.
const EDGE_DEVIATIONS: f64 = 1.5;
/// Least and most that is left out, in 64ths of the image's width: what a mesh says of an edge is no
/// better known. Next to a ball's silhouette lie the largest difference angles that it shows.
const EDGE_WIDTHS: [f64; 2] = [0.25, 4.0];
/// Standard deviations of the point spread beyond which an edge is not seen.
const SPREAD_DEVIATIONS: f64 = 3.0;

/// Squares of pixels that are looked at by one ray each.
pub struct Lattice {
    /// Pixels along a side of a square: a power of two.
    step_px: u32,
    /// Columns and rows.
    pub size: [u32; 2],
    points: Vec<Point>,
}

/// What is known of a lattice point or of a square of them.
#[derive(Clone, Copy, Debug, Default)]
pub struct Point {
    /// Points on the sample, away from silhouettes.
    pub valid: u32,
    /// Sum of the squared change to the next point over the valid ones.
    change2: f32,
    /// Lights, as bits, near the edge of whose shadow some of the valid points lie, or all.
    pub some_edges: u64,
    pub all_edges: u64,
}

impl Point {
    /// How much the angles vary across a square of this level.
    pub fn variation(&self, level: usize) -> f64 {
        let mean = f64::from(self.change2) / f64::from(self.valid.max(1));
        f64::from(1u32 << level) * mean.sqrt()
    }

    fn join(&mut self, other: &Self) {
        if other.valid > 0 {
            self.all_edges = match self.valid {
                0 => other.all_edges,
                _ => self.all_edges & other.all_edges,
            };
            self.some_edges |= other.some_edges;
            self.valid += other.valid;
            self.change2 += other.change2;
        }
    }
}

/// Squares of one size.
pub struct Level {
    /// Columns and rows.
    pub size: [u32; 2],
    points: Vec<Point>,
}

impl Level {
    pub fn at(&self, [x, y]: [u32; 2]) -> &Point {
        &self.points[(y * self.size[0] + x) as usize]
    }

    pub fn squares(&self, level: usize) -> impl Iterator<Item = Square> {
        let [columns, rows] = self.size;
        (0..rows).flat_map(move |y| (0..columns).map(move |x| Square { level, at: [x, y] }))
    }

    /// Squares that have valid points.
    pub fn seen(&self) -> usize {
        self.points.iter().filter(|point| point.valid > 0).count()
    }

    fn next(&self) -> Self {
        let [columns, rows] = self.size;
        let size = self.size.map(|n| n.div_ceil(2));
        let mut points = vec![Point::default(); (size[0] * size[1]) as usize];
        for y in 0..rows {
            for x in 0..columns {
                points[(y / 2 * size[0] + x / 2) as usize].join(self.at([x, y]));
            }
        }
        Self { size, points }
    }
}

/// What a ray through a lattice point finds.
struct Seen {
    on_sample: bool,
    /// Lights that reach the place, as bits.
    lit: u64,
    /// Per light: arsinh of the half angle over the narrowest roughness, of each reflection;
    /// then the difference angle over [`DIFFERENCE_RAD`]. NaN where the light does not reach.
    angles: Vec<[f32; REFLECTIONS.len() + 1]>,
}

impl Lattice {
    /// Sends the rays.
    pub fn look(scene: &Scene, options: &CellOptions) -> Self {
        let resolution_px = scene.camera.resolution_px;
        let longest = resolution_px[0].max(resolution_px[1]);
        let step_px = longest.div_ceil(MAX_POINTS).next_power_of_two() as u32;
        let size = resolution_px.map(|n| (n as u32).div_ceil(step_px));
        let narrowest = narrowest_alpha(scene, options);
        let rows: Vec<Vec<Seen>> = (0..size[1])
            .into_par_iter()
            .map(|y| {
                let middle = |at: u32| (f64::from(at) + 0.5) * f64::from(step_px);
                (0..size[0])
                    .map(|x| see(scene, DVec2::new(middle(x), middle(y)), narrowest))
                    .collect()
            })
            .collect();

        let [silhouettes, shadows] = edge_widths_px(scene, options)
            // An edge lies anywhere between the points on its two sides.
            .map(|width| width.max(0.25) / f64::from(step_px) + 1.0);
        let flat =
            |of: &dyn Fn(&Seen) -> bool| -> Vec<bool> { rows.iter().flatten().map(of).collect() };
        let off_sample = grown(&flat(&|seen| !seen.on_sample), size, silhouettes);
        let mut edges = vec![0u64; off_sample.len()];
        for light in 0..scene.lights.len() {
            let on = |seen: &Seen, lit: bool| seen.on_sample && (seen.lit >> light & 1 == 1) == lit;
            let [lit, unlit] =
                [true, false].map(|lit| grown(&flat(&|seen| on(seen, lit)), size, shadows));
            for (edge, (lit, unlit)) in edges.iter_mut().zip(lit.into_iter().zip(unlit)) {
                *edge |= u64::from(lit && unlit) << light;
            }
        }

        let points = (0..off_sample.len())
            .map(|k| {
                if off_sample[k] {
                    return Point::default();
                }
                let (x, y) = (k % size[0] as usize, k / size[0] as usize);
                let here = &rows[y][x];
                let next = [rows[y].get(x + 1), rows.get(y + 1).map(|row| &row[x])];
                let changes = next.into_iter().flatten().map(|next| {
                    let compared = |light: usize| edges[k] >> light & 1 == 0;
                    change(here, next, compared)
                });
                Point {
                    valid: 1,
                    change2: changes.fold(0.0, f32::max).powi(2),
                    some_edges: edges[k],
                    all_edges: edges[k],
                }
            })
            .collect();
        Self {
            step_px,
            size,
            points,
        }
    }

    /// Squares of 1, 2, 4, … points on either side, up to one for all.
    pub fn levels(&self) -> Vec<Level> {
        let mut levels = vec![Level {
            size: self.size,
            points: self.points.clone(),
        }];
        while let Some(last) = levels.last()
            && last.size != [1, 1]
        {
            levels.push(last.next());
        }
        levels
    }

    /// The pixels of a square that are valid; `None` if none is.
    pub fn cell(&self, square: Square) -> Option<Cell> {
        let side = 1u32 << square.level;
        let [left, top] = square.at.map(|at| at * side);
        let corner_px = [left * self.step_px, top * self.step_px];
        let side_px = side * self.step_px;
        let mut offsets = Vec::with_capacity((side_px * side_px) as usize);
        for dy in 0..side_px {
            for dx in 0..side_px {
                let [x, y] = [left + dx / self.step_px, top + dy / self.step_px];
                let [columns, rows] = self.size;
                let known = x < columns && y < rows;
                if known && self.points[(y * columns + x) as usize].valid > 0 {
                    offsets.push([dx as u16, dy as u16]);
                }
            }
        }
        Cell::part_of(corner_px, side_px, offsets)
    }
}

/// The narrowest lobe as the bench can resolve it: wider by what lamp, lens and pose blur.
fn narrowest_alpha(scene: &Scene, options: &CellOptions) -> f32 {
    let lamps = scene.lights.iter().map(|light| light.angular_radius_rad());
    let lamp = 0.5 * lamps.fold(0.0, f64::max);
    let pose = options.known.rotation_rad;
    let lens = 0.5 * scene.camera.object_na;
    let squares = [options.narrowest_alpha, lamp, lens, pose].map(|width| width * width);
    squares.iter().sum::<f64>().sqrt() as f32
}

/// How far from a silhouette, and from the edge of a shadow, pixels are left out.
fn edge_widths_px(scene: &Scene, options: &CellOptions) -> [f64; 2] {
    let known = &options.known;
    let [low, high] = scene.sample().bounds_mm().map(|v| v.as_dvec3());
    let (middle, radius_mm) = (0.5 * (low + high), 0.5 * low.distance(high));
    let px_per_mm = px_per_mm(scene, middle);
    let [rotation_rad, translation_mm] = match &known.pose_covariance {
        Some(covariance) => {
            let deviation = |from: usize| {
                let largest = (from..from + 3).map(|k| covariance[k][k]);
                largest.fold(0.0, f64::max).sqrt()
            };
            [deviation(0), deviation(3)]
        }
        None => [known.rotation_rad, known.translation_mm],
    };
    let pose_px = px_per_mm * translation_mm.hypot(rotation_rad * radius_mm);
    let light_rad = known.light_rad.hypot(known.stage_rad);
    let shadow_px = pose_px.hypot(px_per_mm * light_rad * radius_mm);
    let spread_px = SPREAD_DEVIATIONS * scene.camera.point_spread_px;
    let field_px = scene.camera.resolution_px[0] as f64 / FIELD_PARTS;
    [pose_px, shadow_px].map(|deviation| {
        let width_px = 0.5 + EDGE_DEVIATIONS * deviation + spread_px;
        let [least, most] = EDGE_WIDTHS.map(|part| part * field_px);
        width_px.clamp(least, most)
    })
}

/// Scale of the image at a point, along the image's rows and columns, the larger.
fn px_per_mm(scene: &Scene, at: DVec3) -> f64 {
    const STEP_MM: f64 = 1e-3;
    let camera = &scene.camera;
    let axes = [DVec3::X, DVec3::Y].map(|axis| camera.sample_from_camera.direction(axis));
    let scales = axes.map(|axis| {
        let ends = [1.0, -1.0].map(|sign| camera.position_px(at + sign * STEP_MM * axis));
        match ends {
            [Some(a), Some(b)] => a.distance(b) / (2.0 * STEP_MM),
            _ => 0.0,
        }
    });
    scales[0].max(scales[1])
}

fn see(scene: &Scene, at_px: DVec2, narrowest: f32) -> Seen {
    let lights = scene.lights.len();
    let mut seen = Seen {
        on_sample: false,
        lit: 0,
        angles: vec![[f32::NAN; REFLECTIONS.len() + 1]; lights],
    };
    let ray = scene.camera.ray(at_px, DVec2::ZERO);
    let mut next = scene.first(&ray).filter(|(hit, _)| hit.is_sample());
    seen.on_sample = next.is_some();
    for reflection in 0..REFLECTIONS.len() {
        let Some((surface, to_viewer)) = next else {
            break;
        };
        for (light, angles) in seen.angles.iter_mut().enumerate() {
            let Some([half, difference]) = half_difference(scene, &surface, to_viewer, light)
            else {
                continue;
            };
            angles[reflection] = (half / narrowest).asinh();
            if reflection == 0 {
                seen.lit |= 1 << light;
                angles[REFLECTIONS.len()] = difference / DIFFERENCE_RAD;
            }
        }
        let mirrored = Vec3::new(-to_viewer.x, -to_viewer.y, to_viewer.z);
        next = scene
            .next(&surface, mirrored)
            .filter(|(hit, _)| hit.is_sample());
    }
    seen
}

/// Half and difference angle under a light, radians; `None` where it does not reach.
fn half_difference(
    scene: &Scene,
    surface: &Surface,
    to_viewer: Vec3,
    light: usize,
) -> Option<[f32; 2]> {
    let to_light = scene.connect(surface, light, [0.5; 2])?.to_light;
    let half = (to_light + to_viewer).normalize();
    let sine = half.truncate().length();
    Some([
        sine.atan2(half.z),
        half.dot(to_light).clamp(-1.0, 1.0).acos(),
    ])
}

/// The largest change between neighbouring points, of the angles under the lights that are
/// `compared` here.
fn change(here: &Seen, next: &Seen, compared: impl Fn(usize) -> bool) -> f32 {
    let mut largest = 0.0f32;
    for light in (0..here.angles.len()).filter(|&light| compared(light)) {
        let [a, b] = [here, next].map(|seen| &seen.angles[light]);
        let weights = REFLECTIONS.iter().chain(&[1.0]);
        for (weight, (a, b)) in weights.zip(a.iter().zip(b)) {
            let change = match (a.is_nan(), b.is_nan()) {
                (true, true) => 0.0,
                (false, false) => (a - b).abs().min(MAX_CHANGE),
                // An edge of what is reached by way of mirrors.
                _ => MAX_CHANGE,
            };
            largest = largest.max(weight * change);
        }
    }
    largest
}

/// Where anything is set within this distance, points.
fn grown(set: &[bool], [columns, rows]: [u32; 2], reach: f64) -> Vec<bool> {
    let (columns, rows) = (columns as usize, rows as usize);
    let mut out = vec![false; set.len()];
    for down in 0..=reach as usize {
        let along = (reach * reach - (down * down) as f64).sqrt() as usize;
        for y in 0..rows {
            // Column until which the last point that is set reaches.
            let (mut until, mut ahead) = (0, 0);
            for x in 0..columns {
                while ahead < columns && ahead <= x + along {
                    if set[y * columns + ahead] {
                        until = ahead + along + 1;
                    }
                    ahead += 1;
                }
                if x < until {
                    let above = y.checked_sub(down);
                    let below = (y + down < rows).then_some(y + down);
                    for y in [above, below].into_iter().flatten() {
                        out[y * columns + x] = true;
                    }
                }
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sets_grow_by_their_reach() {
        let size = [7u32, 5];
        for reach in [1.0, 2.0, 2.3] {
            let mut set = vec![false; 35];
            for at in [0, 17, 30] {
                set[at] = true;
            }
            let found = grown(&set, size, reach);
            for (k, &found) in found.iter().enumerate() {
                let near = |&j: &usize| {
                    let apart = [(j % 7).abs_diff(k % 7), (j / 7).abs_diff(k / 7)];
                    set[j] && (apart[0].pow(2) + apart[1].pow(2)) as f64 <= reach * reach
                };
                assert_eq!(found, (0..35usize).any(|j| near(&j)), "{k} {reach}");
            }
        }
    }
}
