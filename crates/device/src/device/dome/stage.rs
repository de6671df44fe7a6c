//! The stage that a dome is: a target chooses a light, the lamp lights it.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Weak};
use std::time::Duration;

use super::dmx::DmxPort;
use super::line::{DomeLine, KeepAlive};
use super::port::{LightPort, ReadBack};
use super::{DomeConfig, DomeWiring, Lit};
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
    pub(super) port: Arc<dyn LightPort>,
    info: StageInfo,
    /// The light that the last target chose.
    chosen: Option<usize>,
    lamp: Option<LampState>,
    unhomed_since: Option<String>,
    /// Stops from another thread, and how many of them are accounted for.
    stops: Arc<AtomicU64>,
    stops_seen: u64,
    restarts_seen: u64,
    /// Whether the firmware knows its temperature, as far as is known.
    has_temperature: bool,
    _keep_alive: Option<KeepAlive>,
}

impl DomeStage {
    /// Opens the port and asks the dome what it is. Nothing is switched on; a dome
    /// that cannot say whether it is lit is turned off, as its port may have been
    /// lost with a light on.
    pub fn open(config: DomeConfig) -> Result<Self, DeviceError> {
        let port = open_port(&config)?;
        let found = port.identify(config.connect_timeout.to_duration())?;
        let wanted = (config.lights.directions.len(), config.channels);
        if let Some((lights, channels)) = found.lights
            && (lights, channels) != wanted
        {
            let reason = format!(
                "the dome has {lights} lights of {channels} channels, not {} of {}",
                wanted.0, wanted.1
            );
            return Err(port.line().refused("info", &reason));
        }
        if !port.reports_lights() {
            port.show(None)?;
        }
        let keep_alive = found.watchdog.map(|watchdog| {
            let port: Weak<dyn LightPort> = Arc::downgrade(&port);
            KeepAlive::start(port, watchdog / 3)
        });
        let keep_alive = keep_alive.transpose().map_err(|source| DeviceError::Io {
            device: config.port.clone(),
            source,
        })?;
        let info = StageInfo {
            driver: match config.wiring {
                DomeWiring::Line => "dome".to_owned(),
                DomeWiring::Dmx { .. } => "dmx".to_owned(),
            },
            firmware: found.firmware,
            port: config.port.clone(),
            has_watchdog: found.watchdog.is_some(),
        };
        Ok(Self {
            lamp: None,
            info,
            chosen: None,
            unhomed_since: Some("it was connected".to_owned()),
            stops: Arc::default(),
            stops_seen: 0,
            restarts_seen: port.restarts(),
            has_temperature: true,
            _keep_alive: keep_alive,
            port,
            config,
        })
    }

    /// What has happened since the last look makes the state unknown.
    fn look_around(&mut self) {
        let stops = self.stops.load(Ordering::Acquire);
        let restarts = self.port.restarts();
        if restarts != self.restarts_seen {
            self.forget("the dome restarted");
        }
        if stops != self.stops_seen {
            self.forget("it was stopped");
        }
        (self.stops_seen, self.restarts_seen) = (stops, restarts);
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

    /// Brings the lights into a state and believes what the dome then says.
    fn show(&mut self, lit: Option<Lit>) -> Result<(), DeviceError> {
        let outcome = self.port.show(lit).and_then(|()| self.port.read_back());
        let is = match outcome {
            Ok(is) => is,
            Err(error) => {
                if !matches!(error, DeviceError::Refused { .. }) {
                    self.forget("a command was not answered as it should");
                }
                return Err(error);
            }
        };
        let same = match (is, lit) {
            (ReadBack::Unverified, _) | (ReadBack::Off, None) => true,
            (ReadBack::Lit(is), Some(wanted)) => is == wanted,
            _ => false,
        };
        if same {
            return Ok(());
        }
        let words = |lit: Lit| format!("light {}, channel {}", lit.light, lit.channel);
        Err(DeviceError::NotApplied {
            device: self.config.port.clone(),
            what: "the dome".to_owned(),
            is: match is {
                ReadBack::Off | ReadBack::Unverified => "off".to_owned(),
                ReadBack::Lit(is) => words(is),
                ReadBack::Dark(is) => format!("dark, without current, at {}", words(is)),
            },
            wanted: lit.map_or("off".to_owned(), words),
        })
    }

    fn lit(&self, light: usize, channel: LampChannel) -> Lit {
        Lit {
            light,
            channel: channel.0,
            level: self.config.level,
        }
    }
}

fn open_port(config: &DomeConfig) -> Result<Arc<dyn LightPort>, DeviceError> {
    let reply_timeout = config.reply_timeout.to_duration();
    Ok(match &config.wiring {
        DomeWiring::Line => Arc::new(DomeLine::open(&config.port, config.baud, reply_timeout)?),
        DomeWiring::Dmx { addresses } => {
            let port = DmxPort::open(&config.port, config.baud, addresses.clone())?;
            Arc::new(port)
        }
    })
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
        // Also what the last answers told.
        self.look_around();
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
        self.look_around();
        if lit.is_some() {
            self.check_homed()?;
        }
        self.lamp = Some(lamp);
        Ok(lamp)
    }

    fn status(&mut self) -> Result<StageStatus, DeviceError> {
        let is = self.port.read_back()?;
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
            lamp: match is {
                ReadBack::Off => Some(LampState::Off),
                ReadBack::Lit(lit) => Some(LampState::On(LampChannel(lit.channel))),
                ReadBack::Dark(_) | ReadBack::Unverified => None,
            },
        })
    }

    fn reports_lamp(&self) -> bool {
        self.port.reports_lights()
    }

    fn temperature_c(&mut self) -> Option<f64> {
        if !self.has_temperature {
            return None;
        }
        match self.port.temperature_c() {
            Ok(reading) => reading,
            Err(error) => {
                // Firmware of before answers that there is no such request.
                self.has_temperature = !matches!(error, DeviceError::Refused { .. });
                None
            }
        }
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
        // Two requests and what they are read back by; nothing moves.
        4 * self.config.reply_timeout.to_duration() + Duration::from_secs(1)
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
        if self.lamp != Some(LampState::Off) && self.show(None).is_err() {
            let _ = self.port.off_now();
        }
    }
}

struct DomeStop {
    port: Weak<dyn LightPort>,
    stops: Arc<AtomicU64>,
}

impl StopHandle for DomeStop {
    fn stop(&mut self) -> Result<(), DeviceError> {
        // A driver that is gone has turned the lights off.
        let Some(port) = self.port.upgrade() else {
            return Ok(());
        };
        self.stops.fetch_add(1, Ordering::AcqRel);
        turn_off(&*port)
    }
}

fn turn_off(port: &dyn LightPort) -> Result<(), DeviceError> {
    port.off_now()?;
    // Again in its turn, behind whatever was under way.
    port.show(None)?;
    match port.read_back()? {
        ReadBack::Off | ReadBack::Unverified => Ok(()),
        ReadBack::Lit(_) | ReadBack::Dark(_) => Err(DeviceError::NotApplied {
            device: port.line().device().to_owned(),
            what: "the dome".to_owned(),
            is: "lit".to_owned(),
            wanted: "off".to_owned(),
        }),
    }
}

/// Turns off a dome that no driver holds.
pub fn stop_port(config: &DomeConfig) -> Result<(), DeviceError> {
    turn_off(&*open_port(config)?)
}
