//! Which facets meet in which edges, by the positions of the edges' ends: files repeat
//! vertices where normals or colours differ.

use std::collections::HashMap;

use glam::Vec3;

/// One facet's side of an edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Side {
    /// Smaller end.
    low: u32,
    /// Larger end.
    high: u32,
    /// The facet.
    pub facet: u32,
    /// The corner of the facet, 0 to 2, from which the side runs to the next corner.
    pub corner: u8,
    /// Whether it runs from the larger end to the smaller.
    pub is_back: bool,
}

impl Side {
    /// The positions from which and to which it runs.
    pub fn ends(&self) -> [u32; 2] {
        match self.is_back {
            true => [self.high, self.low],
            false => [self.low, self.high],
        }
    }
}

/// Facets and their edges.
pub struct Topology {
    /// By vertex, the first vertex at the same position.
    pub welded: Vec<u32>,
    sides: Vec<Side>,
}

impl Topology {
    /// Of triangles over these positions.
    pub fn of(positions: &[Vec3], triangles: &[[u32; 3]]) -> Self {
        let welded = welded(positions);
        let mut sides: Vec<Side> = Vec::with_capacity(3 * triangles.len());
        for (facet, corners) in (0..).zip(triangles) {
            for corner in 0..3 {
                let [a, b] = [corner, (corner + 1) % 3].map(|k| welded[corners[k] as usize]);
                sides.push(Side {
                    low: a.min(b),
                    high: a.max(b),
                    facet,
                    corner: corner as u8,
                    is_back: a > b,
                });
            }
        }
        sides.sort_unstable();
        Self { welded, sides }
    }

    /// The sides of each edge.
    pub fn edges(&self) -> impl Iterator<Item = &[Side]> {
        self.sides
            .chunk_by(|a, b| (a.low, a.high) == (b.low, b.high))
    }

    /// Edges of two facets that face the same way.
    pub fn pairs(&self) -> impl Iterator<Item = [Side; 2]> {
        self.edges().filter_map(|edge| match edge {
            &[a, b] if a.is_back != b.is_back => Some([a, b]),
            _ => None,
        })
    }

    /// Edges at which two facets face opposite ways.
    pub fn turned_edges(&self) -> usize {
        let is_turned = |edge: &&[Side]| matches!(edge, [a, b] if a.is_back == b.is_back);
        self.edges().filter(is_turned).count()
    }

    /// Edges of more than two facets.
    pub fn crowded_edges(&self) -> usize {
        self.edges().filter(|edge| edge.len() > 2).count()
    }

    /// The edges of one facet joined to chains of positions, each closed where it can be; they
    /// run as their facets do.
    pub fn borders(&self) -> Vec<Vec<u32>> {
        let open = self.edges().filter(|edge| edge.len() == 1);
        chains(open.map(|edge| edge[0].ends()))
    }
}

/// Edges joined to chains, in their order. A chain runs as most of its edges do: some may be
/// those of facets that are turned.
pub fn chains(edges: impl Iterator<Item = [u32; 2]>) -> Vec<Vec<u32>> {
    let edges: Vec<[u32; 2]> = edges.collect();
    let mut at: HashMap<u32, Vec<usize>> = HashMap::new();
    for (index, ends) in edges.iter().enumerate() {
        ends.iter()
            .for_each(|end| at.entry(*end).or_default().push(index));
    }
    let mut is_used = vec![false; edges.len()];
    let mut chains = Vec::new();
    for first in 0..edges.len() {
        if is_used[first] {
            continue;
        }
        let (mut chain, mut end) = (Vec::new(), edges[first][0]);
        let mut forward = 0i64;
        // Where chains touch, one that runs on is preferred.
        while let Some(index) = at
            .get(&end)
            .and_then(|there| {
                let mut free = there.iter().filter(|&&index| !is_used[index]);
                free.clone()
                    .find(|&&index| edges[index][0] == end)
                    .or_else(|| free.next())
            })
            .copied()
        {
            is_used[index] = true;
            chain.push(end);
            let [from, to] = edges[index];
            forward += if from == end { 1 } else { -1 };
            end = if from == end { to } else { from };
        }
        if forward < 0 {
            chain.reverse();
        }
        chains.push(chain);
    }
    chains
}

/// By vertex, the first vertex at exactly the same position.
pub fn welded(positions: &[Vec3]) -> Vec<u32> {
    let mut first_at = HashMap::with_capacity(positions.len());
    let position = |(vertex, p): (u32, &Vec3)| {
        // Adding 0 makes −0 and 0 one position.
        let key = (*p + Vec3::ZERO).to_array().map(f32::to_bits);
        *first_at.entry(key).or_insert(vertex)
    };
    (0..).zip(positions).map(position).collect()
}

/// Sets that are joined step by step.
pub struct Groups(Vec<u32>);

impl Groups {
    /// Each of `count` alone.
    pub fn new(count: usize) -> Self {
        Self((0..count as u32).collect())
    }

    /// The smallest member of its set.
    pub fn root(&mut self, mut of: u32) -> u32 {
        while self.0[of as usize] != of {
            // Halves the way for the next search.
            self.0[of as usize] = self.0[self.0[of as usize] as usize];
            of = self.0[of as usize];
        }
        of
    }

    /// Joins the sets of two members.
    pub fn join(&mut self, a: u32, b: u32) {
        let [a, b] = [a, b].map(|member| self.root(member));
        self.0[a.max(b) as usize] = a.min(b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Shape;

    #[test]
    fn a_bowl_has_one_border_and_a_sphere_none() {
        let borders = |shape: Shape| {
            let mesh = shape.mesh().unwrap();
            let topology = Topology::of(&mesh.positions_mm, &mesh.triangles);
            assert_eq!(topology.turned_edges(), 0);
            assert_eq!(topology.crowded_edges(), 0);
            topology.borders()
        };
        let (radius_mm, segments) = (1.0, 16);
        let bowl = borders(Shape::Bowl {
            radius_mm,
            segments,
        });
        assert_eq!(bowl.iter().map(Vec::len).collect::<Vec<_>>(), [16]);
        assert!(
            borders(Shape::Sphere {
                radius_mm,
                segments
            })
            .is_empty()
        );
    }

    #[test]
    fn a_turned_facet_leaves_a_border_whole() {
        let around = chains([[3, 0], [0, 1], [2, 1], [2, 3]].into_iter());
        assert_eq!(around, [[3, 0, 1, 2]]);
    }

    #[test]
    fn turned_and_crowded_edges_are_counted() {
        let positions = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z, Vec3::ONE];
        let turned = Topology::of(&positions, &[[0, 1, 2], [0, 1, 3]]);
        assert_eq!((turned.turned_edges(), turned.crowded_edges()), (1, 0));
        let crowded = Topology::of(&positions, &[[0, 1, 2], [1, 0, 3], [0, 1, 4]]);
        assert_eq!((crowded.turned_edges(), crowded.crowded_edges()), (0, 1));
    }
}
