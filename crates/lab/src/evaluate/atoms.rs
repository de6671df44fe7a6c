//! Fig. 1: the dictionary's atoms.

use glam::DVec3;

use super::experiment::{Case, EvaluateError, Experiment, Row, Scale, Table};
use super::lab::Lab;
use crate::brdf::environment::EnvironmentMap;
use crate::brdf::sphere::sphere_image;
use crate::brdf::{Mixture, check};
use crate::plot::{Figure, Picture, Tile, pictures};

/// Every atom on a sphere.
pub static ATOMS: Experiment = Experiment {
    name: "atoms",
    shows: "Fig. 1: the atoms of the dictionary, their albedos, and a sphere of each under the studio map",
    full: Scale {
        sphere_px: 128,
        samples_per_pixel: 4096,
        ..Scale::NONE
    },
    quick: Scale {
        sphere_px: 32,
        samples_per_pixel: 256,
        ..Scale::NONE
    },
    cases,
    figures,
};

fn mixture(lab: &Lab, atom: usize) -> Result<Mixture, EvaluateError> {
    let mut weights = vec![0.0; lab.dictionary.len()];
    weights[atom] = 1.0;
    Ok(Mixture::grey(lab.dictionary.clone(), weights)?)
}

fn cases(lab: &Lab) -> Result<Vec<Case>, EvaluateError> {
    let case = |index: usize| {
        Case::new(format!("atom {index}"), move |lab: &Lab| {
            let row = Row::new().with("atom", index);
            let atom = lab.dictionary.atoms()[index];
            let mut row = row.with("type", atom.kind());
            let parameters = [
                ("alpha", atom.alpha()),
                ("eta", atom.eta()),
                ("albedo", atom.albedo()),
            ];
            for (name, value) in parameters {
                if let Some(value) = value {
                    row = row.with(name, value);
                }
            }
            let brdf = mixture(lab, index)?;
            let albedo = |deg: f64| {
                let (sin, cos) = deg.to_radians().sin_cos();
                let from = DVec3::new(sin, 0.0, cos);
                check::directional_albedo(&brdf, from, lab.settings.samples_per_pixel)[1]
            };
            Ok(vec![
                row.with("albedo_0_deg", albedo(0.0))
                    .with("albedo_45_deg", albedo(45.0))
                    .with("albedo_75_deg", albedo(75.0)),
            ])
        })
    };
    Ok((0..lab.dictionary.len()).map(case).collect())
}

fn figures(lab: &Lab, _: &Table) -> Result<Vec<Figure>, EvaluateError> {
    let map = EnvironmentMap::embedded("studio")
        .ok_or_else(|| EvaluateError::Fact("no map is called studio".to_owned()))?;
    let mut all = Vec::new();
    for (index, atom) in lab.dictionary.atoms().iter().enumerate() {
        let image = sphere_image(&mixture(lab, index)?, &map, lab.settings.sphere_px);
        let caption = match (atom.alpha(), atom.eta(), atom.albedo()) {
            (Some(alpha), Some(eta), _) => format!("{} α {alpha:.3}, η {eta:.2}", atom.kind()),
            (None, Some(eta), _) => format!("{} η {eta:.2}", atom.kind()),
            (_, _, Some(albedo)) => format!("{} ρ {albedo}", atom.kind()),
            _ => atom.kind().to_owned(),
        };
        all.push(Tile {
            caption,
            picture: Picture::opaque(image.size, image.to_srgb(0.7)),
            inset: None,
        });
    }
    let rows: Vec<_> = all
        .chunks(8)
        .map(|row| (String::new(), row.to_vec()))
        .collect();
    Ok(vec![pictures("atoms", 96.0, &[], &rows)])
}
