//! The `[geometry]` table: where camera, sample, stage and light are.

use glam::DVec3;

use super::ConfigError;
use super::camera::CameraConfig;
use super::reader::Section;
use super::view::{BodySpec, SampleSpec, take_bodies, take_camera, take_camera_body};
use crate::device::kinematics::{Kinematics, Mechanism};
use crate::frames::{Rigid, Sample, Stage};
use crate::transport::{Camera, CameraBody, Light};
use crate::units::StageAngles;

/// The geometry as calibrated (or as designed, before the first calibration).
#[derive(Clone, Debug, PartialEq)]
pub struct GeometryConfig {
    /// Where the camera stands, with the device's pixel grid.
    pub camera: Camera,
    /// Its housing and lens, which keep light from the sample; `None`: not stated, as where
    /// the light comes through the lens.
    pub camera_body: Option<CameraBody>,
    /// Sensor pixels on each side of a merged image's pixel: 2 under colour filters.
    pub cell_px: usize,
    /// The sample's known shape.
    pub sample: SampleSpec,
    /// What stands around it and moves with it: a holder.
    pub bodies: Vec<BodySpec>,
    /// The stage's axes as seen from the sample.
    pub sample_from_stage: Rigid<Sample, Stage>,
    /// The light.
    pub light: LightConfig,
}

/// The lamp as the sample sees it.
#[derive(Clone, Debug, PartialEq)]
pub struct LightConfig {
    /// Distance of the lamp from the stage's centre, mm; `None`: parallel light.
    /// Where the stage's mechanism changes the distance, the one at which the
    /// irradiance holds: a gantry's height, an arc's radius.
    pub distance_mm: Option<f64>,
    /// The stage, where it changes the lamp's distance.
    pub mechanism: Option<Kinematics>,
    /// Half the angle under which the sample sees the lamp, degrees; 0 for a
    /// lamp at a finite distance, which counts as a point.
    pub angular_radius_deg: f64,
    /// Irradiance at the sample across the light, for R, G and B, W/m².
    pub irradiance_w_m2: [f64; 3],
}

impl GeometryConfig {
    /// From the sample to the camera, in the stage's frame.
    pub fn coaxial(&self) -> DVec3 {
        let to_camera = self.camera.sample_from_camera.direction(-DVec3::Z);
        self.sample_from_stage.inverse().direction(to_camera)
    }

    /// Reads the `[geometry]` table for this camera and a stage with these kinematics.
    pub fn read(
        mut table: Section,
        device: &CameraConfig,
        stage_kinematics: &Kinematics,
    ) -> Result<Self, ConfigError> {
        let mut camera = table.section("camera")?.required()?;
        let view = take_camera(&mut camera, device.resolution_px)?;
        let camera_body = take_camera_body(&mut camera, &view)?;
        camera.finish()?;
        let sample = SampleSpec::read(table.section("sample")?.required()?)?;
        let bodies = take_bodies(&mut table)?;
        let mut stage = table.section_or_empty("sample_from_stage")?;
        let rotation_deg = stage
            .numbers::<3>("rotation_deg", -180.0..=180.0)?
            .or([0.0; 3]);
        let sample_from_stage = Rigid::from_rotation_vector(
            DVec3::from_array(rotation_deg.map(f64::to_radians)),
            stage.position("translation_mm")?.or(DVec3::ZERO),
        );
        stage.finish()?;
        let mut light = table.section_or_empty("light")?;
        let given_mm = light.number("distance_mm", 1.0..=1e5)?.optional();
        let stage_mm = match stage_kinematics {
            Kinematics::TwoAxes(axes) => match axes.mechanism {
                Mechanism::Rotary => None,
                Mechanism::Arc { radius_mm, .. } => Some(radius_mm),
                Mechanism::Gantry { height_mm } => Some(height_mm),
            },
            Kinematics::FixedLights(_) => None,
        };
        if let (Some(given_mm), Some(_)) = (given_mm, stage_mm) {
            let allowed = "absent where the stage's mechanism says how far the lamp is";
            return Err(light.conflict("distance_mm", given_mm, allowed));
        }
        let light_config = LightConfig {
            distance_mm: given_mm.or(stage_mm),
            mechanism: stage_mm.map(|_| stage_kinematics.clone()),
            angular_radius_deg: light.number("angular_radius_deg", 0.0..=45.0)?.or(0.0),
            irradiance_w_m2: light.channels("irradiance_w_m2", 1e-9..=1e9)?.or([1.0; 3]),
        };
        if light_config.distance_mm.is_some() && light_config.angular_radius_deg > 0.0 {
            let allowed = "0 where the lamp is at a finite distance";
            let radius_deg = light_config.angular_radius_deg;
            return Err(light.conflict("angular_radius_deg", radius_deg, allowed));
        }
        light.finish()?;
        table.finish()?;
        Ok(Self {
            camera: view,
            camera_body,
            cell_px: device.mosaic.period(),
            sample,
            bodies,
            sample_from_stage,
            light: light_config,
        })
    }

    /// The camera of merged images.
    pub fn image_camera(&self) -> Camera {
        Camera {
            resolution_px: self.camera.resolution_px.map(|side| side / self.cell_px),
            point_spread_px: self.camera.point_spread_px / self.cell_px as f64,
            ..self.camera
        }
    }

    /// The lamp with all channels lit while the stage is at these angles,
    /// sample frame. A lamp at a finite distance turns about the stage's centre
    /// and gives its irradiance there; one whose distance changes has the same
    /// intensity wherever it is.
    pub fn light(&self, angles: StageAngles) -> Light {
        let to_light = self.sample_from_stage.direction(angles.to_light());
        match self.light.distance_mm {
            None => Light::Directional {
                to_light,
                irradiance: self.light.irradiance_w_m2,
                angular_radius_rad: self.light.angular_radius_deg.to_radians(),
            },
            Some(stated_mm) => {
                let mechanism = self.light.mechanism.as_ref();
                let distance_mm = mechanism
                    .and_then(|mechanism| mechanism.lamp_distance_mm(angles))
                    .unwrap_or(stated_mm);
                Light::Point {
                    position_mm: self.sample_from_stage.translation_mm + to_light * distance_mm,
                    intensity_mm2: self.light.irradiance_w_m2.map(|e| e * stated_mm.powi(2)),
                }
            }
        }
    }
}
