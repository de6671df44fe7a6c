//! Watertight ray queries over triangles.
//!
//! obvhs builds the binary tree; it is collapsed into nodes of eight boxes and
//! leaves of four triangles, which fit the lanes of AVX2. Boxes are grown so that
//! rounding never loses a triangle (Ize 2013); triangles are tested with Woop's
//! sheared edge functions (Woop, Benthin, Wald 2013): a ray that meets a shared
//! edge hits at least one of its triangles.

mod collapse;
mod lanes;

use std::mem::MaybeUninit;

use glam::{DVec3, Vec3, Vec3A};
use obvhs::BvhBuildParams;
use obvhs::aabb::Aabb;
use obvhs::bvh2::builder::build_bvh2;

use super::mesh::Mesh;
use collapse::Collapse;
#[cfg(target_arch = "x86_64")]
use lanes::Avx2;
use lanes::{Instructions, Portable, Prepared, on_an_edge};

/// A half line from `origin_mm` along the unit vector `direction`, up to `limit_mm`.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    /// Start, millimetres.
    pub origin_mm: Vec3,
    /// Unit vector.
    pub direction: Vec3,
    /// Hits farther than this are ignored, millimetres.
    pub limit_mm: f32,
}

/// Where a ray meets a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance from the ray's origin, millimetres.
    pub distance_mm: f32,
    /// Index into the mesh's triangles.
    pub triangle: u32,
    /// Barycentric weights of the triangle's second and third corner.
    pub barycentric: [f32; 2],
}

const WIDTH: usize = 8;
const LEAF: usize = 4;
const LEAF_BIT: u32 = 1 << 31;
const EMPTY: u32 = u32::MAX;
/// Deepest stack: seven pushes per level, and trees of 20 M triangles stay below 40 levels.
const STACK: usize = 320;

/// Eight child boxes; bounds[axis] are the low sides, bounds[axis + 3] the high ones.
#[repr(C, align(64))]
#[derive(Clone)]
struct Node {
    bounds: [[f32; WIDTH]; 6],
    child: [u32; WIDTH],
}

impl Node {
    fn set_bounds(&mut self, slot: usize, low: Vec3, high: Vec3) {
        for axis in 0..3 {
            self.bounds[axis][slot] = low[axis];
            self.bounds[axis + 3][slot] = high[axis];
        }
    }

    /// The box around all children; empty slots are infinitely small.
    fn bounds(&self) -> (Vec3, Vec3) {
        let side = |k: usize, pick: fn(f32, f32) -> f32| {
            self.bounds[k].into_iter().reduce(pick).unwrap_or(f32::NAN)
        };
        (
            Vec3::from_array([0, 1, 2].map(|k| side(k, f32::min))),
            Vec3::from_array([3, 4, 5].map(|k| side(k, f32::max))),
        )
    }
}

/// Four triangles; corner[k][axis][lane]. Unused lanes hold NaN, which meets nothing.
#[repr(C, align(16))]
#[derive(Clone)]
struct Leaf {
    corner: [[[f32; LEAF]; 3]; 3],
    triangle: [u32; LEAF],
}

impl Leaf {
    fn place(&mut self, lane: usize, corners: [Vec3; 3]) {
        for (corner, p) in self.corner.iter_mut().zip(corners) {
            for axis in 0..3 {
                corner[axis][lane] = p[axis];
            }
        }
    }

    fn corners(&self, lane: usize) -> [DVec3; 3] {
        self.corner
            .map(|corner| DVec3::from_array(corner.map(|axis| f64::from(axis[lane]))))
    }

    /// Distance along the ray to a triangle's plane. In f64: in f32 that to a triangle a
    /// thousand times as long as wide is off by more than rays are set off the surface they
    /// leave, and they would meet it again.
    #[inline(always)]
    fn distance_mm(&self, lane: usize, ray: &Ray) -> f32 {
        let [a, b, c] = self.corners(lane);
        let normal = (b - a).cross(c - a);
        let to_plane = normal.dot(a - ray.origin_mm.as_dvec3());
        (to_plane / normal.dot(ray.direction.as_dvec3())) as f32
    }

    /// Barycentric weights of a triangle's second and third corner where the ray meets its
    /// plane, within the triangle.
    #[inline(always)]
    fn barycentric(&self, lane: usize, ray: &Ray) -> [f32; 2] {
        let [a, b, c] = self.corners(lane);
        let (d, from_a) = (ray.direction.as_dvec3(), ray.origin_mm.as_dvec3() - a);
        let across = d.cross(c - a);
        let over = 1.0 / (b - a).dot(across);
        let second = (from_a.dot(across) * over).clamp(0.0, 1.0);
        let third = d.dot(from_a.cross(b - a)) * over;
        [second as f32, third.clamp(0.0, 1.0 - second) as f32]
    }

    /// The box around its triangles; unused lanes are NaN, which min and max pass over.
    fn bounds(&self) -> (Vec3, Vec3) {
        let over = |axis: usize, pick: fn(f32, f32) -> f32, start: f32| {
            let corners = self.corner.iter().flat_map(|corner| corner[axis]);
            corners.fold(start, pick)
        };
        (
            Vec3::from_array([0, 1, 2].map(|axis| over(axis, f32::min, f32::INFINITY))),
            Vec3::from_array([0, 1, 2].map(|axis| over(axis, f32::max, f32::NEG_INFINITY))),
        )
    }
}

/// The tree over one mesh.
pub struct Bvh {
    nodes: Vec<Node>,
    leaves: Vec<Leaf>,
    /// Added to all boxes, millimetres.
    grow: f32,
    avx2: bool,
}

impl Bvh {
    /// Builds the tree; about a second per million triangles.
    pub fn new(mesh: &Mesh) -> Self {
        let boxes: Vec<Aabb> = (0..mesh.triangles.len())
            .map(|i| {
                let [a, b, c] = mesh.corners(i).map(Vec3A::from);
                Aabb::new(a.min(b).min(c), a.max(b).max(c))
            })
            .collect();
        let mut params = BvhBuildParams::medium_build();
        params.max_prims_per_leaf = 1;
        // A thorough search for a better tree, as far as it takes no minutes.
        params.reinsertion_batch_ratio = (2e5 / boxes.len() as f32).clamp(0.05, 1.0);
        let tree = build_bvh2(&boxes, params, &mut std::time::Duration::default());
        let mut bvh = Self {
            nodes: Vec::new(),
            leaves: Vec::new(),
            grow: growth(mesh),
            avx2: avx2_available(),
        };
        Collapse::new(&tree, mesh, bvh.grow).node(0, &mut bvh);
        bvh
    }

    /// The tree with the triangles of `mesh` in place of as many of its first ones: as good
    /// as a new one where they have moved little, and much sooner made.
    pub fn refitted(&self, mesh: &Mesh) -> Self {
        let grow = self.grow.max(growth(mesh));
        let mut leaves = self.leaves.clone();
        for leaf in &mut leaves {
            for lane in 0..LEAF {
                let triangle = leaf.triangle[lane] as usize;
                if triangle < mesh.triangles.len() {
                    leaf.place(lane, mesh.corners(triangle));
                }
            }
        }
        let mut nodes = self.nodes.clone();
        // Children stand behind their parents.
        for index in (0..nodes.len()).rev() {
            for slot in 0..WIDTH {
                let (low, high) = match nodes[index].child[slot] {
                    EMPTY => continue,
                    leaf if leaf & LEAF_BIT != 0 => {
                        let (low, high) = leaves[(leaf & !LEAF_BIT) as usize].bounds();
                        (low - grow, high + grow)
                    }
                    child => nodes[child as usize].bounds(),
                };
                nodes[index].set_bounds(slot, low, high);
            }
        }
        Self {
            nodes,
            leaves,
            grow,
            avx2: self.avx2,
        }
    }

    /// The portable kernel, which finds the same hits on every machine.
    pub fn without_simd(mut self) -> Self {
        self.avx2 = false;
        self
    }

    /// The nearest hit, from either side of a triangle.
    pub fn closest(&self, ray: &Ray) -> Option<Hit> {
        #[cfg(target_arch = "x86_64")]
        if self.avx2 {
            // SAFETY: `avx2` is set only where the processor has AVX2 and FMA.
            return unsafe { closest_avx2(self, ray) };
        }
        closest_with::<Portable>(self, ray)
    }

    /// Whether anything lies on the ray before its limit.
    pub fn any(&self, ray: &Ray) -> bool {
        #[cfg(target_arch = "x86_64")]
        if self.avx2 {
            // SAFETY: as in `closest`.
            return unsafe { any_avx2(self, ray) };
        }
        any_with::<Portable>(self, ray)
    }
}

/// The rounding of a mesh's coordinates in a query, millimetres.
fn growth(mesh: &Mesh) -> f32 {
    let [low, high] = mesh.bounds_mm();
    4e-7 * low.abs().max(high.abs()).max_element()
}

fn avx2_available() -> bool {
    #[cfg(target_arch = "x86_64")]
    {
        is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma")
    }
    #[cfg(not(target_arch = "x86_64"))]
    {
        false
    }
}

/// References and the distances at which their boxes are entered, as numbers that sort
/// by distance. Not initialised: a query uses a few of them.
struct Stack {
    entries: [MaybeUninit<u64>; STACK],
    height: usize,
}

impl Stack {
    #[inline(always)]
    fn new() -> Self {
        Self {
            entries: [const { MaybeUninit::uninit() }; STACK],
            height: 0,
        }
    }

    #[inline(always)]
    fn push(&mut self, entry: u64) {
        self.entries[self.height].write(entry);
        self.height += 1;
    }

    #[inline(always)]
    fn pop(&mut self) -> Option<u64> {
        self.height = self.height.checked_sub(1)?;
        // SAFETY: everything below `height` has been written.
        Some(unsafe { self.entries[self.height].assume_init() })
    }
}

#[inline(always)]
fn entry(distance: f32, reference: u32) -> u64 {
    // Distances are not negative: their bits are in their order.
    u64::from(distance.to_bits()) << 32 | u64::from(reference)
}

#[inline(always)]
fn closest_with<I: Instructions>(bvh: &Bvh, ray: &Ray) -> Option<Hit> {
    let prepared = Prepared::new(ray);
    let mut limit = ray.limit_mm;
    let mut best: Option<Hit> = None;
    let mut stack = Stack::new();
    let mut entries = [0.0; WIDTH];
    let mut reference = 0u32;
    loop {
        if reference & LEAF_BIT == 0 {
            let node = &bvh.nodes[reference as usize];
            let mut met = I::boxes(node, &prepared, limit, &mut entries);
            if met != 0 {
                let lane = met.trailing_zeros() as usize;
                met &= met - 1;
                let mut nearest = entry(entries[lane], node.child[lane]);
                // The nearest first; putting the others in order costs more than it saves.
                while met != 0 {
                    let lane = met.trailing_zeros() as usize;
                    met &= met - 1;
                    let other = entry(entries[lane], node.child[lane]);
                    stack.push(nearest.max(other));
                    nearest = nearest.min(other);
                }
                reference = nearest as u32;
                continue;
            }
        } else {
            let leaf = &bvh.leaves[(reference & !LEAF_BIT) as usize];
            let (mut inside, edge) = I::triangles(leaf, &prepared);
            while inside != 0 {
                let lane = inside.trailing_zeros() as usize;
                inside &= inside - 1;
                if edge >> lane & 1 != 0 && !on_an_edge(leaf, &prepared, lane) {
                    continue;
                }
                let t = leaf.distance_mm(lane, ray);
                let triangle = leaf.triangle[lane];
                // Equal distances go to the smaller index, whatever the tree's order.
                if t > 0.0
                    && (t < limit || t == limit && best.is_some_and(|b| triangle < b.triangle))
                {
                    limit = t;
                    best = Some(Hit {
                        distance_mm: t,
                        triangle,
                        barycentric: leaf.barycentric(lane, ray),
                    });
                }
            }
        }
        loop {
            let Some(next) = stack.pop() else { return best };
            if f32::from_bits((next >> 32) as u32) <= limit {
                reference = next as u32;
                break;
            }
        }
    }
}

#[inline(always)]
fn any_with<I: Instructions>(bvh: &Bvh, ray: &Ray) -> bool {
    let prepared = Prepared::new(ray);
    // A node writes eight references, of which those that are met stay.
    let mut stack = [const { MaybeUninit::<u32>::uninit() }; STACK + WIDTH];
    let mut height = 0;
    let mut entries = [0.0; WIDTH];
    let mut reference = 0u32;
    loop {
        if reference & LEAF_BIT == 0 {
            let node = &bvh.nodes[reference as usize];
            let met = I::boxes(node, &prepared, ray.limit_mm, &mut entries);
            if let Some(top) = stack[height..].first_chunk_mut() {
                I::children(node, met, top);
            }
            height += met.count_ones() as usize;
        } else {
            let leaf = &bvh.leaves[(reference & !LEAF_BIT) as usize];
            let (mut inside, edge) = I::triangles(leaf, &prepared);
            while inside != 0 {
                let lane = inside.trailing_zeros() as usize;
                inside &= inside - 1;
                if edge >> lane & 1 != 0 && !on_an_edge(leaf, &prepared, lane) {
                    continue;
                }
                let t = leaf.distance_mm(lane, ray);
                if t > 0.0 && t < ray.limit_mm {
                    return true;
                }
            }
        }
        if height == 0 {
            return false;
        }
        height -= 1;
        // SAFETY: everything below `height` has been written.
        reference = unsafe { stack[height].assume_init() };
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn closest_avx2(bvh: &Bvh, ray: &Ray) -> Option<Hit> {
    closest_with::<Avx2>(bvh, ray)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn any_avx2(bvh: &Bvh, ray: &Ray) -> bool {
    any_with::<Avx2>(bvh, ray)
}

/// A point just off the surface on the side of `normal`, from which a ray cannot hit
/// the surface it leaves (Wächter and Binder, Ray Tracing Gems, chapter 6).
#[inline]
pub fn offset_origin(point_mm: Vec3, normal: Vec3) -> Vec3 {
    const ORIGIN: f32 = 1.0 / 32.0;
    const FLOAT_SCALE: f32 = 1.0 / 65_536.0;
    const INT_SCALE: f32 = 256.0;
    let shift = |p: f32, n: f32| {
        let steps = (INT_SCALE * n) as i32;
        let moved =
            f32::from_bits((p.to_bits() as i32 + if p < 0.0 { -steps } else { steps }) as u32);
        if p.abs() < ORIGIN {
            p + FLOAT_SCALE * n
        } else {
            moved
        }
    };
    Vec3::new(
        shift(point_mm.x, normal.x),
        shift(point_mm.y, normal.y),
        shift(point_mm.z, normal.z),
    )
}

#[cfg(test)]
mod tests;
