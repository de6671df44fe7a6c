//! Which light directions a capture shall have.

use std::path::Path;
use std::str::FromStr;

use super::light_choice::CANDIDATES;
use crate::outside_file;
use crate::session::Until;
use crate::units::StageAngles;

/// Most lights that can be asked for.
pub const MOST_LIGHTS: usize = 100_000;

/// Which light directions are wanted. As a text: a number, `all`, or `best:N`.
#[derive(Clone, Debug, PartialEq)]
pub enum Lights {
    /// This many, spread evenly.
    Count(usize),
    /// All that keep [`ALL_SPACING_DEG`](super::prepare::ALL_SPACING_DEG) between them.
    All,
    /// This many, 1 to [`CANDIDATES`]: those that are most informative about a material
    /// of which nothing is known.
    Best(usize),
    /// These, in this order.
    Listed(Vec<StageAngles>),
}

impl FromStr for Lights {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "all" {
            return Ok(Self::All);
        }
        if let Some(count) = text.strip_prefix("best:") {
            return match count.parse() {
                Ok(count) if (1..=CANDIDATES).contains(&count) => Ok(Self::Best(count)),
                _ => Err(format!("best:N takes a number N from 1 to {CANDIDATES}")),
            };
        }
        match text.parse() {
            Ok(count @ 1..=MOST_LIGHTS) => Ok(Self::Count(count)),
            _ => Err(format!(
                "a number from 1 to {MOST_LIGHTS}, all, or best:N with N from 1 to {CANDIDATES}"
            )),
        }
    }
}

/// Lights at most of a capture that chooses them, where nothing else is asked for.
pub const MOST_CHOSEN: u32 = 12;

/// An expected error that is enough, as `5%` or `5`.
///
/// # Errors
/// What is expected instead.
pub fn until(text: &str) -> Result<Until, String> {
    let percent = text.strip_suffix('%').unwrap_or(text).trim().parse();
    match percent {
        Ok(percent) if (0.1..=100.0).contains(&percent) => Ok(Until {
            error: percent / 100.0,
            max_lights: MOST_CHOSEN,
            within_s: None,
        }),
        _ => Err("a percentage from 0.1 to 100, e.g. 5%".to_owned()),
    }
}

/// Lights at most of a capture that chooses them, 1 to 60.
///
/// # Errors
/// What is expected instead.
pub fn most_chosen(text: &str) -> Result<u32, String> {
    match text.parse() {
        Ok(most @ 1..=60) => Ok(most),
        _ => Err("a number from 1 to 60".to_owned()),
    }
}

/// Largest file of directions, bytes.
const MAX_BYTES: u64 = 1 << 24;

/// As [`Lights::from_str`], or the name of a file with one direction a line; what follows a # is a
/// remark.
///
/// # Errors
/// What is expected instead, or the file's line.
pub fn lights_or_file(text: &str) -> Result<Lights, String> {
    let path = Path::new(text);
    if !path.is_file() {
        let stated = text.parse::<Lights>();
        return stated.map_err(|fact| format!("{fact}, or a file with AZ,EL in each line"));
    }
    let content = outside_file::read_text(path, MAX_BYTES).map_err(|error| error.to_string())?;
    let lines = content.lines().enumerate();
    let stated = lines.map(|(k, line)| (k + 1, line.split('#').next().unwrap_or("").trim()));
    let listed = stated
        .filter(|(_, line)| !line.is_empty())
        .map(|(number, line)| {
            direction(line)
                .map_err(|expected| format!("line {number}: \"{line}\" is not {expected}"))
        });
    let listed = listed.collect::<Result<Vec<_>, _>>()?;
    match listed.len() {
        1..=MOST_LIGHTS => Ok(Lights::Listed(listed)),
        count => Err(format!(
            "{count} directions, allowed are 1 to {MOST_LIGHTS}"
        )),
    }
}

/// One light direction: `AZ,EL` in degrees.
///
/// # Errors
/// What is expected instead.
pub fn direction(text: &str) -> Result<StageAngles, String> {
    let parsed = text.split_once(',').and_then(|(azimuth, elevation)| {
        let number = |text: &str| text.trim().parse().ok().filter(|x: &f64| x.is_finite());
        Some((number(azimuth)?, number(elevation)?))
    });
    let (azimuth_deg, elevation_deg) =
        parsed.ok_or("two numbers in degrees with a comma between, e.g. 40,35")?;
    Ok(StageAngles::new(azimuth_deg, elevation_deg))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lights_are_a_number_or_all_or_the_best() {
        assert_eq!("4".parse(), Ok(Lights::Count(4)));
        assert_eq!("all".parse(), Ok(Lights::All));
        assert_eq!("best:6".parse(), Ok(Lights::Best(6)));
        for bad in ["0", "-1", "four", "1.5", "", "1000000", "best", "Best:3"] {
            assert!(bad.parse::<Lights>().is_err(), "{bad}");
        }
        for bad in ["best:0", "best:x", "best:1000"] {
            let error = bad.parse::<Lights>().unwrap_err();
            assert!(error.contains("from 1 to"), "{bad}: {error}");
        }
    }

    #[test]
    fn enough_is_a_percentage() {
        assert_eq!(until("5%").unwrap().error, 0.05);
        assert_eq!(until("2.5").unwrap().error, 0.025);
        for bad in ["", "0", "%", "101%", "nan", "5 %%"] {
            assert!(until(bad).is_err(), "{bad}");
        }
        assert_eq!(most_chosen("60"), Ok(60));
        for bad in ["0", "61", ""] {
            assert!(most_chosen(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn a_file_lists_directions() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let name = file.path().to_str().unwrap();
        std::fs::write(name, "# azimuth, elevation\n\n-40, 35.5  # first\n90,15\n").unwrap();
        let listed = [[-40.0, 35.5], [90.0, 15.0]].map(|[a, e]| StageAngles::new(a, e));
        assert_eq!(lights_or_file(name), Ok(Lights::Listed(listed.to_vec())));
        assert_eq!(lights_or_file("best:3"), Ok(Lights::Best(3)));
        for (bad, expected) in [("1,2\n3\n", "line 2: \"3\""), ("# none\n", "0 directions")] {
            std::fs::write(name, bad).unwrap();
            let error = lights_or_file(name).unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn a_direction_is_two_numbers() {
        assert!(direction("-40, 35.5").is_ok());
        for bad in ["40", "a,b", "nan,1", "1,2,3", ""] {
            assert!(direction(bad).is_err(), "{bad}");
        }
    }
}
