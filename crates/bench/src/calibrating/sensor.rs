//! The sensor, by photon transfer.

use serde::Serialize;

use super::{Attendant, CalibratingError, Kept, Place, counted, procedure_options};
use crate::calibration::procedure::LitCamera;
use crate::calibration::record::{Kind, SensorValues};
use crate::calibration::sensor::emva1288::Emva1288;
use crate::calibration::sensor::{SensorFit, TransferPoint};
use crate::capture::open::{OpenOptions, open_real_camera};
use crate::config::RigConfig;
use crate::config::calibration_light::UNIFORM_RADIANCE;
use crate::device::CameraInfo;

/// A photon transfer with the camera of a rig before a steady, uniform light.
pub struct SensorRequest<'a> {
    /// The bench.
    pub rig: &'a RigConfig,
    /// Frames at each exposure, from 2 on.
    pub frames: u32,
    /// How a real camera is opened.
    pub open: &'a OpenOptions,
}

/// A sensor as measured.
#[allow(missing_docs)]
pub struct MeasuredSensor {
    pub info: CameraInfo,
    pub fit: SensorFit,
    /// The same in the terms of EMVA 1288.
    pub emva1288: Emva1288,
    pub method: String,
    sensor_c: Option<f64>,
}

/// What was found, for other programs.
#[derive(Serialize)]
pub struct SensorReport<'a> {
    values: &'a SensorValues,
    reduced_chi2: f64,
    emva1288: &'a Emva1288,
    curve: &'a [TransferPoint],
}

impl SensorRequest<'_> {
    /// Takes frames of the light and solves them.
    ///
    /// # Errors
    /// The camera fails, or the light or the sensor does not fit a photon transfer.
    pub fn measure(&self, attendant: &dyn Attendant) -> Result<MeasuredSensor, CalibratingError> {
        let options = procedure_options(&self.rig.camera, self.frames);
        let mut camera = match self.rig.evenly_lit_camera(UNIFORM_RADIANCE, 0.0) {
            Some((camera, _)) => camera,
            None => open_real_camera(self.rig, self.open)?,
        };
        let info = camera.info().clone();
        let mut cover = |cover| attendant.cover(cover);
        let mut step = counted(attendant, LitCamera::photon_transfer_frames(&options));
        let transfer =
            LitCamera::new(camera.as_mut(), options, &mut cover, &mut step).photon_transfer()?;
        let fit = transfer.solve(info.resolution_px[0] as usize, info.bit_depth)?;
        let (levels, frames) = (fit.curve.len(), self.frames);
        Ok(MeasuredSensor {
            method: format!(
                "photon transfer (EMVA 1288), {levels} exposures of {frames} frames, reduced \
                 chi-square {:.3}",
                fit.reduced_chi2
            ),
            emva1288: transfer.emva1288(&fit, self.rig.camera.mosaic),
            sensor_c: camera.temperature_c(),
            info,
            fit,
        })
    }
}

impl MeasuredSensor {
    /// Keeps the record with its maps and its figure.
    ///
    /// # Errors
    /// A file that cannot be written, or a record of that name that is there.
    pub fn keep(&self, place: &mut Place) -> Result<Kept, CalibratingError> {
        place.measurement.settings.sensor_c = self.sensor_c;
        let id = place.measurement.id(Kind::Sensor);
        let width = self.info.resolution_px[0] as usize;
        let (dark, maps) = self.fit.dark.to_values(width, &id)?;
        let values = SensorValues {
            dark_pattern: Some(dark),
            ..self.fit.values.clone()
        };
        let maps = maps
            .each_ref()
            .map(|(file, bytes)| (file.as_str(), bytes.as_slice()));
        let kept = place.keep(values, &self.method, &maps)?;
        #[cfg(feature = "figures")]
        let kept = place.draw(
            kept,
            &crate::calibration::figures::photon_transfer(&self.fit),
        )?;
        Ok(kept)
    }

    /// What was found, for other programs.
    pub fn report(&self) -> SensorReport<'_> {
        SensorReport {
            values: &self.fit.values,
            reduced_chi2: self.fit.reduced_chi2,
            emva1288: &self.emva1288,
            curve: &self.fit.curve,
        }
    }
}
