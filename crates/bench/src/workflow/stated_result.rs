//! A fitted session with all that a statement of its result to others names.

use std::path::{Path, PathBuf};

use super::traceability::Traceability;
use crate::config::view::SurfaceSpec;
use crate::config::{ConfigError, RigConfig};
use crate::geometry::Shape;
use crate::geometry::shapes::{Form, Profile};
use crate::session::fit_record::{self, FitRecord, FitRecordError};
use crate::session::{Session, SessionError};
use crate::transport::Projection;

/// Why a result cannot be stated.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum StatedResultError {
    #[error("{} is a fit outside a session: where and when its images were taken is not known", folder.display())]
    NoSession { folder: PathBuf },
    /// The session has no fit of this number.
    #[error("{} has no fit {number}", session.display())]
    NoSuchFit { session: PathBuf, number: u32 },
    /// The fit cannot be read.
    #[error(transparent)]
    Fit(#[from] FitRecordError),
    /// The session cannot be read.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// The session's rig file cannot be read.
    #[error(transparent)]
    Config(#[from] ConfigError),
}

/// A fitted session.
#[derive(Debug)]
pub struct StatedResult {
    /// What was captured.
    pub session: Session,
    /// Number of the fit.
    pub number: u32,
    /// The fit.
    pub record: FitRecord,
    /// The bench, as the session's rig file has it.
    pub config: RigConfig,
    /// What its scale rests on.
    pub traceability: Traceability,
}

fn swept(form: Form) -> &'static str {
    match form {
        Form::Extruded => "extruded",
        Form::Revolved => "revolved",
    }
}

impl StatedResult {
    /// The fit that `folder` names: a session, or `SESSION/fits/NUMBER`; `number` instead of
    /// the latest.
    ///
    /// # Errors
    /// A fit outside a session, or what cannot be read.
    pub fn load(folder: &Path, number: Option<u32>) -> Result<Self, StatedResultError> {
        let found = fit_record::find_in_session(folder)?;
        let (session, latest) = found.ok_or_else(|| StatedResultError::NoSession {
            folder: folder.to_owned(),
        })?;
        let number = number.unwrap_or(latest);
        if !fit_record::numbers_in(&session).contains(&number) {
            return Err(StatedResultError::NoSuchFit {
                session: session.root().to_owned(),
                number,
            });
        }
        Ok(Self {
            record: fit_record::read_in(&session, number)?,
            config: session.rig()?,
            traceability: Traceability::of(&session)?,
            number,
            session,
        })
    }

    /// Name of the session's folder.
    pub fn session_name(&self) -> String {
        let root = self.session.root();
        let root = root.canonicalize().unwrap_or_else(|_| root.to_owned());
        let name = root.file_name().unwrap_or_default();
        name.to_string_lossy().into_owned()
    }

    /// The sample's shape in words.
    pub fn sample_shape(&self) -> String {
        match &self.config.geometry.sample.surface {
            SurfaceSpec::Mesh(mesh) => {
                let name = mesh.path.file_name().unwrap_or_default();
                format!("surface of the mesh {}", name.to_string_lossy())
            }
            SurfaceSpec::Made(_) => "surface of a mesh".to_owned(),
            SurfaceSpec::Shape(shape) => match shape {
                Shape::Bowl { radius_mm, .. } => {
                    format!("hollow hemisphere, radius {radius_mm} mm")
                }
                Shape::Sphere { radius_mm, .. } => format!("sphere, radius {radius_mm} mm"),
                Shape::Cap {
                    radius_mm,
                    opening_deg,
                    ..
                } => match opening_deg {
                    90.0 => format!("hemisphere, radius {radius_mm} mm"),
                    _ => format!(
                        "spherical cap up to {opening_deg}° from its axis, radius {radius_mm} mm"
                    ),
                },
                Shape::Ridge {
                    radius_mm, form, ..
                } => format!(
                    "ridge within a moat, {}, radius {radius_mm} mm",
                    swept(*form)
                ),
                Shape::Tetrahedron {
                    radius_mm,
                    depth_mm,
                } => format!("tetrahedron, corners at {radius_mm} mm, {depth_mm} mm deep"),
                Shape::Designed {
                    radius_mm, form, ..
                } => {
                    let form = swept(*form);
                    format!("convex arc facing a concave wall, {form}, arc radius {radius_mm} mm")
                }
                Shape::Groove {
                    radius_mm,
                    width_mm,
                    profile,
                    ..
                } => {
                    let profile = match profile {
                        Profile::Round => "round".to_owned(),
                        Profile::Vee { depth_mm } => format!("V-shaped, {depth_mm} mm deep"),
                    };
                    format!("{profile} groove, {width_mm} mm wide, at a radius of {radius_mm} mm")
                }
            },
        }
    }

    /// The camera's geometry in words.
    pub fn camera_geometry(&self) -> String {
        let camera = &self.config.geometry.camera;
        let view = match camera.projection {
            Projection::Orthographic { extent_mm } => format!(
                "telecentric, field of view {} mm × {} mm",
                extent_mm.x, extent_mm.y
            ),
            Projection::Perspective { fov_rad } => format!(
                "perspective, horizontal angle of view {:.2}°",
                fov_rad.to_degrees()
            ),
        };
        match camera.object_na > 0.0 {
            true => format!("{view}, object-side aperture {}", camera.object_na),
            false => view,
        }
    }

    /// What channel `c` (0 = R, 1 = G, 2 = B) measures.
    pub fn band(&self, c: usize) -> String {
        let name = ["R", "G", "B"][c];
        match self.config.lab.instrument.band_nm[c] {
            Some([from, to]) => format!("{name}: {from} nm to {to} nm"),
            None => format!("{name}: band not stated"),
        }
    }
}
