//! From what files say to what is traced: meshes read, scenes assembled.

use std::path::Path;
use std::sync::Arc;

use super::RigConfig;
use super::geometry::GeometryConfig;
use super::reflectance::BrdfSpec;
use super::scene::SceneFile;
use super::simulation::MaterialSpec;
use super::view::{BodySpec, SampleSpec, SurfaceSpec};
use crate::brdf::{Atom, Brdf, BrdfError, Dictionary, Mixture, source, weights};
use crate::geometry::{Mesh, MeshError, Shape};
use crate::simulation::{Truth, TruthSource};
use crate::transport::{Body, Camera, CameraShadow, Light, Scene, Shading};
use crate::units::StageAngles;

/// Why a scene cannot be built from a valid description.
#[derive(Debug, thiserror::Error)]
pub enum BuildError {
    /// The surface.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// The material.
    #[error(transparent)]
    Brdf(#[from] BrdfError),
    /// A thing beside the sample whose channels differ.
    #[error("geometry.body[{body}] is coloured; only grey bodies can stand beside a sample")]
    ColouredBody {
        /// Index from 0.
        body: usize,
    },
}

impl SurfaceSpec {
    /// The surface, to be shaded so; a shape with `segments` facets around if given, else
    /// with its own.
    pub fn mesh(&self, shading: Shading, segments: Option<u32>) -> Result<Mesh, BuildError> {
        match self {
            SurfaceSpec::Shape(shape) => Ok(with_segments(shape, segments).mesh()?),
            SurfaceSpec::Mesh(spec) => Ok(spec.load(shading)?),
        }
    }
}

fn with_segments(shape: &Shape, wanted: Option<u32>) -> Shape {
    let mut shape = shape.clone();
    if let Some(wanted) = wanted {
        match &mut shape {
            Shape::Bowl { segments, .. }
            | Shape::Sphere { segments, .. }
            | Shape::Cap { segments, .. }
            | Shape::Groove { segments, .. }
            | Shape::Designed { segments, .. } => *segments = wanted.next_multiple_of(4),
            Shape::Tetrahedron { .. } => {}
        }
    }
    shape
}

impl SampleSpec {
    /// The scene of this sample.
    fn scene(
        &self,
        bodies: Vec<Body>,
        camera: Camera,
        lights: Vec<Light>,
    ) -> Result<Scene, BuildError> {
        Ok(Scene::with_bodies(
            self.surface.mesh(self.shading, None)?,
            self.shading,
            bodies,
            camera,
            lights,
        ))
    }
}

impl BodySpec {
    /// The body, its mesh and tables read.
    fn load(&self) -> Result<Body, BuildError> {
        Ok(Body {
            mesh: self.surface.mesh(self.shading, None)?,
            shading: self.shading,
            brdf: self.brdf.load()?,
        })
    }
}

fn load_all(bodies: &[BodySpec]) -> Result<Vec<Body>, BuildError> {
    bodies.iter().map(BodySpec::load).collect()
}

impl GeometryConfig {
    /// The scene as the fit believes it, with the lamp at each of these angles.
    pub fn scene(&self, angles: &[StageAngles]) -> Result<Scene, BuildError> {
        let lights = angles.iter().map(|&a| self.light(a)).collect();
        let bodies = load_all(&self.bodies)?;
        let scene = self.sample.scene(bodies, self.image_camera(), lights)?;
        match scene.coloured_body() {
            Some(body) => Err(BuildError::ColouredBody { body }),
            None => Ok(scene),
        }
    }

    /// Where the camera's body keeps the light from the sample; `None` where none is stated.
    pub fn camera_shadow(&self) -> Result<Option<CameraShadow>, BuildError> {
        let Some(body) = self.camera_body else {
            return Ok(None);
        };
        Ok(Some(CameraShadow::new(&self.scene(&[])?, body)))
    }
}

impl SceneFile {
    /// The scene with its meshes read.
    pub fn scene(&self) -> Result<Scene, BuildError> {
        self.sample
            .scene(load_all(&self.bodies)?, self.camera, self.lights.clone())
    }
}

impl BrdfSpec {
    /// The atoms that have weight, or could have; none of a table.
    pub fn atoms(&self) -> Result<Vec<Atom>, BrdfError> {
        Ok(match self {
            BrdfSpec::Mixture(parts) => parts.iter().map(|p| p.atom).collect(),
            BrdfSpec::Dictionary { dictionary, .. } => {
                load_dictionary(dictionary)?.atoms().to_vec()
            }
            BrdfSpec::Table(_) => Vec::new(),
        })
    }

    /// The BRDF, its tables read.
    pub fn load(&self) -> Result<Arc<dyn Brdf>, BrdfError> {
        Ok(match self {
            BrdfSpec::Mixture(parts) => {
                let atoms = parts.iter().map(|p| p.atom).collect();
                let dictionary = Dictionary::new("mixture", atoms)?;
                let weights = std::array::from_fn(|c| parts.iter().map(|p| p.weight[c]).collect());
                Arc::new(Mixture::new(Arc::new(dictionary), weights)?)
            }
            BrdfSpec::Dictionary {
                dictionary,
                weights: file,
            } => Arc::new(weights::read(file, Arc::new(load_dictionary(dictionary)?))?),
            BrdfSpec::Table(path) => source::load(&path.display().to_string())?.into(),
        })
    }
}

fn load_dictionary(name_or_path: &Path) -> Result<Dictionary, BrdfError> {
    Dictionary::load(&name_or_path.to_string_lossy())
}

impl MaterialSpec {
    /// The material.
    pub fn load(&self) -> Result<Arc<dyn Brdf>, BrdfError> {
        match self {
            MaterialSpec::Bundled { source: kind, name } => {
                Ok(source::load(&format!("{kind}:{name}"))?.into())
            }
            MaterialSpec::Brdf(spec) => spec.load(),
        }
    }
}

impl RigConfig {
    /// The true scene of a simulated rig; `None` for a real one.
    pub fn truth(&self) -> Result<Option<Arc<TruthSource>>, BuildError> {
        let Some(simulation) = &self.simulation else {
            return Ok(None);
        };
        let geometry = self.geometry.clone();
        // The lens was found to be possible when the file was read.
        let camera = simulation.lens.of(&geometry.camera);
        let camera = camera.unwrap_or(geometry.camera);
        Ok(Some(Arc::new(TruthSource::new(Truth {
            mesh: (geometry.sample.surface)
                .mesh(geometry.sample.shading, Some(simulation.segments))?,
            shading: geometry.sample.shading,
            bodies: load_all(&geometry.bodies)?,
            camera,
            mosaic: self.camera.mosaic,
            light: Box::new(move |angles| geometry.light(angles)),
            brdf: simulation.material.load()?,
            pose_error_mm: simulation.pose_error_mm,
            pose_error_deg: simulation.pose_error_deg,
            ambient_w_m2_sr: simulation.ambient_w_m2_sr as f32,
            samples_per_pixel: simulation.samples_per_pixel,
            max_reflections: simulation.max_reflections,
            seed: simulation.seed,
        }))))
    }
}
