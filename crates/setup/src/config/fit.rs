//! The options of a fit: their names, ranges, choices and words, for all that read them. The
//! command line parses [`FitRequest`] itself, rig files and the Python package read it from a
//! [`Source`], the console passes options on by key, and a fit's record holds it.
//!
//! What an option does and its default stand in [`FitOptions`].

#[cfg(feature = "clap")]
mod command_line;

use std::ops::RangeInclusive;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::uncertainty::Deviation;
use crate::brdf::Dictionary;
use crate::brdf::discrepancy::Prior;
use crate::cells;
use crate::inverse::exponentiated_gradient::ExponentiatedGradient;
use crate::inverse::gauss_newton::GaussNewton;
use crate::inverse::{Channels, FitOptions, Optimizer};
use crate::transport::{CacheOptions, Kernel};

const SAMPLES_PER_CELL: RangeInclusive<u64> = 2..=65_536;
const MAX_REFLECTIONS: RangeInclusive<u64> = 2..=64;
const SEED: RangeInclusive<u64> = 0..=i64::MAX as u64;
const MODEL_ERROR: RangeInclusive<f64> = 0.0..=1.0;
const CELLS: RangeInclusive<u64> = *cells::BUDGET.start() as u64..=*cells::BUDGET.end() as u64;
const MEMORY_MIB: RangeInclusive<u64> = 16..=1_048_576;

/// Name, value, and what it is in a few words.
type Choice<T> = (&'static str, T, &'static str);

fn optimizers() -> [Choice<Optimizer>; 3] {
    let gauss_newton = Optimizer::GaussNewton(GaussNewton::default());
    let gradient = Optimizer::ExponentiatedGradient(ExponentiatedGradient::default());
    [
        (gauss_newton, "Gauss-Newton steps on the simplex"),
        (
            gradient,
            "Exponentiated gradient with Adam steps, as in the paper",
        ),
        (
            Optimizer::SingleBounce,
            "Convex least squares on direct reflection alone; a baseline",
        ),
    ]
    .map(|(optimizer, what)| (optimizer.name(), optimizer, what))
}

/// `None`: the fastest that the machine has.
const KERNELS: [Choice<Option<Kernel>>; 4] = [
    (
        "portable",
        Some(Kernel::Portable),
        "Plain Rust, the same numbers on every machine",
    ),
    ("avx2", Some(Kernel::Avx2), "AVX2"),
    ("avx512", Some(Kernel::Avx512), "AVX-512"),
    ("auto", None, "The fastest this machine has"),
];

/// Choices for a fit. What is `None` is as the rig file's `[fit]` table has it (a session), else
/// as in [`FitOptions::default`].
///
/// The record of a fit holds it in serialised form, in addition to the settings that every
/// fit has.
//
// `std::option::Option` is an option whose value on the command line may be none.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "clap", derive(clap::Args))]
pub struct FitRequest {
    /// Name of a built-in dictionary ([`Dictionary::NAMES`]), or the path of a dictionary file.
    #[cfg_attr(feature = "clap", arg(long, value_name = "D", help = command_line::dictionary()))]
    #[serde(skip)]
    pub dictionary: Option<String>,
    /// How the weights are found
    #[cfg_attr(feature = "clap", arg(long, value_parser = command_line::choice(optimizers())))]
    #[serde(skip)]
    pub optimizer: Option<Optimizer>,
    /// Light paths per cell.
    #[cfg_attr(feature = "clap", arg(long = "spp", value_name = "N", value_parser = command_line::count(SAMPLES_PER_CELL), help = command_line::within_or("Light paths per cell", SAMPLES_PER_CELL, CacheOptions::default().samples_per_cell)))]
    #[serde(skip)]
    pub samples_per_cell: Option<u32>,
    /// Longest path in surface reflections.
    #[cfg_attr(feature = "clap", arg(long, value_name = "K", value_parser = command_line::count(MAX_REFLECTIONS), help = command_line::within("Longest path in surface reflections", MAX_REFLECTIONS)))]
    #[serde(skip)]
    pub max_reflections: Option<u32>,
    /// Seed of the light paths
    #[cfg_attr(feature = "clap", arg(long, value_name = "S", value_parser = clap::value_parser!(u64).range(SEED)))]
    #[serde(skip)]
    pub seed: Option<u64>,
    /// The same weights for all colour channels
    #[cfg_attr(feature = "clap", arg(id = "shared_weights", long = "shared-weights", action = clap::ArgAction::SetTrue, value_parser = command_line::shared()))]
    #[serde(rename = "shared_weights", with = "shared_weights", default)]
    pub channels: std::option::Option<Channels>,
    /// Relative error of the model that the weighting allows for.
    #[cfg_attr(feature = "clap", arg(long, value_name = "T", value_parser = command_line::number(MODEL_ERROR), help = command_line::within_or("Relative error of the model that the weighting allows for", MODEL_ERROR, FitOptions::default().model_error)))]
    pub model_error: Option<f64>,
    /// PNG of the images' size: only pixels that are white in it are compared
    #[cfg_attr(feature = "clap", arg(long, value_name = "PNG"))]
    pub mask: Option<PathBuf>,
    /// Most cells of the images that are compared, within [`BUDGET`](cells::BUDGET).
    #[cfg_attr(feature = "clap", arg(long, value_name = "N", value_parser = command_line::size(CELLS), help = command_line::cells()))]
    #[serde(skip)]
    pub cells: Option<usize>,
    /// Memory that the whole fit may take, MiB. `None`: what the cells need and
    /// [`CacheOptions::max_bytes`] for paths, as far as the machine has them free.
    #[cfg_attr(feature = "clap", arg(long = "memory", value_name = "MIB", value_parser = clap::value_parser!(u64).range(MEMORY_MIB), help = command_line::memory()))]
    pub memory_mib: Option<u64>,
    /// Bundled measured material that the model discrepancy's prior is not learned from, nor from
    /// its near duplicates: the truth of simulated images; more than one may be given
    #[cfg_attr(
        feature = "clap",
        arg(id = "left_out", long = "leave-out", value_name = "MATERIAL", value_parser = crate::brdf::nbrdf::NAMES, hide_possible_values = true)
    )]
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<String>,
    /// Which instructions evaluate the paths; portable gives the same numbers anywhere
    #[cfg_attr(feature = "clap", arg(long, value_parser = command_line::choice(KERNELS), default_value = "auto", hide_default_value = true))]
    #[serde(skip)]
    pub kernel: std::option::Option<Kernel>,
    /// Refine light directions, intensities and the sample's pose with the weights,
    /// within the uncertainty that the rig or scene file states
    #[cfg_attr(feature = "clap", arg(long, value_name = "BOOL", num_args = 0..=1, require_equals = true, default_missing_value = "true"))]
    #[serde(skip)]
    pub refine_bench: Option<bool>,
    /// A deviation of the table `[uncertainty]`, such as light_deg=0.5; more than one may be given
    #[cfg_attr(feature = "clap", arg(long, value_name = "KEY=VALUE"))]
    #[serde(skip)]
    pub uncertainty: Vec<Deviation>,
    /// Record of the sample's pose in place of the session's copy; of no use for images of a
    /// scene file.
    #[cfg_attr(feature = "clap", arg(skip))]
    #[serde(skip)]
    pub pose: Option<PathBuf>,
    /// Whose work the fit is, as its record is to state it: a job that is repeated finds its fit
    /// by that.
    #[cfg_attr(feature = "clap", arg(skip))]
    pub job: Option<String>,
}

/// What options are read from by key: it refuses what is out of its range, in words of its own.
pub trait Source {
    /// A value that cannot be used.
    type Error;
    /// What it calls the paths per cell.
    const SAMPLES: &'static str = "samples_per_cell";

    /// An integer in `range`, if there is one.
    fn integer(
        &mut self,
        key: &'static str,
        range: RangeInclusive<u64>,
    ) -> Result<Option<u64>, Self::Error>;

    /// A number in `range`, if there is one.
    fn number(
        &mut self,
        key: &'static str,
        range: RangeInclusive<f64>,
    ) -> Result<Option<f64>, Self::Error>;

    /// True or false, if it is said.
    fn flag(&mut self, key: &'static str) -> Result<Option<bool>, Self::Error>;

    /// A text that is not empty, if there is one.
    fn text(&mut self, key: &'static str) -> Result<Option<String>, Self::Error>;

    /// The value of one of the names, if one is given.
    fn choice<T: Clone>(
        &mut self,
        key: &'static str,
        choices: &[(&'static str, T)],
    ) -> Result<Option<T>, Self::Error>;
}

impl FitRequest {
    /// What may be said of all fits of a bench.
    ///
    /// # Errors
    /// A value that the source refuses.
    pub fn read<S: Source>(from: &mut S) -> Result<Self, S::Error> {
        let count = |count| count as u32;
        Ok(Self {
            dictionary: from.text("dictionary")?,
            optimizer: from.choice("optimizer", &named(optimizers()))?,
            samples_per_cell: from.integer(S::SAMPLES, SAMPLES_PER_CELL)?.map(count),
            max_reflections: from.integer("max_reflections", MAX_REFLECTIONS)?.map(count),
            seed: from.integer("seed", SEED)?,
            channels: from.flag("shared_weights")?.map(shared_weights::channels),
            model_error: from.number("model_error", MODEL_ERROR)?,
            cells: from.integer("cells", CELLS)?.map(|count| count as usize),
            refine_bench: from.flag("refine_bench")?,
            ..Self::default()
        })
    }

    /// The same with what may be said of the machine of one fit.
    ///
    /// # Errors
    /// A value that the source refuses.
    pub fn read_machine<S: Source>(self, from: &mut S) -> Result<Self, S::Error> {
        Ok(Self {
            memory_mib: from.integer("memory_mib", MEMORY_MIB)?,
            kernel: from.choice("kernel", &named(KERNELS))?.flatten(),
            ..self
        })
    }

    /// Puts what is chosen in its place.
    pub fn apply(&self, options: &mut FitOptions) {
        set(&mut options.optimizer, &self.optimizer);
        set(&mut options.cache.samples_per_cell, &self.samples_per_cell);
        set(&mut options.cache.max_reflections, &self.max_reflections);
        set(&mut options.cache.seed, &self.seed);
        set(&mut options.channels, &self.channels);
        set(&mut options.model_error, &self.model_error);
        set(&mut options.kernel, &self.kernel);
        options.left_out.extend(self.left_out.iter().cloned());
    }

    /// What a record states of these options.
    pub fn recorded(options: &FitOptions) -> Self {
        Self {
            channels: Some(options.channels),
            model_error: Some(options.model_error),
            left_out: match &options.left_out[..] {
                [] => Vec::new(),
                named => Prior::without(named).left_out().to_vec(),
            },
            ..Self::default()
        }
    }

    /// What of it is shown of a fit, by what it is called there.
    pub fn shown(&self) -> [(&'static str, Option<String>); 3] {
        let yes_no = |channels| match channels {
            Channels::Shared => "yes".to_owned(),
            Channels::Separate => "no".to_owned(),
        };
        [
            ("Same weights for all channels", self.channels.map(yes_no)),
            (
                "Relative model error allowed for",
                self.model_error.map(|error| error.to_string()),
            ),
            (
                "Materials left out of the prior",
                (!self.left_out.is_empty()).then(|| self.left_out.join(", ")),
            ),
        ]
    }

    /// The dictionary's name or file.
    pub fn dictionary(&self) -> &str {
        self.dictionary.as_deref().unwrap_or(Dictionary::DEFAULT)
    }

    /// The seed of the paths.
    pub fn seed(&self) -> u64 {
        self.seed.unwrap_or(CacheOptions::default().seed)
    }
}

fn named<T, const N: usize>(choices: [Choice<T>; N]) -> [(&'static str, T); N] {
    choices.map(|(name, value, _)| (name, value))
}

/// Replaces `value` where something else was chosen.
pub fn set<T: Clone>(value: &mut T, chosen: &Option<T>) {
    if let Some(chosen) = chosen {
        value.clone_from(chosen);
    }
}

/// Channels as records state them.
mod shared_weights {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    use crate::inverse::Channels;

    pub fn serialize<S: Serializer>(value: &Option<Channels>, to: S) -> Result<S::Ok, S::Error> {
        value.map(|value| value == Channels::Shared).serialize(to)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Channels>, D::Error> {
        let shared = Option::<bool>::deserialize(from)?;
        Ok(shared.map(channels))
    }

    pub fn channels(shared: bool) -> Channels {
        match shared {
            true => Channels::Shared,
            false => Channels::Separate,
        }
    }
}

#[cfg(all(test, feature = "clap"))]
mod tests;
