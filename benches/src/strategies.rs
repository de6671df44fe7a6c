//! Ways to sample paths of two and more reflections between a far lamp and a
//! telecentric camera, for measuring their noise: camera paths with next event,
//! light paths whose vertices are seen by pixels, and both with the balance
//! heuristic (Veach 1997, section 9.2).
//!
//! Lamp and camera are alike here, a direction each: one walk serves both ends. The
//! scene holds the lamp as light 0 and the direction of the camera as light 1.

use glam::{DVec2, DVec3, Vec3};
use rig::brdf::Brdf;
use rig::geometry::Ray;
use rig::random::{Purpose, Stream, stream};
use rig::transport::scene::Surface;
use rig::transport::{Camera, Light, Projection, Proposal, Scene};

/// How paths are found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Strategy {
    /// From the camera, every vertex connected to the lamp.
    Camera,
    /// From the lamp, every vertex connected to the camera.
    Light,
    /// As many of each, weighted by the balance heuristic.
    Both,
}

/// A sample under one far lamp and a telecentric camera.
pub struct Setting {
    scene: Scene,
    /// The rectangle across the lamp's rays that holds the sample's shadow.
    window: Window,
    pixel_mm2: f64,
    longest: u32,
}

/// A rectangle of parallel rays.
struct Window {
    origin: DVec3,
    sides: [DVec3; 2],
    direction: DVec3,
    area_mm2: f64,
}

const LAMP: usize = 0;
const CAMERA: usize = 1;

impl Setting {
    /// Of a scene with one directional light and an orthographic camera; paths have 2
    /// to `longest` reflections. `None` for other scenes.
    pub fn new(mut scene: Scene, longest: u32) -> Option<Self> {
        let Projection::Orthographic { extent_mm } = scene.camera.projection else {
            return None;
        };
        let [Light::Directional { to_light, .. }] = scene.lights[..] else {
            return None;
        };
        let towards_camera = -scene.camera.sample_from_camera.direction(DVec3::Z);
        scene.lights.push(Light::Directional {
            to_light: towards_camera,
            irradiance: [1.0; 3],
            angular_radius_rad: 0.0,
        });
        let pixel_mm2 = extent_mm.x * extent_mm.y / scene.camera.pixels() as f64;
        let window = Window::new(&scene, to_light);
        Some(Self {
            scene,
            window,
            pixel_mm2,
            longest,
        })
    }

    /// Pixels of the image.
    pub fn pixels(&self) -> usize {
        self.scene.camera.pixels()
    }

    /// Radiance per pixel by paths of two and more reflections (the lamp's irradiance
    /// is one), with `paths` per pixel, or as many in total from the lamp.
    pub fn image(
        &self,
        strategy: Strategy,
        brdf: &dyn Brdf,
        proposal: &Proposal,
        paths: u32,
        seed: u64,
    ) -> Vec<f64> {
        let mut image = vec![0.0; self.pixels()];
        match strategy {
            Strategy::Camera => self.from_camera::<false>(brdf, proposal, paths, seed, &mut image),
            Strategy::Light => self.from_lamp::<false>(brdf, proposal, paths, seed, &mut image),
            Strategy::Both => {
                self.from_camera::<true>(brdf, proposal, paths, seed, &mut image);
                self.from_lamp::<true>(brdf, proposal, paths, seed, &mut image);
            }
        }
        image
    }

    /// Density of the walk from the lamp over that of the walk from the camera is the
    /// walk's own ratio times this, for n paths per pixel from either end.
    fn lamp_over_camera(&self) -> f64 {
        self.pixels() as f64 * self.pixel_mm2 / self.window.area_mm2
    }

    fn from_camera<const WEIGHTED: bool>(
        &self,
        brdf: &dyn Brdf,
        proposal: &Proposal,
        paths: u32,
        seed: u64,
        image: &mut [f64],
    ) {
        let camera = &self.scene.camera;
        let width = camera.resolution_px[0];
        for (pixel, radiance) in image.iter_mut().enumerate() {
            let corner = DVec2::new((pixel % width) as f64, (pixel / width) as f64);
            for path in 0..paths {
                let mut numbers = stream(
                    seed,
                    Purpose::PathDirection,
                    0,
                    pixel as u64,
                    u64::from(path),
                );
                let at = corner + DVec2::new(numbers.uniform(), numbers.uniform());
                let ray = camera.ray(at, DVec2::ZERO);
                self.walk::<WEIGHTED>(
                    &ray,
                    LAMP,
                    brdf,
                    proposal,
                    &mut numbers,
                    |_, value, ratio| {
                        let weight = 1.0 / (1.0 + ratio * self.lamp_over_camera());
                        *radiance += value * weight / f64::from(paths);
                    },
                );
            }
        }
    }

    fn from_lamp<const WEIGHTED: bool>(
        &self,
        brdf: &dyn Brdf,
        proposal: &Proposal,
        paths: u32,
        seed: u64,
        image: &mut [f64],
    ) {
        let total = u64::from(paths) * self.pixels() as u64;
        let flux = self.window.area_mm2 / (self.pixel_mm2 * total as f64);
        for path in 0..total {
            let mut numbers = stream(seed, Purpose::PathDirection, 1, 0, path);
            let ray = self.window.ray(numbers.uniform(), numbers.uniform());
            self.walk::<WEIGHTED>(
                &ray,
                CAMERA,
                brdf,
                proposal,
                &mut numbers,
                |surface, value, ratio| {
                    if let Some(pixel) = pixel_of(&self.scene.camera, surface.origin_mm) {
                        let weight = 1.0 / (1.0 + ratio / self.lamp_over_camera());
                        image[pixel] += flux * value * weight;
                    }
                },
            );
        }
    }

    /// Walks from `ray` and connects every vertex from the second on with light `end`:
    /// `seen` gets the vertex, the path's value over the density of its vertices, and
    /// (if `WEIGHTED`, else 0) the density of the same path found from the other end
    /// over that of this walk, both without what the first vertices' windows contribute.
    #[inline(always)]
    fn walk<const WEIGHTED: bool>(
        &self,
        ray: &Ray,
        end: usize,
        brdf: &dyn Brdf,
        proposal: &Proposal,
        numbers: &mut Stream,
        mut seen: impl FnMut(&Surface, f64, f64),
    ) {
        let Some((mut surface, mut back)) = self.scene.first(ray) else {
            return;
        };
        let cos_first = f64::from(back.z);
        let (mut throughput, mut ratio, mut segment) = (1.0f64, 1.0f64, 1.0f64);
        for reflection in 1..=self.longest {
            if reflection > 1
                && let Some(to) = self.scene.connect(&surface, end, [0.0; 2])
            {
                let f = brdf.eval(to.to_light, back)[1];
                let value = throughput * f64::from(f * to.irradiance);
                let ratio = if WEIGHTED {
                    let pdf = f64::from(proposal.pdf(to.to_light, back));
                    ratio * segment * pdf * f64::from(to.to_light.z) / cos_first
                } else {
                    0.0
                };
                seen(&surface, value, ratio);
            }
            if reflection == self.longest {
                break;
            }
            let Some((direction, pdf)) = proposal.sample(back, numbers) else {
                break;
            };
            let f = brdf.eval(direction, back)[1];
            throughput *= f64::from(f * direction.z / pdf);
            if throughput == 0.0 {
                break;
            }
            let Some((next, next_back)) = self.scene.next(&surface, direction) else {
                break;
            };
            if WEIGHTED {
                if reflection > 1 {
                    ratio *= segment * f64::from(proposal.pdf(direction, back));
                }
                segment = f64::from(direction.z) / f64::from(pdf * next_back.z);
            }
            (surface, back) = (next, next_back);
        }
    }
}

impl Window {
    fn new(scene: &Scene, to_light: DVec3) -> Self {
        let (x, y) = to_light.any_orthonormal_pair();
        let across = |p: &Vec3| DVec2::new(p.as_dvec3().dot(x), p.as_dvec3().dot(y));
        let points = &scene.sample().positions_mm;
        let low = points.iter().map(across).fold(DVec2::MAX, DVec2::min);
        let high = points.iter().map(across).fold(DVec2::MIN, DVec2::max);
        let [near, far] = scene.sample().bounds_mm().map(|p| p.as_dvec3());
        let size = high - low;
        Self {
            origin: x * low.x + y * low.y + to_light * (near.length() + far.length() + 1.0),
            sides: [x * size.x, y * size.y],
            direction: -to_light,
            area_mm2: size.x * size.y,
        }
    }

    fn ray(&self, u: f64, v: f64) -> Ray {
        Ray {
            origin_mm: (self.origin + self.sides[0] * u + self.sides[1] * v).as_vec3(),
            direction: self.direction.as_vec3(),
            limit_mm: f32::INFINITY,
        }
    }
}

/// The pixel on which a telecentric camera images a point.
fn pixel_of(camera: &Camera, point: Vec3) -> Option<usize> {
    let Projection::Orthographic { extent_mm } = camera.projection else {
        return None;
    };
    let [width, height] = camera.resolution_px;
    let p = camera.sample_from_camera.inverse().point(point.as_dvec3());
    let x = (p.x / extent_mm.x + 0.5) * width as f64;
    let y = (p.y / extent_mm.y + 0.5) * height as f64;
    let inside = x >= 0.0 && y >= 0.0 && x < width as f64 && y < height as f64;
    inside.then(|| y as usize * width + x as usize)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes;
    use rig::brdf::{Atom, Dictionary, Mixture};
    use rig::transport::{RenderOptions, render};
    use std::sync::Arc;

    fn material(alpha: f64) -> Mixture {
        let atoms = vec![
            Atom::Ggx { alpha, eta: 20.0 },
            Atom::Lambertian { albedo: 1.0 },
        ];
        let dictionary = Arc::new(Dictionary::new("two", atoms).unwrap());
        Mixture::grey(dictionary, vec![0.7, 0.3]).unwrap()
    }

    /// Means of the upper and the lower half of the image with their standard errors,
    /// from independent images.
    fn halves(image: impl Fn(u64) -> Vec<f64>) -> [(f64, f64); 2] {
        const IMAGES: u64 = 16;
        let images: Vec<Vec<f64>> = (0..IMAGES).map(image).collect();
        [0, 1].map(|half| {
            let sums: Vec<f64> = images
                .iter()
                .map(|image| {
                    let n = image.len() / 2;
                    image[half * n..(half + 1) * n].iter().sum::<f64>()
                })
                .collect();
            let n = sums.len() as f64;
            let mean = sums.iter().sum::<f64>() / n;
            let square = sums.iter().map(|s| (s - mean).powi(2)).sum::<f64>();
            (mean, (square / (n * (n - 1.0))).sqrt())
        })
    }

    /// 3 scenes × 3 strategies × 2 halves against the renderer: 18 comparisons at
    /// |t| < 6 with 30 degrees of freedom, together below 3e-5 by chance.
    #[test]
    fn all_strategies_and_the_renderer_agree() {
        for (mesh, lamp_deg) in [
            (scenes::bowl(), 30.0),
            (scenes::corner(), 25.0),
            (scenes::designed(), 10.0),
        ] {
            let mesh = mesh.unwrap();
            let brdf = material(0.3);
            let proposal = Proposal::default();
            let reference = halves(|seed| {
                let scene = scenes::scene(mesh.clone(), 8, &[lamp_deg]);
                let image = |max_reflections| {
                    let options = RenderOptions {
                        samples_per_pixel: 64,
                        max_reflections,
                        seed: 100 + seed,
                        proposal: proposal.clone(),
                        ..RenderOptions::default()
                    };
                    render(&scene, &brdf, &options).remove(0)
                };
                let (all, direct) = (image(8), image(1));
                let pairs = all.mean.iter().zip(&direct.mean);
                pairs.map(|(a, b)| f64::from(a[1] - b[1])).collect()
            });
            let setting = Setting::new(scenes::scene(mesh, 8, &[lamp_deg]), 8).unwrap();
            for strategy in [Strategy::Camera, Strategy::Light, Strategy::Both] {
                let found = halves(|seed| setting.image(strategy, &brdf, &proposal, 64, seed));
                for (a, b) in found.iter().zip(&reference) {
                    let t = (a.0 - b.0) / (a.1 * a.1 + b.1 * b.1).sqrt();
                    assert!(t.abs() < 6.0, "{strategy:?}, {lamp_deg}°: {a:?} {b:?}");
                    assert!(a.1 < 0.05 * a.0, "{strategy:?}: too noisy to say, {a:?}");
                }
            }
        }
    }
}
