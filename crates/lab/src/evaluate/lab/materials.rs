//! The targets of an experiment.

use std::path::Path;
use std::sync::Arc;

use super::{Sample, short_hash, synthetic};
use crate::brdf::nbrdf::NAMES;
use crate::brdf::{Brdf, BrdfError, in_span, source};
use crate::evaluate::error::EvaluateError;
use crate::result_table::Row;

/// Where a material comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Class {
    /// Measured, or a network trained on measurements.
    Measured,
    /// A closed form outside every dictionary, bright enough for strong interreflection.
    Synthetic,
    /// A mixture of the dictionary's own atoms.
    InSpan,
}

impl Class {
    /// As in tables.
    pub fn name(self) -> &'static str {
        match self {
            Class::Measured => "measured",
            Class::Synthetic => "synthetic",
            Class::InSpan => "in-span",
        }
    }
}

/// A target with its name.
pub struct Material {
    /// Without path or prefix, unique among the materials of a run.
    pub name: String,
    /// What settings record: the spec, for files with the first digits of their SHA-256.
    pub identity: String,
    /// Where it comes from.
    pub class: Class,
    /// The reflectance.
    pub brdf: Arc<dyn Brdf>,
    /// Its index among the run's materials.
    pub(super) index: usize,
}

impl Material {
    /// The columns that name a measurement of it from a sample.
    pub fn row(&self, sample: Sample) -> Row {
        Row::new()
            .with("material", self.name.as_str())
            .with("class", self.class.name())
            .with("shape", sample.name())
    }
}

/// Targets that networks describe badly: mirrors far darker than real ones. They are
/// stress cases and named as such, not part of `bundled`.
pub const MIRRORS: [&str; 3] = ["aluminium", "brass", "chrome"];

/// Loads materials; a spec is one of
///
/// | spec | what |
/// |---|---|
/// | `bundled` | all embedded measured materials but [`MIRRORS`] |
/// | `mirrors` | [`MIRRORS`] |
/// | `synthetic` | all of `synthetic` |
/// | `synthetic:NAME` | one of them |
/// | `in-span` | the twenty of [`in_span::set`] |
/// | `in-span:NN` | one of them |
/// | any other | as [`source::load`] reads it: embedded by name, or a file |
///
/// # Errors
/// A spec that nobody reads, two materials of one name, or a file's own.
pub fn load_all(specs: &[String]) -> Result<Vec<Arc<Material>>, EvaluateError> {
    let mut materials: Vec<Arc<Material>> = Vec::new();
    for spec in specs.iter().flat_map(|spec| expand(spec)) {
        let (name, identity, class, brdf) = load(&spec)?;
        if materials.iter().any(|m| m.name == name) {
            return Err(EvaluateError::SameName { name });
        }
        materials.push(Arc::new(Material {
            name,
            identity,
            class,
            brdf,
            index: materials.len(),
        }));
    }
    Ok(materials)
}

/// Specs of this file alone, as a list of what is known shows them.
const GROUPS: [&str; 6] = [
    "bundled",
    "mirrors",
    "synthetic",
    "synthetic:NAME",
    "in-span",
    "in-span:NN",
];

/// Every spec of one embedded material.
pub fn specs() -> Vec<String> {
    let one_by_one = ["bundled", "mirrors", "synthetic", "in-span"];
    one_by_one.iter().flat_map(|group| expand(group)).collect()
}

fn expand(spec: &str) -> Vec<String> {
    let measured = |name: &&str| format!("nbrdf:{name}");
    match spec {
        "bundled" => NAMES
            .iter()
            .filter(|name| !MIRRORS.contains(name))
            .map(measured)
            .collect(),
        "mirrors" => MIRRORS.iter().map(measured).collect(),
        "synthetic" => synthetic::NAMES
            .iter()
            .map(|name| format!("synthetic:{name}"))
            .collect(),
        "in-span" => in_span::set()
            .iter()
            .map(|m| m.name.replacen("in-span-", "in-span:", 1))
            .collect(),
        other => vec![other.to_owned()],
    }
}

type Loaded = (String, String, Class, Arc<dyn Brdf>);

fn load(spec: &str) -> Result<Loaded, EvaluateError> {
    if let Some(name) = spec.strip_prefix("synthetic:") {
        let brdf = synthetic::named(name).ok_or_else(|| EvaluateError::UnknownMaterial {
            spec: spec.to_owned(),
            known: synthetic::NAMES.join(", "),
        })?;
        return Ok((name.into(), spec.into(), Class::Synthetic, Arc::new(brdf)));
    }
    if let Some(number) = spec.strip_prefix("in-span:") {
        let name = format!("in-span-{number}");
        let set = in_span::set();
        let found = set.iter().find(|m| m.name == name);
        let material = found.ok_or_else(|| EvaluateError::UnknownMaterial {
            spec: spec.to_owned(),
            known: format!("in-span:01 to in-span:{:02}", set.len()),
        })?;
        return Ok((
            name,
            spec.into(),
            Class::InSpan,
            Arc::new(material.mixture()),
        ));
    }
    let brdf: Arc<dyn Brdf> = match source::load(spec) {
        Ok(brdf) => brdf.into(),
        Err(BrdfError::UnknownSource { known, .. }) if !spec.starts_with("nbrdf:") => {
            return Err(EvaluateError::UnknownMaterial {
                spec: spec.to_owned(),
                known: format!("{}, {known}", GROUPS.join(", ")),
            });
        }
        Err(error) => return Err(error.into()),
    };
    if let Some(name) = spec.strip_prefix("nbrdf:") {
        return Ok((name.into(), spec.into(), Class::Measured, brdf));
    }
    let path = Path::new(spec);
    let Ok(bytes) = crate::outside_file::read_regular(path, 1 << 29) else {
        // One atom, which may be in some dictionary.
        return Ok((spec.into(), spec.into(), Class::InSpan, brdf));
    };
    let stem = path.file_stem().and_then(|s| s.to_str()).unwrap_or(spec);
    let identity = format!("{spec} ({})", short_hash(&bytes));
    Ok((stem.into(), identity, Class::Measured, brdf))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_are_expanded_and_names_must_differ() {
        let load = |specs: &[&str]| {
            let specs: Vec<String> = specs.iter().map(|s| (*s).to_owned()).collect();
            load_all(&specs)
        };
        let all = load(&["synthetic", "nbrdf:pvc", "ggx:0.1,1.5"]).unwrap();
        assert_eq!(all.len(), synthetic::NAMES.len() + 2);
        assert!(all.iter().enumerate().all(|(i, m)| m.index == i));
        for (bad, said) in [
            (
                vec!["nbrdf:pvc", "nbrdf:pvc"],
                "two materials are called \"pvc\"",
            ),
            (vec!["synthetic:gold"], "\"synthetic:gold\" is unknown"),
            (vec!["nothing"], "\"nothing\" is unknown (known: bundled,"),
        ] {
            let error = load(&bad).err().map(|e| e.to_string()).unwrap_or_default();
            assert!(error.contains(said), "{error}");
        }
    }
}
