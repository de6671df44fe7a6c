//! Exposure and gain of a camera by the controls of Video4Linux, as UVC cameras have them:
//! everything automatic off first, and each value read back.

use std::io;

use super::controls::{self, ControlPort, id};
use super::{CameraSettings, DeviceError};
use crate::units::Seconds;

/// Unit of `EXPOSURE_ABSOLUTE`, seconds.
const EXPOSURE_UNIT_S: f64 = 100e-6;
/// A request that a USB device stalls shows as this error number (EPIPE).
const STALLED: i32 = 32;

/// The controls by which a camera's exposure and gain are set.
#[derive(Clone, Copy, Debug)]
pub struct ManualSettings {
    /// Absent where it cannot be set.
    exposure: Option<Range>,
    gain: Option<Gain>,
}

/// An integer control's range.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Range {
    minimum: i64,
    maximum: i64,
    step: i64,
}

/// The control that sets the gain.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Gain {
    id: u32,
    range: Range,
}

impl ManualSettings {
    /// Those that a camera has.
    ///
    /// # Errors
    /// The port's own.
    pub fn of(port: &dyn ControlPort) -> io::Result<Self> {
        let exposure = range_of(port, id::EXPOSURE_ABSOLUTE)?;
        let mut gain = None;
        for id in [id::ANALOGUE_GAIN, id::GAIN] {
            if gain.is_none() {
                let range = range_of(port, id)?;
                gain = range.map(|range| Gain { id, range });
            }
        }
        Ok(Self { exposure, gain })
    }

    /// Whether the exposure can be set.
    pub fn has_exposure(&self) -> bool {
        self.exposure.is_some()
    }

    /// Shortest and longest exposure, and the step between them; NaN without a control.
    pub fn exposures(&self) -> ([Seconds; 2], Seconds) {
        let seconds = |steps: Option<i64>| {
            Seconds(steps.map_or(f64::NAN, |steps| steps as f64 * EXPOSURE_UNIT_S))
        };
        let range = [
            seconds(self.exposure.map(|range| range.minimum.max(1))),
            seconds(self.exposure.map(|range| range.maximum)),
        ];
        (range, seconds(self.exposure.map(|range| range.step)))
    }

    /// Switches off what is automatic, sets the further controls `wanted`, gain and exposure,
    /// and returns what is read back. The exposure is NaN where it cannot be set.
    ///
    /// # Errors
    /// [`DeviceError::Refused`] where the camera stalls a request or has no such gain;
    /// [`DeviceError::NotApplied`] where something stays automatic; the port's own by way of
    /// `failed`.
    pub fn apply(
        &self,
        port: &dyn ControlPort,
        device: &str,
        wanted: &[(u32, i64)],
        requested: CameraSettings,
        failed: &dyn Fn(io::Error) -> DeviceError,
    ) -> Result<CameraSettings, DeviceError> {
        let refused = |command: &str, reason: &str| DeviceError::Refused {
            device: device.to_owned(),
            command: command.to_owned(),
            reason: reason.to_owned(),
        };
        let set = |id, value, what: &str| {
            controls::set(port, id, value).map_err(|error| match error.raw_os_error() {
                Some(STALLED) => refused(what, "it stalls this request"),
                _ => failed(error),
            })
        };
        controls::set_manual(port, device, failed)?;
        controls::set_wanted(port, device, wanted, failed)?;
        // Gain.
        let command = format!("gain {}", requested.gain);
        let gain = match self.gain {
            None if requested.gain == 1.0 => 1.0,
            None => {
                return Err(refused(
                    &command,
                    "the camera has no gain control, so only 1",
                ));
            }
            Some(control) => {
                let reason = "the unit of its gain is unknown, so only 1 (the lowest)";
                let unknown = || refused(&command, reason);
                let raw = control.raw(requested.gain).ok_or_else(unknown)?;
                let applied = set(control.id, raw, &command)?;
                control.factor(applied).ok_or_else(unknown)?
            }
        };
        // Exposure.
        let exposure_s = match self.exposure {
            None => f64::NAN,
            Some(range) => {
                let steps = range.nearest(requested.exposure.0 / EXPOSURE_UNIT_S);
                let what = format!("exposure {}", requested.exposure);
                let applied = set(id::EXPOSURE_ABSOLUTE, steps, &what)?;
                applied as f64 * EXPOSURE_UNIT_S
            }
        };
        Ok(CameraSettings::new(Seconds(exposure_s), gain))
    }
}

fn range_of(port: &dyn ControlPort, id: u32) -> io::Result<Option<Range>> {
    let control = port.query(id)?;
    Ok(control.map(|control| Range {
        minimum: control.minimum,
        maximum: control.maximum,
        step: control.step,
    }))
}

impl Range {
    /// The allowed value nearest to `wanted`.
    fn nearest(self, wanted: f64) -> i64 {
        let steps = ((wanted - self.minimum as f64) / self.step as f64).round();
        let last = (self.maximum - self.minimum) / self.step;
        // A float becomes the nearest integer, and NaN 0.
        self.minimum + (steps as i64).clamp(0, last.max(0)) * self.step
    }
}

impl Gain {
    /// The raw value of a gain factor, 1 being the lowest. A control that begins
    /// at 0 has no known unit, so that only its lowest value is a known factor.
    fn raw(self, factor: f64) -> Option<i64> {
        if self.range.minimum > 0 {
            Some(self.range.nearest(factor * self.range.minimum as f64))
        } else {
            (factor == 1.0).then_some(self.range.minimum)
        }
    }

    fn factor(self, raw: i64) -> Option<f64> {
        if self.range.minimum > 0 {
            Some(raw as f64 / self.range.minimum as f64)
        } else {
            (raw == self.range.minimum).then_some(1.0)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_rounded_to_the_controls_range() {
        let range = Range {
            minimum: 3,
            maximum: 2047,
            step: 2,
        };
        for (wanted, nearest) in [
            (0.0, 3),
            (5.9, 5),
            (6.1, 7),
            (1e12, 2047),
            (f64::INFINITY, 2047),
            (f64::NAN, 3),
        ] {
            assert_eq!(range.nearest(wanted), nearest, "{wanted}");
        }
    }

    #[test]
    fn a_gain_without_a_unit_is_only_1() {
        let gain = |minimum| Gain {
            id: id::GAIN,
            range: Range {
                minimum,
                maximum: 1000,
                step: 1,
            },
        };
        assert_eq!(gain(64).raw(2.5), Some(160));
        assert_eq!(gain(64).factor(160), Some(2.5));
        assert_eq!(gain(0).raw(1.0), Some(0));
        assert_eq!(gain(0).raw(2.0), None);
        assert_eq!(gain(0).factor(5), None);
    }
}
