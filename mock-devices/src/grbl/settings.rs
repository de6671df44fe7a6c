//! The `$` settings of GRBL 1.1 (its documentation, `settings.md`).

use crate::motion::Position;

/// Settings by their GRBL numbers. Axis values are per X, Y, Z.
#[derive(Clone, Debug, PartialEq)]
pub struct GrblSettings {
    /// $10: bit 0 reports MPos (else WPos), bit 1 adds the buffer state.
    pub status_mask: u8,
    /// $13: reports in inches.
    pub report_inches: bool,
    /// $20: soft limits.
    pub soft_limits: bool,
    /// $21: hard limits.
    pub hard_limits: bool,
    /// $22: homing cycle.
    pub homing: bool,
    /// $23: axes that home towards their negative end, bit mask.
    pub homing_direction_mask: u8,
    /// $24: speed of the precise approach, mm/min.
    pub homing_feed: f64,
    /// $25: speed of the search, mm/min.
    pub homing_seek: f64,
    /// $26: pause after a switch has closed, ms.
    pub homing_debounce_ms: f64,
    /// $27: distance to which homing backs off the switch, mm.
    pub homing_pull_off: f64,
    /// $30: S value of full power.
    pub spindle_max: f64,
    /// $31: S value of least power.
    pub spindle_min: f64,
    /// $32: laser mode.
    pub laser_mode: bool,
    /// $100–$102: steps per mm.
    pub steps_per_mm: Position,
    /// $110–$112: greatest speed, mm/min.
    pub max_rate: Position,
    /// $120–$122: acceleration, mm/s².
    pub acceleration: Position,
    /// $130–$132: travel, mm.
    pub max_travel: Position,
    /// Those without effect here, by number: $0–$6, $11, $12.
    pub(super) inert: Vec<(u8, f64)>,
}

impl Default for GrblSettings {
    /// A stage of 360 units in X and 90 in Y that homes to their lower ends, with
    /// homing and soft limits on, S1000 full power: 60 and 30 units/s.
    fn default() -> Self {
        Self {
            status_mask: 1,
            report_inches: false,
            soft_limits: true,
            hard_limits: false,
            homing: true,
            homing_direction_mask: 0b011,
            homing_feed: 120.0,
            homing_seek: 1800.0,
            homing_debounce_ms: 25.0,
            homing_pull_off: 1.0,
            spindle_max: 1000.0,
            spindle_min: 0.0,
            laser_mode: false,
            steps_per_mm: [100.0, 100.0, 100.0],
            max_rate: [3600.0, 1800.0, 500.0],
            acceleration: [120.0, 60.0, 10.0],
            max_travel: [360.0, 90.0, 200.0],
            inert: vec![
                (0, 10.0),
                (1, 25.0),
                (2, 0.0),
                (3, 0.0),
                (4, 0.0),
                (5, 0.0),
                (6, 0.0),
                (11, 0.01),
                (12, 0.002),
            ],
        }
    }
}

impl GrblSettings {
    /// Whether an axis homes towards its negative end.
    pub fn homes_down(&self, axis: usize) -> bool {
        self.homing_direction_mask >> axis & 1 == 1
    }

    /// The lines of `$$`.
    pub(super) fn listing(&self) -> String {
        let integer = |number: u8, value: f64| format!("${number}={}\r\n", value as i64);
        let decimal = |number: u8, value: f64| format!("${number}={value:.3}\r\n");
        let flag = |number: u8, value: bool| format!("${number}={}\r\n", u8::from(value));
        let inert = |number: u8| {
            self.inert
                .iter()
                .find(|(n, _)| *n == number)
                .map_or(0.0, |(_, value)| *value)
        };
        let mut text = String::new();
        for number in 0..=6 {
            text += &integer(number, inert(number));
        }
        text += &integer(10, f64::from(self.status_mask));
        text += &decimal(11, inert(11));
        text += &decimal(12, inert(12));
        text += &flag(13, self.report_inches);
        text += &flag(20, self.soft_limits);
        text += &flag(21, self.hard_limits);
        text += &flag(22, self.homing);
        text += &integer(23, f64::from(self.homing_direction_mask));
        text += &decimal(24, self.homing_feed);
        text += &decimal(25, self.homing_seek);
        text += &integer(26, self.homing_debounce_ms);
        text += &decimal(27, self.homing_pull_off);
        text += &integer(30, self.spindle_max.round());
        text += &integer(31, self.spindle_min.round());
        text += &flag(32, self.laser_mode);
        for (first, values) in [
            (100, self.steps_per_mm),
            (110, self.max_rate),
            (120, self.acceleration),
            (130, self.max_travel),
        ] {
            for (axis, value) in values.into_iter().enumerate() {
                text += &decimal(first + axis as u8, value);
            }
        }
        text
    }

    /// `$number=value`; an error code of GRBL if it is refused.
    pub(super) fn store(&mut self, number: u8, value: f64) -> Result<(), u8> {
        if value < 0.0 {
            return Err(4);
        }
        let on = value.trunc() as u8 != 0;
        let integer = value.trunc() as u8;
        match number {
            0 if integer < 3 => return Err(6),
            0..=6 | 11 | 12 => {
                if let Some(entry) = self.inert.iter_mut().find(|(n, _)| *n == number) {
                    entry.1 = value;
                }
            }
            10 => self.status_mask = integer,
            13 => self.report_inches = on,
            20 if on && !self.homing => return Err(10),
            20 => self.soft_limits = on,
            21 => self.hard_limits = on,
            22 => {
                self.homing = on;
                self.soft_limits &= on;
            }
            23 => self.homing_direction_mask = integer,
            24 => self.homing_feed = value,
            25 => self.homing_seek = value,
            26 => self.homing_debounce_ms = f64::from(integer),
            27 => self.homing_pull_off = value,
            30 => self.spindle_max = value,
            31 => self.spindle_min = value,
            32 => self.laser_mode = on,
            100..=102 => self.steps_per_mm[usize::from(number - 100)] = value,
            110..=112 => self.max_rate[usize::from(number - 110)] = value,
            120..=122 => self.acceleration[usize::from(number - 120)] = value,
            130..=132 => self.max_travel[usize::from(number - 130)] = value,
            _ => return Err(3),
        }
        Ok(())
    }
}
