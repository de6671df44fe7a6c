//! Seams: open edges whose vertices nearly meet, where a surface of revolution closes or two
//! patches are joined and rounding has left their vertices apart.

use std::collections::HashMap;

use glam::Vec3;

use super::topology::{Groups, Topology};

/// Vertices this near are one, of the mesh's size: what the rounding of a file's numbers makes.
const ROUNDING: f32 = 1e-5;
/// Vertices this near nearly meet, of the mesh's size.
const NEAR: f32 = 1e-3;
/// Both only within this part of the shortest open edge at them.
const OF_EDGE: f32 = 0.05;
/// Most vertices of one cell that are compared.
const PER_CELL: usize = 64;

/// Vertices of open edges that nearly meet another and were left apart.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OpenSeam {
    /// How many.
    pub vertices: usize,
    /// The largest distance among them, of the mesh's size.
    pub apart: f32,
}

/// Moves vertices of open edges that differ from others by rounding onto these.
pub fn close(positions: &mut [Vec3], triangles: &[[u32; 3]]) -> Option<OpenSeam> {
    let topology = Topology::of(positions, triangles);
    // How far each vertex of an open edge is looked around.
    let used = || triangles.iter().flatten().map(|&v| positions[v as usize]);
    let [low, high] = used().fold([Vec3::INFINITY, Vec3::NEG_INFINITY], |[low, high], p| {
        [low.min(p), high.max(p)]
    });
    let size = (high - low).max_element();
    let mut reach: HashMap<u32, f32> = HashMap::new();
    for side in topology.edges().filter(|edge| edge.len() == 1) {
        let ends = side[0].ends();
        let length = positions[ends[0] as usize].distance(positions[ends[1] as usize]);
        for end in ends {
            let reach = reach.entry(end).or_insert(NEAR * size);
            *reach = reach.min(OF_EDGE * length);
        }
    }
    let mut open: Vec<(u32, f32)> = reach
        .into_iter()
        .filter(|(_, reach)| *reach > 0.0)
        .collect();
    open.sort_unstable_by_key(|(vertex, _)| *vertex);
    let cell = open
        .iter()
        .fold(0.0f32, |most, (_, reach)| most.max(*reach));

    // The nearest earlier vertex of each, by cells of that width.
    let mut groups = Groups::new(positions.len());
    let mut cells: HashMap<[i64; 3], Vec<(u32, f32)>> = HashMap::new();
    let mut seam = OpenSeam {
        vertices: 0,
        apart: 0.0,
    };
    let mut joined = false;
    for (vertex, reach) in open {
        let at = positions[vertex as usize];
        let from_low = at.as_dvec3() - low.as_dvec3();
        let [x, y, z] = (from_low / f64::from(cell)).to_array().map(|c| c as i64);
        let step = |from: i64, k: i64| from.wrapping_add(k % 3 - 1);
        let around = (0..27).map(|k| [step(x, k), step(y, k / 3), step(z, k / 9)]);
        let near = around
            .filter_map(|key| cells.get(&key))
            .flatten()
            .map(|(other, their)| {
                (
                    at.distance(positions[*other as usize]),
                    *other,
                    reach.min(*their),
                )
            })
            .filter(|(distance, _, allowed)| distance <= allowed)
            .min_by(|a, b| a.0.total_cmp(&b.0));
        match near {
            Some((distance, other, _)) if distance <= ROUNDING * size => {
                groups.join(vertex, other);
                joined = true;
            }
            Some((distance, _, _)) => {
                seam.vertices += 1;
                seam.apart = seam.apart.max(distance / size);
            }
            None => {}
        }
        let here = cells.entry([x, y, z]).or_default();
        if here.len() < PER_CELL {
            here.push((vertex, reach));
        }
    }
    if joined {
        // Of each group the first stays where it is.
        for (vertex, first) in topology.welded.iter().enumerate() {
            positions[vertex] = positions[groups.root(*first) as usize];
        }
    }
    (seam.vertices > 0).then_some(seam)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Shape;

    /// A bowl cut along a meridian, one side of the cut moved.
    fn cut(by_mm: f32) -> (Vec<Vec3>, Vec<[u32; 3]>) {
        let bowl = Shape::Bowl {
            radius_mm: 10.0,
            segments: 32,
        };
        let bowl = bowl.mesh().unwrap();
        let mut positions = bowl.positions_mm.clone();
        let mut triangles = bowl.triangles.clone();
        for (facet, corners) in triangles.iter_mut().enumerate() {
            let middle = bowl.corners(facet).iter().sum::<Vec3>() / 3.0;
            for corner in corners.iter_mut().filter(|_| middle.y < 0.0) {
                let p = bowl.positions_mm[*corner as usize];
                if p.y.abs() < 1e-4 && p.x > 1e-4 {
                    positions.push(p + by_mm * Vec3::Y);
                    *corner = positions.len() as u32 - 1;
                }
            }
        }
        (positions, triangles)
    }

    #[test]
    fn a_seam_of_rounding_is_closed() {
        let borders = |positions: &[Vec3], triangles: &[[u32; 3]]| {
            let borders = Topology::of(positions, triangles).borders();
            borders.iter().map(Vec::len).collect::<Vec<_>>()
        };
        for (by_mm, closes) in [(1e-6, true), (5e-5, true), (2e-3, false), (0.5, false)] {
            let (mut positions, triangles) = cut(by_mm);
            assert_ne!(borders(&positions, &triangles), [32], "{by_mm}");
            let before = positions.clone();
            let left = close(&mut positions, &triangles);
            assert_eq!(borders(&positions, &triangles) == [32], closes, "{by_mm}");
            assert_eq!(positions == before, !closes);
            assert_eq!(left.is_some(), by_mm == 2e-3, "{by_mm}: {left:?}");
            if let Some(seam) = left {
                assert!((seam.apart - 1e-4).abs() < 1e-5, "{seam:?}");
            }
        }
        // Without open edges nothing moves.
        let (mut positions, triangles) = cut(0.0);
        assert_eq!(close(&mut positions, &triangles), None);
    }
}
