//! What a camera reports with a frame, instead of when its settings are set.

use super::CameraSettings;
use super::retake::FrameFault;
use crate::units::Seconds;

/// A gain that is reported may differ from the one requested by this part.
pub const GAIN_TOLERANCE: f64 = 0.01;

/// What a camera reported with a frame; `None` where it reported nothing of the kind.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Stated {
    /// Exposure of the frame.
    pub exposure: Option<Seconds>,
    /// Gain of the frame, a factor.
    pub gain: Option<f64>,
    /// Serial number of the camera that took it.
    pub serial: Option<String>,
    /// Temperature of the sensor, °C.
    pub sensor_c: Option<f64>,
}

impl Stated {
    /// The settings that the frame was taken with: those of `configured`, replaced by what
    /// was reported.
    pub fn settings(&self, configured: CameraSettings) -> CameraSettings {
        CameraSettings::new(
            self.exposure.unwrap_or(configured.exposure),
            self.gain.unwrap_or(configured.gain),
        )
    }

    /// Whether the frame was taken as requested: the exposure within `step`, which the rig
    /// file states, and the gain within [`GAIN_TOLERANCE`].
    ///
    /// # Errors
    /// [`FrameFault::Settings`] with what was reported and requested.
    pub fn check(&self, requested: CameraSettings, step: Seconds) -> Result<(), FrameFault> {
        // Of a step, so that a number that was printed and read counts as equal.
        const SLACK: f64 = 1e-6;
        let Seconds(wanted_s) = requested.exposure;
        if let Some(exposure) = self.exposure
            && (exposure.0 - wanted_s).abs() > step.0 * (1.0 + SLACK)
        {
            return Err(FrameFault::Settings {
                what: "exposure",
                is: exposure.to_string(),
                wanted: format!("{} ± {step}", requested.exposure),
            });
        }
        if let Some(gain) = self.gain
            && (gain / requested.gain - 1.0).abs() > GAIN_TOLERANCE
        {
            return Err(FrameFault::Settings {
                what: "gain",
                is: gain.to_string(),
                wanted: format!("{} ± {}%", requested.gain, 100.0 * GAIN_TOLERANCE),
            });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_within_the_step_are_taken_and_others_refused() {
        let requested = CameraSettings::new(Seconds(0.02), 2.0);
        let step = Seconds(0.001);
        let of = |exposure_s: f64, gain: f64| Stated {
            exposure: Some(Seconds(exposure_s)),
            gain: Some(gain),
            ..Stated::default()
        };
        for (stated, expected) in [
            (Stated::default(), None),
            (of(0.021, 2.019), None),
            (of(0.019, 1.981), None),
            (of(0.0211, 2.0), Some("exposure")),
            (of(0.0, 2.0), Some("exposure")),
            (of(0.02, 2.03), Some("gain")),
            (of(0.02, 1.0), Some("gain")),
        ] {
            let fault = stated.check(requested, step).err();
            let what = fault.as_ref().map(|fault| match fault {
                FrameFault::Settings { what, .. } => *what,
                other => panic!("{other}"),
            });
            assert_eq!(what, expected, "{stated:?}");
        }
        assert_eq!(Stated::default().settings(requested), requested);
        assert_eq!(of(0.021, 2.0).settings(requested).exposure, Seconds(0.021));
    }
}
