//! Plain forward rendering of any BRDF, known bodies included: mean and variance of the mean per pixel.

use glam::DVec2;
use rayon::prelude::*;

use super::proposal::Proposal;
use super::scene::Scene;
use crate::brdf::Brdf;
use crate::radiance_image::RadianceImage;
use crate::random::{Purpose, stream};

/// How to render.
#[derive(Clone, Debug)]
pub struct RenderOptions {
    /// Paths per pixel, at least 2; the variance falls as its inverse.
    pub samples_per_pixel: u32,
    /// Longest path in surface reflections; 1 = direct only; 1..=64.
    pub max_reflections: u32,
    /// Same seed, same image.
    pub seed: u64,
    /// Where continuations go; one that resembles the BRDF gives less noise.
    pub proposal: Proposal,
}

impl Default for RenderOptions {
    fn default() -> Self {
        Self {
            samples_per_pixel: 256,
            max_reflections: 32,
            seed: 0,
            proposal: Proposal::default(),
        }
    }
}

/// Renders one image per lamp of the scene. `progress` is told the number of
/// finished rows of pixels, from any thread.
pub fn render(
    scene: &Scene,
    brdf: &dyn Brdf,
    options: &RenderOptions,
    progress: &(dyn Fn(usize) + Sync),
) -> Vec<RadianceImage> {
    let [width, height] = scene.camera.resolution_px;
    let lights = scene.lights.len();
    let done = std::sync::atomic::AtomicUsize::new(0);
    let rows: Vec<Vec<PixelSums>> = (0..height)
        .into_par_iter()
        .map(|row| {
            let pixels = (0..width)
                .map(|column| render_pixel(scene, brdf, options, row * width + column))
                .collect();
            progress(done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1);
            pixels
        })
        .collect();
    let n = f64::from(options.samples_per_pixel);
    (0..lights)
        .map(|light| {
            let mut image = RadianceImage::new(width, height);
            for (pixel, sums) in rows.iter().flatten().enumerate() {
                for (channel, &[sum, sum2]) in sums[light].iter().enumerate() {
                    let strength = scene.lights[light].strength()[channel];
                    let mean = sum / n;
                    let variance = ((sum2 / n - mean * mean) / (n - 1.0)).max(0.0);
                    image.mean[pixel][channel] = (mean * strength) as f32;
                    image.variance[pixel][channel] = (variance * strength * strength) as f32;
                }
            }
            image
        })
        .collect()
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
    let noise = |proposal: &Proposal| -> f64 {
        let options = RenderOptions {
            samples_per_pixel: 64,
            proposal: proposal.clone(),
            ..options.clone()
        };
        let sums: Vec<f64> = pixels
            .par_iter()
            .map(|&pixel| {
                let sums = render_pixel(scene, brdf, &options, pixel);
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

/// Per lamp and channel: sum of path values, sum of their squares.
type PixelSums = Vec<[[f64; 2]; 3]>;

fn render_pixel(
    scene: &Scene,
    brdf: &dyn Brdf,
    options: &RenderOptions,
    pixel: usize,
) -> PixelSums {
    let lights = scene.lights.len();
    let width = scene.camera.resolution_px[0];
    let corner = DVec2::new((pixel % width) as f64, (pixel / width) as f64);
    let mut sums = vec![[[0.0; 2]; 3]; lights];
    let mut path = vec![[0.0f64; 3]; lights];
    for sample in 0..options.samples_per_pixel {
        let key = |purpose| stream(options.seed, purpose, 0, pixel as u64, u64::from(sample));
        let mut position = key(Purpose::PixelPosition);
        let mut directions = key(Purpose::PathDirection);
        let mut lamps = key(Purpose::LightAndLens);
        let ray = scene.camera.ray(
            corner + DVec2::new(position.uniform(), position.uniform()),
            DVec2::new(lamps.uniform(), lamps.uniform()),
        );
        path.fill([0.0; 3]);
        let mut throughput = [1.0f64; 3];
        let mut next = scene.first(&ray);
        let mut reflections = 0;
        while let Some((surface, to_viewer)) = next {
            reflections += 1;
            let brdf = scene.known(&surface).unwrap_or(brdf);
            for (light, value) in path.iter_mut().enumerate() {
                let u = [lamps.uniform_f32(), lamps.uniform_f32()];
                if let Some(connection) = scene.connect(&surface, light, u) {
                    let f = brdf.eval(connection.to_light, to_viewer);
                    for channel in 0..3 {
                        value[channel] +=
                            throughput[channel] * f64::from(f[channel] * connection.irradiance);
                    }
                }
            }
            if reflections >= options.max_reflections {
                break;
            }
            let Some((direction, pdf)) = options.proposal.sample(to_viewer, &mut directions) else {
                break;
            };
            let f = brdf.eval(direction, to_viewer);
            for channel in 0..3 {
                throughput[channel] *= f64::from(f[channel] * direction.z / pdf);
            }
            if throughput == [0.0; 3] {
                break;
            }
            next = scene.next(&surface, direction);
        }
        for (sum, value) in sums.iter_mut().zip(&path) {
            for channel in 0..3 {
                sum[channel][0] += value[channel];
                sum[channel][1] += value[channel] * value[channel];
            }
        }
    }
    sums
}
