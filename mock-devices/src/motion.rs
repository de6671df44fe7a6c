//! Acceleration-limited motion along straight lines, in closed form.

/// Position of the three axes in motor coordinates, millimetres (on a rotary
/// axis the firmware's "mm" is whatever one unit turns it by).
pub type Position = [f64; 3];

/// One stretch of motion with constant acceleration along a straight line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Piece {
    /// When it begins, seconds on the bench's clock.
    pub start_s: f64,
    /// How long it lasts, seconds.
    pub duration_s: f64,
    /// Where it begins.
    pub from: Position,
    /// Where it ends: exactly, so that a position does not depend on the way there.
    pub to: Position,
    /// Unit vector of the motion.
    pub direction: Position,
    /// Speed at its beginning, mm/s.
    pub speed: f64,
    /// Acceleration along the direction, mm/s²; negative while braking.
    pub acceleration: f64,
}

impl Piece {
    /// When it ends, seconds on the bench's clock.
    pub fn end_s(&self) -> f64 {
        self.start_s + self.duration_s
    }

    /// Ends it at a time, if it lasts that long.
    pub(crate) fn cut(&mut self, time_s: f64) {
        if time_s < self.end_s() {
            self.to = self.position(time_s);
            self.duration_s = time_s - self.start_s;
        }
    }

    fn clamped(&self, time_s: f64) -> f64 {
        (time_s - self.start_s).clamp(0.0, self.duration_s)
    }

    /// Distance covered by then, mm.
    pub fn travelled(&self, time_s: f64) -> f64 {
        let t = self.clamped(time_s);
        (self.speed + 0.5 * self.acceleration * t) * t
    }

    /// Where it is at a time; at its ends outside of it.
    pub fn position(&self, time_s: f64) -> Position {
        if time_s >= self.end_s() {
            return self.to;
        }
        along(self.from, self.direction, self.travelled(time_s))
    }

    /// Speed at a time within it, mm/s.
    pub fn speed_at(&self, time_s: f64) -> f64 {
        (self.speed + self.acceleration * self.clamped(time_s)).max(0.0)
    }
}

/// The point at a distance along a direction.
pub fn along(from: Position, direction: Position, distance: f64) -> Position {
    std::array::from_fn(|axis| from[axis] + direction[axis] * distance)
}

/// Unit vector and distance from one position to another; `None` if they are the same.
pub fn line(from: Position, to: Position) -> Option<(Position, f64)> {
    let delta: Position = std::array::from_fn(|axis| to[axis] - from[axis]);
    let length = delta.iter().map(|d| d * d).sum::<f64>().sqrt();
    (length > 1e-9).then(|| (delta.map(|d| d / length), length))
}

/// The largest magnitude along a direction that keeps every axis within its own
/// limit: min over the axes of limit / |component|.
pub fn limit_along(direction: Position, limits: Position) -> f64 {
    direction
        .iter()
        .zip(limits)
        .filter(|(component, _)| component.abs() > 1e-12)
        .map(|(component, limit)| limit / component.abs())
        .fold(f64::INFINITY, f64::min)
}

/// Rest to rest with a trapezoid (or triangle) of speed: accelerate, cruise at
/// `max_speed` if the way is long enough, brake. Takes d/v + v/a where
/// d ≥ v²/a, else 2 √(d/a).
pub fn trapezoid(
    from: Position,
    to: Position,
    start_s: f64,
    max_speed: f64,
    acceleration: f64,
) -> Vec<Piece> {
    let Some((direction, length)) = line(from, to) else {
        return Vec::new();
    };
    let peak = max_speed.min((acceleration * length).sqrt());
    let ramp_s = peak / acceleration;
    let ramp_length = 0.5 * peak * ramp_s;
    let cruise_s = ((length - 2.0 * ramp_length) / peak).max(0.0);
    let stretches = [
        (ramp_s, 0.0, acceleration, 0.0),
        (cruise_s, peak, 0.0, ramp_length),
        (ramp_s, peak, -acceleration, length - ramp_length),
    ];
    let mut pieces: Vec<Piece> = Vec::with_capacity(3);
    let mut begin_s = start_s;
    for (duration_s, speed, acceleration, done) in stretches {
        if duration_s > 0.0 {
            if let Some(before) = pieces.last_mut() {
                before.to = along(from, direction, done);
            }
            pieces.push(Piece {
                start_s: begin_s,
                duration_s,
                from: along(from, direction, done),
                to,
                direction,
                speed,
                acceleration,
            });
            begin_s += duration_s;
        }
    }
    pieces
}

#[cfg(test)]
mod tests {
    use super::*;

    /// (distance, speed limit, acceleration): long, exactly triangular, short.
    const CASES: [(f64, f64, f64); 4] = [
        (100.0, 10.0, 50.0),
        (2.0, 10.0, 50.0),
        (0.5, 10.0, 50.0),
        (360.0, 60.0, 120.0),
    ];

    #[test]
    fn duration_and_length_are_those_of_the_closed_form() {
        for (distance, speed, acceleration) in CASES {
            let to = [distance * 0.6, -distance * 0.8, 0.0];
            let pieces = trapezoid([0.0; 3], to, 7.0, speed, acceleration);
            let expected_s = if distance >= speed * speed / acceleration {
                distance / speed + speed / acceleration
            } else {
                2.0 * (distance / acceleration).sqrt()
            };
            let last = pieces.last().unwrap();
            assert!((last.end_s() - 7.0 - expected_s).abs() < 1e-9);
            assert_eq!(last.position(last.end_s()), to, "distance {distance}");
            let nearly = last.position(last.end_s() - 1e-9);
            for (reached, wanted) in nearly.iter().zip(to) {
                assert!((reached - wanted).abs() < 1e-9, "distance {distance}");
            }
            assert!(last.speed_at(1e9) < 1e-6, "ends at rest");
        }
    }

    #[test]
    fn position_and_speed_are_continuous_between_pieces() {
        for (distance, speed, acceleration) in CASES {
            let pieces = trapezoid(
                [1.0; 3],
                [1.0 + distance, 1.0, 1.0],
                0.0,
                speed,
                acceleration,
            );
            for pair in pieces.windows(2) {
                let t = pair[1].start_s;
                assert!((pair[0].position(t)[0] - pair[1].position(t)[0]).abs() < 1e-9);
                assert!((pair[0].speed_at(t) - pair[1].speed_at(t)).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn the_slowest_axis_limits_a_diagonal() {
        let limit = limit_along([0.6, 0.8, 0.0], [6.0, 4.0, 1.0]);
        assert!((limit - 5.0).abs() < 1e-12);
    }
}
