//! `rig stage repeatability`: repeated homing, and how far the reference
//! switches are found from where they were.

use std::sync::atomic::{AtomicBool, Ordering};

use super::output::write_json;
use super::{CliError, Context};
use crate::capture::reach::StageReach;
use crate::device::kinematics::Kinematics;
use crate::device::{DeviceError, LightStage, StageInfo};
use crate::out;
use crate::units::StageAngles;

/// What repeated homing found.
pub struct Repeatability {
    /// Found minus expected of each axis in each cycle, degrees or mm.
    off: Vec<[f64; 2]>,
}

/// Homes, then as often as wanted: drives away, seeks the switches with the
/// steps counted, homes. `None` if the stage cannot tell.
pub fn measure(
    stage: &mut dyn LightStage,
    kinematics: &Kinematics,
    cycles: u32,
    stopped: &AtomicBool,
    context: &Context,
) -> Result<Option<Repeatability>, DeviceError> {
    let away = away(kinematics);
    stage.home()?;
    let mut off = Vec::new();
    for cycle in 1..=cycles {
        if stopped.load(Ordering::Acquire) {
            break;
        }
        if let Some(target) = away {
            stage.move_to(target)?;
        }
        let Some(check) = stage.check_reference()? else {
            return Ok(None);
        };
        context.note(format!(
            "cycle {cycle} of {cycles}: off by {:.4} and {:.4}",
            check.off[0], check.off[1]
        ));
        off.push(check.off);
        stage.home()?;
    }
    Ok(Some(Repeatability { off }))
}

/// A direction well within the limits.
fn away(kinematics: &Kinematics) -> Option<StageAngles> {
    let candidates = StageReach::free(kinematics.clone()).candidates();
    candidates.get(candidates.len() / 2).copied()
}

impl Repeatability {
    /// Root mean square of each axis: of the difference of two findings.
    fn rms(&self) -> [f64; 2] {
        let n = self.off.len().max(1) as f64;
        [0, 1].map(|axis| (self.off.iter().map(|off| off[axis].powi(2)).sum::<f64>() / n).sqrt())
    }

    fn largest(&self) -> [f64; 2] {
        [0, 1].map(|axis| {
            self.off
                .iter()
                .map(|off| off[axis].abs())
                .fold(0.0, f64::max)
        })
    }

    /// Writes it, in degrees or millimetres as the stage's axes have it.
    pub fn report(&self, info: &StageInfo, unit: &str, json: bool) -> Result<(), CliError> {
        let standard_deviation = self.rms().map(|rms| rms / std::f64::consts::SQRT_2);
        let largest = self.largest();
        if json {
            return write_json(&serde_json::json!({
                "stage": info,
                "unit": unit,
                "cycles": self.off.len(),
                "off": self.off,
                "standard_deviation": standard_deviation,
                "largest": largest,
            }));
        }
        out!("cycles              {}", self.off.len())?;
        let [first, second] = standard_deviation;
        out!("standard deviation  {first:.4} and {second:.4} {unit} (one homing)")?;
        out!(
            "largest difference  {:.4} and {:.4} {unit}",
            largest[0],
            largest[1]
        )
    }
}

/// What the axes' coordinates are counted in.
pub fn unit(kinematics: &Kinematics) -> &'static str {
    use crate::device::kinematics::Mechanism;
    match kinematics {
        Kinematics::TwoAxes(axes) if matches!(axes.mechanism, Mechanism::Gantry { .. }) => "mm",
        _ => "degrees",
    }
}
