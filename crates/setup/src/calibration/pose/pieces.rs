//! A mesh taken apart at its creases: within a piece the surface bends gently, so its
//! radiance changes gently too.

use std::collections::HashMap;

use crate::geometry::Mesh;
use crate::geometry::topology::{Groups, Topology};

/// For each triangle the number of its piece, from 0. Triangles belong together where
/// they share an edge, by the positions of its ends, at less than [`Mesh::CREASE_RAD`].
pub fn smooth_pieces(mesh: &Mesh) -> Vec<u32> {
    let mut groups = Groups::new(mesh.triangles.len());
    for [one, two] in Topology::of(&mesh.positions_mm, &mesh.triangles).pairs() {
        let [a, b] = [one, two].map(|side| mesh.face_normal(side.facet as usize));
        if a.angle_between(b) < Mesh::CREASE_RAD {
            groups.join(one.facet, two.facet);
        }
    }
    let mut number = HashMap::new();
    (0..mesh.triangles.len() as u32)
        .map(|triangle| {
            let next = number.len() as u32;
            *number.entry(groups.root(triangle)).or_insert(next)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Shape;
    use crate::geometry::shapes::Profile;

    #[test]
    fn creases_separate_and_curves_do_not() {
        let count = |shape: Shape| {
            let pieces = smooth_pieces(&shape.mesh().unwrap());
            pieces.into_iter().max().unwrap() + 1
        };
        let corner = Shape::Tetrahedron {
            radius_mm: 1.0,
            depth_mm: 0.7,
        };
        assert_eq!(count(corner), 3);
        let bowl = Shape::Bowl {
            radius_mm: 1.0,
            segments: 32,
        };
        assert_eq!(count(bowl), 1);
        let groove = Shape::Groove {
            radius_mm: 1.0,
            width_mm: 0.6,
            profile: Profile::Vee { depth_mm: 0.3 },
            segments: 64,
        };
        assert_eq!(count(groove), 2);
    }
}
