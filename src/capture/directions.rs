//! Which light directions to take: nearest coaxial first, then farthest-point
//! order over a fixed grid of the reachable part of the hemisphere.
//!
//! Any first N directions of the order are spread as evenly as a greedy choice
//! can, so that N + 1 lights are N lights and one more.

use glam::DVec3;

use crate::units::StageAngles;

/// Candidates stand on whole multiples of this, degrees, so that a person can
/// read and repeat them.
const GRID_DEG: f64 = 2.5;

/// What a stage can reach, in its own angles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StageReach {
    /// Smallest and largest azimuth, degrees, soft limits.
    pub azimuth_deg: [f64; 2],
    /// Smallest and largest elevation, degrees, soft limits.
    pub elevation_deg: [f64; 2],
}

impl StageReach {
    /// Whether the soft limits allow it.
    pub fn contains(&self, angles: StageAngles) -> bool {
        let inside = |value: f64, [low, high]: [f64; 2]| (low..=high).contains(&value);
        inside(angles.azimuth_deg, self.azimuth_deg)
            && inside(angles.elevation_deg, self.elevation_deg)
    }

    /// The grid's points inside the limits and the limits themselves; each
    /// direction once, in a fixed order.
    pub fn candidates(&self) -> Vec<StageAngles> {
        let mut all: Vec<(StageAngles, DVec3)> = Vec::new();
        for elevation_deg in ticks(self.elevation_deg) {
            for azimuth_deg in near_zero_first(ticks(self.azimuth_deg)) {
                let angles = StageAngles {
                    azimuth_deg,
                    elevation_deg,
                };
                let direction = angles.to_light();
                // Azimuths that are the same direction: at the zenith, or a full turn apart.
                let row = all
                    .iter()
                    .rev()
                    .take_while(|(a, _)| a.elevation_deg == elevation_deg);
                if row
                    .clone()
                    .all(|(_, d)| d.distance_squared(direction) > 1e-12)
                {
                    all.push((angles, direction));
                }
            }
        }
        all.into_iter().map(|(angles, _)| angles).collect()
    }
}

/// The interval's ends and the grid between them, ascending.
fn ticks([low, high]: [f64; 2]) -> Vec<f64> {
    let first = (low / GRID_DEG).ceil() as i64;
    let last = (high / GRID_DEG).floor() as i64;
    let mut ticks = vec![low];
    ticks.extend((first..=last).map(|i| i as f64 * GRID_DEG));
    ticks.push(high);
    ticks.dedup_by(|a, b| (*a - *b).abs() < 1e-9);
    ticks
}

/// Where several directions are equally good, the axis shall turn little.
fn near_zero_first(mut angles_deg: Vec<f64>) -> Vec<f64> {
    angles_deg.sort_by(|a, b| a.abs().total_cmp(&b.abs()).then(b.total_cmp(a)));
    angles_deg
}

/// Directions in the order in which they should be taken. `coaxial` is the unit
/// direction from the sample to the camera in the stage's frame. Ends after
/// `count` directions, or where the next one would be nearer than
/// `min_spacing_deg` to one chosen before.
pub fn farthest_point_order(
    reach: &StageReach,
    coaxial: DVec3,
    count: usize,
    min_spacing_deg: f64,
) -> Vec<StageAngles> {
    let candidates = reach.candidates();
    let directions: Vec<DVec3> = candidates.iter().map(|angles| angles.to_light()).collect();
    let smallest_distance_sq = (2.0 * (0.5 * min_spacing_deg.to_radians()).sin()).powi(2);
    let Some(mut next) = first_best(directions.iter().map(|d| d.dot(coaxial))) else {
        return Vec::new();
    };
    let mut nearest_sq = vec![f64::INFINITY; directions.len()];
    // Many candidates are equally far from their nearest light; of those the one
    // with the least Coulomb energy is also far from the others.
    let mut energy = vec![0.0; directions.len()];
    let mut chosen = Vec::new();
    while chosen.len() < count {
        chosen.push(candidates[next]);
        for (candidate, direction) in directions.iter().enumerate() {
            let distance_sq = direction.distance_squared(directions[next]);
            nearest_sq[candidate] = nearest_sq[candidate].min(distance_sq);
            energy[candidate] += distance_sq.max(1e-12).sqrt().recip();
        }
        let farthest_sq = nearest_sq.iter().copied().fold(0.0, f64::max);
        if farthest_sq <= smallest_distance_sq.max(1e-12) {
            break;
        }
        let relaxed = energy
            .iter()
            .zip(&nearest_sq)
            .map(|(&energy, &nearest_sq)| {
                if nearest_sq < farthest_sq - 1e-9 {
                    f64::NEG_INFINITY
                } else {
                    -energy
                }
            });
        match first_best(relaxed) {
            Some(best) => next = best,
            None => break,
        }
    }
    chosen
}

/// Index of the first value that no later one exceeds by more than rounding.
fn first_best(values: impl Iterator<Item = f64>) -> Option<usize> {
    let mut best: Option<(usize, f64)> = None;
    for (index, value) in values.enumerate() {
        if best.is_none_or(|(_, so_far)| value > so_far + 1e-9) {
            best = Some((index, value));
        }
    }
    best.map(|(index, _)| index)
}

#[cfg(test)]
mod tests {
    use super::*;

    const REACH: StageReach = StageReach {
        azimuth_deg: [-170.0, 170.0],
        elevation_deg: [12.0, 88.0],
    };

    #[test]
    fn coaxial_comes_first_and_n_lights_begin_n_plus_one() {
        let ten = farthest_point_order(&REACH, DVec3::Z, 10, 0.0);
        assert_eq!(ten.len(), 10);
        assert_eq!(ten[0].elevation_deg, 88.0);
        for n in 1..10 {
            assert_eq!(farthest_point_order(&REACH, DVec3::Z, n, 0.0), ten[..n]);
        }
        assert!(ten.iter().all(|&angles| REACH.contains(angles)));
    }

    #[test]
    fn each_light_is_as_far_from_the_others_as_any_candidate_could_be() {
        let chosen = farthest_point_order(&REACH, DVec3::Z, 8, 0.0);
        let distance = |a: StageAngles, b: StageAngles| a.to_light().distance(b.to_light());
        for n in 1..chosen.len() {
            let gap = |candidate: StageAngles| {
                chosen[..n]
                    .iter()
                    .map(|&c| distance(c, candidate))
                    .fold(9.0, f64::min)
            };
            let best = REACH.candidates().into_iter().map(gap).fold(0.0, f64::max);
            assert!(gap(chosen[n]) > best - 1e-6, "light {n}");
        }
    }

    /// All directions on the lower limit are equally far from the zenith; the
    /// lights still go all around.
    #[test]
    fn equally_far_lights_go_around() {
        let reach = StageReach {
            azimuth_deg: [-180.0, 180.0],
            elevation_deg: [20.0, 90.0],
        };
        let four = farthest_point_order(&reach, DVec3::Z, 4, 0.0);
        let azimuths: Vec<f64> = four.iter().map(|angles| angles.azimuth_deg).collect();
        assert_eq!(azimuths, [0.0, 0.0, 180.0, 90.0]);
    }

    #[test]
    fn the_spacing_bounds_the_number() {
        let all = farthest_point_order(&REACH, DVec3::Z, usize::MAX, 20.0);
        assert!((20..80).contains(&all.len()), "{}", all.len());
        for (i, a) in all.iter().enumerate() {
            for b in &all[..i] {
                let angle = a.to_light().angle_between(b.to_light()).to_degrees();
                assert!(angle > 20.0 - 1e-6, "{a} and {b}");
            }
        }
    }

    #[test]
    fn the_zenith_and_a_full_turn_are_counted_once() {
        let reach = StageReach {
            azimuth_deg: [-180.0, 180.0],
            elevation_deg: [90.0, 90.0],
        };
        assert_eq!(reach.candidates().len(), 1);
        let reach = StageReach {
            elevation_deg: [0.0, 0.0],
            ..reach
        };
        assert_eq!(reach.candidates().len(), 144);
    }
}
