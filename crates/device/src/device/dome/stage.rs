//! The stage that a dome is: a target chooses a light, the lamp lights it.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Weak};
use std::time::Duration;

use super::dmx::DmxPort;
use super::{DomeConfig, Lit};
use crate::device::guardian::PortStop;
use crate::device::{
    DeviceError, LampChannel, LampState, LightStage, StageActivity, StageInfo, StageStatus,
    StageStep, StopHandle,
};
use crate::units::StageAngles;

/// A dome of fixed lights. Moving is choosing a light; `home` turns all off.
///
/// Dropping it turns the lights off.
pub struct DomeStage {
    config: DomeConfig,
    pub(super) port: Arc<DmxPort>,
    info: StageInfo,
    /// The light that the last target chose.
    chosen: Option<usize>,
    lamp: Option<LampState>,
    unhomed_since: Option<String>,
    /// Stops from another thread, and how many of them are accounted for.
    stops: Arc<AtomicU64>,
    stops_seen: u64,
}

impl DomeStage {
    /// Opens the port and asks the interface what it is. Nothing is switched on; the lights are
    /// turned off, as the port may have been lost with one on.
    pub fn open(config: DomeConfig) -> Result<Self, DeviceError> {
        let port = open_port(&config)?;
        let firmware = port.identify(config.connect_timeout.to_duration())?;
        port.show(None)?;
        let info = StageInfo {
            driver: "dmx".to_owned(),
            firmware,
            port: config.port.clone(),
            has_watchdog: false,
        };
        Ok(Self {
            lamp: None,
            info,
            chosen: None,
            unhomed_since: Some("it was connected".to_owned()),
            stops: Arc::default(),
            stops_seen: 0,
            port,
            config,
        })
    }

    /// What has happened since the last look makes the state unknown.
    fn look_around(&mut self) {
        let stops = self.stops.load(Ordering::Acquire);
        if stops != self.stops_seen {
            self.forget("it was stopped");
        }
        self.stops_seen = stops;
    }

    fn forget(&mut self, since: &str) {
        self.unhomed_since = Some(since.to_owned());
        self.chosen = None;
    }

    fn check_homed(&mut self) -> Result<(), DeviceError> {
        self.look_around();
        match &self.unhomed_since {
            None => Ok(()),
            Some(since) => Err(DeviceError::NotHomed {
                device: self.config.port.clone(),
                since: since.clone(),
            }),
        }
    }

    /// Sends the lights' new state.
    fn show(&mut self, lit: Option<Lit>) -> Result<(), DeviceError> {
        let shown = self.port.show(lit);
        if shown
            .as_ref()
            .is_err_and(|error| !matches!(error, DeviceError::Refused { .. }))
        {
            self.forget("a command was not taken as it should");
        }
        shown
    }

    fn lit(&self, light: usize, channel: LampChannel) -> Lit {
        Lit {
            light,
            channel: channel.0,
            level: self.config.level,
        }
    }
}

fn open_port(config: &DomeConfig) -> Result<Arc<DmxPort>, DeviceError> {
    let addresses = config.addresses.clone();
    DmxPort::open(&config.port, config.baud, addresses).map(Arc::new)
}

impl LightStage for DomeStage {
    fn info(&self) -> &StageInfo {
        &self.info
    }

    fn home(&mut self) -> Result<StageStatus, DeviceError> {
        self.forget("homing began");
        self.lamp = None;
        self.look_around();
        self.show(None)?;
        self.lamp = Some(LampState::Off);
        self.unhomed_since = None;
        self.status()
    }

    fn move_to(&mut self, target: StageAngles) -> Result<StageAngles, DeviceError> {
        let light = self
            .config
            .lights
            .nearest(target)
            .ok_or_else(|| DeviceError::OutOfReach {
                device: self.config.port.clone(),
                target,
                limits: self.config.lights.limits(),
            })?;
        self.check_homed()?;
        // A lamp that is on goes on at the new place.
        if let Some(LampState::On(channel)) = self.lamp {
            self.lamp = None;
            self.show(Some(self.lit(light, channel)))?;
            self.lamp = Some(LampState::On(channel));
        }
        self.chosen = Some(light);
        Ok(self.config.lights.directions[light])
    }

    fn set_lamp(&mut self, lamp: LampState) -> Result<LampState, DeviceError> {
        let lit = match lamp {
            LampState::Off => None,
            LampState::On(channel) => {
                if channel.0 >= self.config.channels {
                    return Err(self.port.line().refused(
                        &format!("lamp channel {}", channel.0),
                        &format!(
                            "the lamp has {} channels, counted from 0",
                            self.config.channels
                        ),
                    ));
                }
                self.check_homed()?;
                let light = self.chosen.ok_or_else(|| {
                    let reason = "no light was chosen: move to a direction first";
                    self.port.line().refused("lamp on", reason)
                })?;
                Some(self.lit(light, channel))
            }
        };
        self.lamp = None;
        self.show(lit)?;
        if lit.is_some()
            && let Err(stopped) = self.check_homed()
        {
            // The stop came between the look and the light.
            self.show(None)?;
            return Err(stopped);
        }
        self.lamp = Some(lamp);
        Ok(lamp)
    }

    fn status(&mut self) -> Result<StageStatus, DeviceError> {
        self.port.line().check_connected()?;
        self.look_around();
        let homed = self.unhomed_since.is_none();
        Ok(StageStatus {
            activity: if homed {
                StageActivity::Idle
            } else {
                StageActivity::Alarm
            },
            position: self
                .chosen
                .map(|light| self.config.lights.directions[light]),
            // DMX does not say.
            lamp: None,
        })
    }

    fn reports_lamp(&self) -> bool {
        false
    }

    fn port_stop(&self) -> Result<Option<PortStop>, DeviceError> {
        Ok(Some(PortStop {
            port: self.port.line().duplicate()?,
            name: self.config.port.clone(),
            exchanges: self.port.off_exchanges(),
            reports_lamp: self.reports_lamp(),
            gate: self.port.line().gate(),
        }))
    }

    fn longest(&self, _: StageStep) -> Duration {
        // A packet; nothing moves.
        Duration::from_secs(1)
    }

    fn stop_handle(&self) -> Result<Box<dyn StopHandle>, DeviceError> {
        Ok(Box::new(DomeStop {
            port: Arc::downgrade(&self.port),
            stops: self.stops.clone(),
        }))
    }
}

impl Drop for DomeStage {
    fn drop(&mut self) {
        if self.lamp != Some(LampState::Off) {
            let _ = self.port.show(None);
        }
    }
}

struct DomeStop {
    port: Weak<DmxPort>,
    stops: Arc<AtomicU64>,
}

impl StopHandle for DomeStop {
    fn stop(&mut self) -> Result<(), DeviceError> {
        // A driver that is gone has turned the lights off.
        let Some(port) = self.port.upgrade() else {
            return Ok(());
        };
        self.stops.fetch_add(1, Ordering::AcqRel);
        port.show(None)
    }
}

/// Turns off a dome that no driver holds.
pub fn stop_port(config: &DomeConfig) -> Result<(), DeviceError> {
    open_port(config)?.show(None)
}
