//! Plain forward rendering of any BRDF, known bodies included: mean and variance of the mean per pixel.

use glam::Vec3;
use rayon::prelude::*;

use super::continuation::{Continuations, Steering};
use super::points::{IndependentSampler, Sampler, SobolSampler};
use super::proposal::Proposal;
use super::scene::{Scene, Surface};
use crate::brdf::Brdf;
use crate::geometry::Ray;
use crate::progress::Progress;
use crate::radiance_image::RadianceImage;

/// How to render.
#[derive(Clone, Debug)]
pub struct RenderOptions {
    /// Paths per pixel, at least 2; the variance falls as its inverse.
    pub samples_per_pixel: u32,
    /// Shortest path in surface reflections, 1 or more; 2 leaves the direct light out.
    pub min_reflections: u32,
    /// Longest path in surface reflections; 1 = direct only; 1..=64.
    pub max_reflections: u32,
    /// Same seed, same image.
    pub seed: u64,
    /// Where continuations go; one that resembles the BRDF gives less noise.
    pub proposal: Proposal,
    /// What leads them to light. The images of two scenes that differ a little differ
    /// smoothly, for equal seeds, only without.
    pub steering: Steering,
    /// Paths of evenly spread points instead of independent ones, in this many scrambles, at
    /// least 8: less noise, by a variance that is the scatter of so few means.
    pub scrambles: Option<u32>,
}

impl Default for RenderOptions {
    fn default() -> Self {
        Self {
            samples_per_pixel: 256,
            min_reflections: 1,
            max_reflections: 32,
            seed: 0,
            proposal: Proposal::default(),
            steering: Steering::NONE,
            scrambles: None,
        }
    }
}

impl RenderOptions {
    pub(super) fn continuations(&self, scene: &Scene) -> Continuations<'_> {
        let guide = self.steering.guide(scene, self.seed);
        Continuations::new(&self.proposal, self.steering, guide)
    }

    /// Groups of a pixel's paths whose means are independent of each other, and paths of each.
    fn groups(&self) -> [u32; 2] {
        match self.scrambles {
            Some(scrambles) => {
                // Fewer have no scatter.
                let scrambles = scrambles.max(2);
                [scrambles, self.samples_per_pixel.div_ceil(scrambles)]
            }
            None => [self.samples_per_pixel, 1],
        }
    }
}

/// Renders one image per lamp of the scene.
///
/// ```
/// # use glam::{DVec2, DVec3};
/// # use rig_core::geometry::Shape;
/// # use rig_core::transport::{Camera, Light, Scene, Shading};
/// # let camera = Camera::above([8, 8], DVec2::splat(16.0), 100.0);
/// # let light = Light::distant(DVec3::Z, [1.0; 3]);
/// # let bowl = Shape::Bowl { radius_mm: 10.0, segments: 32 }.mesh()?;
/// # let scene = Scene::new(bowl, Shading::Smooth, camera, vec![light]);
/// use rig_core::brdf::source;
/// use rig_core::transport::{RenderOptions, render};
///
/// let options = RenderOptions { samples_per_pixel: 64, ..RenderOptions::default() };
/// let chalk = source::load("lambertian:0.8")?;
/// let image = &render(&scene, chalk.as_ref(), &options)[0];
///
/// // Direct light alone would be 0.8/π at the bottom; the walls send more there.
/// let middle = image.mean[3 * image.width + 3][0];
/// assert!(middle > 0.8 / std::f32::consts::PI);
/// assert!(image.variance[0][0] >= 0.0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn render(scene: &Scene, brdf: &dyn Brdf, options: &RenderOptions) -> Vec<RadianceImage> {
    render_with_progress(scene, brdf, options, &())
}

/// [`render`], with the rows of pixels as the steps of its progress.
pub fn render_with_progress(
    scene: &Scene,
    brdf: &dyn Brdf,
    options: &RenderOptions,
    progress: &dyn Progress,
) -> Vec<RadianceImage> {
    render_carrying::<[f64; 3]>(scene, brdf, options, progress)
}

/// What a camera path accumulates towards the lamps: the factors between the
/// camera's reading and light that arrives at the end of the path.
pub(super) trait Carrier {
    /// At the camera, looking along `direction`.
    fn start(direction: Vec3) -> Self;
    /// The reading, R, G, B, for unpolarised light of unit power that arrives from
    /// `event.to_light`.
    fn reading(&self, event: &Event<'_>, irradiance: f32) -> [f64; 3];
    /// Continues by a reflection times `weight`; false if nothing is left.
    fn reflect(&mut self, event: &Event<'_>, weight: [f32; 2]) -> bool;
}

/// One reflection on a path.
pub(super) struct Event<'a> {
    pub(super) brdf: &'a dyn Brdf,
    pub(super) surface: &'a Surface,
    /// Unit, local frame.
    pub(super) to_light: Vec3,
    /// Unit, local frame.
    pub(super) to_viewer: Vec3,
}

impl Carrier for [f64; 3] {
    fn start(_: Vec3) -> Self {
        [1.0; 3]
    }

    #[inline]
    fn reading(&self, event: &Event<'_>, irradiance: f32) -> [f64; 3] {
        let f = event.brdf.eval(event.to_light, event.to_viewer);
        [0, 1, 2].map(|c| self[c] * f64::from(f[c] * irradiance))
    }

    #[inline]
    fn reflect(&mut self, event: &Event<'_>, [cosine, pdf]: [f32; 2]) -> bool {
        let f = event.brdf.eval(event.to_light, event.to_viewer);
        for (value, f) in self.iter_mut().zip(f) {
            *value *= f64::from(f * cosine / pdf);
        }
        *self != [0.0; 3]
    }
}

pub(super) fn render_carrying<C: Carrier>(
    scene: &Scene,
    brdf: &dyn Brdf,
    options: &RenderOptions,
    progress: &dyn Progress,
) -> Vec<RadianceImage> {
    let [width, height] = scene.camera.resolution_px;
    let lights = scene.lights.len();
    progress.begin("rendering", Some(height));
    let continuations = options.continuations(scene);
    let rows: Vec<Vec<PixelSums>> = (0..height)
        .into_par_iter()
        .map(|row| {
            let pixels = (0..width)
                .map(|column| {
                    progress.pulse();
                    render_pixel::<C>(scene, brdf, options, &continuations, row * width + column)
                })
                .collect();
            progress.advance(1);
            pixels
        })
        .collect();
    let pixels: Vec<PixelSums> = rows.into_iter().flatten().collect();
    (0..lights)
        .map(|light| {
            let mut image = RadianceImage::new(width, height);
            for (pixel, sums) in pixels.iter().enumerate() {
                let [mean, variance] = moments(scene, options, sums, light);
                image.mean[pixel] = mean;
                image.variance[pixel] = variance;
            }
            image
        })
        .collect()
}

/// Mean and variance of the mean of a pixel's groups of paths under a lamp.
fn moments(
    scene: &Scene,
    options: &RenderOptions,
    sums: &PixelSums,
    light: usize,
) -> [[f32; 3]; 2] {
    let n = f64::from(options.groups()[0]);
    let mut result = [[0.0; 3]; 2];
    for (channel, &[sum, sum2]) in sums[light].iter().enumerate() {
        let strength = scene.lights[light].strength()[channel];
        let mean = sum / n;
        let variance = ((sum2 / n - mean * mean) / (n - 1.0)).max(0.0);
        result[0][channel] = (mean * strength) as f32;
        result[1][channel] = (variance * strength * strength) as f32;
    }
    result
}

/// Single pixels of the image under the scene's first lamp, each as [`render`] would have it:
/// mean and variance of the mean, R, G, B.
pub fn render_pixels(
    scene: &Scene,
    brdf: &dyn Brdf,
    options: &RenderOptions,
    pixels: &[usize],
) -> Vec<[[f32; 3]; 2]> {
    let continuations = options.continuations(scene);
    let of_pixel = |&pixel: &usize| {
        let sums = render_pixel::<[f64; 3]>(scene, brdf, options, &continuations, pixel);
        moments(scene, options, &sums, 0)
    };
    pixels.par_iter().map(of_pixel).collect()
}

/// The default proposal or one made for the sample's BRDF, whichever is quieter.
pub fn suited_proposal(scene: &Scene, brdf: &dyn Brdf, options: &RenderOptions) -> Proposal {
    let mut candidates = vec![Proposal::default()];
    match brdf.as_mixture() {
        Some(mixture) => candidates.extend([0.3, 0.05].map(|d| Proposal::resembling(mixture, d))),
        None => candidates.push(Proposal::tabulating(brdf, 0.3)),
    }
    quietest_proposal(scene, brdf, options, candidates)
}

/// The proposal with the least noise at equal numbers of paths, measured on a spread of
/// pixels: mean of the relative variance over lamps and channels.
pub fn quietest_proposal(
    scene: &Scene,
    brdf: &dyn Brdf,
    options: &RenderOptions,
    candidates: Vec<Proposal>,
) -> Proposal {
    let step = (scene.camera.pixels() / 192).max(1);
    let pixels: Vec<usize> = (0..scene.camera.pixels()).step_by(step).collect();
    let steered = options.continuations(scene);
    let options = RenderOptions {
        samples_per_pixel: 64,
        scrambles: None,
        ..options.clone()
    };
    let noise = |proposal: &Proposal| -> f64 {
        let continuations = steered.by(proposal);
        let sums: Vec<f64> = pixels
            .par_iter()
            .map(|&pixel| {
                let sums = render_pixel::<[f64; 3]>(scene, brdf, &options, &continuations, pixel);
                let relative = |&[sum, sum2]: &[f64; 2]| {
                    if sum > 0.0 {
                        64.0 * sum2 / (sum * sum) - 1.0
                    } else {
                        0.0
                    }
                };
                sums.iter().flatten().map(relative).sum()
            })
            .collect();
        sums.iter().sum()
    };
    let noises: Vec<f64> = candidates.iter().map(noise).collect();
    let best = (0..candidates.len()).min_by(|&a, &b| noises[a].total_cmp(&noises[b]));
    best.and_then(|i| candidates.into_iter().nth(i))
        .unwrap_or_default()
}

/// Per lamp and channel: sum of the means of groups of paths, sum of their squares.
type PixelSums = Vec<[[f64; 2]; 3]>;

fn render_pixel<C: Carrier>(
    scene: &Scene,
    brdf: &dyn Brdf,
    options: &RenderOptions,
    continuations: &Continuations<'_>,
    pixel: usize,
) -> PixelSums {
    let lights = scene.lights.len();
    let mut sums = vec![[[0.0; 2]; 3]; lights];
    let mut group_sums = vec![[0.0f64; 3]; lights];
    let (camera, seed) = (&scene.camera, options.seed);
    let [groups, size] = options.groups();
    for group in 0..groups {
        group_sums.fill([0.0; 3]);
        let mut add = |_, light: usize, reading: [f64; 3]| {
            for (sum, value) in group_sums[light].iter_mut().zip(reading) {
                *sum += value;
            }
        };
        if options.scrambles.is_some() {
            for index in 0..size {
                let path = SobolSampler::begin(camera, seed, pixel, group, index);
                follow::<C, _>(scene, brdf, options, continuations, path, &mut add);
            }
        } else {
            let path = IndependentSampler::begin(camera, seed, pixel, group);
            follow::<C, _>(scene, brdf, options, continuations, path, &mut add);
        }
        for (sum, group_sum) in sums.iter_mut().zip(&group_sums) {
            for channel in 0..3 {
                let mean = group_sum[channel] / f64::from(size);
                sum[channel][0] += mean;
                sum[channel][1] += mean * mean;
            }
        }
    }
    sums
}

/// Follows a path from its ray on and calls `visit` for each connection to a lamp, with the number
/// of reflections up to there, the lamp and what the camera measures of it per unit of the lamp's
/// strength.
#[inline]
pub(super) fn follow<C: Carrier, N: Sampler>(
    scene: &Scene,
    brdf: &dyn Brdf,
    options: &RenderOptions,
    continuations: &Continuations<'_>,
    (mut numbers, ray): (N, Ray),
    visit: impl FnMut(u32, usize, [f64; 3]),
) {
    let carried = C::start(ray.direction);
    if let Some(first) = scene.first(&ray) {
        follow_from(
            scene,
            brdf,
            options,
            continuations,
            (&mut numbers, carried, first),
            visit,
        );
    }
}

/// The same from the first surface point that the camera sees, with the direction towards it.
#[inline]
pub(super) fn follow_from<C: Carrier, N: Sampler>(
    scene: &Scene,
    brdf: &dyn Brdf,
    options: &RenderOptions,
    continuations: &Continuations<'_>,
    (numbers, mut carried, first): (&mut N, C, (Surface, Vec3)),
    mut visit: impl FnMut(u32, usize, [f64; 3]),
) {
    let mut mode = continuations.begin();
    let mut next = Some(first);
    let mut reflections = 0;
    while let Some((surface, to_viewer)) = next {
        reflections += 1;
        let brdf = scene.known(&surface).unwrap_or(brdf);
        let lights = match reflections < options.min_reflections {
            true => 0,
            false => scene.lights.len(),
        };
        for light in 0..lights {
            if let Some(connection) = scene.connect(&surface, light, numbers.on_lamp()) {
                let event = Event {
                    brdf,
                    surface: &surface,
                    to_light: connection.to_light,
                    to_viewer,
                };
                let reading = carried.reading(&event, connection.irradiance);
                visit(reflections, light, reading);
            }
        }
        if reflections >= options.max_reflections {
            break;
        }
        numbers.advance();
        let drawn = continuations.draw(&mut mode, &surface, to_viewer, numbers);
        let Some((direction, pdf)) = drawn else {
            break;
        };
        let event = Event {
            brdf,
            surface: &surface,
            to_light: direction,
            to_viewer,
        };
        if !carried.reflect(&event, [direction.z, pdf]) {
            break;
        }
        next = scene.next(&surface, direction);
    }
}
