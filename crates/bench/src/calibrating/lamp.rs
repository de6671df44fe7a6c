//! Warm-up, drift and flicker of the lamp.

use std::time::Duration;

use super::{Attendant, CalibratingError, Kept, Place};
use crate::calibration::lamp::LampFit;
use crate::calibration::lamp_watch::{Watch, WatchOptions};
use crate::capture::open::{OpenError, OpenOptions, open_devices};
use crate::capture::reach::StageReach;
use crate::config::RigConfig;
use crate::device::{LampChannel, LampState};
use crate::units::StageAngles;

/// A lamp that is switched on and watched.
pub struct LampRequest<'a> {
    /// The bench.
    pub rig: &'a RigConfig,
    /// How long it is watched, minutes.
    pub minutes: f64,
    /// Time between two levels, seconds.
    pub interval_s: f64,
    /// Frames of each burst.
    pub burst: u32,
    /// Channel of the lamp, from 0.
    pub channel: u8,
}

/// A lamp as measured.
#[derive(Clone, Debug)]
pub struct MeasuredLamp {
    /// The lamp.
    pub fit: LampFit,
    method: String,
    sensor_c: Option<f64>,
    lamp_c: Option<f64>,
}

/// Steps in which the progress is counted.
const STEPS: u64 = 1000;

impl LampRequest<'_> {
    /// Whether the lamp has the channel.
    ///
    /// # Errors
    /// [`CalibratingError::NoChannel`].
    pub fn check(&self) -> Result<(), CalibratingError> {
        let (channel, channels) = (self.channel, self.rig.stage.measures.len());
        match usize::from(channel) < channels {
            true => Ok(()),
            false => Err(CalibratingError::NoChannel { channel, channels }),
        }
    }

    /// Homes the stage, aims it steeply, switches the lamp on and watches it; `open` is how real
    /// devices are opened.
    ///
    /// # Errors
    /// A device fails, or the scene or the lamp does not make a calibration.
    pub fn measure(
        &self,
        open: &OpenOptions,
        attendant: &dyn Attendant,
    ) -> Result<MeasuredLamp, CalibratingError> {
        self.check()?;
        let options = WatchOptions {
            gain: self.rig.camera.gain,
            watch_s: 60.0 * self.minutes,
            interval_s: self.interval_s,
            burst: self.burst,
            discard: self.rig.camera.settings_latency_frames + 1,
        };
        let mut progress = |part: f64| attendant.progress((STEPS as f64 * part) as u64, STEPS);
        let (fit, sensor_c, lamp_c) = match self.rig.lamp_on_card(self.channel) {
            Some(mut bench) => {
                let mut wait = bench.clock();
                let switch = bench.switch.as_mut();
                let camera = bench.camera.as_mut();
                let fit = Watch::new(camera, switch, &mut wait, &mut progress).run(&options)?;
                // This camera is cold again in every capture.
                (fit, None, None)
            }
            None => {
                let devices = open_devices(self.rig, open)?;
                let (mut stage, mut camera) = (devices.stage, devices.camera);
                // A stage moves and lights nothing before it knows where it is. A steep light falls
                // on the whole card.
                stage.home().map_err(OpenError::from)?;
                let free = StageReach::of_rig(self.rig).map_err(OpenError::from)?;
                let steep =
                    |a: &StageAngles, b: &StageAngles| a.elevation_deg.total_cmp(&b.elevation_deg);
                if let Some(steepest) = free.candidates().into_iter().max_by(steep) {
                    stage.move_to(steepest).map_err(OpenError::from)?;
                }
                let watchdog = stage.watchdog();
                let mut switch = |on: bool| {
                    let state = match on {
                        true => LampState::On(LampChannel(self.channel)),
                        false => LampState::Off,
                    };
                    stage.set_lamp(state).map(|_| ())
                };
                let mut wait = |seconds: f64| {
                    watchdog.wait(Duration::try_from_secs_f64(seconds).unwrap_or_default());
                };
                let fit = Watch::new(camera.as_mut(), &mut switch, &mut wait, &mut progress)
                    .run(&options)?;
                (fit, camera.temperature_c(), stage.temperature_c())
            }
        };
        Ok(MeasuredLamp {
            fit,
            method: format!(
                "levels every {} s for {} min after switching on, bursts of {} frames, channel {}",
                self.interval_s, self.minutes, self.burst, self.channel
            ),
            sensor_c,
            lamp_c,
        })
    }
}

impl MeasuredLamp {
    /// Keeps the record with its figure.
    ///
    /// # Errors
    /// A file that cannot be written, or a record of that name that is there.
    pub fn keep(&self, place: &mut Place) -> Result<Kept, CalibratingError> {
        place.measurement.settings.sensor_c = self.sensor_c;
        place.measurement.settings.lamp_c = self.lamp_c;
        let kept = place.keep(self.fit.values.clone(), &self.method, &[])?;
        #[cfg(feature = "figures")]
        let kept = place.draw(kept, &crate::calibration::figures::lamp(&self.fit))?;
        Ok(kept)
    }
}
