//! From stage angles to axis positions and back, within the limits.

use super::DeviceError;
use crate::units::StageAngles;
use serde::{Deserialize, Serialize};

/// How one stage angle maps to an axis of the controller:
/// position = (angle − `offset_deg`) · `scale`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AxisMap {
    /// The axis' letter: X, Y, Z, A, B or C.
    pub axis: char,
    /// Axis units per degree; not 0, negative where the axis turns the other way.
    pub scale: f64,
    /// The angle at axis position 0, degrees.
    pub offset_deg: f64,
    /// Smallest angle, degrees.
    pub min_deg: f64,
    /// Largest angle, degrees.
    pub max_deg: f64,
}

/// Angles this close to a limit count as within it, degrees: less than any
/// stage resolves, more than the rounding of a full turn.
const LIMIT_SLACK_DEG: f64 = 1e-6;

impl AxisMap {
    /// The axis position of an angle.
    pub fn position(&self, angle_deg: f64) -> f64 {
        (angle_deg - self.offset_deg) * self.scale
    }

    /// The angle of an axis position, degrees.
    pub fn angle_deg(&self, position: f64) -> f64 {
        position / self.scale + self.offset_deg
    }

    /// Whether an angle is within the limits; never for a non-finite one.
    pub fn reaches(&self, angle_deg: f64) -> bool {
        angle_deg >= self.min_deg - LIMIT_SLACK_DEG && angle_deg <= self.max_deg + LIMIT_SLACK_DEG
    }

    /// Place of the axis in a position report, X first.
    pub fn index(&self) -> Option<usize> {
        "XYZABC".find(self.axis)
    }
}

/// Where both axes stand or shall stand, as angles of the axes themselves.
///
/// The same light direction belongs to several poses: a full turn of the
/// azimuth further, or half a turn with the elevation beyond the zenith.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Angle of the azimuth axis, degrees.
    pub azimuth_deg: f64,
    /// Angle of the elevation axis, degrees; above 90 it is beyond the zenith.
    pub elevation_deg: f64,
}

impl Pose {
    /// Largest difference of the two axes, degrees.
    pub fn distance_deg(self, other: Pose) -> f64 {
        let azimuth_deg = (self.azimuth_deg - other.azimuth_deg).abs();
        azimuth_deg.max((self.elevation_deg - other.elevation_deg).abs())
    }
}

/// The two axes of a stage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kinematics {
    /// The axis that turns the lamp about the stage's +z.
    pub azimuth: AxisMap,
    /// The axis that raises the lamp.
    pub elevation: AxisMap,
    /// Every pose is approached from this far below it on each axis, degrees;
    /// more than the backlash, 0 turns it off. Near a lower limit the approach
    /// is as long as the limit leaves room.
    pub approach_deg: f64,
}

impl Kinematics {
    /// Whether some pose within the limits has this direction. `device` is what
    /// the error calls the stage.
    pub fn reach(&self, device: &str, target: StageAngles) -> Result<(), DeviceError> {
        self.solve(device, target).map(drop)
    }

    /// The pose of a target: as it is written if the limits allow, else another
    /// turn of the azimuth, else beyond the zenith. The same target always has
    /// the same pose, wherever the stage stands, so that its errors repeat.
    pub fn solve(&self, device: &str, target: StageAngles) -> Result<Pose, DeviceError> {
        self.poses(target)
            .next()
            .ok_or_else(|| DeviceError::OutOfReach {
                device: device.to_owned(),
                target,
                limits: self.limits(),
            })
    }

    /// The limits as text, degrees.
    pub fn limits(&self) -> String {
        let range = |map: &AxisMap| format!("{}° to {}°", map.min_deg, map.max_deg);
        format!(
            "azimuth {}, elevation {}",
            range(&self.azimuth),
            range(&self.elevation)
        )
    }

    /// Poses of a target within the limits, at most two turns from its own azimuth.
    fn poses(&self, target: StageAngles) -> impl Iterator<Item = Pose> {
        let StageAngles {
            azimuth_deg,
            elevation_deg,
        } = target;
        let limits = *self;
        [
            (azimuth_deg, elevation_deg),
            (azimuth_deg + 180.0, 180.0 - elevation_deg),
        ]
        .into_iter()
        .flat_map(|(azimuth_deg, elevation_deg)| {
            [0.0, -360.0, 360.0, -720.0, 720.0].map(|turn_deg| Pose {
                azimuth_deg: azimuth_deg + turn_deg,
                elevation_deg,
            })
        })
        .filter(move |pose| {
            limits.azimuth.reaches(pose.azimuth_deg) && limits.elevation.reaches(pose.elevation_deg)
        })
        .map(move |pose| Pose {
            azimuth_deg: pose
                .azimuth_deg
                .max(limits.azimuth.min_deg)
                .min(limits.azimuth.max_deg),
            elevation_deg: pose
                .elevation_deg
                .max(limits.elevation.min_deg)
                .min(limits.elevation.max_deg),
        })
    }

    /// Where to go first so that both axes reach `target` upwards; `None` if
    /// they already do from `from`.
    pub fn approach(&self, from: Pose, target: Pose) -> Option<Pose> {
        let below = |map: &AxisMap, from_deg: f64, target_deg: f64| {
            let start_deg = (target_deg - self.approach_deg).max(map.min_deg);
            start_deg.min(from_deg)
        };
        let start = Pose {
            azimuth_deg: below(&self.azimuth, from.azimuth_deg, target.azimuth_deg),
            elevation_deg: below(&self.elevation, from.elevation_deg, target.elevation_deg),
        };
        (self.approach_deg > 0.0 && start.distance_deg(from) > LIMIT_SLACK_DEG).then_some(start)
    }

    /// The angles of a pose near `target`, written as `target` writes them:
    /// the same turn, the same side of the zenith.
    pub fn angles_like(&self, target: StageAngles, wanted: Pose, reached: Pose) -> StageAngles {
        let beyond_zenith = (wanted.elevation_deg - target.elevation_deg).abs() > LIMIT_SLACK_DEG;
        let sign = if beyond_zenith { -1.0 } else { 1.0 };
        StageAngles {
            azimuth_deg: target.azimuth_deg + (reached.azimuth_deg - wanted.azimuth_deg),
            elevation_deg: target.elevation_deg
                + sign * (reached.elevation_deg - wanted.elevation_deg),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn arm() -> Kinematics {
        Kinematics {
            azimuth: AxisMap {
                axis: 'X',
                scale: 1.0,
                offset_deg: 0.0,
                min_deg: -180.0,
                max_deg: 180.0,
            },
            elevation: AxisMap {
                axis: 'Y',
                scale: -2.0,
                offset_deg: 90.0,
                min_deg: 5.0,
                max_deg: 90.0,
            },
            approach_deg: 2.0,
        }
    }

    fn angles(azimuth_deg: f64, elevation_deg: f64) -> StageAngles {
        StageAngles {
            azimuth_deg,
            elevation_deg,
        }
    }

    #[test]
    fn limits_are_named_when_a_target_is_outside() {
        let error = arm().reach("arm", angles(10.0, 3.0)).unwrap_err();
        assert_eq!(
            error.to_string(),
            "arm: azimuth 10.000°, elevation 3.000° is outside the limits \
             (azimuth -180° to 180°, elevation 5° to 90°)"
        );
        for (azimuth_deg, elevation_deg) in [
            (f64::NAN, 45.0),
            (0.0, f64::INFINITY),
            (0.0, -5.0),
            (0.0, 176.0),
        ] {
            let target = angles(azimuth_deg, elevation_deg);
            assert!(arm().reach("arm", target).is_err(), "{target}");
        }
    }

    #[test]
    fn another_turn_or_the_other_side_of_the_zenith_is_found() {
        let arm = arm();
        let pose = arm.solve("arm", angles(270.0, 45.0)).unwrap();
        assert_eq!((pose.azimuth_deg, pose.elevation_deg), (-90.0, 45.0));
        let pose = arm.solve("arm", angles(30.0, 135.0)).unwrap();
        assert_eq!((pose.azimuth_deg, pose.elevation_deg), (-150.0, 45.0));
        let half = Kinematics {
            azimuth: AxisMap {
                min_deg: 0.0,
                max_deg: 180.0,
                ..arm.azimuth
            },
            elevation: AxisMap {
                min_deg: 0.0,
                max_deg: 180.0,
                ..arm.elevation
            },
            ..arm
        };
        let pose = half.solve("arm", angles(-60.0, 20.0)).unwrap();
        assert_eq!((pose.azimuth_deg, pose.elevation_deg), (120.0, 160.0));
    }

    #[test]
    fn a_target_within_the_limits_is_taken_as_it_is_written() {
        for (azimuth_deg, elevation_deg) in [(180.0, 45.0), (-180.0, 45.0), (0.0, 90.0)] {
            let pose = arm().solve("arm", angles(azimuth_deg, elevation_deg));
            let expected = Pose {
                azimuth_deg,
                elevation_deg,
            };
            assert_eq!(pose.unwrap(), expected);
        }
    }

    #[test]
    fn approach_comes_from_below_and_stays_within_the_limits() {
        let pose = |azimuth_deg, elevation_deg| Pose {
            azimuth_deg,
            elevation_deg,
        };
        let arm = arm();
        let start = |from, to| arm.approach(from, to);
        assert_eq!(
            start(pose(50.0, 50.0), pose(10.0, 20.0)),
            Some(pose(8.0, 18.0))
        );
        assert_eq!(start(pose(0.0, 6.0), pose(10.0, 20.0)), None);
        assert_eq!(
            start(pose(0.0, 50.0), pose(10.0, 20.0)),
            Some(pose(0.0, 18.0))
        );
        assert_eq!(
            start(pose(0.0, 50.0), pose(-180.0, 6.0)),
            Some(pose(-180.0, 5.0))
        );
        let straight = Kinematics {
            approach_deg: 0.0,
            ..arm
        };
        assert_eq!(straight.approach(pose(50.0, 50.0), pose(0.0, 20.0)), None);
    }

    proptest! {
        #[test]
        fn positions_and_angles_are_inverse(
            angle_deg in -360.0..360.0f64,
            scale in prop_oneof![-100.0..-0.01f64, 0.01..100.0f64],
            offset_deg in -360.0..360.0f64,
        ) {
            let map = AxisMap { axis: 'X', scale, offset_deg, min_deg: -360.0, max_deg: 360.0 };
            prop_assert!((map.angle_deg(map.position(angle_deg)) - angle_deg).abs() < 1e-9);
        }

        /// Whatever pose is chosen, it is within the limits and has the target's direction.
        #[test]
        fn a_pose_points_where_the_target_does(
            azimuth_deg in -720.0..720.0f64,
            elevation_deg in -90.0..270.0f64,
        ) {
            let arm = arm();
            let target = angles(azimuth_deg, elevation_deg);
            match arm.solve("arm", target) {
                Ok(pose) => {
                    prop_assert!(arm.azimuth.reaches(pose.azimuth_deg));
                    prop_assert!(arm.elevation.reaches(pose.elevation_deg));
                    let there = angles(pose.azimuth_deg, pose.elevation_deg);
                    prop_assert!((there.to_light() - target.to_light()).length() < 1e-6);
                    let back = arm.angles_like(target, pose, pose);
                    prop_assert!((back.to_light() - target.to_light()).length() < 1e-12);
                }
                Err(_) => {
                    // The azimuth has a full turn, so only the height can be out of reach.
                    let height_deg = target.to_light().z.asin().to_degrees();
                    prop_assert!(height_deg < 5.0 + 1e-4);
                }
            }
        }

        #[test]
        fn an_approach_is_followed_by_a_move_up(
            from in (-180.0..180.0f64, 5.0..90.0f64),
            to in (-178.0..180.0f64, 7.0..90.0f64),
        ) {
            let arm = arm();
            let from = Pose { azimuth_deg: from.0, elevation_deg: from.1 };
            let to = Pose { azimuth_deg: to.0, elevation_deg: to.1 };
            let start = arm.approach(from, to).unwrap_or(from);
            prop_assert!(to.azimuth_deg - start.azimuth_deg >= 2.0 - 1e-5);
            prop_assert!(to.elevation_deg - start.elevation_deg >= 2.0 - 1e-5);
            prop_assert!(arm.azimuth.reaches(start.azimuth_deg));
            prop_assert!(arm.elevation.reaches(start.elevation_deg));
        }
    }
}
