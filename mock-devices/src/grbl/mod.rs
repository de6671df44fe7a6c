//! A controller with GRBL 1.1 firmware, on a pseudo-terminal.
//!
//! It answers the bytes that GRBL 1.1h answers, after GRBL's public interface
//! documentation (`interface.md`, `commands.md`, `settings.md`, `jogging.md`).
//! Known departures: moves stop between each other (see `planner`); arcs,
//! probing, canned positions, tool offsets, overrides and the safety door are
//! absent; homing takes its axes one after the other.

mod commands;
mod dialect;
mod faults;
mod firmware;
mod gcode;
mod homing;
mod interpreter;
mod link;
mod planner;
mod report;
mod settings;

pub use dialect::{Dialect, DialectSimulator};
pub use faults::{Fault, Faults, Trigger};
pub use settings::GrblSettings;

use crate::bench::Bench;
use std::path::{Path, PathBuf};

/// An output of the controller that drives a lamp channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LampPin {
    /// Not connected.
    None,
    /// The spindle's PWM: `M3` or `M4` with `S`, power S / $30, off by `M5`.
    Spindle,
    /// The flood coolant pin: on by `M8`, off by `M9`.
    Flood,
    /// The mist coolant pin: on by `M7`, off by `M9`.
    Mist,
}

/// What the board is and how it is wired.
#[derive(Clone, Debug, PartialEq)]
pub struct GrblConfig {
    /// The `$` settings in its memory.
    pub settings: GrblSettings,
    /// Which output drives each lamp channel; default spindle, flood, mist. The
    /// same output may drive all three: a white lamp.
    pub lamp_wiring: [LampPin; 3],
    /// Axes that `$H` homes, in this order (0 = X); default X, then Y.
    pub homing_order: Vec<usize>,
    /// Whether homing makes the switch's end of each axis zero, so that an axis
    /// that homes down has positions from 0 to its travel (a build option);
    /// otherwise machine space is negative. Default true.
    pub zero_at_home: bool,
    /// Whether opening the port restarts the board, as the DTR line of an
    /// Arduino Uno does. Default true.
    pub reset_on_open: bool,
    /// From a restart until the welcome message, seconds. Default 0.2.
    pub boot_s: f64,
    /// Whether it is grblHAL, after its core's documentation: another banner, more
    /// fields in status reports, alarm states with their code, settings that are
    /// no numbers, more lines of `$I`. Default false.
    pub hal: bool,
    /// Not in stock GRBL: resets (lamp off, motion stopped) when the host has
    /// sent nothing for this long, seconds; `$I` then says
    /// `host-watchdog=<seconds>`. Default none.
    pub host_watchdog_s: Option<f64>,
}

impl Default for GrblConfig {
    fn default() -> Self {
        Self {
            settings: GrblSettings::default(),
            lamp_wiring: [LampPin::Spindle, LampPin::Flood, LampPin::Mist],
            homing_order: vec![0, 1],
            zero_at_home: true,
            reset_on_open: true,
            boot_s: 0.2,
            hal: false,
            host_watchdog_s: None,
        }
    }
}

/// A running controller. Dropping it takes the port away.
///
/// On an [instant](crate::clock::Clock::instant) clock, whatever the firmware
/// must wait for (homing, a dwell, a full queue, the end of a motion before the
/// lamp switches) is over at once, and a motion is over after the first status
/// report that shows it.
#[derive(Debug)]
pub struct GrblSimulator {
    path: PathBuf,
    faults: Faults,
    bench: Bench,
    link: link::Link,
}

impl GrblSimulator {
    /// Opens a pseudo-terminal and powers the board.
    pub fn spawn(config: GrblConfig, bench: Bench) -> std::io::Result<Self> {
        let faults = Faults::default();
        let (link, path) = link::Link::start(config, bench.clone(), faults.clone())?;
        Ok(Self {
            path,
            faults,
            bench,
            link,
        })
    }

    /// The port that a driver opens, e.g. `/dev/pts/3`.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Handle for making it fail.
    pub fn faults(&self) -> Faults {
        self.faults.clone()
    }

    /// The bench it moves and lights.
    pub fn bench(&self) -> &Bench {
        &self.bench
    }

    /// Whether a host has the port open.
    pub fn is_open(&self) -> bool {
        self.link.is_open()
    }

    /// How many bytes from the host the board has taken: a test on a manual
    /// clock waits for them before it moves the time.
    pub fn bytes_taken(&self) -> u64 {
        self.link.bytes_taken()
    }

    /// Pulls the cable: the port is gone for good, the board keeps its power,
    /// so what moves goes on and what burns stays lit.
    pub fn unplug(&self) {
        self.link.unplug();
    }
}
