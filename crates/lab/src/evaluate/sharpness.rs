//! How much error an image that is not sharp adds, and how much of it a model with the point
//! spread removes.

use std::sync::Arc;

use glam::Vec3;

use super::experiment::{Case, EvaluateError, Experiment, Row, Scale, Scatter, Table};
use super::lab::capture::{SENSOR, photograph};
use super::lab::{Lab, Material, Sample, of_materials};
use crate::brdf::{Atom, Dictionary, Mixture};
use crate::calibration::mirror_sphere::Grey;
use crate::calibration::slanted_edge::{Lens, fit_edges, locate};
use crate::geometry::Mesh;
use crate::plot::{Figure, charts};
use crate::random::{Purpose, stream};
use crate::simulation::photograph::Photographer;
use crate::transport::{Camera, Light, RenderOptions, Scene, Shading, render};

/// Captures through a lens that spreads points over pixels, fitted without, with the true
/// and with the measured point spread in the model; and sharp captures.
pub static SHARPNESS: Experiment = Experiment {
    name: "sharpness",
    shows: "Error where the lens spreads a point over 1.5 pixels (standard deviation): without, with the true and with the measured point spread in the model, and of a sharp image",
    full: Scale {
        materials: &[
            "in-span:01",
            "in-span:06",
            "in-span:11",
            "in-span:16",
            "nbrdf:blue-acrylic",
            "nbrdf:red-plastic",
            "nbrdf:pvc",
            "synthetic:cream-satin",
        ],
        lights: 2,
        ..Scale::SINGLE_IMAGE
    },
    quick: Scale {
        materials: &["nbrdf:blue-acrylic"],
        lights: 1,
        resolution_px: 24,
        ..Scale::QUICK_IMAGE
    },
    cases,
    figures,
};

const SHAPES: [Sample; 2] = [Sample::Bowl, Sample::ConcaveCorner];
/// Standard deviation of the true point spread.
const SPREAD_PX: f64 = 1.5;

fn cases(lab: &Lab) -> Result<Vec<Case>, EvaluateError> {
    Ok(of_materials(lab, &SHAPES, |s| s.name().to_owned(), one))
}

fn photographer(seed: u64) -> Photographer {
    Photographer { seed, ..SENSOR }
}

fn one(lab: &Lab, material: &Arc<Material>, sample: Sample) -> Result<Vec<Row>, EvaluateError> {
    let settings = &lab.settings;
    let (resolution_px, lights) = (settings.resolution_px, sample.lights(settings.lights));
    let believed = sample.scene(resolution_px, lights.clone())?;
    let truth = sample.true_scene(resolution_px, lights)?;
    let key = |what| stream(settings.seed, Purpose::BenchPerturbation, 0, 0, what).bits();
    let spread = |scene: &Scene, point_spread_px: f64| {
        let mut scene = scene.clone();
        scene.camera.point_spread_px = point_spread_px;
        scene
    };
    let error = |true_px: f64, believed_px: f64| -> Result<f64, EvaluateError> {
        let scene = spread(&truth, true_px);
        let options = RenderOptions {
            seed: key(1),
            ..lab.truth_options(&scene, &*material.brdf)
        };
        let rendered = render(&scene, &*material.brdf, &options);
        let captured = photograph(&photographer(key(2)), &rendered)?;
        let fitted = lab
            .fit_scene(&spread(&believed, believed_px), &captured)?
            .fit;
        Ok(lab.score(&fitted.material, &*material.brdf).environment)
    };
    let [measured_px, measured_std_px] = measured(&truth.camera, EDGE_SAMPLES, key(3))?;
    let sharp = error(0.0, 0.0)?;
    let ignored = error(SPREAD_PX, 0.0)?;
    let stated = error(SPREAD_PX, SPREAD_PX)?;
    let measured = error(SPREAD_PX, measured_px)?;
    Ok(vec![
        material
            .row(sample)
            .with("spread_px", SPREAD_PX)
            .with("measured_px", measured_px)
            .with("measured_std_px", measured_std_px)
            .with("sharp", sharp)
            .with("ignored", ignored)
            .with("stated", stated)
            .with("measured", measured)
            .with("ignored_over_sharp", ignored / sharp)
            .with("stated_over_sharp", stated / sharp)
            .with("measured_over_sharp", measured / sharp),
    ])
}

/// Point spread and its uncertainty from a photograph of a white target's tilted edge, taken
/// with the same lens at 64 pixels.
fn measured(camera: &Camera, samples_per_pixel: u32, seed: u64) -> Result<[f64; 2], EvaluateError> {
    let mut camera = *camera;
    camera.resolution_px = [EDGE_PX; 2];
    camera.point_spread_px = SPREAD_PX;
    let (sin, cos) = 0.15f32.sin_cos();
    let corner = |u: f32, v: f32| Vec3::new(u * cos - v * sin, u * sin + v * cos, 0.0);
    let corners = [(0.0, -4.0), (4.0, -4.0), (4.0, 4.0), (0.0, 4.0)].map(|(u, v)| corner(u, v));
    let target = Mesh::new(corners.to_vec(), vec![[0, 1, 2], [0, 2, 3]])?;
    let light = Light::Directional {
        to_light: glam::DVec3::Z,
        irradiance: [1.0; 3],
        angular_radius_rad: 0.0,
    };
    let scene = Scene::new(target, Shading::Flat, camera, vec![light]);
    let white = Dictionary::new("white", vec![Atom::Lambertian { albedo: 0.9 }])?;
    let white = Mixture::grey(white.into(), vec![1.0])?;
    let options = RenderOptions {
        samples_per_pixel,
        max_reflections: 1,
        seed,
        ..RenderOptions::default()
    };
    let mut rendered = render(&scene, &white, &options).remove(0);
    // Few paths give a pixel no reliable variance: the largest is used for all.
    let widest = rendered.variance.iter().flatten().copied();
    let widest = widest.fold(0.0, f32::max);
    rendered.variance.fill([widest; 3]);
    let image = photographer(seed).take(&rendered, 0)?;
    let edge = locate(0, &Grey::of(&image), None, &camera, 0.0)?;
    let start = Lens {
        spread_px2: 0.5,
        focus_mm: camera.focus_mm,
        tangent2: 0.0,
    };
    let found = fit_edges(&[edge], start)?;
    let sigma_px = found.lens.spread_px2.sqrt();
    Ok([sigma_px, found.covariance[(0, 0)].sqrt() / (2.0 * sigma_px)])
}

const EDGE_PX: usize = 64;
const EDGE_SAMPLES: u32 = 4096;

/// The sharp image's error against that of the blurred one, one panel per shape; the line
/// is equality.
fn figures(_: &Lab, table: &Table) -> Result<Vec<Figure>, EvaluateError> {
    let scatter = Scatter {
        table,
        decades: -3.0..1.0,
        x: ("sharp", "environment error, sharp image"),
        y_label: "environment error",
        series: &[
            ("blur ignored", 1, "ignored"),
            ("blur stated", 2, "stated"),
            ("blur measured", 0, "measured"),
        ],
    };
    let panels = SHAPES.map(Sample::name).map(|shape| {
        let [ignored, measured] = ["ignored_over_sharp", "measured_over_sharp"]
            .map(|column| scatter.median(column, shape));
        let title =
            format!("{shape}: medians {ignored:.2} and {measured:.2} times the sharp image's");
        scatter.panel(title, shape)
    });
    Ok(vec![charts("sharpness", 2, &panels)])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_point_spread_is_measured_within_its_uncertainty() {
        for (sample, seed) in [(SHAPES[0], 1), (SHAPES[1], 2)] {
            let camera = sample.scene(32, sample.lights(1)).unwrap().camera;
            let [sigma_px, std_px] = measured(&camera, 128, seed).unwrap();
            let pull = (sigma_px - SPREAD_PX) / std_px;
            eprintln!("{}: {sigma_px} ± {std_px}", sample.name());
            assert!(pull.abs() < 5.0 && std_px < 0.05, "{sigma_px} ± {std_px}");
        }
    }
}
