//! The relative response of each pixel, and the scale, under an even light.

use std::sync::atomic::Ordering;

use super::{Attendant, CalibratingError, Kept, Place, counted, procedure_options};
use crate::calibration::flat::{FlatFit, to_map};
use crate::calibration::noise::sensor_noise;
use crate::calibration::procedure::LitCamera;
use crate::calibration::record::{FlatValues, Kind, Measured, ScaleValues, SensorValues};
use crate::calibration::{Library, Loaded};
use crate::capture::open::{OpenOptions, open_real_camera};
use crate::config::calibration_light::UNIFORM_RADIANCE;
use crate::config::{ResolvedRig, RigConfig};
use crate::random::{Purpose, stream};

/// A flat field of the camera of a rig before a steady, uniform light.
pub struct FlatRequest<'a> {
    /// The bench.
    pub rig: &'a ResolvedRig,
    /// Flats, and as many frames without the light.
    pub frames: u32,
    /// Whether these are with the light switched off and the room as it is, not dark.
    pub ambient: bool,
    /// Radiance of the light by its certificate, W/(m² sr).
    pub radiance: Option<Measured>,
    /// How a real camera is opened.
    pub open: &'a OpenOptions,
}

/// A flat field as measured.
pub struct MeasuredFlat {
    /// The response of each pixel.
    pub fit: FlatFit,
    /// Electrons per second for unit radiance, where the light's is certified.
    pub responsivity_e_s: Option<Measured>,
    frames: u32,
    unlit: &'static str,
    width: usize,
    sensor_c: Option<f64>,
}

impl FlatRequest<'_> {
    /// Takes frames with the light and without it and solves them. A sensor record in `place`
    /// counts before that of the rig.
    ///
    /// # Errors
    /// There is no sensor record that can be used, the camera fails, or the light does not fit.
    pub fn measure(
        &self,
        place: &Place,
        attendant: &dyn Attendant,
    ) -> Result<MeasuredFlat, CalibratingError> {
        let rig = &self.rig.config;
        let sensor = self.sensor(place)?;
        // The sensor's noise.
        let serial = rig.camera.serial.as_deref().unwrap_or_default();
        sensor.check_camera(serial, &rig.camera)?;
        let resolution_px = rig.camera.resolution_px;
        let noise = sensor_noise(&sensor, None, None, resolution_px)?;
        // The light, real or simulated, and the frames under it.
        let radiance = self.true_radiance(rig);
        let room = rig.simulation.as_ref().map(|s| s.ambient_w_m2_sr);
        let other = room.filter(|_| self.ambient).unwrap_or(0.0);
        let (mut camera, simulated) = match rig.evenly_lit_camera(radiance, other) {
            Some((camera, switch)) => (camera, Some(switch)),
            None => (open_real_camera(rig, self.open)?, None),
        };
        let mut switch = |on: bool| match &simulated {
            Some(light) => {
                light.store(on, Ordering::Relaxed);
                true
            }
            None => attendant.switch(on),
        };
        let mut cover = |cover| attendant.cover(cover);
        let mut step = counted(attendant, 2 * self.frames);
        let options = procedure_options(&rig.camera, self.frames);
        let bench = LitCamera::new(camera.as_mut(), options, &mut cover, &mut step);
        let mut bench = match self.ambient {
            true => bench.with_switch(&mut switch),
            false => bench,
        };
        let fit = bench.flat_field(&noise)?;
        let gain = sensor.record.values.gain_dn_per_e;
        Ok(MeasuredFlat {
            responsivity_e_s: self.radiance.map(|of| fit.responsivity_e_s(of, gain)),
            fit,
            frames: self.frames,
            unlit: if self.ambient { "ambient" } else { "dark" },
            width: resolution_px[0] as usize,
            sensor_c: camera.temperature_c(),
        })
    }

    /// The sensor record: one that was measured just before into the place counts.
    fn sensor(&self, place: &Place) -> Result<Loaded<SensorValues>, CalibratingError> {
        let config = &self.rig.config;
        let gain = config.camera.gain;
        if let Some(sensor) = place.library.load_for(None, gain)? {
            return Ok(sensor);
        }
        let library = Library::of_rig(self.rig);
        let pinned = config.calibration.sensor.as_deref();
        let sensor = library.load_for(pinned, gain)?;
        sensor.ok_or_else(|| CalibratingError::NoSensor {
            place: library.place(),
        })
    }

    /// The simulated light differs from its certificate as a real one does.
    fn true_radiance(&self, rig: &RigConfig) -> f64 {
        self.radiance
            .map_or(UNIFORM_RADIANCE, |Measured { value, std }| {
                let seed = rig.simulation.as_ref().map_or(0, |s| s.seed);
                value + std * stream(seed, Purpose::BenchPerturbation, u64::MAX, 0, 0).normal()
            })
    }
}

impl MeasuredFlat {
    /// Keeps the record of the flat field, and the scale's where the light is certified; with
    /// them the values of the first.
    ///
    /// # Errors
    /// A file that cannot be written, or a record of that name that is there.
    pub fn keep(
        &self,
        place: &mut Place,
    ) -> Result<(Kept, Option<Kept>, FlatValues), CalibratingError> {
        place.measurement.settings.sensor_c = self.sensor_c;
        let file = format!("{}.png", place.measurement.id(Kind::Flat));
        let (values, png) = to_map(&self.fit.flat, self.width, &file)?;
        let values = FlatValues {
            ambient: self.fit.ambient,
            ..values
        };
        let (frames, unlit) = (self.frames, self.unlit);
        let method = format!("mean of {frames} flats less {frames} {unlit} frames");
        let flat = place.keep(values.clone(), &method, &[(&file, &png)])?;
        let scale = match self.responsivity_e_s {
            None => None,
            Some(responsivity_e_s) => {
                let method = "mean rate under a light of certified radiance";
                Some(place.keep(ScaleValues { responsivity_e_s }, method, &[])?)
            }
        };
        Ok((flat, scale, values))
    }
}
