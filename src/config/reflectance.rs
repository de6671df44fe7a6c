//! How a file names a BRDF.

use std::path::PathBuf;

use super::ConfigError;
use super::reader::Section;
use crate::brdf::Atom;

/// A BRDF as a file gives it.
#[derive(Clone, Debug, PartialEq)]
pub enum BrdfSpec {
    /// A weighted sum of closed forms; per channel the weights sum to 1.
    Mixture(Vec<WeightedAtom>),
    /// A dictionary by name or file, with a table of weights.
    Dictionary {
        /// `paper42`, `grid42`, or a dictionary file.
        name: String,
        /// `weights.csv`, as a fit leaves it.
        weights: PathBuf,
    },
    /// A measured table: MERL (`.binary`) or RGL (`.bsdf`).
    Table(PathBuf),
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
        let dictionary = table.text("dictionary")?.optional();
        let file = table.path("table")?.optional();
        let spec = match (mixture, dictionary, file) {
            (Some(atoms), None, None) => {
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
            (None, Some(name), None) => Self::Dictionary {
                name,
                weights: table.path("weights")?.required()?,
            },
            (None, None, Some(path)) => Self::Table(path),
            (None, None, None) => {
                return Err(table.missing("mixture", "a list of atoms, or `dictionary` or `table`"));
            }
            _ => {
                let many = "beside `dictionary` or `table`";
                return Err(table.conflict("mixture", many, "one of the three alone"));
            }
        };
        table.finish()?;
        Ok(spec)
    }
}

impl WeightedAtom {
    fn read(mut table: Section) -> Result<Self, ConfigError> {
        let weight = table.channels("weight", 0.0..=1.0)?.required()?;
        let lambertian = table.section("lambertian")?.optional();
        let ggx = table.section("ggx")?.optional();
        let black = table.section("black")?.optional();
        let atom = match (lambertian, ggx, black) {
            (Some(mut inner), None, None) => {
                let albedo = inner.number("albedo", 0.0..=1.0)?.required()?;
                inner.finish()?;
                Atom::Lambertian { albedo }
            }
            (None, Some(mut inner), None) => {
                let atom = Atom::Ggx {
                    alpha: inner.number("alpha", 1e-3..=1.0)?.required()?,
                    eta: inner.number("eta", 1.01..=100.0)?.required()?,
                };
                inner.finish()?;
                atom
            }
            (None, None, Some(inner)) => {
                inner.finish()?;
                Atom::Black
            }
            _ => {
                return Err(table.missing("lambertian", "the only one of lambertian, ggx, black"));
            }
        };
        table.finish()?;
        Ok(Self { weight, atom })
    }
}
