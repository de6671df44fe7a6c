//! Which light directions to take: a greedy choice that spreads the lights around the sample
//! and over a range of angles to the camera's axis (docs/adr/0035).
//!
//! N + 1 lights are N lights and one more: the first ones of a longer plan are a plan.

use glam::DVec3;

use super::reach::StageReach;
use crate::units::StageAngles;

/// The first light's angle to the camera's axis, degrees.
const FIRST_DEG: f64 = 45.0;
/// Angles to the camera's axis that are preferred, degrees: nearer to it highlights repeat
/// what the first lights showed, farther from it little of a concave sample is lit.
const PREFERRED_DEG: [f64; 2] = [15.0, 55.0];
/// Beyond them a light counts for less, down to [`LEAST_PREFERENCE`], over this, degrees.
const FALL_DEG: f64 = 30.0;
/// What any direction counts for at least, of 1.
const LEAST_PREFERENCE: f64 = 0.3;
/// How much more a difference of the angle to the axis counts than one around it, as squares:
/// around the axis a sample of revolution shows the same angles of incidence once more.
const POLAR_WEIGHT: f64 = 2.0;

/// A direction that can be chosen.
struct Candidate {
    angles: StageAngles,
    direction: DVec3,
    /// Angle to the camera's axis, radians.
    polar_rad: f64,
    /// Squared chord to the nearest direction chosen so far.
    nearest_chord_sq: f64,
    /// Distance to the nearest one chosen, with [`POLAR_WEIGHT`].
    gap: f64,
    /// Sum of the inverse distances to those chosen.
    energy: f64,
}

impl Candidate {
    fn new(angles: StageAngles, coaxial: DVec3) -> Self {
        let direction = angles.to_light();
        Self {
            angles,
            direction,
            polar_rad: direction.angle_between(coaxial),
            nearest_chord_sq: f64::INFINITY,
            gap: f64::INFINITY,
            energy: 0.0,
        }
    }

    /// Takes note of a direction that was chosen.
    fn meet(&mut self, direction: DVec3, polar_rad: f64) {
        let chord_sq = self.direction.distance_squared(direction);
        let distance = (chord_sq + POLAR_WEIGHT * (self.polar_rad - polar_rad).powi(2)).sqrt();
        self.nearest_chord_sq = self.nearest_chord_sq.min(chord_sq);
        self.gap = self.gap.min(distance);
        self.energy += distance.max(1e-6).recip();
    }

    /// How much its gap counts, up to 1.
    fn preference(&self) -> f64 {
        let polar_deg = self.polar_rad.to_degrees();
        let [near_deg, far_deg] = PREFERRED_DEG;
        let outside_deg = (near_deg - polar_deg).max(polar_deg - far_deg).max(0.0);
        (1.0 - outside_deg / FALL_DEG).max(LEAST_PREFERENCE)
    }
}

/// Directions in the order in which they should be taken: first the one whose angle to the
/// camera's axis is nearest to `FIRST_DEG`, then always the one with the largest gap to
/// those before, where the gap counts by preference. `coaxial` is the unit direction from the
/// sample to the camera in the stage's frame. Ends after `count` directions, or where every
/// other one is nearer than `min_spacing_deg` to one chosen before.
pub fn plan_order(
    reach: &StageReach,
    coaxial: DVec3,
    count: usize,
    min_spacing_deg: f64,
) -> Vec<StageAngles> {
    let smallest_chord_sq = (2.0 * (0.5 * min_spacing_deg.to_radians()).sin()).powi(2);
    let candidates = reach.candidates().into_iter();
    let mut candidates: Vec<Candidate> = candidates
        .map(|angles| Candidate::new(angles, coaxial))
        .collect();
    let off_first = |candidate: &Candidate| (candidate.polar_rad - FIRST_DEG.to_radians()).abs();
    let mut next = first_best(candidates.iter().map(|c| -off_first(c)));
    let mut chosen = Vec::new();
    while let (Some(index), true) = (next, chosen.len() < count) {
        let Candidate {
            angles,
            direction,
            polar_rad,
            ..
        } = candidates[index];
        chosen.push(angles);
        candidates
            .iter_mut()
            .for_each(|c| c.meet(direction, polar_rad));
        candidates.retain(|c| c.nearest_chord_sq > smallest_chord_sq.max(1e-12));
        let largest = candidates.iter().map(|c| c.gap * c.preference());
        let largest = largest.fold(0.0, f64::max);
        // Many are equally far from their nearest light; of those the one with the least
        // energy is also far from the others.
        next =
            first_best(
                candidates
                    .iter()
                    .map(|c| match c.gap * c.preference() > largest - 1e-9 {
                        true => -c.energy,
                        false => f64::NEG_INFINITY,
                    }),
            );
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
    use crate::device::kinematics::{FixedLights, Kinematics};

    fn reach() -> StageReach {
        StageReach::of_angles([-170.0, 170.0], [12.0, 88.0])
    }

    #[test]
    fn n_lights_begin_n_plus_one() {
        let ten = plan_order(&reach(), DVec3::Z, 10, 0.0);
        assert_eq!(ten.len(), 10);
        assert_eq!((ten[0].azimuth_deg, ten[0].elevation_deg), (0.0, 45.0));
        for n in 1..10 {
            assert_eq!(plan_order(&reach(), DVec3::Z, n, 0.0), ten[..n]);
        }
        assert!(ten.iter().all(|&angles| reach().contains(angles)));
    }

    /// Whatever the stage reaches, and however the camera stands: lights are at least as far
    /// apart as so many can be on the part that is preferred, at more than one angle to the
    /// camera's axis, and none is outside that part while there is room in it.
    #[test]
    fn lights_are_spread_over_what_is_preferred() {
        for (azimuth_deg, elevation_deg, tilt_deg) in [
            ([-170.0, 170.0], [12.0, 88.0], 0.0f64),
            ([-180.0, 180.0], [0.0, 90.0], 20.0),
            ([-180.0, 180.0], [30.0, 70.0], 0.0),
            ([-90.0, 90.0], [20.0, 80.0], 0.0),
        ] {
            let reach = StageReach::of_angles(azimuth_deg, elevation_deg);
            let tilt_rad = tilt_deg.to_radians();
            let coaxial = DVec3::new(tilt_rad.sin(), 0.0, tilt_rad.cos());
            let lights = plan_order(&reach, coaxial, 8, 0.0);
            let directions: Vec<DVec3> = lights.iter().map(|angles| angles.to_light()).collect();
            let polar_deg = |d: &DVec3| d.angle_between(coaxial).to_degrees();
            let polar: Vec<f64> = directions.iter().map(polar_deg).collect();
            let [low, high] =
                [f64::min, f64::max].map(|of| polar.iter().copied().reduce(of).unwrap());
            assert!(low >= 15.0 - 5.0 && high <= 55.0 + 10.0, "{polar:?}");
            assert!(high - low > 20.0, "{polar:?}");
            for (n, light) in directions.iter().enumerate() {
                for other in &directions[..n] {
                    let apart_deg = light.angle_between(*other).to_degrees();
                    assert!(apart_deg > 18.0, "{apart_deg}: {lights:?}");
                }
            }
        }
    }

    /// Outside the preferred part there is still a best choice.
    #[test]
    fn lights_that_only_graze_or_only_face_the_camera_go_around() {
        for elevation_deg in [[5.0, 5.0], [80.0, 80.0]] {
            let reach = StageReach::of_angles([-180.0, 180.0], elevation_deg);
            let four = plan_order(&reach, DVec3::Z, 4, 0.0);
            let azimuths: Vec<f64> = four.iter().map(|angles| angles.azimuth_deg).collect();
            assert_eq!(azimuths, [0.0, 180.0, 90.0, -90.0]);
        }
    }

    #[test]
    fn the_spacing_bounds_the_number() {
        let all = plan_order(&reach(), DVec3::Z, usize::MAX, 20.0);
        assert!((20..80).contains(&all.len()), "{}", all.len());
        for (i, a) in all.iter().enumerate() {
            for b in &all[..i] {
                let angle = a.to_light().angle_between(b.to_light()).to_degrees();
                assert!(angle > 20.0 - 1e-6, "{a} and {b}");
            }
        }
    }

    #[test]
    fn fixed_lights_are_the_only_candidates() {
        let directions: Vec<_> = (0..12)
            .map(|i| StageAngles {
                azimuth_deg: f64::from(i) * 30.0,
                elevation_deg: 40.0 + f64::from(i),
            })
            .collect();
        let dome = StageReach::free(Kinematics::FixedLights(FixedLights {
            directions: directions.clone(),
            tolerance_deg: 0.5,
        }));
        let chosen = plan_order(&dome, DVec3::Z, usize::MAX, 0.0);
        assert_eq!(chosen.len(), 12);
        assert_eq!(chosen[0], directions[5]);
        assert!(chosen.iter().all(|light| directions.contains(light)));
    }
}
