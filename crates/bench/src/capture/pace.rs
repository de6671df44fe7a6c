//! How fast the devices of a rig are.

use crate::config::RigConfig;
use crate::units::Seconds;

/// How fast the devices are, for the estimate only.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pace {
    /// Speed of the stage, degrees per second; > 0.
    pub stage_deg_s: f64,
    /// Time to home.
    pub homing: Seconds,
    /// Time between frames where the exposure is shorter.
    pub frame_interval: Seconds,
    /// What a simulated bench computes before a light's first frame; 0 of real ones.
    pub view: Seconds,
}

/// A simulated bench computes for so long what a light shows, on two processors.
const SIMULATED_VIEW: Seconds = Seconds(2.0);

impl Pace {
    /// Of a rig.
    pub fn of_rig(rig: &RigConfig) -> Self {
        let (stage_deg_s, homing) = rig.stage.pace();
        let simulation = rig.simulation.as_ref();
        Self {
            stage_deg_s,
            homing,
            frame_interval: Seconds(simulation.map_or(1.0 / 30.0, |s| s.camera.frame_interval_s)),
            view: simulation.map_or(Seconds(0.0), |_| SIMULATED_VIEW),
        }
    }
}
