//! Where lamps can stand.

use glam::DVec3;

use super::ON_AXIS_DEG;
use crate::capture::reach::StageReach;
use crate::config::RigConfig;
use crate::config::geometry::GeometryConfig;
use crate::transport::{CameraShadow, Light, Scene};
use crate::units::StageAngles;

/// A place for a lamp.
#[derive(Clone, Copy, Debug, serde::Serialize)]
pub struct Lamp {
    /// As its stage counts them; without a bench in the sample's frame.
    #[serde(flatten)]
    pub angles: StageAngles,
    /// What the sample sees, sample frame.
    #[serde(skip)]
    pub light: Light,
}

impl Lamp {
    /// Unit direction from the sample, sample frame.
    pub fn to_light(&self) -> DVec3 {
        match self.light {
            Light::Directional { to_light, .. } => to_light,
            Light::Point { position_mm, .. } => position_mm.normalize_or(DVec3::Z),
        }
    }
}

impl std::fmt::Display for Lamp {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let angles = &self.angles;
        write!(out, "{:.0},{:.0}", angles.azimuth_deg, angles.elevation_deg)
    }
}

/// What leaves lamps their places.
#[derive(Clone, Debug)]
pub struct Reach {
    /// No lower than this over the rim's plane, degrees.
    pub least_elevation_deg: f64,
    /// Least angle between a lamp and the camera's axis, degrees: nearer lamps would stand behind
    /// the camera or shine into its lens.
    pub clearance_deg: f64,
    /// The stage that moves the lamp, and the body of the camera.
    pub bench: Option<Bench>,
}

impl Default for Reach {
    fn default() -> Self {
        Self {
            least_elevation_deg: 15.0,
            clearance_deg: 20.0,
            bench: None,
        }
    }
}

impl Reach {
    /// All that a bench leaves.
    pub fn of_rig(config: &RigConfig) -> Self {
        Self {
            least_elevation_deg: -90.0,
            clearance_deg: 0.0,
            bench: Some(Bench::of_rig(config)),
        }
    }
}

/// A rig whose lamps and camera are to be used.
#[derive(Clone, Debug)]
pub struct Bench {
    stage: StageReach,
    geometry: GeometryConfig,
}

impl Bench {
    /// Its sample does not count.
    fn of_rig(config: &RigConfig) -> Self {
        Self {
            stage: StageReach::free(config.stage.kinematics()),
            geometry: config.geometry.clone(),
        }
    }

    fn to_camera(&self) -> DVec3 {
        let camera = &self.geometry.camera;
        camera.sample_from_camera.direction(-DVec3::Z)
    }

    /// Angle of its camera from the sample's axis, degrees.
    fn camera_tilt_deg(&self) -> f64 {
        self.to_camera().angle_between(DVec3::Z).to_degrees()
    }

    /// Where its camera stands around that axis, degrees; `None` on the axis.
    pub(super) fn camera_azimuth_deg(&self) -> Option<f64> {
        let to_camera = self.to_camera();
        let azimuth_deg = to_camera.y.atan2(to_camera.x).to_degrees();
        (self.camera_tilt_deg() >= ON_AXIS_DEG).then_some(azimuth_deg)
    }

    /// From its camera to what is sharp, mm.
    pub(super) fn camera_distance_mm(&self) -> f64 {
        self.geometry.camera.focus_mm
    }
}

impl Reach {
    /// Tilts of the camera to choose from: as it stands on a bench, else up to 60°.
    pub fn tilts_deg(&self) -> [f64; 2] {
        let bench = self.bench.as_ref();
        bench.map_or([0.0, 60.0], |bench| [bench.camera_tilt_deg(); 2])
    }

    /// Free places around the sample of a scene before its camera, on whole steps of azimuth and
    /// elevation; of fixed lamps all that are free.
    pub fn lamps(&self, scene: &Scene, step_deg: f64) -> Vec<Lamp> {
        let to_camera = scene.camera.sample_from_camera.direction(-DVec3::Z);
        let nearest = self.clearance_deg.to_radians().cos();
        let least = self.least_elevation_deg.to_radians().sin() - 1e-9;
        let mut places = match &self.bench {
            None => self.around(step_deg),
            Some(bench) => bench.places(scene, step_deg),
        };
        places.retain(|lamp| {
            let to_light = lamp.to_light();
            to_light.dot(to_camera) <= nearest && to_light.z >= least
        });
        places
    }

    /// Parallel light of unit irradiance, from the least elevation up.
    fn around(&self, step_deg: f64) -> Vec<Lamp> {
        let steps = |from: f64, to: f64| {
            let count = ((to - from) / step_deg).floor().max(0.0) as usize;
            (0..=count).map(move |k| from + k as f64 * step_deg)
        };
        let place = |azimuth_deg: f64, elevation_deg: f64| {
            let angles = StageAngles::new(azimuth_deg, elevation_deg);
            let light = Light::distant(angles.to_light(), [1.0; 3]);
            Lamp { angles, light }
        };
        let of_elevation = |elevation: f64| {
            let widest = if elevation > 89.0 { 0.0 } else { 359.0 };
            steps(0.0, widest).map(move |azimuth| place(azimuth, elevation))
        };
        let rows = steps(self.least_elevation_deg, 90.0);
        rows.flat_map(of_elevation).collect()
    }
}

impl Bench {
    /// Within the stage's limits and past the camera's body.
    fn places(&self, scene: &Scene, step_deg: f64) -> Vec<Lamp> {
        let body = self.geometry.camera_body;
        let shadow = body.map(|body| CameraShadow::new(scene, body));
        let on_step = |deg: f64| (deg / step_deg - (deg / step_deg).round()).abs() < 1e-6;
        let reachable = self.stage.reachable().into_iter();
        let on_grid = reachable.filter(|angles| {
            self.stage.is_fixed() || (on_step(angles.azimuth_deg) && on_step(angles.elevation_deg))
        });
        let place = |angles| Lamp {
            angles,
            light: self.geometry.light(angles),
        };
        let is_free = |lamp: &Lamp| {
            let shadow = shadow.as_ref();
            shadow.is_none_or(|shadow| !shadow.blocks(&lamp.light))
        };
        on_grid.map(place).filter(is_free).collect()
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::config::BUILT_IN;
    use crate::design::DesignRequest;
    use crate::geometry::Shape;

    /// Before the arm's camera what its stage reaches is left but for the lamps behind the body,
    /// which are fewer where the camera is tilted away from them.
    #[test]
    fn lamps_of_a_bench_are_within_its_limits_and_past_its_camera() {
        let (name, text) = BUILT_IN
            .iter()
            .find(|(n, _)| *n == "grbl-arm-v4l2")
            .unwrap();
        let config = RigConfig::parse(name, Path::new(""), text).unwrap();
        let reach = Reach::of_rig(&config);
        let request = DesignRequest {
            reach: reach.clone(),
            ..DesignRequest::default()
        };
        let shape = Shape::Bowl {
            radius_mm: 10.0,
            segments: 32,
        };
        let free = |tilt_deg: f64| {
            let scene = request.scene(shape.mesh().unwrap(), tilt_deg, 16);
            assert_eq!(scene.camera.focus_mm, config.geometry.camera.focus_mm);
            reach.lamps(&scene, 15.0)
        };
        let on_axis = free(0.0);
        let stage = StageReach::of_rig(&config).unwrap();
        let angles: Vec<StageAngles> = on_axis.iter().map(|lamp| lamp.angles).collect();
        stage.check(&angles).unwrap();
        let high = |lamps: &[Lamp]| lamps.iter().filter(|l| l.to_light().z > 0.9).count();
        assert!(high(&free(54.0)) > high(&on_axis));
    }
}
