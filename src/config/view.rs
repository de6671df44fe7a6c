//! What rig files and scene files say in the same words: where the camera
//! stands, and what lies in front of it.

use std::path::PathBuf;

use glam::DVec3;

use super::ConfigError;
use super::reader::Section;
use super::shape::ShapeSpec;
use crate::frames::{Camera, Rigid, Sample, look_at};

/// How the camera maps directions to pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Projection {
    /// Parallel rays (a telecentric lens).
    Orthographic {
        /// Field of view, width and height, mm.
        extent_mm: [f64; 2],
    },
    /// A pinhole.
    Perspective {
        /// Full horizontal angle of view, degrees.
        fov_deg: f64,
    },
}

/// Where the camera stands and what it sees; the pixel grid is elsewhere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraView {
    /// Parallel or pinhole.
    pub projection: Projection,
    /// The camera's position, sample frame, mm.
    pub position_mm: DVec3,
    /// The point in the middle of the image, sample frame, mm.
    pub look_at_mm: DVec3,
    /// Unit direction that points up in the image, sample frame.
    pub up: DVec3,
    /// Numerical aperture on the sample's side; 0 is a pinhole.
    pub object_na: f64,
}

impl CameraView {
    /// Takes the view's keys out of a table that may have others.
    pub fn take(table: &mut Section) -> Result<Self, ConfigError> {
        let orthographic = table
            .choice("model", &[("orthographic", true), ("perspective", false)])?
            .required()?;
        let projection = if orthographic {
            let extent_mm = table.numbers("extent_mm", 1e-3..=1e4)?.required()?;
            Projection::Orthographic { extent_mm }
        } else {
            let fov_deg = table.number("fov_deg", 0.1..=170.0)?.required()?;
            Projection::Perspective { fov_deg }
        };
        let view = Self {
            projection,
            position_mm: table.position("position_mm")?.required()?,
            look_at_mm: table.position("look_at_mm")?.or(DVec3::ZERO),
            up: table.direction("up")?.or(DVec3::Y),
            object_na: table.number("object_na", 0.0..=0.95)?.or(0.0),
        };
        if look_at(view.position_mm, view.look_at_mm, view.up).is_none() {
            return Err(table.conflict(
                "up",
                view.up,
                "across the view, with look_at_mm away from position_mm",
            ));
        }
        Ok(view)
    }

    /// The camera's place; `None` never happens for a view that was read.
    pub fn sample_from_camera(&self) -> Option<Rigid<Sample, Camera>> {
        look_at(self.position_mm, self.look_at_mm, self.up)
    }
}

/// A surface, from a file or by its parameters.
#[derive(Clone, Debug, PartialEq)]
pub enum SurfaceSpec {
    /// A mesh file (PLY, OBJ, STL), millimetres.
    Mesh(PathBuf),
    /// A shape by its parameters.
    Shape(ShapeSpec),
}

impl SurfaceSpec {
    /// Takes `mesh` or `shape`.
    pub fn take(table: &mut Section) -> Result<Self, ConfigError> {
        let mesh = table.path("mesh")?.optional();
        let shape = table.section("shape")?.optional();
        match (mesh, shape) {
            (Some(mesh), None) => Ok(Self::Mesh(mesh)),
            (None, Some(shape)) => Ok(Self::Shape(ShapeSpec::read(shape)?)),
            (Some(mesh), Some(_)) => {
                Err(table.conflict("mesh", mesh.display(), "absent where `shape` is given"))
            }
            (None, None) => Err(table.missing("mesh", "a mesh file, or `shape` a table")),
        }
    }
}

/// Which normals shade.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shading {
    /// The facets' own.
    Flat,
    /// Interpolated between vertices: no facets in mirror images, but not reciprocal.
    Smooth,
}

/// The sample under the camera, in its own frame.
#[derive(Clone, Debug, PartialEq)]
pub struct SampleSpec {
    /// Its surface.
    pub surface: SurfaceSpec,
    /// Which normals shade.
    pub shading: Shading,
}

impl SampleSpec {
    /// Reads the `[sample]` table.
    pub fn read(mut table: Section) -> Result<Self, ConfigError> {
        let sample = Self {
            surface: SurfaceSpec::take(&mut table)?,
            shading: table
                .choice(
                    "shading",
                    &[("flat", Shading::Flat), ("smooth", Shading::Smooth)],
                )?
                .or(Shading::Flat),
        };
        table.finish()?;
        Ok(sample)
    }
}
