//! Interreflection of the truth: followed from nodes on a coarse grid of the image, and
//! interpolated over the surface to every place that the camera sees.
//!
//! The nodes are those of squares of pixels that are halved until the surface inside hardly
//! turns, for the material's narrowest lobe. A place takes a linear fit to the nodes
//! around it on the same smooth surface: nothing leaks over creases and silhouettes. Where
//! nodes stand follows from geometry and material alone, so one grid serves all lamps.
//! Direct light, which has sharp shadows and highlights, is no part of it.
//!
//! Mirror images of the sample in itself are as sharp as the lobe. Down to half of its width
//! the squares follow, so a nearly mirror-like sample has a node for every pixel and takes
//! minutes; beyond that they are smoothed.

use glam::{DVec2, Mat3, Vec3};
use rayon::prelude::*;

use crate::brdf::Brdf;
use crate::transport::scene::Surface;
use crate::transport::{RenderOptions, Scene, indirect};

/// Squares of the coarsest grid along the image's width, at least; they are whole powers of
/// two of pixels.
const ACROSS: usize = 64;
/// How often a square is halved at most, though never below one pixel.
const HALVINGS: u32 = 3;
/// Rays along each side of a square that show what the surface does inside.
const RAYS: usize = 4;
/// Most that a surface may turn within a square, radians, whatever the material.
const TURN_RAD: f32 = 0.14;
/// A lobe whose half is narrower is a mirror's, radians. A ball of 100 pixels turns by 0.02
/// within one.
const MIRROR_RAD: f32 = 0.02;
/// Surfaces that turn by more are two, radians.
const CREASE_RAD: f32 = 0.5;
/// How far a node's normal may be from a place's for it to count there, radians.
const ALIKE_RAD: f32 = 0.6;
/// Slope out of the tangent plane beyond which a node lies on another surface.
const STEEP: f32 = 0.5;
/// How much a slope is drawn to zero: nodes on one side say little of it.
const RIDGE: f32 = 0.02;
/// One of so many of a node's paths is followed in any case.
const PILOT: u32 = 16;
/// ... and at least so many.
const FEWEST: u32 = 16;
/// A place looks for nodes in so many squares along each side, of the size of its own.
const SPAN: usize = 5;

/// A place at which paths begin.
struct Node {
    surface: Surface,
    to_viewer: Vec3,
    normal: Vec3,
}

/// What the paths of a node found.
#[derive(Clone, Copy)]
pub(super) struct Value {
    pub(super) radiance: [f32; 3],
    pub(super) paths: f32,
}

/// Light of the scene's first lamp that a place reflects towards the viewer.
pub(super) fn direct(
    scene: &Scene,
    brdf: &dyn Brdf,
    place: &Surface,
    to_viewer: Vec3,
    on_lamp: [f32; 2],
) -> [f32; 3] {
    let Some(lamp) = scene.connect(place, 0, on_lamp) else {
        return [0.0; 3];
    };
    let brdf = scene.known(place).unwrap_or(brdf);
    let f = brdf.eval(lamp.to_light, to_viewer);
    let strength = scene.lights[0].strength();
    std::array::from_fn(|c| f[c] * lamp.irradiance * strength[c] as f32)
}

/// Where the interreflection is followed.
pub(super) struct Grid {
    nodes: Vec<Node>,
    /// Half the width of the material's lobe, radians; 1 where it has none.
    lobe_rad: f32,
    /// Side of the finest square, pixels.
    finest_px: usize,
    /// Finest squares per row.
    columns: usize,
    /// For each finest square: its square's first node, how many it has, and its side in pixels.
    squares: Vec<Square>,
}

/// A square that was not halved: left and top edge, side, pixels, and its nodes.
type Leaf = (usize, usize, usize, Vec<Node>);

#[derive(Clone, Copy, Default)]
struct Square {
    first: u32,
    nodes: u32,
    side_px: u32,
}

impl Grid {
    /// The grid of a scene's camera for a material.
    pub(super) fn new(scene: &Scene, brdf: &dyn Brdf) -> Self {
        let [width, height] = scene.camera.resolution_px;
        let coarsest_px = 1 << (width / ACROSS).max(1).ilog2();
        let finest_px = (coarsest_px >> HALVINGS).max(1);
        let [columns, rows] = [width, height].map(|n| n.div_ceil(finest_px));
        let lobe_rad = half_width_rad(brdf);
        let turn_rad = TURN_RAD.min(0.5 * lobe_rad);
        let across = width.div_ceil(coarsest_px);
        let down = height.div_ceil(coarsest_px);
        let coarse: Vec<Vec<Leaf>> = (0..across * down)
            .into_par_iter()
            .map(|k| {
                let corner = [k % across, k / across].map(|n| n * coarsest_px);
                let mut found = Vec::new();
                split(scene, corner, coarsest_px, finest_px, turn_rad, &mut found);
                found
            })
            .collect();
        let mut grid = Self {
            nodes: Vec::new(),
            lobe_rad,
            finest_px,
            columns,
            squares: vec![Square::default(); columns * rows],
        };
        for (x, y, side, nodes) in coarse.into_iter().flatten() {
            let square = Square {
                first: grid.nodes.len() as u32,
                nodes: nodes.len() as u32,
                side_px: side as u32,
            };
            grid.nodes.extend(nodes);
            for row in y / finest_px..((y + side) / finest_px).min(rows) {
                let start = row * columns;
                let within = x / finest_px..((x + side) / finest_px).min(columns);
                grid.squares[start..][within].fill(square);
            }
        }
        grid
    }

    /// Follows the interreflection from every node: by [`PILOT`] of the paths where direct
    /// light outshines it, by all where there is no other.
    pub(super) fn render(
        &self,
        scene: &Scene,
        brdf: &dyn Brdf,
        options: &RenderOptions,
    ) -> Vec<Value> {
        let most = options.samples_per_pixel.max(2);
        let fewest = (most / PILOT).max(FEWEST).min(most);
        let place = |node: &Node| (node.surface, node.to_viewer);
        // Paths of its own: what a node is worth must not depend on the paths that it keeps.
        let pilot = RenderOptions {
            samples_per_pixel: fewest,
            seed: options.seed.wrapping_add(1),
            ..options.clone()
        };
        let places: Vec<_> = self.nodes.iter().map(place).collect();
        let of_pilot = indirect(scene, brdf, &pilot, &places, &[]);
        // Noise counts relative to all of the light: its square falls with the paths.
        let paths: Vec<u32> = self
            .nodes
            .iter()
            .zip(&of_pilot)
            .map(|(node, found)| {
                let direct = direct(scene, brdf, &node.surface, node.to_viewer, [0.5; 2]);
                let [direct, found] = [direct, *found].map(|v| v[0].max(v[1]).max(v[2]));
                let part = found / (found + direct).max(f32::MIN_POSITIVE);
                let wanted = (part * part * most as f32) as u32;
                wanted.clamp(fewest, most)
            })
            .collect();
        let radiance = indirect(scene, brdf, options, &places, &paths);
        let value = |(radiance, paths)| Value {
            radiance,
            paths: paths as f32,
        };
        radiance.into_iter().zip(paths).map(value).collect()
    }

    /// Interreflection at a place that is seen at a position of the image, by the nodes' values.
    pub(super) fn at(&self, values: &[Value], position_px: DVec2, place: &Surface) -> [f32; 3] {
        let mut near = Near::new(place);
        let side_px = f64::from(self.square(position_px).side_px.max(1));
        let mut seen = [u32::MAX; SPAN * SPAN];
        for k in 0..SPAN * SPAN {
            let step = DVec2::new((k % SPAN) as f64, (k / SPAN) as f64) - (SPAN / 2) as f64;
            let square = self.square(position_px + side_px * step);
            // A large square is met more than once.
            if square.nodes == 0 || seen[..k].contains(&square.first) {
                continue;
            }
            seen[k] = square.first;
            for index in square.first..square.first + square.nodes {
                near.offer(index, &self.nodes[index as usize]);
            }
        }
        near.fit(values)
    }

    /// Whether the material is a mirror: a lobe that a curved sample shows within a pixel.
    pub(super) fn is_of_a_mirror(&self) -> bool {
        self.lobe_rad < MIRROR_RAD
    }

    /// Whether any node stands within some pixels of a position.
    pub(super) fn is_seen(&self, position_px: DVec2, within_px: f64) -> bool {
        let step = within_px.max((2 * self.finest_px) as f64);
        (0..9).any(|k| {
            let by = DVec2::new(f64::from(k % 3) - 1.0, f64::from(k / 3) - 1.0);
            self.square(position_px + step * by).nodes > 0
        })
    }

    fn square(&self, position_px: DVec2) -> Square {
        let rows = self.squares.len() / self.columns;
        let index = |x: f64, most: usize| {
            let cell = (x / self.finest_px as f64).floor();
            (cell >= 0.0 && cell < most as f64).then_some(cell as usize)
        };
        match (
            index(position_px.x, self.columns),
            index(position_px.y, rows),
        ) {
            (Some(column), Some(row)) => self.squares[row * self.columns + column],
            _ => Square::default(),
        }
    }
}

/// The nodes around a place that lie on the same smooth surface.
struct Near<'a> {
    place: &'a Surface,
    /// Normal, then two directions along the surface.
    frame: [Vec3; 3],
    /// Index and position along the surface, millimetres.
    nodes: [(u32, [f32; 2]); MOST_NEAR],
    count: usize,
    /// The node whose normal is most like the place's, should there be no other.
    likest: Option<(f32, u32)>,
}

/// Most nodes that a place goes by.
const MOST_NEAR: usize = 2 * SPAN * SPAN;

impl<'a> Near<'a> {
    fn new(place: &'a Surface) -> Self {
        let normal = place.world(Vec3::Z);
        let (tangent, bitangent) = normal.any_orthonormal_pair();
        Self {
            place,
            frame: [normal, tangent, bitangent],
            nodes: [(0, [0.0; 2]); MOST_NEAR],
            count: 0,
            likest: None,
        }
    }

    fn offer(&mut self, index: u32, node: &Node) {
        let [normal, tangent, bitangent] = self.frame;
        let turned = normal.dot(node.normal);
        if self.likest.is_none_or(|(best, _)| turned > best) {
            self.likest = Some((turned, index));
        }
        let from = node.surface.origin_mm - self.place.origin_mm;
        let along = [from.dot(tangent), from.dot(bitangent)];
        let is_alike = self.place.is_sample() == node.surface.is_sample()
            && turned > ALIKE_RAD.cos()
            && from.dot(normal).abs() <= STEEP * along[0].hypot(along[1]) + f32::EPSILON;
        if is_alike && self.count < MOST_NEAR {
            self.nodes[self.count] = (index, along);
            self.count += 1;
        }
    }

    /// The value at the place of a linear fit to the nodes', least squares weighted by
    /// nearness and by how well each is known.
    fn fit(&self, values: &[Value]) -> [f32; 3] {
        let nodes = &self.nodes[..self.count];
        if nodes.is_empty() {
            let likest = self
                .likest
                .map(|(_, index)| values[index as usize].radiance);
            return likest.unwrap_or_default();
        }
        let square = |[x, y]: [f32; 2]| x * x + y * y;
        let farthest = nodes
            .iter()
            .map(|&(_, along)| square(along))
            .fold(0.0, f32::max);
        // The kernel ends just beyond the farthest one.
        let scale = 1.0 / (1.2 * farthest + 1e-12).sqrt();
        let row = |[x, y]: [f32; 2]| Vec3::new(1.0, x * scale, y * scale);
        let weight = |index: u32, row: Vec3| {
            let nearness = (1.0 - row.y * row.y - row.z * row.z).max(0.0);
            nearness * nearness * values[index as usize].paths
        };
        let mut moments = Mat3::ZERO;
        for &(index, along) in nodes {
            let row = row(along);
            moments += weight(index, row) * Mat3::from_cols(row * row.x, row * row.y, row * row.z);
        }
        let ridge = RIDGE * moments.x_axis.x;
        moments.y_axis.y += ridge;
        moments.z_axis.z += ridge;
        let solved = moments.inverse() * Vec3::X;
        let mut sum = [0.0f32; 3];
        for &(index, along) in nodes {
            let row = row(along);
            let factor = weight(index, row) * solved.dot(row);
            for (sum, value) in sum.iter_mut().zip(values[index as usize].radiance) {
                *sum += factor * value;
            }
        }
        sum.map(|value| value.max(0.0))
    }
}

/// Halves a square until the surface inside hardly turns, and notes what remains.
fn split(
    scene: &Scene,
    [x, y]: [usize; 2],
    side: usize,
    finest: usize,
    turn_rad: f32,
    found: &mut Vec<Leaf>,
) {
    let rays = RAYS.min(2 * side);
    let mut hits: Vec<(f64, Node)> = Vec::with_capacity(rays * rays);
    for k in 0..rays * rays {
        let place = DVec2::new((k % rays) as f64, (k / rays) as f64);
        let within = (place + 0.5) * (side as f64 / rays as f64);
        let at = DVec2::new(x as f64, y as f64) + within;
        let ray = scene.camera.ray(at, DVec2::splat(0.5));
        if let Some((surface, to_viewer)) = scene.first(&ray) {
            let from_middle = within - 0.5 * side as f64;
            let normal = surface.world(Vec3::Z);
            hits.push((
                from_middle.length_squared(),
                Node {
                    surface,
                    to_viewer,
                    normal,
                },
            ));
        }
    }
    if hits.is_empty() {
        return;
    }
    let turns = |limit: f32| {
        let first = hits[0].1.normal;
        let middle: Vec3 = hits.iter().map(|(_, node)| node.normal).sum::<Vec3>();
        let middle = middle.try_normalize().unwrap_or(first);
        let cos = (0.5 * limit).cos();
        hits.iter().any(|(_, node)| node.normal.dot(middle) < cos)
    };
    if side > finest && turns(turn_rad) {
        let half = side / 2;
        for k in 0..4 {
            let corner = [x + half * (k % 2), y + half * (k / 2)];
            split(scene, corner, half, finest, turn_rad, found);
        }
        return;
    }
    // One node for each surface inside: the hit nearest to the middle first.
    hits.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut nodes: Vec<Node> = Vec::new();
    for (_, hit) in hits {
        let is_new = nodes.iter().all(|node| {
            node.normal.dot(hit.normal) < CREASE_RAD.cos()
                || node.surface.is_sample() != hit.surface.is_sample()
        });
        if is_new {
            nodes.push(hit);
        }
    }
    found.push((x, y, side, nodes));
}

/// Half the width of a material's lobe of mirror light: the angle of the half vector from the
/// normal, radians, at which what stands above the diffuse rest has fallen to half.
fn half_width_rad(brdf: &dyn Brdf) -> f32 {
    let f = |theta_h: f32| {
        // Lamp and viewer 20° off the half vector, across the plane in which it is turned.
        let (sin, cos) = theta_h.sin_cos();
        let half = Vec3::new(sin, 0.0, cos);
        let (sin_d, cos_d) = 0.35f32.sin_cos();
        let [i, o] = [1.0, -1.0].map(|sign| half * cos_d + Vec3::Y * (sign * sin_d));
        let value = brdf.eval(i, o);
        value[0].max(value[1]).max(value[2])
    };
    let (peak, rest) = (f(0.0), f(0.9));
    if peak < 1.2 * rest {
        return 1.0;
    }
    let level = 0.5 * (peak + rest);
    let mut angle = 1e-3;
    while angle < 0.9 && f(angle) > level {
        angle *= 1.1;
    }
    angle
}
