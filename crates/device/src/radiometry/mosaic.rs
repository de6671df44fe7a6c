//! Colour filter arrays: which colour a sensor pixel sees.

use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// The order of colour filters over the sensor, by its first two pixels of the first two rows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[allow(missing_docs)]
pub enum Mosaic {
    /// A monochrome sensor.
    #[default]
    None,
    Rggb,
    Grbg,
    Gbrg,
    Bggr,
}

impl FromStr for Mosaic {
    type Err = &'static str;

    /// `none`, or the letters of the first cell.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        [Self::None, Self::Rggb, Self::Grbg, Self::Gbrg, Self::Bggr]
            .into_iter()
            .find(|mosaic| mosaic.name() == text)
            .ok_or("none, rggb, grbg, gbrg or bggr")
    }
}

impl std::fmt::Display for Mosaic {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

impl Mosaic {
    /// As it is read: `none`, or the letters of the first cell.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Rggb => "rggb",
            Self::Grbg => "grbg",
            Self::Gbrg => "gbrg",
            Self::Bggr => "bggr",
        }
    }

    /// Channel (0 red, 1 green, 2 blue) of a sensor pixel; `None` on a
    /// monochrome sensor.
    pub fn channel(self, x: usize, y: usize) -> Option<usize> {
        let cell = match self {
            Self::None => return None,
            Self::Rggb => [0, 1, 1, 2],
            Self::Grbg => [1, 0, 2, 1],
            Self::Gbrg => [1, 2, 0, 1],
            Self::Bggr => [2, 1, 1, 0],
        };
        Some(cell[(y % 2) * 2 + x % 2])
    }

    /// How many colours the sensor sees: 1 or 3.
    pub fn colours(self) -> usize {
        if self == Self::None { 1 } else { 3 }
    }

    /// Distance in pixels to the next pixel of the same position in the cell.
    pub fn period(self) -> usize {
        if self == Self::None { 1 } else { 2 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_spell_the_first_cell() {
        for (mosaic, name) in [
            (Mosaic::Rggb, "rggb"),
            (Mosaic::Grbg, "grbg"),
            (Mosaic::Gbrg, "gbrg"),
            (Mosaic::Bggr, "bggr"),
        ] {
            let spelled: String = [(0, 0), (1, 0), (0, 1), (1, 1)]
                .iter()
                .map(|&(x, y)| ['r', 'g', 'b'][mosaic.channel(x, y).unwrap()])
                .collect();
            assert_eq!(spelled, name);
            assert_eq!((mosaic.name(), name.parse()), (name, Ok(mosaic)));
        }
        assert_eq!(Mosaic::None.channel(3, 5), None);
    }
}
