//! BRDFs by name or file.

use std::path::Path;
use std::sync::Arc;

use super::dictionary::{Atom, Dictionary};
use super::mixture::Mixture;
use super::nbrdf::{NAMES, NeuralBrdf};
use super::rgl::RglBrdf;
use super::{Brdf, BrdfError, merl, weights};
use crate::outside_file::ends_in;

/// Loads a BRDF:
///
/// | spec | what |
/// |---|---|
/// | `nbrdf:NAME` | an embedded measured material, see [`NAMES`] (as a table, for speed) |
/// | `lambertian:ALBEDO`, `ggx:ALPHA,ETA` | one atom |
/// | `FILE.binary` | a MERL table |
/// | `FILE.bsdf` | an isotropic RGL material in RGB |
/// | `DICTIONARY:WEIGHTS.csv` | a mixture; the dictionary by name or file, the weights as a fit writes them, without the model discrepancy |
///
/// ```
/// use glam::Vec3;
/// use rig_core::brdf::source::load;
///
/// let chalk = load("lambertian:0.8")?;
/// let [f, ..] = chalk.eval(Vec3::Z, Vec3::new(0.6, 0.0, 0.8));
/// assert!((f - 0.8 / std::f32::consts::PI).abs() < 1e-6);
///
/// // An unknown name lists the known ones.
/// let error = load("nbrdf:gold").err().expect("no such material");
/// assert!(error.to_string().contains("red-plastic"));
/// # Ok::<(), rig_core::brdf::BrdfError>(())
/// ```
pub fn load(spec: &str) -> Result<Box<dyn Brdf>, BrdfError> {
    let unknown = |known: String| BrdfError::UnknownSource {
        spec: spec.to_owned(),
        known,
    };
    if let Some(name) = spec.strip_prefix("nbrdf:") {
        let network = NeuralBrdf::named(name).ok_or_else(|| unknown(NAMES.join(", ")))?;
        return Ok(Box::new(network.tabulate()));
    }
    if let Some(atom) = parse_atom(spec) {
        let dictionary = Dictionary::new(spec, vec![atom])?;
        return Ok(Box::new(Mixture::grey(Arc::new(dictionary), vec![1.0])?));
    }
    if let Some((dictionary, file)) = spec.rsplit_once(':')
        && ends_in(Path::new(file), "csv")
    {
        let dictionary = Arc::new(Dictionary::load(dictionary)?);
        let mixture = weights::read(Path::new(file), dictionary)?;
        return Ok(Box::new(mixture));
    }
    let path = Path::new(spec);
    if ends_in(path, "binary") {
        return Ok(Box::new(merl::read(path)?));
    }
    if ends_in(path, "bsdf") {
        return Ok(Box::new(RglBrdf::read(path)?));
    }
    Err(unknown(
        "nbrdf:NAME, lambertian:ALBEDO, ggx:ALPHA,ETA, FILE.binary, FILE.bsdf, DICTIONARY:WEIGHTS.csv"
            .to_owned(),
    ))
}

/// `lambertian:0.5` or `ggx:0.1,1.5`; ranges are checked by the dictionary.
fn parse_atom(spec: &str) -> Option<Atom> {
    if let Some(albedo) = spec.strip_prefix("lambertian:") {
        let albedo = albedo.parse().ok()?;
        return Some(Atom::Lambertian { albedo });
    }
    let (alpha, eta) = spec.strip_prefix("ggx:")?.split_once(',')?;
    Some(Atom::Ggx {
        alpha: alpha.trim().parse().ok()?,
        eta: eta.trim().parse().ok()?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    #[test]
    fn specs_are_told_apart() {
        let half = load("lambertian:0.5").unwrap();
        assert!((half.eval(Vec3::Z, Vec3::Z)[1] - 0.5 / std::f32::consts::PI).abs() < 1e-6);
        assert!(load("ggx:0.1,1.5").unwrap().eval(Vec3::Z, Vec3::Z)[0] > 0.3);
        for (bad, said) in [
            ("ggx:3,1.5", "alpha 3"),
            ("lambertian:x", "known"),
            ("nbrdf:gold", "red-plastic"),
            ("nothing.xyz", "known"),
            ("missing.binary", "missing.binary"),
            ("MISSING.BINARY", "MISSING.BINARY: "),
            ("Missing.Bsdf", "Missing.Bsdf: "),
            ("paper42:missing.csv", "missing.csv"),
            ("paper42:MISSING.CSV", "MISSING.CSV: "),
            ("MISSING.TOML:x.csv", "MISSING.TOML: "),
        ] {
            let error = load(bad).err().map(|e| e.to_string()).unwrap_or_default();
            assert!(error.contains(said), "{bad}: {error}");
        }
    }
}
