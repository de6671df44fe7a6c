//! The content of a mesh file, in its own order and unit, and how it becomes a [`Mesh`].
//!
//! Programs leave behind facets without area, facets twice, vertices that nothing uses and
//! normals that are none. All formats are tidied here, so that they take the same.

use std::collections::HashSet;

use glam::{DVec3, Vec3};

use super::mesh::{MAX_TRIANGLES, Mesh, face_normal, has_area};
use super::mesh_error::{FileRemark, MeshError, MeshRemark, Steps};
use super::placement::Placement;
use super::seams;
use super::topology::{Topology, welded};
use super::triangulate::{Cut, MAX_CORNERS, triangulate};

/// The number of a normal where a corner has none.
pub const NO_NORMAL: u32 = u32::MAX;

/// A corner of a polygon: indices of its vertex and its normal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Corner {
    /// Among the vertices.
    pub vertex: u32,
    /// Among the normals, or [`NO_NORMAL`].
    pub normal: u32,
}

impl Corner {
    /// Without a normal.
    pub fn bare(vertex: u32) -> Self {
        Self {
            vertex,
            normal: NO_NORMAL,
        }
    }
}

/// A mesh as a file holds it.
#[derive(Default)]
pub struct Draft {
    /// In the file's unit; those that no facet uses may be anything.
    pub vertices: Vec<DVec3>,
    /// Lines of the vertices that are not finite, where the file is text.
    pub broken_lines: Vec<(u32, usize)>,
    /// Whether the file holds them as 32-bit numbers.
    pub are_single: bool,
    /// Of any length.
    pub normals: Vec<Vec3>,
    corners: Vec<Corner>,
    /// Where in `corners` each polygon ends.
    ends: Vec<usize>,
    /// What has been remarked so far.
    pub remarks: Vec<MeshRemark>,
}

impl Draft {
    /// Adds a polygon; one of fewer than three corners counts as without area.
    ///
    /// # Errors
    /// It has too many corners, or there are too many triangles.
    pub fn push(&mut self, corners: impl IntoIterator<Item = Corner>) -> Result<(), MeshError> {
        let start = self.corners.len();
        self.corners.extend(corners);
        self.ends.push(self.corners.len());
        let count = self.corners.len() - start;
        if count > MAX_CORNERS {
            return Err(MeshError::format(format!(
                "facet {} has {count} corners; at most {MAX_CORNERS} are supported",
                self.ends.len() - 1
            )));
        }
        let triangles = self.corners.len().saturating_sub(2 * self.ends.len());
        let triangles = triangles.max(self.ends.len());
        match triangles > MAX_TRIANGLES {
            true => Err(MeshError::TooLarge {
                triangles,
                limit: MAX_TRIANGLES,
            }),
            false => Ok(()),
        }
    }

    /// Polygons so far.
    pub fn polygons(&self) -> usize {
        self.ends.len()
    }

    /// The middle of the box around the corners, in the file's unit; the origin of none.
    pub fn middle(&self) -> DVec3 {
        let positions = self
            .corners
            .iter()
            .filter_map(|c| self.vertices.get(c.vertex as usize));
        let finite = positions.filter(|p| p.is_finite());
        let [low, high] = finite.fold([DVec3::INFINITY, DVec3::NEG_INFINITY], |[low, high], p| {
            [low.min(*p), high.max(*p)]
        });
        match low.is_finite() {
            true => 0.5 * (low + high),
            false => DVec3::ZERO,
        }
    }

    /// The mesh, with what was left out among its remarks.
    ///
    /// # Errors
    /// There is no facet with area, or a corner's vertex is missing, not finite or too far.
    pub fn mesh(mut self, placement: &Placement) -> Result<Mesh, MeshError> {
        if self.ends.is_empty() {
            return Err(MeshError::Empty {
                vertices: self.vertices.len(),
            });
        }
        self.check_corners()?;
        let mut positions_mm: Vec<Vec3> = self
            .vertices
            .iter()
            .map(|&position| placement.point(position).as_vec3())
            .collect();
        let triangles = self.triangles();
        let mut triangles = self.tidied(triangles, &positions_mm)?;
        self.remark_on_distance(&triangles, &positions_mm, placement);
        let facets: Vec<[u32; 3]> = triangles.iter().map(|t| t.map(|c| c.vertex)).collect();
        if let Some(seam) = seams::close(&mut positions_mm, &facets) {
            self.remarks.push(MeshRemark::OpenSeam(seam));
        }
        triangles.retain(|t| has_area(t.map(|c| positions_mm[c.vertex as usize])));
        let shaded = self.are_normals_usable(&triangles);

        // A vertex for each position and normal that is used, in the file's order.
        let key = |corner: Corner| Corner {
            normal: if shaded { corner.normal } else { NO_NORMAL },
            ..corner
        };
        let mut used: Vec<Corner> = triangles.iter().flatten().map(|&c| key(c)).collect();
        used.sort_unstable();
        used.dedup();
        let index = |corner| used.binary_search(&key(corner)).unwrap_or(0) as u32;
        let faces = triangles
            .iter()
            .map(|corners| {
                let [a, b, c] = corners.map(index);
                match placement.flip_facets {
                    true => [a, c, b],
                    false => [a, b, c],
                }
            })
            .collect();
        let positions = used.iter().map(|c| positions_mm[c.vertex as usize]);
        let mut mesh = Mesh::new(positions.collect(), faces)?;
        if shaded {
            let turned = |c: &Corner| {
                let normal = self.normals[c.normal as usize].as_dvec3().normalize();
                placement.sample_from_mesh.direction(normal).as_vec3()
            };
            let normals = used.iter().map(turned).collect();
            mesh = self.with_normals(mesh, normals, placement)?;
        }
        let turned = Topology::of(&mesh.positions_mm, &mesh.triangles).turned_edges();
        if turned > 0 {
            self.remarks.push(MeshRemark::Turned { edges: turned });
        }
        let named = |what| FileRemark {
            file: String::new(),
            what,
        };
        mesh.remarks = self.remarks.into_iter().map(named).collect();
        Ok(mesh)
    }

    fn check_corners(&self) -> Result<(), MeshError> {
        let vertices = self.vertices.len();
        let polygon = |at: usize| self.ends.partition_point(|&end| end <= at);
        if let Some(at) = (self.corners.iter()).position(|c| c.vertex as usize >= vertices) {
            return Err(MeshError::NoSuchVertex {
                facet: polygon(at),
                vertex: self.corners[at].vertex.into(),
                vertices,
            });
        }
        let broken = |c: &&Corner| !self.vertices[c.vertex as usize].is_finite();
        match self.corners.iter().find(broken) {
            Some(corner) => Err(self.not_finite(corner.vertex)),
            None => Ok(()),
        }
    }

    fn not_finite(&self, vertex: u32) -> MeshError {
        let line = self.broken_lines.iter().find(|(of, _)| *of == vertex);
        MeshError::NotFinite {
            location: match line {
                Some((_, line)) => format!("line {line}: vertex {vertex}"),
                None => format!("vertex {vertex}"),
            },
        }
    }

    /// All polygons cut into triangles.
    fn triangles(&mut self) -> Vec<[Corner; 3]> {
        let mut triangles = Vec::with_capacity(self.ends.len());
        let (mut flat, mut crossing) = (0, 0);
        let (mut positions, mut cut) = (Vec::new(), Vec::new());
        let mut start = 0;
        for &end in &self.ends {
            let mut corners = self.corners[start..end].to_vec();
            start = end;
            corners.dedup_by_key(|c| c.vertex);
            if corners.len() > 1 && corners[0].vertex == corners[corners.len() - 1].vertex {
                corners.pop();
            }
            if let [a, b, c] = corners[..] {
                triangles.push([a, b, c]);
                continue;
            }
            positions.clear();
            positions.extend(corners.iter().map(|c| self.vertices[c.vertex as usize]));
            cut.clear();
            match triangulate(&positions, &mut cut) {
                Cut::Whole => {}
                Cut::Crossing => crossing += 1,
                Cut::NoArea => flat += 1,
            }
            triangles.extend(cut.iter().map(|t| t.map(|k| corners[k])));
        }
        if crossing > 0 {
            let polygons = crossing;
            self.remarks.push(MeshRemark::Crossing { polygons });
        }
        if flat > 0 {
            self.remarks.push(MeshRemark::NoArea { facets: flat });
        }
        triangles
    }

    /// The triangles that have an area, each once.
    fn tidied(
        &mut self,
        mut triangles: Vec<[Corner; 3]>,
        positions_mm: &[Vec3],
    ) -> Result<Vec<[Corner; 3]>, MeshError> {
        let facets = self.ends.len();
        let before = triangles.len();
        triangles.retain(|t| has_area(t.map(|c| positions_mm[c.vertex as usize])));
        if triangles.is_empty() {
            return Err(MeshError::NoArea { facets });
        }
        let flat = before - triangles.len();
        if flat > 0 {
            // Together with polygons that had none as a whole.
            let earlier = self.remarks.iter_mut().find_map(|remark| match remark {
                MeshRemark::NoArea { facets } => Some(facets),
                _ => None,
            });
            match earlier {
                Some(facets) => *facets += flat,
                None => self.remarks.push(MeshRemark::NoArea { facets: flat }),
            }
        }
        let welded = welded(positions_mm);
        let (mut doubled, mut two_sided) = (0, 0);
        let mut known: HashSet<[u32; 3]> = HashSet::with_capacity(triangles.len());
        triangles.retain(|t| {
            let [a, b, c] = t.map(|corner| welded[corner.vertex as usize]);
            // Begun at its smallest position, which leaves the sense of rotation.
            let smallest = a.min(b).min(c);
            let front = match smallest {
                _ if smallest == a => [a, b, c],
                _ if smallest == b => [b, c, a],
                _ => [c, a, b],
            };
            let is_back_known = known.contains(&[front[0], front[2], front[1]]);
            let is_new = !is_back_known && known.insert(front);
            two_sided += usize::from(is_back_known);
            doubled += usize::from(!is_back_known && !is_new);
            is_new
        });
        if doubled > 0 {
            self.remarks.push(MeshRemark::Doubled { facets: doubled });
        }
        if two_sided > 0 {
            let facets = two_sided;
            self.remarks.push(MeshRemark::TwoSided { facets });
        }
        Ok(triangles)
    }

    /// Remarks on coordinates so far away that single precision makes steps of them, in the
    /// file or after its placement.
    fn remark_on_distance(
        &mut self,
        triangles: &[[Corner; 3]],
        positions_mm: &[Vec3],
        placement: &Placement,
    ) {
        let used = || triangles.iter().flatten().map(|c| c.vertex as usize);
        let in_file = || used().map(|v| self.vertices[v]);
        let placed = || used().map(|v| positions_mm[v].as_dvec3());
        let file = self.are_single.then(|| Steps::of(in_file())).flatten();
        let file = file.map(|steps| (steps, false));
        let placed = Steps::of(placed()).map(|steps| (steps, true));
        // The file's own, if the placement brings it back; else what is left of it.
        let of_file_mm = |steps: &Steps| steps.step * placement.mm_per_unit;
        let worst = match (file, placed) {
            (Some(file), Some(placed)) if of_file_mm(&file.0) < placed.0.step => Some(placed),
            (file, placed) => file.or(placed),
        };
        if let Some((steps, is_placed)) = worst {
            self.remarks.push(match is_placed {
                true => MeshRemark::PlacedFar(steps),
                false => MeshRemark::Far(steps),
            });
        }
    }

    /// Whether every corner has a normal of some length.
    fn are_normals_usable(&mut self, triangles: &[[Corner; 3]]) -> bool {
        let corners = || triangles.iter().flatten();
        if corners().all(|c| c.normal == NO_NORMAL) {
            return false;
        }
        let is_none = |c: &&Corner| {
            let normal = self.normals.get(c.normal as usize);
            normal.is_none_or(|n| n.as_dvec3().try_normalize().is_none())
        };
        match corners().find(is_none) {
            Some(corner) => {
                let vertex = corner.vertex as usize;
                self.remarks.push(MeshRemark::Normals { vertex });
                false
            }
            None => true,
        }
    }

    /// With normals that point to the facets' fronts, on the whole.
    fn with_normals(
        &mut self,
        mesh: Mesh,
        mut normals: Vec<Vec3>,
        placement: &Placement,
    ) -> Result<Mesh, MeshError> {
        let forward: f64 = mesh
            .triangles
            .iter()
            .map(|t| {
                let front = face_normal(t.map(|v| mesh.positions_mm[v as usize]));
                let along = t.map(|v| front.dot(normals[v as usize]).signum());
                f64::from(along.iter().sum::<f32>())
            })
            .sum();
        if forward < 0.0 {
            normals.iter_mut().for_each(|n| *n = -*n);
            if !placement.flip_facets {
                self.remarks.push(MeshRemark::NormalsTurned);
            }
        }
        mesh.with_normals(normals)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frames::Rigid;

    fn draft(vertices: &[[f64; 3]], polygons: &[&[u32]]) -> Draft {
        let mut draft = Draft {
            vertices: vertices.iter().map(|v| DVec3::from_array(*v)).collect(),
            ..Draft::default()
        };
        for polygon in polygons {
            draft
                .push(polygon.iter().map(|&v| Corner::bare(v)))
                .unwrap();
        }
        draft
    }

    const SQUARE: [[f64; 3]; 5] = [
        [f64::NAN, 0.0, 0.0],
        [0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [1.0, 1.0, 0.0],
        [0.0, 1.0, 0.0],
    ];

    fn whats(mesh: &Mesh) -> Vec<MeshRemark> {
        mesh.remarks.iter().map(|r| r.what.clone()).collect()
    }

    #[test]
    fn what_programs_leave_behind_is_left_out() {
        let polygons: [&[u32]; 7] = [
            &[1, 2, 3, 4],
            &[3, 4, 1],
            &[1, 3, 2],
            &[1, 1, 2],
            &[1, 2, 2, 1],
            &[2, 3],
            &[1, 2, 3],
        ];
        let mesh = draft(&SQUARE, &polygons)
            .mesh(&Placement::default())
            .unwrap();
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(mesh.positions_mm.len(), 4);
        assert_eq!(
            whats(&mesh),
            [
                MeshRemark::NoArea { facets: 3 },
                MeshRemark::Doubled { facets: 2 },
                MeshRemark::TwoSided { facets: 1 },
            ]
        );
    }

    #[test]
    fn a_turned_facet_is_remarked_on() {
        let mesh = draft(&SQUARE, &[&[1, 2, 3], &[1, 4, 3]]);
        let mesh = mesh.mesh(&Placement::default()).unwrap();
        assert_eq!(whats(&mesh), [MeshRemark::Turned { edges: 1 }]);
    }

    #[test]
    fn a_placement_scales_flips_turns_and_moves() {
        let placement = Placement {
            mm_per_unit: 1000.0,
            flip_facets: true,
            sample_from_mesh: Rigid::new(
                super::super::placement::rotation_xyz([90.0, 0.0, 0.0]),
                DVec3::new(0.0, 0.0, -1000.0),
            ),
        };
        let mesh = draft(&SQUARE, &[&[1, 2, 3]]).mesh(&placement).unwrap();
        let corner = mesh.corners(0)[1];
        assert!(
            (corner - Vec3::new(1000.0, 0.0, 0.0)).length() < 1e-3,
            "{corner}"
        );
        // z becomes −y, and the other side of it is the front.
        assert!((mesh.face_normal(0) - Vec3::Y).length() < 1e-6);
    }

    #[test]
    fn errors_name_facet_and_vertex() {
        let error = |polygon: &[u32]| {
            let made = draft(&SQUARE, &[&[1, 2, 3], polygon]).mesh(&Placement::default());
            made.unwrap_err().to_string()
        };
        assert_eq!(
            error(&[1, 2, 9]),
            "facet 1 refers to vertex 9, but there are 5"
        );
        assert_eq!(
            error(&[0, 1, 2]),
            "vertex 0 has a coordinate that is not finite, and a facet uses it"
        );
        let none = draft(&SQUARE, &[&[1, 1, 2]]).mesh(&Placement::default());
        assert!(matches!(none, Err(MeshError::NoArea { facets: 1 })));
        let none = draft(&SQUARE, &[]).mesh(&Placement::default());
        assert!(matches!(none, Err(MeshError::Empty { vertices: 5 })));
    }

    /// What single precision has taken, in the file or by the placement, is remarked on.
    #[test]
    fn coarse_coordinates_are_remarked_on() {
        let at = |x: f64, moved: f64, are_single: bool| {
            let far = [[x, 0.0, 0.0], [x + 20.0, 0.0, 0.0], [x, 20.0, 0.0]];
            let mut draft = draft(&far, &[&[0, 1, 2]]);
            draft.are_single = are_single;
            let placement = Placement {
                sample_from_mesh: Rigid::new(glam::DQuat::IDENTITY, DVec3::new(moved, 0.0, 0.0)),
                ..Placement::default()
            };
            let mesh = draft.mesh(&placement).unwrap();
            whats(&mesh)
                .iter()
                .map(MeshRemark::to_string)
                .collect::<Vec<_>>()
                .join("\n")
        };
        let said = at(4e6, 0.0, true);
        assert!(
            said.contains("reach 4000020, where 32-bit numbers are 0.25 apart, 1.25% of the mesh's size of 20 (in the file's unit)"),
            "{said}"
        );
        assert_eq!(
            at(4e6, -4e6, true),
            said,
            "moving it back brings no digits back"
        );
        assert!(at(4e6, 0.0, false).contains("of 20 (mm); `translate_mm`"));
        assert_eq!(at(4e6, -4e6, false), "");
        assert_eq!(at(1000.0, 0.0, true), "");
    }

    /// Far from the file's origin a coordinate keeps its digits where the placement brings
    /// it back.
    #[test]
    fn coordinates_far_away_keep_their_digits() {
        let far = [
            [500_000.001, 0.0, 0.0],
            [500_000.002, 0.0, 0.0],
            [500_000.001, 0.001, 0.0],
        ];
        let placement = Placement {
            sample_from_mesh: Rigid::new(glam::DQuat::IDENTITY, DVec3::new(-500_000.0, 0.0, 0.0)),
            ..Placement::default()
        };
        let mesh = draft(&far, &[&[0, 1, 2]]).mesh(&placement).unwrap();
        assert!((mesh.positions_mm[1].x - 0.002).abs() < 1e-7);
    }
}
