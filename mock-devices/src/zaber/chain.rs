//! The devices: their state, their time, their lines.

use super::axis::{Axis, Task};
use super::message::{self, Command};
use super::{LampWiring, ZaberConfig};
use crate::bench::Bench;
use crate::motion::{Piece, Position, line};
use crate::pty::Board;

/// The bench is informed of two axes in motion as straight ways this short, seconds.
const SLICE_S: f64 = 0.005;
/// Longest line that is kept; a longer one is dropped.
const LONGEST_LINE: usize = 200;

pub(super) struct Chain {
    pub(super) config: ZaberConfig,
    pub(super) bench: Bench,
    pub(super) axes: [Axis; 2],
    /// Digital outputs of device 1.
    pub(super) outputs: [bool; 4],
    /// Lamps of device 2.
    pub(super) lamps: [bool; 3],
    /// Relative flux of each lamp.
    pub(super) flux: [f64; 3],
    broken: [bool; 3],
    pub(super) checksums: bool,
    pub(super) alerts: bool,
    pub(super) jam_after_s: Option<f64>,
    pub(super) restart_after_s: Option<f64>,
    moving_since_s: Option<f64>,
    line: Vec<u8>,
    pub(super) out: Vec<u8>,
}

impl std::fmt::Debug for Chain {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.debug_struct("Chain").finish_non_exhaustive()
    }
}

impl Chain {
    pub(super) fn new(config: ZaberConfig, bench: Bench) -> Self {
        let mut chain = Self {
            axes: axes(&config),
            outputs: [false; 4],
            lamps: [false; 3],
            flux: [1.0; 3],
            broken: [false; 3],
            checksums: false,
            alerts: config.alerts,
            jam_after_s: None,
            restart_after_s: None,
            moving_since_s: None,
            line: Vec::new(),
            out: Vec::new(),
            config,
            bench,
        };
        chain.power_up();
        chain
    }

    pub(super) fn power_up(&mut self) {
        let now_s = self.bench.clock().now_s();
        self.axes = axes(&self.config);
        self.outputs = [false; 4];
        self.lamps = [false; 3];
        self.moving_since_s = None;
        self.line.clear();
        self.bench.cut_drives(now_s, [0.0; 3]);
        self.bench.forget_homing();
        self.light(now_s);
    }

    pub(super) fn break_output(&mut self, channel: usize) {
        if let Some(broken) = self.broken.get_mut(channel) {
            *broken = true;
        }
        self.light(self.bench.clock().now_s());
    }

    /// Device numbers that are there.
    pub(super) fn devices(&self) -> std::ops::RangeInclusive<u8> {
        match self.config.lamp {
            LampWiring::Outputs => 1..=1,
            LampWiring::Illuminator => 1..=2,
        }
    }

    /// Brings the outputs to the bench; what is broken stays off.
    pub(super) fn light(&mut self, now_s: f64) {
        let drive = match self.config.lamp {
            LampWiring::Outputs => {
                for (output, broken) in self.outputs.iter_mut().zip(self.broken) {
                    *output &= !broken;
                }
                std::array::from_fn(|i| f64::from(u8::from(self.outputs[i])))
            }
            LampWiring::Illuminator => {
                for (lamp, broken) in self.lamps.iter_mut().zip(self.broken) {
                    *lamp &= !broken;
                }
                std::array::from_fn(|i| f64::from(u8::from(self.lamps[i])) * self.flux[i])
            }
        };
        self.bench.set_lamp(now_s, drive);
    }

    pub(super) fn start(&mut self, index: usize, task: Task, to: f64, now_s: f64) {
        self.axes[index].start(task, to, now_s);
        self.moving_since_s.get_or_insert(now_s);
        self.tell_bench(now_s);
    }

    /// Where the home sensor of an axis is by its firmware's count.
    pub(super) fn sensor(&self, index: usize) -> f64 {
        -self.bench.slip()[index]
    }

    pub(super) fn halt(&mut self, index: usize, now_s: f64) -> bool {
        let moved = self.axes[index].halt(now_s);
        if moved {
            self.tell_bench(now_s);
        }
        moved
    }

    /// The ways of both axes together, as short straight pieces.
    fn tell_bench(&mut self, now_s: f64) {
        let end_s = self.axes.iter().filter_map(Axis::end_s).reduce(f64::max);
        let at = |axes: &[Axis; 2], time_s| -> Position {
            [axes[0].position(time_s), axes[1].position(time_s), 0.0]
        };
        let mut pieces = Vec::new();
        if let Some(end_s) = end_s {
            let slices = ((end_s - now_s) / SLICE_S).ceil().max(1.0) as usize;
            let time_s = |slice: usize| now_s + (end_s - now_s) * slice as f64 / slices as f64;
            for slice in 0..slices {
                let from = at(&self.axes, time_s(slice));
                let to = at(&self.axes, time_s(slice + 1));
                if let Some((direction, length)) = line(from, to) {
                    let duration_s = time_s(slice + 1) - time_s(slice);
                    pieces.push(Piece {
                        start_s: time_s(slice),
                        duration_s,
                        from,
                        to,
                        direction,
                        speed: length / duration_s,
                        acceleration: 0.0,
                    });
                }
            }
        }
        self.bench.follow(now_s, &pieces);
    }

    fn finish(&mut self, now_s: f64) {
        for index in 0..self.axes.len() {
            let Some(task) = self.axes[index].finish(now_s) else {
                continue;
            };
            if task == Task::Home {
                self.bench.end_homing(&[index]);
                let axis = &mut self.axes[index];
                axis.set_position(0.0);
                axis.no_reference = false;
                axis.stalled = false;
                if self.axes.iter().any(|axis| axis.no_reference) {
                    self.bench.forget_homing();
                }
            }
            self.alert(index);
        }
        if !self.axes.iter().any(Axis::is_busy) {
            self.moving_since_s = None;
        }
    }

    fn alert(&mut self, index: usize) {
        if self.alerts {
            let flags = self.axes[index].flags();
            let flag = flags.first().copied().unwrap_or("--");
            let body = format!("01 {} IDLE {flag}", index + 1);
            self.out.extend(message::line('!', &body, self.checksums));
        }
    }

    /// What happens to the stage rather than to a message.
    fn suffer(&mut self, now_s: f64) {
        let Some(since_s) = self.moving_since_s else {
            return;
        };
        if self.restart_after_s.is_some_and(|s| now_s >= since_s + s) {
            self.restart_after_s = None;
            self.power_up();
        }
        if self.jam_after_s.is_some_and(|s| now_s >= since_s + s) {
            self.jam_after_s = None;
            for index in 0..self.axes.len() {
                if self.halt(index, now_s) {
                    self.axes[index].stalled = true;
                    self.bench.forget_homing();
                    self.alert(index);
                }
            }
            self.moving_since_s = None;
        }
    }

    fn take_line(&mut self, now_s: f64) {
        let line = std::mem::take(&mut self.line);
        let line = line.strip_suffix(b"\r").unwrap_or(&line);
        let Some(command) = message::parse(line) else {
            return;
        };
        let devices: Vec<u8> = self
            .devices()
            .filter(|&device| command.device == 0 || command.device == device)
            .collect();
        for device in devices {
            self.obey(device, &command, now_s);
        }
    }

    /// The reply and the info lines after it.
    pub(super) fn reply(
        &mut self,
        device: u8,
        command: &Command,
        outcome: Result<String, &'static str>,
    ) {
        let (flag, data) = match outcome {
            Ok(data) => ("OK", data),
            Err(reason) => ("RJ", reason.to_owned()),
        };
        let id = command.id.map_or(String::new(), |id| format!(" {id:02}"));
        let indices = self.axes_of(device, command.axis);
        let busy = indices.iter().any(|&index| self.axes[index].is_busy());
        let status = if busy { "BUSY" } else { "IDLE" };
        let mut flags: Vec<&str> = indices
            .iter()
            .flat_map(|&index| self.axes[index].flags())
            .collect();
        // Faults before warnings before notes.
        flags.sort_by_key(|flag| "FWN".find(&flag[..1]));
        let warning = flags.first().copied().unwrap_or("--");
        let body = format!(
            "{device:02} {}{id} {flag} {status} {warning} {data}",
            command.axis
        );
        self.out.extend(message::line('@', &body, self.checksums));
    }

    /// Motor axes that a command to this device and axis means.
    pub(super) fn axes_of(&self, device: u8, axis: u8) -> Vec<usize> {
        match (device, axis) {
            (1, 0) => vec![0, 1],
            (1, 1 | 2) => vec![usize::from(axis) - 1],
            _ => Vec::new(),
        }
    }
}

fn axes(config: &ZaberConfig) -> [Axis; 2] {
    std::array::from_fn(|i| {
        Axis::new(
            config.microsteps_per_unit[i],
            config.limit_max[i],
            config.speed[i],
            config.acceleration[i],
        )
    })
}

impl Board for Chain {
    fn receive(&mut self, bytes: &[u8], now_s: f64) -> Vec<u8> {
        for &byte in bytes {
            if byte == b'\n' {
                self.take_line(now_s);
            } else if self.line.len() < LONGEST_LINE {
                self.line.push(byte);
            }
        }
        std::mem::take(&mut self.out)
    }

    fn step(&mut self, now_s: f64) -> Vec<u8> {
        self.suffer(now_s);
        self.finish(now_s);
        std::mem::take(&mut self.out)
    }

    fn jump_to_s(&self) -> Option<f64> {
        let end_s = self.axes.iter().filter_map(Axis::end_s).reduce(f64::max)?;
        let since_s = self.moving_since_s?;
        let mishaps = [self.jam_after_s, self.restart_after_s];
        let mishap_s = mishaps.into_iter().flatten().map(|s| since_s + s);
        Some(mishap_s.fold(end_s, f64::min))
    }
}
