//! The `[geometry]` table: where camera, sample, stage and light are.

use glam::DVec3;

use super::ConfigError;
use super::reader::Section;
use super::view::{CameraView, SampleSpec};
use crate::frames::{Rigid, Sample, Stage};
use crate::units::StageAngles;

/// The geometry as calibrated (or as designed, before the first calibration).
#[derive(Clone, Debug, PartialEq)]
pub struct GeometryConfig {
    /// Where the camera stands; the pixel grid is the camera's.
    pub camera: CameraView,
    /// The sample's known shape.
    pub sample: SampleSpec,
    /// The stage's axes as seen from the sample.
    pub sample_from_stage: Rigid<Sample, Stage>,
    /// The light.
    pub light: LightConfig,
}

/// The lamp as the sample sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightConfig {
    /// Distance of the lamp from the stage's centre, mm; `None`: parallel light.
    pub distance_mm: Option<f64>,
    /// Half the angle under which the sample sees the lamp, degrees.
    pub angular_radius_deg: f64,
    /// Irradiance at the sample across the light, for R, G and B, W/m².
    pub irradiance_w_m2: [f64; 3],
}

impl GeometryConfig {
    /// Reads the `[geometry]` table.
    pub fn read(mut table: Section) -> Result<Self, ConfigError> {
        let mut camera = table.section("camera")?.required()?;
        let view = CameraView::take(&mut camera)?;
        camera.finish()?;
        let sample = SampleSpec::read(table.section("sample")?.required()?)?;
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
        let light_config = LightConfig {
            distance_mm: light.number("distance_mm", 1.0..=1e5)?.optional(),
            angular_radius_deg: light.number("angular_radius_deg", 0.0..=45.0)?.or(0.0),
            irradiance_w_m2: light.channels("irradiance_w_m2", 1e-9..=1e9)?.or([1.0; 3]),
        };
        light.finish()?;
        table.finish()?;
        Ok(Self {
            camera: view,
            sample,
            sample_from_stage,
            light: light_config,
        })
    }

    /// Unit vector from the sample's origin towards the lamp at these angles, sample frame.
    pub fn to_light(&self, angles: StageAngles) -> DVec3 {
        let to_light = self.sample_from_stage.direction(angles.to_light());
        match self.light.distance_mm {
            None => to_light,
            Some(distance_mm) => {
                let lamp_mm = to_light * distance_mm + self.sample_from_stage.translation_mm;
                lamp_mm.try_normalize().unwrap_or(to_light)
            }
        }
    }
}
