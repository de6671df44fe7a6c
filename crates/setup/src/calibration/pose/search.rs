//! A pose from far off: tens of degrees and half a field of view.
//!
//! An alignment by edges sees no farther than a few pixels. Here whole small images are
//! compared with the regions that a pose predicts: within one region, the square root of
//! the radiance is fitted by a constant and, in light, a term that rises with the cosine to
//! the light; what that leaves of the images' variance is the pose's cost. Rotations spread
//! evenly within the range, each with the sample moved to where the images are bright, give
//! starts; the best are brought down by Nelder and Mead's simplex (1965), first on coarse
//! pixels, then on finer ones. A small cost of the distance itself settles what the images
//! leave open, such as a bowl's turn about its axis: of poses that look alike, the one
//! nearest to the description is found.

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use super::regions::{Grid, Seen, Sight, is_lit};
use crate::inverse::nuisance::with_sample_at;
use crate::radiance_image::RadianceImage;
use crate::transport::Scene;

/// Rotations up to this angle are sought, degrees.
pub const WIDEST_DEG: f64 = 45.0;
/// Starts.
const STARTS: usize = 320;
/// Starts that are brought down on coarse pixels, and then on finer ones.
const KEPT: [usize; 2] = [12, 3];
/// Pixels across at most, coarse and finer.
const ACROSS_PX: [usize; 2] = [24, 56];
/// Steps of a simplex.
const STEPS: [usize; 2] = [150, 220];
/// First sizes of a simplex: degrees, and part of the field.
const FIRST_STEP: [(f64, f64); 2] = [(8.0, 0.08), (2.0, 0.02)];
/// Most lights that are compared: the first ones.
const LIGHTS: usize = 4;
/// Cost of the largest rotation, or of a field's width, in parts of the images' variance.
const DISTANCE_COST: f64 = 0.004;
/// Cost above which nothing of the images is explained.
const USELESS: f64 = 0.6;

/// Rotation vector (radians) and translation (mm) of a sample whose regions explain the
/// images best; `None` if none does.
pub fn search(scene: &Scene, sight: &Sight<'_>, images: &[RadianceImage]) -> Option<[DVec3; 2]> {
    let levels = ACROSS_PX.map(|across| Level::new(scene, sight, images, across));
    let [coarse, fine] = &levels;
    let mut starts: Vec<(f64, Pose)> = (0..STARTS)
        .into_par_iter()
        .map(|number| {
            let rotation = rotation_rad(number);
            let moved = coarse.to_the_light(rotation);
            [Pose::new(rotation, moved), Pose::new(rotation, DVec3::ZERO)]
                .map(|pose| (coarse.cost(&pose), pose))
        })
        .map(|[a, b]| if b.0 < a.0 { b } else { a })
        .collect();
    let best_first = |poses: &mut Vec<(f64, Pose)>| poses.sort_by(|a, b| a.0.total_cmp(&b.0));
    for (stage, level) in [coarse, fine].into_iter().enumerate() {
        best_first(&mut starts);
        starts.truncate(KEPT[stage]);
        let (degrees, part) = FIRST_STEP[stage];
        let sizes = [degrees.to_radians(), part * level.field_mm];
        starts = starts
            .into_par_iter()
            .map(|(_, pose)| descend(pose, sizes, STEPS[stage], &|pose| level.cost(pose)))
            .collect();
    }
    best_first(&mut starts);
    let (cost, pose) = *starts.first()?;
    tracing::debug!(cost, ?pose, "pose search");
    (cost < USELESS && fine.cost(&pose) < USELESS).then(|| pose.parts())
}

/// Six numbers: rotation vector, radians, then translation, mm.
#[derive(Clone, Copy, Debug)]
struct Pose([f64; 6]);

impl Pose {
    fn new(rotation: DVec3, translation: DVec3) -> Self {
        let [a, b] = [rotation, translation].map(|v| v.to_array());
        Self([a[0], a[1], a[2], b[0], b[1], b[2]])
    }

    fn parts(&self) -> [DVec3; 2] {
        let [a, b, c, d, e, f] = self.0;
        [DVec3::new(a, b, c), DVec3::new(d, e, f)]
    }
}

/// The `number`-th of rotation vectors spread evenly within a ball: Roberts' R3 sequence in
/// the cube around it, as far as it is within; the first is none.
fn rotation_rad(number: usize) -> DVec3 {
    let step = DVec3::new(
        0.819_172_513_396_164_4,
        0.671_043_606_703_789_2,
        0.549_700_477_901_960_3,
    );
    let cube = (0..).map(|i| (step * f64::from(i)).fract() * 2.0 - DVec3::ONE);
    let ball = cube.filter(|v| v.length() <= 1.0);
    let point = std::iter::once(DVec3::ZERO).chain(ball).nth(number);
    point.unwrap_or_default() * WIDEST_DEG.to_radians()
}

/// The images on pixels of one size.
struct Level<'a> {
    scene: Scene,
    sight: &'a Sight<'a>,
    grid: Grid,
    /// By light: square roots of the radiance over that of the brightest; NaN where unknown.
    brightness: Vec<Vec<f32>>,
    /// By light: sum of squares about the mean.
    variance: Vec<f64>,
    /// Middle of what is bright, pixels of the grid.
    bright_px: DVec2,
    /// Width of the field at the sample, mm.
    field_mm: f64,
}

impl<'a> Level<'a> {
    fn new(scene: &Scene, sight: &'a Sight<'a>, images: &[RadianceImage], across: usize) -> Self {
        let [width, height] = scene.camera.resolution_px;
        let grid = Grid::new([width, height], width.max(height).div_ceil(across));
        let mut scene = scene.clone();
        scene.lights.truncate(LIGHTS);
        let brightness: Vec<Vec<f32>> = images[..scene.lights.len()]
            .iter()
            .map(|image| brightness(image, grid))
            .collect();
        let variance = |values: &Vec<f32>| {
            let known = || {
                values
                    .iter()
                    .filter(|v| v.is_finite())
                    .map(|v| f64::from(*v))
            };
            let count = known().count().max(1) as f64;
            let mean = known().sum::<f64>() / count;
            known().map(|v| (v - mean).powi(2)).sum::<f64>()
        };
        let (mut sum, mut all) = (DVec2::ZERO, 0.0);
        for values in &brightness {
            for (pixel, value) in values.iter().enumerate().filter(|(_, v)| **v > 0.25) {
                sum += middle_px(grid, pixel) * f64::from(*value);
                all += f64::from(*value);
            }
        }
        Self {
            variance: brightness.iter().map(variance).collect(),
            bright_px: sum / f64::max(all, 1e-9),
            field_mm: scene.camera.field_mm(DVec3::ZERO).max_element(),
            scene,
            sight,
            grid,
            brightness,
        }
    }

    fn posed(&self, pose: &Pose) -> Scene {
        let [rotation, translation] = pose.parts();
        with_sample_at(self.scene.clone(), rotation, translation)
    }

    /// The translation across the view that brings a turned sample to where it is bright.
    fn to_the_light(&self, rotation: DVec3) -> DVec3 {
        let mut seen = self.sight.blank(&self.scene);
        let scene = self.posed(&Pose::new(rotation, DVec3::ZERO));
        let (mut sum, mut count) = (DVec2::ZERO, 0.0);
        for pixel in 0..self.grid.pixels() {
            let at = middle_px(self.grid, pixel);
            self.sight
                .look(&scene, at * self.grid.factor as f64, &mut seen);
            if seen.iter().any(|s| is_lit(s.label)) {
                sum += at;
                count += 1.0;
            }
        }
        if count == 0.0 {
            return DVec3::ZERO;
        }
        let off_px = self.bright_px - sum / count;
        let mm_per_px = self.field_mm / self.grid.width.max(self.grid.height) as f64;
        let camera = &self.scene.camera.sample_from_camera;
        camera.direction(DVec3::new(off_px.x, off_px.y, 0.0) * mm_per_px)
    }

    /// Part of the images' variance that the regions of a pose leave, and a little for the
    /// distance.
    fn cost(&self, pose: &Pose) -> f64 {
        let [rotation, translation] = pose.parts();
        let widest = WIDEST_DEG.to_radians();
        if rotation.length() > 1.1 * widest || translation.length() > self.field_mm {
            return f64::INFINITY;
        }
        let distance =
            (rotation / widest).length_squared() + (translation / self.field_mm).length_squared();
        self.unexplained(pose) + DISTANCE_COST * distance
    }

    fn unexplained(&self, pose: &Pose) -> f64 {
        let scene = self.posed(pose);
        let mut seen = self.sight.blank(&scene);
        let mut regions: Vec<Vec<(u32, Region)>> = vec![Vec::new(); self.brightness.len()];
        for pixel in 0..self.grid.pixels() {
            let at = middle_px(self.grid, pixel) * self.grid.factor as f64;
            self.sight.look(&scene, at, &mut seen);
            for ((regions, values), seen) in regions.iter_mut().zip(&self.brightness).zip(&seen) {
                if values[pixel].is_finite() {
                    add(regions, seen, values[pixel]);
                }
            }
        }
        let left =
            |regions: &Vec<(u32, Region)>| regions.iter().map(|(_, r)| r.left()).sum::<f64>();
        let parts = regions.iter().zip(&self.variance);
        parts.map(|(r, all)| left(r) / all.max(1e-12)).sum::<f64>() / self.variance.len() as f64
    }
}

/// The middle of a pixel of the grid.
fn middle_px(grid: Grid, pixel: usize) -> DVec2 {
    DVec2::new((pixel % grid.width) as f64, (pixel / grid.width) as f64) + 0.5
}

/// Square roots of an image's grey radiance, its bright end as 1.
fn brightness(image: &RadianceImage, grid: Grid) -> Vec<f32> {
    let value = |pixel: usize| {
        let [x, y] = [pixel % grid.width, pixel / grid.width].map(|i| i * grid.factor);
        let (mut sum, mut count) = (0.0, 0.0);
        for row in y..y + grid.factor {
            for column in x..x + grid.factor {
                let at = row * image.width + column;
                let grey: f32 = image.mean[at].iter().sum();
                if image.valid[at] && grey.is_finite() {
                    sum += grey.max(0.0);
                    count += 1.0;
                }
            }
        }
        (sum / count).sqrt()
    };
    let mut values: Vec<f32> = (0..grid.pixels()).map(value).collect();
    let mut sorted: Vec<f32> = values.iter().copied().filter(|v| v.is_finite()).collect();
    sorted.sort_by(f32::total_cmp);
    // A highlight is not to outweigh all else.
    let bright = sorted
        .get(sorted.len() * 9 / 10)
        .map_or(1.0, |v| v.max(1e-12));
    values.iter_mut().for_each(|v| *v = (*v / bright).min(1.5));
    values
}

/// Sums over one region under one light.
#[derive(Clone, Copy, Default)]
struct Region {
    count: f64,
    cosine: f64,
    cosine2: f64,
    value: f64,
    value2: f64,
    both: f64,
}

impl Region {
    /// Squares that are left by a constant and a term that rises with the cosine.
    fn left(&self) -> f64 {
        let plain = self.value2 - self.value * self.value / self.count;
        let spread = self.cosine2 - self.cosine * self.cosine / self.count;
        let both = self.both - self.cosine * self.value / self.count;
        match both > 0.0 && spread > 1e-9 {
            true => (plain - both * both / spread).max(0.0),
            false => plain.max(0.0),
        }
    }
}

fn add(regions: &mut Vec<(u32, Region)>, seen: &Seen, value: f32) {
    let known = regions.iter().position(|(label, _)| *label == seen.label);
    let index = known.unwrap_or_else(|| {
        regions.push((seen.label, Region::default()));
        regions.len() - 1
    });
    let region = &mut regions[index].1;
    let (cosine, value) = (f64::from(seen.cosine).sqrt(), f64::from(value));
    region.count += 1.0;
    region.cosine += cosine;
    region.cosine2 += cosine * cosine;
    region.value += value;
    region.value2 += value * value;
    region.both += cosine * value;
}

/// Nelder and Mead's simplex from a pose, with first steps of these sizes (radians, mm).
fn descend(
    start: Pose,
    [radians, mm]: [f64; 2],
    steps: usize,
    cost: &dyn Fn(&Pose) -> f64,
) -> (f64, Pose) {
    let mut corners: Vec<(f64, Pose)> = vec![(cost(&start), start)];
    for k in 0..6 {
        let mut pose = start;
        pose.0[k] += if k < 3 { radians } else { mm };
        corners.push((cost(&pose), pose));
    }
    let between =
        |a: &Pose, b: &Pose, t: f64| Pose(std::array::from_fn(|k| a.0[k] + t * (b.0[k] - a.0[k])));
    for _ in 0..steps {
        corners.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (best, second, worst) = (corners[0], corners[5], corners[6]);
        let others = &corners[..6];
        let middle = Pose(std::array::from_fn(|k| {
            others.iter().map(|(_, p)| p.0[k]).sum::<f64>() / 6.0
        }));
        let tried = |t: f64| {
            let pose = between(&middle, &worst.1, t);
            (cost(&pose), pose)
        };
        let mirrored = tried(-1.0);
        let next = if mirrored.0 < best.0 {
            let farther = tried(-2.0);
            if farther.0 < mirrored.0 {
                farther
            } else {
                mirrored
            }
        } else if mirrored.0 < second.0 {
            mirrored
        } else {
            tried(if mirrored.0 < worst.0 { -0.5 } else { 0.5 })
        };
        if next.0 < worst.0 {
            corners[6] = next;
            continue;
        }
        for corner in &mut corners[1..] {
            let pose = between(&best.1, &corner.1, 0.5);
            *corner = (cost(&pose), pose);
        }
    }
    corners.sort_by(|a, b| a.0.total_cmp(&b.0));
    corners[0]
}
