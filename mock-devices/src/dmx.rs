//! A DMX512 interface framed like Enttec's DMX USB Pro, with a dome of lights
//! behind it. DMX carries nothing back: the lights can't be asked.

use crate::bench::Bench;
use crate::pty::{Board, Port};
use std::path::Path;

/// What is behind the interface.
#[derive(Clone, Debug, PartialEq)]
pub struct DmxConfig {
    /// Azimuth and elevation of each light, degrees, and the DMX address (1 to
    /// 512) of the first of its three channels.
    pub lights: Vec<([f64; 2], usize)>,
}

/// A running interface. Dropping it takes the port away.
#[derive(Debug)]
pub struct DmxSimulator {
    port: Port<Widget>,
    bench: Bench,
}

impl DmxSimulator {
    /// Opens a pseudo-terminal and powers the interface.
    pub fn spawn(config: DmxConfig, bench: Bench) -> std::io::Result<Self> {
        let clock = bench.clock().clone();
        let widget = Widget {
            config,
            bench: bench.clone(),
            received: Vec::new(),
            packets: 0,
            mute: false,
        };
        Ok(Self {
            port: Port::start("dmx-simulator", widget, clock)?,
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

    /// DMX packets taken so far.
    pub fn packets(&self) -> u64 {
        self.port.board().packets
    }

    /// The interface answers nothing more.
    pub fn mute(&self) {
        self.port.board().mute = true;
    }
}

#[derive(Debug)]
struct Widget {
    config: DmxConfig,
    bench: Bench,
    received: Vec<u8>,
    packets: u64,
    mute: bool,
}

impl Widget {
    fn obey(&mut self, label: u8, data: &[u8]) -> Vec<u8> {
        let answer: &[u8] = match label {
            // Firmware 1.44, break 9, mark 1, 40 packets/s.
            3 => &[44, 1, 9, 1, 40],
            10 => &[0x21, 0x43, 0x65, 0x87],
            6 if data.first() == Some(&0) && data.len() >= 25 => {
                self.packets += 1;
                self.show(&data[1..]);
                return Vec::new();
            }
            _ => return Vec::new(),
        };
        if self.mute {
            return Vec::new();
        }
        let mut message = vec![0x7e, label, answer.len() as u8, 0];
        message.extend(answer);
        message.push(0xe7);
        message
    }

    /// The bench has one lamp: it is where the brightest light is.
    fn show(&self, levels: &[u8]) {
        let drive_of = |address: usize| -> [f64; 3] {
            std::array::from_fn(|channel| {
                let level = address
                    .checked_sub(1)
                    .and_then(|slot| levels.get(slot + channel));
                f64::from(level.copied().unwrap_or(0)) / 255.0
            })
        };
        let brightest = self
            .config
            .lights
            .iter()
            .map(|&(direction, address)| (direction, drive_of(address)))
            .max_by(|(_, a), (_, b)| a.iter().sum::<f64>().total_cmp(&b.iter().sum()));
        let Some((direction, drive)) = brightest else {
            return;
        };
        if drive != [0.0; 3] {
            point_bench(&self.bench, direction);
        }
        self.bench.set_lamp(self.bench.clock().now_s(), drive);
    }
}

/// The bench's lamp is where this light is.
fn point_bench(bench: &Bench, [azimuth_deg, elevation_deg]: [f64; 2]) {
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

impl Board for Widget {
    fn receive(&mut self, bytes: &[u8], _now_s: f64) -> Vec<u8> {
        self.received.extend(bytes);
        let mut answers = Vec::new();
        loop {
            let start = self.received.iter().position(|&byte| byte == 0x7e);
            self.received.drain(..start.unwrap_or(self.received.len()));
            let Some(&[_, label, low, high]) = self.received.first_chunk::<4>() else {
                return answers;
            };
            let length = usize::from(low) + 256 * usize::from(high);
            if length > 600 {
                self.received.drain(..1);
                continue;
            }
            if self.received.len() < length + 5 {
                return answers;
            }
            let message: Vec<u8> = self.received.drain(..length + 5).collect();
            if message[length + 4] == 0xe7 {
                let answer = self.obey(label, &message[4..length + 4]);
                answers.extend(answer);
            }
        }
    }

    fn step(&mut self, _now_s: f64) -> Vec<u8> {
        Vec::new()
    }

    fn jump_to_s(&self) -> Option<f64> {
        None
    }
}
