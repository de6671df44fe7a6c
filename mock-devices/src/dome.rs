//! A dome of lights that speaks the dome line protocol (`docs/reference/dome-protocol.md` of the
//! project) on a pseudo-terminal.

use crate::bench::Bench;
use crate::pty::{Board, Port};
use std::path::Path;

/// What the dome is.
#[derive(Clone, Debug, PartialEq)]
pub struct DomeConfig {
    /// Azimuth and elevation of each light, degrees.
    pub lights: Vec<[f64; 2]>,
    /// Colour channels of each light. Default 3.
    pub channels: u8,
    /// Silence of the host after which all lights go off, seconds; 0: never. Default 2.
    pub watchdog_s: f64,
    /// What it reports of its temperature, degrees Celsius; `None`: older firmware, which does
    /// not know the request. Default 31.5.
    pub temperature_c: Option<f64>,
}

impl DomeConfig {
    /// A dome with lights in these directions.
    pub fn of_lights(lights: Vec<[f64; 2]>) -> Self {
        Self {
            lights,
            channels: 3,
            watchdog_s: 2.0,
            temperature_c: Some(31.5),
        }
    }
}

/// A running dome. Dropping it takes the port away.
#[derive(Debug)]
pub struct DomeSimulator {
    port: Port<Firmware>,
    bench: Bench,
}

impl DomeSimulator {
    /// Opens a pseudo-terminal and powers the dome.
    pub fn spawn(config: DomeConfig, bench: Bench) -> std::io::Result<Self> {
        let clock = bench.clock().clone();
        let firmware = Firmware {
            broken: vec![false; config.lights.len()],
            config,
            bench: bench.clone(),
            lit: None,
            heard_s: clock.now_s(),
            heard: Vec::new(),
            line: Vec::new(),
            out: Vec::new(),
        };
        Ok(Self {
            port: Port::start("dome-simulator", firmware, clock)?,
            bench,
        })
    }

    /// The port that a driver opens.
    pub fn path(&self) -> &Path {
        self.port.path()
    }

    /// The bench it lights.
    pub fn bench(&self) -> &Bench {
        &self.bench
    }

    /// The supply dips: the dome restarts with its lights off, and says so.
    pub fn restart(&self) {
        let mut firmware = self.port.board();
        firmware.show(None);
        firmware.line.clear();
        firmware.say("0 restarted");
    }

    /// It becomes this warm, degrees Celsius.
    pub fn warm_to(&self, temperature_c: f64) {
        self.port.board().config.temperature_c = Some(temperature_c);
    }

    /// How many requests of this kind it has received.
    pub fn requests(&self, kind: &str) -> usize {
        let firmware = self.port.board();
        firmware.heard.iter().filter(|heard| *heard == kind).count()
    }

    /// A light's wire breaks: driven, it stays dark.
    pub fn break_light(&self, light: usize) {
        if let Some(broken) = self.port.board().broken.get_mut(light) {
            *broken = true;
        }
    }
}

#[derive(Clone, Copy, Debug)]
struct Lit {
    light: usize,
    channel: u8,
    level: u8,
}

#[derive(Debug)]
struct Firmware {
    config: DomeConfig,
    bench: Bench,
    lit: Option<Lit>,
    broken: Vec<bool>,
    heard_s: f64,
    /// The first word of every request.
    heard: Vec<String>,
    line: Vec<u8>,
    out: Vec<u8>,
}

impl Firmware {
    fn say(&mut self, body: &str) {
        let sum = body.bytes().fold(0_u8, |sum, byte| sum ^ byte);
        self.out
            .extend(format!("{body}*{sum:02X}\r\n").into_bytes());
    }

    fn show(&mut self, lit: Option<Lit>) {
        let mut drive = [0.0; 3];
        if let Some(Lit {
            light,
            channel,
            level,
        }) = lit
        {
            point_bench(&self.bench, self.config.lights[light]);
            if !self.broken[light] {
                drive[usize::from(channel)] = f64::from(level) / 255.0;
            }
        }
        self.lit = lit;
        self.bench.set_lamp(self.bench.clock().now_s(), drive);
    }

    fn take_line(&mut self) {
        let line = std::mem::take(&mut self.line);
        let Some((number, words)) = request(&line) else {
            return; // what is damaged is not answered
        };
        let words: Vec<&str> = words.split(' ').collect();
        self.heard
            .extend(words.first().map(|&kind| kind.to_owned()));
        let answer = match words[..] {
            ["info"] => format!(
                "ok lights={} channels={} watchdog={} firmware=1.0",
                self.config.lights.len(),
                self.config.channels,
                self.config.watchdog_s
            ),
            ["temperature"] => match self.config.temperature_c {
                Some(temperature_c) => format!("ok {temperature_c:.1}"),
                None => "error no such request".to_owned(),
            },
            ["off"] => {
                self.show(None);
                "ok".to_owned()
            }
            ["state"] => match self.lit {
                None => "ok off".to_owned(),
                Some(Lit {
                    light,
                    channel,
                    level,
                }) => {
                    let current = if self.broken[light] { "dark" } else { "shines" };
                    format!("ok light {light} {channel} {level} {current}")
                }
            },
            ["light", light, channel, level] => match self.lit_of(light, channel, level) {
                Ok(lit) => {
                    self.show(Some(lit));
                    "ok".to_owned()
                }
                Err(reason) => format!("error {reason}"),
            },
            _ => "error no such request".to_owned(),
        };
        if number > 0 {
            self.say(&format!("{number} {answer}"));
        }
    }

    fn lit_of(&self, light: &str, channel: &str, level: &str) -> Result<Lit, &'static str> {
        let lit = Lit {
            light: light.parse().map_err(|_| "no such light")?,
            channel: channel.parse().map_err(|_| "no such channel")?,
            level: level.parse().map_err(|_| "no such level")?,
        };
        if lit.light >= self.config.lights.len() {
            return Err("no such light");
        }
        if lit.channel >= self.config.channels.min(3) {
            return Err("no such channel");
        }
        Ok(lit)
    }
}

/// The bench's lamp is where this light is.
pub(crate) fn point_bench(bench: &Bench, [azimuth_deg, elevation_deg]: [f64; 2]) {
    let kinematics = bench.config().kinematics;
    let mut by_mm = [0.0; 3];
    for (axis, angle_deg) in [
        (kinematics.azimuth, azimuth_deg),
        (kinematics.elevation, elevation_deg),
    ] {
        let motor_mm = (angle_deg - axis.offset_deg) / axis.deg_per_mm;
        by_mm[axis.axis as usize] = motor_mm - bench.motor_position()[axis.axis as usize];
    }
    bench.push_stage(by_mm);
}

/// `number words*checksum`, if the checksum is right.
fn request(line: &[u8]) -> Option<(u16, String)> {
    let text = std::str::from_utf8(line).ok()?.trim_end();
    let (body, given) = text.rsplit_once('*')?;
    let sum = body.bytes().fold(0_u8, |sum, byte| sum ^ byte);
    (u8::from_str_radix(given, 16).ok()? == sum).then_some(())?;
    let (number, words) = body.split_once(' ')?;
    Some((number.parse().ok()?, words.to_owned()))
}

impl Board for Firmware {
    fn receive(&mut self, bytes: &[u8], now_s: f64) -> Vec<u8> {
        self.heard_s = now_s;
        for &byte in bytes {
            if byte == b'\n' {
                self.take_line();
            } else if self.line.len() < 128 {
                self.line.push(byte);
            }
        }
        std::mem::take(&mut self.out)
    }

    fn step(&mut self, now_s: f64) -> Vec<u8> {
        let limit_s = self.config.watchdog_s;
        if limit_s > 0.0 && self.lit.is_some() && now_s - self.heard_s > limit_s {
            self.show(None);
        }
        std::mem::take(&mut self.out)
    }

    fn jump_to_s(&self) -> Option<f64> {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::BenchConfig;
    use crate::clock::Clock;

    fn firmware() -> (Firmware, Clock) {
        let clock = Clock::manual();
        let bench = Bench::new(BenchConfig::default(), clock.clone());
        let firmware = Firmware {
            config: DomeConfig::of_lights(vec![[0.0, 90.0], [30.0, 45.0]]),
            bench,
            lit: None,
            broken: vec![false; 2],
            heard_s: 0.0,
            heard: Vec::new(),
            line: Vec::new(),
            out: Vec::new(),
        };
        (firmware, clock)
    }

    fn ask(firmware: &mut Firmware, body: &str) -> String {
        let sum = body.bytes().fold(0_u8, |sum, byte| sum ^ byte);
        let answer = firmware.receive(format!("{body}*{sum:02X}\n").as_bytes(), 0.0);
        String::from_utf8(answer).unwrap()
    }

    #[test]
    fn one_light_at_a_time() {
        let (mut firmware, _) = firmware();
        assert!(ask(&mut firmware, "4 light 1 2 255").starts_with("4 ok*"));
        let angles_deg = firmware.bench.stage_angles_deg();
        assert!((angles_deg[0] - 30.0).abs() < 1e-9 && (angles_deg[1] - 45.0).abs() < 1e-9);
        assert_eq!(firmware.bench.lamp_drive(), [0.0, 0.0, 1.0]);
        assert!(ask(&mut firmware, "5 state").starts_with("5 ok light 1 2 255 shines*"));
        firmware.broken[0] = true;
        ask(&mut firmware, "6 light 0 0 51");
        assert_eq!(firmware.bench.lamp_drive(), [0.0; 3]);
        assert!(ask(&mut firmware, "7 state").starts_with("7 ok light 0 0 51 dark*"));
        assert!(ask(&mut firmware, "8 light 2 0 51").starts_with("8 error no such light*"));
        assert!(ask(&mut firmware, "9 light 0 3 51").starts_with("9 error no such channel*"));
        assert!(ask(&mut firmware, "10 dance").starts_with("10 error"));
        assert!(ask(&mut firmware, "10 temperature").starts_with("10 ok 31.5*"));
        firmware.config.temperature_c = None;
        assert!(ask(&mut firmware, "10 temperature").starts_with("10 error"));
        assert_eq!(ask(&mut firmware, "0 off"), "", "number 0 is not answered");
        assert!(ask(&mut firmware, "11 state").starts_with("11 ok off*"));
        assert!(firmware.receive(b"12 state*00\n", 0.0).is_empty());
    }

    #[test]
    fn silence_turns_the_lights_off() {
        let (mut firmware, _) = firmware();
        ask(&mut firmware, "1 light 1 0 255");
        firmware.step(1.9);
        assert_eq!(firmware.bench.lamp_drive()[0], 1.0);
        firmware.step(2.1);
        assert_eq!(firmware.bench.lamp_drive()[0], 0.0);
    }
}
