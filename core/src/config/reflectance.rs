//! How a file names a BRDF.

use std::path::PathBuf;

use super::ConfigError;
use super::reader::Section;
use crate::brdf::{Atom, Dictionary};

/// A BRDF as a file gives it.
#[derive(Clone, Debug, PartialEq)]
pub enum BrdfSpec {
    /// A weighted sum of closed forms; per channel the weights sum to 1.
    Mixture(Vec<WeightedAtom>),
    /// A dictionary by name or file, with a table of weights.
    Dictionary {
        /// One of [`Dictionary::NAMES`], or a dictionary file.
        dictionary: PathBuf,
        /// `weights.csv`, as a fit leaves it; what departs from it is not read.
        weights: PathBuf,
    },
    /// A measured table: MERL (`.binary`) or RGL (`.bsdf`).
    Table(PathBuf),
    /// The folder of a fit, as `rig fit` leaves it.
    Fit(PathBuf),
}

/// A closed form and how much of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WeightedAtom {
    /// Share per channel, 0 to 1.
    pub weight: [f64; 3],
    /// The closed form.
    pub atom: Atom,
}

/// How far per-channel weights may sum away from 1.
const WEIGHT_SUM_TOLERANCE: f64 = 1e-6;

impl BrdfSpec {
    /// Reads the `[brdf]` table.
    pub fn read(mut table: Section) -> Result<Self, ConfigError> {
        let mixture = table.sections("mixture")?.optional();
        let dictionary = table
            .name_or_path("dictionary", &Dictionary::NAMES)?
            .optional();
        let file = table.path("table")?.optional();
        let fit = table.path("fit")?.optional();
        let spec = match (mixture, dictionary, file, fit) {
            (Some(atoms), None, None, None) => {
                let atoms: Vec<_> = atoms
                    .into_iter()
                    .map(WeightedAtom::read)
                    .collect::<Result<_, _>>()?;
                for channel in 0..3 {
                    let sum: f64 = atoms.iter().map(|atom| atom.weight[channel]).sum();
                    if (sum - 1.0).abs() > WEIGHT_SUM_TOLERANCE {
                        let sums = format!("a mixture whose weights sum to {sum:.6}");
                        return Err(table.conflict("mixture", sums, "one whose weights sum to 1"));
                    }
                }
                Self::Mixture(atoms)
            }
            (None, Some(dictionary), None, None) => Self::Dictionary {
                dictionary,
                weights: table.path("weights")?.required()?,
            },
            (None, None, Some(path), None) => Self::Table(path),
            (None, None, None, Some(folder)) => Self::Fit(folder),
            (None, None, None, None) => {
                let needed = "a list of atoms, or `dictionary`, `table` or `fit`";
                return Err(table.missing("mixture", needed));
            }
            _ => {
                let many = "not alone";
                let one = "one of `mixture`, `dictionary`, `table` and `fit`";
                return Err(table.conflict("mixture", many, one));
            }
        };
        table.finish()?;
        Ok(spec)
    }
}

impl WeightedAtom {
    const KINDS: [&str; 5] = ["lambertian", "ggx", "beckmann", "coated", "black"];

    fn read(mut table: Section) -> Result<Self, ConfigError> {
        let weight = table.channels("weight", 0.0..=1.0)?.required()?;
        let mut given = Vec::new();
        for kind in Self::KINDS {
            if let Some(inner) = table.section(kind)?.optional() {
                given.push((kind, inner));
            }
        }
        let [(kind, mut inner)] = <[_; 1]>::try_from(given).map_err(|_| {
            let only = format!("the only one of {}", Self::KINDS.join(", "));
            table.missing("lambertian", &only)
        })?;
        let is_lobe = matches!(kind, "ggx" | "beckmann");
        let mut number = |wanted: bool, key, range| match wanted {
            true => inner.number(key, range)?.required().map(Some),
            false => Ok(None),
        };
        let alpha = number(is_lobe, "alpha", 1e-3..=1.0)?;
        let eta = number(is_lobe || kind == "coated", "eta", 1.01..=100.0)?;
        let albedo = number(kind == "lambertian", "albedo", 0.0..=1.0)?;
        inner.finish()?;
        let Some(atom) = Atom::from_parts(kind, alpha, eta, albedo) else {
            unreachable!("a kind of the list, with its parameters");
        };
        table.finish()?;
        Ok(Self { weight, atom })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(atom: &str) -> Result<BrdfSpec, String> {
        let text = format!("mixture = [{{ weight = [1.0, 1.0, 1.0], {atom} }}]");
        Section::parse("scene.toml", std::path::Path::new(""), &text)
            .and_then(BrdfSpec::read)
            .map_err(|error| error.to_string())
    }

    #[test]
    fn every_kind_of_atom_is_read() {
        let (alpha, eta) = (0.2, 1.5);
        for (text, atom) in [
            ("ggx = { alpha = 0.2, eta = 1.5 }", Atom::Ggx { alpha, eta }),
            (
                "beckmann = { alpha = 0.2, eta = 1.5 }",
                Atom::Beckmann { alpha, eta },
            ),
            ("coated = { eta = 1.5 }", Atom::Coated { eta }),
            (
                "lambertian = { albedo = 0.3 }",
                Atom::Lambertian { albedo: 0.3 },
            ),
            ("black = {}", Atom::Black),
        ] {
            let weight = [1.0; 3];
            let spec = BrdfSpec::Mixture(vec![WeightedAtom { weight, atom }]);
            assert_eq!(read(text).unwrap(), spec);
        }
    }

    #[test]
    fn a_wrong_atom_is_named() {
        for (text, said) in [
            ("coated = { alpha = 0.2, eta = 1.5 }", "alpha"),
            ("beckmann = { alpha = 0.2 }", "beckmann.eta"),
            ("beckmann = { alpha = 2, eta = 1.5 }", "beckmann.alpha"),
            ("black = {}, coated = { eta = 1.5 }", "the only one of"),
        ] {
            let error = read(text).unwrap_err();
            assert!(error.contains(said), "{text}: {error}");
        }
    }
}
