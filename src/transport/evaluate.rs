//! One pass over the cached paths: image and per-pixel Jacobian for given weights.
//!
//! Along a path, light gathered after record i is R; a continuation turns it into
//! f·g·R, a connection adds f·w. The derivative with respect to atom n is the sum
//! over records of (product of all factors before) · f_n · (what follows), formed
//! from prefix products and the suffix R: no division by f, so a vertex where the
//! current mixture is black still contributes (docs/adr/0002).

use rayon::prelude::*;

use super::cache::{Cache, Chunk, Records};
use super::event::{LaneAtoms, Record};
use super::lanes::{Lanes, Portable};

/// Which instructions evaluate the cache.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kernel {
    /// Plain Rust; the same numbers on every machine.
    Portable,
    /// AVX2 with FMA and F16C.
    Avx2,
}

impl Kernel {
    /// The fastest that this processor has.
    pub fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2")
            && is_x86_feature_detected!("fma")
            && is_x86_feature_detected!("f16c")
        {
            return Kernel::Avx2;
        }
        Kernel::Portable
    }
}

impl std::fmt::Display for Kernel {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.write_str(match self {
            Kernel::Portable => "portable",
            Kernel::Avx2 => "avx2",
        })
    }
}

/// One pixel's multiple-reflection radiance per unit lamp strength: values and
/// derivatives of both halves. Row `r = light · channels + channel`.
pub struct PixelRows<'a> {
    /// The pixel.
    pub pixel: usize,
    /// `value[half][r]`.
    pub value: [&'a [f32]; 2],
    /// Variance of the mean of both halves, per row.
    pub variance: &'a [f32],
    /// `jacobian[half][r · atoms + atom]`.
    pub jacobian: [&'a [f32]; 2],
}

/// Weights of one mixture per channel; all channels may share one.
pub type ChannelWeights<'a> = &'a [&'a [f64]];

impl Cache {
    /// Evaluates every pixel for `weights` (1 or 3 channels × atoms). `chunk` makes
    /// an accumulator for each group of pixels, `visit` adds a pixel to it; the
    /// accumulators come back in the order of the pixels, whatever the threads did.
    pub fn evaluate<T: Send>(
        &self,
        kernel: Kernel,
        weights: ChannelWeights<'_>,
        chunk: impl Fn() -> T + Sync,
        visit: impl Fn(&mut T, &PixelRows<'_>) + Sync,
    ) -> Vec<T> {
        macro_rules! by_channels {
            ($chunks:expr, $b:literal) => {
                match weights.len() {
                    1 => self.run::<$b, 1, _, _>(kernel, $chunks, weights, &chunk, &visit),
                    3 => self.run::<$b, 3, _, _>(kernel, $chunks, weights, &chunk, &visit),
                    n => panic!("{n} channels of weights; 1 or 3 are possible"),
                }
            };
        }
        match &self.records {
            Records::Grid(c) => by_channels!(c, 5),
            Records::General1(c) => by_channels!(c, 1),
            Records::General2(c) => by_channels!(c, 2),
            Records::General3(c) => by_channels!(c, 3),
            Records::General5(c) => by_channels!(c, 5),
            Records::General8(c) => by_channels!(c, 8),
        }
    }

    fn run<const B: usize, const C: usize, R: Record<B>, T: Send>(
        &self,
        kernel: Kernel,
        chunks: &[Chunk<R>],
        weights: ChannelWeights<'_>,
        chunk: &(impl Fn() -> T + Sync),
        visit: &(impl Fn(&mut T, &PixelRows<'_>) + Sync),
    ) -> Vec<T> {
        let mixture = Mixture::<B, C>::new(&self.atoms, weights);
        let atoms = self.atoms.atoms();
        chunks
            .par_iter()
            .map(|records| {
                let mut accumulator = chunk();
                let mut sums = [
                    Sums::<B, C>::new(self.lights),
                    Sums::<B, C>::new(self.lights),
                ];
                let mut rows = [
                    vec![0.0; self.lights * C * atoms],
                    vec![0.0; self.lights * C * atoms],
                ];
                let mut values = [vec![0.0; self.lights * C], vec![0.0; self.lights * C]];
                let mut variance = vec![0.0; self.lights * C];
                let mut scratch = Vec::new();
                for p in 0..records.start.len() / 2 {
                    for half in 0..2 {
                        let range = records.start[2 * p + half] as usize
                            ..records.start[2 * p + half + 1] as usize;
                        sums[half].clear();
                        match kernel {
                            Kernel::Portable => {
                                pass_portable::<B, C, R>(
                                    &records.records[range],
                                    &mixture,
                                    &mut sums[half],
                                    &mut scratch,
                                );
                            }
                            #[cfg(target_arch = "x86_64")]
                            // SAFETY: the kernel is chosen by `Kernel::detect`.
                            Kernel::Avx2 => unsafe {
                                pass_avx2::<B, C, R>(
                                    &records.records[range],
                                    &mixture,
                                    &mut sums[half],
                                    &mut scratch,
                                );
                            },
                            #[cfg(not(target_arch = "x86_64"))]
                            Kernel::Avx2 => unreachable!("not detected on this architecture"),
                        }
                        sums[half].rows(
                            &self.atoms,
                            self.samples_per_half,
                            &mut values[half],
                            &mut rows[half],
                        );
                    }
                    let n = 2.0 * self.samples_per_half as f32;
                    for (r, out) in variance.iter_mut().enumerate() {
                        let mean = 0.5 * (values[0][r] + values[1][r]);
                        let square = (sums[0].square[r] + sums[1].square[r]) / n;
                        *out = ((square - mean * mean) / (n - 1.0)).max(0.0);
                    }
                    visit(
                        &mut accumulator,
                        &PixelRows {
                            pixel: records.first_pixel + p,
                            value: [&values[0], &values[1]],
                            variance: &variance,
                            jacobian: [&rows[0], &rows[1]],
                        },
                    );
                }
                accumulator
            })
            .collect()
    }
}

/// Weights in lane order.
struct Mixture<const B: usize, const C: usize> {
    lanes: [[[f32; 8]; B]; C],
    lambertian: [f32; C],
}

impl<const B: usize, const C: usize> Mixture<B, C> {
    fn new(atoms: &LaneAtoms, weights: ChannelWeights<'_>) -> Self {
        let mut mixture = Self {
            lanes: [[[0.0; 8]; B]; C],
            lambertian: [0.0; C],
        };
        for (c, weights) in weights.iter().enumerate().take(C) {
            (mixture.lanes[c], mixture.lambertian[c]) = atoms.lane_weights::<B>(weights);
        }
        mixture
    }
}

/// Sums over the paths of one half of a pixel; row r = light · C + channel.
struct Sums<const B: usize, const C: usize> {
    value: Vec<f32>,
    square: Vec<f32>,
    gradient: Vec<[[f32; 8]; B]>,
    lambertian: Vec<f32>,
}

impl<const B: usize, const C: usize> Sums<B, C> {
    fn new(lights: usize) -> Self {
        let rows = lights * C;
        Self {
            value: vec![0.0; rows],
            square: vec![0.0; rows],
            gradient: vec![[[0.0; 8]; B]; rows],
            lambertian: vec![0.0; rows],
        }
    }

    fn clear(&mut self) {
        self.value.fill(0.0);
        self.square.fill(0.0);
        self.gradient.fill([[0.0; 8]; B]);
        self.lambertian.fill(0.0);
    }

    /// Adds `coefficient` times the atoms' values of a record to a row.
    #[inline(always)]
    fn add<L: Lanes>(&mut self, row: usize, blocks: &[L; B], scale: f32, coefficient: f32) {
        let lanes = L::splat(coefficient * scale);
        let gradient = &mut self.gradient[row];
        for b in 0..B {
            blocks[b]
                .mul_add(lanes, L::load(&gradient[b]))
                .store(&mut gradient[b]);
        }
        self.lambertian[row] += coefficient;
    }

    /// Means over the samples, in the dictionary's order.
    fn rows(&self, atoms: &LaneAtoms, samples: u32, values: &mut [f32], rows: &mut [f32]) {
        let scale = 1.0 / samples as f32;
        let n = atoms.atoms();
        for r in 0..self.value.len() {
            values[r] = self.value[r] * scale;
            atoms.atom_row(
                &self.gradient[r],
                self.lambertian[r],
                scale,
                &mut rows[r * n..(r + 1) * n],
            );
        }
    }
}

/// What the forward sweep leaves for the backward one.
#[derive(Clone, Copy)]
struct Step<const C: usize> {
    f: [f32; C],
    before: [f32; C],
}

/// A function of its own: inlined into every caller it would be compiled many times over.
#[inline(never)]
fn pass_portable<const B: usize, const C: usize, R: Record<B>>(
    records: &[R],
    mixture: &Mixture<B, C>,
    sums: &mut Sums<B, C>,
    scratch: &mut Vec<Step<C>>,
) {
    pass::<Portable, B, C, R>(records, mixture, sums, scratch);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma,f16c")]
fn pass_avx2<const B: usize, const C: usize, R: Record<B>>(
    records: &[R],
    mixture: &Mixture<B, C>,
    sums: &mut Sums<B, C>,
    scratch: &mut Vec<Step<C>>,
) {
    pass::<super::lanes::Avx2, B, C, R>(records, mixture, sums, scratch);
}

#[expect(
    clippy::needless_range_loop,
    reason = "only what is inlined here may use the kernel's instructions: loops, not closures"
)]
#[inline(always)]
fn pass<L: Lanes, const B: usize, const C: usize, R: Record<B>>(
    records: &[R],
    mixture: &Mixture<B, C>,
    sums: &mut Sums<B, C>,
    scratch: &mut Vec<Step<C>>,
) {
    let mut weights = [[L::splat(0.0); B]; C];
    for c in 0..C {
        for b in 0..B {
            weights[c][b] = L::load(&mixture.lanes[c][b]);
        }
    }
    let lights = sums.value.len() / C;
    let mut gathered = [[0.0f32; C]; super::event::MAX_LIGHTS];
    let mut begin = 0;
    while begin < records.len() {
        // Forward: f of every record, and the product of all factors before it.
        scratch.clear();
        let mut before = [1.0f32; C];
        let mut end = begin;
        while end < records.len() && (end == begin || !records[end].head().is_first()) {
            let record = &records[end];
            let head = record.head();
            let blocks = record.decode::<L>();
            let scale = head.scale();
            let mut f = mixture.lambertian;
            for c in 0..C {
                let mut dot = blocks[0].mul(weights[c][0]);
                for b in 1..B {
                    dot = blocks[b].mul_add(weights[c][b], dot);
                }
                f[c] += dot.sum() * scale;
            }
            scratch.push(Step { f, before });
            if head.light().is_none() {
                for c in 0..C {
                    before[c] *= f[c] * head.weight;
                }
            }
            end += 1;
        }
        // Backward: what is gathered after each record.
        for after in &mut gathered[..lights] {
            *after = [0.0; C];
        }
        for i in (begin..end).rev() {
            let record = &records[i];
            let head = record.head();
            let scale = head.scale();
            let step = &scratch[i - begin];
            let blocks = record.decode::<L>();
            match head.light() {
                Some(light) => {
                    for c in 0..C {
                        let coefficient = step.before[c] * head.weight;
                        sums.add(light * C + c, &blocks, scale, coefficient);
                        gathered[light][c] += step.f[c] * head.weight;
                    }
                }
                None => {
                    for light in 0..lights {
                        let after = &mut gathered[light];
                        if *after == [0.0; C] {
                            continue;
                        }
                        for c in 0..C {
                            let coefficient = step.before[c] * head.weight * after[c];
                            sums.add(light * C + c, &blocks, scale, coefficient);
                            after[c] *= step.f[c] * head.weight;
                        }
                    }
                }
            }
        }
        for (light, total) in gathered[..lights].iter().enumerate() {
            for c in 0..C {
                sums.value[light * C + c] += total[c];
                sums.square[light * C + c] += total[c] * total[c];
            }
        }
        begin = end;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::brdf::dictionary::Dictionary;
    use crate::geometry::Shape;
    use crate::transport::{CacheOptions, Camera, Light, Projection, Scene, Shading};
    use glam::{DVec2, DVec3};

    fn scene() -> Scene {
        let mesh = Shape::Bowl {
            radius_mm: 1.0,
            segments: 32,
        }
        .mesh()
        .unwrap();
        let camera = Camera::looking_at(
            [8, 8],
            Projection::Orthographic {
                extent_mm: DVec2::splat(2.2),
            },
            DVec3::new(0.0, 0.0, 5.0),
            DVec3::ZERO,
            DVec3::Y,
        )
        .unwrap();
        let light = |x: f64| Light::Directional {
            to_light: DVec3::new(x, 0.1, 1.0).normalize(),
            irradiance: [1.0; 3],
            angular_radius_rad: 0.0,
        };
        Scene::new(mesh, Shading::Flat, camera, vec![light(0.0), light(0.4)])
    }

    /// Sum over all pixels of the radiance under each lamp, in f64, by walking the
    /// records: the definition that the kernels must reproduce.
    fn radiance<const B: usize, R: Record<B>>(
        chunks: &[Chunk<R>],
        atoms: &LaneAtoms,
        weights: &[f64],
        lights: usize,
    ) -> Vec<f64> {
        // Weights in f64: the kernels' own are rounded to f32.
        let mut exact = vec![0.0f64; B * 8];
        let mut lambertian = 0.0;
        for (n, &weight) in weights.iter().enumerate() {
            let mut unit = vec![0.0; atoms.atoms()];
            unit[n] = 1.0;
            let (one, constant) = atoms.lane_weights::<B>(&unit);
            for (sum, value) in exact.iter_mut().zip(one.iter().flatten()) {
                *sum += f64::from(*value) * weight;
            }
            lambertian += f64::from(constant) * weight;
        }
        let mut total = vec![0.0; lights];
        for record_list in chunks.iter().map(|c| &c.records) {
            let mut throughput = 1.0;
            for record in record_list {
                let head = record.head();
                if head.is_first() {
                    throughput = 1.0;
                }
                let mut f = lambertian;
                for (b, block) in record.decode::<Portable>().into_iter().enumerate() {
                    let mut values = [0.0; 8];
                    block.store(&mut values);
                    for i in 0..8 {
                        f += f64::from(values[i]) * f64::from(head.scale()) * exact[b * 8 + i];
                    }
                }
                match head.light() {
                    Some(light) => total[light] += throughput * f * f64::from(head.weight),
                    None => throughput *= f * f64::from(head.weight),
                }
            }
        }
        total
    }

    /// Central differences of the f64 walk against the kernels' Jacobian, summed over
    /// the pixels, also with all weight on one atom (where the others' f is not a factor).
    #[test]
    fn jacobian_agrees_with_central_differences() {
        let scene = scene();
        for (dictionary, allow_grid) in [
            (Dictionary::grid42(), true),
            (Dictionary::grid42(), false),
            (Dictionary::paper42(), true),
        ] {
            let options = CacheOptions {
                samples_per_pixel: 32,
                max_reflections: 6,
                allow_grid,
                ..CacheOptions::default()
            };
            let cache = Cache::trace(&scene, &dictionary, &options).unwrap();
            let n = dictionary.len();
            let mut single = vec![0.0; n];
            single[7] = 1.0;
            let mut black = vec![0.0; n];
            black[n - 1] = 1.0;
            for weights in [vec![1.0 / n as f64; n], single, black] {
                let walk = |w: &[f64]| match &cache.records {
                    Records::Grid(c) => radiance(c, &cache.atoms, w, 2),
                    Records::General5(c) => radiance(c, &cache.atoms, w, 2),
                    _ => panic!("unexpected layout"),
                };
                for kernel in [Kernel::Portable, Kernel::detect()] {
                    let (values, gradient) = totals(&cache, kernel, &weights);
                    let expected = walk(&weights);
                    for light in 0..2 {
                        let scale = expected[light].abs().max(1e-12);
                        assert!(
                            (values[light] - expected[light]).abs() <= 1e-5 * scale,
                            "{} {kernel}: {} for {}",
                            dictionary.name(),
                            values[light],
                            expected[light]
                        );
                    }
                    let step = 1e-5;
                    let mut worst: f64 = 0.0;
                    let largest = gradient
                        .iter()
                        .flatten()
                        .fold(0.0f64, |m, v| m.max(v.abs()));
                    for atom in 0..n {
                        let (mut up, mut down) = (weights.clone(), weights.clone());
                        up[atom] += step;
                        down[atom] -= step;
                        let (up, down) = (walk(&up), walk(&down));
                        for light in 0..2 {
                            let difference = (up[light] - down[light]) / (2.0 * step);
                            let error = (gradient[light][atom] - difference).abs();
                            worst =
                                worst.max(error / difference.abs().max(1e-2 * largest).max(1e-2));
                        }
                    }
                    assert!(
                        worst < 1e-4,
                        "{} {kernel}: worst {worst}",
                        dictionary.name()
                    );
                }
            }
        }
    }

    /// Sums over pixels and samples of value and Jacobian per light.
    fn totals(cache: &Cache, kernel: Kernel, weights: &[f64]) -> (Vec<f64>, Vec<Vec<f64>>) {
        let n = weights.len();
        let samples = f64::from(cache.samples_per_half);
        let parts = cache.evaluate(
            kernel,
            &[weights],
            || (vec![0.0; 2], vec![vec![0.0; n]; 2]),
            |(values, gradient), rows| {
                for half in 0..2 {
                    for light in 0..2 {
                        values[light] += samples * f64::from(rows.value[half][light]);
                        let jacobian = &rows.jacobian[half][light * n..][..n];
                        for (sum, &row) in gradient[light].iter_mut().zip(jacobian) {
                            *sum += samples * f64::from(row);
                        }
                    }
                }
            },
        );
        let mut sum = (vec![0.0; 2], vec![vec![0.0; n]; 2]);
        for (values, gradient) in parts {
            for light in 0..2 {
                sum.0[light] += values[light];
                for (sum, part) in sum.1[light].iter_mut().zip(&gradient[light]) {
                    *sum += part;
                }
            }
        }
        sum
    }

    #[test]
    fn results_do_not_depend_on_the_number_of_threads() {
        let scene = scene();
        let dictionary = Dictionary::grid42();
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            pool.install(|| {
                let options = CacheOptions {
                    samples_per_pixel: 16,
                    ..CacheOptions::default()
                };
                let cache = Cache::trace(&scene, &dictionary, &options).unwrap();
                totals(&cache, Kernel::detect(), &vec![1.0 / 42.0; 42])
            })
        };
        assert_eq!(run(1), run(3));
    }
}
