//! An indexed triangle mesh that has been checked once.

use glam::Vec3;

use super::mesh_error::FileRemark;
pub use super::mesh_error::{MAX_DISTANCE_MM, MeshError};
use super::topology::Topology;
use crate::shown::{MESSAGE, shortened};

/// Vertices and triangles of one body. The front of a triangle is the side
/// from which its corners run counter-clockwise; the BRDF lives there, the
/// back is black.
///
/// ```
/// use glam::Vec3;
/// use rig_core::geometry::Mesh;
///
/// let corners = vec![Vec3::ZERO, Vec3::X, Vec3::Y];
/// let facet = Mesh::new(corners.clone(), vec![[0, 1, 2]])?;
/// assert_eq!(facet.face_normal(0), Vec3::Z);
///
/// // A vertex that does not exist is an error.
/// assert!(Mesh::new(corners, vec![[0, 1, 3]]).is_err());
/// # Ok::<(), rig_core::geometry::MeshError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Mesh {
    /// Corners, millimetres, sample frame.
    pub positions_mm: Vec<Vec3>,
    /// Indices of three corners each.
    pub triangles: Vec<[u32; 3]>,
    /// Unit normals per corner, for smooth shading, where known.
    pub normals: Option<Vec<Vec3>>,
    /// Remarks about the file that it was read from.
    pub remarks: Vec<FileRemark>,
}

impl MeshError {
    /// An error of the format, without the file's name, which a parser does not know.
    pub(super) fn format(what: impl Into<String>) -> Self {
        Self::Format {
            what: shortened(&what.into(), MESSAGE).into_owned(),
        }
    }
}

/// Most triangles that a mesh may have.
pub const MAX_TRIANGLES: usize = 20_000_000;

impl Mesh {
    /// Checks indices, coordinates and areas. Edges may be shared by any number of triangles:
    /// rays meet each for itself.
    pub fn new(positions_mm: Vec<Vec3>, triangles: Vec<[u32; 3]>) -> Result<Self, MeshError> {
        if triangles.is_empty() {
            return Err(MeshError::Empty {
                vertices: positions_mm.len(),
            });
        }
        if triangles.len() > MAX_TRIANGLES {
            return Err(MeshError::TooLarge {
                triangles: triangles.len(),
                limit: MAX_TRIANGLES,
            });
        }
        if let Some(vertex) = positions_mm.iter().position(|p| !p.is_finite()) {
            let location = format!("vertex {vertex}");
            return Err(MeshError::NotFinite { location });
        }
        let distances = positions_mm.iter().map(|p| p.abs().max_element());
        if let Some((vertex, distance_mm)) =
            distances.enumerate().find(|(_, d)| *d > MAX_DISTANCE_MM)
        {
            return Err(MeshError::TooFar {
                vertex,
                distance_mm,
            });
        }
        for (triangle, corners) in triangles.iter().enumerate() {
            if let Some(&vertex) = corners.iter().find(|&&v| v as usize >= positions_mm.len()) {
                return Err(MeshError::NoSuchVertex {
                    facet: triangle,
                    vertex: vertex.into(),
                    vertices: positions_mm.len(),
                });
            }
            if !has_area(corners.map(|v| positions_mm[v as usize])) {
                return Err(MeshError::Degenerate { triangle });
            }
        }
        Ok(Self {
            positions_mm,
            triangles,
            normals: None,
            remarks: Vec::new(),
        })
    }

    /// With unit normals at the corners, used for smooth shading; lengths are normalised.
    pub fn with_normals(mut self, normals: Vec<Vec3>) -> Result<Self, MeshError> {
        if normals.len() != self.positions_mm.len() {
            return Err(MeshError::Normal {
                vertex: normals.len().min(self.positions_mm.len()),
            });
        }
        if let Some(vertex) = normals.iter().position(|n| n.try_normalize().is_none()) {
            return Err(MeshError::Normal { vertex });
        }
        self.normals = Some(normals.into_iter().map(Vec3::normalize).collect());
        Ok(self)
    }

    /// All of them as one mesh, triangles in order, without normals.
    pub fn joined<'a>(meshes: impl Iterator<Item = &'a Mesh>) -> Self {
        let mut all = Self {
            positions_mm: Vec::new(),
            triangles: Vec::new(),
            normals: None,
            remarks: Vec::new(),
        };
        for mesh in meshes {
            let first = all.positions_mm.len() as u32;
            all.positions_mm.extend(&mesh.positions_mm);
            let moved = mesh.triangles.iter().map(|t| t.map(|v| v + first));
            all.triangles.extend(moved);
        }
        all
    }

    /// Corners of a triangle.
    pub fn corners(&self, triangle: usize) -> [Vec3; 3] {
        self.triangles[triangle].map(|v| self.positions_mm[v as usize])
    }

    /// Unit normal of a triangle's front.
    pub fn face_normal(&self, triangle: usize) -> Vec3 {
        face_normal(self.corners(triangle))
    }

    /// Neighbouring facets at a larger angle are meant to be a crease, radians: eight
    /// facets around stay below it.
    pub const CREASE_RAD: f32 = 0.8;

    /// Largest angle between the normals of two triangles that share an edge,
    /// among angles below `crease_rad` (larger ones are meant to be creases), radians.
    /// A lobe narrower than eight times this angle sees the facets.
    pub fn facet_step_rad(&self, crease_rad: f32) -> f32 {
        let topology = Topology::of(&self.positions_mm, &self.triangles);
        let turn = |[one, two]: [super::topology::Side; 2]| {
            let [one, two] = [one, two].map(|side| self.face_normal(side.facet as usize));
            one.cross(two).length().atan2(one.dot(two))
        };
        let turns = topology.pairs().map(turn);
        turns.filter(|turn| *turn < crease_rad).fold(0.0, f32::max)
    }

    /// Mean length of the triangles' edges, millimetres.
    pub fn mean_edge_mm(&self) -> f64 {
        let around = (0..self.triangles.len()).map(|t| {
            let [a, b, c] = self.corners(t);
            f64::from(a.distance(b) + b.distance(c) + c.distance(a))
        });
        around.sum::<f64>() / (3 * self.triangles.len()) as f64
    }

    /// Smallest and largest coordinates, millimetres.
    pub fn bounds_mm(&self) -> [Vec3; 2] {
        self.positions_mm
            .iter()
            .fold([Vec3::INFINITY, Vec3::NEG_INFINITY], |[low, high], &p| {
                [low.min(p), high.max(p)]
            })
    }

    /// Another mesh moved by a rigid transform into the frame `Dst`.
    pub fn transformed<Dst, Src>(&self, dst_from_src: &crate::frames::Rigid<Dst, Src>) -> Self {
        let point = |p: &Vec3| dst_from_src.point(p.as_dvec3()).as_vec3();
        let direction = |n: &Vec3| dst_from_src.direction(n.as_dvec3()).as_vec3();
        Self {
            positions_mm: self.positions_mm.iter().map(point).collect(),
            triangles: self.triangles.clone(),
            normals: self
                .normals
                .as_ref()
                .map(|n| n.iter().map(direction).collect()),
            remarks: self.remarks.clone(),
        }
    }
}

/// Whether a triangle has an area, in f64: no triangle of f32 corners is lost to rounding.
pub(super) fn has_area(corners: [Vec3; 3]) -> bool {
    let [a, b, c] = corners.map(Vec3::as_dvec3);
    (b - a).cross(c - a).length_squared() > 0.0
}

/// Unit normal of a triangle's front.
pub(super) fn face_normal(corners: [Vec3; 3]) -> Vec3 {
    let [a, b, c] = corners.map(Vec3::as_dvec3);
    (b - a).cross(c - a).normalize().as_vec3()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square() -> (Vec<Vec3>, Vec<[u32; 3]>) {
        (
            vec![Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.0), Vec3::Y],
            vec![[0, 1, 2], [0, 2, 3]],
        )
    }

    #[test]
    fn bad_meshes_are_named() {
        let (positions, triangles) = square();
        assert!(Mesh::new(positions.clone(), triangles.clone()).is_ok());
        assert!(matches!(
            Mesh::new(positions.clone(), vec![]),
            Err(MeshError::Empty { vertices: 4 })
        ));
        assert!(matches!(
            Mesh::new(positions.clone(), vec![[0, 1, 9]]),
            Err(MeshError::NoSuchVertex {
                facet: 0,
                vertex: 9,
                vertices: 4
            })
        ));
        assert!(matches!(
            Mesh::new(positions.clone(), vec![[0, 1, 1]]),
            Err(MeshError::Degenerate { triangle: 0 })
        ));
        // Edges of any number of facets, turned or not.
        assert!(Mesh::new(positions.clone(), vec![[0, 1, 2], [0, 1, 3]]).is_ok());
        let mut far = positions.clone();
        far[1].x = 3e8;
        let error = Mesh::new(far, triangles.clone()).unwrap_err().to_string();
        assert!(error.contains("vertex 1 lies 300000000 mm"), "{error}");
        let mut broken = positions;
        broken[2].y = f32::NAN;
        assert!(matches!(
            Mesh::new(broken, triangles),
            Err(MeshError::NotFinite { .. })
        ));
    }
}
