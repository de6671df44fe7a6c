//! Which light directions a capture shall have.

use std::str::FromStr;

use super::light_choice::CANDIDATES;
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
    fn a_direction_is_two_numbers() {
        assert!(direction("-40, 35.5").is_ok());
        for bad in ["40", "a,b", "nan,1", "1,2,3", ""] {
            assert!(direction(bad).is_err(), "{bad}");
        }
    }
}
