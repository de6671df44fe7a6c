//! From light directions to what a stage does for them, and back, within its
//! limits: two axes that carry one lamp, or lights that stand still.

mod axis;
mod fixed_lights;
mod two_axes;

pub use axis::AxisMap;
pub use fixed_lights::FixedLights;
pub use two_axes::{Mechanism, Pose, TwoAxes};

use super::DeviceError;
use crate::units::StageAngles;

/// How a stage brings light from a direction.
#[derive(Clone, Debug, PartialEq)]
pub enum Kinematics {
    /// One lamp on two axes.
    TwoAxes(TwoAxes),
    /// Many lamps, or places for a lamp, each in its direction.
    FixedLights(FixedLights),
}

impl Kinematics {
    /// Whether light can come from this direction. `device` is what the error
    /// calls the stage.
    pub fn reach(&self, device: &str, target: StageAngles) -> Result<(), DeviceError> {
        if self.reaches(target) {
            return Ok(());
        }
        Err(DeviceError::OutOfReach {
            device: device.to_owned(),
            target,
            limits: self.limits(),
        })
    }

    /// Whether light can come from this direction.
    pub fn reaches(&self, target: StageAngles) -> bool {
        match self {
            Self::TwoAxes(axes) => axes.solve(target).is_some(),
            Self::FixedLights(lights) => lights.nearest(target).is_some(),
        }
    }

    /// The limits as text.
    pub fn limits(&self) -> String {
        match self {
            Self::TwoAxes(axes) => axes.limits(),
            Self::FixedLights(lights) => lights.limits(),
        }
    }

    /// Distance of the lamp from the stage's centre when light comes from this
    /// direction, mm; `None` where the mechanism does not determine it or not reach.
    pub fn lamp_distance_mm(&self, target: StageAngles) -> Option<f64> {
        match self {
            Self::TwoAxes(axes) => axes.lamp(axes.solve(target)?).1,
            Self::FixedLights(_) => None,
        }
    }
}
