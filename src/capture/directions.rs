//! Which light directions to take: nearest coaxial first, then farthest-point
//! order over a fixed grid of the reachable part of the hemisphere.
//!
//! Any first N directions of the order are spread as evenly as a greedy choice
//! can, so that N + 1 lights are N lights and one more.

use glam::DVec3;

use crate::device::kinematics::{AxisMap, Kinematics, Mechanism, TwoAxes};
use crate::units::StageAngles;

/// Candidates stand on whole multiples of this, degrees, so that a person can
/// read and repeat them.
const GRID_DEG: f64 = 2.5;

/// What a stage can reach.
#[derive(Clone, Debug, PartialEq)]
pub struct StageReach(pub Kinematics);

impl StageReach {
    /// Two rotary axes with these soft limits, degrees.
    pub fn of_angles(azimuth_deg: [f64; 2], elevation_deg: [f64; 2]) -> Self {
        let axis = |[min, max]: [f64; 2]| AxisMap {
            scale: 1.0,
            offset: 0.0,
            min,
            max,
        };
        Self(Kinematics::TwoAxes(TwoAxes {
            mechanism: Mechanism::Rotary,
            first: axis(azimuth_deg),
            second: axis(elevation_deg),
            approach: 0.0,
        }))
    }

    /// Whether the soft limits allow it.
    pub fn contains(&self, angles: StageAngles) -> bool {
        self.0.reaches(angles)
    }

    /// Directions to choose from, each once, in a fixed order: of axes the
    /// grid's points inside the limits and rotary limits themselves, of fixed
    /// lights all of them.
    pub fn candidates(&self) -> Vec<StageAngles> {
        let axes = match &self.0 {
            Kinematics::FixedLights(lights) => return lights.directions.clone(),
            Kinematics::TwoAxes(axes) => axes,
        };
        let [azimuth_deg, elevation_deg] = axes.angle_ranges_deg();
        let mut all: Vec<(StageAngles, DVec3)> = Vec::new();
        for elevation_deg in ticks(elevation_deg) {
            for azimuth_deg in near_zero_first(ticks(azimuth_deg)) {
                let angles = StageAngles {
                    azimuth_deg,
                    elevation_deg,
                };
                if !self.contains(angles) {
                    continue;
                }
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
    use crate::device::kinematics::FixedLights;

    fn reach() -> StageReach {
        StageReach::of_angles([-170.0, 170.0], [12.0, 88.0])
    }

    #[test]
    fn coaxial_comes_first_and_n_lights_begin_n_plus_one() {
        let ten = farthest_point_order(&reach(), DVec3::Z, 10, 0.0);
        assert_eq!(ten.len(), 10);
        assert_eq!(ten[0].elevation_deg, 88.0);
        for n in 1..10 {
            assert_eq!(farthest_point_order(&reach(), DVec3::Z, n, 0.0), ten[..n]);
        }
        assert!(ten.iter().all(|&angles| reach().contains(angles)));
    }

    #[test]
    fn each_light_is_as_far_from_the_others_as_any_candidate_could_be() {
        let chosen = farthest_point_order(&reach(), DVec3::Z, 8, 0.0);
        let distance = |a: StageAngles, b: StageAngles| a.to_light().distance(b.to_light());
        for n in 1..chosen.len() {
            let gap = |candidate: StageAngles| {
                chosen[..n]
                    .iter()
                    .map(|&c| distance(c, candidate))
                    .fold(9.0, f64::min)
            };
            let best = reach()
                .candidates()
                .into_iter()
                .map(gap)
                .fold(0.0, f64::max);
            assert!(gap(chosen[n]) > best - 1e-6, "light {n}");
        }
    }

    /// All directions on the lower limit are equally far from the zenith; the
    /// lights still go all around.
    #[test]
    fn equally_far_lights_go_around() {
        let reach = StageReach::of_angles([-180.0, 180.0], [20.0, 90.0]);
        let four = farthest_point_order(&reach, DVec3::Z, 4, 0.0);
        let azimuths: Vec<f64> = four.iter().map(|angles| angles.azimuth_deg).collect();
        assert_eq!(azimuths, [0.0, 0.0, 180.0, 90.0]);
    }

    #[test]
    fn the_spacing_bounds_the_number() {
        let all = farthest_point_order(&reach(), DVec3::Z, usize::MAX, 20.0);
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
        let reach = StageReach::of_angles([-180.0, 180.0], [90.0, 90.0]);
        assert_eq!(reach.candidates().len(), 1);
        let reach = StageReach::of_angles([-180.0, 180.0], [0.0, 0.0]);
        assert_eq!(reach.candidates().len(), 144);
    }

    /// 200 mm aside at a height of 300 mm is 56.3° of elevation, along the
    /// diagonal 46.7°: what is lower is no candidate, what is higher is one
    /// wherever it points.
    #[test]
    fn a_gantry_reaches_farther_along_its_diagonals() {
        let axis = AxisMap {
            scale: 1.0,
            offset: 0.0,
            min: -200.0,
            max: 200.0,
        };
        let gantry = StageReach(Kinematics::TwoAxes(TwoAxes {
            mechanism: Mechanism::Gantry { height_mm: 300.0 },
            first: axis,
            second: axis,
            approach: 0.0,
        }));
        let candidates = gantry.candidates();
        let at = |elevation_deg| {
            let row = candidates.iter();
            row.filter(|angles| angles.elevation_deg == elevation_deg)
                .count()
        };
        assert_eq!([at(45.0), at(57.5), at(90.0)], [0, 144, 1]);
        assert!((1..144).contains(&at(50.0)), "{}", at(50.0));
        assert!(candidates.iter().all(|&angles| gantry.contains(angles)));
    }

    #[test]
    fn fixed_lights_are_the_only_candidates() {
        let directions: Vec<_> = (0..12)
            .map(|i| StageAngles {
                azimuth_deg: f64::from(i) * 30.0,
                elevation_deg: 40.0 + f64::from(i),
            })
            .collect();
        let dome = StageReach(Kinematics::FixedLights(FixedLights {
            directions: directions.clone(),
            tolerance_deg: 0.5,
        }));
        let chosen = farthest_point_order(&dome, DVec3::Z, usize::MAX, 0.0);
        assert_eq!(chosen.len(), 12);
        assert_eq!(chosen[0], directions[11]);
        assert!(chosen.iter().all(|light| directions.contains(light)));
    }
}
