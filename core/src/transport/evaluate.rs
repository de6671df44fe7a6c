//! One pass over the cached paths: image and per-pixel Jacobian for given weights.
//!
//! Along a path, light gathered after record i is R; a continuation turns it into
//! f·g·R, a connection adds f·w. The derivative with respect to atom n is the sum
//! over records of (product of all factors before) · f_n · (what follows), formed
//! from prefix products and the suffix R: no division by f, so a vertex where the
//! current mixture is black still contributes (docs/adr/0002).

use nalgebra::DMatrix;
use rayon::prelude::*;

use super::cache::{Cache, Chunk, Records};
use super::event::{LaneAtoms, MAX_LIGHTS, Record};
use super::lanes::{Lanes, Portable};
use crate::brdf::discrepancy::{LEVELS, NODES, VALUES, cos_2phi_of};

/// Which instructions evaluate the cache.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kernel {
    /// Plain Rust; the same numbers on every machine.
    Portable,
    /// AVX2 with FMA and F16C.
    Avx2,
    /// AVX-512 (F, VL, DQ, BW) besides.
    Avx512,
}

impl Kernel {
    /// All that there are, the fastest last.
    pub const ALL: [Self; 3] = [Self::Portable, Self::Avx2, Self::Avx512];

    /// The fastest that this processor has.
    pub fn detect() -> Self {
        *Self::available().last().unwrap_or(&Kernel::Portable)
    }

    /// Those that this processor has, the fastest last.
    pub fn available() -> &'static [Self] {
        #[cfg(target_arch = "x86_64")]
        let count = {
            use std::arch::is_x86_feature_detected as has;
            let avx2 = has!("avx2") && has!("fma") && has!("f16c");
            let avx512 =
                has!("avx512f") && has!("avx512vl") && has!("avx512dq") && has!("avx512bw");
            1 + usize::from(avx2) + usize::from(avx2 && avx512)
        };
        #[cfg(not(target_arch = "x86_64"))]
        let count = 1;
        &Self::ALL[..count]
    }
}

impl std::fmt::Display for Kernel {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.write_str(match self {
            Kernel::Portable => "portable",
            Kernel::Avx2 => "avx2",
            Kernel::Avx512 => "avx512",
        })
    }
}

/// One cell's multiple-reflection radiance per unit lamp strength: values and
/// derivatives of both halves. Row `r = light · channels + channel`.
pub struct CellRows<'a> {
    /// The cell.
    pub cell: usize,
    /// `value[half][r]`.
    pub value: [&'a [f32]; 2],
    /// Variance of the mean of both halves, per row.
    pub variance: &'a [f32],
    /// `jacobian[half][r · atoms + atom]`.
    pub jacobian: [&'a [f32]; 2],
    /// Derivatives along the modes of a discrepancy, `by_modes[half][r · modes + mode]`; empty
    /// unless requested.
    pub by_modes: [&'a [f32]; 2],
}

/// Most accumulators of one evaluation: enough to keep many threads busy, few enough to be
/// kept until all are there.
const MAX_GROUPS: usize = 256;

/// Weights of one mixture per channel; all channels may share one.
pub type ChannelWeights<'a> = &'a [&'a [f64]];

/// The discrepancy of a material in an evaluation.
#[derive(Clone, Copy, Default)]
pub struct Discrepancies<'a> {
    /// Per channel, factors of f at the places of [`crate::brdf::discrepancy`]; empty
    /// without discrepancy.
    pub factors: &'a [Vec<f32>],
    /// Modes (columns of values at the nodes) along which derivatives of ln f are wanted.
    pub modes: Option<&'a DMatrix<f64>>,
}

impl Cache {
    /// Evaluates every cell for `weights` (1 or 3 channels × atoms). `group` makes
    /// an accumulator for each group of cells, `visit` adds a cell to it; the
    /// accumulators come back in the order of the cells, whatever the threads did.
    ///
    /// # Panics
    /// For a kernel that is not among [`Kernel::available`].
    pub fn evaluate<T: Send>(
        &self,
        kernel: Kernel,
        weights: ChannelWeights<'_>,
        group: impl Fn() -> T + Sync,
        visit: impl Fn(&mut T, &CellRows<'_>) + Sync,
    ) -> Vec<T> {
        self.evaluate_with_discrepancy(kernel, weights, &Discrepancies::default(), group, visit)
    }

    /// [`Cache::evaluate`] for a mixture with discrepancy.
    pub fn evaluate_with_discrepancy<T: Send>(
        &self,
        kernel: Kernel,
        weights: ChannelWeights<'_>,
        discrepancy: &Discrepancies<'_>,
        group: impl Fn() -> T + Sync,
        visit: impl Fn(&mut T, &CellRows<'_>) + Sync,
    ) -> Vec<T> {
        assert!(
            Kernel::available().contains(&kernel),
            "this processor lacks kernel {kernel}"
        );
        // The threads' work knows the visitor, and what is compiled for each size of records and
        // number of channels does not: together they would be compiled ninety times.
        let groups = self.groups(kernel, weights, discrepancy);
        (0..groups.count())
            .into_par_iter()
            // Groups differ in size: a thread that is done takes the next.
            .with_max_len(1)
            .map(|index| {
                let mut accumulator = group();
                groups.visit(index, &mut |rows| visit(&mut accumulator, rows));
                accumulator
            })
            .collect()
    }

    fn groups<'a>(
        &'a self,
        kernel: Kernel,
        weights: ChannelWeights<'_>,
        discrepancy: &Discrepancies<'_>,
    ) -> Box<dyn Groups + 'a> {
        macro_rules! by_channels {
            ($chunks:expr, $b:literal) => {
                match weights.len() {
                    1 => Box::new(Pass::<$b, 1>::new(
                        self,
                        kernel,
                        $chunks,
                        weights,
                        discrepancy,
                    )),
                    3 => Box::new(Pass::<$b, 3>::new(
                        self,
                        kernel,
                        $chunks,
                        weights,
                        discrepancy,
                    )),
                    n => panic!("{n} channels of weights; 1 or 3 are possible"),
                }
            };
        }
        match &*self.records {
            Records::Blocks1(c) => by_channels!(c, 1),
            Records::Blocks2(c) => by_channels!(c, 2),
            Records::Blocks3(c) => by_channels!(c, 3),
            Records::Blocks5(c) => by_channels!(c, 5),
            Records::Blocks8(c) => by_channels!(c, 8),
        }
    }
}

/// Cells of a cache in groups, each for one thread.
trait Groups: Sync {
    fn count(&self) -> usize;

    /// Evaluates the cells of one group in order.
    fn visit(&self, group: usize, visit: &mut dyn FnMut(&CellRows<'_>));
}

/// An evaluation of records of `B` blocks of lanes for `C` channels.
struct Pass<'a, const B: usize, const C: usize> {
    cache: &'a Cache,
    kernel: Kernel,
    groups: Vec<&'a [Chunk<B>]>,
    mixture: Mixture<B, C>,
    /// The modes in rows.
    modes: Option<DMatrix<f32>>,
}

impl<'a, const B: usize, const C: usize> Pass<'a, B, C> {
    fn new(
        cache: &'a Cache,
        kernel: Kernel,
        chunks: &'a [Chunk<B>],
        weights: ChannelWeights<'_>,
        discrepancy: &Discrepancies<'_>,
    ) -> Self {
        let per_group = chunks.len().div_ceil(MAX_GROUPS).max(1);
        Self {
            cache,
            kernel,
            groups: chunks.chunks(per_group).collect(),
            mixture: Mixture::new(&cache.atoms, weights, discrepancy.factors),
            modes: discrepancy
                .modes
                .map(|modes| modes.transpose().map(|v| v as f32)),
        }
    }
}

impl<const B: usize, const C: usize> Groups for Pass<'_, B, C> {
    fn count(&self) -> usize {
        self.groups.len()
    }

    fn visit(&self, group: usize, visit: &mut dyn FnMut(&CellRows<'_>)) {
        let cache = self.cache;
        let rows = cache.lights * C;
        // Room for one cell, used again for all of the group.
        let mut scratch = Scratch::new();
        let by_node = self.modes.is_some();
        let mut sums = [(); 2].map(|()| Sums::<B, C>::new(cache.lights, by_node));
        let mut jacobian = [(); 2].map(|()| vec![0.0; rows * cache.atoms.atoms()]);
        let mut nodes = DMatrix::zeros(VALUES, if by_node { rows } else { 0 });
        let modes = self.modes.as_ref().map_or(0, DMatrix::nrows);
        let mut by_modes = [(); 2].map(|()| DMatrix::zeros(modes, nodes.ncols()));
        let mut values = [(); 2].map(|()| vec![0.0; rows]);
        let mut variance = vec![0.0; rows];
        for records in self.groups[group] {
            for p in 0..records.start.len() / 2 {
                for half in 0..2 {
                    let range = records.start[2 * p + half] as usize
                        ..records.start[2 * p + half + 1] as usize;
                    pass(
                        self.kernel,
                        &records.records[range],
                        &self.mixture,
                        &mut scratch,
                        &mut sums[half],
                    );
                    sums[half].rows(
                        &cache.atoms,
                        cache.samples_per_half,
                        &mut values[half],
                        &mut jacobian[half],
                    );
                    if let Some(modes) = &self.modes {
                        sums[half].by_node(cache.samples_per_half, &mut nodes);
                        by_modes[half].gemm(1.0, modes, &nodes, 0.0);
                    }
                }
                // Variance of the mean over both halves' paths.
                let n = 2.0 * cache.samples_per_half as f32;
                for (r, out) in variance.iter_mut().enumerate() {
                    let mean = 0.5 * (values[0][r] + values[1][r]);
                    let square = (sums[0].square(r) + sums[1].square(r)) / n;
                    *out = ((square - mean * mean) / (n - 1.0)).max(0.0);
                }
                visit(&CellRows {
                    cell: records.first_cell + p,
                    value: [&values[0], &values[1]],
                    variance: &variance,
                    jacobian: [&jacobian[0], &jacobian[1]],
                    by_modes: [by_modes[0].as_slice(), by_modes[1].as_slice()],
                });
            }
        }
    }
}

/// Weights in lane order.
struct Mixture<const B: usize, const C: usize> {
    lanes: [[[f32; 8]; B]; C],
    lambertian: [f32; C],
    /// Of f, by the place of a record; without discrepancy, one.
    factors: Vec<[f32; C]>,
    /// All bits of a place, or none without discrepancy.
    places: usize,
}

impl<const B: usize, const C: usize> Mixture<B, C> {
    fn new(atoms: &LaneAtoms, weights: ChannelWeights<'_>, factors: &[Vec<f32>]) -> Self {
        let places = factors.first().map_or(1, Vec::len);
        let mut mixture = Self {
            lanes: [[[0.0; 8]; B]; C],
            lambertian: [0.0; C],
            factors: vec![[1.0; C]; places],
            places: if places == 1 { 0 } else { usize::MAX },
        };
        for (c, factors) in factors.iter().enumerate().take(C) {
            for (all, factor) in mixture.factors.iter_mut().zip(factors) {
                all[c] = *factor;
            }
        }
        for (c, weights) in weights.iter().enumerate().take(C) {
            (mixture.lanes[c], mixture.lambertian[c]) = atoms.lane_weights::<B>(weights);
        }
        mixture
    }
}

/// cos 2φd by level.
static COS_2PHI: [f32; LEVELS] = {
    let mut cosines = [0.0; LEVELS];
    let mut level = 0;
    while level < LEVELS {
        cosines[level] = cos_2phi_of(level);
        level += 1;
    }
    cosines
};

/// Sums over the paths of one half of a cell, per light.
struct Sums<const B: usize, const C: usize>(
    Vec<LightSums<B, C>>,
    /// By g₀ and g₁ at the nodes, per light; empty unless requested.
    Vec<Vec<[[f32; C]; 2]>>,
);

/// Sums under one light, per channel.
#[derive(Clone, Copy)]
struct LightSums<const B: usize, const C: usize> {
    value: [f32; C],
    square: [f32; C],
    lambertian: [f32; C],
    gradient: [[[f32; 8]; B]; C],
}

impl<const B: usize, const C: usize> Sums<B, C> {
    fn new(lights: usize, by_node: bool) -> Self {
        let sums = vec![
            LightSums {
                value: [0.0; C],
                square: [0.0; C],
                lambertian: [0.0; C],
                gradient: [[[0.0; 8]; B]; C],
            };
            lights
        ];
        let nodes = if by_node { lights } else { 0 };
        Self(sums, vec![vec![[[0.0; C]; 2]; NODES]; nodes])
    }

    fn square(&self, row: usize) -> f32 {
        self.0[row / C].square[row % C]
    }

    /// Means over the samples by the values of a discrepancy, a column per row of a cell.
    fn by_node(&self, samples: u32, out: &mut DMatrix<f32>) {
        let scale = 1.0 / samples as f32;
        for (light, nodes) in self.1.iter().enumerate() {
            for c in 0..C {
                let mut column = out.column_mut(light * C + c);
                for (k, node) in nodes.iter().enumerate() {
                    column[k] = node[0][c] * scale;
                    column[NODES + k] = node[1][c] * scale;
                }
            }
        }
    }

    /// Means over the samples, in the dictionary's order.
    fn rows(&self, atoms: &LaneAtoms, samples: u32, values: &mut [f32], rows: &mut [f32]) {
        let scale = 1.0 / samples as f32;
        let n = atoms.atoms();
        for (light, sums) in self.0.iter().enumerate() {
            for c in 0..C {
                let r = light * C + c;
                values[r] = sums.value[c] * scale;
                let row = &mut rows[r * n..(r + 1) * n];
                atoms.atom_row(&sums.gradient[c], sums.lambertian[c], scale, row);
            }
        }
    }
}

/// What the sweeps over a cell's records leave for each other.
struct Scratch<const C: usize> {
    /// Per record.
    steps: Vec<Step<C>>,
    /// Records that have a share in the light's derivative, and the factor of their
    /// values there.
    share: Vec<(u32, [f32; C])>,
}

/// What the forward sweep leaves of a record.
#[derive(Clone, Copy)]
struct Step<const C: usize> {
    /// f of the mixture.
    f: [f32; C],
    /// f · weight, by which a continuation multiplies what comes after it.
    gain: [f32; C],
    /// Weight times the product of all gains before it on its path.
    before: [f32; C],
}

impl<const C: usize> Scratch<C> {
    fn new() -> Self {
        Self {
            steps: Vec::new(),
            share: Vec::new(),
        }
    }

    /// Room for `n` records.
    fn slices(&mut self, n: usize) -> (&mut [Step<C>], &mut [(u32, [f32; C])]) {
        if self.steps.len() < n {
            let step = Step {
                f: [0.0; C],
                gain: [0.0; C],
                before: [0.0; C],
            };
            self.steps.resize(n, step);
            self.share.resize(n, (0, [0.0; C]));
        }
        (&mut self.steps[..n], &mut self.share[..n])
    }
}

/// Functions of their own: inlined into every caller they would be compiled many times over.
fn pass<const B: usize, const C: usize>(
    kernel: Kernel,
    records: &[Record<B>],
    mixture: &Mixture<B, C>,
    scratch: &mut Scratch<C>,
    sums: &mut Sums<B, C>,
) {
    match kernel {
        Kernel::Portable => pass_portable::<B, C>(records, mixture, scratch, sums),
        #[cfg(target_arch = "x86_64")]
        // SAFETY: `Cache::evaluate` let only an available kernel pass.
        Kernel::Avx2 => unsafe { pass_avx2::<B, C>(records, mixture, scratch, sums) },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: as above.
        Kernel::Avx512 => unsafe { pass_avx512::<B, C>(records, mixture, scratch, sums) },
        #[cfg(not(target_arch = "x86_64"))]
        _ => unreachable!("not available on this architecture"),
    }
}

#[inline(never)]
fn pass_portable<const B: usize, const C: usize>(
    records: &[Record<B>],
    mixture: &Mixture<B, C>,
    scratch: &mut Scratch<C>,
    sums: &mut Sums<B, C>,
) {
    sweep::<Portable, B, C>(records, mixture, scratch, sums);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma,f16c")]
fn pass_avx2<const B: usize, const C: usize>(
    records: &[Record<B>],
    mixture: &Mixture<B, C>,
    scratch: &mut Scratch<C>,
    sums: &mut Sums<B, C>,
) {
    sweep::<super::lanes::Avx2, B, C>(records, mixture, scratch, sums);
}

/// The same eight lanes, with the twice as many registers and the masks of AVX-512.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma,f16c,avx512f,avx512vl,avx512dq,avx512bw")]
fn pass_avx512<const B: usize, const C: usize>(
    records: &[Record<B>],
    mixture: &Mixture<B, C>,
    scratch: &mut Scratch<C>,
    sums: &mut Sums<B, C>,
) {
    sweep::<super::lanes::Avx2, B, C>(records, mixture, scratch, sums);
}

/// Three sweeps without a branch on what a record is, as no processor predicts that:
/// forward for f and the products before each record, backward per light for what is
/// gathered after it, and over the records that have a share for the derivatives.
/// What a record is enters as factors of 0 and 1.
#[expect(
    clippy::needless_range_loop,
    reason = "only what is inlined here may use the kernel's instructions: loops, not closures"
)]
#[inline(always)]
fn sweep<L: Lanes, const B: usize, const C: usize>(
    records: &[Record<B>],
    mixture: &Mixture<B, C>,
    scratch: &mut Scratch<C>,
    sums: &mut Sums<B, C>,
) {
    let n = records.len();
    let (steps, shares) = scratch.slices(n);
    // Forward: f at each record, and the product of all factors before it on its path.
    let mut weights = [[L::splat(0.0); B]; C];
    for c in 0..C {
        for b in 0..B {
            weights[c][b] = L::load(&mixture.lanes[c][b]);
        }
    }
    let mut before = [0.0f32; C];
    // By what the record before multiplies the product.
    let mut factor = [0.0f32; C];
    for i in 0..n {
        let step = &mut steps[i];
        let head = records[i].head();
        let flags = head.flags();
        let scale = head.scale();
        let node_factors = &mixture.factors[head.place() & mixture.places];
        let dot = records[i].dot::<L, C>(&weights);
        // About as many records come next: the pixel's other half, or the next pixel.
        L::prefetch(&records[i], n);
        for c in 0..C {
            let weight = head.weight * node_factors[c];
            step.f[c] = L::fused(dot[c], scale, mixture.lambertian[c]);
            let gain = step.f[c] * weight;
            before[c] = L::fused(before[c], factor[c] * flags.later, flags.first);
            step.before[c] = before[c] * weight;
            step.gain[c] = gain;
            factor[c] = L::fused(gain, flags.goes_on, flags.connects);
        }
    }

    // Backward, lamp by lamp: the light gathered after each record, and each record's share.
    let mut is_lamp = [0.0f32; MAX_LIGHTS];
    let Sums(by_atom, by_node) = sums;
    for (light, sums) in by_atom.iter_mut().enumerate() {
        is_lamp[light] = 1.0;
        let mut count = 0;
        let (mut value, mut square, mut lambertian) = ([0.0f32; C], [0.0f32; C], [0.0f32; C]);
        let mut after = [0.0f32; C];
        // 0 where the record before is the last of its path.
        let mut same_path = 0.0;
        for i in (0..n).rev() {
            let step = &steps[i];
            let head = records[i].head();
            let flags = head.flags();
            let connects = flags.connects * is_lamp[head.lamp()];
            let mut share = [0.0f32; C];
            for c in 0..C {
                // A path never ends with a continuation: what is after it is its own.
                let coefficient = step.before[c] * L::fused(after[c], flags.goes_on, connects);
                let factor = L::fused(step.gain[c], flags.goes_on, flags.connects) * same_path;
                after[c] = L::fused(after[c], factor, step.gain[c] * connects);
                let total = after[c] * flags.first;
                value[c] += total;
                square[c] = L::fused(total, total, square[c]);
                lambertian[c] += coefficient;
                share[c] = coefficient;
            }
            same_path = flags.later;
            shares[count] = (i as u32, share);
            count += usize::from(share != [0.0; C]);
        }
        is_lamp[light] = 0.0;
        // Derivatives by the atoms' weights: the shares times the atoms' values.
        let mut gradient = [[L::splat(0.0); B]; C];
        for &(i, share) in &shares[..count] {
            let i = i as usize;
            let scale = records[i].head().scale();
            for c in 0..C {
                let share = share[c] * scale;
                records[i].accumulate(share, &mut gradient[c]);
            }
        }
        // Derivatives by ln f at the nodes of the discrepancy.
        if let Some(nodes) = by_node.get_mut(light) {
            nodes.fill([[0.0; C]; 2]);
            for &(i, share) in &shares[..count] {
                let i = i as usize;
                let place = records[i].head().place();
                let cosine = COS_2PHI[place % LEVELS];
                let node = &mut nodes[place / LEVELS];
                for c in 0..C {
                    let part = share[c] * steps[i].f[c];
                    node[0][c] += part;
                    node[1][c] = L::fused(part, cosine, node[1][c]);
                }
            }
        }
        for c in 0..C {
            for b in 0..B {
                gradient[c][b].store(&mut sums.gradient[c][b]);
            }
        }
        (sums.value, sums.square, sums.lambertian) = (value, square, lambertian);
    }
}

#[cfg(test)]
mod tests;
