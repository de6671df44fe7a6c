//! How good the lights are that `--lights N` plans on each shipped bench, compared with lights
//! as far from each other as the stage allows.

use std::path::Path;

use glam::DVec3;

use super::experiment::{Case, EvaluateError, Experiment, Medians, Row, Scale, Table, doublings};
use super::lab::capture::{SENSOR, photograph};
use super::lab::{Lab, Material};
use crate::capture::directions::{Aim, plan_order};
use crate::capture::reach::StageReach;
use crate::config::geometry::GeometryConfig;
use crate::config::{BUILT_IN, RigConfig};
use crate::frames::{Rigid, Sample};
use crate::plot::{Axis, Chart, Figure, Series, charts};
use crate::random::{Purpose, stream};
use crate::simulation::photograph::Photographer;
use crate::simulation::pose_error;
use crate::transport::Scene;
use crate::units::StageAngles;

/// Every built-in rig file, with the camera of the file in fewer pixels.
pub static PLANS: Experiment = Experiment {
    name: "plans",
    shows: "Error with the 1, 2, 4, … lights that each shipped rig file's plan has, and with one light nearest to the camera and the others as far from each other as the stage allows; the bench's pose and angles off as the simulated bench's are",
    full: Scale {
        resolution_px: 64,
        samples_per_pixel: 256,
        truth_samples_per_pixel: 1024,
        lights: 4,
        materials: &[
            "nbrdf:dark-red-paint",
            "nbrdf:alum-bronze",
            "nbrdf:silver-paint",
            "nbrdf:delrin",
            "synthetic:bright-enamel",
            "synthetic:cream-satin",
        ],
        ..Scale::SINGLE_IMAGE
    },
    quick: Scale {
        resolution_px: 24,
        lights: 4,
        materials: &["nbrdf:dark-red-paint"],
        ..Scale::QUICK_IMAGE
    },
    cases,
    figures,
};

/// Facets around the true sample's rim: finer than the fit's, as on the simulated bench.
const TRUE_SEGMENTS: u32 = 320;
/// Error of the stage's angles, degrees (standard deviation).
const POSITIONING_DEG: f64 = 0.05;
/// Error of the sample's pose in the file, per axis (standard deviations).
const POSE_ERROR_MM: f64 = 0.02;
const POSE_ERROR_DEG: f64 = 0.1;

/// How lights are chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Rule {
    /// As `rig capture --lights N` does.
    Planned,
    /// Nearest to the camera first, then always the one farthest from those before, blocked
    /// or not: how lights were chosen before.
    Farthest,
}

impl Rule {
    fn name(self) -> &'static str {
        match self {
            Self::Planned => "planned",
            Self::Farthest => "farthest point",
        }
    }

    fn lights(self, reach: &StageReach, coaxial: DVec3, count: usize) -> Vec<StageAngles> {
        match self {
            Self::Planned => plan_order(reach, Aim::along(coaxial), count, 0.0),
            Self::Farthest => farthest(&reach.reachable(), coaxial, count),
        }
    }
}

/// The direction nearest to the camera's, then always the first one of those farthest from
/// all before it.
fn farthest(from: &[StageAngles], coaxial: DVec3, count: usize) -> Vec<StageAngles> {
    let mut chosen: Vec<StageAngles> = Vec::new();
    while chosen.len() < count.min(from.len()) {
        let score = |angles: &StageAngles| {
            let gaps = chosen
                .iter()
                .map(|c| c.to_light().distance(angles.to_light()));
            match chosen.is_empty() {
                true => angles.to_light().dot(coaxial),
                false => gaps.fold(f64::INFINITY, f64::min),
            }
        };
        let best = from
            .iter()
            .reduce(|best, next| match score(next) > score(best) + 1e-9 {
                true => next,
                false => best,
            });
        chosen.extend(best);
    }
    chosen
}

fn cases(lab: &Lab) -> Result<Vec<Case>, EvaluateError> {
    let mut counts = vec![1];
    while counts[counts.len() - 1] * 2 <= lab.settings.lights {
        counts.push(counts[counts.len() - 1] * 2);
    }
    let mut cases = Vec::new();
    for (rig, text) in BUILT_IN {
        let config = RigConfig::parse(rig, Path::new(""), text).map_err(fact)?;
        let reach = StageReach::of_rig(&config).map_err(fact)?;
        let coaxial = config.geometry.coaxial();
        for &count in &counts {
            for rule in [Rule::Planned, Rule::Farthest] {
                let lights = rule.lights(&reach, coaxial, count);
                for material in &lab.materials {
                    let (material, geometry) = (material.clone(), config.geometry.clone());
                    let (lights, rig) = (lights.clone(), *rig);
                    let key = format!("{}/{rig}/{count}/{}", material.name, rule.name());
                    cases.push(Case::new(key, move |lab: &Lab| {
                        let row = Row::new()
                            .with("material", material.name.as_str())
                            .with("rig", rig)
                            .with("rule", rule.name())
                            .with("lights", count)
                            .with("elevations_deg", elevations(&lights));
                        Ok(vec![row.and(one(lab, &geometry, &lights, &material)?)])
                    }));
                }
            }
        }
    }
    Ok(cases)
}

/// Images of the bench as it truly is, fitted as it is described.
fn one(
    lab: &Lab,
    geometry: &GeometryConfig,
    lights: &[StageAngles],
    material: &Material,
) -> Result<Row, EvaluateError> {
    let seed = lab.settings.seed;
    let believed = with_side(
        geometry.scene(lights).map_err(fact)?,
        lab.settings.resolution_px,
    );
    let [turned_rad, moved_mm] = pose_error(seed, POSE_ERROR_MM, POSE_ERROR_DEG);
    let pose: Rigid<Sample, Sample> = Rigid::from_rotation_vector(turned_rad, moved_mm);
    let surface = &geometry.sample.surface;
    let mesh = surface
        .mesh(geometry.sample.shading, Some(TRUE_SEGMENTS))
        .map_err(fact)?;
    let mut numbers = stream(seed, Purpose::BenchPerturbation, 0, 0, 2);
    let true_lights = lights.iter().map(|angles| {
        geometry.light(StageAngles {
            azimuth_deg: angles.azimuth_deg + POSITIONING_DEG * numbers.normal(),
            elevation_deg: angles.elevation_deg + POSITIONING_DEG * numbers.normal(),
        })
    });
    let truth = Scene::new(
        mesh.transformed(&pose),
        geometry.sample.shading,
        believed.camera,
        true_lights.collect(),
    );
    let photographer = Photographer {
        full_well_e: 10_500.0,
        frames: 2,
        seed,
        ..SENSOR
    };
    let rendered = lab.render_truth(&truth, &*material.brdf);
    let captured = photograph(&photographer, &rendered)?;
    let estimate = lab.fit_scene(&believed, &captured, material)?;
    lab.score_row(&estimate.fit.material, material)
}

/// The same view with so many pixels along its longer side.
fn with_side(mut scene: Scene, side_px: usize) -> Scene {
    let camera = &mut scene.camera;
    let longer_px = camera.resolution_px.into_iter().max().unwrap_or(1).max(1);
    let scale = side_px as f64 / longer_px as f64;
    camera.point_spread_px *= scale;
    camera.resolution_px = camera
        .resolution_px
        .map(|side| ((side as f64 * scale).round() as usize).max(1));
    scene
}

fn elevations(lights: &[StageAngles]) -> String {
    let each = lights
        .iter()
        .map(|angles| format!("{:.1}", angles.elevation_deg));
    each.collect::<Vec<_>>().join(" ")
}

fn fact(error: impl std::fmt::Display) -> EvaluateError {
    EvaluateError::Fact(error.to_string())
}

fn figures(_: &Lab, table: &Table) -> Result<Vec<Figure>, EvaluateError> {
    let counts = table.numbers("lights");
    let x = doublings(&counts, "number of lights");
    let medians = Medians {
        table,
        column: "environment_error",
        x_column: "lights",
        x: &counts,
        position: f64::log2,
    };
    let panel = |(rig, _): &(&str, &str)| {
        let mut all = Vec::new();
        let series = [Rule::Planned, Rule::Farthest].iter().enumerate();
        let series = series.map(|(color, rule)| {
            let series = medians.series(rule.name(), color, |row| {
                row.text("rig") == *rig && row.text("rule") == rule.name()
            });
            all.extend(series.points.iter().map(|p| p[1]));
            series.within(Vec::new())
        });
        let series: Vec<Series> = series.collect();
        let low = all.iter().copied().fold(0.0, f64::min);
        Chart {
            title: (*rig).to_owned(),
            x: x.clone(),
            y: Axis::decades(low - 0.1..0.1, "median environment error"),
            series,
        }
    };
    let panels: Vec<Chart> = BUILT_IN.iter().map(panel).collect();
    Ok(vec![charts("plans", 2, &panels)])
}
