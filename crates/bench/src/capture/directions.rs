//! Which light directions to take: a greedy choice that spreads the lights around the sample
//! and over a range of angles to the camera's axis (docs/adr/0035).
//!
//! N + 1 lights are N lights and one more: the first ones of a longer plan are a plan.

use glam::DVec3;

use super::reach::StageReach;
use crate::config::geometry::GeometryConfig;
use crate::config::view::SurfaceSpec;
use crate::geometry::Shape;
use crate::units::StageAngles;

/// The first light's angle to the camera's axis, degrees.
const FIRST_DEG: f64 = 45.0;
/// Angles to the camera's axis that are preferred, degrees: nearer to it highlights repeat
/// what the first lights showed, farther from it little of a concave sample is lit.
const PREFERRED_DEG: [f64; 2] = [15.0, 55.0];
/// The same where the camera is tilted or the sample is convex: what only lights far from the
/// camera show is grazing light, and they reach what the camera sees.
const PREFERRED_AROUND_DEG: [f64; 2] = [30.0, 145.0];
/// Angle to the sample's axis up to which lights are preferred where a tilted camera sees
/// something else than a convex sample, degrees: lower lamps leave most of it in shadow, whose
/// edges tell of its form and pose instead of the material.
const PREFERRED_HIGH_DEG: f64 = 50.0;
/// A camera further from the sample's axis than this counts as tilted, degrees.
const TILTED_DEG: f64 = 30.0;
/// Beyond them a light counts for less, down to [`LEAST_PREFERENCE`], over this, degrees.
const FALL_DEG: f64 = 30.0;
/// What any direction counts for at least, of 1.
const LEAST_PREFERENCE: f64 = 0.3;
/// How much more a difference of the angle to the axis counts than one around it, as squares:
/// around the axis a sample of revolution shows the same angles of incidence once more.
const POLAR_WEIGHT: f64 = 2.0;

/// What a plan is to show of a sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aim {
    /// Unit direction from the sample to the camera in the stage's frame.
    pub coaxial: DVec3,
    /// Angles to the camera's axis that are preferred, degrees.
    preferred_deg: [f64; 2],
    /// The sample's axis in the stage's frame, where lights near it are preferred.
    axis: Option<DVec3>,
}

impl Aim {
    /// At a concave sample, by a camera on its axis in this direction.
    pub fn along(coaxial: DVec3) -> Self {
        Self {
            coaxial,
            preferred_deg: PREFERRED_DEG,
            axis: None,
        }
    }

    /// At a convex sample that the camera sees from this direction.
    pub fn around(coaxial: DVec3) -> Self {
        Self {
            coaxial,
            preferred_deg: PREFERRED_AROUND_DEG,
            axis: None,
        }
    }

    /// On a bench.
    pub fn of(geometry: &GeometryConfig) -> Self {
        let to_camera = geometry.camera.sample_from_camera.direction(-DVec3::Z);
        let tilt_deg = to_camera.angle_between(DVec3::Z).to_degrees();
        let is_convex = matches!(
            geometry.sample.surface,
            SurfaceSpec::Shape(Shape::Sphere { .. } | Shape::Cap { .. })
        );
        let coaxial = geometry.coaxial();
        match is_convex {
            true => Self::around(coaxial),
            false if tilt_deg > TILTED_DEG => Self {
                axis: Some(geometry.sample_from_stage.inverse().direction(DVec3::Z)),
                ..Self::around(coaxial)
            },
            false => Self::along(coaxial),
        }
    }

    /// How much the gap around a direction counts, up to 1; `polar_rad` is its angle to the
    /// camera's axis.
    fn preference(&self, direction: DVec3, polar_rad: f64) -> f64 {
        let outside = |angle_deg: f64, [near_deg, far_deg]: [f64; 2]| {
            let outside_deg = (near_deg - angle_deg).max(angle_deg - far_deg).max(0.0);
            (1.0 - outside_deg / FALL_DEG).max(LEAST_PREFERENCE)
        };
        let of_axis = self.axis.map_or(1.0, |axis| {
            let angle_deg = direction.angle_between(axis).to_degrees();
            outside(angle_deg, [0.0, PREFERRED_HIGH_DEG])
        });
        outside(polar_rad.to_degrees(), self.preferred_deg) * of_axis
    }
}

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
}

/// Directions in the order in which they should be taken: first the one whose angle to the
/// camera's axis is nearest to `FIRST_DEG`, then always the one with the largest gap to
/// those before, where the gap counts by preference. Ends after `count` directions, or where every
/// other one is nearer than `min_spacing_deg` to one chosen before.
pub fn plan_order(
    reach: &StageReach,
    aim: Aim,
    count: usize,
    min_spacing_deg: f64,
) -> Vec<StageAngles> {
    let smallest_chord_sq = (2.0 * (0.5 * min_spacing_deg.to_radians()).sin()).powi(2);
    let candidates = reach.candidates().into_iter();
    let mut candidates: Vec<Candidate> = candidates
        .map(|angles| Candidate::new(angles, aim.coaxial))
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
        let counts = |c: &Candidate| c.gap * aim.preference(c.direction, c.polar_rad);
        let largest = candidates.iter().map(counts);
        let largest = largest.fold(0.0, f64::max);
        // Many are equally far from their nearest light; of those the one with the least
        // energy is also far from the others.
        next = first_best(candidates.iter().map(|c| match counts(c) > largest - 1e-9 {
            true => -c.energy,
            false => f64::NEG_INFINITY,
        }));
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
    use crate::config::{BUILT_IN, RigConfig};
    use crate::device::kinematics::{FixedLights, Kinematics};
    use std::path::Path;

    fn reach() -> StageReach {
        StageReach::of_angles([-170.0, 170.0], [12.0, 88.0])
    }

    #[test]
    fn n_lights_begin_n_plus_one() {
        let ten = plan_order(&reach(), Aim::along(DVec3::Z), 10, 0.0);
        assert_eq!(ten.len(), 10);
        assert_eq!((ten[0].azimuth_deg, ten[0].elevation_deg), (0.0, 45.0));
        for n in 1..10 {
            assert_eq!(plan_order(&reach(), Aim::along(DVec3::Z), n, 0.0), ten[..n]);
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
            let lights = plan_order(&reach, Aim::along(coaxial), 8, 0.0);
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

    /// The shipped benches with a tilted camera: the first light at 45° from it, and among four
    /// some far beyond 90°, down to what the stage reaches, none in the camera's way.
    #[test]
    fn lights_go_around_what_a_tilted_camera_sees() {
        for (name, farthest_deg) in [("simulated-tilted", 100.0), ("simulated-ball", 130.0)] {
            let (_, text) = BUILT_IN.iter().find(|(known, _)| *known == name).unwrap();
            let rig = RigConfig::parse(name, Path::new(""), text).unwrap();
            let reach = StageReach::of_rig(&rig).unwrap();
            let aim = Aim::of(&rig.geometry);
            let four = plan_order(&reach, aim, 4, 0.0);
            reach.check(&four).unwrap();
            let polar = |angles: &StageAngles| angles.to_light().angle_between(aim.coaxial);
            let polar_deg: Vec<f64> = four.iter().map(|a| polar(a).to_degrees()).collect();
            println!("{name}: {four:?} {polar_deg:?}");
            assert!((polar_deg[0] - 45.0).abs() < 1.5, "{name}: {polar_deg:?}");
            let most = polar_deg.iter().copied().fold(0.0, f64::max);
            assert!(most > farthest_deg, "{name}: {polar_deg:?}");
        }
    }

    /// Outside the preferred part there is still a best choice.
    #[test]
    fn lights_that_only_graze_or_only_face_the_camera_go_around() {
        for elevation_deg in [[5.0, 5.0], [80.0, 80.0]] {
            let reach = StageReach::of_angles([-180.0, 180.0], elevation_deg);
            let four = plan_order(&reach, Aim::along(DVec3::Z), 4, 0.0);
            let azimuths: Vec<f64> = four.iter().map(|angles| angles.azimuth_deg).collect();
            assert_eq!(azimuths, [0.0, 180.0, 90.0, -90.0]);
        }
    }

    #[test]
    fn the_spacing_bounds_the_number() {
        let all = plan_order(&reach(), Aim::along(DVec3::Z), usize::MAX, 20.0);
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
        let chosen = plan_order(&dome, Aim::along(DVec3::Z), usize::MAX, 0.0);
        assert_eq!(chosen.len(), 12);
        assert_eq!(chosen[0], directions[5]);
        assert!(chosen.iter().all(|light| directions.contains(light)));
    }
}
