//! One lamp on two axes.

use glam::DVec3;

use super::axis::{AxisMap, LIMIT_SLACK};
use crate::units::{Seconds, StageAngles};

/// What the two axes do with the lamp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mechanism {
    /// Two rotary axes that cross in the stage's centre. Coordinates: azimuth
    /// and elevation, degrees; beyond 90° the elevation is past the zenith.
    Rotary,
    /// A turntable carries an arc on which the lamp's carriage climbs.
    /// Coordinates: the turntable's azimuth and the carriage's angle at the
    /// arc's own centre, degrees.
    Arc {
        /// Radius of the lamp's way, mm; > 0.
        radius_mm: f64,
        /// Height of the arc's centre above the stage's, mm; less than the
        /// radius in magnitude.
        centre_height_mm: f64,
    },
    /// A gantry moves the lamp in a plane above the stage. Coordinates: the
    /// lamp's x and y, mm.
    Gantry {
        /// Height of the lamp above the stage's centre, mm; > 0.
        height_mm: f64,
    },
}

/// Where both axes stand or shall stand, as their coordinates.
///
/// On rotary axes the same light direction belongs to several poses: a full
/// turn of the azimuth further, or half a turn with the elevation beyond the
/// zenith.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose(pub [f64; 2]);

/// The two axes of a stage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TwoAxes {
    /// What they do with the lamp.
    pub mechanism: Mechanism,
    /// First axis: azimuth, turntable, or x.
    pub first: AxisMap,
    /// Second axis: elevation, carriage, or y.
    pub second: AxisMap,
    /// Every pose is approached from this far below it on each axis, degrees or
    /// mm; more than the backlash, 0 turns it off. Where the lower limit leaves no
    /// room for that, always from above: also from a home position beyond the limit.
    pub approach: f64,
}

impl TwoAxes {
    /// Rotary axes of which nothing is known: coordinates count as degrees, without limits.
    pub fn unlimited() -> Self {
        let axis = AxisMap {
            scale: 1.0,
            offset: 0.0,
            min: f64::NEG_INFINITY,
            max: f64::INFINITY,
        };
        Self {
            mechanism: Mechanism::Rotary,
            first: axis,
            second: axis,
            approach: 0.0,
        }
    }

    /// From the lower limit of both axes to the upper.
    pub fn whole_travel(&self) -> [Pose; 2] {
        [
            Pose([self.first.min, self.second.min]),
            Pose([self.first.max, self.second.max]),
        ]
    }

    /// Both axes.
    pub fn axes(&self) -> [&AxisMap; 2] {
        [&self.first, &self.second]
    }

    /// The pose of a target: as it is written if the limits allow, else another
    /// turn of the azimuth, else beyond the zenith. The same target always has
    /// the same pose, wherever the stage stands, so that its errors repeat.
    pub fn solve(&self, target: StageAngles) -> Option<Pose> {
        self.poses(target)
            .into_iter()
            .find(|Pose(pose)| self.first.reaches(pose[0]) && self.second.reaches(pose[1]))
            .map(|Pose(pose)| Pose([self.first.clamped(pose[0]), self.second.clamped(pose[1])]))
    }

    /// Direction from the stage's centre to the lamp, and its distance in mm
    /// where the mechanism fixes it.
    pub fn lamp(&self, pose: Pose) -> (DVec3, Option<f64>) {
        let direction = self.angles(pose).to_light();
        let distance_mm = match self.mechanism {
            Mechanism::Rotary => None,
            Mechanism::Arc {
                radius_mm,
                centre_height_mm,
            } => {
                let (sin, cos) = pose.0[1].to_radians().sin_cos();
                Some((radius_mm * cos).hypot(centre_height_mm + radius_mm * sin))
            }
            Mechanism::Gantry { height_mm } => {
                let [x_mm, y_mm] = pose.0;
                Some(DVec3::new(x_mm, y_mm, height_mm).length())
            }
        };
        (direction, distance_mm)
    }

    /// The light's angles in a pose, as the axes have them: turns are counted,
    /// and an elevation above 90° is beyond the zenith.
    pub fn angles(&self, Pose([first, second]): Pose) -> StageAngles {
        match self.mechanism {
            Mechanism::Rotary => StageAngles::new(first, second),
            Mechanism::Arc {
                radius_mm,
                centre_height_mm,
            } => {
                let (sin, cos) = second.to_radians().sin_cos();
                let height_mm = centre_height_mm + radius_mm * sin;
                StageAngles::new(first, height_mm.atan2(radius_mm * cos).to_degrees())
            }
            Mechanism::Gantry { height_mm } => {
                StageAngles::from_direction(DVec3::new(first, second, height_mm))
            }
        }
    }

    /// Poses of a target, the preferred one first, limits aside; at most two
    /// turns from its own azimuth.
    fn poses(&self, target: StageAngles) -> Vec<Pose> {
        if let Mechanism::Gantry { height_mm } = self.mechanism {
            let light = target.to_light();
            let above = light.z > 0.0;
            let pose = above.then(|| Pose([light.x, light.y].map(|d| height_mm * d / light.z)));
            return pose.into_iter().collect();
        }
        let StageAngles {
            azimuth_deg,
            elevation_deg,
        } = target;
        [
            (azimuth_deg, elevation_deg),
            (azimuth_deg + 180.0, 180.0 - elevation_deg),
        ]
        .into_iter()
        .flat_map(|(azimuth_deg, elevation_deg)| {
            let second = self.second_of(elevation_deg);
            [0.0, -360.0, 360.0, -720.0, 720.0]
                .map(|turn_deg| Pose([azimuth_deg + turn_deg, second]))
        })
        .collect()
    }

    /// The second rotary axis' coordinate for an elevation.
    fn second_of(&self, elevation_deg: f64) -> f64 {
        let Mechanism::Arc {
            radius_mm,
            centre_height_mm,
        } = self.mechanism
        else {
            return elevation_deg;
        };
        // Where the ray from the stage's centre meets the circle.
        let (sin, cos) = elevation_deg.to_radians().sin_cos();
        let across_mm = centre_height_mm * cos;
        let distance_mm =
            centre_height_mm * sin + (radius_mm * radius_mm - across_mm * across_mm).sqrt();
        let height_mm = distance_mm * sin - centre_height_mm;
        let angle_deg = height_mm.atan2(distance_mm * cos).to_degrees();
        // The arc tangent's turn is that of the elevation.
        angle_deg + 360.0 * ((elevation_deg - angle_deg) / 360.0).round()
    }

    /// Azimuths and elevations that contain all that is reached, degrees.
    pub fn angle_ranges_deg(&self) -> [[f64; 2]; 2] {
        let [first, second] = self.axes().map(|map| [map.min, map.max]);
        match self.mechanism {
            Mechanism::Rotary => [first, second],
            Mechanism::Arc { .. } => {
                let elevation_deg = |second| self.angles(Pose([first[0], second])).elevation_deg;
                [first, second.map(elevation_deg)]
            }
            Mechanism::Gantry { .. } => {
                let corners = first.map(|x| second.map(|y| self.angles(Pose([x, y]))));
                let lowest_deg = corners
                    .as_flattened()
                    .iter()
                    .map(|angles| angles.elevation_deg);
                [[-180.0, 180.0], [lowest_deg.fold(90.0, f64::min), 90.0]]
            }
        }
    }

    /// How far two poses are apart: the larger difference of the axes, degrees;
    /// of a gantry the largest angle that it can make at the stage's centre.
    pub fn distance_deg(&self, a: Pose, b: Pose) -> f64 {
        let differences = [(a.0[0] - b.0[0]).abs(), (a.0[1] - b.0[1]).abs()];
        match self.mechanism {
            Mechanism::Gantry { height_mm } => {
                (differences[0].hypot(differences[1]) / height_mm).to_degrees()
            }
            _ => differences[0].max(differences[1]),
        }
    }

    /// The limits as text.
    pub fn limits(&self) -> String {
        let (names, unit) = match self.mechanism {
            Mechanism::Rotary => (["azimuth", "elevation"], "°"),
            Mechanism::Arc { .. } => (["turntable", "carriage"], "°"),
            Mechanism::Gantry { .. } => (["lamp's x", "y"], " mm"),
        };
        let range = |map: &AxisMap| format!("{}{unit} to {}{unit}", map.min, map.max);
        format!(
            "{} {}, {} {}",
            names[0],
            range(&self.first),
            names[1],
            range(&self.second)
        )
    }

    /// For estimates: the degrees per second by which the light's direction
    /// turns at least, given each axis' speed in controller units per second,
    /// and the time of the longest travel.
    pub fn pace(&self, units_per_s: [f64; 2]) -> (f64, Seconds) {
        let degrees_per_coordinate = match self.mechanism {
            Mechanism::Gantry { height_mm } => (1.0 / height_mm).to_degrees(),
            _ => 1.0,
        };
        let mut slowest_deg_s = f64::INFINITY;
        let mut longest_s: f64 = 0.0;
        for (map, per_s) in self.axes().into_iter().zip(units_per_s) {
            let speed = per_s / map.scale.abs();
            slowest_deg_s = slowest_deg_s.min(speed * degrees_per_coordinate);
            longest_s = longest_s.max((map.max - map.min) / speed);
        }
        (slowest_deg_s, Seconds(longest_s))
    }

    /// Where to go first so that each axis reaches `target` from the side that it always
    /// does; `None` if they already do from `from`.
    pub fn approach(&self, from: Pose, target: Pose) -> Option<Pose> {
        let start_of = |map: &AxisMap, from: f64, target: f64| {
            let below = target - self.approach;
            if below >= map.min {
                below.min(from)
            } else {
                (target + self.approach).min(map.max).max(from)
            }
        };
        let start = [
            start_of(&self.first, from.0[0], target.0[0]),
            start_of(&self.second, from.0[1], target.0[1]),
        ];
        let way = (start[0] - from.0[0])
            .abs()
            .max((start[1] - from.0[1]).abs());
        (self.approach > 0.0 && way > LIMIT_SLACK).then_some(Pose(start))
    }

    /// The angles of a pose near `target`, written as `target` writes them:
    /// the same turn, the same side of the zenith.
    pub fn angles_like(&self, target: StageAngles, wanted: Pose, reached: Pose) -> StageAngles {
        let (wanted, reached) = (self.angles(wanted), self.angles(reached));
        let beyond_zenith = (wanted.elevation_deg - target.elevation_deg).abs() > 1e-4;
        let sign = if beyond_zenith { -1.0 } else { 1.0 };
        let mut turned_deg = reached.azimuth_deg - wanted.azimuth_deg;
        if matches!(self.mechanism, Mechanism::Gantry { .. }) {
            turned_deg -= 360.0 * (turned_deg / 360.0).round();
        }
        StageAngles {
            azimuth_deg: target.azimuth_deg + turned_deg,
            elevation_deg: target.elevation_deg
                + sign * (reached.elevation_deg - wanted.elevation_deg),
        }
    }
}

#[cfg(test)]
mod tests;
