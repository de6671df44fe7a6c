//! What the true camera sees under the true lamp: direct light of every pixel by as many
//! points of its footprint as it needs, and the interreflection of the coarse grid at them.

use glam::DVec2;
use rayon::prelude::*;

use super::interreflection::{Grid, Value, direct};
use crate::brdf::Brdf;
use crate::transport::Scene;
use crate::transport::points::{Sampler, SobolSampler};
use crate::transport::scene::Surface;

/// Points of a pixel where the image is smooth, where it changes, and where the edge of a
/// shadow or of the sample crosses.
const POINTS: [u32; 3] = [4, 16, 128];
/// So many times as many through an open aperture, which a pixel's light fills as well.
const OPEN: u32 = 8;
/// So many times as many where a mirror shows the lamp: its highlight is smaller than a pixel,
/// and 128 points find its middle to a tenth of a pixel at best.
const OF_A_MIRROR: u32 = 32;
/// Radiance from which on a mirror shows the lamp, relative to the brightest.
const HIGHLIGHT: f32 = 0.01;
/// Contrast of a pixel with its neighbours, relative to the brightest, from which on it takes
/// more points.
const CONTRASTS: [f32; 2] = [0.2, 0.95];

/// Radiance of every pixel under the scene's only lamp, R, G, B, W/(m² sr).
pub(super) struct View<'a> {
    pub(super) scene: &'a Scene,
    pub(super) brdf: &'a dyn Brdf,
    pub(super) grid: &'a Grid,
    /// Of the grid's nodes.
    pub(super) interreflection: &'a [Value],
    /// Key of the points.
    pub(super) seed: u64,
}

/// What some points of a pixel saw.
#[derive(Clone, Copy, Default)]
struct Seen {
    radiance: [f32; 3],
    /// How many saw a surface.
    hits: u32,
    /// Smallest and largest radiance of a point, in its brightest channel.
    range: [f32; 2],
}

impl View<'_> {
    pub(super) fn render(&self) -> Vec<[f32; 3]> {
        let [width, height] = self.scene.camera.resolution_px;
        let pixels = width * height;
        let camera = &self.scene.camera;
        let points = match camera.object_na > 0.0 {
            true => POINTS.map(|points| OPEN * points),
            false => POINTS,
        };
        // How far a pixel sees beyond its own square; out of focus anywhere.
        let reach_px = 4.0 * camera.point_spread_px;
        let may_see =
            |pixel| camera.object_na > 0.0 || self.grid.is_seen(self.middle_px(pixel), reach_px);
        let first: Vec<Seen> = (0..pixels)
            .into_par_iter()
            .with_min_len(256)
            .map(|pixel| match may_see(pixel) {
                true => self.pixel(pixel, points[0], false),
                false => Seen::default(),
            })
            .collect();
        let around = |pixel: usize| {
            let [x, y] = [pixel % width, pixel / width];
            let rows = y.saturating_sub(1)..(y + 2).min(height);
            let columns = x.saturating_sub(1)..(x + 2).min(width);
            rows.flat_map(move |row| columns.clone().map(move |column| row * width + column))
        };
        // What is brighter is the lamp in a mirror; nothing is without one.
        let brightest = first.iter().map(|seen| seen.range[1]).fold(0.0, f32::max);
        let highlight = match self.grid.is_of_a_mirror() {
            true => HIGHLIGHT * brightest,
            false => f32::INFINITY,
        };
        let finished = |pixel: usize| {
            let (mut low, mut high) = (f32::INFINITY, 0.0f32);
            let (mut fewest, mut most) = (points[0], 0);
            for seen in around(pixel).map(|neighbour| &first[neighbour]) {
                low = low.min(seen.range[0]);
                high = high.max(seen.range[1]);
                fewest = fewest.min(seen.hits);
                most = most.max(seen.hits);
            }
            if most == 0 {
                return [0.0; 3];
            }
            let contrast = (high - low) / high.max(f32::MIN_POSITIVE);
            let is_inside = fewest == points[0];
            if is_inside && contrast > CONTRASTS[0] && high > highlight {
                let fine = self.pixel(pixel, OF_A_MIRROR * POINTS[2], false);
                return self.with_indirect_at_middle(pixel, &fine);
            }
            let more = match !is_inside {
                // The sample's own edge, whether light reaches it or not.
                true => CONTRASTS.len(),
                false => CONTRASTS.iter().filter(|&&limit| contrast > limit).count(),
            };
            match more {
                0 => self.with_indirect_at_middle(pixel, &first[pixel]),
                more => self.pixel(pixel, points[more], true).radiance,
            }
        };
        let image = (0..pixels).into_par_iter().with_min_len(256);
        image.map(finished).collect()
    }

    /// A smooth pixel, all of which sees the sample: one place stands for all.
    fn with_indirect_at_middle(&self, pixel: usize, seen: &Seen) -> [f32; 3] {
        let camera = &self.scene.camera;
        let ray = camera.ray(self.middle_px(pixel), DVec2::splat(0.5));
        let Some((place, _)) = self.scene.first(&ray) else {
            return seen.radiance;
        };
        let indirect = self.indirect(pixel, &place);
        std::array::from_fn(|c| seen.radiance[c] + indirect[c])
    }

    fn indirect(&self, pixel: usize, place: &Surface) -> [f32; 3] {
        self.grid
            .at(self.interreflection, self.middle_px(pixel), place)
    }

    fn middle_px(&self, pixel: usize) -> DVec2 {
        let width = self.scene.camera.resolution_px[0];
        DVec2::new((pixel % width) as f64, (pixel / width) as f64) + 0.5
    }

    /// The mean over points of a pixel's footprint, with the interreflection or without.
    fn pixel(&self, pixel: usize, points: u32, with_indirect: bool) -> Seen {
        let scene = self.scene;
        let mut seen = Seen {
            range: [f32::INFINITY, 0.0],
            ..Seen::default()
        };
        for point in 0..points {
            let (mut numbers, ray) =
                SobolSampler::begin(&scene.camera, self.seed, pixel, u32::MAX, point);
            let mut radiance = [0.0f32; 3];
            if let Some((surface, to_viewer)) = scene.first(&ray) {
                radiance = direct(scene, self.brdf, &surface, to_viewer, numbers.on_lamp());
                seen.hits += 1;
                if with_indirect {
                    let indirect = self.indirect(pixel, &surface);
                    for (sum, value) in seen.radiance.iter_mut().zip(indirect) {
                        *sum += value;
                    }
                }
            }
            let brightest = radiance.into_iter().fold(0.0, f32::max);
            seen.range = [seen.range[0].min(brightest), seen.range[1].max(brightest)];
            for (sum, value) in seen.radiance.iter_mut().zip(radiance) {
                *sum += value;
            }
        }
        seen.radiance = seen.radiance.map(|value| value / points as f32);
        seen
    }
}
