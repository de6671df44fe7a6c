//! A stage that a person is: the light is placed and switched by hand, and every
//! step confirmed. How the person is asked is not known here.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use super::kinematics::FixedLights;
use super::{
    DeviceError, LampChannel, LampState, LightStage, StageActivity, StageInfo, StageStatus,
    StopHandle,
};
use crate::units::StageAngles;

/// What the person is asked to do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Request {
    /// Put the light where it shines from this direction.
    Place {
        /// The direction's number in the rig file, from 0.
        light: usize,
        /// The direction.
        angles: StageAngles,
    },
    /// Switch the lamp.
    Lamp(LampState),
}

/// As a person is told.
impl std::fmt::Display for Request {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Place { light, angles } => {
                write!(f, "place the light at direction {}: {angles}", light + 1)
            }
            Self::Lamp(LampState::Off) => f.write_str("turn the lamp off"),
            Self::Lamp(LampState::On(LampChannel(channel))) => {
                write!(f, "turn on channel {channel} of the lamp, and no other")
            }
        }
    }
}

/// Asks the person at the bench.
pub trait Operator: Send + Sync {
    /// Returns once the person has done it; false if they say that they have
    /// not, or nobody answers any more.
    fn ask(&self, request: Request) -> bool;
    /// Tells what must be done now, without waiting.
    fn tell(&self, request: Request);
}

/// Nobody: who is asked does nothing.
pub struct Nobody;

impl Operator for Nobody {
    fn ask(&self, _: Request) -> bool {
        false
    }
    fn tell(&self, _: Request) {}
}

/// A manual stage as its driver needs it.
#[derive(Clone, Debug, PartialEq)]
pub struct ManualConfig {
    /// Where the light may be placed.
    pub lights: FixedLights,
    /// Colour channels of the lamp, 1 to 3.
    pub channels: u8,
}

/// A stage moved by hand. Its lamp is what the person says it is.
pub struct ManualStage {
    config: ManualConfig,
    operator: Arc<dyn Operator>,
    info: StageInfo,
    homed: bool,
    placed: Option<usize>,
    lamp: Option<LampState>,
    stops: Arc<AtomicU64>,
    stops_seen: u64,
}

/// What its [`StageInfo`] calls the driver.
pub const DRIVER: &str = "manual";
/// What errors call it.
const NAME: &str = "the manual stage";

impl ManualStage {
    /// A stage that asks this operator. Nothing is asked yet.
    pub fn new(config: ManualConfig, operator: Arc<dyn Operator>) -> Self {
        Self {
            config,
            operator,
            info: StageInfo {
                driver: DRIVER.to_owned(),
                firmware: "by hand (unverified)".to_owned(),
                port: NAME.to_owned(),
                has_watchdog: false,
            },
            homed: false,
            placed: None,
            lamp: None,
            stops: Arc::default(),
            stops_seen: 0,
        }
    }

    fn ask(&mut self, request: Request) -> Result<(), DeviceError> {
        if self.operator.ask(request) {
            return Ok(());
        }
        self.homed = false;
        Err(DeviceError::Refused {
            device: NAME.to_owned(),
            command: match request {
                Request::Place { angles, .. } => format!("place the light at {angles}"),
                Request::Lamp(LampState::Off) => "lamp off".to_owned(),
                Request::Lamp(LampState::On(LampChannel(channel))) => {
                    format!("lamp on, channel {channel}")
                }
            },
            reason: "nobody confirmed it".to_owned(),
        })
    }

    fn check_homed(&mut self) -> Result<(), DeviceError> {
        let stops = self.stops.load(Ordering::Acquire);
        let stopped = std::mem::replace(&mut self.stops_seen, stops) != stops;
        self.homed &= !stopped;
        if self.homed {
            return Ok(());
        }
        Err(DeviceError::NotHomed {
            device: NAME.to_owned(),
            since: if stopped {
                "it was stopped"
            } else {
                "it began"
            }
            .to_owned(),
        })
    }

    fn state(&self) -> StageStatus {
        StageStatus {
            activity: if self.homed {
                StageActivity::Idle
            } else {
                StageActivity::Alarm
            },
            position: self
                .placed
                .map(|light| self.config.lights.directions[light]),
            lamp: None,
        }
    }
}

impl LightStage for ManualStage {
    fn info(&self) -> &StageInfo {
        &self.info
    }

    fn home(&mut self) -> Result<StageStatus, DeviceError> {
        self.placed = None;
        self.set_lamp(LampState::Off)?;
        self.stops_seen = self.stops.load(Ordering::Acquire);
        self.homed = true;
        Ok(self.state())
    }

    fn move_to(&mut self, target: StageAngles) -> Result<StageAngles, DeviceError> {
        let light = self
            .config
            .lights
            .nearest(target)
            .ok_or_else(|| DeviceError::OutOfReach {
                device: NAME.to_owned(),
                target,
                limits: self.config.lights.limits(),
            })?;
        self.check_homed()?;
        let angles = self.config.lights.directions[light];
        if self.placed != Some(light) {
            self.placed = None;
            self.ask(Request::Place { light, angles })?;
            self.placed = Some(light);
        }
        Ok(angles)
    }

    fn set_lamp(&mut self, lamp: LampState) -> Result<LampState, DeviceError> {
        if let LampState::On(LampChannel(channel)) = lamp {
            if channel >= self.config.channels {
                return Err(DeviceError::Refused {
                    device: NAME.to_owned(),
                    command: format!("lamp channel {channel}"),
                    reason: format!(
                        "the lamp has {} channels, counted from 0",
                        self.config.channels
                    ),
                });
            }
            self.check_homed()?;
        }
        if self.lamp != Some(lamp) {
            self.lamp = None;
            self.ask(Request::Lamp(lamp))?;
            self.lamp = Some(lamp);
        }
        Ok(lamp)
    }

    fn status(&mut self) -> Result<StageStatus, DeviceError> {
        Ok(self.state())
    }

    fn stop_handle(&self) -> Result<Box<dyn StopHandle>, DeviceError> {
        Ok(Box::new(ManualStop {
            operator: self.operator.clone(),
            stops: self.stops.clone(),
        }))
    }
}

impl Drop for ManualStage {
    fn drop(&mut self) {
        if matches!(self.lamp, Some(LampState::On(_))) {
            self.operator.tell(Request::Lamp(LampState::Off));
        }
    }
}

struct ManualStop {
    operator: Arc<dyn Operator>,
    stops: Arc<AtomicU64>,
}

impl StopHandle for ManualStop {
    fn stop(&mut self) -> Result<(), DeviceError> {
        self.stops.fetch_add(1, Ordering::AcqRel);
        self.operator.tell(Request::Lamp(LampState::Off));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Mutex;

    /// Does what it is asked to until it no longer wants to.
    #[derive(Default)]
    struct Scripted {
        asked: Mutex<Vec<Request>>,
        told: Mutex<Vec<Request>>,
        refuses: Mutex<bool>,
    }

    impl Operator for Scripted {
        fn ask(&self, request: Request) -> bool {
            self.asked.lock().unwrap().push(request);
            !*self.refuses.lock().unwrap()
        }
        fn tell(&self, request: Request) {
            self.told.lock().unwrap().push(request);
        }
    }

    fn angles(azimuth_deg: f64) -> StageAngles {
        StageAngles::new(azimuth_deg, 40.0)
    }

    #[test]
    fn every_step_is_asked_for_once_and_only_when_it_changes_something() {
        let operator = Arc::new(Scripted::default());
        let config = ManualConfig {
            lights: FixedLights {
                directions: vec![angles(0.0), angles(120.0)],
                tolerance_deg: 1.0,
            },
            channels: 1,
        };
        let mut stage = ManualStage::new(config, operator.clone());
        assert!(matches!(
            stage.move_to(angles(0.0)),
            Err(DeviceError::NotHomed { .. })
        ));
        stage.home().unwrap();
        let lit = LampState::On(LampChannel(0));
        for _ in 0..2 {
            assert_eq!(stage.move_to(angles(120.5)).unwrap(), angles(120.0));
            assert_eq!(stage.set_lamp(lit).unwrap(), lit);
        }
        let place = Request::Place {
            light: 1,
            angles: angles(120.0),
        };
        let expected = [Request::Lamp(LampState::Off), place, Request::Lamp(lit)];
        assert_eq!(*operator.asked.lock().unwrap(), expected);
        assert!(matches!(
            stage.move_to(angles(60.0)),
            Err(DeviceError::OutOfReach { .. })
        ));
        assert!(stage.set_lamp(LampState::On(LampChannel(1))).is_err());
        // A stop tells, and only homing goes on from there.
        stage.stop_handle().unwrap().stop().unwrap();
        assert!(matches!(
            stage.move_to(angles(0.0)),
            Err(DeviceError::NotHomed { .. })
        ));
        stage.home().unwrap();
        *operator.refuses.lock().unwrap() = true;
        let refused = stage.move_to(angles(0.0)).unwrap_err();
        assert!(
            refused.to_string().contains("nobody confirmed"),
            "{refused}"
        );
        assert_eq!(stage.status().unwrap().position, None);
        *operator.refuses.lock().unwrap() = false;
        stage.home().unwrap();
        stage.set_lamp(lit).unwrap();
        drop(stage);
        let off = Request::Lamp(LampState::Off);
        assert_eq!(*operator.told.lock().unwrap(), [off, off]);
    }
}
