//! Where a real bench deviates from the model, and the error of ignoring that.

use std::sync::Arc;

use glam::Vec3;

use super::experiment::{Case, EvaluateError, Experiment, Row, Scale, Table, quantile};
use super::lab::{Lab, Material, Sample};
use crate::brdf::{Atom, Brdf, Dictionary, Mixture};
use crate::geometry::Mesh;
use crate::plot::{Axis, Chart, Figure, Mark, Series, charts};
use crate::radiance_image::RadianceImage;
use crate::transport::{Body, Light, Scene, Shading, render_polarised};

/// The truth with one deviation at a time, the fit without.
pub static REALISM: Experiment = Experiment {
    name: "realism",
    shows: "Error that each deviation of a real bench from the model causes if the fit ignores it: polarisation, broadband channels, cones of lamp and lens, a near lamp, the holder, translucency",
    full: Scale {
        materials: &["in-span"],
        ..Scale::SINGLE_IMAGE
    },
    quick: Scale {
        samples_per_pixel: 256,
        materials: &["in-span:02", "in-span:11"],
        ..Scale::QUICK_IMAGE
    },
    cases,
    figures,
};

const SHAPES: [Sample; 3] = [Sample::Sphere, Sample::Bowl, Sample::Designed];

/// What the truth includes and the fit's model does not.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Deviation {
    /// Nothing.
    None,
    /// Light is polarised by reflections.
    Polarised,
    /// A channel covers two equal bands; the material reflects a tenth in one.
    Broadband,
    /// Its control: a channel in which the material reflects the same everywhere.
    Narrowband,
    /// Half angle of the lamp, degrees.
    Lamp(f64),
    /// Half angle of the cone that the lens takes in, degrees.
    Lens(f64),
    /// The lamp's distance, mm (the sample is 1 mm in radius).
    Near(f64),
    /// Grey walls of this albedo around the sample, 1.3 mm from its axis, 1 mm high.
    Holder(f64),
    /// Part of the light that comes out elsewhere, 0.05 mm away (standard deviation).
    Translucent(f64),
}

const DEVIATIONS: [(&str, Deviation); 12] = [
    ("none", Deviation::None),
    ("polarised light", Deviation::Polarised),
    ("narrow channel", Deviation::Narrowband),
    ("broadband channel", Deviation::Broadband),
    ("lamp ±0.5°", Deviation::Lamp(0.5)),
    ("lamp ±1.15°", Deviation::Lamp(1.15)),
    ("lens ±0.5°", Deviation::Lens(0.5)),
    ("lens ±1.15°", Deviation::Lens(1.15)),
    ("lamp at 12 radii", Deviation::Near(12.0)),
    ("black holder", Deviation::Holder(0.05)),
    ("grey holder", Deviation::Holder(0.4)),
    ("translucent, 20%", Deviation::Translucent(0.2)),
];

fn cases(lab: &Lab) -> Result<Vec<Case>, EvaluateError> {
    let mut cases = Vec::new();
    for material in &lab.materials {
        for sample in SHAPES {
            for (name, deviation) in DEVIATIONS {
                // How other materials polarise is not known.
                if deviation == Deviation::Polarised && material.brdf.as_mixture().is_none() {
                    continue;
                }
                let material = material.clone();
                let key = format!("{}/{}/{name}", material.name, sample.name());
                cases.push(Case::new(key, move |lab: &Lab| {
                    one(lab, sample, &material, name, deviation)
                }));
            }
        }
    }
    Ok(cases)
}

fn one(
    lab: &Lab,
    sample: Sample,
    material: &Material,
    name: &str,
    deviation: Deviation,
) -> Result<Vec<Row>, EvaluateError> {
    let lights = sample.lights(1);
    let (captured, truth) = capture(lab, sample, &lights, &material.brdf, deviation)?;
    let estimate = lab.fit(sample, &lights, &captured, material)?;
    let figures = lab.score(&estimate.fit.material, &*truth);
    Ok(vec![
        Row::new()
            .with("material", material.name.as_str())
            .with("shape", sample.name())
            .with("departure", name)
            .with("environment_error", figures.environment)
            .with("brdf_error", figures.brdf)
            .with("cube_root_error", figures.cube_root)
            .with("reduced_chi2", estimate.mean_reduced_chi2()),
    ])
}

/// Images with the deviation, and the BRDF that a perfect fit would find.
fn capture(
    lab: &Lab,
    sample: Sample,
    lights: &[Light],
    brdf: &Arc<dyn Brdf>,
    deviation: Deviation,
) -> Result<(Vec<RadianceImage>, Arc<dyn Brdf>), EvaluateError> {
    // The true scene and material, then the images with the deviation.
    let mut scene = sample.true_scene(lab.settings.resolution_px, lights.to_vec())?;
    let mut truth = brdf.clone();
    let scaled = |factor: f32| Scaled {
        brdf: brdf.clone(),
        factor,
    };
    let images = match deviation {
        Deviation::None => lab.render_truth(&scene, &**brdf),
        Deviation::Polarised => {
            let options = lab.truth_options(&scene, &**brdf);
            render_polarised(&scene, &**brdf, &options, &())
                .map_err(|error| EvaluateError::Fact(error.to_string()))?
        }
        Deviation::Narrowband => {
            truth = Arc::new(scaled(0.55));
            lab.render_truth(&scene, &*truth)
        }
        Deviation::Broadband => {
            truth = Arc::new(scaled(0.55));
            let bright = lab.render_truth(&scene, &**brdf);
            let dark = lab.render_truth(&scene, &scaled(0.1));
            bright.iter().zip(&dark).map(|(a, b)| mean(a, b)).collect()
        }
        Deviation::Lamp(half_angle_deg) => {
            for light in &mut scene.lights {
                if let Light::Directional {
                    angular_radius_rad, ..
                } = light
                {
                    *angular_radius_rad = half_angle_deg.to_radians();
                }
            }
            lab.render_truth(&scene, &**brdf)
        }
        Deviation::Lens(half_angle_deg) => {
            scene.camera.object_na = half_angle_deg.to_radians().sin();
            lab.render_truth(&scene, &**brdf)
        }
        Deviation::Near(distance_mm) => {
            for light in &mut scene.lights {
                if let Light::Directional { to_light, .. } = *light {
                    *light = Light::Point {
                        position_mm: to_light * distance_mm,
                        intensity_mm2: [distance_mm * distance_mm; 3],
                    };
                }
            }
            lab.render_truth(&scene, &**brdf)
        }
        Deviation::Holder(albedo) => {
            let mesh = scene.sample().clone();
            let body = holder(albedo)?;
            let camera = scene.camera;
            let with =
                Scene::with_bodies(mesh, Shading::Smooth, vec![body], camera, lights.to_vec());
            lab.render_truth(&with, &**brdf)
        }
        Deviation::Translucent(part) => {
            let sharp = lab.render_truth(&scene, &**brdf);
            let sigma_px = 0.05 * lab.settings.resolution_px as f64 / 2.2;
            sharp
                .iter()
                .map(|image| blurred(image, part, sigma_px))
                .collect()
        }
    };
    Ok((images, truth))
}

/// A BRDF times a factor in 0..=1.
struct Scaled {
    brdf: Arc<dyn Brdf>,
    factor: f32,
}

impl Brdf for Scaled {
    fn eval(&self, to_light: Vec3, to_viewer: Vec3) -> [f32; 3] {
        self.brdf.eval(to_light, to_viewer).map(|f| f * self.factor)
    }
}

fn mean(a: &RadianceImage, b: &RadianceImage) -> RadianceImage {
    let mut mean = a.clone();
    for (p, rgb) in mean.mean.iter_mut().enumerate() {
        for (c, value) in rgb.iter_mut().enumerate() {
            *value = 0.5 * (a.mean[p][c] + b.mean[p][c]);
            mean.variance[p][c] = 0.25 * (a.variance[p][c] + b.variance[p][c]);
        }
    }
    mean
}

/// Four walls that look at the axis, from the sample's rim upwards.
fn holder(albedo: f64) -> Result<Body, EvaluateError> {
    let (side, height) = (1.3f32, 1.0f32);
    let corners = [(-side, -side), (side, -side), (side, side), (-side, side)];
    let mut positions = Vec::new();
    let mut triangles = Vec::new();
    for k in 0..4 {
        let ((x0, y0), (x1, y1)) = (corners[k], corners[(k + 1) % 4]);
        let first = positions.len() as u32;
        positions.extend([
            Vec3::new(x0, y0, 0.0),
            Vec3::new(x1, y1, 0.0),
            Vec3::new(x1, y1, height),
            Vec3::new(x0, y0, height),
        ]);
        // Counter-clockwise as seen from the axis.
        triangles.extend([[first + 1, first, first + 2], [first, first + 3, first + 2]]);
    }
    let dictionary = Dictionary::new("holder", vec![Atom::Lambertian { albedo }])?;
    Ok(Body {
        mesh: Mesh::new(positions, triangles)?,
        shading: Shading::Flat,
        brdf: Arc::new(Mixture::grey(Arc::new(dictionary), vec![1.0])?),
    })
}

/// `part` of every pixel's light spread as a Gaussian over the sample's pixels.
fn blurred(image: &RadianceImage, part: f64, sigma_px: f64) -> RadianceImage {
    let reach = (3.0 * sigma_px).ceil() as isize;
    let (width, height) = (image.width as isize, image.height as isize);
    let on_sample = |p: usize| image.mean[p].iter().any(|&v| v > 0.0);
    let mut out = image.clone();
    for y in 0..height {
        for x in 0..width {
            let p = (y * width + x) as usize;
            if !on_sample(p) {
                continue;
            }
            let (mut sum, mut weight) = ([0.0f64; 3], 0.0);
            for dy in -reach..=reach {
                for dx in -reach..=reach {
                    let (u, v) = (x + dx, y + dy);
                    if u < 0 || v < 0 || u >= width || v >= height {
                        continue;
                    }
                    let q = (v * width + u) as usize;
                    if on_sample(q) {
                        let r2 = (dx * dx + dy * dy) as f64;
                        let w = (-0.5 * r2 / (sigma_px * sigma_px)).exp();
                        weight += w;
                        (0..3).for_each(|c| sum[c] += w * f64::from(image.mean[q][c]));
                    }
                }
            }
            for (value, sum) in out.mean[p].iter_mut().zip(sum) {
                *value = ((1.0 - part) * f64::from(*value) + part * sum / weight) as f32;
            }
        }
    }
    out
}

fn figures(_: &Lab, table: &Table) -> Result<Vec<Figure>, EvaluateError> {
    let names = DEVIATIONS.map(|(name, _)| name);
    let ticks = (0..names.len()).map(|i| (i as f64, format!("{}", i + 1)));
    let x = Axis::with_ticks(
        -0.5..11.5,
        ticks.collect(),
        "deviation of the bench, see the legend",
    );
    let panel = |column: &str, label: &str, range: std::ops::Range<f64>| {
        let mut series = Vec::new();
        for (color, sample) in SHAPES.iter().enumerate() {
            let offset = 0.22 * (color as f64 - 1.0);
            let (mut points, mut bars) = (Vec::new(), Vec::new());
            for (i, name) in names.iter().enumerate() {
                let errors = table.figures(column, |row| {
                    row.text("shape") == sample.name() && row.text("departure") == *name
                });
                if errors.is_empty() {
                    continue;
                }
                let log = |p: f64| quantile(&errors, p).max(1e-6).log10();
                points.push([i as f64 + offset, log(0.5)]);
                bars.push([i as f64 + offset, log(0.25), log(0.75)]);
            }
            series.push(Series::new(sample.name(), color, Mark::Dots, points).within(bars));
        }
        for (i, name) in names.iter().enumerate() {
            let label = format!("{}: {name}", i + 1);
            series.push(Series::new(&label, 7, Mark::None, Vec::new()));
        }
        Chart {
            title: "median and quartiles over materials".to_owned(),
            x: x.clone(),
            y: Axis::decades(range, label),
            series,
        }
    };
    Ok(vec![charts(
        "realism",
        2,
        &[
            panel(
                "environment_error",
                "environment error (relative)",
                -2.5..0.5,
            ),
            panel("brdf_error", "BRDF error (relative)", -2.5..1.0),
        ],
    )])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_holder_looks_inwards() {
        let body = holder(0.3).unwrap();
        for triangle in 0..body.mesh.triangles.len() {
            let [a, b, c] = body.mesh.corners(triangle);
            let middle = (a + b + c) / 3.0;
            let inwards = -Vec3::new(middle.x, middle.y, 0.0);
            assert!(body.mesh.face_normal(triangle).dot(inwards) > 0.0);
        }
    }

    #[test]
    fn blurring_keeps_what_is_even_and_stays_on_the_sample() {
        let mut image = RadianceImage::new(8, 8);
        for p in 0..32 {
            image.mean[p] = [2.0; 3];
        }
        let out = blurred(&image, 0.5, 1.5);
        assert!((0..32).all(|p| (out.mean[p][0] - 2.0).abs() < 1e-6));
        assert!((32..64).all(|p| out.mean[p][0] == 0.0));
    }
}
