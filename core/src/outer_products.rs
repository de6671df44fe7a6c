//! Sums of outer products, the inner loop of normal equations.
//!
//! An entry of the matrix is read and written once for several products, which are added to it one
//! after the other: the sums are those of one product at a time, to the last bit.

use nalgebra::DMatrix;

use crate::widened::widened;

/// Products that are added at once.
const AT_ONCE: usize = 4;

/// Σ w v vᵀ.
pub type Squares = Sum<1>;

/// Σ w ½ (a bᵀ + b aᵀ).
pub type Products = Sum<2>;

/// A symmetric N × N sum whose terms are P outer products each.
#[derive(Clone, Debug)]
pub struct Sum<const P: usize> {
    /// Its lower triangle.
    matrix: DMatrix<f64>,
    /// Terms that wait to be added.
    waiting: usize,
    /// Of each term, with its weight: columns.
    left: [DMatrix<f64>; P],
    /// Of each term: columns.
    right: [DMatrix<f64>; P],
}

impl<const P: usize> Sum<P> {
    /// Of nothing, N × N.
    pub fn zero(n: usize) -> Self {
        let none = || DMatrix::zeros(n, AT_ONCE);
        Self {
            matrix: DMatrix::zeros(n, n),
            waiting: 0,
            left: std::array::from_fn(|_| none()),
            right: std::array::from_fn(|_| none()),
        }
    }

    /// Adds Σ scale left rightᵀ, of which the lower triangle is kept.
    #[inline]
    fn add_term(&mut self, scale: f64, left: [&[f64]; P], right: [&[f64]; P]) {
        let column = self.waiting;
        let scaled = |v: &f64| scale * v;
        for p in 0..P {
            let mut own = self.left[p].column_mut(column);
            let values = own.iter_mut().zip(left[p].iter().map(scaled));
            values.for_each(|(own, v)| *own = v);
            let mut own = self.right[p].column_mut(column);
            own.copy_from_slice(right[p]);
        }
        self.waiting += 1;
        if self.waiting == AT_ONCE {
            self.settle();
        }
    }

    /// Adds the terms that wait.
    fn settle(&mut self) {
        for left in &mut self.left {
            // The others count as nothing.
            left.columns_range_mut(self.waiting..).fill(0.0);
        }
        self.waiting = 0;
        add(
            self.matrix.as_mut_slice(),
            self.left.each_ref().map(DMatrix::as_slice),
            self.right.each_ref().map(DMatrix::as_slice),
        );
    }

    /// Adds another sum of N × N.
    pub fn join(&mut self, mut other: Self) {
        self.settle();
        other.settle();
        self.matrix += other.matrix;
    }

    /// The sum.
    pub fn matrix(mut self) -> DMatrix<f64> {
        self.settle();
        self.matrix.fill_upper_triangle_with_lower_triangle();
        self.matrix
    }
}

impl Squares {
    /// Adds w v vᵀ.
    pub fn add(&mut self, w: f64, v: &[f64]) {
        self.add_term(w, [v], [v]);
    }
}

impl Products {
    /// Adds w ½ (a bᵀ + b aᵀ).
    pub fn add(&mut self, w: f64, [a, b]: [&[f64]; 2]) {
        self.add_term(0.5 * w, [a, b], [b, a]);
    }
}

widened! {
    /// Lower triangle of `matrix += Σ left rightᵀ`, term by term, P products to a term.
    #[allow(clippy::needless_range_loop, reason = "closures would not be compiled for AVX2")]
    fn add<const P: usize>(matrix: &mut [f64], left: [&[f64]; P], right: [&[f64]; P]) {
        let n = left[0].len() / AT_ONCE;
        for j in 0..n {
            let column = &mut matrix[j * n + j..(j + 1) * n];
            let rows = column.len();
            let mut scales = [[0.0; AT_ONCE]; P];
            let mut vectors = [[&[][..]; AT_ONCE]; P];
            for p in 0..P {
                for k in 0..AT_ONCE {
                    scales[p][k] = left[p][k * n + j];
                    vectors[p][k] = &right[p][k * n + j..][..rows];
                }
            }
            for i in 0..rows {
                let mut sum = column[i];
                for k in 0..AT_ONCE {
                    let mut term = scales[0][k] * vectors[0][k][i];
                    for p in 1..P {
                        term += scales[p][k] * vectors[p][k][i];
                    }
                    sum += term;
                }
                column[i] = sum;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against one term at a time, for sizes that fill no whole number of lanes and terms that
    /// fill no whole number of turns.
    #[test]
    fn sums_are_those_of_one_term_at_a_time() {
        for n in [1, 7, 65] {
            let [mut squares, mut products] = [DMatrix::zeros(n, n), DMatrix::zeros(n, n)];
            let (mut found, mut mixed) = (Squares::zero(n), Products::zero(n));
            for term in 0..AT_ONCE + 3 {
                let value = |k: usize| ((k * 7919 + term * 104_729) % 1009) as f64 / 997.0 - 0.5;
                let a: Vec<f64> = (0..n).map(value).collect();
                let b: Vec<f64> = (n..2 * n).map(value).collect();
                let w = 0.3 + term as f64;
                found.add(w, &a);
                mixed.add(w, [&a, &b]);
                for (i, j) in (0..n).flat_map(|j| (j..n).map(move |i| (i, j))) {
                    squares[(i, j)] += w * a[j] * a[i];
                    let half = 0.5 * w;
                    products[(i, j)] += half * a[j] * b[i] + half * b[j] * a[i];
                }
            }
            squares.fill_upper_triangle_with_lower_triangle();
            products.fill_upper_triangle_with_lower_triangle();
            assert_eq!([found.matrix(), mixed.matrix()], [squares, products], "{n}");
        }
    }
}
