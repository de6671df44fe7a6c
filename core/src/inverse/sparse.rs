//! Samples of a posterior on the simplex whose prior holds that few atoms are used.
//!
//! A priori each atom is used with the same probability, and the weights of those in
//! use are uniform on their simplex. The likelihood is a Gaussian. A Metropolis chain
//! walks over the sets in use: an atom joins, leaves or is replaced. Most moves touch one
//! or two weights; some draw all weights of the new set from the Gaussian restricted to
//! it, so the chain does not have to creep along the narrow valleys that nearly equal
//! atoms make. Such jumps alone stay for ever in a set whose Gaussian lies off the simplex.

use nalgebra::{DMatrix, DVector};

use super::segment::Segment;
use crate::random::Stream;

/// Most atoms in use at once.
const MAX_ATOMS_IN_USE: usize = 14;

/// Precision added to the Gaussian that weights are proposed from, which keeps directions
/// without information near the simplex. It does not change the posterior.
const PROPOSAL_PRECISION: f64 = 4.0;

/// Moves of one or two weights for each of all weights.
const LOCAL_MOVES: usize = 6;

/// log p(x) = −½ xᵀHx + bᵀx + log prior + constant.
pub struct SparsePosterior {
    h: DMatrix<f64>,
    b: DVector<f64>,
    /// Log odds of an atom being in use.
    log_odds: f64,
}

/// Where the chain is.
struct State {
    /// Atoms in use.
    used: Vec<usize>,
    /// Their weights, each above zero, together one.
    x: Vec<f64>,
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

    /// `count` samples out of a chain of `steps` that begins around `start` (on the
    /// simplex); the first fifth is thrown away.
    pub fn draw(
        &self,
        start: &DVector<f64>,
        count: usize,
        steps: usize,
        numbers: &mut Stream,
    ) -> Vec<DVector<f64>> {
        let n = self.b.len();
        let mut state = begin(start);
        let burn = steps / 5;
        let mut samples = Vec::with_capacity(count);
        for step in 0..steps {
            for _ in 0..LOCAL_MOVES {
                match index(3, numbers) {
                    0 => self.share(&mut state, numbers),
                    1 => self.join_or_leave(&mut state, numbers),
                    _ => self.replace(&mut state, numbers),
                }
            }
            self.jump(&mut state, numbers);
            if step >= burn && (step - burn) * count >= samples.len() * (steps - burn) {
                let mut x = DVector::zeros(n);
                let weights = state.used.iter().zip(&state.x);
                weights.for_each(|(&k, &v)| x[k] = v);
                samples.push(x);
            }
        }
        samples
    }

    /// What moving weight to `gains` from `loses` does to the log-likelihood: slope and
    /// curvature along the way.
    fn along(&self, state: &State, gains: usize, loses: usize) -> [f64; 2] {
        let pull = |k: usize| {
            let weights = state.used.iter().zip(&state.x);
            self.b[k] - weights.map(|(&j, &x)| self.h[(k, j)] * x).sum::<f64>()
        };
        let h = |i, j| self.h[(i, j)];
        let curvature = h(gains, gains) - 2.0 * h(gains, loses) + h(loses, loses);
        [pull(gains) - pull(loses), curvature]
    }

    /// Shares the weight of two atoms in use anew, as the posterior has it.
    fn share(&self, state: &mut State, numbers: &mut Stream) {
        let Some([i, j]) = pair(state.used.len(), numbers) else {
            return;
        };
        let all = state.x[i] + state.x[j];
        (state.x[i], state.x[j]) = (all, 0.0);
        let [slope, curvature] = self.along(state, state.used[j], state.used[i]);
        let moved = Segment::new(slope, curvature, all).draw(numbers);
        (state.x[i], state.x[j]) = (all - moved, moved);
    }

    /// An atom takes part of another's weight, or gives another all that it has. The new
    /// weight is drawn as the posterior has it, so the choice rests on the mass along the
    /// way alone (Green 1995, reversible jump).
    fn join_or_leave(&self, state: &mut State, numbers: &mut Stream) {
        let (n, k) = (self.b.len(), state.used.len());
        // Log ratio of the posterior's to the proposals' densities for k → k + 1 atoms.
        let log_ratio = |k: usize, mass: f64| {
            let ways = k as f64 * (n - k) as f64 / (k + 1) as f64;
            self.log_odds + ways.ln() + mass
        };
        if numbers.uniform() < 0.5 {
            if k == MAX_ATOMS_IN_USE.min(n) {
                return;
            }
            let mut joins = index(n, numbers);
            while state.used.contains(&joins) {
                joins = index(n, numbers);
            }
            let gives = index(k, numbers);
            let [slope, curvature] = self.along(state, joins, state.used[gives]);
            let segment = Segment::new(slope, curvature, state.x[gives]);
            if (1.0 - numbers.uniform()).ln() < log_ratio(k, segment.log_mass()) {
                let moved = segment.draw(numbers);
                state.x[gives] -= moved;
                state.used.push(joins);
                state.x.push(moved);
            }
        } else if let Some([leaves, takes]) = pair(k, numbers) {
            let before = [state.x[leaves], state.x[takes]];
            state.x[takes] += state.x[leaves];
            state.x[leaves] = 0.0;
            let [slope, curvature] = self.along(state, state.used[leaves], state.used[takes]);
            let segment = Segment::new(slope, curvature, state.x[takes]);
            if (1.0 - numbers.uniform()).ln() < -log_ratio(k - 1, segment.log_mass()) {
                state.used.swap_remove(leaves);
                state.x.swap_remove(leaves);
            } else {
                [state.x[leaves], state.x[takes]] = before;
            }
        }
    }

    /// An atom that is not in use takes the place of one that is.
    fn replace(&self, state: &mut State, numbers: &mut Stream) {
        let place = index(state.used.len(), numbers);
        let atom = index(self.b.len(), numbers);
        if state.used.contains(&atom) {
            return;
        }
        let [slope, curvature] = self.along(state, atom, state.used[place]);
        let all = state.x[place];
        if (1.0 - numbers.uniform()).ln() < all * (slope - 0.5 * curvature * all) {
            state.used[place] = atom;
        }
    }

    /// All weights anew for the same atoms, one more, one fewer or one replaced, from the
    /// Gaussian restricted to them.
    fn jump(&self, state: &mut State, numbers: &mut Stream) {
        let mut used = state.used.clone();
        let choice = numbers.uniform();
        let atom = index(self.b.len(), numbers);
        let place = used.iter().position(|&k| k == atom);
        if choice < 0.35 {
            match place {
                Some(at) => drop(used.remove(at)),
                None => used.push(atom),
            }
        } else if choice < 0.75 {
            let at = index(used.len(), numbers);
            match place {
                Some(_) => return,
                None => used[at] = atom,
            }
        }
        let Some(proposal) = Proposal::new(self, &used) else {
            return;
        };
        let Some(x) = proposal.draw(numbers) else {
            return;
        };
        let Some(back) = Proposal::new(self, &state.used) else {
            return;
        };
        let next = State { used, x };
        let gain = self.log_density(&next) - proposal.log_density(&next.x);
        let loss = self.log_density(state) - back.log_density(&state.x);
        if (1.0 - numbers.uniform()).ln() < gain - loss {
            *state = next;
        }
    }

    /// Log posterior; a uniform density on the simplex of k weights is (k − 1)!.
    fn log_density(&self, state: &State) -> f64 {
        let k = state.used.len();
        let log_uniform: f64 = (1..k).map(|i| (i as f64).ln()).sum();
        k as f64 * self.log_odds + log_uniform + self.log_likelihood(&state.used, &state.x)
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
}

/// The Gaussian restricted to the plane of a set of atoms, in the coordinates x₀..x_{k−2},
/// the last weight being what is left of one.
struct Proposal {
    /// Atoms.
    k: usize,
    /// Lower triangular root of the precision.
    factor: [[f64; MAX_ATOMS_IN_USE]; MAX_ATOMS_IN_USE],
    /// The mean, left-multiplied by the root's transpose.
    y: [f64; MAX_ATOMS_IN_USE],
}

impl Proposal {
    /// `None` for no atoms, too many, or atoms without any precision.
    fn new(posterior: &SparsePosterior, used: &[usize]) -> Option<Self> {
        let k = used.len();
        if k == 0 || k > MAX_ATOMS_IN_USE {
            return None;
        }
        let m = k - 1;
        let last = used[m];
        let h = |i: usize, j: usize| posterior.h[(i, j)];
        let b = &posterior.b;
        let mut factor = [[0.0f64; MAX_ATOMS_IN_USE]; MAX_ATOMS_IN_USE];
        let mut y = [0.0f64; MAX_ATOMS_IN_USE];
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
            let mut v = b[i] - b[last] - h(i, last) + h(last, last) + PROPOSAL_PRECISION / k as f64;
            for q in 0..s {
                v -= factor[s][q] * y[q];
            }
            y[s] = v / factor[s][s];
        }
        Some(Self { k, factor, y })
    }

    /// Weights; `None` where these are off the simplex.
    fn draw(&self, numbers: &mut Stream) -> Option<Vec<f64>> {
        let m = self.k - 1;
        let mut x = vec![0.0; self.k];
        let mut left = 1.0;
        for s in (0..m).rev() {
            let others: f64 = (s + 1..m).map(|q| self.factor[q][s] * x[q]).sum();
            x[s] = (self.y[s] + numbers.normal() - others) / self.factor[s][s];
            left -= x[s];
            if x[s] < 0.0 || left < 0.0 {
                return None;
            }
        }
        x[m] = left;
        Some(x)
    }

    /// Log density of weights on the simplex.
    fn log_density(&self, x: &[f64]) -> f64 {
        let m = self.k - 1;
        let mut log_density = -0.5 * m as f64 * std::f64::consts::TAU.ln();
        for s in 0..m {
            let mapped: f64 = (s..m).map(|q| self.factor[q][s] * x[q]).sum();
            let z = mapped - self.y[s];
            log_density += self.factor[s][s].ln() - 0.5 * z * z;
        }
        log_density
    }
}

/// The largest weights of `start`.
fn begin(start: &DVector<f64>) -> State {
    let mut used: Vec<usize> = (0..start.len()).filter(|&k| start[k] > 0.0).collect();
    used.sort_by(|&a, &b| start[b].total_cmp(&start[a]));
    used.truncate(MAX_ATOMS_IN_USE);
    let sum: f64 = used.iter().map(|&k| start[k]).sum();
    let x = used.iter().map(|&k| start[k] / sum).collect();
    State { used, x }
}

/// An index below `n`.
fn index(n: usize, numbers: &mut Stream) -> usize {
    ((numbers.uniform() * n as f64) as usize).min(n - 1)
}

/// Two different indices below `n`, where there are two.
fn pair(n: usize, numbers: &mut Stream) -> Option<[usize; 2]> {
    if n < 2 {
        return None;
    }
    let first = index(n, numbers);
    let second = index(n - 1, numbers);
    Some([first, second + usize::from(second >= first)])
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
        let samples = posterior.draw(&start, 40_000, 400_000, &mut numbers);
        let n = samples.len() as f64;
        let found = [
            samples.iter().map(|x| x[0]).sum::<f64>() / n,
            samples.iter().map(|x| x[0] * x[0]).sum::<f64>() / n,
            samples.iter().filter(|x| x[2] == 0.0).count() as f64 / n,
        ];
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() < 0.02, "{found} for {expected}");
        }
        for x in &samples {
            assert!((x.sum() - 1.0).abs() < 1e-9 && x.min() >= 0.0);
        }
    }

    /// Without a likelihood: atoms in use and the sum of the squared weights against the
    /// binomial and 2 / (k + 1), and every atom alike.
    #[test]
    fn the_prior_is_what_it_says() {
        let n = 26;
        let expected = 5.0;
        let posterior = SparsePosterior::new(DMatrix::zeros(n, n), DVector::zeros(n), expected);
        let odds = posterior.log_odds.exp();
        // Ways to use k atoms, each with the odds.
        let mut mass = vec![1.0];
        for k in 1..=MAX_ATOMS_IN_USE {
            mass.push(mass[k - 1] * odds * (n + 1 - k) as f64 / k as f64);
        }
        let mean_of = |f: &dyn Fn(f64) -> f64| -> f64 {
            let terms = (1..=MAX_ATOMS_IN_USE).map(|k| mass[k] * f(k as f64));
            terms.sum::<f64>() / mass[1..].iter().sum::<f64>()
        };
        let mut numbers = stream(5, Purpose::Posterior, 0, 0, 0);
        let start = DVector::from_element(n, 1.0 / n as f64);
        let samples = posterior.draw(&start, 20_000, 200_000, &mut numbers);
        let mean = |f: &dyn Fn(&DVector<f64>) -> f64| -> f64 {
            samples.iter().map(f).sum::<f64>() / samples.len() as f64
        };
        let used = mean(&|x| x.iter().filter(|&&w| w > 0.0).count() as f64);
        let wanted = mean_of(&|k| k);
        assert!((used - wanted).abs() < 0.05, "{used} for {wanted}");
        let square = mean(&|x| x.norm_squared());
        let wanted = mean_of(&|k| 2.0 / (k + 1.0));
        assert!((square - wanted).abs() < 0.01, "{square} for {wanted}");
        for atom in 0..n {
            let weight = mean(&|x| x[atom]);
            assert!((weight * n as f64 - 1.0).abs() < 0.15, "{atom}: {weight}");
        }
    }
}
