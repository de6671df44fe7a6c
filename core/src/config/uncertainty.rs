//! The `[uncertainty]` table of rig and scene files: how well the rest of the file is
//! known, as standard deviations. A refinement of the bench stays within them.

use std::ops::RangeInclusive;

use super::ConfigError;
use super::reader::Section;
use crate::bench_priors::BenchPriors;

/// A key, what it may be, how many internal units its unit is, and where it goes.
struct Key {
    name: &'static str,
    range: RangeInclusive<f64>,
    unit: f64,
    place: fn(&mut BenchPriors) -> &mut f64,
}

const DEGREE: f64 = std::f64::consts::PI / 180.0;

const fn key(
    name: &'static str,
    most: f64,
    unit: f64,
    place: fn(&mut BenchPriors) -> &mut f64,
) -> Key {
    Key {
        name,
        range: 0.0..=most,
        unit,
        place,
    }
}

const KEYS: [Key; 7] = [
    key("light_deg", 5.0, DEGREE, |priors| &mut priors.light_rad),
    key("stage_deg", 5.0, DEGREE, |priors| &mut priors.stage_rad),
    key("intensity", 0.5, 1.0, |priors| &mut priors.intensity),
    key("common_intensity", 2.0, 1.0, |priors| {
        &mut priors.common_intensity
    }),
    key("rotation_deg", 5.0, DEGREE, |priors| {
        &mut priors.rotation_rad
    }),
    key("translation_mm", 10.0, 1.0, |priors| {
        &mut priors.translation_mm
    }),
    key("stray_light", 1e9, 1.0, |priors| &mut priors.stray_light),
];

/// Reads the table; what it doesn't say is as in [`BenchPriors::default`].
pub fn read(mut table: Section) -> Result<BenchPriors, ConfigError> {
    let mut priors = BenchPriors::default();
    for key in KEYS {
        if let Some(value) = table.number(key.name, key.range)?.optional() {
            *(key.place)(&mut priors) = value * key.unit;
        }
    }
    table.finish()?;
    Ok(priors)
}

/// One deviation that takes precedence over a file's.
#[derive(Clone, Debug, PartialEq)]
pub struct Deviation {
    key: usize,
    value: f64,
}

impl Deviation {
    /// Puts it in its place.
    pub fn apply(&self, priors: &mut BenchPriors) {
        let key = &KEYS[self.key];
        *(key.place)(priors) = self.value * key.unit;
    }
}

impl std::str::FromStr for Deviation {
    type Err = String;

    /// `KEY=VALUE` with a key of the table.
    fn from_str(text: &str) -> Result<Self, String> {
        let (name, value) = text.split_once('=').ok_or("not KEY=VALUE")?;
        let key = KEYS
            .iter()
            .position(|key| key.name == name)
            .ok_or_else(|| {
                format!(
                    "unknown key {name} (known: {})",
                    KEYS.map(|k| k.name).join(", ")
                )
            })?;
        let range = &KEYS[key].range;
        let value: f64 = value
            .parse()
            .map_err(|_| format!("{} is no number", crate::shown::excerpt(value)))?;
        if !range.contains(&value) {
            let (low, high) = (range.start(), range.end());
            return Err(format!(
                "{name} is {value}, but must be from {low} to {high}"
            ));
        }
        Ok(Self { key, value })
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    fn parse(text: &str) -> Result<BenchPriors, ConfigError> {
        read(Section::parse("rig.toml", Path::new(""), text)?)
    }

    #[test]
    fn deviations_come_in_degrees_and_the_rest_has_defaults() {
        let priors = parse("light_deg = 0.5\nintensity = 0.02\nstray_light = 3\n").unwrap();
        let expected = BenchPriors {
            light_rad: 0.5f64.to_radians(),
            intensity: 0.02,
            stray_light: 3.0,
            ..BenchPriors::default()
        };
        assert!((priors.light_rad - expected.light_rad).abs() < 1e-15);
        assert_eq!(priors.intensity, expected.intensity);
        assert_eq!(priors.stray_light, expected.stray_light);
        assert_eq!(priors.rotation_rad, expected.rotation_rad);
        assert_eq!(parse("").unwrap(), BenchPriors::default());
    }

    #[test]
    fn bad_deviations_are_refused_with_the_place() {
        for (bad, said) in [
            (
                "light_deg = 6",
                "rig.toml:1: `light_deg` is 6, but must be a number from 0 to 5",
            ),
            ("light_dgs = 1", "rig.toml:1: unknown key `light_dgs`"),
        ] {
            let error = parse(bad).unwrap_err().to_string();
            assert!(error.contains(said), "{error}");
        }
        for (bad, said) in [
            ("intensity", "not KEY=VALUE"),
            ("weight=1", "unknown key weight (known: light_deg,"),
            ("intensity=x", "x is no number"),
            (
                "intensity=0.9",
                "intensity is 0.9, but must be from 0 to 0.5",
            ),
        ] {
            let error = bad.parse::<Deviation>().unwrap_err();
            assert!(error.contains(said), "{error}");
        }
        let mut priors = BenchPriors::default();
        "translation_mm=0.5"
            .parse::<Deviation>()
            .unwrap()
            .apply(&mut priors);
        assert_eq!(priors.translation_mm, 0.5);
    }
}
