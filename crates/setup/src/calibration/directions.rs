//! The record of the directions of a bench's lights, and the geometry of a rig file with it.

use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

use super::mirror_sphere::light::FoundLight;
use super::record::{BadValue, Kind, LightsValues, Measured, Values, must, within};
use super::stage_directions::{StageFit, offset};
use crate::bench_priors::BenchPriors;
use crate::config::geometry::GeometryConfig;
use crate::transport::falloff::Falloff;
use crate::transport::{Light, Scene};
use crate::units::StageAngles;

/// Directions of lights, measured with mirror spheres. Directions are in the sample's
/// frame by the camera's pose in the rig file, and seen from the stage's centre.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DirectionsValues {
    /// Standard deviation of a light about this record's, each of its two angles,
    /// independent between lights, degrees.
    pub light_std_deg: f64,
    /// Standard uncertainty that all lights share, as a turn about each axis, degrees.
    pub common_std_deg: f64,
    /// Distance of the lamp from the stage's centre, where two spheres gave it, millimetres.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub distance_mm: Option<Measured>,
    /// How the stage stands, where it moves its lamp.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub stage: Option<StagePose>,
    /// Every light that was measured.
    pub lights: Vec<LightDirection>,
}

/// How a stage stands.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StagePose {
    /// Rotation vector from stage to sample, degrees, in place of the rig file's
    /// `geometry.sample_from_stage.rotation_deg`.
    pub rotation_deg: [f64; 3],
    /// To be added to the elevations that the stage reports, degrees; 0 for a stage whose
    /// second axis is no elevation.
    pub elevation_offset_deg: f64,
    /// Covariance of a further turn about the sample's x, y and z, and of the offset, deg².
    pub covariance_deg2: [[f64; 4]; 4],
    /// Standard deviation of a light about this pose, each of its two angles, degrees.
    pub scatter_deg: f64,
}

/// One light.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LightDirection {
    /// Azimuth and elevation as the stage or the rig file has them, degrees.
    pub stage_deg: [f64; 2],
    /// Unit vector towards the light, sample frame.
    pub to_light: [f64; 3],
    /// Covariance towards larger azimuth and larger elevation about the sample's z, deg².
    pub covariance_deg2: [[f64; 2]; 2],
}

impl Values for DirectionsValues {
    const KIND: Kind = Kind::Directions;

    fn check(&self) -> Result<(), BadValue> {
        within("light_std_deg", self.light_std_deg, 0.0, 10.0)?;
        within("common_std_deg", self.common_std_deg, 0.0, 10.0)?;
        if let Some(Measured { value, std }) = self.distance_mm {
            let possible = value > 0.0 && std >= 0.0 && value.is_finite();
            let allowed = "above 0, with an uncertainty of at least 0";
            must(possible, "distance_mm", value, allowed)?;
        }
        if let Some(stage) = &self.stage {
            let turned = DVec3::from_array(stage.rotation_deg).length();
            let possible = turned <= 360.0 && stage.elevation_offset_deg.abs() <= 90.0;
            let allowed = "a turn of at most 360 and an offset of at most 90";
            must(possible, "stage.rotation_deg", turned, allowed)?;
        }
        must(!self.lights.is_empty(), "lights", "empty", "at least one")?;
        for light in &self.lights {
            let length = DVec3::from_array(light.to_light).length();
            let is_unit = (0.999_999..=1.000_001).contains(&length);
            let value = format!("of length {length}");
            must(is_unit, "lights.to_light", value, "of length 1")?;
        }
        Ok(())
    }
}

impl DirectionsValues {
    /// What the lights and the stage were found to be. `distance_mm` where two spheres
    /// gave it.
    pub fn new(
        angles: &[StageAngles],
        found: &[FoundLight],
        stage: Option<&StageFit>,
        distance_mm: Option<Measured>,
    ) -> Self {
        let deg2 = 1f64.to_degrees().powi(2);
        let lights = angles.iter().zip(found).map(|(angles, found)| {
            let covariance = found.covariance() * deg2;
            LightDirection {
                stage_deg: [angles.azimuth_deg, angles.elevation_deg],
                to_light: found.to_light.to_array(),
                covariance_deg2: [0, 1].map(|i| [0, 1].map(|j| covariance[(i, j)])),
            }
        });
        let count = found.len().max(1) as f64;
        let own = found.iter().map(|f| f.own.trace()).sum::<f64>() / (2.0 * count);
        let shared = found.iter().map(|f| f.covariance().trace() - f.own.trace());
        let shared = shared.sum::<f64>() / (2.0 * count);
        let (light_rad, common_rad) = match stage {
            None => (own.max(0.0).sqrt(), shared.max(0.0).sqrt()),
            Some(stage) => {
                let turn = stage.covariance.fixed_view::<3, 3>(0, 0).trace() / 3.0;
                let offset = stage.covariance[(3, 3)];
                (stage.scatter_rad, (turn + offset / 3.0).max(0.0).sqrt())
            }
        };
        Self {
            // A prior of exactly 0 would mean that a light is known for certain.
            light_std_deg: light_rad.to_degrees().max(1e-3),
            common_std_deg: common_rad.to_degrees(),
            distance_mm,
            stage: stage.map(|stage| StagePose {
                rotation_deg: stage
                    .sample_from_stage
                    .to_scaled_axis()
                    .to_array()
                    .map(f64::to_degrees),
                elevation_offset_deg: stage.elevation_offset_rad.to_degrees(),
                covariance_deg2: [0, 1, 2, 3]
                    .map(|i| [0, 1, 2, 3].map(|j| stage.covariance[(i, j)] * deg2)),
                scatter_deg: stage.scatter_rad.to_degrees(),
            }),
            lights: lights.collect(),
        }
    }

    /// Puts the lights where they were measured: turns the stage, or moves each of fixed
    /// lights to its measured direction, and takes over the distance. `angles` of fixed
    /// lights that were not measured stay; their number is returned.
    pub fn apply(&self, geometry: &mut GeometryConfig, angles: &mut [StageAngles]) -> usize {
        if geometry.light.mechanism.is_none()
            && let Some(distance) = self.distance_mm
        {
            geometry.light.distance_mm = Some(distance.value);
        }
        if let Some(stage) = &self.stage {
            let vector = DVec3::from_array(stage.rotation_deg.map(f64::to_radians));
            geometry.sample_from_stage.rotation = DQuat::from_scaled_axis(vector);
            for angles in angles {
                *angles = offset(*angles, stage.elevation_offset_deg.to_radians());
            }
            return 0;
        }
        let stage_from_sample = geometry.sample_from_stage.inverse();
        let mut unmeasured = 0;
        for angles in angles {
            let here = angles.to_light();
            let measured = self.lights.iter().find(|light| {
                let there = StageAngles::new(light.stage_deg[0], light.stage_deg[1]);
                there.to_light().angle_between(here).to_degrees() < SAME_LIGHT_DEG
            });
            match measured {
                Some(light) => {
                    let direction = stage_from_sample.direction(DVec3::from_array(light.to_light));
                    *angles = StageAngles::from_direction(direction);
                }
                None => unmeasured += 1,
            }
        }
        unmeasured
    }

    /// Makes a fit's priors what this record knows.
    pub fn inform(&self, priors: &mut BenchPriors) {
        priors.light_rad = self.light_std_deg.to_radians();
        priors.stage_rad = self.common_std_deg.to_radians();
    }
}

/// Two fixed lights are further apart than this.
const SAME_LIGHT_DEG: f64 = 0.05;

impl LightsValues {
    /// Puts the measured irradiance into a rig's geometry.
    pub fn apply(&self, geometry: &mut GeometryConfig) {
        geometry.light.irradiance_w_m2 = self.irradiance_w_m2.map(|m| m.value);
    }

    /// Makes the scale common to all lights, in a fit's priors, as uncertain as the
    /// irradiance is.
    pub fn inform(&self, priors: &mut BenchPriors) {
        let relative = self.irradiance_w_m2.map(|m| m.std / m.value);
        priors.common_intensity = relative.into_iter().fold(0.0, f64::max);
    }

    /// Makes the lights of a scene, which stand at `angles`, as bright against each other
    /// and as uneven as they were measured, and a fit's priors as uncertain. Lights that
    /// were not measured stay; their number is returned.
    pub fn shape(
        &self,
        scene: &mut Scene,
        angles: &[StageAngles],
        priors: &mut BenchPriors,
    ) -> usize {
        if self.lights.is_empty() {
            return 0;
        }
        let mut unmeasured = 0;
        let mut std: f64 = 0.0;
        scene.falloffs = vec![Falloff::default(); scene.lights.len()];
        for (k, angles) in angles.iter().enumerate().take(scene.lights.len()) {
            let Some(found) = self.lights.iter().find(|light| light.is_at(*angles)) else {
                unmeasured += 1;
                continue;
            };
            let strength = match &mut scene.lights[k] {
                Light::Directional { irradiance, .. } => irradiance,
                Light::Point { intensity_mm2, .. } => intensity_mm2,
            };
            for (strength, relative) in strength.iter_mut().zip(found.relative) {
                *strength *= relative.value;
                std = std.max(relative.std / relative.value);
            }
            std = std.max(found.uneven);
            scene.falloffs[k] = found.falloff();
        }
        // What was not measured varies as the measured ones do, or as the rig file states.
        priors.intensity = match unmeasured {
            0 => std.max(1e-4),
            _ => priors.intensity.max(std),
        };
        unmeasured
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::super::stage_directions;
    use super::super::white_lights::LightIntensity;
    use super::*;
    use crate::config::{BUILT_IN, RigConfig};

    fn direction(geometry: &GeometryConfig, angles: StageAngles) -> DVec3 {
        match geometry.light(angles) {
            Light::Directional { to_light, .. } => to_light,
            Light::Point { position_mm, .. } => {
                (position_mm - geometry.sample_from_stage.translation_mm).normalize()
            }
        }
    }

    /// What a fit then uses is what was measured, with axes and without; a record
    /// survives its file.
    #[test]
    fn a_bench_follows_its_record() {
        let rig = RigConfig::parse("rig", Path::new(""), BUILT_IN[0].1).unwrap();
        let truth = DQuat::from_scaled_axis(DVec3::new(0.01, -0.02, 0.05));
        let (angles, found) = stage_directions::tests::measured(5, truth, 0.03, 0.0);
        let stage = stage_directions::fit(DQuat::IDENTITY, &angles, &found, true).unwrap();
        let distance = Some(Measured::new(310.0, 2.0));
        for stage in [Some(&stage), None] {
            let values = DirectionsValues::new(&angles, &found, stage, distance);
            values.check().unwrap();
            let text = toml::to_string(&values).unwrap();
            let back: DirectionsValues = toml::from_str(&text).unwrap();
            assert_eq!(back, values);
            let mut geometry = rig.geometry.clone();
            let mut places = angles.clone();
            assert_eq!(back.apply(&mut geometry, &mut places), 0);
            assert_eq!(geometry.light.distance_mm, Some(310.0));
            for (place, found) in places.iter().zip(&found) {
                let off = direction(&geometry, *place).angle_between(found.to_light);
                let allowed = if stage.is_some() { 3e-3 } else { 1e-6 };
                assert!(off < allowed, "{off}");
            }
            let mut priors = rig.uncertainty.clone();
            back.inform(&mut priors);
            assert!(
                priors.light_rad < 1e-3 && priors.stage_rad > 1e-5,
                "{priors:?}"
            );
        }
        // A fixed light that was not measured stays.
        let values = DirectionsValues::new(&angles, &found[..3], None, None);
        let mut places = angles.clone();
        let left = values.apply(&mut rig.geometry.clone(), &mut places);
        assert_eq!(left, angles.len() - 3);
        assert_eq!(places[5], angles[5]);
    }

    #[test]
    fn an_irradiance_replaces_the_rig_files() {
        let rig = RigConfig::parse("rig", Path::new(""), BUILT_IN[0].1).unwrap();
        let values = LightsValues {
            irradiance_w_m2: [1.0, 2.0, 4.0].map(|value| Measured { value, std: 0.04 }),
            lights: Vec::new(),
        };
        let (mut geometry, mut priors) = (rig.geometry.clone(), rig.uncertainty.clone());
        values.apply(&mut geometry);
        values.inform(&mut priors);
        assert_eq!(geometry.light.irradiance_w_m2, [1.0, 2.0, 4.0]);
        assert_eq!(priors.common_intensity, 0.04);
    }

    /// Lights at measured angles get their own strength and falloff, and the prior what is
    /// known of them; others stay.
    #[test]
    fn measured_lights_differ_as_they_were_measured() {
        let rig = RigConfig::parse("rig", Path::new(""), BUILT_IN[0].1).unwrap();
        let at = |azimuth_deg: f64| StageAngles {
            azimuth_deg,
            elevation_deg: 60.0,
        };
        let measured = |azimuth_deg: f64, value: f64| LightIntensity {
            stage_deg: [azimuth_deg, 60.0],
            relative: [Measured { value, std: 0.004 }; 3],
            slope_per_mm: [0.01, 0.0],
            curve_per_mm2: [0.0; 3],
            uneven: 0.002,
        };
        let values = LightsValues {
            irradiance_w_m2: [1.0; 3].map(|value| Measured { value, std: 0.01 }),
            lights: vec![measured(20.0, 0.9), measured(80.0, 1.1)],
        };
        values.check().unwrap();
        let shaped = |angles: &[StageAngles]| {
            let mut scene = rig.geometry.scene(angles).unwrap();
            let mut priors = rig.uncertainty.clone();
            let left = values.shape(&mut scene, angles, &mut priors);
            (scene, priors, left)
        };
        let (scene, priors, left) = shaped(&[at(80.1), at(20.0)]);
        assert_eq!(left, 0);
        let stated = rig.geometry.light.irradiance_w_m2[1];
        for (light, relative) in scene.lights.iter().zip([1.1, 0.9]) {
            assert!((light.strength()[1] / stated - relative).abs() < 1e-12);
        }
        assert!((priors.intensity - 0.004 / 0.9).abs() < 1e-12);
        assert_eq!(scene.falloffs, [values.lights[0].falloff(); 2]);
        let (scene, priors, left) = shaped(&[at(81.0), at(20.0)]);
        assert_eq!((left, scene.lights[0].strength()[1]), (1, stated));
        assert_eq!(scene.falloffs[0], Falloff::default());
        assert_eq!(priors.intensity, rig.uncertainty.intensity);
    }
}
