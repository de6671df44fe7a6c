//! The settings of a run: what its rows depend on, and nothing else.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::{EvaluateError, Experiment};

/// Settings of an experiment before the command line; 0 or empty where the
/// experiment does not have the setting.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    /// Pixels per side of the captured images.
    pub resolution_px: usize,
    /// Paths per pixel of the fit.
    pub samples_per_pixel: u32,
    /// Paths per pixel of the true images.
    pub truth_samples_per_pixel: u32,
    /// Most lights.
    pub lights: usize,
    /// Pixels per side of the spheres of the environment error.
    pub sphere_px: usize,
    /// Azimuths φd of the BRDF error's cells and of projections.
    pub azimuths: usize,
    /// Specs of [`super::super::lab::materials`].
    pub materials: &'static [&'static str],
    /// Dictionary of the fits, by name.
    pub dictionary: &'static str,
}

impl Scale {
    /// An experiment with none of the settings.
    pub const NONE: Self = Self {
        resolution_px: 0,
        samples_per_pixel: 0,
        truth_samples_per_pixel: 0,
        lights: 0,
        sphere_px: 0,
        azimuths: 0,
        materials: &[],
        dictionary: PAPER,
    };

    /// One image, as published: 64 × 64 pixels, the spheres of the environment error.
    pub const SINGLE_IMAGE: Self = Self {
        resolution_px: 64,
        samples_per_pixel: 512,
        truth_samples_per_pixel: 2048,
        lights: 0,
        sphere_px: 128,
        azimuths: 9,
        materials: &["bundled", "synthetic"],
        dictionary: PAPER,
    };

    /// One image of a camera's own size. The fit compares cells, over which the true images'
    /// noise is averaged, so that few paths per pixel make up as many as in
    /// [`Self::SINGLE_IMAGE`].
    pub const FULL_SIZE: Self = Self {
        resolution_px: 640,
        truth_samples_per_pixel: 24,
        ..Self::SINGLE_IMAGE
    };

    /// [`Self::SINGLE_IMAGE`] in minutes on one core.
    pub const QUICK_IMAGE: Self = Self {
        resolution_px: 16,
        samples_per_pixel: 64,
        truth_samples_per_pixel: 256,
        lights: 0,
        sphere_px: 24,
        azimuths: 3,
        materials: &["nbrdf:blue-acrylic", "nbrdf:pvc", "synthetic:cream-satin"],
        dictionary: PAPER,
    };
}

/// What the command line changes.
#[derive(Clone, Debug, Default)]
pub struct Overrides {
    /// Material specs.
    pub materials: Option<Vec<String>>,
    /// Pixels per side, 4..=4096.
    pub resolution_px: Option<usize>,
    /// Paths per cell of the fit; the truth's change in proportion unless it is given.
    pub samples_per_pixel: Option<u32>,
    /// Paths per pixel of the true images.
    pub truth_samples_per_pixel: Option<u32>,
    /// Pixels per side of the spheres of the environment error.
    pub sphere_px: Option<usize>,
    /// Most lights.
    pub lights: Option<usize>,
    /// Seed.
    pub seed: Option<u64>,
    /// Dictionary, by name or file.
    pub dictionary: Option<String>,
    /// Run the small version.
    pub quick: bool,
    /// Only instructions that every machine has.
    pub portable: bool,
}

/// All that the rows of a run depend on; written with them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// The experiment's name.
    pub experiment: String,
    /// Its small version.
    pub quick: bool,
    /// Pixels per side of the captured images.
    pub resolution_px: usize,
    /// Paths per pixel of the fit.
    pub samples_per_pixel: u32,
    /// Paths per pixel of the true images.
    pub truth_samples_per_pixel: u32,
    /// Longest path in surface reflections.
    pub max_reflections: u32,
    /// Most lights.
    pub lights: usize,
    /// Pixels per side of the spheres of the environment error.
    pub sphere_px: usize,
    /// Azimuths φd of the BRDF error's cells and of projections.
    pub azimuths: usize,
    /// Key of all random numbers.
    pub seed: u64,
    /// Dictionary name and the first digits of its atoms' SHA-256.
    pub dictionary: String,
    /// Material specs, each once; files with the first digits of their SHA-256.
    pub materials: Vec<String>,
    /// Instructions that evaluate paths.
    pub kernel: String,
    /// Program versions.
    pub versions: BTreeMap<String, String>,
}

/// Longest path in surface reflections of every experiment, truth and fit alike.
pub const MAX_REFLECTIONS: u32 = 16;

/// Dictionary of the experiments that repeat the paper's, unless another is given. Those that
/// measure what users get have [`Dictionary::DEFAULT`](crate::brdf::Dictionary::DEFAULT).
pub const PAPER: &str = "paper42";
/// Seed unless another is given.
pub const SEED: u64 = 1;

impl Settings {
    /// The experiment's defaults with the command line's changes. `dictionary`,
    /// `materials` and `kernel` are filled in by the laboratory that loads them.
    pub fn new(experiment: &Experiment, overrides: &Overrides) -> Result<Self, EvaluateError> {
        let scale = if overrides.quick {
            &experiment.quick
        } else {
            &experiment.full
        };
        // Options that the experiment has no use for.
        let o = overrides;
        let options = [
            (
                "resolution",
                o.resolution_px.is_some(),
                scale.resolution_px > 0,
            ),
            (
                "spp",
                o.samples_per_pixel.is_some(),
                scale.samples_per_pixel > 0,
            ),
            (
                "truth-spp",
                o.truth_samples_per_pixel.is_some(),
                scale.truth_samples_per_pixel > 0,
            ),
            ("sphere", o.sphere_px.is_some(), scale.sphere_px > 0),
            ("lights", o.lights.is_some(), scale.lights > 0),
            (
                "materials",
                o.materials.is_some(),
                !scale.materials.is_empty(),
            ),
        ];
        let unused = options.into_iter().find(|&(_, given, has)| given && !has);
        if let Some((setting, ..)) = unused {
            return Err(EvaluateError::Unused {
                experiment: experiment.name,
                setting,
            });
        }
        // The truth's paths change in proportion to the fit's.
        let truth_samples_per_pixel = match (o.truth_samples_per_pixel, o.samples_per_pixel) {
            (Some(n), _) => n,
            (None, Some(n)) if scale.truth_samples_per_pixel > 0 => {
                let [truth, fit] = [scale.truth_samples_per_pixel, scale.samples_per_pixel];
                (u64::from(n) * u64::from(truth) / u64::from(fit.max(1))).max(2) as u32
            }
            _ => scale.truth_samples_per_pixel,
        };
        Ok(Self {
            experiment: experiment.name.to_owned(),
            quick: o.quick,
            resolution_px: o.resolution_px.unwrap_or(scale.resolution_px),
            samples_per_pixel: o.samples_per_pixel.unwrap_or(scale.samples_per_pixel),
            truth_samples_per_pixel,
            max_reflections: MAX_REFLECTIONS,
            lights: o.lights.unwrap_or(scale.lights),
            sphere_px: o.sphere_px.unwrap_or(scale.sphere_px),
            azimuths: scale.azimuths,
            seed: o.seed.unwrap_or(SEED),
            dictionary: o
                .dictionary
                .clone()
                .unwrap_or_else(|| scale.dictionary.to_owned()),
            materials: o
                .materials
                .clone()
                .unwrap_or_else(|| scale.materials.iter().map(|&s| s.to_owned()).collect()),
            kernel: String::new(),
            versions: BTreeMap::from([("rig".to_owned(), env!("CARGO_PKG_VERSION").to_owned())]),
        })
    }

    /// Each setting that differs, as `name: then, now now`; empty if none does.
    pub fn differences(&self, now: &Self) -> String {
        let fields = |settings: &Self| serde_json::to_value(settings).unwrap_or_default();
        let (then, now) = (fields(self), fields(now));
        let mut differences = Vec::new();
        for (name, then) in then.as_object().into_iter().flatten() {
            let now = &now[name];
            if now != then {
                differences.push(format!("{name} was {then}, is {now}"));
            }
        }
        differences.join("; ")
    }
}
