//! Nonlinear least squares by Levenberg and Marquardt's damped Gauss–Newton steps.
//!
//! A [`Problem`] forms its own normal equations, so that robust weights, priors, blocks
//! that see few of the parameters, and parameters that aren't vectors (rotations) cost
//! nothing extra. The crate `levenberg-marquardt` wants one dense Jacobian of plain
//! residuals over a plain vector, has no weights that change from step to step, and no
//! covariance: each of the fits here would need more code around it than the loop is long.

use nalgebra::{DMatrix, DVector};

/// A sum of squares to be minimised.
pub trait Problem {
    /// The parameters.
    type Point: Clone;

    /// The normal equations at `at`. Robust weights and whatever else the problem estimates
    /// along the way are renewed here, and hold in [`Problem::cost`] until the next call.
    fn linearise(&mut self, at: &Self::Point) -> Equations;

    /// The weighted sum of squares, priors included; with robust weights any cost whose
    /// gradient is that of the equations.
    fn cost(&self, at: &Self::Point) -> f64;

    /// The parameters after a step; limits of steps and of parameters are kept here.
    fn moved(&self, from: &Self::Point, step: &DVector<f64>) -> Self::Point;
}

/// Normal equations `N Δ = b` of one step, with N = JᵀWJ and b = JᵀWr (r: measured less
/// modelled), priors included.
#[derive(Clone, Debug)]
pub struct Equations {
    /// N.
    pub normal: DMatrix<f64>,
    /// b.
    pub right: DVector<f64>,
    /// The cost at this point, as [`Problem::cost`] has it.
    pub cost: f64,
}

impl Equations {
    /// N⁻¹: the covariance where the weights are inverse variances. `None` where a
    /// parameter is not determined.
    pub fn covariance(&self) -> Option<DMatrix<f64>> {
        Some(self.normal.clone().cholesky()?.inverse())
    }

    /// N⁻¹ S N⁻¹ for the covariance S of the right side (sandwich).
    pub fn sandwich(&self, scatter: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        let inverse = self.covariance()?;
        Some(&inverse * scatter * &inverse)
    }

    /// The step with N's diagonal enlarged by the factor 1 + `damping`.
    fn step(&self, damping: f64) -> Option<DVector<f64>> {
        let mut damped = self.normal.clone();
        for i in 0..damped.nrows() {
            damped[(i, i)] *= 1.0 + damping;
        }
        Some(damped.cholesky()?.solve(&self.right))
    }
}

/// How steps are damped and when they end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Most steps.
    pub rounds: usize,
    /// Damping of the first step, relative to the diagonal; 0: undamped until a step fails.
    pub damping: f64,
    /// A step that lowers the cost by less than this part of it is the last one …
    pub least_relative_gain: f64,
    /// … as is one that lowers it by less than this.
    pub least_gain: f64,
}

/// Where the steps ended.
#[derive(Clone, Debug, PartialEq)]
pub struct Minimum<Point> {
    /// The parameters.
    pub point: Point,
    /// Whether no step lowers the cost by more than the options' least gain.
    pub settled: bool,
}

/// Damping after the first failure of an undamped step.
const FIRST_DAMPING: f64 = 1e-3;
/// Least damping that a damped problem comes down to; above the largest no step helps.
const DAMPING_RANGE: [f64; 2] = [1e-9, 1e12];
/// A cost that is higher by less, relative, is rounding.
const ROUNDING: f64 = 1e-12;

/// Minimises `problem` from `start`.
pub fn minimise<P: Problem>(
    problem: &mut P,
    start: P::Point,
    options: &Options,
) -> Minimum<P::Point> {
    let mut point = start;
    let mut damping = options.damping;
    for _ in 0..options.rounds {
        let equations = problem.linearise(&point);
        let lower = |damping: f64| {
            let next = problem.moved(&point, &equations.step(damping)?);
            let cost = problem.cost(&next);
            (cost <= equations.cost * (1.0 + ROUNDING)).then_some((next, cost))
        };
        let (next, cost) = loop {
            if let Some(found) = lower(damping) {
                break found;
            }
            damping = (10.0 * damping).max(FIRST_DAMPING);
            if damping > DAMPING_RANGE[1] {
                let settled = equations.cost.is_finite();
                return Minimum { point, settled };
            }
        };
        point = next;
        if damping > 0.0 {
            damping = (0.1 * damping).max(DAMPING_RANGE[0]);
        }
        let least = options.least_gain + options.least_relative_gain * equations.cost;
        if equations.cost - cost <= least {
            return Minimum {
                point,
                settled: true,
            };
        }
    }
    Minimum {
        point,
        settled: false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// y = a·exp(b·t) through points, with weights that a robust bound renews.
    struct Decay {
        points: Vec<[f64; 2]>,
        bound: f64,
        weights: Vec<f64>,
    }

    impl Decay {
        fn new(bound: f64) -> Self {
            let points: Vec<[f64; 2]> = (0..20)
                .map(|k| [f64::from(k) / 10.0, 3.0 * (-0.15 * f64::from(k)).exp()])
                .collect();
            let weights = vec![1.0; points.len()];
            Self {
                points,
                bound,
                weights,
            }
        }

        fn residuals(&self, at: &[f64; 2]) -> Vec<f64> {
            let off = |[t, y]: &[f64; 2]| y - at[0] * (at[1] * t).exp();
            self.points.iter().map(off).collect()
        }
    }

    impl Problem for Decay {
        type Point = [f64; 2];

        fn linearise(&mut self, at: &[f64; 2]) -> Equations {
            let residuals = self.residuals(at);
            let robust = |r: &f64| (self.bound / r.abs()).min(1.0);
            self.weights = residuals.iter().map(robust).collect();
            let rows = self.points.iter().flat_map(|[t, _]| {
                let e = (at[1] * t).exp();
                [e, at[0] * t * e]
            });
            let jacobian = DMatrix::from_row_iterator(self.points.len(), 2, rows);
            let weights = DMatrix::from_diagonal(&DVector::from_row_slice(&self.weights));
            let weighted = jacobian.transpose() * weights;
            Equations {
                normal: &weighted * &jacobian,
                right: weighted * DVector::from_vec(residuals),
                cost: self.cost(at),
            }
        }

        fn cost(&self, at: &[f64; 2]) -> f64 {
            let squares = self.residuals(at).into_iter().zip(&self.weights);
            squares.map(|(r, w)| w * r * r).sum()
        }

        fn moved(&self, from: &[f64; 2], step: &DVector<f64>) -> [f64; 2] {
            [from[0] + step[0], from[1] + step[1]]
        }
    }

    const OPTIONS: Options = Options {
        rounds: 60,
        damping: 1e-3,
        least_relative_gain: 1e-12,
        least_gain: 1e-24,
    };

    #[test]
    fn the_minimum_is_found_from_afar_damped_or_not() {
        for damping in [0.0, 1e-3, 1.0] {
            let options = Options { damping, ..OPTIONS };
            let found = minimise(&mut Decay::new(f64::INFINITY), [0.5, 1.0], &options);
            assert!(found.settled);
            let [a, b] = found.point;
            assert!((a - 3.0).abs() < 1e-9 && (b + 1.5).abs() < 1e-9, "{a} {b}");
        }
    }

    #[test]
    fn robust_weights_resist_an_outlier() {
        let mut decay = Decay::new(0.01);
        decay.points[7][1] += 5.0;
        let [a, b] = minimise(&mut decay, [2.0, -1.0], &OPTIONS).point;
        assert!((a - 3.0).abs() < 0.02 && (b + 1.5).abs() < 0.02, "{a} {b}");
    }

    #[test]
    fn too_few_rounds_and_no_number_are_not_settled() {
        let options = Options {
            rounds: 1,
            ..OPTIONS
        };
        let mut decay = Decay::new(f64::INFINITY);
        assert!(!minimise(&mut decay, [0.5, 1.0], &options).settled);
        assert!(!minimise(&mut decay, [f64::NAN, 1.0], &OPTIONS).settled);
    }

    #[test]
    fn the_covariance_is_the_inverse_and_none_without_information() {
        let equations = Decay::new(f64::INFINITY).linearise(&[3.0, -1.5]);
        let covariance = equations.covariance().unwrap();
        let unit = &covariance * &equations.normal;
        assert!((unit - DMatrix::identity(2, 2)).norm() < 1e-9);
        let sandwich = equations.sandwich(&equations.normal).unwrap();
        assert!((sandwich - covariance).norm() < 1e-9);
        let nothing = Equations {
            normal: DMatrix::zeros(2, 2),
            right: DVector::zeros(2),
            cost: 0.0,
        };
        assert!(nothing.covariance().is_none());
    }
}
