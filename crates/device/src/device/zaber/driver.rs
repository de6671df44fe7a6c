//! The stage driver: homing, moves, lamp and status over a [`Link`].

use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};

use super::codes::{self, Trust};
use super::link::Link;
use super::protocol::{Reply, command};
use super::{AxisAddress, LampSwitch, ZaberConfig};
use crate::device::guardian::{Exchange, PortStop};
use crate::device::kinematics::Pose;
use crate::device::{
    AlarmCause, DeviceError, FirmwareFault, LampChannel, LampState, LightStage, ReferenceCheck,
    StageActivity, StageInfo, StageStatus, StageStep, StopHandle,
};
use crate::units::StageAngles;

/// A question is asked this often before its device counts as lost.
const ATTEMPTS: u32 = 3;
/// How long each answer to a stop may take, and where one did not come.
const ANSWERED: Duration = Duration::from_secs(1);
const ANSWERED_AFTER_SILENCE: Duration = Duration::from_millis(300);
/// Longest time that axes take to come to rest after `stop`.
const STANDS: Duration = Duration::from_secs(2);
/// Longest pause between two looks at a motion.
const POLL_PAUSE: Duration = Duration::from_millis(50);
/// Data of `maxspeed` per microstep/s, and 10⁴ times that of `accel` per microstep/s².
const SPEED_UNIT: f64 = 1.6384;

/// A light stage on Zaber devices.
///
/// Dropping it turns the lamp off and ends any motion.
pub struct ZaberStage {
    config: ZaberConfig,
    link: Arc<Link>,
    info: StageInfo,
    axes: [AxisSettings; 2],
    lamp: Option<LampState>,
    /// A command that moves the stage is under way.
    in_motion: bool,
    /// The devices have spoken: before, there is nothing to turn off.
    is_alive: bool,
}

/// What an axis says about itself, in microsteps and seconds.
#[derive(Clone, Copy, Debug, Default)]
struct AxisSettings {
    min: f64,
    max: f64,
    speed: f64,
    acceleration: f64,
}

impl ZaberStage {
    /// Opens the port and asks the devices what they are. Nothing moves; replies
    /// with checksums are switched on (`comm.checksum`). The position is unknown
    /// until [`home`](LightStage::home).
    pub fn open(config: ZaberConfig) -> Result<Self, DeviceError> {
        let info = StageInfo {
            driver: "zaber".to_owned(),
            firmware: String::new(),
            port: config.port.clone(),
            has_watchdog: false,
        };
        let mut stage = Self {
            link: Arc::new(Link::open(&config.port, config.baud)?),
            config,
            info,
            axes: [AxisSettings::default(); 2],
            lamp: None,
            in_motion: false,
            is_alive: false,
        };
        for device in stage.devices() {
            let timeout = stage.config.connect_timeout.to_duration();
            stage.link.ask(device, 0, "", timeout, 10)?;
            stage.is_alive = true;
            stage.command(device, 0, "set comm.checksum 1")?;
        }
        stage.identify()?;
        stage.lamp = stage.read_lamp()?;
        Ok(stage)
    }

    /// The devices that are used, each once.
    fn devices(&self) -> Vec<u8> {
        let lamps = self.config.lamp.iter().map(|switch| match switch {
            LampSwitch::Output { device, .. } => *device,
            LampSwitch::Illuminator(address) => address.device,
        });
        let axes = self.config.axes.iter().map(|address| address.device);
        let mut devices: Vec<u8> = axes.chain(lamps).collect();
        devices.sort_unstable();
        devices.dedup();
        devices
    }

    fn identify(&mut self) -> Result<(), DeviceError> {
        let device = self.config.axes[0].device;
        let version = self.get(device, 0, "version")?;
        if version < 6.0 {
            return Err(DeviceError::Firmware {
                device: self.config.port.clone(),
                fault: FirmwareFault::Old {
                    is: format!("Zaber {version}"),
                    needed: "Zaber 6",
                },
            });
        }
        let serial = self.get(device, 0, "system.serial")?;
        self.info.firmware = format!("{version} (serial number {serial})");
        for (index, address) in self.config.axes.into_iter().enumerate() {
            let get = |setting| self.get(address.device, address.axis, setting);
            let settings = AxisSettings {
                min: get("limit.min")?,
                max: get("limit.max")?,
                speed: get("maxspeed")? / SPEED_UNIT,
                acceleration: get("accel")? * 1e4 / SPEED_UNIT,
            };
            self.check_travel(index, address, settings)?;
            self.axes[index] = settings;
        }
        Ok(())
    }

    /// The configured limits must be within the device's.
    fn check_travel(
        &self,
        index: usize,
        address: AxisAddress,
        settings: AxisSettings,
    ) -> Result<(), DeviceError> {
        let map = self.config.kinematics.axes()[index];
        for limit in [map.min, map.max] {
            let position = map.position(limit);
            let within = position >= settings.min - 1.0 && position <= settings.max + 1.0;
            if limit.is_finite() && !within {
                let reason = format!(
                    "the limit {limit} is microstep {position:.0}, but the device goes from {} to {}",
                    settings.min, settings.max
                );
                let axis = format!("axis {address}");
                return Err(self.link.line().refused(&axis, &reason));
            }
        }
        Ok(())
    }

    fn reply_timeout(&self) -> Duration {
        self.config.reply_timeout.to_duration()
    }

    /// Something to do, sent once.
    fn command(&self, device: u8, axis: u8, words: &str) -> Result<Reply, DeviceError> {
        self.link.ask(device, axis, words, self.reply_timeout(), 1)
    }

    /// A question, asked again where the answer is lost.
    fn question(&self, device: u8, axis: u8, words: &str) -> Result<Reply, DeviceError> {
        self.link
            .ask(device, axis, words, self.reply_timeout(), ATTEMPTS)
    }

    /// The number that a setting has.
    fn get(&self, device: u8, axis: u8, setting: &str) -> Result<f64, DeviceError> {
        let reply = self.question(device, axis, &format!("get {setting}"))?;
        let number = reply
            .data
            .parse()
            .ok()
            .filter(|value: &f64| value.is_finite());
        number.ok_or_else(|| {
            let expected = format!("the number of {setting}");
            self.link.line().garbled(&reply.data, &expected)
        })
    }

    fn pose(&self) -> Result<Pose, DeviceError> {
        let mut pose = Pose([0.0; 2]);
        let maps = self.config.kinematics.axes();
        for (index, address) in self.config.axes.into_iter().enumerate() {
            let position = self.get(address.device, address.axis, "pos")?;
            pose.0[index] = maps[index].coordinate(position);
        }
        Ok(pose)
    }

    /// Whether any axis moves.
    fn is_busy(&self) -> Result<bool, DeviceError> {
        let mut busy = false;
        for address in self.config.axes {
            busy |= self.question(address.device, address.axis, "")?.busy;
        }
        Ok(busy)
    }

    fn alarm(&self, reason: String) -> DeviceError {
        DeviceError::Alarm {
            device: self.config.port.clone(),
            cause: AlarmCause::Other,
            reason,
        }
    }

    /// An error if the position is unknown.
    fn check_homed(&self) -> Result<(), DeviceError> {
        let known = self.link.known();
        if let Some(fault) = known.fault.clone() {
            return Err(self.alarm(fault));
        }
        match known.unhomed_since.clone() {
            Some(since) => Err(DeviceError::NotHomed {
                device: self.config.port.clone(),
                since,
            }),
            None => Ok(()),
        }
    }

    /// Waits until both axes stand; `check` looks at every poll for what ends
    /// the wait early.
    fn wait_until_idle(
        &self,
        timeout: Duration,
        check: impl Fn(&Self) -> Result<(), DeviceError>,
    ) -> Result<(), DeviceError> {
        let start = Instant::now();
        let mut pause = Duration::from_millis(1);
        loop {
            let busy = self.is_busy()?;
            check(self)?;
            if !busy {
                return Ok(());
            }
            if start.elapsed() > timeout {
                self.link.forget_position("a motion did not end in time");
                return Err(self.link.line().no_reply("the end of a motion", timeout));
            }
            std::thread::sleep(pause);
            pause = (2 * pause).min(POLL_PAUSE);
        }
    }

    /// Drives both axes at once and waits until the stage stands there.
    fn drive(&mut self, from: Pose, to: Pose) -> Result<Pose, DeviceError> {
        // Twice what it should take, and something for the devices themselves.
        let timeout = 2 * self.duration(from, to) + self.reply_timeout() + Duration::from_secs(1);
        self.check_homed()?;
        self.in_motion = true;
        let maps = self.config.kinematics.axes().map(|map| *map);
        for (index, address) in self.config.axes.into_iter().enumerate() {
            let target = maps[index].position(to.0[index]).round() as i64;
            let words = format!("move abs {target}");
            self.command(address.device, address.axis, &words)?;
        }
        self.wait_until_idle(timeout, Self::check_homed)?;
        let reached = self.pose()?;
        self.check_homed()?;
        self.in_motion = false;
        let off_deg = self.config.kinematics.distance_deg(reached, to);
        if off_deg.is_nan() || off_deg > self.config.position_tolerance_deg {
            return Err(DeviceError::NotApplied {
                device: self.config.port.clone(),
                what: "position".to_owned(),
                is: self.config.kinematics.angles(reached).to_string(),
                wanted: self.config.kinematics.angles(to).to_string(),
            });
        }
        Ok(reached)
    }

    /// How long a move of both axes at once takes by their speed and acceleration.
    fn duration(&self, from: Pose, to: Pose) -> Duration {
        let maps = self.config.kinematics.axes();
        let longest_s = (0..2)
            .map(|index| {
                let way = ((to.0[index] - from.0[index]) * maps[index].scale).abs();
                let axis = self.axes[index];
                way / axis.speed + axis.speed / axis.acceleration
            })
            .fold(0.0, f64::max);
        Duration::try_from_secs_f64(longest_s).unwrap_or(Duration::from_secs(600))
    }

    /// Switches one channel.
    fn switch(
        link: &Link,
        switch: LampSwitch,
        on: bool,
        timeout: Duration,
    ) -> Result<(), DeviceError> {
        let (device, axis, words) = switch.command(on);
        let reply = link.ask(device, axis, &words, timeout, ATTEMPTS);
        reply.map(drop)
    }

    /// Whether a channel is on by its device's word.
    fn is_on(link: &Link, switch: LampSwitch, timeout: Duration) -> Result<bool, DeviceError> {
        let (reply, on, off) = match switch {
            LampSwitch::Output { device, output } => {
                let words = format!("io get do {output}");
                (link.ask(device, 0, &words, timeout, ATTEMPTS)?, "1", "0")
            }
            LampSwitch::Illuminator(AxisAddress { device, axis }) => {
                let words = "get lamp.status";
                (link.ask(device, axis, words, timeout, ATTEMPTS)?, "2", "1")
            }
        };
        match reply.data.as_str() {
            data if data == on => Ok(true),
            data if data == off => Ok(false),
            data => Err(link.line().garbled(data, "the state of a lamp")),
        }
    }

    /// The lamp by its devices' word; `None` where more than one channel is on.
    fn read_lamp(&self) -> Result<Option<LampState>, DeviceError> {
        let mut lit = Vec::new();
        for (channel, &switch) in self.config.lamp.iter().enumerate() {
            if Self::is_on(&self.link, switch, self.reply_timeout())? {
                lit.push(LampChannel(channel as u8));
            }
        }
        Ok(match lit[..] {
            [] => Some(LampState::Off),
            [channel] => Some(LampState::On(channel)),
            _ => None,
        })
    }

    fn wanted_channel(&self, lamp: LampState) -> Result<Option<usize>, DeviceError> {
        let LampState::On(LampChannel(channel)) = lamp else {
            return Ok(None);
        };
        let channels = self.config.lamp.len();
        if usize::from(channel) < channels {
            return Ok(Some(usize::from(channel)));
        }
        Err(self.link.line().refused(
            &format!("lamp channel {channel}"),
            &format!("the lamp has {channels} channels, counted from 0"),
        ))
    }

    fn stopper(&self) -> ZaberStop {
        ZaberStop {
            link: Arc::downgrade(&self.link),
            axes: self.config.axes,
            lamp: self.config.lamp.clone(),
            reply_timeout: self.reply_timeout(),
            timeout: self.config.connect_timeout.to_duration().min(STANDS),
        }
    }
}

impl LightStage for ZaberStage {
    fn info(&self) -> &StageInfo {
        &self.info
    }

    fn home(&mut self) -> Result<StageStatus, DeviceError> {
        let stops = {
            let mut known = self.link.known();
            known.unhomed_since = Some("homing began".to_owned());
            known.fault = None;
            known.stops
        };
        self.in_motion = true;
        for address in self.config.axes {
            // Asked again where what is left of a damaged answer spoils the first.
            self.question(address.device, address.axis, "warnings clear")?;
            self.link.known().fault = None;
            self.command(address.device, address.axis, "home")?;
        }
        self.wait_until_idle(self.config.homing_timeout.to_duration(), |stage| {
            let known = stage.link.known();
            match &known.fault {
                Some(fault) => Err(stage.alarm(fault.clone())),
                None if known.stops != stops => Err(DeviceError::NotHomed {
                    device: stage.config.port.clone(),
                    since: "it was stopped".to_owned(),
                }),
                None => Ok(()),
            }
        })?;
        for address in self.config.axes {
            let reply = self.question(address.device, address.axis, "warnings")?;
            let flags = reply.data.split(' ').skip(1);
            let mut doubts = flags.filter(|flag| codes::trust(flag) != Trust::Sound);
            if let Some(flag) = doubts.next() {
                return Err(self.alarm(format!("after homing, {}", codes::warning(flag))));
            }
        }
        self.in_motion = false;
        {
            let mut known = self.link.known();
            if known.stops == stops {
                known.unhomed_since = None;
            }
        }
        self.status()
    }

    fn move_to(&mut self, target: StageAngles) -> Result<StageAngles, DeviceError> {
        let kinematics = self.config.kinematics;
        let wanted = kinematics
            .solve(target)
            .ok_or_else(|| DeviceError::OutOfReach {
                device: self.config.port.clone(),
                target,
                limits: kinematics.limits(),
            })?;
        self.check_homed()?;
        let mut at = self.pose()?;
        if let Some(start) = kinematics.approach(at, wanted) {
            at = self.drive(at, start)?;
        }
        let reached = self.drive(at, wanted)?;
        Ok(kinematics.angles_like(target, wanted, reached))
    }

    fn set_lamp(&mut self, lamp: LampState) -> Result<LampState, DeviceError> {
        let wanted = self.wanted_channel(lamp)?;
        self.lamp = None;
        let timeout = self.reply_timeout();
        // Never two channels at once: off first.
        let mut failed = None;
        for (channel, &switch) in self.config.lamp.iter().enumerate() {
            if Some(channel) != wanted
                && let Err(error) = Self::switch(&self.link, switch, false, timeout)
            {
                failed.get_or_insert(error);
            }
        }
        if let Some(error) = failed {
            return Err(error);
        }
        if let Some(channel) = wanted {
            Self::switch(&self.link, self.config.lamp[channel], true, timeout)?;
        }
        self.lamp = self.read_lamp()?;
        if self.lamp == Some(lamp) {
            return Ok(lamp);
        }
        let words = |lamp| match lamp {
            Some(LampState::Off) => "off".to_owned(),
            Some(LampState::On(LampChannel(channel))) => format!("channel {channel}"),
            None => "several channels".to_owned(),
        };
        Err(DeviceError::NotApplied {
            device: self.config.port.clone(),
            what: "the lamp".to_owned(),
            is: words(self.lamp),
            wanted: words(Some(lamp)),
        })
    }

    fn status(&mut self) -> Result<StageStatus, DeviceError> {
        let busy = self.is_busy()?;
        let pose = self.pose()?;
        self.lamp = self.read_lamp()?;
        let homed = self.check_homed().is_ok();
        Ok(StageStatus {
            activity: match (busy, homed) {
                (true, _) => StageActivity::Moving,
                (false, true) => StageActivity::Idle,
                (false, false) => StageActivity::Alarm,
            },
            position: homed.then(|| self.config.kinematics.angles(pose)),
            lamp: self.lamp,
        })
    }

    fn reports_lamp(&self) -> bool {
        true
    }

    fn check_reference(&mut self) -> Result<Option<ReferenceCheck>, DeviceError> {
        self.check_homed()?;
        self.in_motion = true;
        for address in self.config.axes {
            // To the home sensor without taking its position over.
            let words = "tools gotolimit home neg 2 0";
            self.command(address.device, address.axis, words)?;
        }
        let timeout = self.config.homing_timeout.to_duration();
        self.wait_until_idle(timeout, Self::check_homed)?;
        self.in_motion = false;
        let mut off = [0.0; 2];
        for (index, address) in self.config.axes.into_iter().enumerate() {
            let get = |setting| self.get(address.device, address.axis, setting);
            let scale = self.config.kinematics.axes()[index].scale;
            off[index] = (get("pos")? - get("limit.home.pos")?) / scale;
        }
        Ok(Some(ReferenceCheck {
            off,
            allowed: self.config.position_tolerance_deg,
        }))
    }

    fn port_stop(&self) -> Result<Option<PortStop>, DeviceError> {
        let to = |device, axis, words: &str| command(device, axis, 0, words).into_bytes();
        let axes = &self.config.axes;
        let mut exchanges: Vec<Exchange> = axes
            .iter()
            .map(|at| Exchange::new(&to(at.device, at.axis, "stop"), &[b" OK "]))
            .collect();
        for switch in &self.config.lamp {
            let (device, axis, words) = switch.command(false);
            exchanges.push(Exchange::new(&to(device, axis, &words), &[b" OK "]));
        }
        for at in axes {
            exchanges.push(Exchange::new(&to(at.device, at.axis, ""), &[b" IDLE "]));
        }
        Ok(Some(PortStop {
            port: self.link.line().duplicate()?,
            name: self.config.port.clone(),
            exchanges,
            reports_lamp: self.reports_lamp(),
            gate: self.link.line().gate(),
        }))
    }

    fn longest(&self, step: StageStep) -> Duration {
        let [from, to] = self.config.kinematics.whole_travel();
        let homing = self.config.homing_timeout.to_duration();
        step.longest(homing, self.duration(from, to), self.reply_timeout(), 4)
    }

    fn stop_handle(&self) -> Result<Box<dyn StopHandle>, DeviceError> {
        Ok(Box::new(self.stopper()))
    }
}

impl Drop for ZaberStage {
    fn drop(&mut self) {
        if !self.is_alive || (self.lamp == Some(LampState::Off) && !self.in_motion) {
            return;
        }
        let turned_off = !self.in_motion && self.set_lamp(LampState::Off).is_ok();
        if !turned_off {
            let _ = self.stopper().stop();
        }
    }
}

/// Stops a [`ZaberStage`] without its driver.
struct ZaberStop {
    link: Weak<Link>,
    axes: [AxisAddress; 2],
    lamp: Vec<LampSwitch>,
    reply_timeout: Duration,
    timeout: Duration,
}

impl StopHandle for ZaberStop {
    fn stop(&mut self) -> Result<(), DeviceError> {
        // A driver that is gone has turned the lamp off and ended its motion.
        let Some(link) = self.link.upgrade() else {
            return Ok(());
        };
        {
            let mut known = link.known();
            known.stops += 1;
            known.unhomed_since = Some("it was stopped".to_owned());
        }
        stop(
            &link,
            &self.axes,
            &self.lamp,
            self.reply_timeout,
            self.timeout,
        )
    }
}

/// Motion first, then the lamp; both are requested even where one fails, and
/// verified by what the devices then say.
fn stop(
    link: &Link,
    axes: &[AxisAddress],
    lamp: &[LampSwitch],
    reply_timeout: Duration,
    timeout: Duration,
) -> Result<(), DeviceError> {
    let mut outcome = Ok(());
    // After a missing answer the remaining commands are still sent, with a short wait for each.
    let patience = |so_far: &Result<(), DeviceError>| {
        reply_timeout.min(match so_far {
            Ok(()) => ANSWERED,
            Err(_) => ANSWERED_AFTER_SILENCE,
        })
    };
    for address in axes {
        let timeout = patience(&outcome);
        let stopped = link.ask(address.device, address.axis, "stop", timeout, ATTEMPTS);
        outcome = outcome.and(stopped.map(drop));
    }
    for &switch in lamp {
        let timeout = patience(&outcome);
        outcome = outcome.and(ZaberStage::switch(link, switch, false, timeout));
    }
    outcome?;
    for &switch in lamp {
        if ZaberStage::is_on(link, switch, reply_timeout)? {
            return Err(DeviceError::NotApplied {
                device: link.line().device().to_owned(),
                what: "the lamp".to_owned(),
                is: "on".to_owned(),
                wanted: "off".to_owned(),
            });
        }
    }
    let deadline = Instant::now() + timeout;
    for address in axes {
        while link
            .ask(address.device, address.axis, "", reply_timeout, ATTEMPTS)?
            .busy
        {
            if Instant::now() > deadline {
                return Err(link.line().no_reply("stop", timeout));
            }
            std::thread::sleep(Duration::from_millis(5));
        }
    }
    Ok(())
}

/// Stops the axes and turns off the lamp of a chain that no driver holds.
pub fn stop_port(config: &ZaberConfig) -> Result<(), DeviceError> {
    let link = Link::open(&config.port, config.baud)?;
    let reply_timeout = config.reply_timeout.to_duration();
    let timeout = config.connect_timeout.to_duration();
    stop(&link, &config.axes, &config.lamp, reply_timeout, timeout)
}
