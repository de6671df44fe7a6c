//! From the binary tree to the wide one.

use glam::Vec3;
use obvhs::bvh2::Bvh2;

use super::{Bvh, EMPTY, LEAF, LEAF_BIT, Leaf, Node, WIDTH};
use crate::geometry::Mesh;

/// Turns the binary tree into the wide one with the least expected cost of a query:
/// areas of visited boxes, weighted by what a visit costs (dynamic programming after
/// Ylitie, Karras, Laine 2017, section 3.3).
pub(super) struct Collapse<'a> {
    tree: &'a Bvh2,
    mesh: &'a Mesh,
    /// Added to all boxes, millimetres: the rounding of their own coordinates.
    grow: f32,
    /// `costs[n][j − 1]`: the binary subtree n as at most j children of a wide node.
    costs: Vec<[f32; WIDTH]>,
    /// Triangles below each binary node.
    triangles: Vec<u32>,
}

/// Cost of testing a leaf's triangles over that of testing a node's boxes.
const LEAF_COST: f32 = 0.8;

impl<'a> Collapse<'a> {
    fn children(&self, n: usize) -> Option<[usize; 2]> {
        let node = &self.tree.nodes[n];
        let first = node.first_index as usize;
        (!node.is_leaf()).then_some([first, first + 1])
    }

    /// Prices every subtree of `tree`; boxes will be grown by `grow` millimetres.
    pub(super) fn new(tree: &'a Bvh2, mesh: &'a Mesh, grow: f32) -> Self {
        let mut collapse = Self {
            tree,
            mesh,
            grow,
            costs: vec![[0.0; WIDTH]; tree.nodes.len()],
            triangles: vec![0; tree.nodes.len()],
        };
        collapse.price(0);
        collapse
    }

    /// Fills `costs` and `triangles` of the subtree at n.
    fn price(&mut self, n: usize) {
        let area = self.tree.nodes[n].aabb().half_area();
        let Some([a, b]) = self.children(n) else {
            self.triangles[n] = self.tree.nodes[n].prim_count;
            self.costs[n] = [area * LEAF_COST; WIDTH];
            return;
        };
        self.price(a);
        self.price(b);
        self.triangles[n] = self.triangles[a] + self.triangles[b];
        let mut costs = [0.0; WIDTH];
        costs[0] = area + self.divide(a, b, WIDTH).0;
        if self.triangles[n] <= LEAF as u32 {
            costs[0] = costs[0].min(area * LEAF_COST);
        }
        for j in 2..=WIDTH {
            costs[j - 1] = costs[j - 2].min(self.divide(a, b, j).0);
        }
        self.costs[n] = costs;
    }

    /// The cheapest way to share `j` children between two subtrees: cost, share of the first.
    fn divide(&self, a: usize, b: usize, j: usize) -> (f32, usize) {
        (1..j)
            .map(|k| (self.costs[a][k - 1] + self.costs[b][j - k - 1], k))
            .fold((f32::INFINITY, 1), |best, other| {
                if other.0 < best.0 { other } else { best }
            })
    }

    /// The roots of at most `j` children that the subtree at n becomes.
    fn gather(&self, n: usize, j: usize, members: &mut Vec<usize>) {
        match self.children(n) {
            Some([a, b]) if j > 1 && self.costs[n][j - 1] < self.costs[n][0] => {
                let k = self.divide(a, b, j).1;
                self.gather(a, k, members);
                self.gather(b, j - k, members);
            }
            _ => members.push(n),
        }
    }

    /// Whether the subtree at n is cheapest as one leaf.
    fn is_leaf(&self, n: usize) -> bool {
        let area = self.tree.nodes[n].aabb().half_area();
        self.triangles[n] <= LEAF as u32 && self.costs[n][0] >= area * LEAF_COST
    }

    /// Makes the wide node of the binary one and returns its reference.
    pub(super) fn node(&self, root: usize, bvh: &mut Bvh) -> u32 {
        let mut members = Vec::with_capacity(WIDTH);
        match self.children(root) {
            Some([a, b]) => {
                let k = self.divide(a, b, WIDTH).1;
                self.gather(a, k, &mut members);
                self.gather(b, WIDTH - k, &mut members);
            }
            None => members.push(root),
        }
        // Leaves last: any-hit queries take the last first.
        members.sort_by_key(|&member| self.is_leaf(member));
        let index = bvh.nodes.len();
        bvh.nodes.push(Node {
            bounds: std::array::from_fn(|side| {
                [if side < 3 {
                    f32::INFINITY
                } else {
                    f32::NEG_INFINITY
                }; WIDTH]
            }),
            child: [EMPTY; WIDTH],
        });
        for (slot, &member) in members.iter().enumerate() {
            let child = if self.is_leaf(member) {
                self.leaf(member, bvh)
            } else {
                self.node(member, bvh)
            };
            let aabb = self.tree.nodes[member].aabb();
            let wide = &mut bvh.nodes[index];
            let [low, high] = [aabb.min, aabb.max].map(Vec3::from);
            wide.set_bounds(slot, low - self.grow, high + self.grow);
            wide.child[slot] = child;
        }
        index as u32
    }

    fn leaf(&self, root: usize, bvh: &mut Bvh) -> u32 {
        let mut leaf = Leaf {
            corner: [[[f32::NAN; LEAF]; 3]; 3],
            triangle: [EMPTY; LEAF],
        };
        let mut lane = 0;
        let mut open = vec![root];
        while let Some(n) = open.pop() {
            if let Some(children) = self.children(n) {
                open.extend(children);
                continue;
            }
            let node = &self.tree.nodes[n];
            let first = node.first_index as usize;
            let below = &self.tree.primitive_indices[first..first + node.prim_count as usize];
            for &triangle in below {
                leaf.triangle[lane] = triangle;
                leaf.place(lane, self.mesh.corners(triangle as usize));
                lane += 1;
            }
        }
        bvh.leaves.push(leaf);
        (bvh.leaves.len() - 1) as u32 | LEAF_BIT
    }
}
