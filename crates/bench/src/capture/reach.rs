//! Where light can come from: what the stage's limits allow and the camera's body leaves free.

use glam::DVec3;
use rayon::prelude::*;

use super::CaptureError;
use crate::config::BuildError;
use crate::config::RigConfig;
use crate::config::geometry::GeometryConfig;
use crate::device::kinematics::{AxisMap, Kinematics, Mechanism, TwoAxes};
use crate::transport::{CameraShadow, Obstruction};
use crate::units::StageAngles;

/// Candidates stand on whole multiples of this, degrees, so that a person can
/// read and repeat them.
const GRID_DEG: f64 = 2.5;
/// Steps in which the nearest free elevation is looked for, degrees.
const ELEVATION_STEP_DEG: f64 = 0.5;

/// What a stage can reach, and what stands in the light's way there.
#[derive(Clone, Debug, PartialEq)]
pub struct StageReach {
    kinematics: Kinematics,
    /// Where the camera's body is stated: its shadow, and the lamps by which it falls.
    shadow: Option<(CameraShadow, GeometryConfig)>,
}

impl StageReach {
    /// A stage with nothing in its light's way.
    pub fn free(kinematics: Kinematics) -> Self {
        Self {
            kinematics,
            shadow: None,
        }
    }

    /// Of a bench with its camera.
    ///
    /// # Errors
    /// The sample's surface cannot be read.
    pub fn of_rig(config: &RigConfig) -> Result<Self, BuildError> {
        let geometry = &config.geometry;
        let shadow = geometry.camera_shadow()?;
        Ok(Self {
            kinematics: config.stage.kinematics(),
            shadow: shadow.map(|shadow| (shadow, geometry.clone())),
        })
    }

    /// Two rotary axes with these soft limits, degrees.
    pub fn of_angles(azimuth_deg: [f64; 2], elevation_deg: [f64; 2]) -> Self {
        let axis = |[min, max]: [f64; 2]| AxisMap {
            scale: 1.0,
            offset: 0.0,
            min,
            max,
        };
        Self::free(Kinematics::TwoAxes(TwoAxes {
            mechanism: Mechanism::Rotary,
            first: axis(azimuth_deg),
            second: axis(elevation_deg),
            approach: 0.0,
        }))
    }

    /// Whether the soft limits allow it.
    pub fn contains(&self, angles: StageAngles) -> bool {
        self.kinematics.reaches(angles)
    }

    /// What stands in the way of light from there.
    pub fn obstruction(&self, angles: StageAngles) -> Option<Obstruction> {
        let (shadow, geometry) = self.shadow.as_ref()?;
        shadow.obstruction(&geometry.light(angles))
    }

    /// Checks directions against the soft limits and the camera's body.
    ///
    /// # Errors
    /// The first that cannot be reached, else the first that is blocked.
    pub fn check(&self, lights: &[StageAngles]) -> Result<(), CaptureError> {
        if let Some(light) = lights.iter().position(|&angles| !self.contains(angles)) {
            return Err(CaptureError::LightOutOfReach {
                light,
                angles: lights[light],
                limits: self.kinematics.limits(),
            });
        }
        for (light, &angles) in lights.iter().enumerate() {
            if let Some(by) = self.obstruction(angles) {
                return Err(CaptureError::LightBlocked {
                    light,
                    angles,
                    by,
                    free: self.nearest_free(angles),
                });
            }
        }
        Ok(())
    }

    /// The direction nearest to a blocked one that is within reach and free: of fixed lights
    /// one of them, else at the same azimuth.
    fn nearest_free(&self, blocked: StageAngles) -> Option<StageAngles> {
        let is_free = |angles: &StageAngles| self.contains(*angles) && !self.is_blocked(*angles);
        let near = |angles: &StageAngles| blocked.to_light().dot(angles.to_light());
        if let Kinematics::FixedLights(lights) = &self.kinematics {
            let free = lights.directions.iter().copied().filter(is_free);
            return free.max_by(|a, b| near(a).total_cmp(&near(b)));
        }
        let steps = (180.0 / ELEVATION_STEP_DEG) as i64;
        // On the grid of the steps, the nearest first, away from the zenith before towards it.
        let middle = (blocked.elevation_deg / ELEVATION_STEP_DEG).round() as i64;
        let elevations = (0..=steps).flat_map(|step| [middle - step, middle + step]);
        let mut angles = elevations.map(|step| StageAngles {
            elevation_deg: step as f64 * ELEVATION_STEP_DEG,
            ..blocked
        });
        angles.find(is_free)
    }

    /// Directions to choose from, each once, in a fixed order: of axes the grid's points
    /// inside the limits and rotary limits themselves, of fixed lights all of them; without
    /// those that the camera's body blocks.
    pub fn candidates(&self) -> Vec<StageAngles> {
        self.reachable_where(|is_blocked| !is_blocked)
    }

    /// Candidates that the camera's body blocks.
    pub fn blocked(&self) -> Vec<StageAngles> {
        self.reachable_where(|is_blocked| is_blocked)
    }

    fn is_blocked(&self, angles: StageAngles) -> bool {
        let shadow = self.shadow.as_ref();
        shadow.is_some_and(|(shadow, geometry)| shadow.blocks(&geometry.light(angles)))
    }

    fn reachable_where(&self, wanted: impl Fn(bool) -> bool + Sync) -> Vec<StageAngles> {
        let all = self.reachable().into_par_iter();
        all.filter(|&angles| wanted(self.is_blocked(angles)))
            .collect()
    }

    /// Whether the lights stand still, each in its direction.
    pub fn is_fixed(&self) -> bool {
        matches!(self.kinematics, Kinematics::FixedLights(_))
    }

    /// Candidates within reach, blocked or not.
    pub fn reachable(&self) -> Vec<StageAngles> {
        let axes = match &self.kinematics {
            Kinematics::FixedLights(lights) => return lights.directions.clone(),
            Kinematics::TwoAxes(axes) => axes,
        };
        let [azimuth_deg, elevation_deg] = axes.angle_ranges_deg();
        let mut all: Vec<(StageAngles, DVec3)> = Vec::new();
        for elevation_deg in ticks(elevation_deg) {
            for azimuth_deg in near_zero_first(ticks(azimuth_deg)) {
                let angles = StageAngles::new(azimuth_deg, elevation_deg);
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

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::config::BUILT_IN;

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
        let gantry = StageReach::free(Kinematics::TwoAxes(TwoAxes {
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

    fn shipped(name: &str, change: impl Fn(&str) -> String) -> StageReach {
        let (_, text) = BUILT_IN.iter().find(|(known, _)| *known == name).unwrap();
        let config = RigConfig::parse(name, Path::new(""), &change(text)).unwrap();
        StageReach::of_rig(&config).unwrap()
    }

    fn at(azimuth_deg: f64, elevation_deg: f64) -> StageAngles {
        StageAngles::new(azimuth_deg, elevation_deg)
    }

    /// The camera's body takes away what is around its axis, for lamps on an arm and in a
    /// plane above the camera; nothing without a body.
    #[test]
    fn what_the_camera_blocks_is_no_candidate() {
        for (name, body) in [
            ("grbl-arm-v4l2", true),
            ("zaber-gantry-v4l2", true),
            ("simulated", false),
        ] {
            let reach = shipped(name, str::to_owned);
            let (all, free, blocked) = (reach.reachable(), reach.candidates(), reach.blocked());
            assert_eq!(free.len() + blocked.len(), all.len(), "{name}");
            assert_eq!(blocked.is_empty(), !body, "{name}");
            assert!(
                free.len() > all.len() / 2,
                "{name}: {} of {}",
                free.len(),
                all.len()
            );
            for angles in blocked {
                assert!(angles.elevation_deg > 65.0, "{name}: {angles}");
                let refused = reach.check(&[at(0.0, 50.0), angles]).unwrap_err();
                let CaptureError::LightBlocked {
                    light: 1,
                    free: Some(free),
                    ..
                } = refused
                else {
                    panic!("{name}: {refused}");
                };
                assert_eq!(free.azimuth_deg, angles.azimuth_deg);
                assert!(
                    (65.0..angles.elevation_deg).contains(&free.elevation_deg),
                    "{name}: {free}"
                );
                assert!(reach.check(&[free]).is_ok());
            }
        }
    }

    /// Of lights that stand still, another one is named.
    #[test]
    fn a_blocked_light_of_a_dome_has_a_free_one_next_to_it() {
        let dome = shipped("dmx-dome-v4l2", |text| {
            text.replacen("elevation_deg = 60.0", "elevation_deg = 80.0", 1)
        });
        assert_eq!(dome.blocked(), [at(30.0, 80.0)]);
        assert_eq!(dome.candidates().len(), 9);
        let refused = dome.check(&[at(30.0, 80.0)]).unwrap_err().to_string();
        assert!(
            refused.contains("free direction is azimuth 120.000°, elevation 60.000°")
                || refused.contains("free direction is azimuth -60.000°, elevation 60.000°"),
            "{refused}"
        );
        assert!(matches!(
            dome.check(&[at(30.0, 80.0), at(0.0, 10.0)]),
            Err(CaptureError::LightOutOfReach { light: 1, .. })
        ));
    }

    /// A body so wide that nothing is free: no plan, and no direction to name.
    #[test]
    fn a_body_that_blocks_everything_leaves_nothing() {
        let reach = shipped("grbl-arm-v4l2", |text| {
            text.replace(
                "radius_mm = 25.0, length_mm = 220.0",
                "radius_mm = 900.0, length_mm = 9.0, front_mm = 105.0",
            )
        });
        assert_eq!(reach.candidates(), []);
        let refused = reach.check(&[at(0.0, 50.0)]).unwrap_err().to_string();
        assert!(
            refused.contains("no direction near it is free"),
            "{refused}"
        );
    }
}
