//! What the cases of an experiment share: settings, materials, dictionary, samples,
//! and how an estimate is scored.

pub mod capture;
pub mod cases;
pub mod materials;
pub mod misaligned;
pub mod samples;
mod scoring;
mod synthetic;

use std::sync::{Arc, LazyLock, OnceLock};

use super::error::EvaluateError;
use super::experiment::settings::Settings;
use crate::brdf::Dictionary;
use crate::brdf::environment::EnvironmentMap;
use crate::brdf::projection::{CellMatrix, EnvironmentMatrix};
use crate::checksum::sha256_hex;
use crate::transport::Kernel;

pub use cases::of_materials;
pub use materials::{Class, Material};
pub use samples::Sample;
pub use scoring::Scored;

/// The maps of the environment error.
static MAPS: LazyLock<Vec<EnvironmentMap>> = LazyLock::new(EnvironmentMap::all);

/// Settings with all that they name, loaded. What is costly and shared by cases is
/// computed at the first use.
pub struct Lab {
    /// The settings.
    pub settings: Settings,
    /// The dictionary of the fits.
    pub dictionary: Arc<Dictionary>,
    /// The instructions that evaluate paths.
    pub kernel: Kernel,
    /// The targets.
    pub materials: Vec<Arc<Material>>,
    environment: OnceLock<EnvironmentMatrix<'static>>,
    cells: OnceLock<CellMatrix>,
    /// By material.
    reachable: Vec<OnceLock<Result<Scored, String>>>,
}

impl Lab {
    /// Loads what `settings` name; `portable`: for the kernel that every processor has.
    pub fn new(mut settings: Settings, portable: bool) -> Result<Self, EvaluateError> {
        let dictionary = Arc::new(Dictionary::load(&settings.dictionary)?);
        let atoms = serde_json::to_vec(dictionary.atoms()).unwrap_or_default();
        settings.dictionary = format!("{} ({})", dictionary.name(), short_hash(&atoms));
        let materials = materials::load_all(&settings.materials)?;
        settings.materials = materials.iter().map(|m| m.identity.clone()).collect();
        let kernel = if portable {
            Kernel::Portable
        } else {
            Kernel::detect()
        };
        settings.kernel = kernel.to_string();
        Ok(Self {
            settings,
            dictionary,
            kernel,
            reachable: materials.iter().map(|_| OnceLock::new()).collect(),
            materials,
            environment: OnceLock::new(),
            cells: OnceLock::new(),
        })
    }

    /// The maps of the environment error.
    pub fn maps(&self) -> &'static [EnvironmentMap] {
        &MAPS
    }

    /// The dictionary's spheres under the four maps.
    pub fn environment(&self) -> &EnvironmentMatrix<'static> {
        self.environment.get_or_init(|| {
            EnvironmentMatrix::new(self.dictionary.clone(), &MAPS, self.settings.sphere_px)
        })
    }

    /// The dictionary at the cells of the BRDF error.
    pub fn cells(&self) -> &CellMatrix {
        self.cells
            .get_or_init(|| CellMatrix::new(self.dictionary.clone(), self.settings.azimuths.max(1)))
    }
}

/// The first 12 digits of a SHA-256.
fn short_hash(bytes: &[u8]) -> String {
    sha256_hex(bytes)[..12].to_owned()
}
