//! Normals for smooth shading of a mesh that has none.

use glam::Vec3;

use super::mesh::Mesh;
use super::mesh_error::MeshRemark;
use super::topology::{Groups, Topology};

/// Facets that turn by this angle or more from one to the next meet in a crease, degrees,
/// where nothing else is stated. Chamfers of 45° stay sharp, a bowl of sixteen facets around
/// becomes smooth.
pub const DEFAULT_CREASE_DEG: f64 = 30.0;

impl Mesh {
    /// With normals at the corners, each the mean of the normals of the facets around it,
    /// weighted by their angles there (Thürmer and Wüthrich 1998), on this side of creases:
    /// edges at which facets turn by `crease_rad` or more. A remark says where edges that
    /// may not be meant as creases stay sharp.
    pub fn smoothed(&self, crease_rad: f32) -> (Self, Option<MeshRemark>) {
        let topology = Topology::of(&self.positions_mm, &self.triangles);
        let fronts: Vec<Vec3> = (0..self.triangles.len())
            .map(|t| self.face_normal(t))
            .collect();

        // Corners at one position belong together across every edge that is no crease.
        let mut groups = Groups::new(3 * self.triangles.len());
        let (mut all, mut sharp) = (0, 0);
        let (mut least, mut most) = (f32::INFINITY, 0.0f32);
        for [one, two] in topology.pairs() {
            let turn = fronts[one.facet as usize].angle_between(fronts[two.facet as usize]);
            all += 1;
            if turn < crease_rad {
                // One's start is the other's end.
                let start = |side: super::topology::Side| 3 * side.facet + u32::from(side.corner);
                let end =
                    |side: super::topology::Side| 3 * side.facet + (u32::from(side.corner) + 1) % 3;
                groups.join(start(one), end(two));
                groups.join(end(one), start(two));
            } else if turn < Self::CREASE_RAD {
                sharp += 1;
                least = least.min(turn);
                most = most.max(turn);
            }
        }

        // One vertex for each group, in the order of the corners.
        let mut vertex_of = vec![u32::MAX; 3 * self.triangles.len()];
        let (mut positions_mm, mut sums) = (Vec::new(), Vec::new());
        let mut triangles = self.triangles.clone();
        for (facet, corners) in triangles.iter_mut().enumerate() {
            let positions = self.corners(facet);
            for k in 0..3 {
                let root = groups.root((3 * facet + k) as u32) as usize;
                if vertex_of[root] == u32::MAX {
                    vertex_of[root] = positions_mm.len() as u32;
                    positions_mm.push(positions[k]);
                    sums.push(Vec3::ZERO);
                }
                corners[k] = vertex_of[root];
                let [along, back] = [positions[(k + 1) % 3], positions[(k + 2) % 3]]
                    .map(|other| (other - positions[k]).normalize_or_zero());
                let angle = along.cross(back).length().atan2(along.dot(back));
                sums[corners[k] as usize] += fronts[facet] * angle;
            }
        }
        let mut normals: Vec<Vec3> = sums.iter().map(|sum| sum.normalize_or_zero()).collect();
        for (facet, corners) in triangles.iter().enumerate() {
            for &vertex in corners {
                if normals[vertex as usize] == Vec3::ZERO {
                    normals[vertex as usize] = fronts[facet];
                }
            }
        }
        let remark = (sharp > 0).then(|| MeshRemark::SharpEdges {
            edges: sharp,
            all,
            least_deg: least.to_degrees(),
            most_deg: most.to_degrees(),
            crease_deg: crease_rad.to_degrees(),
        });
        let mesh = Self {
            positions_mm,
            triangles,
            normals: Some(normals),
            remarks: self.remarks.clone(),
        };
        (mesh, remark)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Shape;

    const CREASE_RAD: f32 = 30.0 * std::f32::consts::PI / 180.0;

    fn bare(shape: Shape) -> Mesh {
        Mesh {
            normals: None,
            ..shape.mesh().unwrap()
        }
    }

    #[test]
    fn a_bowl_gets_nearly_the_spheres_normals() {
        let bowl = bare(Shape::Bowl {
            radius_mm: 2.0,
            segments: 64,
        });
        let (smooth, remark) = bowl.smoothed(CREASE_RAD);
        assert_eq!(remark, None);
        assert_eq!(smooth.positions_mm.len(), bowl.positions_mm.len());
        let normals = smooth.normals.unwrap();
        for (p, n) in smooth.positions_mm.iter().zip(&normals) {
            // The rim has facets on one side alone: half a facet, 2.8°.
            let off = n.angle_between(-*p);
            let most: f32 = if p.z.abs() < 1e-6 { 3.0 } else { 0.3 };
            assert!(off < most.to_radians(), "{p}: {}", off.to_degrees());
        }
    }

    #[test]
    fn creases_stay_sharp() {
        let corner = bare(Shape::Tetrahedron {
            radius_mm: 1.0,
            depth_mm: 0.7,
        });
        let (smooth, remark) = corner.smoothed(CREASE_RAD);
        assert_eq!(remark, None, "90° is a crease for anyone");
        for facet in 0..3 {
            for vertex in smooth.triangles[facet] {
                let normal = smooth.normals.as_ref().unwrap()[vertex as usize];
                assert!(normal.dot(corner.face_normal(facet)) > 0.9999);
            }
        }
        let coarse = bare(Shape::Bowl {
            radius_mm: 1.0,
            segments: 8,
        });
        let (_, remark) = coarse.smoothed(CREASE_RAD);
        assert!(
            matches!(remark, Some(MeshRemark::SharpEdges { .. })),
            "{remark:?}"
        );
        let (_, remark) = coarse.smoothed(1.0);
        assert_eq!(remark, None);
    }

    #[test]
    fn a_turned_facet_spoils_no_normal_around_it() {
        let mut bowl = bare(Shape::Bowl {
            radius_mm: 1.0,
            segments: 32,
        });
        bowl.triangles[40].swap(1, 2);
        let (smooth, _) = bowl.smoothed(CREASE_RAD);
        for facet in 0..smooth.triangles.len() {
            for vertex in smooth.triangles[facet] {
                let normal = smooth.normals.as_ref().unwrap()[vertex as usize];
                assert!(normal.dot(smooth.face_normal(facet)) > 0.9, "{facet}");
            }
        }
    }
}
