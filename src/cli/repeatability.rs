//! `rig stage repeatability`: what repeated homing found.

use super::CliError;
use super::output::write_json;
use crate::device::StageInfo;
use crate::device::kinematics::{Kinematics, Mechanism};
use crate::out;
use crate::workflow::Repeatability;

/// Writes the result, in degrees or millimetres as the stage's axes have it.
pub fn report(
    found: &Repeatability,
    info: &StageInfo,
    kinematics: &Kinematics,
    json: bool,
) -> Result<(), CliError> {
    let unit = match kinematics {
        Kinematics::TwoAxes(axes) if matches!(axes.mechanism, Mechanism::Gantry { .. }) => "mm",
        _ => "degrees",
    };
    let (standard_deviation, largest) = (found.standard_deviation(), found.largest());
    if json {
        return write_json(&serde_json::json!({
            "stage": info,
            "unit": unit,
            "cycles": found.off.len(),
            "off": found.off,
            "standard_deviation": standard_deviation,
            "largest": largest,
        }));
    }
    out!("cycles              {}", found.off.len())?;
    let [first, second] = standard_deviation;
    out!("standard deviation  {first:.4} and {second:.4} {unit} (one homing)")?;
    let [first, second] = largest;
    out!("largest difference  {first:.4} and {second:.4} {unit}")
}
