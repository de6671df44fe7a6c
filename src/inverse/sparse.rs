//! Draws from a posterior on the simplex whose prior holds that few atoms are used.
//!
//! A priori each atom is used with the same probability, and the weights of those in
//! use are uniform on their simplex. The likelihood is a Gaussian. A Metropolis chain
//! walks over the sets in use: an atom joins, leaves or is replaced, and the weights of
//! the new set come from the Gaussian restricted to it, so the chain never has to creep
//! along the narrow valleys that nearly equal atoms make.

use nalgebra::{DMatrix, DVector};

use crate::random::Stream;

/// Most atoms in use at once.
const MOST: usize = 14;

/// Precision added to the Gaussian that weights are proposed from, which keeps directions
/// without information near the simplex. It does not change the posterior.
const PROPOSAL_PRECISION: f64 = 4.0;

/// log p(x) = −½ xᵀHx + bᵀx + log prior + constant.
pub struct SparsePosterior {
    h: DMatrix<f64>,
    b: DVector<f64>,
    /// Log odds of an atom being in use.
    log_odds: f64,
}

/// Where the chain is.
struct State {
    used: Vec<usize>,
    x: Vec<f64>,
    /// Log posterior over the proposal's density.
    log_weight: f64,
}

impl SparsePosterior {
    /// `h`: N × N, symmetric positive semidefinite; `b`: N; `expected`: atoms in use a
    /// priori on average, (0, N).
    pub fn new(h: DMatrix<f64>, b: DVector<f64>, expected: f64) -> Self {
        let share = expected / b.len() as f64;
        Self {
            h,
            b,
            log_odds: (share / (1.0 - share)).ln(),
        }
    }

    /// `count` draws out of a chain of `steps` that begins around `start` (on the
    /// simplex); the first fifth is thrown away.
    pub fn draw(
        &self,
        start: &DVector<f64>,
        count: usize,
        steps: usize,
        numbers: &mut Stream,
    ) -> Vec<DVector<f64>> {
        let n = self.b.len();
        let mut state = self.begin(start, numbers);
        let burn = steps / 5;
        let mut draws = Vec::with_capacity(count);
        for step in 0..steps {
            let mut used = state.used.clone();
            let choice = numbers.uniform();
            let atom = ((numbers.uniform() * n as f64) as usize).min(n - 1);
            let place = used.iter().position(|&k| k == atom);
            if choice < 0.35 {
                match place {
                    Some(at) => drop(used.remove(at)),
                    None => used.push(atom),
                }
            } else if choice < 0.75 {
                let at = ((numbers.uniform() * used.len() as f64) as usize).min(used.len() - 1);
                match place {
                    Some(_) => used.clear(),
                    None => used[at] = atom,
                }
            }
            if let Some(next) = self.propose(used, numbers)
                && (1.0 - numbers.uniform()).ln() < next.log_weight - state.log_weight
            {
                state = next;
            }
            if step >= burn && (step - burn) * count >= draws.len() * (steps - burn) {
                let mut x = DVector::zeros(n);
                state
                    .used
                    .iter()
                    .zip(&state.x)
                    .for_each(|(&k, &v)| x[k] = v);
                draws.push(x);
            }
        }
        draws
    }

    /// The largest weights of `start`, as many as give a point inside the simplex.
    fn begin(&self, start: &DVector<f64>, numbers: &mut Stream) -> State {
        let mut used: Vec<usize> = (0..start.len()).filter(|&k| start[k] > 1e-3).collect();
        used.sort_by(|&a, &b| start[b].total_cmp(&start[a]));
        used.truncate(8);
        while used.len() > 1 {
            for _ in 0..2000 {
                if let Some(state) = self.propose(used.clone(), numbers) {
                    return state;
                }
            }
            used.pop();
        }
        let only = used.first().copied().unwrap_or(0);
        State {
            log_weight: self.log_odds + self.log_likelihood(&[only], &[1.0]),
            used: vec![only],
            x: vec![1.0],
        }
    }

    fn log_likelihood(&self, used: &[usize], x: &[f64]) -> f64 {
        let mut sum = 0.0;
        for (&i, &xi) in used.iter().zip(x) {
            let row: f64 = used
                .iter()
                .zip(x)
                .map(|(&j, &xj)| self.h[(i, j)] * xj)
                .sum();
            sum += xi * (self.b[i] - 0.5 * row);
        }
        sum
    }

    /// Weights for a set of atoms, from the Gaussian restricted to their plane; `None`
    /// off the simplex.
    fn propose(&self, used: Vec<usize>, numbers: &mut Stream) -> Option<State> {
        let k = used.len();
        if k == 0 || k > MOST {
            return None;
        }
        let m = k - 1;
        let last = used[m];
        let h = |i: usize, j: usize| self.h[(i, j)];
        // In the coordinates x₀..x_{m−1}, the last weight being what is left of one.
        let mut factor = [[0.0f64; MOST]; MOST];
        let mut y = [0.0f64; MOST];
        for s in 0..m {
            let i = used[s];
            for t in 0..=s {
                let j = used[t];
                let mut v = h(i, j) - h(i, last) - h(last, j) + h(last, last);
                if s == t {
                    v += PROPOSAL_PRECISION;
                }
                for (a, b) in factor[s][..t].iter().zip(&factor[t][..t]) {
                    v -= a * b;
                }
                factor[s][t] = if s == t {
                    if v <= 0.0 {
                        return None;
                    }
                    v.sqrt()
                } else {
                    v / factor[t][t]
                };
            }
            let mut v = self.b[i] - self.b[last] - h(i, last)
                + h(last, last)
                + PROPOSAL_PRECISION / k as f64;
            for q in 0..s {
                v -= factor[s][q] * y[q];
            }
            y[s] = v / factor[s][s];
        }
        let mut log_density = -0.5 * m as f64 * std::f64::consts::TAU.ln();
        for s in 0..m {
            let z = numbers.normal();
            log_density += factor[s][s].ln() - 0.5 * z * z;
            y[s] += z;
        }
        let mut x = vec![0.0; k];
        let mut left = 1.0;
        for s in (0..m).rev() {
            let mut v = y[s];
            for q in s + 1..m {
                v -= factor[q][s] * x[q];
            }
            x[s] = v / factor[s][s];
            left -= x[s];
            if x[s] < 0.0 || left < 0.0 {
                return None;
            }
        }
        x[m] = left;
        // A uniform density on the simplex of k weights is (k − 1)!.
        let log_uniform: f64 = (1..k).map(|i| (i as f64).ln()).sum();
        let log_weight =
            k as f64 * self.log_odds + log_uniform + self.log_likelihood(&used, &x) - log_density;
        Some(State {
            used,
            x,
            log_weight,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, stream};

    /// Three atoms, by quadrature over the faces of the triangle: mean and square of a
    /// weight, and how often an atom is not used.
    #[test]
    fn draws_follow_the_posterior() {
        let h = DMatrix::from_row_slice(3, 3, &[40.0, 30.0, 5.0, 30.0, 45.0, 0.0, 5.0, 0.0, 20.0]);
        let b = DVector::from_vec(vec![25.0, 24.0, 6.0]);
        let posterior = SparsePosterior::new(h.clone(), b.clone(), 1.2);
        let density = |x: [f64; 3]| {
            let x = DVector::from_row_slice(&x);
            (-0.5 * x.dot(&(&h * &x)) + b.dot(&x)).exp()
        };
        let odds = posterior.log_odds.exp();
        let steps = 400;
        let at = |i: usize| (i as f64 + 0.5) / f64::from(steps);
        // Moments of x₀ and the chance that atom 2 is idle: [1, x, x², idle].
        let mut sums = [0.0; 4];
        let mut add = |x: [f64; 3], mass: f64, idle: bool| {
            let p = mass * density(x);
            let terms = [1.0, x[0], x[0] * x[0], f64::from(u8::from(idle))];
            sums.iter_mut().zip(terms).for_each(|(s, t)| *s += p * t);
        };
        for (k, x) in [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
            .into_iter()
            .enumerate()
        {
            add(x, odds, k != 2);
        }
        for i in 0..steps as usize {
            let (u, v) = (at(i), 1.0 - at(i));
            let mass = odds * odds / f64::from(steps);
            add([u, v, 0.0], mass, true);
            add([u, 0.0, v], mass, false);
            add([0.0, u, v], mass, false);
            for j in 0..steps as usize {
                let w = at(j);
                if u + w < 1.0 {
                    let mass = 2.0 * odds.powi(3) / f64::from(steps * steps);
                    add([u, w, 1.0 - u - w], mass, false);
                }
            }
        }
        let expected = [1, 2, 3].map(|i| sums[i] / sums[0]);
        let mut numbers = stream(4, Purpose::Posterior, 0, 0, 0);
        let start = DVector::from_vec(vec![0.5, 0.3, 0.2]);
        let draws = posterior.draw(&start, 40_000, 400_000, &mut numbers);
        let n = draws.len() as f64;
        let found = [
            draws.iter().map(|x| x[0]).sum::<f64>() / n,
            draws.iter().map(|x| x[0] * x[0]).sum::<f64>() / n,
            draws.iter().filter(|x| x[2] == 0.0).count() as f64 / n,
        ];
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() < 0.02, "{found} for {expected}");
        }
        for x in &draws {
            assert!((x.sum() - 1.0).abs() < 1e-9 && x.min() >= 0.0);
        }
    }
}
