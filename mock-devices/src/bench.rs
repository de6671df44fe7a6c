//! What is true on the bench: where the axes stand and which lamps burn,
//! whatever the firmware believes.

use crate::Illumination;
use crate::clock::{Clock, lock};
use crate::motion::{Piece, Position};
use crate::random;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

/// A motor axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Axis {
    X,
    Y,
    Z,
}

/// How a motor axis turns one stage angle: angle = `offset_deg` + `deg_per_mm` × position.
/// On a gantry it shifts the lamp instead, and degrees are millimetres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AngleAxis {
    /// The motor.
    pub axis: Axis,
    /// Degrees per unit ("mm") of the firmware; negative turns the other way.
    pub deg_per_mm: f64,
    /// Angle at machine zero, degrees.
    pub offset_deg: f64,
}

impl AngleAxis {
    fn angle_deg(&self, position: Position) -> f64 {
        self.offset_deg + self.deg_per_mm * position[self.axis as usize]
    }
}

/// From motor positions to the lamp's azimuth and elevation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kinematics {
    /// The azimuth's motor; by default X, one degree per unit, machine zero at −180°.
    pub azimuth: AngleAxis,
    /// The elevation's motor; by default Y, one degree per unit, machine zero at 0°.
    pub elevation: AngleAxis,
    /// What the two do with the lamp; by default its azimuth and elevation.
    pub mount: Mount,
}

/// What the two motors do with the lamp.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[allow(missing_docs)]
pub enum Mount {
    /// They are its azimuth and its elevation.
    #[default]
    Angles,
    /// A turntable, and a carriage's angle on an arc whose centre is above the
    /// stage's.
    Arc {
        /// Radius of the lamp's way, mm.
        radius_mm: f64,
        centre_height_mm: f64,
    },
    /// The lamp's x and y, mm.
    Gantry { height_mm: f64 },
}

impl Kinematics {
    /// The lamp's azimuth and elevation, degrees.
    fn angles_deg(&self, position: Position) -> [f64; 2] {
        let first = self.azimuth.angle_deg(position);
        let second = self.elevation.angle_deg(position);
        match self.mount {
            Mount::Angles => [first, second],
            Mount::Arc {
                radius_mm,
                centre_height_mm,
            } => {
                let out_mm = radius_mm * second.to_radians().cos();
                let up_mm = centre_height_mm + radius_mm * second.to_radians().sin();
                [first, up_mm.atan2(out_mm).to_degrees()]
            }
            Mount::Gantry { height_mm } => {
                let out_mm = first.hypot(second);
                [second.atan2(first), height_mm.atan2(out_mm)].map(f64::to_degrees)
            }
        }
    }
}

impl Default for Kinematics {
    fn default() -> Self {
        Self {
            azimuth: AngleAxis {
                axis: Axis::X,
                deg_per_mm: 1.0,
                offset_deg: -180.0,
            },
            elevation: AngleAxis {
                axis: Axis::Y,
                deg_per_mm: 1.0,
                offset_deg: 0.0,
            },
            mount: Mount::Angles,
        }
    }
}

/// How the true stage departs from what its firmware reports. All zero by default.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StageErrors {
    /// True azimuth minus that of the kinematics, degrees.
    pub azimuth_offset_deg: f64,
    /// True elevation minus that of the kinematics, degrees.
    pub elevation_offset_deg: f64,
    /// Play of each axis, mm: a position reached by moving down is this much too high.
    pub backlash_mm: Position,
    /// Standard deviation of a fixed error of each axis that depends on the
    /// target, mm: the same target always errs alike.
    pub positioning_mm: f64,
    /// Standard deviation of an error of each axis that is new with every visit of a
    /// target, mm; see [`Bench::count_visit`].
    pub repeatability_mm: f64,
    /// Standard deviation of where homing finds the switch, mm: new with every homing.
    pub homing_mm: f64,
    /// How far an axis coasts when its drive is cut in motion, as seconds of
    /// its speed (times a number in [0, 1) new at each cut).
    pub coast_s: f64,
}

/// The lamp's power over time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LampModel {
    /// Power of each channel at full drive, warm, relative to nominal; default 1.
    pub power: [f64; 3],
    /// Fraction of power missing at the moment of switching on; default 0.
    pub warm_up_fraction: f64,
    /// Time constant with which it appears, seconds; default 60.
    pub warm_up_s: f64,
    /// Relative change of power per hour on the bench's clock; default 0.
    pub drift_per_hour: f64,
    /// Amplitude of a sine on the power, relative; default 0.
    pub flicker_depth: f64,
    /// Its frequency, Hz; default 100.
    pub flicker_hz: f64,
}

impl Default for LampModel {
    fn default() -> Self {
        Self {
            power: [1.0; 3],
            warm_up_fraction: 0.0,
            warm_up_s: 60.0,
            drift_per_hour: 0.0,
            flicker_depth: 0.0,
            flicker_hz: 100.0,
        }
    }
}

impl LampModel {
    /// Mean of the flicker over a time, relative to the power.
    fn flicker(&self, start_s: f64, end_s: f64) -> f64 {
        let omega = std::f64::consts::TAU * self.flicker_hz;
        let phase = 0.5 * omega * (end_s - start_s);
        let damped = if phase.abs() < 1e-9 {
            1.0
        } else {
            phase.sin() / phase
        };
        1.0 + self.flicker_depth * damped * (0.5 * omega * (start_s + end_s)).sin()
    }
}

/// Everything true about a bench that does not change by itself.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BenchConfig {
    /// Motors to angles.
    pub kinematics: Kinematics,
    /// Departures from it.
    pub errors: StageErrors,
    /// The lamp.
    pub lamp: LampModel,
    /// Where the axes stand when the bench is made, motor coordinates (those
    /// of the firmware after a perfect homing), mm.
    pub start_mm: Position,
    /// Key of everything random on this bench.
    pub seed: u64,
}

/// How much of the past is kept for exposures that began earlier, seconds.
const HISTORY_S: f64 = 600.0;

/// One moving stretch, where the firmware believes that it leads, and the errors that
/// hold from its start on.
#[derive(Clone, Copy, Debug)]
struct Stretch {
    piece: Piece,
    target: Position,
    error: Position,
}

/// Two targets of the firmware closer than this are one, mm.
const SAME_TARGET_MM: f64 = 5e-4;

fn is_same(a: Position, b: Position) -> bool {
    a.iter().zip(b).all(|(a, b)| (a - b).abs() < SAME_TARGET_MM)
}

#[derive(Clone, Copy, Debug)]
struct LampEvent {
    time_s: f64,
    /// Drive of each channel, 0 to 1.
    drive: [f64; 3],
    /// Since when each channel has burned.
    lit_since_s: [f64; 3],
}

#[derive(Debug)]
struct State {
    /// Motor position, play and error before the first stretch.
    rest: Position,
    rest_output: Position,
    rest_error: Position,
    rest_target: Position,
    stretches: VecDeque<Stretch>,
    /// Motor position minus the firmware's.
    slip: Position,
    /// Every target that was left after the lamp had burned there, as often as it was.
    visits: Vec<Position>,
    /// A target that was being visited when this bench was made.
    under_way: Option<Position>,
    /// Where the lamp has burned since the stage last moved.
    lit_at: Option<Position>,
    homings: u64,
    cuts: u64,
    lamp: VecDeque<LampEvent>,
    dead_channels: [bool; 3],
    homed: bool,
    alarm: Option<u8>,
}

/// The shared truth; clones are handles to the same bench.
#[derive(Clone, Debug)]
pub struct Bench {
    config: BenchConfig,
    clock: Clock,
    state: Arc<Mutex<State>>,
}

impl Bench {
    /// A bench at rest with its lamps off.
    pub fn new(mut config: BenchConfig, clock: Clock) -> Self {
        config.errors.backlash_mm = config.errors.backlash_mm.map(|play| play.max(0.0));
        let now_s = clock.now_s();
        let state = State {
            rest: config.start_mm,
            rest_output: config.start_mm,
            rest_error: [0.0; 3],
            rest_target: config.start_mm,
            stretches: VecDeque::new(),
            slip: config.start_mm,
            visits: Vec::new(),
            under_way: None,
            lit_at: None,
            homings: 0,
            cuts: 0,
            lamp: VecDeque::from([LampEvent {
                time_s: now_s,
                drive: [0.0; 3],
                lit_since_s: [now_s; 3],
            }]),
            dead_channels: [false; 3],
            homed: false,
            alarm: None,
        };
        Self {
            config,
            clock,
            state: Arc::new(Mutex::new(state)),
        }
    }

    /// The clock of everything on this bench.
    pub fn clock(&self) -> &Clock {
        &self.clock
    }

    /// What this bench is.
    pub fn config(&self) -> &BenchConfig {
        &self.config
    }

    /// The light now.
    pub fn illumination(&self) -> Illumination {
        let now_s = self.clock.now_s();
        self.illumination_over(now_s, now_s)
    }

    /// The light over an exposure, seconds on the clock: the lamp's direction at
    /// its middle and each channel's power averaged over it.
    pub fn illumination_over(&self, start_s: f64, end_s: f64) -> Illumination {
        let state = lock(&self.state);
        let middle_s = 0.5 * (start_s + end_s);
        let [azimuth_deg, elevation_deg] = self.angles_deg(&state, middle_s);
        Illumination {
            azimuth_rad: azimuth_deg.to_radians(),
            elevation_rad: elevation_deg.to_radians(),
            sent_to_deg: self.config.kinematics.angles_deg(state.target(middle_s)),
            channels: self.mean_power(&state, start_s, end_s),
        }
    }

    /// Largest change of either stage angle between two times, degrees.
    pub fn turned_deg(&self, start_s: f64, end_s: f64) -> f64 {
        let state = lock(&self.state);
        let a = self.angles_deg(&state, start_s);
        let b = self.angles_deg(&state, end_s);
        (a[0] - b[0]).abs().max((a[1] - b[1]).abs())
    }

    /// True azimuth and elevation now, degrees.
    pub fn stage_angles_deg(&self) -> [f64; 2] {
        self.angles_deg(&lock(&self.state), self.clock.now_s())
    }

    /// Where the motors stand now, motor coordinates, mm: without play and errors.
    pub fn motor_position(&self) -> Position {
        lock(&self.state).motor(self.clock.now_s())
    }

    /// How hard each lamp channel is driven now, 0 to 1, as the wiring has it.
    pub fn lamp_drive(&self) -> [f64; 3] {
        lock(&self.state)
            .lamp
            .back()
            .map_or([0.0; 3], |event| event.drive)
    }

    /// Whether the firmware has found its switches since its last power-up or alarm.
    pub fn is_homed(&self) -> bool {
        lock(&self.state).homed
    }

    /// The firmware's alarm code, if it is in alarm.
    pub fn alarm(&self) -> Option<u8> {
        lock(&self.state).alarm
    }

    /// Breaks (or mends) a lamp channel: dead, it gives no light however driven.
    pub fn set_lamp_dead(&self, channel: usize, dead: bool) {
        if let Some(flag) = lock(&self.state).dead_channels.get_mut(channel) {
            *flag = dead;
        }
    }

    /// Someone pushes the stage by hand while its drives are off: the firmware
    /// does not know.
    pub fn push_stage(&self, by_mm: Position) {
        let now_s = self.clock.now_s();
        let mut state = lock(&self.state);
        let at = state.motor(now_s);
        state.rest_target = state.target(now_s);
        state.stretches.clear();
        state.rest = std::array::from_fn(|axis| at[axis] + by_mm[axis]);
        state.rest_output = state.rest;
        state.slip = std::array::from_fn(|axis| state.slip[axis] + by_mm[axis]);
    }

    /// A target of the firmware was visited before this bench was made. The bench
    /// counts by itself what comes after: a visit is a stay with the lamp lit, and each
    /// has its own error of [`StageErrors::repeatability_mm`].
    pub fn count_visit(&self, target: Position) {
        lock(&self.state).visits.push(target);
    }

    /// A visit of this target was under way when this bench was made: where the lamp is
    /// next lit there, it goes on; lit elsewhere, it was over.
    pub fn continue_visit(&self, target: Position) {
        lock(&self.state).under_way = Some(target);
    }

    fn angles_deg(&self, state: &State, time_s: f64) -> [f64; 2] {
        let position = state.output(time_s, self.config.errors.backlash_mm);
        let [azimuth_deg, elevation_deg] = self.config.kinematics.angles_deg(position);
        [
            azimuth_deg + self.config.errors.azimuth_offset_deg,
            elevation_deg + self.config.errors.elevation_offset_deg,
        ]
    }

    fn mean_power(&self, state: &State, start_s: f64, end_s: f64) -> [f64; 3] {
        let span_s = end_s - start_s;
        if span_s <= 0.0 {
            let flicker = self.config.lamp.flicker(start_s, start_s);
            return self.power_at(state, start_s).map(|power| power * flicker);
        }
        let mut edges = vec![start_s];
        edges.extend(
            state
                .lamp
                .iter()
                .map(|event| event.time_s)
                .filter(|&t| t > start_s && t < end_s),
        );
        edges.push(end_s);
        let mut mean = [0.0; 3];
        for pair in edges.windows(2) {
            let power = self.power_at(state, 0.5 * (pair[0] + pair[1]));
            let flicker = self.config.lamp.flicker(pair[0], pair[1]);
            for (sum, power) in mean.iter_mut().zip(power) {
                *sum += power * flicker * (pair[1] - pair[0]) / span_s;
            }
        }
        mean
    }

    fn power_at(&self, state: &State, time_s: f64) -> [f64; 3] {
        let lamp = &self.config.lamp;
        let Some(event) = state.lamp.iter().rev().find(|event| event.time_s <= time_s) else {
            return [0.0; 3];
        };
        std::array::from_fn(|channel| {
            if state.dead_channels[channel] {
                return 0.0;
            }
            let lit_s = time_s - event.lit_since_s[channel];
            let warm = 1.0 - lamp.warm_up_fraction * (-lit_s / lamp.warm_up_s).exp();
            let drift = 1.0 + lamp.drift_per_hour * time_s / 3600.0;
            event.drive[channel] * lamp.power[channel] * warm * drift
        })
    }

    /// The firmware's drives follow these stretches (its coordinates) from a time on;
    /// what was planned beyond that time is forgotten.
    pub(crate) fn follow(&self, from_s: f64, pieces: &[Piece]) {
        let mut state = lock(&self.state);
        state.cut(from_s);
        state.forget_before(from_s - HISTORY_S, self.config.errors.backlash_mm);
        if !pieces.is_empty()
            && let Some(left) = state.lit_at.take()
        {
            state.visits.push(left);
        }
        for piece in pieces {
            let mut piece = *piece;
            let target = piece.to;
            for (axis, slip) in state.slip.iter().enumerate() {
                piece.from[axis] += slip;
                piece.to[axis] += slip;
            }
            let error = self.error_at(target, state.visits_of(target));
            state.stretches.push_back(Stretch {
                piece,
                target,
                error,
            });
        }
    }

    /// The error of a stay at a target of the firmware after so many visits before it.
    fn error_at(&self, target: Position, visits: u64) -> Position {
        let errors = &self.config.errors;
        let [x, y, z] = target.map(|mm| (mm * 1e4).round() as i64 as u64);
        std::array::from_fn(|axis| {
            let seed = self.config.seed;
            let mut error = 0.0;
            if errors.positioning_mm > 0.0 {
                let place = [x, y, z][axis];
                error +=
                    errors.positioning_mm * random::stream(&[seed, 1, axis as u64, place]).normal();
            }
            if errors.repeatability_mm > 0.0 {
                let visit = [seed, 2, axis as u64, x, y, z, visits];
                error += errors.repeatability_mm * random::stream(&visit).normal();
            }
            error
        })
    }

    /// The drives are cut at a time: axes in motion coast, and the firmware,
    /// which now believes `firmware`, does not notice.
    pub(crate) fn cut_drives(&self, now_s: f64, firmware: Position) {
        let mut state = lock(&self.state);
        let coast = state.stretch_at(now_s).map_or([0.0; 3], |stretch| {
            let speed = stretch.piece.speed_at(now_s);
            let chance = random::stream(&[self.config.seed, 3, state.cuts]).uniform();
            stretch
                .piece
                .direction
                .map(|d| d * speed * self.config.errors.coast_s * chance)
        });
        let error = state
            .stretch_at(now_s)
            .map_or(state.rest_error, |stretch| stretch.error);
        let output = state.output_without_error(now_s, self.config.errors.backlash_mm);
        let at = state.motor(now_s);
        state.rest_target = state.target(now_s);
        state.cuts += 1;
        state.stretches.clear();
        state.rest = std::array::from_fn(|axis| at[axis] + coast[axis]);
        state.rest_output = std::array::from_fn(|axis| output[axis] + coast[axis]);
        state.rest_error = error;
        state.slip = std::array::from_fn(|axis| state.rest[axis] - firmware[axis]);
    }

    /// During homing the firmware's coordinates are the motors' own.
    pub(crate) fn begin_homing(&self) -> Position {
        let mut state = lock(&self.state);
        state.slip = [0.0; 3];
        state.homed = false;
        state.motor(self.clock.now_s())
    }

    /// Homing has found the switches of these axes, each with its error.
    pub(crate) fn end_homing(&self, axes: &[usize]) {
        let mut state = lock(&self.state);
        state.homings += 1;
        let homings = state.homings;
        for &axis in axes {
            let error = random::stream(&[self.config.seed, 4, axis as u64, homings]).normal();
            state.slip[axis] = self.config.errors.homing_mm * error;
        }
        state.homed = true;
    }

    /// What the firmware does not know: the motors' position minus its own.
    pub(crate) fn slip(&self) -> Position {
        lock(&self.state).slip
    }

    pub(crate) fn set_alarm(&self, alarm: Option<u8>) {
        lock(&self.state).alarm = alarm;
    }

    pub(crate) fn forget_homing(&self) {
        lock(&self.state).homed = false;
    }

    /// Drives the lamp's channels (0 to 1) from a time on, as the wiring has it.
    pub fn set_lamp(&self, now_s: f64, drive: [f64; 3]) {
        let mut state = lock(&self.state);
        let last = state.lamp.back().copied();
        if last.is_some_and(|event| event.drive == drive) {
            return;
        }
        if drive.iter().any(|&drive| drive > 0.0) {
            let here = state.target(now_s);
            state.lit_at = Some(here);
            if let Some(visited) = state.under_way.take()
                && !is_same(visited, here)
            {
                state.visits.push(visited);
            }
        }
        let lit_since_s = std::array::from_fn(|channel| match last {
            Some(event) if event.drive[channel] > 0.0 => event.lit_since_s[channel],
            _ => now_s,
        });
        state.lamp.push_back(LampEvent {
            time_s: now_s,
            drive,
            lit_since_s,
        });
        while state.lamp.len() > 2 && state.lamp[1].time_s < now_s - HISTORY_S {
            state.lamp.pop_front();
        }
    }
}

impl State {
    fn stretch_at(&self, time_s: f64) -> Option<&Stretch> {
        self.stretches
            .iter()
            .rev()
            .find(|stretch| stretch.piece.start_s <= time_s)
            .filter(|stretch| time_s < stretch.piece.end_s())
    }

    fn motor(&self, time_s: f64) -> Position {
        self.stretches
            .iter()
            .rev()
            .find(|stretch| stretch.piece.start_s <= time_s)
            .map_or(self.rest, |stretch| stretch.piece.position(time_s))
    }

    /// Where the firmware was sent.
    fn target(&self, time_s: f64) -> Position {
        self.stretches
            .iter()
            .rev()
            .find(|stretch| stretch.piece.start_s <= time_s)
            .map_or(self.rest_target, |stretch| stretch.target)
    }

    /// How often a target was visited before.
    fn visits_of(&self, target: Position) -> u64 {
        let visits = self.visits.iter();
        visits.filter(|&&visit| is_same(visit, target)).count() as u64
    }

    /// The play operator: the output stays until the motor has taken up the
    /// play; moving up it equals the motor, moving down it lags by the play.
    /// Every stretch is monotonic in every axis, so its ends suffice.
    fn output_without_error(&self, time_s: f64, play: Position) -> Position {
        let mut output = self.rest_output;
        for stretch in &self.stretches {
            if stretch.piece.start_s > time_s {
                break;
            }
            let motor = stretch.piece.position(time_s);
            output = std::array::from_fn(|axis| {
                output[axis].clamp(motor[axis], motor[axis] + play[axis])
            });
        }
        output
    }

    fn output(&self, time_s: f64, play: Position) -> Position {
        let error = self
            .stretches
            .iter()
            .rev()
            .find(|stretch| stretch.piece.start_s <= time_s)
            .map_or(self.rest_error, |stretch| stretch.error);
        let output = self.output_without_error(time_s, play);
        std::array::from_fn(|axis| output[axis] + error[axis])
    }

    fn cut(&mut self, time_s: f64) {
        while self
            .stretches
            .back()
            .is_some_and(|stretch| stretch.piece.start_s >= time_s)
        {
            self.stretches.pop_back();
        }
        if let Some(stretch) = self.stretches.back_mut() {
            stretch.piece.cut(time_s);
        }
    }

    fn forget_before(&mut self, time_s: f64, play: Position) {
        while self
            .stretches
            .front()
            .is_some_and(|stretch| stretch.piece.end_s() < time_s)
        {
            if let Some(stretch) = self.stretches.pop_front() {
                let motor = stretch.piece.position(stretch.piece.end_s());
                self.rest = motor;
                self.rest_output = std::array::from_fn(|axis| {
                    self.rest_output[axis].clamp(motor[axis], motor[axis] + play[axis])
                });
                self.rest_error = stretch.error;
                self.rest_target = stretch.target;
            }
        }
    }
}

#[cfg(test)]
mod tests;
