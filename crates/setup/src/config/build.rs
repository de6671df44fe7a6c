//! From what rig files say to what is traced: the believed scene and the simulated truth.

use std::sync::Arc;

use super::RigConfig;
use super::geometry::GeometryConfig;
use super::simulation::MaterialSpec;
use crate::brdf::{Brdf, BrdfError, source};
use crate::config::{BuildError, load_bodies};
use crate::simulation::{Truth, TruthSource};
use crate::transport::{CameraShadow, Scene};
use crate::units::StageAngles;

impl GeometryConfig {
    /// The scene as the fit believes it, with the lamp at each of these angles.
    pub fn scene(&self, angles: &[StageAngles]) -> Result<Scene, BuildError> {
        let lights = angles.iter().map(|&a| self.light(a)).collect();
        let bodies = load_bodies(&self.bodies)?;
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
            bodies: load_bodies(&geometry.bodies)?,
            camera,
            mosaic: self.camera.mosaic,
            light: Box::new(move |angles| geometry.light(angles)),
            brdf: simulation.material.load()?,
            pose_error_mm: simulation.pose_error_mm,
            pose_error_deg: simulation.pose_error_deg,
            ambient_w_m2_sr: simulation.ambient_w_m2_sr as f32,
            glare: simulation.glare,
            samples_per_pixel: simulation.samples_per_pixel,
            max_reflections: simulation.max_reflections,
            seed: simulation.seed,
        }))))
    }
}
