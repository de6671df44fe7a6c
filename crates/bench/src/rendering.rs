//! Mean and variance images of a scene file.

mod deviation;

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::brdf::discrepancy::Material;
use crate::brdf::{Atom, Brdf, BrdfError};
use crate::config::BuildError;
use crate::config::ConfigError;
use crate::config::reflectance::BrdfSpec;
use crate::config::scene::SceneFile;
use crate::geometry::Mesh;
use crate::progress::Progress;
use crate::radiance_image::RadianceImage;
use crate::radiance_image::exr::{self, ExrError};
use crate::session::fit_record::{self, FitRecordError};
use crate::transport::polarised::NotPolarisable;
use crate::transport::{
    Remainder, RenderOptions, Scene, Steering, render_polarised, render_with_progress,
    suited_proposal, truncation_remainder,
};

pub use deviation::deviations;

/// What to render, and where to.
#[derive(Clone, Debug)]
pub struct RenderRequest {
    /// Scene file with a `[brdf]`.
    pub scene: PathBuf,
    /// The folder of a fit, or a session, whose latest is taken: its material instead of `[brdf]`.
    pub fit: Option<PathBuf>,
    /// Where to write the standard deviation over the fit's posterior samples, numbered as `out`.
    pub deviation: Option<PathBuf>,
    /// Image to write; with several lights `X.exr` becomes `X_L000.exr`, `X_L001.exr`, ….
    pub out: PathBuf,
    /// Light paths per pixel, 2 or more.
    pub samples_per_pixel: u32,
    /// Longest path in surface reflections, 1..=64.
    pub max_reflections: u32,
    /// Seed of the light paths.
    pub seed: u64,
    /// Follow polarisation, also where the scene file doesn't ask for it.
    pub polarised: bool,
}

impl RenderRequest {
    /// With the renderer's defaults.
    pub fn new(scene: &Path, out: &Path) -> Self {
        let options = RenderOptions::default();
        Self {
            scene: scene.to_owned(),
            fit: None,
            deviation: None,
            out: out.to_owned(),
            samples_per_pixel: options.samples_per_pixel,
            max_reflections: options.max_reflections,
            seed: options.seed,
            polarised: false,
        }
    }
}

/// Why nothing was rendered.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum RenderError {
    /// The scene file.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// What the scene file describes.
    #[error(transparent)]
    Build(#[from] BuildError),
    #[error("{}: [brdf] is missing", path.display())]
    NoBrdf { path: PathBuf },
    /// The fit.
    #[error(transparent)]
    Fit(#[from] FitRecordError),
    #[error("the material is no fit, so that no posterior samples say how sure it is")]
    NoFit,
    #[error("{} has no posterior samples: it drew none, or an earlier version made it", fit.display())]
    NoSamples { fit: PathBuf },
    /// The BRDF could not be loaded.
    #[error(transparent)]
    Brdf(#[from] BrdfError),
    /// Polarisation of this material is not known.
    #[error(transparent)]
    Polarisation(#[from] NotPolarisable),
    /// An image could not be written.
    #[error(transparent)]
    Image(#[from] ExrError),
}

/// A scene that is ready to be rendered.
#[allow(missing_docs)]
pub struct Rendering {
    pub file: SceneFile,
    pub scene: Scene,
    /// Facets that are too coarse for the material's highlight.
    pub coarse_facets: Option<CoarseFacets>,
    brdf: Arc<dyn Brdf>,
    samples: Vec<Material>,
    request: RenderRequest,
}

/// Images that were written.
#[derive(Clone, Debug)]
pub struct Rendered {
    /// One per light.
    pub images: Vec<PathBuf>,
    /// One per light where deviations were asked for: standard deviations as R, G, B.
    pub deviations: Vec<PathBuf>,
    /// Whether polarisation was followed.
    pub polarised: bool,
    /// Light that longer paths would bring, per light.
    pub truncation: Vec<Remainder>,
}

/// Paths per pixel that estimate what the longest path cuts off.
const TRUNCATION_SAMPLES: u32 = 32;

impl Rendering {
    /// Reads the scene and its BRDF.
    ///
    /// # Errors
    /// A file that cannot be read, or a scene without a BRDF.
    pub fn load(request: &RenderRequest) -> Result<Self, RenderError> {
        let file = SceneFile::load(&request.scene)?;
        let spec = request.fit.clone().map(BrdfSpec::Fit);
        let Some(spec) = spec.as_ref().or(file.brdf.as_ref()) else {
            return Err(RenderError::NoBrdf {
                path: request.scene.clone(),
            });
        };
        let scene = file.scene()?;
        let mut samples = Vec::new();
        let (atoms, brdf) = match spec {
            BrdfSpec::Fit(folder) => {
                let record = fit_record::find(folder)?;
                if request.deviation.is_some() {
                    samples = record.sampled_materials(usize::MAX)?;
                    if samples.len() < 2 {
                        let fit = folder.clone();
                        return Err(RenderError::NoSamples { fit });
                    }
                }
                let atoms = record.mixture()?.dictionary().atoms().to_vec();
                (atoms, record.material()?)
            }
            _ if request.deviation.is_some() => return Err(RenderError::NoFit),
            other => (other.atoms()?, other.load()?),
        };
        Ok(Self {
            coarse_facets: CoarseFacets::of(&scene, &atoms),
            brdf,
            samples,
            scene,
            file,
            request: request.clone(),
        })
    }

    /// Rows of pixels that are rendered: the steps of the progress.
    pub fn rows(&self) -> usize {
        self.scene.camera.resolution_px[1] * (1 + self.samples.len())
    }

    /// Renders and writes the images; the steps of its progress are [`Self::rows`].
    ///
    /// # Errors
    /// A material whose polarisation is not known, or an image that cannot be written.
    pub fn run(&self, progress: &dyn Progress) -> Result<Rendered, RenderError> {
        let (request, scene, brdf) = (&self.request, &self.scene, &*self.brdf);
        let polarised = request.polarised || self.file.polarised;
        let mut options = RenderOptions {
            samples_per_pixel: request.samples_per_pixel,
            max_reflections: request.max_reflections,
            seed: request.seed,
            steering: Steering::default(),
            ..RenderOptions::default()
        };
        options.proposal = suited_proposal(scene, brdf, &options);
        let images = match polarised {
            true => render_polarised(scene, brdf, &options, progress)?,
            false => render_with_progress(scene, brdf, &options, progress),
        };
        let samples = TRUNCATION_SAMPLES.min(request.samples_per_pixel);
        let truncation = truncation_remainder(scene, brdf, &options, samples);
        let deviations = match &request.deviation {
            Some(out) => {
                let found = deviations(scene, &self.samples, &options, progress);
                let images = found.into_iter().map(|deviations| {
                    let [width, height] = scene.camera.resolution_px;
                    let mut image = RadianceImage::new(width, height);
                    image.mean = deviations;
                    image
                });
                written(out, &images.collect::<Vec<_>>())?
            }
            None => Vec::new(),
        };
        Ok(Rendered {
            images: written(&request.out, &images)?,
            deviations,
            polarised,
            truncation,
        })
    }
}

/// Writes one image per light; their paths.
fn written(out: &Path, images: &[RadianceImage]) -> Result<Vec<PathBuf>, ExrError> {
    let write = |(light, image)| {
        let path = match images.len() {
            1 => out.to_owned(),
            _ => numbered(out, light),
        };
        exr::write(&path, image)?;
        Ok(path)
    };
    images.iter().enumerate().map(write).collect()
}

fn numbered(path: &Path, light: usize) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!("{stem}_L{light:03}.exr"))
}

/// Facets that are too coarse for a narrow lobe: they shade with their own normals, and
/// neighbours differ by more than an eighth of the lobe's roughness, which takes up to a
/// sixth off its peak.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoarseFacets {
    /// Angle between neighbours, radians.
    pub step_rad: f64,
    /// Roughness of the narrowest lobe.
    pub alpha: f64,
}

impl CoarseFacets {
    /// The largest angle between neighbours that a lobe of this roughness allows, radians.
    pub fn allowed_rad(alpha: f64) -> f64 {
        alpha / 8.0
    }

    /// Of a scene whose material has these atoms; `None` where the facets are fine enough.
    pub fn of(scene: &Scene, atoms: &[Atom]) -> Option<Self> {
        let widths = atoms.iter().filter_map(Atom::alpha);
        let alpha = widths.fold(f64::INFINITY, f64::min);
        if !scene.is_flat() || alpha.is_infinite() {
            return None;
        }
        let step_rad = f64::from(scene.sample().facet_step_rad(Mesh::CREASE_RAD));
        (step_rad > Self::allowed_rad(alpha)).then_some(Self { step_rad, alpha })
    }
}

impl fmt::Display for CoarseFacets {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "the sample's facets turn by {:.2}° from one to the next; the narrowest lobe (alpha {}) allows {:.2}°",
            self.step_rad.to_degrees(),
            self.alpha,
            Self::allowed_rad(self.alpha).to_degrees()
        )
    }
}
