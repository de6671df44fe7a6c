//! What the cache keeps of one reflection: the values of all atoms there, in half
//! precision, and the factor that the geometry and the proposal contribute.
//!
//! Lane `b · 8 + i` of a record belongs to one atom that varies with the directions. A power
//! of two common to the record keeps the numbers within the range of half precision;
//! Lambertian atoms need no storage.

use half::f16;
use half::slice::HalfFloatSliceExt;

use super::lanes::Lanes;
use crate::brdf::dictionary::{Dictionary, MAX_ATOMS};
use crate::brdf::discrepancy;
use crate::brdf::evaluator::Evaluator;
use crate::brdf::ggx::Cosines;

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
    /// Continuation: cos θ/pdf; connection: irradiance over the lamp's strength.
    pub weight: f32,
    /// Exponent of the power of two that multiplies the stored values.
    pub exponent: i8,
    tag: u8,
    /// Of a record: the place in the table of discrepancies that stands for the pair of directions.
    place: u16,
}

impl Head {
    /// A continuation.
    pub fn continuation(weight: f32) -> Self {
        Self {
            weight,
            exponent: 0,
            tag: CONTINUES,
            place: 0,
        }
    }

    /// A connection to lamp `light` < [`MAX_LIGHTS`].
    pub fn connection(weight: f32, light: usize) -> Self {
        Self {
            weight,
            exponent: 0,
            tag: light as u8 & LIGHT,
            place: 0,
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
    pub fn flags(&self) -> &'static RecordFlags {
        &FLAGS[usize::from(self.tag >> 6)]
    }

    /// The lamp of a connection; anything for a continuation.
    #[inline(always)]
    pub fn lamp(&self) -> usize {
        usize::from(self.tag & LIGHT)
    }

    /// The discrepancy's place ([`discrepancy::place_near`]).
    #[inline(always)]
    pub fn place(&self) -> usize {
        usize::from(self.place)
    }

    /// 2^exponent.
    #[inline(always)]
    pub fn scale(&self) -> f32 {
        SCALES[usize::from(self.exponent.cast_unsigned())]
    }
}

/// The flags of a record as factors, because a branch on them could not be predicted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RecordFlags {
    /// 1 for the first record of a path, else 0.
    pub first: f32,
    /// The opposite of `first`.
    pub later: f32,
    /// 1 for a continuation, else 0.
    pub goes_on: f32,
    /// 1 for a connection, else 0.
    pub connects: f32,
}

/// Flags by the two highest bits of the tag.
static FLAGS: [RecordFlags; 4] = {
    let mut flags = [RecordFlags {
        first: 0.0,
        later: 1.0,
        goes_on: 0.0,
        connects: 1.0,
    }; 4];
    (flags[1].first, flags[1].later) = (1.0, 0.0);
    (flags[3].first, flags[3].later) = (1.0, 0.0);
    (flags[2].goes_on, flags[2].connects) = (1.0, 0.0);
    (flags[3].goes_on, flags[3].connects) = (1.0, 0.0);
    flags
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
    evaluator: Evaluator,
    /// Per lane: the dictionary's atom.
    atom_of_lane: Vec<usize>,
    lambertian: Vec<(usize, f64)>,
    atoms: usize,
}

impl LaneAtoms {
    /// A lane for each atom of a dictionary that varies with the directions.
    pub fn new(dictionary: &Dictionary) -> Self {
        let atoms = dictionary.atoms();
        let lambertian = atoms
            .iter()
            .enumerate()
            .filter_map(|(i, atom)| Some((i, atom.albedo()?)))
            .collect();
        let atom_of_lane: Vec<usize> = (0..atoms.len()).filter(|&i| atoms[i].varies()).collect();
        Self {
            evaluator: Evaluator::new(atom_of_lane.iter().map(|&i| &atoms[i])),
            atom_of_lane,
            lambertian,
            atoms: atoms.len(),
        }
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
            lanes[lane / 8][lane % 8] = weights[*atom] as f32;
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
            row[*atom] = lanes[lane / 8][lane % 8] * scale;
        }
        for &(atom, albedo) in &self.lambertian {
            row[atom] = lambertian * scale * albedo as f32 * std::f32::consts::FRAC_1_PI;
        }
    }

    /// Adds `factor · f_r` of every atom at `at` to `row`.
    pub fn add_values(&self, at: &Cosines<f32>, factor: f64, row: &mut [f64]) {
        let mut values = [0.0; MAX_ATOMS];
        self.evaluator.eval(at, &mut values);
        for (&atom, &value) in self.atom_of_lane.iter().zip(&values) {
            row[atom] += factor * f64::from(value);
        }
        for &(atom, albedo) in &self.lambertian {
            row[atom] += factor * albedo * std::f64::consts::FRAC_1_PI;
        }
    }
}

/// A stored reflection: a half-precision number per atom, in `B` blocks of eight lanes.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct Record<const B: usize> {
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

#[expect(
    clippy::needless_range_loop,
    reason = "only what is inlined may use the kernel's instructions: a loop, not a closure"
)]
impl<const B: usize> Record<B> {
    /// Stores the atoms' values at `at`.
    pub fn encode(head: Head, atoms: &LaneAtoms, at: &Cosines<f32>) -> Self {
        let mut head = head;
        head.place = discrepancy::place_near(at.cos_i, at.cos_o, at.sin2_h, at.cos_d);
        let mut lanes = [[0.0f32; 8]; B];
        atoms.evaluator.eval(at, lanes.as_flattened_mut());
        let largest = lanes.iter().flatten().fold(0.0f32, |m, &v| m.max(v));
        head.exponent = exponent_for(largest);
        Self {
            values: lanes.map(|block| store(&block, head.exponent)),
            head,
        }
    }

    /// The part that all records share.
    #[inline(always)]
    pub fn head(&self) -> Head {
        self.head
    }

    /// Marks the record as the first of its path.
    pub fn mark_first(&mut self) {
        self.head.mark_first();
    }

    /// Per channel the sum of the atoms' values times `weights`, over 2^exponent.
    #[inline(always)]
    pub fn dot<L: Lanes, const C: usize>(&self, weights: &[[L; B]; C]) -> [f32; C] {
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

    /// `sums += factor ·` the atoms' values over 2^exponent.
    #[inline(always)]
    pub fn accumulate<L: Lanes>(&self, factor: f32, sums: &mut [L; B]) {
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

    fn decoded<const B: usize>(record: &Record<B>) -> Vec<f32> {
        let scale = record.head().scale();
        let mut values = [Portable::splat(0.0); B];
        record.accumulate(1.0, &mut values);
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
        for dictionary in [Dictionary::paper42(), Dictionary::rig26()] {
            let atoms = LaneAtoms::new(&dictionary);
            for (i, o) in directions {
                let to_light = Vec3::new(i.sin(), 0.0, i.cos());
                let to_viewer = Vec3::new(o.sin(), 0.02, o.cos()).normalize();
                let at = Cosines::new(to_light.to_array(), to_viewer.to_array()).unwrap();
                let head = Head::connection(1.0, 3);
                let values = decoded(&Record::<5>::encode(head, &atoms, &at));
                let largest = values.iter().fold(0.0f32, |m, &v| m.max(v));
                for (lane, &atom) in atoms.atom_of_lane.iter().enumerate() {
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
