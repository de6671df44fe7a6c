//! Watertight ray queries over triangles.
//!
//! obvhs builds the binary tree; it is collapsed into nodes of eight boxes and
//! leaves of four triangles, which fit the lanes of AVX2. Boxes are grown so that
//! rounding never loses a triangle (Ize 2013); triangles are tested with Woop's
//! sheared edge functions (Woop, Benthin, Wald 2013), whose products are exact
//! here because they are formed in f64 from f32 coordinates: a ray that meets a
//! shared edge hits at least one of its triangles.

use glam::{Vec3, Vec3A};
use obvhs::BvhBuildParams;
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2;

use super::mesh::Mesh;

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

/// Eight child boxes; bounds[axis][0 = low, 1 = high].
#[repr(C, align(32))]
#[derive(Clone)]
struct Node {
    bounds: [[[f32; WIDTH]; 2]; 3],
    child: [u32; WIDTH],
}

/// Four triangles; corner[k][axis][lane]. Unused lanes hold NaN, which meets nothing.
#[repr(C, align(16))]
#[derive(Clone)]
struct Leaf {
    corner: [[[f32; LEAF]; 3]; 3],
    triangle: [u32; LEAF],
}

/// The tree over one mesh.
pub struct Bvh {
    nodes: Vec<Node>,
    leaves: Vec<Leaf>,
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
        params.max_prims_per_leaf = LEAF as u32;
        let tree = build_bvh2(&boxes, params, &mut std::time::Duration::default());
        let [low, high] = mesh.bounds_mm();
        let grow = 4e-7 * low.abs().max(high.abs()).max_element();
        let mut bvh = Self {
            nodes: Vec::new(),
            leaves: Vec::new(),
            avx2: avx2_available(),
        };
        bvh.collapse(&tree, 0, mesh, grow);
        bvh
    }

    /// The portable kernel, which gives the same hits on every machine.
    pub fn without_simd(mut self) -> Self {
        self.avx2 = false;
        self
    }

    /// Turns the subtree at `root` into one wide node and returns its reference.
    fn collapse(&mut self, tree: &Bvh2, root: usize, mesh: &Mesh, grow: f32) -> u32 {
        let mut members = vec![root];
        if !tree.nodes[root].is_leaf() {
            // Open the largest inner member until eight are gathered.
            loop {
                let largest = members
                    .iter()
                    .enumerate()
                    .filter(|&(_, &m)| !tree.nodes[m].is_leaf())
                    .max_by(|a, b| {
                        let area = |m: usize| tree.nodes[m].aabb().half_area();
                        area(*a.1).total_cmp(&area(*b.1))
                    })
                    .map(|(slot, _)| slot);
                let Some(slot) = largest.filter(|_| members.len() < WIDTH) else {
                    break;
                };
                let first = tree.nodes[members.swap_remove(slot)].first_index as usize;
                members.extend([first, first + 1]);
            }
        }
        let index = self.nodes.len();
        self.nodes.push(Node {
            bounds: [[[f32::INFINITY; WIDTH], [f32::NEG_INFINITY; WIDTH]]; 3],
            child: [EMPTY; WIDTH],
        });
        for (slot, &member) in members.iter().enumerate() {
            let node = &tree.nodes[member];
            let child = if node.is_leaf() {
                self.push_leaf(tree, member, mesh)
            } else {
                self.collapse(tree, member, mesh, grow)
            };
            let aabb = node.aabb();
            let wide = &mut self.nodes[index];
            for axis in 0..3 {
                wide.bounds[axis][0][slot] = aabb.min[axis] - grow;
                wide.bounds[axis][1][slot] = aabb.max[axis] + grow;
            }
            wide.child[slot] = child;
        }
        index as u32
    }

    fn push_leaf(&mut self, tree: &Bvh2, member: usize, mesh: &Mesh) -> u32 {
        let node = &tree.nodes[member];
        let mut leaf = Leaf {
            corner: [[[f32::NAN; LEAF]; 3]; 3],
            triangle: [EMPTY; LEAF],
        };
        for lane in 0..node.prim_count as usize {
            let triangle = tree.primitive_indices[node.first_index as usize + lane];
            leaf.triangle[lane] = triangle;
            for (corner, p) in mesh.corners(triangle as usize).iter().enumerate() {
                for axis in 0..3 {
                    leaf.corner[corner][axis][lane] = p[axis];
                }
            }
        }
        self.leaves.push(leaf);
        (self.leaves.len() - 1) as u32 | LEAF_BIT
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

/// What the tests need of a ray, computed once.
struct Prepared {
    origin: [f32; 3],
    /// Distances to planes are `plane · inverse − offset`, [0 = entering, 1 = leaving]
    /// per axis, rounded outwards.
    inverse: [[f32; 2]; 3],
    offset: [[f32; 2]; 3],
    /// 1 where the direction's component is negative: the high bound is the near one.
    near: [usize; 3],
    /// Axes permuted so that the direction's largest component comes last.
    axes: [usize; 3],
    shear: [f32; 3],
}

/// Relative rounding of a distance to a plane and of its comparison (Ize 2013).
const DISTANCE_ERROR: f32 = 8.0 * f32::EPSILON;
/// Relative rounding of the ray's origin in the box and triangle tests.
const ORIGIN_ERROR: f32 = 4.0 * f32::EPSILON;
/// Components of the direction below this count as this: no 0 · ∞ in the box test.
const LEAST_COMPONENT: f32 = 1e-18;

impl Prepared {
    #[inline(always)]
    fn new(ray: &Ray) -> Self {
        let origin = ray.origin_mm.to_array();
        let d = ray.direction.to_array();
        let [dx, dy, dz] = d.map(f32::abs);
        let z = if dx > dy {
            if dx > dz { 0 } else { 2 }
        } else if dy > dz {
            1
        } else {
            2
        };
        const NEXT: [usize; 4] = [1, 2, 0, 1];
        let (mut x, mut y) = (NEXT[z], NEXT[z + 1]);
        if d[z] < 0.0 {
            std::mem::swap(&mut x, &mut y);
        }
        let mut prepared = Self {
            origin,
            inverse: [[0.0; 2]; 3],
            offset: [[0.0; 2]; 3],
            near: [0; 3],
            axes: [x, y, z],
            shear: [0.0; 3],
        };
        for axis in 0..3 {
            let component = d[axis].abs().max(LEAST_COMPONENT).copysign(d[axis]);
            let inverse = 1.0 / component;
            let farther = inverse * (1.0 + DISTANCE_ERROR);
            let error = (origin[axis] * farther).abs() * ORIGIN_ERROR;
            prepared.inverse[axis] = [inverse, farther];
            prepared.offset[axis] = [
                origin[axis] * inverse + error,
                origin[axis] * farther - error,
            ];
            prepared.near[axis] = usize::from(d[axis].is_sign_negative());
        }
        let along = prepared.inverse[z][0];
        prepared.shear = [d[x] * along, d[y] * along, along];
        prepared
    }
}

/// What the processor does on whole registers. A trait, not closures: only what is
/// inlined into a function compiled for AVX2 may use its instructions.
trait Instructions {
    /// A bit for each box that is met before `limit`, and the distances of entry.
    fn boxes(node: &Node, ray: &Prepared, limit: f32, entries: &mut [f32; WIDTH]) -> u32;
    /// Woop's test in f32: fills `hits` and returns (lanes inside, lanes on an edge).
    fn triangles(leaf: &Leaf, ray: &Prepared, hits: &mut LeafHits) -> (u32, u32);
}

/// Distances and barycentric weights of a leaf's triangles, where they are met.
struct LeafHits {
    distance: [f32; LEAF],
    second: [f32; LEAF],
    third: [f32; LEAF],
}

impl LeafHits {
    const NONE: Self = Self {
        distance: [0.0; LEAF],
        second: [0.0; LEAF],
        third: [0.0; LEAF],
    };
}

struct Portable;

impl Instructions for Portable {
    #[inline(always)]
    fn boxes(node: &Node, ray: &Prepared, limit: f32, entries: &mut [f32; WIDTH]) -> u32 {
        let mut met = 0;
        for lane in 0..WIDTH {
            let (mut entry, mut leave) = (0.0f32, limit);
            for axis in 0..3 {
                let near = node.bounds[axis][ray.near[axis]][lane];
                let far = node.bounds[axis][1 - ray.near[axis]][lane];
                entry = entry.max(near * ray.inverse[axis][0] - ray.offset[axis][0]);
                leave = leave.min(far * ray.inverse[axis][1] - ray.offset[axis][1]);
            }
            entries[lane] = entry;
            met |= u32::from(entry <= leave) << lane;
        }
        met
    }

    #[inline(always)]
    fn triangles(leaf: &Leaf, ray: &Prepared, hits: &mut LeafHits) -> (u32, u32) {
        let (mut inside, mut edge) = (0, 0);
        for lane in 0..LEAF {
            let [[ax, ay, az], [bx, by, bz], [cx, cy, cz]] = sheared(leaf, ray, lane);
            // Rounding is monotonous: a difference of two rounded products has the
            // exact difference's sign, or is zero.
            let u = cx * by - cy * bx;
            let v = ax * cy - ay * cx;
            let w = bx * ay - by * ax;
            let (low, high) = (u.min(v).min(w), u.max(v).max(w));
            inside |= u32::from(low >= 0.0 || high <= 0.0) << lane;
            edge |= u32::from(u == 0.0 || v == 0.0 || w == 0.0) << lane;
            let determinant = u + v + w;
            hits.distance[lane] = (u * az + v * bz + w * cz) / determinant;
            hits.second[lane] = v / determinant;
            hits.third[lane] = w / determinant;
        }
        (inside, edge)
    }
}

/// A triangle's corners seen along the ray: two coordinates across, the distance along.
#[inline(always)]
fn sheared(leaf: &Leaf, ray: &Prepared, lane: usize) -> [[f32; 3]; 3] {
    let [x, y, z] = ray.axes;
    let mut out = [[0.0; 3]; 3];
    for (corner, out) in leaf.corner.iter().zip(&mut out) {
        let along = corner[z][lane] - ray.origin[z];
        *out = [
            (corner[x][lane] - ray.origin[x]) - ray.shear[0] * along,
            (corner[y][lane] - ray.origin[y]) - ray.shear[1] * along,
            ray.shear[2] * along,
        ];
    }
    out
}

/// The same test where f32 sees a ray on an edge: products of f32 are exact in f64,
/// hence so are the signs, and antisymmetric across a shared edge. Updates the lane of
/// `hits` and says whether the triangle is met.
#[cold]
#[inline(never)]
fn on_an_edge(leaf: &Leaf, ray: &Prepared, lane: usize, hits: &mut LeafHits) -> bool {
    let corners = sheared(leaf, ray, lane).map(|p| p.map(f64::from));
    let [[ax, ay, az], [bx, by, bz], [cx, cy, cz]] = corners;
    let u = cx * by - cy * bx;
    let v = ax * cy - ay * cx;
    let w = bx * ay - by * ax;
    let determinant = u + v + w;
    if determinant == 0.0 || u.min(v).min(w) < 0.0 && u.max(v).max(w) > 0.0 {
        return false;
    }
    hits.distance[lane] = ((u * az + v * bz + w * cz) / determinant) as f32;
    hits.second[lane] = (v / determinant) as f32;
    hits.third[lane] = (w / determinant) as f32;
    true
}

#[cfg(target_arch = "x86_64")]
struct Avx2;

#[cfg(target_arch = "x86_64")]
impl Instructions for Avx2 {
    #[inline(always)]
    fn boxes(node: &Node, ray: &Prepared, limit: f32, entries: &mut [f32; WIDTH]) -> u32 {
        use std::arch::x86_64::*;
        // SAFETY: instantiated only inside functions compiled for AVX2 and FMA; every
        // pointer is to an array of eight f32.
        unsafe {
            let mut entry = _mm256_setzero_ps();
            let mut leave = _mm256_set1_ps(limit);
            let mut axis = 0;
            while axis < 3 {
                let near = _mm256_loadu_ps(node.bounds[axis][ray.near[axis]].as_ptr());
                let far = _mm256_loadu_ps(node.bounds[axis][1 - ray.near[axis]].as_ptr());
                let [enter_inverse, leave_inverse] = ray.inverse[axis];
                let [enter_offset, leave_offset] = ray.offset[axis];
                let (inverse, offset) =
                    (_mm256_set1_ps(enter_inverse), _mm256_set1_ps(enter_offset));
                entry = _mm256_max_ps(_mm256_fmsub_ps(near, inverse, offset), entry);
                let (inverse, offset) =
                    (_mm256_set1_ps(leave_inverse), _mm256_set1_ps(leave_offset));
                leave = _mm256_min_ps(_mm256_fmsub_ps(far, inverse, offset), leave);
                axis += 1;
            }
            _mm256_storeu_ps(entries.as_mut_ptr(), entry);
            _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(entry, leave)) as u32
        }
    }

    #[inline(always)]
    fn triangles(leaf: &Leaf, ray: &Prepared, hits: &mut LeafHits) -> (u32, u32) {
        use std::arch::x86_64::*;
        // SAFETY: as above; every pointer is to an array of four f32. Multiplications
        // and additions are not fused, so that the portable form gives the same numbers.
        unsafe {
            let [x, y, z] = ray.axes;
            let origin = [x, y, z].map(|axis| _mm_set1_ps(ray.origin[axis]));
            let shear = ray.shear.map(|s| _mm_set1_ps(s));
            let zero = _mm_setzero_ps();
            let mut across = [[zero; 2]; 3];
            let mut along = [zero; 3];
            let mut k = 0;
            while k < 3 {
                let corner = &leaf.corner[k];
                along[k] = _mm_sub_ps(_mm_loadu_ps(corner[z].as_ptr()), origin[2]);
                let px = _mm_sub_ps(_mm_loadu_ps(corner[x].as_ptr()), origin[0]);
                let py = _mm_sub_ps(_mm_loadu_ps(corner[y].as_ptr()), origin[1]);
                across[k][0] = _mm_sub_ps(px, _mm_mul_ps(shear[0], along[k]));
                across[k][1] = _mm_sub_ps(py, _mm_mul_ps(shear[1], along[k]));
                k += 1;
            }
            let [[ax, ay], [bx, by], [cx, cy]] = across;
            let u = _mm_sub_ps(_mm_mul_ps(cx, by), _mm_mul_ps(cy, bx));
            let v = _mm_sub_ps(_mm_mul_ps(ax, cy), _mm_mul_ps(ay, cx));
            let w = _mm_sub_ps(_mm_mul_ps(bx, ay), _mm_mul_ps(by, ax));
            let low = _mm_min_ps(_mm_min_ps(u, v), w);
            let high = _mm_max_ps(_mm_max_ps(u, v), w);
            let inside = _mm_or_ps(_mm_cmpge_ps(low, zero), _mm_cmple_ps(high, zero));
            let inside = _mm_movemask_ps(inside) as u32;
            if inside == 0 {
                return (0, 0);
            }
            let edge = _mm_or_ps(
                _mm_or_ps(_mm_cmpeq_ps(u, zero), _mm_cmpeq_ps(v, zero)),
                _mm_cmpeq_ps(w, zero),
            );
            let determinant = _mm_add_ps(_mm_add_ps(u, v), w);
            let sum = _mm_add_ps(
                _mm_add_ps(
                    _mm_mul_ps(u, _mm_mul_ps(shear[2], along[0])),
                    _mm_mul_ps(v, _mm_mul_ps(shear[2], along[1])),
                ),
                _mm_mul_ps(w, _mm_mul_ps(shear[2], along[2])),
            );
            _mm_storeu_ps(hits.distance.as_mut_ptr(), _mm_div_ps(sum, determinant));
            _mm_storeu_ps(hits.second.as_mut_ptr(), _mm_div_ps(v, determinant));
            _mm_storeu_ps(hits.third.as_mut_ptr(), _mm_div_ps(w, determinant));
            (inside, _mm_movemask_ps(edge) as u32)
        }
    }
}

/// References and the distances at which their boxes are entered, as numbers that sort
/// by distance. Not initialised: a query uses a few of them.
struct Stack {
    entries: [std::mem::MaybeUninit<u64>; STACK],
    height: usize,
}

impl Stack {
    #[inline(always)]
    fn new() -> Self {
        Self {
            entries: [const { std::mem::MaybeUninit::uninit() }; STACK],
            height: 0,
        }
    }

    #[inline(always)]
    fn push(&mut self, entry: u64) {
        self.entries[self.height].write(entry);
        self.height += 1;
    }

    /// Pushes below all entries above `base` that are nearer.
    #[inline(always)]
    fn push_sorted(&mut self, base: usize, entry: u64) {
        let mut slot = self.height;
        while slot > base {
            // SAFETY: everything below `height` has been written.
            let below = unsafe { self.entries[slot - 1].assume_init() };
            if below >= entry {
                break;
            }
            self.entries[slot].write(below);
            slot -= 1;
        }
        self.entries[slot].write(entry);
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
    let mut hits = LeafHits::NONE;
    let mut reference = 0u32;
    loop {
        if reference & LEAF_BIT == 0 {
            let node = &bvh.nodes[reference as usize];
            let mut met = I::boxes(node, &prepared, limit, &mut entries);
            if met != 0 {
                let lane = met.trailing_zeros() as usize;
                met &= met - 1;
                let mut nearest = entry(entries[lane], node.child[lane]);
                let base = stack.height;
                while met != 0 {
                    let lane = met.trailing_zeros() as usize;
                    met &= met - 1;
                    let other = entry(entries[lane], node.child[lane]);
                    stack.push_sorted(base, nearest.max(other));
                    nearest = nearest.min(other);
                }
                reference = nearest as u32;
                continue;
            }
        } else {
            let leaf = &bvh.leaves[(reference & !LEAF_BIT) as usize];
            let (mut inside, edge) = I::triangles(leaf, &prepared, &mut hits);
            while inside != 0 {
                let lane = inside.trailing_zeros() as usize;
                inside &= inside - 1;
                if edge >> lane & 1 != 0 && !on_an_edge(leaf, &prepared, lane, &mut hits) {
                    continue;
                }
                let t = hits.distance[lane];
                let triangle = leaf.triangle[lane];
                // Equal distances go to the smaller index, whatever the tree's order.
                if t > 0.0
                    && (t < limit || t == limit && best.is_some_and(|b| triangle < b.triangle))
                {
                    limit = t;
                    best = Some(Hit {
                        distance_mm: t,
                        triangle,
                        barycentric: [hits.second[lane], hits.third[lane]],
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
    let mut stack = Stack::new();
    let mut entries = [0.0; WIDTH];
    let mut hits = LeafHits::NONE;
    let mut reference = 0u32;
    loop {
        if reference & LEAF_BIT == 0 {
            let node = &bvh.nodes[reference as usize];
            let mut met = I::boxes(node, &prepared, ray.limit_mm, &mut entries);
            while met != 0 {
                let lane = met.trailing_zeros() as usize;
                met &= met - 1;
                stack.push(u64::from(node.child[lane]));
            }
        } else {
            let leaf = &bvh.leaves[(reference & !LEAF_BIT) as usize];
            let (mut inside, edge) = I::triangles(leaf, &prepared, &mut hits);
            while inside != 0 {
                let lane = inside.trailing_zeros() as usize;
                inside &= inside - 1;
                if (edge >> lane & 1 == 0 || on_an_edge(leaf, &prepared, lane, &mut hits))
                    && hits.distance[lane] > 0.0
                    && hits.distance[lane] < ray.limit_mm
                {
                    return true;
                }
            }
        }
        let Some(next) = stack.pop() else {
            return false;
        };
        reference = next as u32;
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
mod tests {
    use super::*;
    use crate::geometry::Shape;
    use crate::random::{Purpose, Stream, stream};

    fn direction(numbers: &mut Stream) -> Vec3 {
        let z = 2.0 * numbers.uniform_f32() - 1.0;
        let phi = std::f32::consts::TAU * numbers.uniform_f32();
        let r = (1.0 - z * z).max(0.0).sqrt();
        Vec3::new(r * phi.cos(), r * phi.sin(), z)
    }

    fn sphere() -> Mesh {
        Shape::Sphere {
            radius_mm: 1.0,
            segments: 64,
        }
        .mesh()
        .unwrap()
    }

    /// Rays from inside a closed sphere at its vertices and edge points must all hit.
    #[test]
    fn no_ray_escapes_a_closed_sphere() {
        let mesh = sphere();
        for bvh in [Bvh::new(&mesh), Bvh::new(&mesh).without_simd()] {
            let mut numbers = stream(11, Purpose::Experiment, 0, 0, 0);
            let mut escaped = 0;
            for sample in 0..400_000 {
                let triangle = (numbers.bits() % mesh.triangles.len() as u64) as usize;
                let [a, b, _] = mesh.corners(triangle);
                let target = if sample % 2 == 0 {
                    a
                } else {
                    a.lerp(b, numbers.uniform_f32())
                };
                let origin = direction(&mut numbers) * 0.7 * numbers.uniform_f32();
                let ray = Ray {
                    origin_mm: origin,
                    direction: (target - origin).normalize(),
                    limit_mm: f32::INFINITY,
                };
                if bvh.closest(&ray).is_none() || !bvh.any(&ray) {
                    escaped += 1;
                }
            }
            assert_eq!(escaped, 0, "of 400000 rays");
        }
    }

    /// Rays that leave the surface never meet it at once: on a sphere the nearest other
    /// point along a direction with cosine c to the normal is 2 c R away.
    #[test]
    fn no_ray_hits_the_surface_it_leaves() {
        let mesh = sphere();
        let bvh = Bvh::new(&mesh);
        let mut numbers = stream(12, Purpose::Experiment, 0, 0, 0);
        for _ in 0..200_000 {
            let triangle = (numbers.bits() % mesh.triangles.len() as u64) as usize;
            let [a, b, c] = mesh.corners(triangle);
            let (mut u, mut v) = (numbers.uniform_f32(), numbers.uniform_f32());
            if u + v > 1.0 {
                (u, v) = (1.0 - u, 1.0 - v);
            }
            let outward = mesh.face_normal(triangle);
            let mut away = direction(&mut numbers);
            if away.dot(outward) < 0.0 {
                away = -away;
            }
            let ray = Ray {
                origin_mm: offset_origin(a + (b - a) * u + (c - a) * v, outward),
                direction: away,
                limit_mm: f32::INFINITY,
            };
            assert!(!bvh.any(&ray), "triangle {triangle}, direction {away}");
        }
    }

    /// Against testing every triangle with the plain double-precision formula.
    #[test]
    fn closest_agrees_with_brute_force() {
        let mesh = Shape::Bowl {
            radius_mm: 1.0,
            segments: 12,
        }
        .mesh()
        .unwrap();
        let bvh = Bvh::new(&mesh);
        let portable = Bvh::new(&mesh).without_simd();
        let mut numbers = stream(13, Purpose::Experiment, 0, 0, 0);
        let mut hits = 0;
        for _ in 0..4000 {
            let ray = Ray {
                origin_mm: direction(&mut numbers) * 2.0,
                direction: direction(&mut numbers),
                limit_mm: f32::INFINITY,
            };
            let brute = (0..mesh.triangles.len())
                .filter_map(|i| {
                    let [a, b, c] = mesh.corners(i).map(Vec3::as_dvec3);
                    let (o, d) = (ray.origin_mm.as_dvec3(), ray.direction.as_dvec3());
                    let (e1, e2) = (b - a, c - a);
                    let p = d.cross(e2);
                    let det = e1.dot(p);
                    let s = o - a;
                    let u = s.dot(p) / det;
                    let q = s.cross(e1);
                    let v = d.dot(q) / det;
                    let t = e2.dot(q) / det;
                    (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0).then_some(t)
                })
                .fold(f64::INFINITY, f64::min);
            let found = bvh.closest(&ray);
            assert_eq!(
                found.map(|h| h.triangle),
                portable.closest(&ray).map(|h| h.triangle)
            );
            match found {
                Some(hit) => {
                    hits += 1;
                    assert!(
                        (f64::from(hit.distance_mm) - brute).abs() < 1e-5,
                        "{hit:?} {brute}"
                    );
                }
                None => assert!(brute.is_infinite(), "missed a hit at {brute}"),
            }
            assert_eq!(bvh.any(&ray), found.is_some());
        }
        assert!(hits > 100, "only {hits} rays hit");
    }
}
