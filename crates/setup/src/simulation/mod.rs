//! The simulated bench's truth: the sample as it really is, under the lamp where it
//! really is, rendered for `mock-devices`.
//!
//! It differs from what a fit believes as a real bench does: another pose, a finer
//! mesh, other paths, a measured material outside the dictionary.

pub mod checkerboard;
pub mod edge;
pub mod glare_card;
pub mod glossy_spheres;
mod interreflection;
pub mod photograph;
pub mod pixels;
pub mod posed_sample;
pub mod room;
mod view;
pub mod white_standard;

use std::collections::HashMap;
use std::sync::{Arc, Mutex, OnceLock};

use glam::DVec3;
use mock_devices::glare::Glare;
use mock_devices::{Illumination, RadianceSource};

use self::interreflection::{Grid, Value};
use self::view::View;
use crate::brdf::Brdf;
use crate::frames::{Rigid, Sample};
use crate::geometry::Mesh;
use crate::radiometry::mosaic::Mosaic;
use crate::random::{Purpose, stream};
use crate::transport::render::quietest_proposal;
use crate::transport::{Body, Camera, Light, Proposal, RenderOptions, Scene, Shading};
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
    /// What the lens does to the light of the sample.
    pub glare: Glare,
    /// Light paths from each node of the grid on which the interreflection is followed.
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
/// Steps of the angles at which interreflection is followed, degrees: visits of one light
/// mostly fall into one step, and what lights the sample by way of itself changes less
/// within it than noise.
const INTERREFLECTION_STEP_DEG: f64 = 0.1;

/// Renders the truth on demand and remembers it by lamp position.
pub struct TruthSource {
    truth: Truth,
    /// What it takes to render, made when first requested.
    studio: OnceLock<Studio>,
    /// Held while something is rendered, so that nothing is rendered twice.
    known: Mutex<Known>,
}

/// What was rendered.
#[derive(Default)]
struct Known {
    /// By where the lamp was sent and stands, in [`INTERREFLECTION_STEP_DEG`].
    interreflections: HashMap<[i64; 4], Arc<Vec<Value>>>,
    /// The latest image, with the key of [`key`]: lights come one after the other, and an
    /// image is large.
    latest: Option<([i64; 4], Rendered)>,
}

/// What the images under all lamps share.
struct Studio {
    /// Without a lamp.
    scene: Scene,
    grid: Grid,
    /// Where continuations go.
    proposal: Proposal,
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
            studio: OnceLock::new(),
            known: Mutex::default(),
        }
    }

    fn studio(&self) -> &Studio {
        self.studio.get_or_init(|| Studio::new(&self.truth))
    }

    /// The image for unit power of each channel, rendered if it is not known.
    fn image(&self, illumination: &Illumination) -> Rendered {
        let mut known = self
            .known
            .lock()
            .unwrap_or_else(|poisoned| poisoned.into_inner());
        let position = key(illumination, ANGLE_STEP_DEG);
        if let Some((of, image)) = &known.latest
            && *of == position
        {
            return image.clone();
        }
        let place = key(illumination, INTERREFLECTION_STEP_DEG);
        let interreflection = known
            .interreflections
            .entry(place)
            .or_insert_with(|| Arc::new(self.follow(place)))
            .clone();
        let view = View {
            scene: &self.lit(position, ANGLE_STEP_DEG),
            brdf: &*self.truth.brdf,
            grid: &self.studio().grid,
            interreflection: &interreflection,
            seed: self.seed(place, 1),
        };
        let image = Arc::new(self.glared(view.render()));
        known.latest = Some((position, image.clone()));
        image
    }

    /// The image with the lens' glare.
    fn glared(&self, mut image: Vec<[f32; 3]>) -> Vec<[f32; 3]> {
        let Truth { glare, camera, .. } = &self.truth;
        if !glare.is_none() {
            for c in 0..3 {
                let mut plane: Vec<f32> = image.iter().map(|radiance| radiance[c]).collect();
                glare.spread(&mut plane, camera.resolution_px[0]);
                for (radiance, value) in image.iter_mut().zip(plane) {
                    radiance[c] = value;
                }
            }
        }
        image
    }

    /// Interreflection of the grid's nodes.
    fn follow(&self, place: [i64; 4]) -> Vec<Value> {
        let options = RenderOptions {
            seed: self.seed(place, 0),
            proposal: self.studio().proposal.clone(),
            ..options(&self.truth)
        };
        let scene = self.lit(place, INTERREFLECTION_STEP_DEG);
        self.studio()
            .grid
            .render(&scene, &*self.truth.brdf, &options)
    }

    /// The scene with the lamp where a key of these steps says that it stands.
    fn lit(&self, [azimuth, elevation, ..]: [i64; 4], step_deg: f64) -> Scene {
        self.studio().lit_by((self.truth.light)(StageAngles::new(
            azimuth as f64 * step_deg,
            elevation as f64 * step_deg,
        )))
    }

    /// Independent numbers for every position to which the lamp is sent, and the same at
    /// every visit: what differs between two visits is where the lamp stands alone.
    fn seed(&self, [.., azimuth, elevation]: [i64; 4], number: u64) -> u64 {
        let [azimuth, elevation] = [azimuth, elevation].map(|steps| steps as u64);
        let purpose = Purpose::BenchPerturbation;
        stream(self.truth.seed, purpose, azimuth, elevation, 1 + number).bits()
    }
}

/// True azimuth and elevation of the lamp, then where it was sent, in steps.
fn key(illumination: &Illumination, step_deg: f64) -> [i64; 4] {
    let steps = |angle_deg: f64, step_deg: f64| (angle_deg / step_deg).round() as i64;
    let [azimuth_deg, elevation_deg] = illumination.sent_to_deg;
    [
        steps(illumination.azimuth_rad.to_degrees(), step_deg),
        steps(illumination.elevation_rad.to_degrees(), step_deg),
        steps(azimuth_deg, ANGLE_STEP_DEG),
        steps(elevation_deg, ANGLE_STEP_DEG),
    ]
}

/// How the interreflection is followed, but for seed and proposal.
fn options(truth: &Truth) -> RenderOptions {
    RenderOptions {
        samples_per_pixel: truth.samples_per_pixel,
        max_reflections: truth.max_reflections,
        ..RenderOptions::default()
    }
}

impl Studio {
    fn new(truth: &Truth) -> Self {
        let scene = Scene::with_bodies(
            truth.mesh.clone(),
            truth.shading,
            truth.bodies.clone(),
            truth.camera,
            Vec::new(),
        );
        let grid = Grid::new(&scene, &*truth.brdf);
        let mut studio = Self {
            scene,
            grid,
            proposal: Proposal::default(),
        };
        // The same for all lamps, and whichever is lit first: by one above the stage.
        let above = (truth.light)(StageAngles::new(0.0, 90.0));
        let candidates = vec![
            Proposal::default(),
            Proposal::of_lobes([(0.3, 0.1)]),
            Proposal::of_lobes([(0.1, 0.2), (0.3, 0.2)]),
            Proposal::of_lobes([(0.05, 0.25), (0.15, 0.25)]),
            Proposal::of_lobes([(0.2, 0.5), (0.4, 0.2)]),
            Proposal::of_lobes([(0.1, 0.5), (0.25, 0.2)]),
            Proposal::tabulating(&*truth.brdf, 0.3),
        ];
        let (scene, options) = (studio.lit_by(above), options(truth));
        studio.proposal = quietest_proposal(&scene, &*truth.brdf, &options, candidates);
        studio
    }

    fn lit_by(&self, light: Light) -> Scene {
        let mut scene = self.scene.clone();
        scene.lights = vec![light];
        scene
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
        let image = self.image(illumination);
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
            camera: Camera::above([8, 8], DVec2::splat(2.2), 5.0),
            light: Box::new(|angles| Light::distant(angles.to_light(), [1.0, 2.0, 3.0])),
            mosaic: Mosaic::None,
            brdf: Arc::new(Mixture::grey(Arc::new(dictionary), vec![1.0]).unwrap()),
            pose_error_mm,
            pose_error_deg: 0.0,
            ambient_w_m2_sr: 0.5,
            glare: Glare::default(),
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
