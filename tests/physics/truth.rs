//! The simulated bench's truth, whose interreflection is interpolated, against paths traced
//! from every pixel.

use std::path::Path;
use std::sync::Arc;

use glam::DVec2;
use mock_devices::{Illumination, RadianceSource};
use rig::brdf::{Atom, Brdf, Dictionary, Mixture};
use rig::config::{BUILT_IN, RigConfig};
use rig::frames::{Rigid, Sample};
use rig::geometry::Shape;
use rig::geometry::shapes::Profile;
use rig::radiometry::mosaic::Mosaic;
use rig::random::{Purpose, stream};
use rig::simulation::{Truth, TruthSource, pose_error};
use rig::transport::render::render_pixels;
use rig::transport::{Camera, Light, RenderOptions, Scene, Shading, Steering, suited_proposal};
use rig::units::StageAngles;

/// The lamp's second channel, off the place where it was sent.
fn lit(at: StageAngles) -> Illumination {
    Illumination {
        azimuth_rad: at.azimuth_deg.to_radians(),
        elevation_rad: at.elevation_deg.to_radians(),
        sent_to_deg: [at.azimuth_deg.round(), at.elevation_deg.round()],
        channels: [0.0, 1.0, 0.0],
    }
}

/// Pixels of which every ray of a grid of 8 × 8 over three pixels meets the sample on one
/// side of the shadow's edge.
fn is_away_from_edges(scene: &Scene, pixel: usize) -> bool {
    let width = scene.camera.resolution_px[0];
    let corner = DVec2::new((pixel % width) as f64, (pixel / width) as f64) - 1.0;
    let mut lit = 0;
    for k in 0..64 {
        let place = DVec2::new(f64::from(k % 8), f64::from(k / 8)) * (3.0 / 7.0);
        let ray = scene.camera.ray(corner + place, DVec2::splat(0.5));
        match scene.first(&ray) {
            Some((surface, _)) => {
                lit += u32::from(scene.connect(&surface, 0, [0.5; 2]).is_some());
            }
            None => return false,
        }
    }
    lit == 0 || lit == 64
}

/// Some pixels of a scene away from edges.
fn some_pixels(scene: &Scene, count: usize) -> Vec<usize> {
    let mut numbers = stream(11, Purpose::Experiment, 0, 0, 0);
    let any = || (numbers.uniform() * scene.camera.pixels() as f64) as usize;
    std::iter::repeat_with(any)
        .filter(|&pixel| is_away_from_edges(scene, pixel))
        .take(count)
        .collect()
}

/// Mean and variance of the mean of some pixels in the second channel: direct light by many
/// points, interreflection by paths that the truth doesn't know.
fn by_pixel(scene: &Scene, brdf: &dyn Brdf, pixels: &[usize], paths: u32) -> [Vec<[f64; 2]>; 2] {
    let mut options = RenderOptions {
        samples_per_pixel: paths,
        min_reflections: 2,
        max_reflections: 32,
        seed: 990,
        steering: Steering::default(),
        scrambles: Some(16),
        ..RenderOptions::default()
    };
    options.proposal = suited_proposal(scene, brdf, &options);
    let direct = RenderOptions {
        min_reflections: 1,
        max_reflections: 1,
        ..options.clone()
    };
    [direct, options].map(|options| {
        let found = render_pixels(scene, brdf, &options, pixels);
        let green = |moments: [[f32; 3]; 2]| moments.map(|m| f64::from(m[1]));
        found.into_iter().map(green).collect()
    })
}

/// The shipped bench, whose truth is as its camera would have it without noise. A pixel that
/// is as dark as a twentieth of the sample's collects 420 electrons in its longest exposure,
/// which is a signal-to-noise ratio of 20 as the rig file wants it; others in proportion, up
/// to 5000, about what a bracket with steps of four leaves between two exposures. Away from
/// the edges of shadows and sample, 200 pixels: the mean square error over noise, less
/// what the per-pixel paths' own noise makes, is known within a fifth (two standard
/// deviations of the mean of 200 squares), and must be below 1/9.
#[test]
fn the_shipped_truth_errs_by_less_than_a_third_of_the_sensors_noise() {
    let rig = RigConfig::parse("simulated", Path::new(""), BUILT_IN[0].1).unwrap();
    let (simulation, geometry) = (rig.simulation.as_ref().unwrap(), &rig.geometry);
    let source = rig.truth().unwrap().unwrap();
    let at = StageAngles::new(20.043, 61.748);
    let radiance = source.radiance(&lit(at));
    let brdf = simulation.material.load().unwrap();
    let (surface, shading) = (&geometry.sample.surface, geometry.sample.shading);
    let mesh = surface.mesh(shading, Some(simulation.segments)).unwrap();
    let [rotation_rad, translation_mm] = pose_error(
        simulation.seed,
        simulation.pose_error_mm,
        simulation.pose_error_deg,
    );
    let pose: Rigid<Sample, Sample> = Rigid::from_rotation_vector(rotation_rad, translation_mm);
    let scene = Scene::new(
        mesh.transformed(&pose),
        geometry.sample.shading,
        geometry.camera,
        vec![geometry.light(at)],
    );
    let pixels = some_pixels(&scene, 200);
    let [direct, indirect] = by_pixel(&scene, &*brdf, &pixels, 4096);
    let means: Vec<f64> = direct
        .iter()
        .zip(&indirect)
        .map(|(d, i)| d[0] + i[0])
        .collect();
    let mut sorted = means.clone();
    sorted.sort_by(f64::total_cmp);
    let electrons_per_unit = 420.0 / sorted[sorted.len() / 20];
    let (mut errors, mut of_reference) = (0.0, 0.0);
    for (k, &pixel) in pixels.iter().enumerate() {
        let electrons = (means[k] * electrons_per_unit).min(5000.0);
        let noise2 = means[k] * means[k] / electrons;
        let seen = f64::from(radiance[pixel]) - simulation.ambient_w_m2_sr;
        errors += (seen - means[k]).powi(2) / noise2;
        of_reference += (direct[k][1] + indirect[k][1]) / noise2;
    }
    let [errors, of_reference] = [errors, of_reference].map(|sum| sum / pixels.len() as f64);
    println!(
        "error over noise: {:.3}, of the paths it is compared with {:.3}",
        (errors - of_reference).max(0.0).sqrt(),
        of_reference.sqrt()
    );
    assert!(errors - of_reference < 1.0 / 9.0, "{errors} {of_reference}");
}

fn bright() -> Arc<dyn Brdf> {
    let atoms = vec![
        Atom::Lambertian { albedo: 0.8 },
        Atom::Ggx {
            alpha: 0.3,
            eta: 1.5,
        },
    ];
    let dictionary = Dictionary::new("bright", atoms).unwrap();
    Arc::new(Mixture::grey(Arc::new(dictionary), vec![0.8, 0.2]).unwrap())
}

/// A bright bowl, and a groove with a crease along which light would leak: the
/// interreflection's sum over 300 pixels agrees with paths of every pixel within four standard
/// errors (6e-5 each) and a thousandth, and the pixels' root mean square error is below 3% of
/// all of their light, noise of both included. Two seeds of the truth tell its own standard error.
#[test]
fn interpolated_interreflection_is_that_of_paths_from_every_pixel() {
    let shapes = [
        Shape::Bowl {
            radius_mm: 10.0,
            segments: 128,
        },
        Shape::Groove {
            radius_mm: 12.0,
            width_mm: 12.0,
            profile: Profile::Vee { depth_mm: 6.0 },
            segments: 128,
        },
    ];
    let at = StageAngles::new(30.02, 70.03);
    let lamp = |angles: StageAngles| Light::distant(angles.to_light(), [1.0; 3]);
    for shape in shapes {
        let extent_mm = DVec2::new(40.0, 30.0);
        let mut camera = Camera::above([320, 240], extent_mm, 200.0);
        camera.point_spread_px = 0.5;
        let brdf = bright();
        let truth = |seed| {
            TruthSource::new(Truth {
                mesh: shape.mesh().unwrap(),
                shading: Shading::Smooth,
                bodies: Vec::new(),
                camera,
                mosaic: Mosaic::None,
                light: Box::new(lamp),
                brdf: brdf.clone(),
                pose_error_mm: 0.0,
                pose_error_deg: 0.0,
                ambient_w_m2_sr: 0.0,
                glare: Default::default(),
                samples_per_pixel: 256,
                max_reflections: 32,
                seed,
            })
        };
        let images = [1, 2].map(|seed| truth(seed).radiance(&lit(at)));
        let mesh = shape.mesh().unwrap();
        let scene = Scene::new(mesh, Shading::Smooth, camera, vec![lamp(at)]);
        let pixels = some_pixels(&scene, 300);
        let [direct, indirect] = by_pixel(&scene, &*brdf, &pixels, 512);
        let (mut off, mut of_seeds, mut variance, mut sum, mut square) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for (k, &pixel) in pixels.iter().enumerate() {
            let seen = images
                .each_ref()
                .map(|image| f64::from(image[pixel]) - direct[k][0]);
            let difference = 0.5 * (seen[0] + seen[1]) - indirect[k][0];
            off += difference;
            of_seeds += 0.5 * (seen[0] - seen[1]);
            variance += direct[k][1] + indirect[k][1];
            sum += indirect[k][0];
            square += (difference / (direct[k][0] + indirect[k][0])).powi(2);
        }
        let std_dev = (variance + of_seeds * of_seeds).sqrt();
        let rms = (square / pixels.len() as f64).sqrt();
        println!("{shape:?}: {off} ± {std_dev} of {sum}, each {rms}");
        assert!(
            off.abs() < 4.0 * std_dev + 1e-3 * sum,
            "{shape:?}: {off} ± {std_dev} of {sum}"
        );
        assert!(rms < 0.03, "{shape:?}: {rms}");
    }
}
