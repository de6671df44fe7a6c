//! One axis of a controller: where it believes to be, and what it does.

use crate::motion::{Piece, trapezoid};

/// What an axis is under way to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Task {
    Move,
    Home,
    /// `tools gotolimit`: ends at the sensor, wherever that is.
    FindSensor,
}

/// Positions are those of the firmware, in the bench's units (one is
/// `microsteps_per_unit` microsteps).
#[derive(Clone, Debug)]
pub(super) struct Axis {
    pub microsteps_per_unit: f64,
    /// Travel, microsteps: from 0.
    pub limit_max: i64,
    /// Settings `maxspeed` and `accel`, in the protocol's units.
    pub max_speed: i64,
    pub accel: i64,
    /// Has no reference position since its power came (WR).
    pub no_reference: bool,
    /// Stalled and stopped (FS).
    pub stalled: bool,
    /// A move was interrupted by another command (NI).
    pub interrupted: bool,
    pub disabled: bool,
    rest: f64,
    way: Option<(Task, Vec<Piece>)>,
}

impl Axis {
    pub(super) fn new(microsteps_per_unit: f64, limit_max: i64, speed: f64, accel: f64) -> Self {
        // Data are microsteps/s × 1.6384 and microsteps/s² × 1.6384 / 10⁴.
        let max_speed = speed * microsteps_per_unit * SPEED_UNIT;
        let accel = accel * microsteps_per_unit * SPEED_UNIT / 1e4;
        Self {
            microsteps_per_unit,
            limit_max,
            max_speed: max_speed.round() as i64,
            accel: (accel.round() as i64).max(1),
            no_reference: true,
            stalled: false,
            interrupted: false,
            disabled: false,
            rest: 0.0,
            way: None,
        }
    }

    pub(super) fn position(&self, now_s: f64) -> f64 {
        match &self.way {
            Some((_, pieces)) => pieces
                .iter()
                .rev()
                .find(|piece| piece.start_s <= now_s)
                .map_or(self.rest, |piece| piece.position(now_s)[0]),
            None => self.rest,
        }
    }

    pub(super) fn microsteps(&self, now_s: f64) -> i64 {
        (self.position(now_s) * self.microsteps_per_unit).round() as i64
    }

    pub(super) fn is_busy(&self) -> bool {
        self.way.is_some()
    }

    pub(super) fn end_s(&self) -> Option<f64> {
        let (_, pieces) = self.way.as_ref()?;
        pieces.last().map(Piece::end_s)
    }

    /// Starts a way from rest (a moving axis halts first).
    pub(super) fn start(&mut self, task: Task, to: f64, now_s: f64) {
        self.interrupted = self.is_busy();
        self.halt(now_s);
        let speed = self.max_speed as f64 / SPEED_UNIT / self.microsteps_per_unit;
        let acceleration = self.accel as f64 * 1e4 / SPEED_UNIT / self.microsteps_per_unit;
        let pieces = trapezoid(
            [self.rest, 0.0, 0.0],
            [to, 0.0, 0.0],
            now_s,
            speed,
            acceleration,
        );
        self.way = Some((task, pieces));
    }

    /// Stands still at once where it is; whether it had moved.
    pub(super) fn halt(&mut self, now_s: f64) -> bool {
        self.rest = self.position(now_s);
        self.way.take().is_some()
    }

    /// What has come to its end by now.
    pub(super) fn finish(&mut self, now_s: f64) -> Option<Task> {
        let (task, _) = self.way.as_ref()?;
        if self.end_s().is_some_and(|end_s| now_s < end_s) {
            return None;
        }
        let task = *task;
        self.rest = self.position(now_s);
        self.way = None;
        Some(task)
    }

    pub(super) fn set_position(&mut self, position: f64) {
        self.rest = position;
    }

    /// Flags, the most important first.
    pub(super) fn flags(&self) -> Vec<&'static str> {
        let all = [
            (self.disabled, "FO"),
            (self.stalled, "FS"),
            (self.no_reference, "WR"),
            (self.interrupted, "NI"),
        ];
        all.into_iter()
            .filter_map(|(set, flag)| set.then_some(flag))
            .collect()
    }
}

/// Data of `maxspeed` per microstep/s.
pub(super) const SPEED_UNIT: f64 = 1.6384;
