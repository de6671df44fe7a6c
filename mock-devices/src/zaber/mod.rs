//! A chain of Zaber devices with firmware 7 on a pseudo-terminal: device 1 is a
//! controller with two axes and digital outputs, device 2, where it is there,
//! an illuminator with three lamps.
//!
//! It answers what such devices answer after Zaber's public ASCII protocol
//! manual: addresses, message ids, checksums, warning flags, rejections,
//! alerts. Known departures: streams, triggers, lockstep, joysticks and stored
//! settings are absent; homing has one speed; a second command to a moving axis
//! halts it without a ramp.

mod axis;
mod chain;
mod commands;
mod message;

use crate::bench::Bench;
use crate::pty::Port;
use chain::Chain;
use std::path::Path;

/// What drives the lamp's channels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LampWiring {
    /// Digital outputs 1, 2 and 3 of the controller.
    Outputs,
    /// Lamps 1, 2 and 3 of the illuminator, device 2.
    Illuminator,
}

/// What the devices are and how they are wired.
#[derive(Clone, Debug, PartialEq)]
pub struct ZaberConfig {
    /// Microsteps per unit of the bench ("mm"), for each axis. Default 1000.
    pub microsteps_per_unit: [f64; 2],
    /// Setting `limit.max` of each axis, microsteps; `limit.min` is 0. Default 360 000.
    pub limit_max: [i64; 2],
    /// Speed of each axis, bench units per second. Default 50.
    pub speed: [f64; 2],
    /// Acceleration of each axis, bench units per s². Default 200.
    pub acceleration: [f64; 2],
    /// The lamp. Default digital outputs.
    pub lamp: LampWiring,
    /// Setting `comm.alert` at power-up. Default false.
    pub alerts: bool,
}

impl Default for ZaberConfig {
    fn default() -> Self {
        Self {
            microsteps_per_unit: [1000.0; 2],
            limit_max: [360_000; 2],
            speed: [50.0; 2],
            acceleration: [200.0; 2],
            lamp: LampWiring::Outputs,
            alerts: false,
        }
    }
}

/// A running chain. Dropping it takes the port away.
///
/// On an [instant](crate::clock::Clock::instant) clock a motion is over after
/// the first answer given while it is under way.
#[derive(Debug)]
pub struct ZaberSimulator {
    port: Port<Chain>,
    bench: Bench,
}

impl ZaberSimulator {
    /// Opens a pseudo-terminal and powers the devices.
    pub fn spawn(config: ZaberConfig, bench: Bench) -> std::io::Result<Self> {
        let clock = bench.clock().clone();
        let chain = Chain::new(config, bench.clone());
        Ok(Self {
            port: Port::start("zaber-simulator", chain, clock)?,
            bench,
        })
    }

    /// The port that a driver opens.
    pub fn path(&self) -> &Path {
        self.port.path()
    }

    /// The bench it moves and lights.
    pub fn bench(&self) -> &Bench {
        &self.bench
    }

    /// The supply dips this long after the next motion has begun, seconds.
    pub fn power_cycle_in_motion(&self, after_s: f64) {
        self.port.board().restart_after_s = Some(after_s);
    }

    /// Something blocks the stage this long after the next motion has begun,
    /// seconds: the axes stall.
    pub fn jam_in_motion(&self, after_s: f64) {
        self.port.board().jam_after_s = Some(after_s);
    }

    /// The motors lose steps without noticing: each axis stands this far from
    /// where its controller believes, bench units.
    pub fn lose_steps(&self, by: [f64; 2]) {
        self.bench.push_stage([by[0], by[1], 0.0]);
    }

    /// A lamp channel's output no longer switches on, and reads back so.
    pub fn break_output(&self, channel: usize) {
        self.port.board().break_output(channel);
    }
}
