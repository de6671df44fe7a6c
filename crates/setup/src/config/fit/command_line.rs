//! The options of a fit on the command line: parsers of their values, help with ranges and
//! defaults.

use std::fmt::Display;
use std::ops::RangeInclusive;

use clap::builder::{BoolValueParser, PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::value_parser;

use super::{CELLS, Choice, FitRequest};
use crate::brdf::Dictionary;
use crate::cells::DEFAULT_CELLS;
use crate::inverse::Channels;
use crate::transport::CacheOptions;

impl FitRequest {
    /// The words that give `rig fit` the option of this key; `None` if it has no such option,
    /// or one that is said or not, and the value is neither `true` nor `false`.
    pub fn words(key: &str, value: &str) -> Option<Vec<String>> {
        let command = <Self as clap::Args>::augment_args(clap::Command::new("fit"));
        let option = command
            .get_arguments()
            .find(|option| option.get_id() == key)?;
        let name = option.get_long()?;
        // A value stands behind `=` and is never read as an option.
        match (option.get_action().takes_values(), value) {
            (true, value) => Some(vec![format!("--{name}={value}")]),
            (false, "true") => Some(vec![format!("--{name}")]),
            (false, "false") => Some(Vec::new()),
            (false, _) => None,
        }
    }
}

/// One of the names.
pub(super) fn choice<T, const N: usize>(choices: [Choice<T>; N]) -> impl TypedValueParser<Value = T>
where
    T: Clone + Send + Sync + 'static,
{
    let shown = |(name, _, what): &Choice<T>| PossibleValue::new(*name).help(*what);
    PossibleValuesParser::new(choices.each_ref().map(shown)).try_map(move |name| {
        let chosen = choices.iter().find(|(known, ..)| *known == name);
        chosen.map(|(_, value, _)| value.clone()).ok_or("unknown")
    })
}

/// An integer of 32 bits.
pub(super) fn count(range: RangeInclusive<u64>) -> impl TypedValueParser<Value = u32> {
    value_parser!(u32).range(*range.start() as i64..=*range.end() as i64)
}

/// A number of things in memory.
pub(super) fn size(range: RangeInclusive<u64>) -> impl TypedValueParser<Value = usize> {
    value_parser!(u64).range(range).map(|size| size as usize)
}

/// A real number.
pub(super) fn number(
    range: RangeInclusive<f64>,
) -> impl Fn(&str) -> Result<f64, String> + Clone + Send + Sync + 'static {
    move |text| match text.parse() {
        Err(_) => Err("not a number".to_owned()),
        Ok(value) if range.contains(&value) => Ok(value),
        Ok(_) => Err(format!("not in {}", span(&range))),
    }
}

/// `--shared-weights`.
pub(super) fn shared() -> impl TypedValueParser<Value = Option<Channels>> {
    BoolValueParser::new().map(|shared| shared.then_some(Channels::Shared))
}

/// Help with the range.
pub(super) fn within(what: &str, range: RangeInclusive<impl Display>) -> String {
    format!("{what}, {}", span(&range))
}

/// Help with range and default.
pub(super) fn within_or(
    what: &str,
    range: RangeInclusive<impl Display>,
    default: impl Display,
) -> String {
    format!("{what}, {} (default {default})", span(&range))
}

fn span(range: &RangeInclusive<impl Display>) -> String {
    format!("{} to {}", range.start(), range.end())
}

pub(super) fn dictionary() -> String {
    let others = Dictionary::NAMES
        .iter()
        .filter(|name| **name != Dictionary::DEFAULT);
    let others: Vec<&str> = others.copied().collect();
    format!(
        "{} (the default), {}, or a dictionary file",
        Dictionary::DEFAULT,
        others.join(", ")
    )
}

pub(super) fn cells() -> String {
    let what = within_or(
        "Most cells of the images that are compared",
        CELLS,
        DEFAULT_CELLS,
    );
    format!(
        "{what}: squares of pixels, single ones where a highlight can be and large ones where the scene is smooth"
    )
}

pub(super) fn memory() -> String {
    let default_mib = CacheOptions::default().max_bytes >> 20;
    format!(
        "Memory that the whole fit may take, MiB: fewer paths are traced if it does not suffice, and a fit that is too large for it is refused. By default, what the cells need and {default_mib} MiB for paths, as far as the machine has them free"
    )
}
