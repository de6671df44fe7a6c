//! A ray against eight boxes or four triangles at once: portable, and with AVX2.

use std::mem::MaybeUninit;

use super::{LEAF, Leaf, Node, Ray, WIDTH};

/// What the tests need of a ray, computed once.
pub(super) struct Prepared {
    origin: [f32; 3],
    /// Distances to planes are `plane · inverse − offset`, [0 = entering, 1 = leaving]
    /// per axis, rounded outwards.
    inverse: [[f32; 2]; 3],
    offset: [[f32; 2]; 3],
    /// Which of a node's bounds the ray meets first and last, by axis: each below 6.
    near: [usize; 3],
    far: [usize; 3],
    /// Axes permuted so that the direction's largest component comes last.
    axes: [usize; 3],
    shear: [f32; 2],
}

/// Relative rounding of a distance to a plane and of its comparison (Ize 2013).
const DISTANCE_ERROR: f32 = 8.0 * f32::EPSILON;
/// Relative rounding of the ray's origin in the box and triangle tests.
const ORIGIN_ERROR: f32 = 4.0 * f32::EPSILON;
/// Components of the direction below this count as this: no 0 · ∞ in the box test.
const LEAST_COMPONENT: f32 = 1e-18;

impl Prepared {
    #[inline(always)]
    pub(super) fn new(ray: &Ray) -> Self {
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
            far: [0; 3],
            axes: [x, y, z],
            shear: [0.0; 2],
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
            let backwards = d[axis].is_sign_negative();
            prepared.near[axis] = if backwards { axis + 3 } else { axis };
            prepared.far[axis] = if backwards { axis } else { axis + 3 };
        }
        let along = prepared.inverse[z][0];
        prepared.shear = [d[x] * along, d[y] * along];
        prepared
    }
}

/// What the processor does on whole registers. A trait, not closures: only what is
/// inlined into a function compiled for AVX2 may use its instructions.
pub(super) trait Instructions {
    /// A bit for each box that is met before `limit`, and the distances of entry.
    fn boxes(node: &Node, ray: &Prepared, limit: f32, entries: &mut [f32; WIDTH]) -> u32;
    /// Writes the met children to the front of `out`; what follows them is arbitrary.
    fn children(node: &Node, met: u32, out: &mut [MaybeUninit<u32>; WIDTH]);
    /// Woop's test in f32: (lanes inside, lanes on an edge).
    fn triangles(leaf: &Leaf, ray: &Prepared) -> (u32, u32);
}

/// For each set of lanes their numbers in order, a byte each.
static LANES_OF: [u64; 256] = {
    let mut table = [0; 256];
    let mut set = 0;
    while set < 256 {
        let (mut lane, mut shift) = (0, 0);
        while lane < WIDTH as u64 {
            if set >> lane & 1 != 0 {
                table[set] |= lane << shift;
                shift += 8;
            }
            lane += 1;
        }
        set += 1;
    }
    table
};

pub(super) struct Portable;

impl Instructions for Portable {
    #[inline(always)]
    fn boxes(node: &Node, ray: &Prepared, limit: f32, entries: &mut [f32; WIDTH]) -> u32 {
        let mut met = 0;
        for (lane, out) in entries.iter_mut().enumerate() {
            let (mut entry, mut leave) = (0.0f32, limit);
            for axis in 0..3 {
                let near = node.bounds[ray.near[axis]][lane];
                let far = node.bounds[ray.far[axis]][lane];
                entry = entry.max(near * ray.inverse[axis][0] - ray.offset[axis][0]);
                leave = leave.min(far * ray.inverse[axis][1] - ray.offset[axis][1]);
            }
            *out = entry;
            met |= u32::from(entry <= leave) << lane;
        }
        met
    }

    #[inline(always)]
    fn children(node: &Node, met: u32, out: &mut [MaybeUninit<u32>; WIDTH]) {
        let lanes = LANES_OF[met as usize].to_le_bytes();
        for (out, lane) in out.iter_mut().zip(lanes) {
            out.write(node.child[usize::from(lane)]);
        }
    }

    #[inline(always)]
    fn triangles(leaf: &Leaf, ray: &Prepared) -> (u32, u32) {
        let (mut inside, mut edge) = (0, 0);
        for lane in 0..LEAF {
            let [[ax, ay], [bx, by], [cx, cy]] = sheared(leaf, ray, lane);
            // Rounding is monotonous: a difference of two rounded products has the
            // exact difference's sign, or is zero.
            let u = cx * by - cy * bx;
            let v = ax * cy - ay * cx;
            let w = bx * ay - by * ax;
            let (low, high) = (u.min(v).min(w), u.max(v).max(w));
            inside |= u32::from(low >= 0.0 || high <= 0.0) << lane;
            edge |= u32::from(u == 0.0 || v == 0.0 || w == 0.0) << lane;
        }
        (inside, edge)
    }
}

/// A triangle's corners seen along the ray: coordinates across it.
#[inline(always)]
fn sheared(leaf: &Leaf, ray: &Prepared, lane: usize) -> [[f32; 2]; 3] {
    let [x, y, z] = ray.axes;
    let mut out = [[0.0; 2]; 3];
    for (corner, out) in leaf.corner.iter().zip(&mut out) {
        let along = corner[z][lane] - ray.origin[z];
        *out = [
            (corner[x][lane] - ray.origin[x]) - ray.shear[0] * along,
            (corner[y][lane] - ray.origin[y]) - ray.shear[1] * along,
        ];
    }
    out
}

/// Whether a triangle is met where f32 sees the ray on an edge: products of f32 are exact in
/// f64, hence so are the signs, and antisymmetric across a shared edge.
#[cold]
#[inline(never)]
pub(super) fn on_an_edge(leaf: &Leaf, ray: &Prepared, lane: usize) -> bool {
    let corners = sheared(leaf, ray, lane).map(|p| p.map(f64::from));
    let [[ax, ay], [bx, by], [cx, cy]] = corners;
    let u = cx * by - cy * bx;
    let v = ax * cy - ay * cx;
    let w = bx * ay - by * ax;
    let determinant = u + v + w;
    determinant != 0.0 && (u.min(v).min(w) >= 0.0 || u.max(v).max(w) <= 0.0)
}

#[cfg(target_arch = "x86_64")]
pub(super) struct Avx2;

#[cfg(target_arch = "x86_64")]
impl Instructions for Avx2 {
    #[inline(always)]
    fn boxes(node: &Node, ray: &Prepared, limit: f32, entries: &mut [f32; WIDTH]) -> u32 {
        use std::arch::x86_64::*;
        // SAFETY: instantiated only inside functions compiled for AVX2 and FMA; `near`
        // and `far` are below 6, and each of the six rows is eight f32.
        unsafe {
            let rows = node.bounds.as_ptr().cast::<f32>();
            let mut entry = _mm256_setzero_ps();
            let mut leave = _mm256_set1_ps(limit);
            let mut axis = 0;
            while axis < 3 {
                let near = _mm256_load_ps(rows.add(WIDTH * ray.near[axis]));
                let far = _mm256_load_ps(rows.add(WIDTH * ray.far[axis]));
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
    fn children(node: &Node, met: u32, out: &mut [MaybeUninit<u32>; WIDTH]) {
        use std::arch::x86_64::*;
        let lanes = LANES_OF[(met & 0xff) as usize];
        // SAFETY: as above; both arrays are eight u32.
        unsafe {
            let lanes = _mm256_cvtepu8_epi32(_mm_cvtsi64_si128(lanes as i64));
            let child = _mm256_loadu_si256(node.child.as_ptr().cast());
            let met = _mm256_permutevar8x32_epi32(child, lanes);
            _mm256_storeu_si256(out.as_mut_ptr().cast(), met);
        }
    }

    #[inline(always)]
    fn triangles(leaf: &Leaf, ray: &Prepared) -> (u32, u32) {
        use std::arch::x86_64::*;
        // SAFETY: as above; axes are below 3, and a corner has three rows of four f32.
        // Multiplications and additions are not fused, so that the portable form gives the same numbers.
        unsafe {
            let [x, y, z] = ray.axes;
            let origin = [x, y, z].map(|axis| _mm_set1_ps(ray.origin[axis]));
            let shear = ray.shear.map(|s| _mm_set1_ps(s));
            let zero = _mm_setzero_ps();
            let mut across = [[zero; 2]; 3];
            let mut k = 0;
            while k < 3 {
                let rows = leaf.corner[k].as_ptr().cast::<f32>();
                let along = _mm_sub_ps(_mm_load_ps(rows.add(LEAF * z)), origin[2]);
                let px = _mm_sub_ps(_mm_load_ps(rows.add(LEAF * x)), origin[0]);
                let py = _mm_sub_ps(_mm_load_ps(rows.add(LEAF * y)), origin[1]);
                across[k][0] = _mm_sub_ps(px, _mm_mul_ps(shear[0], along));
                across[k][1] = _mm_sub_ps(py, _mm_mul_ps(shear[1], along));
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
            (inside, _mm_movemask_ps(edge) as u32)
        }
    }
}
