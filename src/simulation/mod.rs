//! The simulated bench's truth: the sample as it really is, under the lamp where it
//! really is, rendered for `mock-devices`.
//!
//! It differs from what a fit believes as a real bench does: another pose, a finer
//! mesh, other paths, a measured material outside the dictionary.

pub mod checkerboard;
pub mod edge;
pub mod glossy_spheres;
pub mod photograph;
pub mod pixels;
pub mod posed_sample;
pub mod white_standard;

use std::collections::HashMap;
use std::sync::{Arc, Mutex, OnceLock};

use glam::DVec3;
use mock_devices::{Illumination, RadianceSource};

use crate::brdf::Brdf;
use crate::frames::{Rigid, Sample};
use crate::geometry::Mesh;
use crate::radiometry::mosaic::Mosaic;
use crate::random::{Purpose, stream};
use crate::transport::{
    Body, Camera, Light, Proposal, RenderOptions, Scene, Shading, render, render::quietest_proposal,
};
use crate::units::StageAngles;

/// What is true on the bench.
pub struct Truth {
    /// The sample's surface where the configuration puts it.
    pub mesh: Mesh,
    /// Which normals shade.
    pub shading: Shading,
    /// What stands around it, where the configuration puts that; it moves with the sample.
    pub bodies: Vec<Body>,
    /// The camera.
    pub camera: Camera,
    /// Its colour filters, each of which passes its channel's light alone.
    pub mosaic: Mosaic,
    /// The lamp with all channels lit, for the stage's true angles.
    pub light: Box<dyn Fn(StageAngles) -> Light + Send + Sync>,
    /// The sample's material.
    pub brdf: Arc<dyn Brdf>,
    /// Standard deviation of the true position against the configured one, mm.
    pub pose_error_mm: f64,
    /// Standard deviation of the true orientation, degrees.
    pub pose_error_deg: f64,
    /// Radiance of the room's light on the sensor, W/(m² sr).
    pub ambient_w_m2_sr: f32,
    /// Light paths per pixel.
    pub samples_per_pixel: u32,
    /// Longest path in surface reflections.
    pub max_reflections: u32,
    /// Key of the pose errors and of the paths.
    pub seed: u64,
}

/// The image under one lamp position, for unit power of each channel.
type Rendered = Arc<Vec<[f32; 3]>>;

/// Steps of the angles at which the truth is rendered, degrees: far below what any image
/// shows, and above the last bits of a sum.
const ANGLE_STEP_DEG: f64 = 1e-6;

/// Renders the truth on demand and remembers it by lamp position.
pub struct TruthSource {
    truth: Truth,
    /// The material's own lobes.
    lobes: OnceLock<Proposal>,
    /// By the key of [`TruthSource::key`].
    rendered: Mutex<HashMap<[i64; 4], Rendered>>,
}

impl TruthSource {
    /// Puts the sample where it truly is.
    pub fn new(mut truth: Truth) -> Self {
        let [rotation_rad, translation_mm] =
            pose_error(truth.seed, truth.pose_error_mm, truth.pose_error_deg);
        let pose: Rigid<Sample, Sample> = Rigid::from_rotation_vector(rotation_rad, translation_mm);
        let meshes = truth.bodies.iter_mut().map(|body| &mut body.mesh);
        for mesh in meshes.chain([&mut truth.mesh]) {
            *mesh = mesh.transformed(&pose);
        }
        Self {
            truth,
            lobes: OnceLock::new(),
            rendered: Mutex::default(),
        }
    }

    /// True azimuth and elevation of the lamp, then where it was sent, in steps.
    fn key(illumination: &Illumination) -> [i64; 4] {
        let steps = |angle_deg: f64| (angle_deg / ANGLE_STEP_DEG).round() as i64;
        let [azimuth_deg, elevation_deg] = illumination.sent_to_deg;
        [
            steps(illumination.azimuth_rad.to_degrees()),
            steps(illumination.elevation_rad.to_degrees()),
            steps(azimuth_deg),
            steps(elevation_deg),
        ]
    }

    fn render(&self, key: [i64; 4]) -> Vec<[f32; 3]> {
        let truth = &self.truth;
        let [azimuth, elevation, paths @ ..] = key;
        let light = (truth.light)(StageAngles {
            azimuth_deg: azimuth as f64 * ANGLE_STEP_DEG,
            elevation_deg: elevation as f64 * ANGLE_STEP_DEG,
        });
        let scene = Scene::with_bodies(
            truth.mesh.clone(),
            truth.shading,
            truth.bodies.clone(),
            truth.camera,
            vec![light],
        );
        // Independent paths for every position to which the lamp is sent, and the same at
        // every visit: what differs between two visits is where the lamp stands alone.
        let [azimuth, elevation] = paths.map(|steps| steps as u64);
        let position = stream(
            truth.seed,
            Purpose::BenchPerturbation,
            azimuth,
            elevation,
            1,
        )
        .bits();
        let mut options = RenderOptions {
            samples_per_pixel: truth.samples_per_pixel.max(2),
            max_reflections: truth.max_reflections,
            seed: position,
            ..RenderOptions::default()
        };
        let candidates = vec![
            Proposal::default(),
            Proposal::of_lobes([(0.3, 0.1)]),
            Proposal::of_lobes([(0.1, 0.2), (0.3, 0.2)]),
            Proposal::of_lobes([(0.05, 0.25), (0.15, 0.25)]),
            Proposal::of_lobes([(0.2, 0.5), (0.4, 0.2)]),
            Proposal::of_lobes([(0.1, 0.5), (0.25, 0.2)]),
            self.lobes
                .get_or_init(|| Proposal::tabulating(&*truth.brdf, 0.3))
                .clone(),
        ];
        options.proposal = quietest_proposal(&scene, &*truth.brdf, &options, candidates);
        render(&scene, &*truth.brdf, &options, &|_| {})
            .remove(0)
            .mean
    }
}

/// Where the sample truly lies against the configuration: turned by a vector (radians)
/// about its datum, then moved (mm), by errors of these standard deviations along each axis.
pub fn pose_error(seed: u64, error_mm: f64, error_deg: f64) -> [DVec3; 2] {
    let mut numbers = stream(seed, Purpose::BenchPerturbation, 0, 0, 0);
    let mut vector =
        |sigma: f64| DVec3::new(numbers.normal(), numbers.normal(), numbers.normal()) * sigma;
    [vector(error_deg.to_radians()), vector(error_mm)]
}

impl RadianceSource for TruthSource {
    fn resolution_px(&self) -> [u32; 2] {
        self.truth.camera.resolution_px.map(|n| n as u32)
    }

    fn radiance(&self, illumination: &Illumination) -> Arc<Vec<f32>> {
        let ambient = self.truth.ambient_w_m2_sr;
        let pixels = self.truth.camera.pixels();
        if illumination.channels == [0.0; 3] {
            return Arc::new(vec![ambient; pixels]);
        }
        let key = Self::key(illumination);
        let known = self
            .rendered
            .lock()
            .map(|map| map.get(&key).cloned())
            .unwrap_or_default();
        let image = known.unwrap_or_else(|| {
            let image = Arc::new(self.render(key));
            if let Ok(mut map) = self.rendered.lock() {
                map.insert(key, image.clone());
            }
            image
        });
        let power = illumination.channels.map(|p| p as f32);
        let width = self.truth.camera.resolution_px[0];
        let seen = |(pixel, radiance): (usize, &[f32; 3])| {
            let filter = self.truth.mosaic.channel(pixel % width, pixel / width);
            let passes = |channel: &usize| filter.is_none_or(|only| only == *channel);
            let channels = (0..3).filter(passes);
            ambient + channels.map(|c| radiance[c] * power[c]).sum::<f32>()
        };
        Arc::new(image.iter().enumerate().map(seen).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::brdf::{Atom, Dictionary, Mixture};
    use crate::geometry::Shape;
    use crate::transport::Projection;
    use glam::DVec2;

    fn source(pose_error_mm: f64) -> TruthSource {
        let dictionary = Dictionary::new("white", vec![Atom::Lambertian { albedo: 0.8 }]).unwrap();
        TruthSource::new(Truth {
            mesh: Shape::Bowl {
                radius_mm: 1.0,
                segments: 32,
            }
            .mesh()
            .unwrap(),
            shading: Shading::Smooth,
            bodies: Vec::new(),
            camera: Camera::looking_at(
                [8, 8],
                Projection::Orthographic {
                    extent_mm: DVec2::splat(2.2),
                },
                DVec3::new(0.0, 0.0, 5.0),
                DVec3::ZERO,
                DVec3::Y,
            )
            .unwrap(),
            light: Box::new(|angles| Light::Directional {
                to_light: angles.to_light(),
                irradiance: [1.0, 2.0, 3.0],
                angular_radius_rad: 0.0,
            }),
            mosaic: Mosaic::None,
            brdf: Arc::new(Mixture::grey(Arc::new(dictionary), vec![1.0]).unwrap()),
            pose_error_mm,
            pose_error_deg: 0.0,
            ambient_w_m2_sr: 0.5,
            samples_per_pixel: 16,
            max_reflections: 4,
            seed: 3,
        })
    }

    fn lit(elevation_deg: f64, channels: [f64; 3]) -> Illumination {
        Illumination {
            azimuth_rad: 0.3,
            elevation_rad: f64::to_radians(elevation_deg),
            sent_to_deg: [17.0, elevation_deg.round()],
            channels,
        }
    }

    #[test]
    fn the_lamp_adds_to_the_room() {
        let source = source(0.0);
        assert!(
            source
                .radiance(&lit(90.0, [0.0; 3]))
                .iter()
                .all(|&v| v == 0.5)
        );
        let middle = 8 * 4 + 4;
        let red = source.radiance(&lit(90.0, [1.0, 0.0, 0.0]))[middle] - 0.5;
        let green = source.radiance(&lit(90.0, [0.0, 1.0, 0.0]))[middle] - 0.5;
        assert!(red > 0.1);
        assert!((green / red - 2.0).abs() < 1e-4, "{green} against {red}");
        assert_ne!(
            source.radiance(&lit(60.0, [1.0, 0.0, 0.0]))[middle] - 0.5,
            red
        );
    }

    /// Last bits of the angles change nothing, and another visit, a hundredth of a degree
    /// away, changes what that hundredth changes: not the paths.
    #[test]
    fn one_commanded_position_has_one_truth() {
        let image = |elevation_deg| source(0.0).radiance(&lit(elevation_deg, [1.0, 0.0, 0.0]));
        let first = image(60.0);
        assert_eq!(image(60.0 * (1.0 + 2.0 * f64::EPSILON)), first);
        let again = image(60.01);
        assert_ne!(again, first);
        let sum = |image: &[f32]| image.iter().sum::<f32>();
        let change = sum(&again) / sum(&first) - 1.0;
        assert!(change.abs() < 1e-3, "{change}");
    }

    #[test]
    fn the_true_pose_differs() {
        let at = lit(90.0, [1.0, 0.0, 0.0]);
        assert_ne!(source(0.0).radiance(&at), source(0.2).radiance(&at));
    }
}
