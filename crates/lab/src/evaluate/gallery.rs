//! Figs. 6, 7 and 9: objects of the recovered materials under environment maps.

use std::sync::Arc;

use glam::DVec3;

use super::experiment::{Case, EvaluateError, Experiment, Row, Scale, Table};
use super::lab::{Lab, Material, Sample, of_materials};
use crate::brdf::environment::EnvironmentMap;
use crate::brdf::sphere::{normals, shade, srgb8};
use crate::brdf::{Brdf, Mixture};
use crate::plot::colors::sequential;
use crate::plot::{Figure, Picture, Tile, pictures};

/// A sphere and a vase under a checkerboard and a studio.
pub static GALLERY: Experiment = Experiment {
    name: "gallery",
    shows: "Figs. 6, 7, 9: a sphere and a vase of the true, projected and recovered materials under a checkerboard and a studio map, with insets of the error, from one image and from several",
    full: Scale {
        lights: 4,
        materials: &[
            "nbrdf:blue-acrylic",
            "nbrdf:gold-metallic-paint",
            "nbrdf:pearl-paint",
            "nbrdf:red-plastic",
            "synthetic:pink-ceramic",
            "synthetic:satin-metal",
        ],
        ..Scale::SINGLE_IMAGE
    },
    quick: Scale {
        lights: 4,
        sphere_px: 40,
        materials: &["nbrdf:blue-acrylic", "synthetic:pink-ceramic"],
        ..Scale::QUICK_IMAGE
    },
    cases,
    figures,
};

const SHAPES: [Sample; 3] = [Sample::Sphere, Sample::Bowl, Sample::Designed];

/// What is lit by the maps.
#[derive(Clone, Copy)]
enum Object {
    Sphere,
    Vase,
}

/// Figures 6 and 7: object and map.
const VIEWS: [(Object, &str, &str); 2] = [
    (Object::Sphere, "sphere", "checkerboard"),
    (Object::Vase, "vase", "studio"),
];

fn map(name: &str) -> Result<EnvironmentMap, EvaluateError> {
    if name != "checkerboard" {
        return EnvironmentMap::embedded(name)
            .ok_or_else(|| EvaluateError::Fact(format!("no map is called {name}")));
    }
    // Fields of 22.5°, mean radiance 1.
    let (width, height) = (128, 64);
    let texels = (0..width * height).map(|texel| {
        let (x, y) = (texel % width / 8, texel / width / 8);
        if (x + y) % 2 == 0 { [1.9; 3] } else { [0.1; 3] }
    });
    EnvironmentMap::new(name, width, height, texels.collect()).map_err(EvaluateError::Fact)
}

impl Object {
    /// Seen pixels and their normals; the viewer is at +z.
    fn points(self, size: usize) -> Vec<(usize, DVec3)> {
        match self {
            Object::Sphere => normals(size),
            Object::Vase => (0..size * size)
                .filter_map(|pixel| {
                    let at = |k: usize| (2.0 * k as f64 + 1.0) / size as f64 - 1.0;
                    let (x, y) = (at(pixel % size), -at(pixel / size));
                    let (radius, slope) = vase(y);
                    let nx = x / radius;
                    (nx.abs() < 1.0 && y.abs() < 0.95).then(|| {
                        let normal = DVec3::new(nx, -slope, (1.0 - nx * nx).sqrt());
                        (pixel, normal.normalize())
                    })
                })
                .collect(),
        }
    }
}

/// Radius of the vase at height y, −1..=1, and dr/dy.
fn vase(y: f64) -> (f64, f64) {
    let radius = 0.52 - 0.14 * y + 0.18 * (3.6 * y + 1.9).cos();
    let slope = -0.14 - 0.18 * 3.6 * (3.6 * y + 1.9).sin();
    (radius, slope)
}

fn cases(lab: &Lab) -> Result<Vec<Case>, EvaluateError> {
    let several = (lab.settings.lights > 1).then_some(lab.settings.lights);
    let counts = [Some(1), several].into_iter().flatten();
    let variants: Vec<(Sample, usize)> = SHAPES
        .into_iter()
        .flat_map(|sample| counts.clone().map(move |lights| (sample, lights)))
        .collect();
    let name = |(sample, lights): (Sample, usize)| format!("{}/{lights}", sample.name());
    Ok(of_materials(lab, &variants, name, one))
}

fn one(
    lab: &Lab,
    material: &Arc<Material>,
    (sample, lights): (Sample, usize),
) -> Result<Vec<Row>, EvaluateError> {
    let estimate = lab.measure(sample, lights, material)?;
    let mut row = Row::new()
        .with("material", material.name.as_str())
        .with("shape", sample.name())
        .with("lights", lights);
    for (object, name, map_name) in VIEWS {
        let points = object.points(lab.settings.sphere_px);
        let brdfs: [&dyn Brdf; 2] = [&*material.brdf, &estimate.fit.material];
        let shaded = pairs(brdfs, &map(map_name)?, &points);
        let error = relative_error(shaded.iter().map(|(_, pair)| *pair));
        row = row.with(format!("error_{name}_{map_name}"), error);
    }
    let weights =
        serde_json::to_string(estimate.fit.material.mixture.weights()).unwrap_or_default();
    Ok(vec![row.with("weights", weights)])
}

/// Two BRDFs shaded under one map: pixel and radiance of each.
fn pairs(
    brdfs: [&dyn Brdf; 2],
    map: &EnvironmentMap,
    points: &[(usize, DVec3)],
) -> Vec<(usize, [[f32; 3]; 2])> {
    let shaded = shade(&brdfs, std::slice::from_ref(map), points);
    let pair = |(pixel, values): (usize, Vec<[f32; 3]>)| (pixel, [values[0], values[1]]);
    shaded.into_iter().map(pair).collect()
}

/// ‖b − a‖ / ‖a‖ of (truth, estimate) pairs.
fn relative_error(pairs: impl Iterator<Item = [[f32; 3]; 2]>) -> f64 {
    let (mut difference, mut reference) = (0.0, 0.0);
    for [a, b] in pairs {
        for c in 0..3 {
            difference += f64::from(b[c] - a[c]).powi(2);
            reference += f64::from(a[c]).powi(2);
        }
    }
    (difference / reference).sqrt()
}

/// Error that the inset's brightest colour stands for, over the truth's mean.
const INSET_RANGE: f32 = 0.5;

/// One row of a figure: truth, then each BRDF with its error.
fn row(
    lab: &Lab,
    view: (Object, &str, &str),
    truth: &dyn Brdf,
    others: &[&dyn Brdf],
) -> Result<Vec<Tile>, EvaluateError> {
    let size = lab.settings.sphere_px;
    let points = view.0.points(size);
    let map = map(view.2)?;
    let mut row = Vec::new();
    let mut exposure = 1.0;
    let mut mean = 1.0f32;
    for (index, brdf) in std::iter::once(&truth).chain(others).enumerate() {
        let shaded = pairs([truth, *brdf], &map, &points);
        if index == 0 {
            let mut all: Vec<f32> = shaded.iter().flat_map(|(_, [a, _])| *a).collect();
            all.sort_by(f32::total_cmp);
            exposure = 1.0 / all[all.len() * 97 / 100].max(f32::MIN_POSITIVE);
            mean = all.iter().sum::<f32>() / all.len() as f32;
        }
        let mut pixels = vec![[255; 3]; size * size];
        let mut errors = vec![[255; 3]; size * size];
        for (pixel, [a, b]) in &shaded {
            pixels[*pixel] = b.map(|x| srgb8(exposure * x));
            let error = (0..3).map(|c| (b[c] - a[c]).abs()).sum::<f32>() / 3.0;
            errors[*pixel] = sequential(error / (INSET_RANGE * mean));
        }
        let error = relative_error(shaded.iter().map(|(_, pair)| *pair));
        row.push(Tile {
            caption: if index == 0 {
                String::new()
            } else {
                format!("error {error:.3}")
            },
            picture: Picture::opaque(size, pixels),
            inset: (index > 0).then(|| Picture::opaque(size, errors)),
        });
    }
    Ok(row)
}

fn figures(lab: &Lab, table: &Table) -> Result<Vec<Figure>, EvaluateError> {
    let estimate = |material: &Material, sample: Sample, lights: f64| {
        let found = table.rows.iter().find(|row| {
            row.text("material") == material.name
                && row.text("shape") == sample.name()
                && row.number("lights") == Some(lights)
        });
        let text = found.map_or("", |row| row.text("weights"));
        let weights: [Vec<f64>; 3] = serde_json::from_str(text)
            .map_err(|error| EvaluateError::Fact(format!("weights: {error}")))?;
        Ok::<_, EvaluateError>(Mixture::new(lab.dictionary.clone(), weights)?)
    };
    let named = |titles: &[&str]| titles.iter().map(|t| (*t).to_owned()).collect::<Vec<_>>();
    let mut figures = Vec::new();
    for view in VIEWS {
        let mut rows = Vec::new();
        for material in &lab.materials {
            let reference = lab.cells().reference_projection(&*material.brdf)?;
            let [sphere, bowl, designed] = SHAPES.map(|s| estimate(material, s, 1.0));
            let (sphere, bowl, designed) = (sphere?, bowl?, designed?);
            let others: [&dyn Brdf; 4] = [&reference, &sphere, &bowl, &designed];
            rows.push((
                material.name.clone(),
                row(lab, view, &*material.brdf, &others)?,
            ));
        }
        let titles = [
            "truth",
            "projection",
            "from sphere",
            "from bowl",
            "from designed",
        ];
        let name = format!("gallery-{}-{}", view.1, view.2);
        figures.push(pictures(&name, 104.0, &named(&titles), &rows));
    }
    if lab.settings.lights > 1 {
        let n = lab.settings.lights as f64;
        let mut rows = Vec::new();
        for material in &lab.materials {
            let mut mixtures = Vec::new();
            for sample in SHAPES {
                mixtures.push(estimate(material, sample, 1.0)?);
                mixtures.push(estimate(material, sample, n)?);
            }
            let others: Vec<&dyn Brdf> = mixtures.iter().map(|m| m as &dyn Brdf).collect();
            rows.push((
                material.name.clone(),
                row(lab, VIEWS[0], &*material.brdf, &others)?,
            ));
        }
        let mut titles = vec!["truth".to_owned()];
        for sample in SHAPES {
            titles.push(format!("{}, 1 light", sample.name()));
            titles.push(format!("{}, {n} lights", sample.name()));
        }
        figures.push(pictures("gallery-lights", 104.0, &titles, &rows));
    }
    Ok(figures)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_vase_has_the_normals_of_its_profile() {
        let points = Object::Vase.points(64);
        assert!(points.len() > 1000);
        for y in [-0.7, 0.0, 0.6] {
            let (low, high) = (vase(y - 1e-5).0, vase(y + 1e-5).0);
            assert!((vase(y).1 - (high - low) / 2e-5).abs() < 1e-6);
        }
        assert!(
            points
                .iter()
                .all(|(_, n)| n.z > 0.0 && (n.length() - 1.0).abs() < 1e-12)
        );
    }
}
