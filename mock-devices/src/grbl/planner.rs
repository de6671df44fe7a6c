//! The queue of straight moves and the motion that follows from it.
//!
//! Moves begin and end at rest. (GRBL joins moves that follow each other at the
//! junction's speed; stopping between them makes a chain of moves a little
//! slower here, and a single move exactly as long.)

use crate::motion::{Piece, Position, along, limit_along, line, trapezoid};
use std::collections::VecDeque;

/// Moves that GRBL holds, the one under way included.
pub(super) const CAPACITY: usize = 15;

#[derive(Clone, Copy, Debug)]
struct Move {
    to: Position,
    speed: f64,
    acceleration: f64,
    end_s: f64,
}

/// The queue, in the firmware's machine coordinates.
#[derive(Clone, Debug, Default)]
pub(super) struct Planner {
    /// Where the first of the moves begins, or the position at rest.
    from: Position,
    moves: VecDeque<Move>,
    pieces: Vec<Piece>,
    /// Since when it has moved without rest.
    moving_since_s: f64,
    /// Braking or braked by a hold; the time at which it stands.
    held: Option<f64>,
    jogging: bool,
}

impl Planner {
    pub(super) fn at(position: Position) -> Self {
        Self {
            from: position,
            ..Self::default()
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.moves.is_empty()
    }

    pub(super) fn free(&self) -> usize {
        CAPACITY - self.moves.len().min(CAPACITY)
    }

    pub(super) fn is_jogging(&self) -> bool {
        self.jogging && !self.moves.is_empty()
    }

    /// The stretches of the moves queued, for the drives to follow.
    pub(super) fn pieces(&self) -> &[Piece] {
        &self.pieces
    }

    /// When the last move ends, or the brake is at rest.
    pub(super) fn end_s(&self) -> Option<f64> {
        self.held
            .or_else(|| self.moves.back().map(|last| last.end_s))
    }

    /// When the first move ends and its place in the queue is free.
    pub(super) fn first_end_s(&self) -> Option<f64> {
        self.moves.front().map(|first| first.end_s)
    }

    pub(super) fn moving_since_s(&self) -> Option<f64> {
        (!self.moves.is_empty()).then_some(self.moving_since_s)
    }

    pub(super) fn position(&self, now_s: f64) -> Position {
        self.pieces
            .iter()
            .rev()
            .find(|piece| piece.start_s <= now_s)
            .map_or(self.from, |piece| piece.position(now_s))
    }

    /// mm/s.
    pub(super) fn speed(&self, now_s: f64) -> f64 {
        self.pieces
            .iter()
            .rev()
            .find(|piece| piece.start_s <= now_s)
            .filter(|piece| now_s < piece.end_s())
            .map_or(0.0, |piece| piece.speed_at(now_s))
    }

    /// Where the queue will have brought it.
    pub(super) fn target(&self) -> Position {
        self.moves.back().map_or(self.from, |last| last.to)
    }

    /// Adds a move, speeds in mm/s and mm/s² along its line. Nothing if it is there already.
    pub(super) fn push(
        &mut self,
        now_s: f64,
        to: Position,
        speed: f64,
        limits: (Position, Position),
        jog: bool,
    ) {
        let from = self.target();
        let Some((direction, _)) = line(from, to) else {
            return;
        };
        let (max_speed, max_acceleration) = limits;
        let speed = speed.min(limit_along(direction, max_speed));
        let acceleration = limit_along(direction, max_acceleration);
        if !(speed > 0.0 && acceleration > 0.0) {
            return;
        }
        let start_s = match self.moves.back() {
            Some(last) => last.end_s.max(now_s),
            None => {
                self.moving_since_s = now_s;
                self.pieces.clear();
                now_s
            }
        };
        let pieces = trapezoid(from, to, start_s, speed, acceleration);
        let end_s = pieces.last().map_or(start_s, Piece::end_s);
        self.pieces.extend(pieces);
        self.jogging = jog;
        self.moves.push_back(Move {
            to,
            speed,
            acceleration,
            end_s,
        });
    }

    /// Forgets the moves that are over.
    pub(super) fn retire(&mut self, now_s: f64) {
        if self.held.is_some() {
            return;
        }
        while let Some(first) = self.moves.front().filter(|first| first.end_s <= now_s) {
            let end_s = first.end_s;
            self.from = first.to;
            self.moves.pop_front();
            self.pieces.retain(|piece| piece.end_s() > end_s);
        }
    }

    /// Brakes as hard as the move under way accelerates, and keeps the rest of it.
    pub(super) fn hold(&mut self, now_s: f64) {
        if self.held.is_some() {
            return;
        }
        let at = self.position(now_s);
        let speed = self.speed(now_s);
        self.from = at;
        self.pieces.clear();
        self.held = Some(now_s);
        let Some(first) = self.moves.front() else {
            return;
        };
        let Some((direction, left)) = line(at, first.to) else {
            return;
        };
        let duration_s = speed / first.acceleration;
        if duration_s <= 0.0 {
            return;
        }
        // Every move can stop before its end; rounding may not carry it beyond.
        let length = (0.5 * speed * duration_s).min(left);
        let to = along(at, direction, length);
        self.pieces.push(Piece {
            start_s: now_s,
            duration_s,
            from: at,
            to,
            direction,
            speed,
            acceleration: -speed / duration_s,
        });
        self.from = to;
        self.held = Some(now_s + duration_s);
    }

    pub(super) fn is_braking(&self, now_s: f64) -> bool {
        self.held.is_some_and(|end_s| now_s < end_s)
    }

    /// Goes on with what a hold interrupted.
    pub(super) fn resume(&mut self, now_s: f64) {
        if self.held.take().is_none() {
            return;
        }
        self.pieces.clear();
        let mut from = self.from;
        let mut start_s = now_s;
        self.moving_since_s = now_s;
        for planned in &mut self.moves {
            let pieces = trapezoid(
                from,
                planned.to,
                start_s,
                planned.speed,
                planned.acceleration,
            );
            start_s = pieces.last().map_or(start_s, Piece::end_s);
            planned.end_s = start_s;
            from = planned.to;
            self.pieces.extend(pieces);
        }
    }

    /// Forgets all moves and stands where it is, at once.
    pub(super) fn clear(&mut self, now_s: f64) {
        *self = Self::at(self.position(now_s));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: (Position, Position) = ([10.0; 3], [50.0; 3]);

    #[test]
    fn a_hold_brakes_along_the_line_and_a_resume_reaches_the_target() {
        let mut planner = Planner::at([0.0; 3]);
        planner.push(0.0, [100.0, 0.0, 0.0], 10.0, LIMITS, false);
        let undisturbed_s = planner.end_s().unwrap();
        planner.hold(5.0);
        // v²/2a = 1 mm beyond the position at 5 s, reached after v/a = 0.2 s.
        let at = 10.0 * 5.0 - 1.0;
        assert!((planner.position(9.0)[0] - (at + 1.0)).abs() < 1e-9);
        assert!(planner.is_braking(5.1) && !planner.is_braking(5.2 + 1e-9));
        planner.retire(9.0);
        planner.resume(9.0);
        planner.retire(60.0);
        assert!(planner.is_empty());
        assert_eq!(planner.position(60.0)[0], 100.0);
        // The stop costs its braking and its starting ramp: 0.2 s more than the pause.
        let mut again = Planner::at([0.0; 3]);
        again.push(0.0, [100.0, 0.0, 0.0], 10.0, LIMITS, false);
        again.hold(5.0);
        again.resume(5.2);
        assert!((again.end_s().unwrap() - (undisturbed_s + 0.2)).abs() < 1e-9);
    }

    #[test]
    fn queued_moves_follow_each_other_and_free_their_places() {
        let mut planner = Planner::at([0.0; 3]);
        for i in 1..=CAPACITY {
            planner.push(0.0, [i as f64, 0.0, 0.0], 10.0, LIMITS, true);
        }
        assert_eq!(planner.free(), 0);
        assert!(planner.is_jogging());
        let each_s = 2.0 * (1.0_f64 / 50.0).sqrt();
        assert!((planner.end_s().unwrap() - 15.0 * each_s).abs() < 1e-9);
        planner.retire(3.5 * each_s);
        assert_eq!(planner.free(), 3);
        assert!((planner.position(3.5 * each_s)[0] - 3.5).abs() < 1e-9);
        planner.clear(3.5 * each_s);
        assert!(planner.is_empty());
        assert!((planner.position(99.0)[0] - 3.5).abs() < 1e-9);
    }
}
