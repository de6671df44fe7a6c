//! Which corner of the board is which: from a corner to its neighbours, step by step.

use std::collections::{HashMap, VecDeque};

use glam::DVec2;

/// Part of a step by which a corner may be off from where its neighbours put it.
const NEAR: f64 = 0.3;
/// Corners from which a walk is tried.
const SEEDS: usize = 12;

/// A found corner: position and the directions of its two edges (radians).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// Pixels.
    pub at_px: DVec2,
    /// Directions of the edges, the same for every second corner, exchanged for the others.
    pub angles_rad: [f64; 2],
    /// How much of a corner it is.
    pub response: f64,
}

/// The largest connected part of a board: for each of the board's nodes (column, row; in a
/// right-handed system seen from its front, so that rows count upwards) the index of the
/// candidate. Nodes count from 0.
pub fn label(candidates: &[Candidate]) -> HashMap<[i32; 2], usize> {
    let mut order: Vec<usize> = (0..candidates.len()).collect();
    order.sort_by(|a, b| {
        candidates[*b]
            .response
            .total_cmp(&candidates[*a].response)
            .then(a.cmp(b))
    });
    let mut best = HashMap::new();
    for &seed in order.iter().take(SEEDS) {
        let labels = walk(candidates, seed);
        if labels.len() > best.len() {
            best = labels;
        }
        if 2 * best.len() > candidates.len() {
            break;
        }
    }
    let low = |i: usize| best.keys().map(|node| node[i]).min().unwrap_or(0);
    let [column, row] = [low(0), low(1)];
    best.into_iter()
        .map(|(node, index)| ([node[0] - column, node[1] - row], index))
        .collect()
}

fn walk(candidates: &[Candidate], seed: usize) -> HashMap<[i32; 2], usize> {
    let mut labels = HashMap::new();
    let Some(steps) = first_steps(candidates, seed) else {
        return labels;
    };
    let mut taken = vec![false; candidates.len()];
    labels.insert([0, 0], seed);
    taken[seed] = true;
    let mut queue = VecDeque::from([([0, 0], seed, steps)]);
    while let Some((node, from, steps)) = queue.pop_front() {
        for (axis, sign) in [(0, 1), (0, -1), (1, 1), (1, -1)] {
            let mut next = node;
            next[axis] += sign;
            if labels.contains_key(&next) {
                continue;
            }
            let step = steps[axis] * f64::from(sign);
            let expected = candidates[from].at_px + step;
            let Some(found) = nearest(candidates, expected, NEAR * step.length()) else {
                continue;
            };
            if taken[found] {
                continue;
            }
            taken[found] = true;
            labels.insert(next, found);
            let mut steps = steps;
            steps[axis] = (candidates[found].at_px - candidates[from].at_px) * f64::from(sign);
            queue.push_back((next, found, steps));
        }
    }
    labels
}

fn nearest(candidates: &[Candidate], at: DVec2, within: f64) -> Option<usize> {
    let distance = |c: &Candidate| c.at_px.distance(at);
    (0..candidates.len())
        .filter(|&i| distance(&candidates[i]) <= within)
        .min_by(|&a, &b| distance(&candidates[a]).total_cmp(&distance(&candidates[b])))
}

/// Steps to the neighbours along both edges of a corner: to the right and upwards where
/// the board stands straight.
fn first_steps(candidates: &[Candidate], seed: usize) -> Option<[DVec2; 2]> {
    let from = &candidates[seed];
    let mut steps = [DVec2::ZERO; 2];
    for (step, angle) in steps.iter_mut().zip(from.angles_rad) {
        let along = DVec2::from_angle(angle);
        let ahead = candidates.iter().filter_map(|c| {
            let offset = c.at_px - from.at_px;
            let forward = offset.dot(along);
            // Within 15° of the edge, to either side.
            (forward.abs() > 1.0 && offset.perp_dot(along).abs() < 0.27 * forward.abs())
                .then_some(offset * forward.signum())
        });
        *step = ahead.min_by(|a, b| a.length().total_cmp(&b.length()))?;
    }
    let ratio = steps[0].length() / steps[1].length();
    if !(0.2..=5.0).contains(&ratio) {
        return None;
    }
    // Rows of the image count downwards.
    if steps[0].perp_dot(steps[1]) > 0.0 {
        steps[1] = -steps[1];
    }
    Some(steps)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A board in perspective with a missing corner and corners that are none of its.
    #[test]
    fn a_board_among_other_corners_is_labelled() {
        let project = |i: i32, j: i32| {
            let (x, y) = (f64::from(i), f64::from(j));
            let w = 1.0 + 0.02 * x - 0.03 * y;
            DVec2::new(40.0 + 22.0 * x + 3.0 * y, 200.0 + 2.0 * x - 20.0 * y) / w
        };
        let mut candidates = Vec::new();
        let mut expected = HashMap::new();
        for j in 0..6 {
            for i in 0..8 {
                if (i, j) == (3, 3) {
                    continue;
                }
                let at_px = project(i, j);
                let angle = |a: DVec2| (a - at_px).to_angle();
                expected.insert([i, j], candidates.len());
                candidates.push(Candidate {
                    at_px,
                    angles_rad: [angle(project(i + 1, j)), angle(project(i, j + 1))],
                    response: 1.0,
                });
            }
        }
        for k in 0..5 {
            candidates.push(Candidate {
                at_px: DVec2::new(400.0, 40.0 * f64::from(k)),
                angles_rad: [0.3, 1.2],
                response: 1.5,
            });
        }
        assert_eq!(label(&candidates), expected);
        assert!(label(&[]).is_empty());
    }
}
