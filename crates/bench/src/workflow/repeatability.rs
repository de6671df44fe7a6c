//! How well a stage finds its reference switches: repeated homing.

use std::sync::atomic::{AtomicBool, Ordering};

use super::notice::{Notice, Observer};
use crate::capture::reach::StageReach;
use crate::device::kinematics::Kinematics;
use crate::device::{DeviceError, LightStage};
use crate::units::StageAngles;

/// Result of repeated homing.
#[derive(Clone, Debug, PartialEq)]
pub struct Repeatability {
    /// Position found minus expected, of both axes in each cycle, degrees or mm as the axes.
    pub off: Vec<[f64; 2]>,
}

/// Homes, then in each cycle drives away, seeks the switches with the steps counted, homes.
/// Ends early once `stopped`. `None` if the stage cannot measure it.
///
/// # Errors
/// Those of the stage.
pub fn measure_repeatability(
    stage: &mut dyn LightStage,
    kinematics: &Kinematics,
    cycles: u32,
    stopped: &AtomicBool,
    observer: &dyn Observer,
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
        observer.notice(Notice::HomingCycle {
            cycle,
            of: cycles,
            off: check.off,
        });
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
    /// Standard deviation of one homing, of each axis: each cycle is the difference of two.
    pub fn standard_deviation(&self) -> [f64; 2] {
        let n = self.off.len().max(1) as f64;
        [0, 1].map(|axis| {
            let rms = (self.off.iter().map(|off| off[axis].powi(2)).sum::<f64>() / n).sqrt();
            rms / std::f64::consts::SQRT_2
        })
    }

    /// Largest difference of each axis.
    pub fn largest(&self) -> [f64; 2] {
        [0, 1].map(|axis| {
            self.off
                .iter()
                .map(|off| off[axis].abs())
                .fold(0.0, f64::max)
        })
    }
}
