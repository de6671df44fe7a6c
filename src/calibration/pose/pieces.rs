//! A mesh taken apart at its creases: within a piece the surface bends gently, so its
//! radiance changes gently too.

use std::collections::HashMap;

use glam::Vec3;

use crate::geometry::Mesh;

/// For each triangle the number of its piece, from 0. Triangles belong together where
/// they share an edge, by the places of its ends, at less than [`Mesh::CREASE_RAD`].
pub fn smooth_pieces(mesh: &Mesh) -> Vec<u32> {
    // Adding 0 makes −0 and 0 one place.
    let place = |v: u32| (mesh.positions_mm[v as usize] + Vec3::ZERO).to_array();
    let key = |v: u32| place(v).map(f32::to_bits);
    let mut parent: Vec<u32> = (0..mesh.triangles.len() as u32).collect();
    let mut edges = HashMap::new();
    for (triangle, corners) in mesh.triangles.iter().enumerate() {
        let normal = mesh.face_normal(triangle);
        for i in 0..3 {
            let (a, b) = (key(corners[i]), key(corners[(i + 1) % 3]));
            match edges.remove(&(b, a)) {
                Some(other) => {
                    if normal.angle_between(mesh.face_normal(other)) < Mesh::CREASE_RAD {
                        let [one, two] = [triangle, other].map(|t| root(&mut parent, t as u32));
                        parent[one.max(two) as usize] = one.min(two);
                    }
                }
                None => {
                    edges.insert((a, b), triangle);
                }
            }
        }
    }
    let mut number = HashMap::new();
    (0..mesh.triangles.len() as u32)
        .map(|triangle| {
            let next = number.len() as u32;
            *number.entry(root(&mut parent, triangle)).or_insert(next)
        })
        .collect()
}

fn root(parent: &mut [u32], mut of: u32) -> u32 {
    while parent[of as usize] != of {
        // Halves the way for the next search.
        parent[of as usize] = parent[parent[of as usize] as usize];
        of = parent[of as usize];
    }
    of
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
