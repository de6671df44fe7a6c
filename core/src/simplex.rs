//! Exact quadratic programming on the simplex.
//!
//! Minimises ½ xᵀHx − gᵀx over x ≥ 0, Σx = 1 by a primal active-set method in
//! the manner of Lawson & Hanson's NNLS: solve on the free variables, step to
//! the first bound met, release the bound with the most negative multiplier.
//!
//! Atoms of a dictionary can be nearly equal (so H is singular) and differ in
//! scale by 1e4 (so H is badly scaled), and black has a zero column. Hence the
//! sum constraint is eliminated through the free variable with the smallest
//! diagonal, the reduced system is scaled to a unit diagonal, and H gets a
//! ridge of [`RIDGE`]·H_ii.

use nalgebra::{Cholesky, DMatrix, DVector};

/// Relative ridge added to the diagonal of H.
pub const RIDGE: f64 = 1e-9;

/// A convex quadratic ½ xᵀHx − gᵀx + c.
#[derive(Clone, Debug, PartialEq)]
pub struct Quadratic {
    /// Symmetric positive semidefinite, N × N.
    pub h: DMatrix<f64>,
    /// N.
    pub g: DVector<f64>,
    /// Value at x = 0.
    pub c: f64,
}

impl Quadratic {
    /// Zero, of `n` unknowns.
    pub fn zero(n: usize) -> Self {
        Self {
            h: DMatrix::zeros(n, n),
            g: DVector::zeros(n),
            c: 0.0,
        }
    }

    /// ½ ‖A x − b‖² with row weights `w` (all ones if `None`); A is rows × N.
    pub fn least_squares(a: &DMatrix<f64>, b: &DVector<f64>, w: Option<&DVector<f64>>) -> Self {
        let (scaled_a, scaled_b);
        let (a, b) = match w {
            None => (a, b),
            Some(w) => {
                let root = w.map(f64::sqrt);
                let mut rows = a.clone();
                for mut column in rows.column_iter_mut() {
                    column.component_mul_assign(&root);
                }
                scaled_a = rows;
                scaled_b = b.component_mul(&root);
                (&scaled_a, &scaled_b)
            }
        };
        Self {
            h: a.tr_mul(a),
            g: a.tr_mul(b),
            c: 0.5 * b.norm_squared(),
        }
    }

    /// Adds `scale` times another quadratic of the same size.
    pub fn add_scaled(&mut self, scale: f64, other: &Self) {
        self.h += scale * &other.h;
        self.g += scale * &other.g;
        self.c += scale * other.c;
    }

    /// Value at `x`.
    pub fn value(&self, x: &DVector<f64>) -> f64 {
        0.5 * x.dot(&(&self.h * x)) - self.g.dot(x) + self.c
    }

    /// Minimum on the simplex, see [`solve`].
    pub fn minimise(&self) -> Result<Solution, SimplexError> {
        solve(&self.h, &self.g, None)
    }
}

/// The minimiser and its certificate.
#[derive(Clone, Debug, PartialEq)]
pub struct Solution {
    /// Weights: each ≥ 0, summing to 1 within rounding.
    pub x: DVector<f64>,
    /// `true` where the weight is held at zero.
    pub at_zero: Vec<bool>,
    /// Multiplier of each bound: the rate at which the objective grows when that
    /// weight leaves zero at the expense of the free ones; 0 on free weights, ≥ 0
    /// up to rounding elsewhere.
    pub multipliers: DVector<f64>,
    /// Multiplier ν of the sum: (Hx − g)ₖ = −ν on every free k.
    pub sum_multiplier: f64,
    /// Systems solved.
    pub iterations: usize,
}

/// Why there is no solution.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)]
pub enum SimplexError {
    /// H is not N × N, g not N, the start not N, or N = 0.
    #[error("quadratic of {rows} x {columns} with a gradient of {gradient} and a start of {start}")]
    Shape {
        rows: usize,
        columns: usize,
        gradient: usize,
        /// Length of the start (that of g if none was given).
        start: usize,
    },
    /// A value is infinite or not a number, or H is not positive semidefinite.
    #[error("the quadratic is not finite or not convex")]
    NotConvex,
    #[error("the active set did not settle in {0} iterations")]
    Unsettled(usize),
}

/// Minimises ½ xᵀHx − gᵀx on the simplex. Only the lower triangle of H need
/// be accurate to rounding; it must be positive semidefinite up to rounding.
/// `start` (on the simplex) only saves iterations.
pub fn solve(
    h: &DMatrix<f64>,
    g: &DVector<f64>,
    start: Option<&DVector<f64>>,
) -> Result<Solution, SimplexError> {
    let n = g.len();
    if n == 0 || h.shape() != (n, n) || start.is_some_and(|s| s.len() != n) {
        return Err(SimplexError::Shape {
            rows: h.nrows(),
            columns: h.ncols(),
            gradient: n,
            start: start.map_or(n, DVector::len),
        });
    }
    let finite = h.iter().chain(g.iter()).all(|v| v.is_finite());
    if !finite || (0..n).any(|i| h[(i, i)] < 0.0) {
        return Err(SimplexError::NotConvex);
    }
    let h = with_ridge(h);
    let mut x = match start {
        Some(start) if start.iter().all(|v| v.is_finite()) && start.max() > 0.0 => {
            let positive = start.map(|v| v.max(0.0));
            &positive / positive.sum()
        }
        _ => best_vertex(&h, g),
    };
    let mut free: Vec<usize> = (0..n).filter(|&k| x[k] > 0.0).collect();
    // Bounds whose release made no progress since x last moved.
    let mut refused = vec![false; n];
    let mut just_freed = None;
    let limit = 100 + 20 * n;
    for iteration in 1..=limit {
        let target = minimum_on(&h, g, &free).ok_or(SimplexError::NotConvex)?;
        if let Some(entered) = just_freed.take() {
            let position = free.iter().position(|&k| k == entered);
            if position.is_some_and(|p| target[p] <= 0.0) {
                // Only rounding made its multiplier negative.
                free.retain(|&k| k != entered);
                refused[entered] = true;
                if let Some(released) = release(&h, g, &x, &free, &refused) {
                    free.push(released);
                    just_freed = Some(released);
                    continue;
                }
                return Ok(finish(&h, g, x, &free, iteration));
            }
        }
        let mut step = 1.0f64;
        for (&k, &t) in free.iter().zip(&target) {
            if t < 0.0 {
                step = step.min(x[k] / (x[k] - t));
            }
        }
        for (&k, &t) in free.iter().zip(&target) {
            x[k] += step * (t - x[k]);
        }
        if step < 1.0 {
            let smallest = free
                .iter()
                .zip(&target)
                .filter(|&(_, &t)| t < 0.0)
                .min_by(|a, b| x[*a.0].total_cmp(&x[*b.0]))
                .map(|(&k, _)| k);
            let drop: Vec<usize> = free
                .iter()
                .copied()
                .filter(|&k| x[k] <= 0.0 || Some(k) == smallest)
                .collect();
            for &k in &drop {
                x[k] = 0.0;
            }
            free.retain(|k| !drop.contains(k));
            continue;
        }
        refused.fill(false);
        match release(&h, g, &x, &free, &refused) {
            Some(released) => {
                free.push(released);
                just_freed = Some(released);
            }
            None => return Ok(finish(&h, g, x, &free, iteration)),
        }
    }
    Err(SimplexError::Unsettled(limit))
}

fn with_ridge(h: &DMatrix<f64>) -> DMatrix<f64> {
    let mut h = h.clone();
    let largest = h.diagonal().max();
    for i in 0..h.nrows() {
        // The absolute part separates two zero columns; it is far below rounding
        // of anything an image could say.
        h[(i, i)] += RIDGE * h[(i, i)] + 1e-18 * largest + f64::MIN_POSITIVE;
    }
    h
}

fn best_vertex(h: &DMatrix<f64>, g: &DVector<f64>) -> DVector<f64> {
    let value = |k: usize| 0.5 * h[(k, k)] - g[k];
    let best = (0..g.len())
        .min_by(|&a, &b| value(a).total_cmp(&value(b)))
        .unwrap_or(0);
    let mut x = DVector::zeros(g.len());
    x[best] = 1.0;
    x
}

/// Minimum on Σ = 1 over the free variables alone, signs ignored, in their order;
/// `None` if H is far from semidefinite there.
fn minimum_on(h: &DMatrix<f64>, g: &DVector<f64>, free: &[usize]) -> Option<Vec<f64>> {
    let pivot = (0..free.len())
        .min_by(|&a, &b| h[(free[a], free[a])].total_cmp(&h[(free[b], free[b])]))
        .unwrap_or(0);
    let p = free[pivot];
    let others: Vec<usize> = (0..free.len()).filter(|&k| k != pivot).collect();
    let m = others.len();
    // x_p = 1 − Σ others: the Gram matrix of the differences to atom p.
    let mut reduced = DMatrix::from_fn(m, m, |a, b| {
        let (i, j) = (free[others[a]], free[others[b]]);
        h[(i, j)] - h[(i, p)] - h[(p, j)] + h[(p, p)]
    });
    let scale: Vec<f64> = (0..m)
        .map(|a| 1.0 / reduced[(a, a)].max(f64::MIN_POSITIVE).sqrt())
        .collect();
    let mut rhs = DVector::from_fn(m, |a, _| {
        let i = free[others[a]];
        scale[a] * (g[i] - g[p] - h[(i, p)] + h[(p, p)])
    });
    for a in 0..m {
        for b in 0..m {
            reduced[(a, b)] *= scale[a] * scale[b];
        }
    }
    let mut ridge = 0.0;
    let factor = loop {
        let mut damped = reduced.clone();
        for a in 0..m {
            damped[(a, a)] += ridge;
        }
        match Cholesky::new(damped) {
            Some(factor) => break factor,
            // Rounding made a semidefinite matrix indefinite.
            None if ridge == 0.0 => ridge = 1e-14,
            None if ridge < 1e-3 => ridge *= 10.0,
            None => return None,
        }
    };
    let unscaled = rhs.clone();
    factor.solve_mut(&mut rhs);
    // One step of refinement against the undamped matrix.
    let mut correction = unscaled - &reduced * &rhs;
    factor.solve_mut(&mut correction);
    rhs += correction;
    let mut x = vec![0.0; free.len()];
    let mut sum = 0.0;
    for a in 0..m {
        x[others[a]] = scale[a] * rhs[a];
        sum += x[others[a]];
    }
    x[pivot] = 1.0 - sum;
    Some(x)
}

/// Gradient Hx − g, and the size of the terms it is the difference of.
fn gradient(h: &DMatrix<f64>, g: &DVector<f64>, x: &DVector<f64>) -> (DVector<f64>, DVector<f64>) {
    let terms = h.abs() * x + g.abs();
    (h * x - g, terms)
}

fn sum_multiplier(gradient: &DVector<f64>, x: &DVector<f64>, free: &[usize]) -> f64 {
    -free.iter().map(|&k| gradient[k] * x[k]).sum::<f64>() / free.iter().map(|&k| x[k]).sum::<f64>()
}

/// The bound whose release lowers the objective most per unit of that atom's
/// own scale, if any does by more than rounding.
fn release(
    h: &DMatrix<f64>,
    g: &DVector<f64>,
    x: &DVector<f64>,
    free: &[usize],
    refused: &[bool],
) -> Option<usize> {
    let (gradient, terms) = gradient(h, g, x);
    let nu = sum_multiplier(&gradient, x, free);
    let free_terms = free.iter().map(|&k| terms[k] * x[k]).sum::<f64>();
    (0..g.len())
        .filter(|k| !free.contains(k) && !refused[*k])
        .filter(|&k| gradient[k] + nu < -1e-13 * (terms[k] + free_terms))
        .min_by(|&a, &b| {
            let scaled = |k: usize| (gradient[k] + nu) / h[(k, k)].sqrt();
            scaled(a).total_cmp(&scaled(b))
        })
}

fn finish(
    h: &DMatrix<f64>,
    g: &DVector<f64>,
    x: DVector<f64>,
    free: &[usize],
    iterations: usize,
) -> Solution {
    let x = &x / x.sum();
    let (gradient, _) = gradient(h, g, &x);
    let nu = sum_multiplier(&gradient, &x, free);
    let at_zero: Vec<bool> = (0..g.len()).map(|k| !free.contains(&k)).collect();
    let multipliers = DVector::from_fn(
        g.len(),
        |k, _| {
            if at_zero[k] { gradient[k] + nu } else { 0.0 }
        },
    );
    Solution {
        x,
        at_zero,
        multipliers,
        sum_multiplier: nu,
        iterations,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, Stream, stream};

    /// The conditions that make a point the minimum, in units of the terms compared.
    fn assert_optimal(h: &DMatrix<f64>, g: &DVector<f64>, solution: &Solution, case: &str) {
        let x = &solution.x;
        assert!((x.sum() - 1.0).abs() < 1e-12, "{case}: sum {}", x.sum());
        assert!(x.min() >= 0.0, "{case}: smallest weight {}", x.min());
        let (gradient, terms) = gradient(h, g, x);
        let scale = terms.max().max(1e-300);
        for k in 0..g.len() {
            let slack = gradient[k] + solution.sum_multiplier;
            assert!(slack > -1e-7 * scale, "{case}: multiplier {slack} of {k}");
            if x[k] > 1e-9 {
                assert!(
                    slack < 1e-7 * scale,
                    "{case}: {k} is free with slope {slack}"
                );
            }
        }
    }

    fn random_matrix(rows: usize, columns: usize, numbers: &mut Stream) -> DMatrix<f64> {
        DMatrix::from_fn(rows, columns, |_, _| numbers.normal())
    }

    #[test]
    fn random_problems_meet_the_optimality_conditions() {
        for case in 0..300 {
            let mut numbers = stream(11, Purpose::Experiment, case, 0, 0);
            let n = 1 + (numbers.uniform() * 50.0) as usize;
            let rows = 1 + (numbers.uniform() * 80.0) as usize;
            let mut a = random_matrix(rows, n, &mut numbers);
            if case % 3 == 1 {
                // Scales over four decades, as between narrow lobes and Lambertian.
                for mut column in a.column_iter_mut() {
                    column *= 10f64.powf(4.0 * numbers.uniform());
                }
            }
            if case % 4 == 2 {
                a.column_mut(n - 1).fill(0.0); // black
            }
            let b = if case % 2 == 0 {
                random_matrix(rows, 1, &mut numbers).column(0).into_owned() * 3.0
            } else {
                let inside = DVector::from_fn(n, |_, _| numbers.uniform().powi(6));
                &a * (&inside / inside.sum())
            };
            let q = Quadratic::least_squares(&a, &b, None);
            let solution = q.minimise().unwrap();
            assert_optimal(&q.h, &q.g, &solution, &format!("case {case}, {rows} x {n}"));
        }
    }

    #[test]
    fn starts_do_not_change_the_minimum() {
        let mut numbers = stream(12, Purpose::Experiment, 0, 0, 0);
        let a = random_matrix(60, 20, &mut numbers);
        let b = random_matrix(60, 1, &mut numbers).column(0).into_owned();
        let q = Quadratic::least_squares(&a, &b, None);
        let reference = q.minimise().unwrap();
        for seed in 0..10 {
            let mut numbers = stream(13, Purpose::Experiment, seed, 0, 0);
            let start = DVector::from_fn(20, |_, _| numbers.uniform());
            let other = solve(&q.h, &q.g, Some(&start)).unwrap();
            assert!((other.x - &reference.x).norm() < 1e-6);
        }
    }

    #[test]
    fn equal_and_nearly_equal_columns_are_harmless() {
        for difference in [0.0, 1e-12, 1e-8, 1e-5] {
            let mut numbers = stream(14, Purpose::Experiment, 0, 0, 0);
            let base = random_matrix(40, 6, &mut numbers);
            let nudge = random_matrix(40, 18, &mut numbers);
            let a = DMatrix::from_fn(40, 18, |r, c| base[(r, c % 6)] + difference * nudge[(r, c)]);
            let weights = DVector::from_fn(18, |k, _| if k == 2 || k == 9 { 0.5 } else { 0.0 });
            let b = &a * weights;
            let q = Quadratic::least_squares(&a, &b, None);
            let solution = q.minimise().unwrap();
            assert_optimal(&q.h, &q.g, &solution, &format!("difference {difference}"));
            let residual = (&a * &solution.x - &b).norm() / b.norm();
            assert!(
                residual < 1e-5,
                "difference {difference}: residual {residual}"
            );
        }
    }

    #[test]
    fn one_atom_can_be_the_answer() {
        let mut numbers = stream(15, Purpose::Experiment, 0, 0, 0);
        let a = random_matrix(50, 42, &mut numbers);
        for atom in [0, 17, 41] {
            let b = a.column(atom).into_owned();
            let solution = Quadratic::least_squares(&a, &b, None).minimise().unwrap();
            assert!((solution.x[atom] - 1.0).abs() < 1e-6, "atom {atom}");
            // Far outside the simplex along the atom: the vertex itself, all others held.
            let q = Quadratic::least_squares(&a, &(1e4 * b), None);
            let solution = q.minimise().unwrap();
            assert_optimal(&q.h, &q.g, &solution, &format!("beyond atom {atom}"));
        }
    }

    #[test]
    fn weights_of_rows_are_those_of_repeated_rows() {
        let mut numbers = stream(16, Purpose::Experiment, 0, 0, 0);
        let a = random_matrix(9, 4, &mut numbers);
        let b = random_matrix(9, 1, &mut numbers).column(0).into_owned();
        let w = DVector::from_fn(9, |r, _| 1.0 + (r % 3) as f64);
        let rows: Vec<usize> = (0..9).flat_map(|r| vec![r; 1 + r % 3]).collect();
        let weighted = Quadratic::least_squares(&a, &b, Some(&w));
        let repeated = Quadratic::least_squares(&a.select_rows(&rows), &b.select_rows(&rows), None);
        assert!((weighted.h - repeated.h).norm() < 1e-12);
        assert!((weighted.g - repeated.g).norm() < 1e-12);
        assert!((weighted.c - repeated.c).abs() < 1e-12);
    }

    #[test]
    fn bad_input_is_an_error() {
        let h = DMatrix::identity(2, 2);
        assert!(matches!(
            solve(&h, &DVector::zeros(3), None),
            Err(SimplexError::Shape { .. })
        ));
        assert!(matches!(
            solve(&DMatrix::zeros(0, 0), &DVector::zeros(0), None),
            Err(SimplexError::Shape { .. })
        ));
        let mut g = DVector::zeros(2);
        g[0] = f64::NAN;
        assert_eq!(solve(&h, &g, None), Err(SimplexError::NotConvex));
        assert_eq!(
            solve(&-h, &DVector::zeros(2), None),
            Err(SimplexError::NotConvex)
        );
    }
}
