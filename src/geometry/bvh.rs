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

/// Four triangles; corner[k][axis][lane]. Unused lanes hold a triangle without area.
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
            corner: [[[0.0; LEAF]; 3]; 3],
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
        closest_with::<PortableBoxes>(self, ray)
    }

    /// Whether anything lies on the ray before its limit.
    pub fn any(&self, ray: &Ray) -> bool {
        #[cfg(target_arch = "x86_64")]
        if self.avx2 {
            // SAFETY: as in `closest`.
            return unsafe { any_avx2(self, ray) };
        }
        any_with::<PortableBoxes>(self, ray)
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
    inverse: [f32; 3],
    /// 1 where the direction's component is negative: the high bound is the near one.
    near: [usize; 3],
    /// Axes permuted so that the direction's largest component comes last.
    axes: [usize; 3],
    shear: [f32; 3],
}

impl Prepared {
    #[inline(always)]
    fn new(ray: &Ray) -> Self {
        let d = ray.direction.to_array();
        let magnitude = d.map(f32::abs);
        let z = if magnitude[0] > magnitude[1] {
            if magnitude[0] > magnitude[2] { 0 } else { 2 }
        } else if magnitude[1] > magnitude[2] {
            1
        } else {
            2
        };
        let (mut x, mut y) = ((z + 1) % 3, (z + 2) % 3);
        if d[z] < 0.0 {
            std::mem::swap(&mut x, &mut y);
        }
        Self {
            origin: ray.origin_mm.to_array(),
            inverse: d.map(|c| 1.0 / c),
            near: d.map(|c| usize::from(c.is_sign_negative())),
            axes: [x, y, z],
            shear: [d[x] / d[z], d[y] / d[z], 1.0 / d[z]],
        }
    }
}

/// Grows the far distance by the rounding of its three operations (Ize 2013).
const FAR_GROWTH: f32 = 1.000_000_5;

/// Tests a ray against the eight boxes of a node. A trait, not a closure: only what is
/// inlined into a function compiled for AVX2 may use its instructions.
trait BoxTest {
    /// A bit for each box that is met before `limit`, and the distances of entry.
    fn boxes(node: &Node, ray: &Prepared, limit: f32) -> (u32, [f32; WIDTH]);
}

struct PortableBoxes;

impl BoxTest for PortableBoxes {
    #[inline(always)]
    fn boxes(node: &Node, ray: &Prepared, limit: f32) -> (u32, [f32; WIDTH]) {
        let mut entry = [0.0f32; WIDTH];
        let mut leave = [limit; WIDTH];
        for axis in 0..3 {
            let near = &node.bounds[axis][ray.near[axis]];
            let far = &node.bounds[axis][1 - ray.near[axis]];
            for lane in 0..WIDTH {
                // A NaN (0 · ∞, a ray inside a slab's plane) keeps the other bound.
                let t0 = (near[lane] - ray.origin[axis]) * ray.inverse[axis];
                let t1 = (far[lane] - ray.origin[axis]) * ray.inverse[axis] * FAR_GROWTH;
                entry[lane] = if t0 > entry[lane] { t0 } else { entry[lane] };
                leave[lane] = if t1 < leave[lane] { t1 } else { leave[lane] };
            }
        }
        let mut met = 0;
        for lane in 0..WIDTH {
            met |= u32::from(entry[lane] <= leave[lane]) << lane;
        }
        (met, entry)
    }
}

#[cfg(target_arch = "x86_64")]
struct Avx2Boxes;

#[cfg(target_arch = "x86_64")]
impl BoxTest for Avx2Boxes {
    #[inline(always)]
    fn boxes(node: &Node, ray: &Prepared, limit: f32) -> (u32, [f32; WIDTH]) {
        use std::arch::x86_64::*;
        // SAFETY: instantiated only inside functions compiled for AVX2; every pointer
        // is to an array of eight f32.
        unsafe {
            let mut entry = _mm256_setzero_ps();
            let mut leave = _mm256_set1_ps(limit);
            let growth = _mm256_set1_ps(FAR_GROWTH);
            let mut axis = 0;
            while axis < 3 {
                let origin = _mm256_set1_ps(ray.origin[axis]);
                let inverse = _mm256_set1_ps(ray.inverse[axis]);
                let near = _mm256_loadu_ps(node.bounds[axis][ray.near[axis]].as_ptr());
                let far = _mm256_loadu_ps(node.bounds[axis][1 - ray.near[axis]].as_ptr());
                let t0 = _mm256_mul_ps(_mm256_sub_ps(near, origin), inverse);
                let t1 = _mm256_mul_ps(_mm256_mul_ps(_mm256_sub_ps(far, origin), inverse), growth);
                entry = _mm256_max_ps(t0, entry);
                leave = _mm256_min_ps(t1, leave);
                axis += 1;
            }
            let met = _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(entry, leave)) as u32;
            let mut distances = [0.0; WIDTH];
            _mm256_storeu_ps(distances.as_mut_ptr(), entry);
            (met, distances)
        }
    }
}

/// Distances and barycentric weights of a leaf's triangles; infinite where missed.
struct LeafHits {
    distance: [f32; LEAF],
    second: [f32; LEAF],
    third: [f32; LEAF],
}

/// Woop's test on four lanes. The sheared coordinates are f32, the same for every
/// triangle that shares the vertex; their products are exact in f64, hence the sign
/// of an edge function is the exact sign and antisymmetric across a shared edge.
#[inline(always)]
fn triangles_lanes(leaf: &Leaf, ray: &Prepared, limit: f32) -> LeafHits {
    let [x, y, z] = ray.axes;
    let mut sheared = [[[0.0f64; LEAF]; 2]; 3];
    let mut depth = [[0.0f64; LEAF]; 3];
    for corner in 0..3 {
        let c = &leaf.corner[corner];
        for lane in 0..LEAF {
            let pz = c[z][lane] - ray.origin[z];
            sheared[corner][0][lane] = f64::from((c[x][lane] - ray.origin[x]) - ray.shear[0] * pz);
            sheared[corner][1][lane] = f64::from((c[y][lane] - ray.origin[y]) - ray.shear[1] * pz);
            depth[corner][lane] = f64::from(ray.shear[2] * pz);
        }
    }
    let [[ax, ay], [bx, by], [cx, cy]] = sheared;
    let mut hits = LeafHits {
        distance: [f32::INFINITY; LEAF],
        second: [0.0; LEAF],
        third: [0.0; LEAF],
    };
    for lane in 0..LEAF {
        let u = cx[lane] * by[lane] - cy[lane] * bx[lane];
        let v = ax[lane] * cy[lane] - ay[lane] * cx[lane];
        let w = bx[lane] * ay[lane] - by[lane] * ax[lane];
        let determinant = u + v + w;
        let inside = (u >= 0.0) & (v >= 0.0) & (w >= 0.0) | (u <= 0.0) & (v <= 0.0) & (w <= 0.0);
        let reciprocal = 1.0 / determinant;
        let t = (u * depth[0][lane] + v * depth[1][lane] + w * depth[2][lane]) * reciprocal;
        let t = t as f32;
        let hit = inside & (determinant != 0.0) & (t > 0.0) & (t < limit);
        hits.distance[lane] = if hit { t } else { f32::INFINITY };
        hits.second[lane] = (v * reciprocal) as f32;
        hits.third[lane] = (w * reciprocal) as f32;
    }
    hits
}

#[inline(always)]
fn closest_with<T: BoxTest>(bvh: &Bvh, ray: &Ray) -> Option<Hit> {
    let prepared = Prepared::new(ray);
    let mut limit = ray.limit_mm;
    let mut best = None;
    let mut stack = [(0u32, 0.0f32); STACK];
    let mut height = 1;
    while height > 0 {
        height -= 1;
        let (reference, entry) = stack[height];
        if entry > limit {
            continue;
        }
        if reference & LEAF_BIT != 0 {
            let leaf = &bvh.leaves[(reference & !LEAF_BIT) as usize];
            let hits = triangles_lanes(leaf, &prepared, limit);
            for lane in 0..LEAF {
                // Equal distances go to the smaller index, whatever the tree's order.
                let t = hits.distance[lane];
                if t < limit {
                    limit = t;
                    best = Some(Hit {
                        distance_mm: t,
                        triangle: leaf.triangle[lane],
                        barycentric: [hits.second[lane], hits.third[lane]],
                    });
                }
            }
            continue;
        }
        let node = &bvh.nodes[reference as usize];
        let (mut met, entries) = T::boxes(node, &prepared, limit);
        let base = height;
        while met != 0 {
            let lane = met.trailing_zeros() as usize;
            met &= met - 1;
            // Keep the pushed children sorted, the nearest on top.
            let entry = entries[lane];
            let mut slot = height;
            while slot > base && stack[slot - 1].1 < entry {
                stack[slot] = stack[slot - 1];
                slot -= 1;
            }
            stack[slot] = (node.child[lane], entry);
            height += 1;
        }
    }
    best
}

#[inline(always)]
fn any_with<T: BoxTest>(bvh: &Bvh, ray: &Ray) -> bool {
    let prepared = Prepared::new(ray);
    let mut stack = [0u32; STACK];
    let mut height = 1;
    while height > 0 {
        height -= 1;
        let reference = stack[height];
        if reference & LEAF_BIT != 0 {
            let leaf = &bvh.leaves[(reference & !LEAF_BIT) as usize];
            let hits = triangles_lanes(leaf, &prepared, ray.limit_mm);
            if hits.distance.iter().any(|&t| t < ray.limit_mm) {
                return true;
            }
            continue;
        }
        let node = &bvh.nodes[reference as usize];
        let (mut met, _) = T::boxes(node, &prepared, ray.limit_mm);
        while met != 0 {
            let lane = met.trailing_zeros() as usize;
            met &= met - 1;
            stack[height] = node.child[lane];
            height += 1;
        }
    }
    false
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn closest_avx2(bvh: &Bvh, ray: &Ray) -> Option<Hit> {
    closest_with::<Avx2Boxes>(bvh, ray)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn any_avx2(bvh: &Bvh, ray: &Ray) -> bool {
    any_with::<Avx2Boxes>(bvh, ray)
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
