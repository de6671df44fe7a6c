//! Four lobes side by side: continuations need the density of all lobes of a cell, and
//! four at a time cost little more than one.

use glam::{Mat3, Vec3, Vec4};

use super::{Lobe, WIDER, WIDTHS};

/// Vectors of four lobes by component.
type Vectors = [Vec4; 3];

/// Up to four lobes; those that are missing have no share.
#[derive(Clone, Copy, Debug)]
pub(super) struct Four {
    position_mm: Vectors,
    towards: Vectors,
    /// By column.
    turn: [Vectors; 3],
    alpha2: Vec4,
    share: Vec4,
}

impl Four {
    /// One to four lobes.
    pub fn new(lobes: &[Lobe]) -> Self {
        let nothing = Lobe {
            position_mm: Vec3::ZERO,
            towards: Vec3::Z,
            turn: Mat3::ZERO,
            alpha2: 1.0,
            share: 0.0,
        };
        let lobe = |lane: usize| lobes.get(lane).unwrap_or(&nothing);
        let each = |of: &dyn Fn(&Lobe) -> f32| Vec4::from_array([0, 1, 2, 3].map(|k| of(lobe(k))));
        let vectors =
            |of: &dyn Fn(&Lobe) -> Vec3| [0, 1, 2].map(|axis| each(&|lobe| of(lobe)[axis]));
        Self {
            position_mm: vectors(&|lobe| lobe.position_mm),
            towards: vectors(&|lobe| lobe.towards),
            turn: [0, 1, 2].map(|column| vectors(&|lobe| lobe.turn.col(column))),
            alpha2: each(&|lobe| lobe.alpha2),
            share: each(&|lobe| lobe.share),
        }
    }

    /// Probabilities of the lobes within their cell.
    #[inline]
    pub fn shares(&self) -> [f32; 4] {
        self.share.to_array()
    }

    /// One of them.
    #[inline]
    pub fn lobe(&self, lane: usize) -> Lobe {
        let vector = |of: &Vectors| Vec3::from_array(of.map(|component| component[lane]));
        let [x, y, z] = &self.turn;
        Lobe {
            position_mm: vector(&self.position_mm),
            towards: vector(&self.towards),
            turn: Mat3::from_cols(vector(x), vector(y), vector(z)),
            alpha2: self.alpha2[lane],
            share: self.share[lane],
        }
    }

    /// Their part of the density at a unit direction, times πW for the W widths of a lobe.
    /// With t where a lobe comes from, not of unit length, p = t·d and q = |t × d|², a width
    /// has the density α² cos / (α² cos² + sin²)² / π = α² p |t|³ / (α² p² + q)² / π.
    #[inline]
    pub fn density(&self, position_mm: Vec3, direction: Vec3) -> Vec4 {
        let moved = [0, 1, 2].map(|axis| Vec4::splat(position_mm[axis]) - self.position_mm[axis]);
        let [tx, ty, tz] = [0, 1, 2].map(|axis| {
            let [x, y, z] = &self.turn;
            self.towards[axis] + x[axis] * moved[0] + y[axis] * moved[1] + z[axis] * moved[2]
        });
        let [dx, dy, dz] = direction.to_array().map(Vec4::splat);
        let along = tx * dx + ty * dy + tz * dz;
        let across = [ty * dz - tz * dy, tz * dx - tx * dz, tx * dy - ty * dx];
        // Behind a lobe p is 0, and q = |t|².
        let (p, behind) = (along.max(Vec4::ZERO), along.min(Vec4::ZERO));
        let q = across[0] * across[0] + across[1] * across[1] + across[2] * across[2];
        let (p2, q) = (p * p, q + behind * behind);
        let mut alpha2 = self.alpha2;
        let mut widths = Vec4::ZERO;
        for _ in 0..WIDTHS {
            let spread = alpha2 * p2 + q;
            widths += alpha2 / (spread * spread);
            alpha2 *= WIDER * WIDER;
        }
        let length2 = p2 + q;
        let length = Vec4::from_array(length2.to_array().map(f32::sqrt));
        self.share * p * length2 * length * widths
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, stream};

    /// Against the textbook form lobe by lobe in double precision, and 0 behind them.
    #[test]
    fn the_density_is_that_of_each_lobe() {
        let mut numbers = stream(8, Purpose::Experiment, 0, 0, 0);
        let mut vector = || Vec3::from_array([0; 3].map(|_| numbers.normal() as f32));
        let lobes: Vec<Lobe> = (0..3)
            .map(|k| Lobe {
                position_mm: vector(),
                towards: vector().normalize(),
                turn: 0.1 * Mat3::from_cols(vector(), vector(), vector()),
                alpha2: [3.6e-5, 0.01, 0.2][k],
                share: [0.5, 0.3, 0.2][k],
            })
            .collect();
        let four = Four::new(&lobes);
        for (lane, lobe) in lobes.iter().enumerate() {
            for apart in [0.0, 0.003, 0.02, 0.3, 1.4, 1.8, std::f32::consts::PI] {
                let position_mm = lobe.position_mm + 0.3 * vector();
                let towards = lobe.towards_from(position_mm);
                let direction =
                    towards * apart.cos() + towards.any_orthonormal_vector() * apart.sin();
                let density = four.density(position_mm, direction)[lane];
                let (sin, cos) = f64::from(apart).sin_cos();
                let widths: f64 = (0..WIDTHS)
                    .map(|k| f64::from(lobe.alpha2) * f64::from(WIDER).powi(2 * k))
                    .map(|a| a * cos.max(0.0) / (a * cos * cos + sin * sin).powi(2))
                    .sum();
                let expected = f64::from(lobe.share) * widths;
                let off = (f64::from(density) - expected).abs();
                // The direction itself is rounded to 1e-7.
                assert!(
                    off <= 1e-4 * expected,
                    "{lane}, {apart}: {density} for {expected}"
                );
            }
            assert_eq!(four.lobe(lane).turn, lobe.turn);
        }
        let elsewhere = four.density(vector(), vector().normalize());
        assert_eq!(elsewhere[3], 0.0, "a missing lobe");
    }
}
