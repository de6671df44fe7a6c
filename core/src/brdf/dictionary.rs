//! The BRDF dictionary: a fixed list of simple BRDFs (atoms) whose convex
//! mixtures describe a material.

use std::path::Path;

use glam::Vec3;
use serde::Deserialize;

use super::BrdfError;
pub use super::atom::Atom;
use super::evaluator::Evaluator;
pub use super::evaluator::MAX_ATOMS;
use super::ggx::Cosines;
use super::half_difference::HalfDifference;
use crate::outside_file::ends_in;
use crate::shown::{MESSAGE, shortened};

/// A named list of atoms, each with parameters in range.
///
/// ```
/// use rig_core::brdf::{Atom, Dictionary};
///
/// let usual = Dictionary::load(Dictionary::DEFAULT)?;
/// assert_eq!((usual.name(), usual.len()), ("rig65", 65));
///
/// let own = "atoms = [{ type = 'ggx', alpha = 0.1, eta = 1.5 }, { type = 'black' }]";
/// let own = Dictionary::parse("own", own, false)?;
/// assert_eq!(own.atoms()[0], Atom::Ggx { alpha: 0.1, eta: 1.5 });
///
/// // Rougher than any surface: refused.
/// assert!(Dictionary::new("bad", vec![Atom::Ggx { alpha: 2.0, eta: 1.5 }]).is_err());
/// # Ok::<(), rig_core::brdf::BrdfError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Dictionary {
    name: String,
    atoms: Vec<Atom>,
    /// See [`Self::first_part`].
    averaged_with_first: Option<usize>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct DictionaryFile {
    name: Option<String>,
    #[allow(dead_code, reason = "a note for the reader of the file")]
    source: Option<String>,
    averaged_with_first: Option<usize>,
    atoms: Vec<Atom>,
}

impl Dictionary {
    /// From atoms, at least one and at most [`MAX_ATOMS`]; parameters out of range
    /// are refused. A Lambertian atom of albedo 0 becomes [`Atom::Black`].
    pub fn new(name: impl Into<String>, atoms: Vec<Atom>) -> Result<Self, BrdfError> {
        let name = name.into();
        let refuse = |fact: String| BrdfError::Dictionary {
            name: name.clone(),
            fact,
        };
        if atoms.is_empty() || atoms.len() > MAX_ATOMS {
            return Err(refuse(format!(
                "{} atoms, allowed are 1 to {MAX_ATOMS}",
                atoms.len()
            )));
        }
        let mut checked = Vec::with_capacity(atoms.len());
        for (index, atom) in atoms.into_iter().enumerate() {
            let outside = |value: Option<f64>, low: f64, high: f64| {
                value.filter(|v| !(low..=high).contains(v))
            };
            let (key, value, low, high) = if let Some(alpha) = outside(atom.alpha(), 1e-3, 1.0) {
                ("alpha", alpha, 1e-3, 1.0)
            } else if let Some(eta) = outside(atom.eta(), 1.01, 100.0) {
                ("eta", eta, 1.01, 100.0)
            } else if let Some(albedo) = outside(atom.albedo(), 0.0, 1.0) {
                ("albedo", albedo, 0.0, 1.0)
            } else {
                checked.push(match atom {
                    Atom::Lambertian { albedo: 0.0 } => Atom::Black,
                    valid => valid,
                });
                continue;
            };
            return Err(refuse(format!(
                "atom {index} has {key} {value}, allowed is {low} to {high}"
            )));
        }
        Ok(Self {
            name,
            atoms: checked,
            averaged_with_first: None,
        })
    }

    /// The same, of whose first `count` atoms fits make a second estimate ([`Self::first_part`]);
    /// `count` is 1 to one less than all.
    pub fn averaged_with_first(self, count: usize) -> Result<Self, BrdfError> {
        if !(1..self.len()).contains(&count) {
            return Err(BrdfError::Dictionary {
                fact: format!(
                    "averaged_with_first is {count}, allowed is 1 to {}",
                    self.len() - 1
                ),
                name: self.name,
            });
        }
        Ok(Self {
            averaged_with_first: Some(count),
            ..self
        })
    }

    /// The first atoms as a dictionary of their own, where fits are to estimate the material by
    /// these alone as well and average both estimates (docs/adr/0039).
    pub fn first_part(&self) -> Option<Self> {
        let count = self.averaged_with_first?;
        Some(Self {
            name: format!("the first {count} of {}", self.name),
            atoms: self.atoms[..count].to_vec(),
            averaged_with_first: None,
        })
    }

    /// The dictionary published by the paper's authors: 40 GGX atoms, white
    /// Lambertian, black. (0.01, 10) stands twice there and here: see
    /// [`Self::duplicate_of`].
    pub fn paper42() -> Self {
        Self::embedded(
            "paper42",
            include_str!("../../data/dictionaries/paper42.json"),
        )
    }

    /// GGX and Beckmann lobes, coated and plain white, black: 26 atoms that explain
    /// measured materials better than any of the 42 (docs/adr/0013).
    pub fn rig26() -> Self {
        Self::embedded("rig26", include_str!("../../data/dictionaries/rig26.json"))
    }

    /// All atoms of paper42 and of rig26, the former also on their own: the average of both
    /// estimates is better than either dictionary's, with one light and with four
    /// (docs/adr/0039).
    pub fn rig65() -> Self {
        Self::embedded("rig65", include_str!("../../data/dictionaries/rig65.json"))
    }

    /// What fits use by default. Experiments that repeat the paper's use paper42.
    pub const DEFAULT: &'static str = "rig65";

    /// The dictionaries that [`Self::load`] knows by name.
    pub const NAMES: [&'static str; 3] = ["rig65", "rig26", "paper42"];

    /// By one of [`Self::NAMES`], or from a `.json` or `.toml` file with a list
    /// `atoms` of `{type = "ggx", alpha, eta}`, `{type = "beckmann", alpha, eta}`,
    /// `{type = "coated", eta}`, `{type = "lambertian", albedo}` or `{type = "black"}`,
    /// and optionally `name`, `source` and `averaged_with_first` ([`Self::first_part`]).
    pub fn load(name_or_path: &str) -> Result<Self, BrdfError> {
        match name_or_path {
            "paper42" => Ok(Self::paper42()),
            "rig26" => Ok(Self::rig26()),
            "rig65" => Ok(Self::rig65()),
            path => Self::read(Path::new(path)),
        }
    }

    fn read(path: &Path) -> Result<Self, BrdfError> {
        let is_json = ends_in(path, "json");
        if !is_json && !ends_in(path, "toml") {
            return Err(BrdfError::UnknownSource {
                spec: path.display().to_string(),
                known: format!("{}, a .json or .toml file", Self::NAMES.join(", ")),
            });
        }
        let text =
            crate::outside_file::read_text(path, super::LARGEST_TEXT_BYTES).map_err(|source| {
                BrdfError::Io {
                    path: path.into(),
                    source,
                }
            })?;
        let stem = path.file_stem().and_then(|s| s.to_str()).unwrap_or("file");
        Self::parse(stem, &text, is_json).map_err(|fact| match fact {
            BrdfError::Dictionary { fact, .. } => BrdfError::File {
                path: path.into(),
                fact,
            },
            other => other,
        })
    }

    /// From the text of a dictionary file, JSON or TOML; as [`Self::load`] says.
    ///
    /// # Errors
    /// Syntax, or atoms out of range.
    pub fn parse(default_name: &str, text: &str, json: bool) -> Result<Self, BrdfError> {
        let parsed: Result<DictionaryFile, String> = if json {
            serde_json::from_str(text).map_err(|e| e.to_string())
        } else {
            toml::from_str(text).map_err(|e| e.message().to_owned())
        };
        let file = parsed.map_err(|fact| BrdfError::Dictionary {
            name: default_name.to_owned(),
            fact: shortened(&fact, MESSAGE).into_owned(),
        })?;
        let dictionary = Self::new(file.name.as_deref().unwrap_or(default_name), file.atoms)?;
        match file.averaged_with_first {
            Some(count) => dictionary.averaged_with_first(count),
            None => Ok(dictionary),
        }
    }

    fn embedded(name: &str, json: &str) -> Self {
        Self::parse(name, json, true).expect("an embedded dictionary is valid (tested)")
    }

    /// Every atom's f at half and difference angles (degrees) and φd = 90°, 1/sr.
    pub fn values_at(&self, theta_h_deg: f64, theta_d_deg: f64) -> Vec<f64> {
        self.values_of(HalfDifference {
            theta_h_rad: theta_h_deg.to_radians(),
            theta_d_rad: theta_d_deg.to_radians(),
            phi_d_rad: std::f64::consts::FRAC_PI_2,
        })
    }

    /// f_r of all atoms, 1/sr; 0 where either direction is below the horizon.
    pub fn values_of(&self, angles: HalfDifference) -> Vec<f64> {
        let (to_light, to_viewer) = angles.to_directions();
        match Cosines::new(to_light.to_array(), to_viewer.to_array()) {
            Some(at) => self.atoms.iter().map(|atom| atom.eval(&at)).collect(),
            None => vec![0.0; self.atoms.len()],
        }
    }

    /// What tables and files call it.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The atoms in order; weights are indexed alike.
    pub fn atoms(&self) -> &[Atom] {
        &self.atoms
    }

    /// Number of atoms.
    pub fn len(&self) -> usize {
        self.atoms.len()
    }

    /// Never true; for the convention that goes with [`Self::len`].
    pub fn is_empty(&self) -> bool {
        self.atoms.is_empty()
    }

    /// Per atom, the index of an earlier equal atom: such an atom adds nothing,
    /// and a fit may keep its weight at zero.
    pub fn duplicate_of(&self) -> Vec<Option<usize>> {
        (0..self.len())
            .map(|i| (0..i).find(|&j| self.atoms[j] == self.atoms[i]))
            .collect()
    }

    /// f_r of every atom, 1/sr, zero if either direction is not above the horizon.
    pub fn eval(&self, to_light: Vec3, to_viewer: Vec3) -> Vec<f32> {
        let mut values = vec![0.0; self.len()];
        if let Some(at) = Cosines::new(to_light.to_array(), to_viewer.to_array()) {
            self.evaluator().eval(&at, &mut values);
        }
        values
    }

    /// For evaluating all atoms at many pairs of directions.
    pub fn evaluator(&self) -> Evaluator {
        Evaluator::new(self.atoms.iter())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_published_dictionary_has_one_pair_twice() {
        let paper = Dictionary::paper42();
        assert_eq!(paper.len(), 42);
        assert_eq!(paper.atoms()[40], Atom::Lambertian { albedo: 1.0 });
        assert_eq!(paper.atoms()[41], Atom::Black);
        let duplicates: Vec<_> = paper
            .duplicate_of()
            .into_iter()
            .enumerate()
            .filter_map(|(i, j)| j.map(|j| (i, j)))
            .collect();
        assert_eq!(duplicates, [(33, 0)]);
    }

    #[test]
    fn the_default_dictionary_has_no_atom_twice() {
        let ours = Dictionary::load(Dictionary::DEFAULT).unwrap();
        assert_eq!(ours, Dictionary::rig65());
        // But for the pair that the paper's has.
        let twice = ours.duplicate_of().iter().flatten().count();
        assert_eq!(twice, 1);
        let rig26 = Dictionary::rig26();
        assert!(rig26.duplicate_of().iter().all(Option::is_none));
    }

    #[test]
    fn the_default_holds_both_others_and_averages_with_the_papers() {
        let all = Dictionary::rig65();
        let [paper, ours] = [Dictionary::paper42(), Dictionary::rig26()];
        let part = all.first_part().unwrap();
        assert_eq!(part.atoms(), paper.atoms());
        assert!(part.first_part().is_none());
        assert!(ours.atoms().iter().all(|atom| all.atoms().contains(atom)));
        assert!(all.len() == 65 && all.len() < paper.len() + ours.len());
        for count in [0, 65] {
            let refused = Dictionary::rig65().averaged_with_first(count).unwrap_err();
            assert!(refused.to_string().contains("1 to 64"), "{refused}");
        }
    }

    #[test]
    fn the_evaluator_is_the_atoms() {
        let at = Cosines::new([0.6, 0.0, 0.8], [-0.48, 0.36, 0.8f32]).unwrap();
        for dictionary in [Dictionary::paper42(), Dictionary::rig26()] {
            let mut values = vec![f32::NAN; dictionary.len()];
            dictionary.evaluator().eval(&at, &mut values);
            for (value, atom) in values.iter().zip(dictionary.atoms()) {
                let single = atom.eval(&at);
                assert!((value - single).abs() <= 1e-6 * single, "{atom:?}");
            }
        }
    }

    #[test]
    fn files_are_checked() {
        let toml = "atoms = [{ type = \"ggx\", alpha = 0.1, eta = 1.5 }, { type = \"black\" }]";
        assert_eq!(Dictionary::parse("two", toml, false).unwrap().len(), 2);
        for (bad, said) in [
            ("atoms = []", "0 atoms"),
            (
                "atoms = [{ type = \"ggx\", alpha = 2.0, eta = 1.5 }]",
                "alpha 2",
            ),
            (
                "atoms = [{ type = \"ggx\", alpha = 0.2, eta = 0.5 }]",
                "eta 0.5",
            ),
            (
                "atoms = [{ type = \"ggx\", alpha = nan, eta = 1.5 }]",
                "alpha NaN",
            ),
            ("atoms = [{ type = \"coated\", eta = 1.0 }]", "eta 1,"),
            (
                "atoms = [{ type = \"lambertian\", albedo = 1.5 }]",
                "albedo 1.5",
            ),
            ("atoms = [{ type = \"mirror\" }]", "mirror"),
            ("atom = []", "atom"),
        ] {
            let error = Dictionary::parse("bad", bad, false)
                .unwrap_err()
                .to_string();
            assert!(error.contains(said), "{bad}: {error}");
        }
    }
}
