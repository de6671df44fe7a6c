//! A material in the parametric model of another program, with what that loses.

use std::path::Path;

use crate::brdf::Brdf;
use crate::brdf::score;
use crate::brdf::sphere::{GreyCard, SphereImage};
use crate::outside_file::ends_in;
use crate::parametric::{self, FitError, Fitted, LEAST_ROUGHNESS, Loss, Model, Parameters};
use crate::progress::Progress;

/// A program's material file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ModelFormat {
    /// OpenPBR in MaterialX.
    OpenPbr,
    /// A script for Blender.
    Blender,
    /// A binary glTF of a sphere.
    Gltf,
}

impl ModelFormat {
    /// The usual ending of its files.
    pub const fn ending(self) -> &'static str {
        match self {
            Self::OpenPbr => "mtlx",
            Self::Blender => "py",
            Self::Gltf => "glb",
        }
    }

    /// What messages call the model.
    pub fn name(self) -> &'static str {
        match self {
            Self::OpenPbr => "OpenPBR",
            Self::Blender => "Blender's Principled BSDF",
            Self::Gltf => "glTF",
        }
    }

    /// The format that a file's ending stands for.
    pub fn of(path: &Path) -> Option<Self> {
        [Self::OpenPbr, Self::Blender, Self::Gltf]
            .into_iter()
            .find(|format| ends_in(path, format.ending()))
    }

    /// The model behind it.
    pub fn model(self) -> Model {
        match self {
            Self::OpenPbr => Model::OpenPbr,
            Self::Blender => Model::Principled,
            Self::Gltf => Model::Gltf,
        }
    }
}

/// Environment error above which a model does not hold a material.
pub const LARGEST_ERROR: f64 = 0.25;
/// Width α below which renderers differ.
const NARROW_ALPHA: f64 = 0.01;
/// Difference of albedos worth a statement.
const ALBEDO_DIFFERENCE: f64 = 0.02;
/// Decimals of the parameters in files.
const DECIMALS: i32 = 4;

/// A material as a program will show it.
#[derive(Clone, Debug)]
pub struct AsModel {
    /// The program whose parameters these are.
    pub format: ModelFormat,
    /// The parameters, as the file holds them.
    pub fitted: Fitted,
    /// What they lose.
    pub loss: Loss,
    /// Environment error where the extensions are ignored, if the file has any.
    pub without_extensions: Option<f64>,
    /// Images of an 18% grey sphere, one for each environment map, to show next to `loss.spheres`.
    pub greys: Vec<SphereImage>,
}

impl AsModel {
    /// That of the program's materials which is nearest to `brdf`, without layers and tints
    /// that gain little unless it shall be the `closest`.
    ///
    /// # Errors
    /// A BRDF that reflects nothing, or has undefined values.
    pub fn of(
        brdf: &dyn Brdf,
        format: ModelFormat,
        closest: bool,
        progress: &dyn Progress,
    ) -> Result<Self, FitError> {
        let fitted = parametric::fit_shown(brdf, format.model(), closest, progress)?;
        let fitted = Fitted {
            parameters: fitted.parameters.rounded(DECIMALS),
            core: fitted.core.rounded(DECIMALS),
            ..fitted
        };
        let has_extensions = fitted.core != fitted.parameters;
        let core = fitted.core_brdf();
        let others: [&dyn Brdf; 2] = [&GreyCard, &core];
        let others = &others[..1 + usize::from(has_extensions)];
        let (loss, others) =
            Loss::with_spheres_of(&fitted.brdf(), brdf, others, score::SPHERE_SIZE);
        let without_extensions = has_extensions.then(|| {
            let pairs = others.iter().zip(&loss.spheres);
            let errors =
                pairs.map(|(others, [_, truth])| score::image_error(&others[1], truth).all);
            errors.sum::<f64>() / others.len() as f64
        });
        let greys = others.into_iter().map(|mut others| others.swap_remove(0));
        Ok(Self {
            format,
            fitted,
            loss,
            without_extensions,
            greys: greys.collect(),
        })
    }

    /// Whether the environment error is above [`LARGEST_ERROR`].
    pub fn is_poor(&self) -> bool {
        self.loss.error() > LARGEST_ERROR
    }

    /// What was lost, a sentence each.
    pub fn statements(&self) -> Vec<String> {
        let mut all = vec![format!(
            "as {}: environment error {}",
            self.format.name(),
            percent(self.loss.error())
        )];
        if let Some(error) = self.without_extensions {
            all.push(format!(
                "viewers that ignore the extensions show an environment error of {}",
                percent(error)
            ));
        }
        let worst = self.loss.worst.iter().map(|angle| {
            format!(
                "θh {}°, θd {}°: {}",
                angle.theta_h_deg,
                angle.theta_d_deg,
                too_much(angle.relative)
            )
        });
        all.push(format!("worst at {}", worst.collect::<Vec<_>>().join("; ")));
        let albedo = self.loss.albedo.iter();
        for pair in albedo.filter(|pair| (pair.model - pair.material).abs() > ALBEDO_DIFFERENCE) {
            all.push(format!(
                "directional albedo at {}° is {:.3}, of the material {:.3}",
                pair.theta_deg, pair.model, pair.material
            ));
        }
        all.extend(limits(&self.fitted.parameters));
        all
    }
}

/// Parameters at a limit, where the material may be beyond it.
fn limits(parameters: &Parameters) -> Vec<String> {
    let mut all = Vec::new();
    let reached: Vec<&str> = ["R", "G", "B"]
        .into_iter()
        .zip(parameters.base_color)
        .filter(|(_, value)| *value >= 1.0)
        .map(|(name, _)| name)
        .collect();
    if !reached.is_empty() {
        all.push(format!(
            "the base colour is 1, the largest allowed, in {}",
            reached.join(", ")
        ));
    }
    let coat = (parameters.coat_weight > 0.0).then_some(parameters.coat_roughness);
    for roughness in [Some(parameters.roughness), coat].into_iter().flatten() {
        let alpha = roughness * roughness;
        let least = match roughness <= LEAST_ROUGHNESS {
            true => ", the least allowed",
            false => "",
        };
        if alpha < NARROW_ALPHA {
            all.push(format!(
                "a lobe of α = {alpha:.4}{least}: many renderers widen lobes below {NARROW_ALPHA}"
            ));
        }
    }
    all
}

/// "40% too dark", "2.5 times too bright".
fn too_much(relative: f64) -> String {
    match relative {
        r if r >= 1.0 => format!("{:.1} times as bright as the material", 1.0 + r),
        r if r >= 0.0 => format!("{} too bright", percent(r)),
        r => format!("{} too dark", percent(-r)),
    }
}

/// With two digits: "7.1%", "12%".
fn percent(share: f64) -> String {
    match 100.0 * share {
        p if p < 9.95 => format!("{p:.1}%"),
        p => format!("{p:.0}%"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_for_numbers() {
        assert_eq!(percent(0.071), "7.1%");
        assert_eq!(percent(0.123), "12%");
        assert_eq!(too_much(-0.4), "40% too dark");
        assert_eq!(too_much(0.05), "5.0% too bright");
        assert_eq!(too_much(1.5), "2.5 times as bright as the material");
        let limited = Parameters {
            base_color: [1.0, 0.5, 1.0],
            roughness: LEAST_ROUGHNESS,
            ..Parameters::default()
        };
        let said = limits(&limited).join("\n");
        assert!(
            said.contains("in R, B") && said.contains("the least allowed"),
            "{said}"
        );
        assert!(limits(&Parameters::default()).is_empty());
    }

    #[test]
    fn endings_name_formats() {
        assert_eq!(
            ModelFormat::of(Path::new("a/b.mtlx")),
            Some(ModelFormat::OpenPbr)
        );
        assert_eq!(ModelFormat::of(Path::new("b.GLB")), Some(ModelFormat::Gltf));
        assert_eq!(ModelFormat::of(Path::new("b.binary")), None);
    }
}
