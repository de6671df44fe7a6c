//! The manual stage of a simulated bench: what the person confirms happens there, by the
//! bench's own firmware, whose errors of position are then those of their hand.

use std::sync::{Arc, Mutex, PoisonError};

use super::grbl::{GrblConfig, GrblStage};
use super::kinematics::{AxisMap, TwoAxes};
use super::manual::{ManualConfig, ManualStage, Operator, Request};
use super::simulated::SimulatedBench;
use super::{DeviceError, LightStage};

/// The firmware that stands in for a hand which holds a lamp of as many channels.
pub fn firmware(channels: u8) -> GrblConfig {
    let axis = |reach_deg: f64| AxisMap {
        scale: 1.0,
        offset: -reach_deg,
        min: -reach_deg,
        max: reach_deg,
    };
    let on = ["M3 S1000", "M7", "M8"]
        .into_iter()
        .map(|command| vec![command.to_owned()]);
    GrblConfig {
        kinematics: TwoAxes {
            first: axis(360.0),
            second: axis(90.0),
            ..TwoAxes::unlimited()
        },
        feed_per_min: 1e5,
        lamp_on: on.take(usize::from(channels)).collect(),
        ..GrblConfig::of_port("", 115_200)
    }
}

/// The manual stage of this bench, which [`firmware`] moves.
///
/// # Errors
/// The firmware does not answer.
pub fn open(
    bench: &SimulatedBench,
    config: ManualConfig,
    person: Arc<dyn Operator>,
) -> Result<ManualStage, DeviceError> {
    let hand = Hand {
        person,
        stage: Mutex::new(bench.open_stage()?),
    };
    Ok(ManualStage::new(config, Arc::new(hand)))
}

struct Hand {
    person: Arc<dyn Operator>,
    stage: Mutex<GrblStage>,
}

impl Operator for Hand {
    fn ask(&self, request: Request) -> bool {
        if !self.person.ask(request) {
            return false;
        }
        let mut stage = self.stage.lock().unwrap_or_else(PoisonError::into_inner);
        let mut act = |is_first: bool| -> Result<(), DeviceError> {
            if !is_first {
                stage.home()?;
            }
            match request {
                Request::Place { angles, .. } => stage.move_to(angles).map(drop),
                Request::Lamp(lamp) => stage.set_lamp(lamp).map(drop),
            }
        };
        // Firmware moves once it is homed, a hand at once.
        act(true).or_else(|_| act(false)).is_ok()
    }

    fn tell(&self, request: Request) {
        self.person.tell(request);
    }
}
