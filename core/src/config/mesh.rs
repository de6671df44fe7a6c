//! A mesh file as a sample's or a body's surface: its unit, its place, its creases.

use std::path::PathBuf;

use glam::DVec3;

use super::ConfigError;
use super::reader::Section;
use crate::frames::Rigid;
use crate::geometry::inspect::UNITS;
use crate::geometry::placement::{Placement, rotation_xyz};
use crate::geometry::smooth::DEFAULT_CREASE_DEG;
use crate::geometry::{FileRemark, Mesh, MeshError, MeshRemark, files};
use crate::transport::Shading;

/// A mesh file and how it is taken.
#[derive(Clone, Debug, PartialEq)]
pub struct MeshSpec {
    /// PLY, OBJ or STL.
    pub path: PathBuf,
    /// Unit, front and place.
    pub placement: Placement,
    /// Normals for smooth shading are made of the facets, with creases where these turn by
    /// so many degrees; `None`: the file's normals, where it has some, else with
    /// [`DEFAULT_CREASE_DEG`].
    pub crease_deg: Option<f64>,
}

impl MeshSpec {
    /// A file in millimetres and the sample's axes.
    pub fn of(path: PathBuf) -> Self {
        Self {
            path,
            placement: Placement::default(),
            crease_deg: None,
        }
    }

    /// Takes the keys that say how the mesh at `path` is to be taken.
    pub fn take(path: PathBuf, table: &mut Section) -> Result<Self, ConfigError> {
        let mm_per_unit = table.choice("mesh_unit", &UNITS)?.or(1.0);
        let flip_facets = table.flag("flip_facets")?.or(false);
        let mut to_sample = table.section_or_empty("mesh_to_sample")?;
        let rotate_deg = to_sample.numbers::<3>("rotate_deg", -360.0..=360.0)?;
        let translate_mm = to_sample.numbers::<3>("translate_mm", -1e9..=1e9)?;
        let rotate_deg = rotate_deg.or([0.0; 3]);
        let sample_from_mesh = Rigid::new(
            rotation_xyz(rotate_deg),
            DVec3::from_array(translate_mm.or([0.0; 3])),
        );
        to_sample.finish()?;
        Ok(Self {
            path,
            placement: Placement {
                mm_per_unit,
                flip_facets,
                sample_from_mesh,
            },
            crease_deg: table.number("crease_deg", 0.0..=180.0)?.optional(),
        })
    }

    /// The mesh, with normals if it is to be shaded smoothly.
    ///
    /// # Errors
    /// As [`files::read`].
    pub fn load(&self, shading: Shading) -> Result<Mesh, MeshError> {
        let mesh = files::read(&self.path, &self.placement)?;
        let name = self.path.display().to_string();
        Ok(shaded(mesh, shading, self.crease_deg, &name))
    }
}

/// The mesh as it is shaded, with normals for smooth shading: its own, unless a crease is stated,
/// or those of its facets.
pub(super) fn shaded(
    mut mesh: Mesh,
    shading: Shading,
    crease_deg: Option<f64>,
    name: &str,
) -> Mesh {
    if shading == Shading::Flat {
        let of_normals = |what: &MeshRemark| {
            matches!(what, MeshRemark::Normals { .. } | MeshRemark::NormalsTurned)
        };
        mesh.remarks.retain(|remark| !of_normals(&remark.what));
        return mesh;
    }
    if mesh.normals.is_some() && crease_deg.is_none() {
        return mesh;
    }
    let crease_deg = crease_deg.unwrap_or(DEFAULT_CREASE_DEG);
    let (mut smooth, remark) = mesh.smoothed(crease_deg.to_radians() as f32);
    smooth.remarks.extend(remark.map(|what| FileRemark {
        file: name.to_owned(),
        what,
    }));
    smooth
}
