//! From what scene files say to what is traced: meshes read, scenes assembled.

use std::path::Path;
use std::sync::Arc;

use super::mesh::shaded;
use super::reflectance::BrdfSpec;
use super::scene::SceneFile;
use super::view::{BodySpec, SampleSpec, SurfaceSpec};
use crate::brdf::{Atom, Brdf, BrdfError, Dictionary, Mixture, fitted, source, weights};
use crate::geometry::{Mesh, MeshError, Shape};
use crate::transport::{Body, Camera, Light, Scene, Shading};

/// Why a scene cannot be built from a valid description.
#[derive(Debug, thiserror::Error)]
pub enum BuildError {
    /// The surface.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// The material.
    #[error(transparent)]
    Brdf(#[from] BrdfError),
    /// A body next to the sample whose channels differ.
    #[error("geometry.body[{body}] is coloured; only grey bodies can stand next to a sample")]
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
            SurfaceSpec::Made(mesh) => Ok(shaded((**mesh).clone(), shading, None, "the mesh")),
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
            | Shape::Ridge { segments, .. }
            | Shape::Designed { segments, .. } => *segments = wanted.next_multiple_of(4),
            Shape::Tetrahedron { .. } => {}
        }
    }
    shape
}

impl SampleSpec {
    /// The scene of this sample.
    pub fn scene(
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

/// All bodies of a description.
pub fn load_bodies(bodies: &[BodySpec]) -> Result<Vec<Body>, BuildError> {
    bodies.iter().map(BodySpec::load).collect()
}

impl SceneFile {
    /// The scene with its meshes read.
    pub fn scene(&self) -> Result<Scene, BuildError> {
        self.sample
            .scene(load_bodies(&self.bodies)?, self.camera, self.lights.clone())
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
            BrdfSpec::Fit(folder) => {
                let material = fitted::read(folder)?;
                material.mixture.dictionary().atoms().to_vec()
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
            BrdfSpec::Fit(folder) => Arc::new(fitted::read(folder)?),
            BrdfSpec::Table(path) => source::load(&path.display().to_string())?.into(),
        })
    }
}

fn load_dictionary(name_or_path: &Path) -> Result<Dictionary, BrdfError> {
    Dictionary::load(&name_or_path.to_string_lossy())
}
