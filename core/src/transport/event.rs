//! What the cache keeps of one reflection: the values of all atoms there, in half
//! precision, and the factor that the geometry and the proposal contribute.
//!
//! Lane `b · 8 + i` of a record belongs to one GGX atom. On a grid dictionary the
//! value is the product of D·G (of the width) and F (of the index), and a record
//! takes 32 bytes; in general one half-precision number per atom is kept.
//! A power of two common to the record keeps the numbers within the range of half
//! precision; Lambertian atoms need no storage.

use half::f16;
use half::slice::HalfFloatSliceExt;

use super::lanes::Lanes;
use crate::brdf::dictionary::{Dictionary, MAX_ATOMS};
use crate::brdf::discrepancy;
use crate::brdf::evaluator::Evaluator;
use crate::brdf::ggx::{self, Cosines};

/// A continuation: the path goes on to another surface.
const CONTINUES: u8 = 0x80;
/// The first record of a path.
const FIRST: u8 = 0x40;
/// The lamp of a connection.
const LIGHT: u8 = 0x3f;
/// Most lamps that a cache can hold.
pub const MAX_LIGHTS: usize = LIGHT as usize + 1;

/// The part that all records share.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Head {
    /// Continuation: cos θ/pdf; connection: irradiance over the lamp's strength. Of a record, its
    /// last eight bits are the node of the discrepancy that stands for the pair of directions.
    pub weight: f32,
    /// Exponent of the power of two that multiplies the stored values.
    pub exponent: i8,
    tag: u8,
}

impl Head {
    /// A continuation.
    pub fn continuation(weight: f32) -> Self {
        Self {
            weight,
            exponent: 0,
            tag: CONTINUES,
        }
    }

    /// A connection to lamp `light` < [`MAX_LIGHTS`].
    pub fn connection(weight: f32, light: usize) -> Self {
        Self {
            weight,
            exponent: 0,
            tag: light as u8 & LIGHT,
        }
    }

    /// Marks the record as the first of its path.
    pub fn mark_first(&mut self) {
        self.tag |= FIRST;
    }

    /// Whether a path begins here.
    #[inline(always)]
    pub fn is_first(&self) -> bool {
        self.tag & FIRST != 0
    }

    /// The lamp of a connection; `None` for a continuation.
    #[inline(always)]
    pub fn light(&self) -> Option<usize> {
        (self.tag & CONTINUES == 0).then_some((self.tag & LIGHT) as usize)
    }

    /// What the record is, as factors of 0 and 1.
    #[inline(always)]
    pub fn kind(&self) -> &'static Kind {
        &KINDS[usize::from(self.tag >> 6)]
    }

    /// The lamp of a connection; anything for a continuation.
    #[inline(always)]
    pub fn lamp(&self) -> usize {
        usize::from(self.tag & LIGHT)
    }

    /// The discrepancy's node ([`discrepancy::node_near`]).
    #[inline(always)]
    pub fn node(&self) -> usize {
        usize::from(self.weight.to_bits() as u8)
    }

    /// With the node of a pair of directions. The weight keeps 16 bits, more than the values.
    #[inline]
    fn at(self, at: &Cosines<f32>) -> Self {
        let bits = self.weight.to_bits().saturating_add(0x80) & !0xff;
        let node = discrepancy::node_near(at.sin2_h, at.cos_d);
        Self {
            weight: f32::from_bits(bits | u32::from(node)),
            ..self
        }
    }

    /// 2^exponent.
    #[inline(always)]
    pub fn scale(&self) -> f32 {
        SCALES[usize::from(self.exponent.cast_unsigned())]
    }
}

/// Kind of a record, in numbers, because a branch on it could not be predicted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kind {
    /// 1 for the first record of a path, else 0.
    pub first: f32,
    /// The opposite of `first`.
    pub later: f32,
    /// 1 for a continuation, else 0.
    pub goes_on: f32,
    /// 1 for a connection, else 0.
    pub connects: f32,
}

/// Kinds by the two highest bits of the tag.
static KINDS: [Kind; 4] = {
    let mut kinds = [Kind {
        first: 0.0,
        later: 1.0,
        goes_on: 0.0,
        connects: 1.0,
    }; 4];
    (kinds[1].first, kinds[1].later) = (1.0, 0.0);
    (kinds[3].first, kinds[3].later) = (1.0, 0.0);
    (kinds[2].goes_on, kinds[2].connects) = (1.0, 0.0);
    (kinds[3].goes_on, kinds[3].connects) = (1.0, 0.0);
    kinds
};

/// Powers of two by the exponent's byte.
static SCALES: [f32; 256] = {
    let mut scales = [0.0; 256];
    let mut byte = 0;
    while byte < 256 {
        let exponent = (byte as u8).cast_signed() as i32;
        scales[byte] = f32::from_bits(((exponent + 127) as u32) << 23);
        byte += 1;
    }
    scales
};

/// A stored reflection with `B` blocks of eight lanes.
pub trait Record<const B: usize>: Copy + Send + Sync {
    /// Stores the atoms' values at `at`.
    fn encode(head: Head, atoms: &LaneAtoms, at: &Cosines<f32>) -> Self;
    /// The shared part.
    fn head(&self) -> Head;
    /// Marks the record as the first of its path.
    fn mark_first(&mut self);
    /// What is worked out once for both of the following.
    type Unpacked: Copy + Default;
    /// Works it out.
    fn unpack<L: Lanes>(&self) -> Self::Unpacked;
    /// Per channel the sum of the atoms' values times `weights`, over 2^exponent.
    fn dot<L: Lanes, const C: usize>(
        &self,
        unpacked: &Self::Unpacked,
        weights: &[[L; B]; C],
    ) -> [f32; C];
    /// `sums += factor ·` the atoms' values over 2^exponent.
    fn accumulate<L: Lanes>(&self, unpacked: &Self::Unpacked, factor: f32, sums: &mut [L; B]);
}

/// Where the stored values are put: largest in [2^14, 2^15).
const TOP_EXPONENT: i32 = 14;

/// Exponent of the power of two that brings `largest` to the top of the range.
fn exponent_for(largest: f32) -> i8 {
    let exponent = ((largest.to_bits() >> 23) & 0xff) as i32 - 127;
    (exponent - TOP_EXPONENT).clamp(-126, 127) as i8
}

/// Which atom each lane stands for.
#[derive(Clone, Debug)]
pub struct LaneAtoms {
    layout: Layout,
    /// Per lane: the dictionary's atom; `None` for a lane without one.
    atom_of_lane: Vec<Option<usize>>,
    lambertian: Vec<(usize, f64)>,
    atoms: usize,
}

/// How the lanes' values come about.
#[derive(Clone, Debug)]
enum Layout {
    /// Lane `e · 8 + a` is D·G of width `a` times F of index `e`.
    Grid { alphas: Vec<f32>, etas: Vec<f32> },
    /// Each lane has its own value.
    General(Evaluator),
}

impl LaneAtoms {
    /// The layout of a dictionary: separable if its lobes are a grid of at most
    /// eight widths and five indices and `allow_grid` says so.
    pub fn new(dictionary: &Dictionary, allow_grid: bool) -> Self {
        let atoms = dictionary.atoms();
        let lambertian = atoms
            .iter()
            .enumerate()
            .filter_map(|(i, atom)| Some((i, atom.albedo()?)))
            .collect();
        let (layout, atom_of_lane) = match dictionary.grid_axes().filter(|_| allow_grid) {
            Some(axes) => {
                let mut atom_of_lane = vec![None; 8 * 5];
                for e in 0..axes.etas.len() {
                    for a in 0..axes.alphas.len() {
                        atom_of_lane[e * 8 + a] = Some(axes.atom[a * axes.etas.len() + e]);
                    }
                }
                let single = |axis: &[f64]| axis.iter().map(|&value| value as f32).collect();
                let layout = Layout::Grid {
                    alphas: single(&axes.alphas),
                    etas: single(&axes.etas),
                };
                (layout, atom_of_lane)
            }
            None => {
                let lanes: Vec<usize> = (0..atoms.len()).filter(|&i| atoms[i].varies()).collect();
                let evaluator = Evaluator::new(lanes.iter().map(|&i| &atoms[i]));
                let atom_of_lane = lanes.into_iter().map(Some).collect();
                (Layout::General(evaluator), atom_of_lane)
            }
        };
        Self {
            layout,
            atom_of_lane,
            lambertian,
            atoms: atoms.len(),
        }
    }

    /// Whether the separable layout is used.
    pub fn is_grid(&self) -> bool {
        matches!(self.layout, Layout::Grid { .. })
    }

    /// Blocks of eight lanes that are needed.
    pub fn blocks(&self) -> usize {
        self.atom_of_lane.len().div_ceil(8)
    }

    /// Number of atoms of the dictionary.
    pub fn atoms(&self) -> usize {
        self.atoms
    }

    /// The dictionary's weights in lane order (`B` blocks), and the Lambertian f_r, 1/sr.
    pub fn lane_weights<const B: usize>(&self, weights: &[f64]) -> ([[f32; 8]; B], f32) {
        let mut lanes = [[0.0; 8]; B];
        for (lane, atom) in self.atom_of_lane.iter().enumerate() {
            lanes[lane / 8][lane % 8] = atom.map_or(0.0, |a| weights[a] as f32);
        }
        let albedo: f64 = self
            .lambertian
            .iter()
            .map(|&(i, albedo)| weights[i] * albedo)
            .sum();
        (lanes, (albedo * std::f64::consts::FRAC_1_PI) as f32)
    }

    /// Sums per lane and the Lambertian sum as a row over the dictionary's atoms, times `scale`.
    pub fn atom_row(&self, lanes: &[[f32; 8]], lambertian: f32, scale: f32, row: &mut [f32]) {
        row.fill(0.0);
        for (lane, atom) in self.atom_of_lane.iter().enumerate() {
            if let Some(atom) = atom {
                row[*atom] = lanes[lane / 8][lane % 8] * scale;
            }
        }
        for &(atom, albedo) in &self.lambertian {
            row[atom] = lambertian * scale * albedo as f32 * std::f32::consts::FRAC_1_PI;
        }
    }

    /// Adds `factor · f_r` of every atom at `at` to `row`.
    pub fn add_values(&self, at: &Cosines<f32>, factor: f64, row: &mut [f64]) {
        let mut add = |lane: usize, value: f64| {
            if let Some(atom) = self.atom_of_lane[lane] {
                row[atom] += factor * value;
            }
        };
        match &self.layout {
            Layout::Grid { .. } => {
                let (lobes, fresnel) = self.factors(at);
                for (e, fresnel) in fresnel[..5].iter().enumerate() {
                    for (a, lobe) in lobes.iter().enumerate() {
                        add(e * 8 + a, f64::from(*lobe) * f64::from(*fresnel));
                    }
                }
            }
            Layout::General(evaluator) => {
                let mut values = [0.0; MAX_ATOMS];
                evaluator.eval(at, &mut values);
                let lanes = self.atom_of_lane.len();
                for (lane, &value) in values.iter().enumerate().take(lanes) {
                    add(lane, f64::from(value));
                }
            }
        }
        for &(atom, albedo) in &self.lambertian {
            row[atom] += factor * albedo * std::f64::consts::FRAC_1_PI;
        }
    }

    /// D·G per width and F per index of a grid.
    #[inline]
    fn factors(&self, at: &Cosines<f32>) -> ([f32; 8], [f32; 8]) {
        let (mut lobes, mut fresnel) = ([0.0; 8], [0.0; 8]);
        if let Layout::Grid { alphas, etas } = &self.layout {
            for (value, &alpha) in lobes.iter_mut().zip(alphas) {
                *value = ggx::d_g(alpha, at.cos_i, at.cos_o, at.sin2_h);
            }
            for (value, &eta) in fresnel.iter_mut().zip(etas) {
                *value = ggx::fresnel(eta, at.cos_d);
            }
        }
        (lobes, fresnel)
    }
}

/// 32 bytes: eight D·G, five F, exponent and tag, weight.
#[derive(Clone, Copy)]
#[repr(C, align(32))]
pub struct GridRecord {
    lobes: [u16; 8],
    /// F in the first five; the exponent's byte and the tag's; the weight's two halves.
    /// One array, so that a register takes it in one load.
    rest: [u16; 8],
}

const _: () = assert!(size_of::<GridRecord>() == 32);

/// One half-precision number per atom.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct GeneralRecord<const B: usize> {
    values: [[u16; 8]; B],
    head: Head,
}

/// Half precision of `values` · 2^−exponent.
#[inline]
fn store(values: &[f32; 8], exponent: i8) -> [u16; 8] {
    let scale = f32::from_bits(((127 - i32::from(exponent)).clamp(1, 254) as u32) << 23);
    let mut halves = [f16::ZERO; 8];
    halves.convert_from_f32_slice(&values.map(|v| v * scale));
    halves.map(f16::to_bits)
}

impl Record<5> for GridRecord {
    fn encode(head: Head, atoms: &LaneAtoms, at: &Cosines<f32>) -> Self {
        let head = head.at(at);
        let (lobes, fresnel) = atoms.factors(at);
        let largest = lobes.iter().fold(0.0f32, |m, &v| m.max(v));
        let exponent = exponent_for(largest);
        let [f0, f1, f2, f3, f4, ..] = store(&fresnel, 0);
        let marks = u16::from_le_bytes([exponent.cast_unsigned(), head.tag]);
        let weight = head.weight.to_bits();
        Self {
            lobes: store(&lobes, exponent),
            rest: [
                f0,
                f1,
                f2,
                f3,
                f4,
                marks,
                weight as u16,
                (weight >> 16) as u16,
            ],
        }
    }

    #[inline(always)]
    fn head(&self) -> Head {
        let [.., marks, low, high] = self.rest;
        let [exponent, tag] = marks.to_le_bytes();
        Head {
            weight: f32::from_bits(u32::from(low) | u32::from(high) << 16),
            exponent: exponent.cast_signed(),
            tag,
        }
    }

    fn mark_first(&mut self) {
        self.rest[5] |= u16::from(FIRST) << 8;
    }

    /// F in the first five; in memory, from where it is spread over a register for free.
    type Unpacked = [f32; 8];

    #[inline(always)]
    fn unpack<L: Lanes>(&self) -> [f32; 8] {
        let mut fresnel = [0.0; 8];
        L::from_f16(&self.rest).store(&mut fresnel);
        fresnel
    }

    #[inline(always)]
    fn dot<L: Lanes, const C: usize>(&self, fresnel: &[f32; 8], weights: &[[L; 5]; C]) -> [f32; C] {
        let lobes = L::from_f16(&self.lobes);
        let mut f = [0.0; C];
        for c in 0..C {
            let mut by_width = weights[c][0].mul(L::splat(fresnel[0]));
            for e in 1..5 {
                by_width = weights[c][e].mul_add(L::splat(fresnel[e]), by_width);
            }
            f[c] = by_width.mul(lobes).sum();
        }
        f
    }

    #[inline(always)]
    fn accumulate<L: Lanes>(&self, fresnel: &[f32; 8], factor: f32, sums: &mut [L; 5]) {
        let lobes = L::from_f16(&self.lobes).mul(L::splat(factor));
        for e in 0..5 {
            sums[e] = lobes.mul_add(L::splat(fresnel[e]), sums[e]);
        }
    }
}

#[expect(
    clippy::needless_range_loop,
    reason = "only what is inlined may use the kernel's instructions: a loop, not a closure"
)]
impl<const B: usize> Record<B> for GeneralRecord<B> {
    fn encode(head: Head, atoms: &LaneAtoms, at: &Cosines<f32>) -> Self {
        let mut head = head.at(at);
        let mut lanes = [[0.0f32; 8]; B];
        if let Layout::General(evaluator) = &atoms.layout {
            evaluator.eval(at, lanes.as_flattened_mut());
        }
        let largest = lanes.iter().flatten().fold(0.0f32, |m, &v| m.max(v));
        head.exponent = exponent_for(largest);
        Self {
            values: lanes.map(|block| store(&block, head.exponent)),
            head,
        }
    }

    #[inline(always)]
    fn head(&self) -> Head {
        self.head
    }

    fn mark_first(&mut self) {
        self.head.mark_first();
    }

    type Unpacked = ();

    #[inline(always)]
    fn unpack<L: Lanes>(&self) {}

    #[inline(always)]
    fn dot<L: Lanes, const C: usize>(&self, (): &(), weights: &[[L; B]; C]) -> [f32; C] {
        let mut f = [0.0; C];
        for c in 0..C {
            let mut sum = L::from_f16(&self.values[0]).mul(weights[c][0]);
            for b in 1..B {
                sum = L::from_f16(&self.values[b]).mul_add(weights[c][b], sum);
            }
            f[c] = sum.sum();
        }
        f
    }

    #[inline(always)]
    fn accumulate<L: Lanes>(&self, (): &(), factor: f32, sums: &mut [L; B]) {
        let factor = L::splat(factor);
        for b in 0..B {
            sums[b] = L::from_f16(&self.values[b]).mul_add(factor, sums[b]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transport::lanes::Portable;
    use glam::Vec3;

    fn decoded<const B: usize, R: Record<B>>(record: &R) -> Vec<f32> {
        let scale = record.head().scale();
        let mut values = [Portable::splat(0.0); B];
        record.accumulate(&record.unpack::<Portable>(), 1.0, &mut values);
        values
            .iter()
            .flat_map(|block| {
                let mut out = [0.0; 8];
                block.store(&mut out);
                out.map(|v| v * scale)
            })
            .collect()
    }

    /// Stored values against the dictionary's own, over ordinary and extreme directions.
    #[test]
    fn records_hold_every_atom_within_half_precision() {
        let directions = [
            (0.0f32, 0.0f32),
            (0.001, 0.0),
            (0.6, 0.6),
            (0.6, -0.6),
            (1.55, 1.5),
            (1.2, -1.2),
        ];
        for dictionary in [
            Dictionary::paper42(),
            Dictionary::grid42(),
            Dictionary::rig26(),
        ] {
            for grid in [true, false] {
                let atoms = LaneAtoms::new(&dictionary, grid);
                for (i, o) in directions {
                    let to_light = Vec3::new(i.sin(), 0.0, i.cos());
                    let to_viewer = Vec3::new(o.sin(), 0.02, o.cos()).normalize();
                    let at = Cosines::new(to_light.to_array(), to_viewer.to_array()).unwrap();
                    let head = Head::connection(1.0, 3);
                    let values = if atoms.is_grid() {
                        decoded(&GridRecord::encode(head, &atoms, &at))
                    } else {
                        decoded(&GeneralRecord::<5>::encode(head, &atoms, &at))
                    };
                    let largest = values.iter().fold(0.0f32, |m, &v| m.max(v));
                    for (lane, atom) in atoms.atom_of_lane.iter().enumerate() {
                        let Some(atom) = *atom else { continue };
                        let expected = dictionary.atoms()[atom].eval(&at);
                        let error = (values[lane] - expected).abs();
                        let bound = 1.1e-3 * expected + 4e-8 * largest;
                        assert!(
                            error <= bound,
                            "{} atom {atom}: {} for {expected}",
                            dictionary.name(),
                            values[lane]
                        );
                    }
                }
            }
        }
    }
}
