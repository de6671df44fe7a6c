//! The designer: which sample, which tilt of the camera and which lamps tell most of an unknown
//! material.
//!
//! A profile, turned about an axis or drawn along a line, and the tilt are searched by the
//! cross-entropy method; the lamps are the best of those within reach, for each profile anew. What counts is the environment error that the
//! images are expected to leave ([`crate::inverse::expected_error`], docs/adr/0017), the geometric mean
//! over some embedded materials. All candidates are looked at with the same paths, and what was found
//! once more with others and with materials that took no part, because a search exploits noise.

use std::sync::Arc;

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use crate::geometry::shapes::Form;
use crate::geometry::{Mesh, MeshError, Shape};
use crate::inverse::expected_error::{
    Choice, ExpectedError, PredictionError, PredictionOptions, Prospects, Subject, USUAL, coarse,
    error_by_deviations,
};
use crate::progress::Progress;
use crate::random::{Purpose, Stream, stream};
use crate::transport::{Camera, Projection, Scene, Shading};
use crate::units::StageAngles;

mod drawing;
pub mod profile;
mod reach;
mod solid;
mod tolerance;
mod written;

pub use profile::{Limits, Profile};
pub use reach::{Bench, Lamp, Reach};
pub use tolerance::Tolerance;
pub use written::{WriteError, write};

use profile::HEIGHTS;

/// Materials that take no part in a search.
pub const HELD_OUT: [&str; 4] = ["alum-bronze", "pvc", "delrin", "gold-metallic-paint"];

/// What is searched for.
#[derive(Clone, Debug)]
pub struct DesignRequest {
    /// Lamps, 1..=12.
    pub images: usize,
    /// What can be made.
    pub limits: Limits,
    /// Least and largest angle of the camera from the sample's axis, degrees, 0..=75.
    pub tilt_deg: [f64; 2],
    /// Where lamps can stand.
    pub reach: Reach,
    /// How exactly it is made and placed.
    pub tolerance: Tolerance,
    /// Embedded materials that the error is averaged over.
    pub materials: Vec<String>,
    /// Rounds of the search, 0..=100.
    pub rounds: u32,
    /// Designs per round, 8..=1000.
    pub population: u32,
    /// Of the search and its paths.
    pub seed: u64,
}

/// Angles of a camera from the sample's axis, degrees, as `LOW:HIGH` or one.
///
/// # Errors
/// What is expected instead.
pub fn tilt_range(text: &str) -> Result<[f64; 2], String> {
    let (low, high) = text.split_once(':').unwrap_or((text, text));
    match [low, high].map(|text| text.trim().parse()) {
        [Ok(low), Ok(high)] if 0.0 <= low && low <= high && high <= 75.0 => Ok([low, high]),
        _ => Err("not an angle in 0 to 75, or two with the lower one first, e.g. 0:60".to_owned()),
    }
}

/// A form by its name, as `rig design --form` takes it.
///
/// # Errors
/// What is expected instead.
pub fn form(text: &str) -> Result<Form, String> {
    match text {
        "revolved" => Ok(Form::Revolved),
        "extruded" => Ok(Form::Extruded),
        _ => Err("not one of revolved, extruded".to_owned()),
    }
}

impl Default for DesignRequest {
    fn default() -> Self {
        Self {
            images: 4,
            limits: Limits::default(),
            tilt_deg: Reach::default().tilts_deg(),
            reach: Reach::default(),
            tolerance: Tolerance::default(),
            materials: USUAL.map(str::to_owned).to_vec(),
            rounds: 8,
            population: 24,
            seed: 1,
        }
    }
}

/// A sample with its camera and lamps, and the errors that are expected of it.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Design {
    /// What tables call it.
    pub name: String,
    /// Angle of the camera from the sample's axis, degrees.
    pub camera_tilt_deg: f64,
    /// Lamps, the most telling first.
    pub lights: Vec<Lamp>,
    /// Geometric mean of the materials that took part.
    pub error: f64,
    /// Of those that took none.
    pub error_held_out: f64,
    /// Of those that took part, where sample and lamps are off by the request's tolerance and the fit
    /// takes them for exact.
    pub error_as_made: f64,
    /// Each material.
    pub materials: Vec<ExpectedError>,
}

/// What a search found.
#[derive(Clone, Debug)]
pub struct Found {
    /// The sample's profile.
    pub profile: Profile,
    /// Its design.
    pub design: Design,
    /// Known shapes in the same place.
    pub others: Vec<Design>,
}

/// Why there is no design.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum DesignError {
    #[error(transparent)]
    Mesh(#[from] MeshError),
    #[error(transparent)]
    Prediction(#[from] PredictionError),
    #[error("{name} is no embedded material")]
    Material { name: String },
    #[error("{images} images, but only {lamps} directions are free for lamps")]
    TooFewLamps { images: usize, lamps: usize },
    #[error(
        "a camera tilt of {tilt_deg}° makes the flat sample {depth_mm:.1} mm deep, {allowed_mm} mm are sharp"
    )]
    TooDeep {
        tilt_deg: f64,
        depth_mm: f64,
        allowed_mm: f64,
    },
}

/// Pixels per side and facets around while searching.
const SEARCH: [u32; 2] = [18, 64];
/// The same for what was found.
const FINAL: [u32; 2] = [24, 128];
/// Paths per cell while searching.
const SEARCH_PATHS: u32 = 32;
/// Share of a round whose mean and spread the next one has.
const ELITE: f64 = 0.2;
/// Spread of the first round's heights, in radii.
const FIRST_SPREAD: f64 = 0.35;
/// Step of the lamps' angles while searching, degrees.
const LAMP_STEP_DEG: f64 = 30.0;
/// Parts into which the step is divided for what was found.
const FINER: f64 = 2.0;
/// Side of the view, in radii.
const VIEW: f64 = 2.2;
/// Where a tilted camera stands that is no bench's, degrees.
const CAMERA_AZIMUTH_DEG: f64 = 180.0;

/// Searches.
///
/// # Errors
/// Limits that leave no design.
pub fn design(request: &DesignRequest, progress: &dyn Progress) -> Result<Found, DesignError> {
    let search = Search::new(request)?;
    let (heights, tilt_deg) = search.run(progress)?;
    let profile = Profile::through(&heights).flattened(&request.limits, tilt_deg);
    let segments = FINAL[1];
    let mesh = profile.mesh(&request.limits, segments)?;
    let design = search.judged("found", mesh, tilt_deg)?;

    // Known shapes with the tilt that suits each best.
    let radius_mm = request.limits.radius_mm as f32;
    let shapes = [
        (
            "bowl",
            Shape::Bowl {
                radius_mm,
                segments,
            },
        ),
        (
            "ball",
            Shape::Sphere {
                radius_mm,
                segments,
            },
        ),
        (
            "cap of 60°",
            Shape::Cap {
                radius_mm: radius_mm / 60f32.to_radians().sin(),
                opening_deg: 60.0,
                segments,
            },
        ),
    ];
    let mut others = Vec::new();
    for (name, shape) in shapes {
        let mesh = shape.mesh()?;
        let [low, high] = request.tilt_deg;
        let mut tilts_deg = vec![low, 0.5 * (low + high), high];
        tilts_deg.dedup();
        let mut best: Option<Design> = None;
        for tilt_deg in tilts_deg {
            let next = search.judged(name, mesh.clone(), tilt_deg)?;
            if best.as_ref().is_none_or(|best| next.error < best.error) {
                best = Some(next);
            }
        }
        others.extend(best);
    }
    Ok(Found {
        profile,
        design,
        others,
    })
}

/// Embedded materials by their names.
///
/// # Errors
/// [`DesignError::Material`].
pub fn subjects(names: &[String]) -> Result<Vec<Arc<Subject>>, DesignError> {
    let load = |name: &String| {
        let subject = Subject::embedded(name).map(Arc::new);
        subject.ok_or_else(|| DesignError::Material { name: name.clone() })
    };
    names.par_iter().map(load).collect()
}

/// What is expected of each material after the images of a scene.
///
/// # Errors
/// Bodies of the scene that cannot be taken into account.
pub fn evaluate(
    scene: Scene,
    materials: &[Arc<Subject>],
    seed: u64,
) -> Result<Vec<ExpectedError>, PredictionError> {
    let all: Vec<usize> = (0..scene.lights.len()).collect();
    let options = PredictionOptions {
        seed,
        ..PredictionOptions::default()
    };
    Ok(Prospects::new(coarse(scene), materials, &options)?.by_material(&all))
}

/// The geometric mean of what is expected of some materials.
pub fn geometric_mean(errors: &[ExpectedError]) -> f64 {
    let sum: f64 = errors.iter().map(|of| of.error.ln()).sum();
    (sum / errors.len() as f64).exp()
}

/// A lamp, and the error that is expected with it and those before.
#[derive(Clone, Copy, Debug, serde::Serialize)]
pub struct ChosenLamp {
    /// Its direction in the sample's frame.
    #[serde(flatten)]
    pub light: StageAngles,
    /// Expected environment error.
    pub error: f64,
}

/// The best lamps for the sample and the camera of a scene, in place of its own.
///
/// # Errors
/// Too few free directions; bodies that cannot be taken into account.
pub fn lights_only(
    mut scene: Scene,
    request: &DesignRequest,
) -> Result<Vec<ChosenLamp>, DesignError> {
    let materials = subjects(&request.materials)?;
    let free = request.reach.lamps(&scene, LAMP_STEP_DEG / FINER);
    let free = enough(free, request.images)?;
    scene.lights = free.iter().map(|lamp| lamp.light).collect();
    let options = PredictionOptions {
        seed: request.seed,
        ..PredictionOptions::default()
    };
    let prospects = Prospects::new(coarse(scene), &materials, &options)?;
    let chosen = prospects.greedy(&[], request.images).into_iter();
    Ok(chosen
        .map(|choice| ChosenLamp {
            light: free[choice.candidate].angles,
            error: choice.error,
        })
        .collect())
}

/// A point of the search: heights in radii, then the tilt in degrees.
type Point = [f64; HEIGHTS + 1];

struct Search<'a> {
    request: &'a DesignRequest,
    subjects: Vec<Arc<Subject>>,
    held_out: Vec<Arc<Subject>>,
}

impl<'a> Search<'a> {
    fn new(request: &'a DesignRequest) -> Result<Self, DesignError> {
        let [tilt_deg, _] = request.tilt_deg;
        let flat = Profile::through(&[0.0; HEIGHTS]);
        if !flat.keeps(&request.limits, tilt_deg) {
            return Err(DesignError::TooDeep {
                tilt_deg,
                depth_mm: flat.depth(tilt_deg) * request.limits.radius_mm,
                allowed_mm: request.limits.depth_of_field_mm,
            });
        }
        Ok(Self {
            request,
            subjects: subjects(&request.materials)?,
            held_out: subjects(&HELD_OUT.map(str::to_owned))?,
        })
    }

    /// The best point of a cross-entropy search: each round is drawn from the normal distribution
    /// of the best of the round before.
    fn run(&self, progress: &dyn Progress) -> Result<([f64; HEIGHTS], f64), DesignError> {
        let request = self.request;
        let [low, high] = request.tilt_deg;
        let mut mean: Point = [0.0; HEIGHTS + 1];
        let mut spread: Point = [FIRST_SPREAD; HEIGHTS + 1];
        (mean[HEIGHTS], spread[HEIGHTS]) = (0.5 * (low + high), 0.4 * (high - low));
        let mut best: Option<(f64, Point)> = None;
        for round in 0..request.rounds {
            let drawn = (0..request.population).map(|k| {
                let mut numbers = stream(
                    request.seed,
                    Purpose::Experiment,
                    u64::from(round),
                    0,
                    u64::from(k),
                );
                self.drawn(&mean, &spread, &mut numbers)
            });
            let mut scored = Vec::new();
            for point in drawn.collect::<Vec<_>>() {
                scored.push((self.error(&point)?, point));
                progress.advance(1);
            }
            scored.extend(best);
            scored.sort_by(|a, b| a.0.total_cmp(&b.0));
            best = scored.first().copied();
            scored.truncate((ELITE * f64::from(request.population)).ceil() as usize);
            let count = scored.len() as f64;
            for k in 0..=HEIGHTS {
                let elite = || scored.iter().map(|(_, point)| point[k]);
                let of = elite().sum::<f64>() / count;
                let square = elite().map(|v| (v - of).powi(2)).sum::<f64>() / count;
                mean[k] = 0.3 * mean[k] + 0.7 * of;
                spread[k] = 0.3 * spread[k] + 0.7 * square.sqrt();
            }
        }
        let point = best.map_or(mean, |(_, point)| point);
        Ok((heights(&point), point[HEIGHTS]))
    }

    fn drawn(&self, mean: &Point, spread: &Point, numbers: &mut Stream) -> Point {
        let [low, high] = self.request.tilt_deg;
        let mut point: Point = std::array::from_fn(|k| mean[k] + spread[k] * numbers.normal());
        let limits = &self.request.limits;
        let deepest = (0.5 * limits.depth_of_field_mm / limits.radius_mm).min(1.0);
        let deepest_deg = deepest.asin().to_degrees();
        point[HEIGHTS] = point[HEIGHTS].clamp(low, high.min(deepest_deg).max(low));
        point
    }

    fn error(&self, point: &Point) -> Result<f64, DesignError> {
        let (request, tilt_deg) = (self.request, point[HEIGHTS]);
        let profile = Profile::through(&heights(point)).flattened(&request.limits, tilt_deg);
        let [pixels, segments] = SEARCH;
        let mesh = profile.mesh(&request.limits, segments)?;
        let mut scene = request.scene(mesh, tilt_deg, pixels);
        let lamps = self.lamps(&scene, tilt_deg, LAMP_STEP_DEG)?;
        scene.lights = lamps.iter().map(|lamp| lamp.light).collect();
        let options = PredictionOptions {
            samples_per_cell: SEARCH_PATHS,
            seed: request.seed,
            ..PredictionOptions::default()
        };
        let prospects = Prospects::new(scene, &self.subjects, &options)?;
        let choices = prospects.greedy(&[], request.images);
        Ok(choices.last().map_or(f64::INFINITY, |last| last.error))
    }

    /// With the best lamps of a finer grid, by other paths than those of the search.
    fn judged(&self, name: &str, mesh: Mesh, tilt_deg: f64) -> Result<Design, DesignError> {
        let request = self.request;
        let place = |lamps: &[Lamp]| {
            let mut scene = request.scene(mesh.clone(), tilt_deg, FINAL[0]);
            scene.lights = lamps.iter().map(|lamp| lamp.light).collect();
            scene
        };
        let lamps = self.lamps(&place(&[]), tilt_deg, LAMP_STEP_DEG / FINER)?;
        let options = PredictionOptions {
            seed: request.seed.wrapping_add(1),
            ..PredictionOptions::default()
        };
        let prospects = Prospects::new(place(&lamps), &self.subjects, &options)?;
        let chosen = prospects.greedy(&[], request.images);
        let chosen: Vec<Lamp> = chosen.iter().map(|c: &Choice| lamps[c.candidate]).collect();
        let all: Vec<usize> = (0..chosen.len()).collect();
        let again = PredictionOptions {
            seed: request.seed.wrapping_add(2),
            ..options
        };
        let [took_part, held_out] = [&self.subjects, &self.held_out]
            .map(|subjects| Prospects::new(place(&chosen), subjects, &again));
        let [mut materials, held_out] = [took_part?, held_out?].map(|of| of.by_material(&all));
        let (error, error_held_out) = (geometric_mean(&materials), geometric_mean(&held_out));
        let described = place(&chosen);
        let deviations = request.tolerance.deviations(&described, request.seed);
        let added = error_by_deviations(&described, &deviations, &self.subjects, &again)?;
        let as_made = materials
            .iter()
            .zip(added)
            .map(|(of, added)| of.error.hypot(added).ln());
        let error_as_made = (as_made.sum::<f64>() / materials.len() as f64).exp();
        materials.extend(held_out);
        Ok(Design {
            name: name.to_owned(),
            camera_tilt_deg: tilt_deg,
            lights: chosen,
            error,
            error_held_out,
            error_as_made,
            materials,
        })
    }

    /// Free places. Without a bench sample and camera are mirror images of themselves at azimuth
    /// 0, and on the axis a single lamp may stand at any azimuth of a turned sample, in one quarter of
    /// a drawn one.
    fn lamps(&self, scene: &Scene, tilt_deg: f64, step_deg: f64) -> Result<Vec<Lamp>, DesignError> {
        let Self { request, .. } = self;
        let widest_deg = match tilt_deg < ON_AXIS_DEG && request.images == 1 {
            _ if request.reach.bench.is_some() => 360.0,
            true if request.limits.form == Form::Revolved => 0.0,
            true => 90.0,
            false => 180.0,
        };
        let mut free = request.reach.lamps(scene, step_deg);
        free.retain(|lamp| lamp.angles.azimuth_deg <= widest_deg);
        enough(free, request.images)
    }
}

fn enough(free: Vec<Lamp>, images: usize) -> Result<Vec<Lamp>, DesignError> {
    let lamps = free.len();
    match lamps < images {
        true => Err(DesignError::TooFewLamps { images, lamps }),
        false => Ok(free),
    }
}

fn heights(point: &Point) -> [f64; HEIGHTS] {
    std::array::from_fn(|k| point[k])
}

/// Tilts of the camera below this count as none, degrees.
const ON_AXIS_DEG: f64 = 1.0;

impl DesignRequest {
    /// A sample before its camera, which is tilted from the sample's axis and aimed at the middle
    /// of its height; without lamps.
    fn scene(&self, mesh: Mesh, tilt_deg: f64, pixels: u32) -> Scene {
        let [low, high] = mesh.bounds_mm().map(|corner| f64::from(corner.z));
        let middle_mm = 0.5 * (low + high) * DVec3::Z;
        let radius_mm = self.limits.radius_mm;
        let bench = self.reach.bench.as_ref();
        let azimuth_deg = bench.and_then(Bench::camera_azimuth_deg);
        let azimuth_deg = azimuth_deg.unwrap_or(CAMERA_AZIMUTH_DEG);
        let distance_mm = bench.map_or(10.0 * radius_mm, Bench::camera_distance_mm);
        let to_camera = StageAngles::new(azimuth_deg, 90.0 - tilt_deg).to_light();
        let up = match tilt_deg < ON_AXIS_DEG {
            true => DVec3::Y,
            false => DVec3::Z,
        };
        let extent_mm = DVec2::splat(VIEW * radius_mm);
        let camera = Camera::looking_at(
            [pixels as usize; 2],
            Projection::Orthographic { extent_mm },
            middle_mm + distance_mm * to_camera,
            middle_mm,
            up,
        );
        let camera = camera.expect("up is across the view");
        Scene::new(mesh, Shading::Smooth, camera, Vec::new())
    }
}
