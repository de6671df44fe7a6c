//! The limit switches, and the cycle that finds them.

use super::firmware::{Firmware, Mode};
use super::planner::Planner;
use crate::motion::{Piece, trapezoid};

/// Homing searches this many times the travel before it gives up.
const SEARCH_FACTOR: f64 = 1.5;

impl Firmware {
    /// Where the switch of an axis closes, motor coordinates.
    pub(super) fn switch_mm(&self, axis: usize) -> f64 {
        let settings = &self.config.settings;
        let away = if settings.homes_down(axis) { -1.0 } else { 1.0 };
        self.home_mm(axis) + away * settings.homing_pull_off
    }

    /// The position that an axis has after homing.
    pub(super) fn home_mm(&self, axis: usize) -> f64 {
        let settings = &self.config.settings;
        if self.config.zero_at_home {
            0.0
        } else if settings.homes_down(axis) {
            settings.homing_pull_off - settings.max_travel[axis]
        } else {
            -settings.homing_pull_off
        }
    }

    /// Letters of the axes whose switch is closed.
    pub(super) fn limit_pins(&self) -> String {
        let motor = self.bench.motor_position();
        self.config
            .homing_order
            .iter()
            .filter(|&&axis| self.switch_closed(axis, motor[axis]))
            .map(|&axis| ["X", "Y", "Z"][axis])
            .collect()
    }

    pub(super) fn switch_closed(&self, axis: usize, motor_mm: f64) -> bool {
        let beyond = motor_mm - self.switch_mm(axis);
        if self.config.settings.homes_down(axis) {
            beyond <= 1e-9
        } else {
            beyond >= -1e-9
        }
    }

    pub(super) fn check_limit_switches(&mut self, now_s: f64) {
        let moving = self.mode == Mode::Normal && !self.planner.is_empty();
        if moving && self.config.settings.hard_limits && !self.limit_pins().is_empty() {
            self.raise_alarm(1, now_s);
        }
    }

    /// Search at the seek rate, back off, approach at the feed rate, back off:
    /// for each axis in turn.
    pub(super) fn begin_homing(&mut self, now_s: f64) {
        let settings = self.config.settings.clone();
        let mut at = self.bench.begin_homing();
        let mut pieces: Vec<Piece> = Vec::new();
        let mut time_s = now_s;
        let mut fails = false;
        for &axis in &self.config.homing_order {
            let switch = self.switch_mm(axis);
            let sign = if settings.homes_down(axis) { -1.0 } else { 1.0 };
            let distance = (switch - at[axis]) * sign;
            let search = SEARCH_FACTOR * settings.max_travel[axis];
            fails = distance > search;
            let back = switch - sign * settings.homing_pull_off;
            let found = if fails {
                at[axis] + sign * search
            } else {
                switch
            };
            let legs: &[(f64, f64)] = if fails {
                &[(found, settings.homing_seek)]
            } else {
                &[
                    (found, settings.homing_seek),
                    (back, settings.homing_feed),
                    (switch, settings.homing_feed),
                    (back, settings.homing_feed),
                ]
            };
            for &(to_mm, rate) in legs {
                let mut to = at;
                to[axis] = to_mm;
                let speed = (rate / 60.0).min(settings.max_rate[axis] / 60.0).max(1e-3);
                let acceleration = settings.acceleration[axis].max(1e-3);
                let leg = trapezoid(at, to, time_s, speed, acceleration);
                time_s =
                    leg.last().map_or(time_s, Piece::end_s) + settings.homing_debounce_ms / 1000.0;
                pieces.extend(leg);
                at = to;
            }
            if fails {
                break;
            }
        }
        self.planner = Planner::at(at);
        self.bench.follow(now_s, &pieces);
        self.mode = Mode::Home {
            start_s: now_s,
            end_s: time_s,
            fails,
        };
    }

    pub(super) fn end_homing(&mut self, end_s: f64, fails: bool) {
        if fails {
            self.abort(end_s, Some(9));
            return;
        }
        let mut position = self.planner.position(end_s);
        for &axis in &self.config.homing_order {
            position[axis] = self.home_mm(axis);
        }
        self.planner = Planner::at(position);
        self.modal.position = position;
        self.bench.end_homing(&self.config.homing_order);
        self.bench.set_alarm(None);
        self.mode = Mode::Normal;
        self.run_startup_after_homing();
    }
}
