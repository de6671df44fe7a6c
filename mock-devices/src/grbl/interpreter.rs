//! What a line of G-code does to the parser's state, and what remains to be
//! done when it is accepted.

use super::firmware::{Action, Firmware, Mode};
use super::gcode::{self, Block, Motion, Once, Program, Spindle};
use crate::motion::Position;
use std::collections::VecDeque;

/// The parser's state.
#[derive(Clone, Debug)]
pub(super) struct Modal {
    pub motion: Motion,
    pub inches: bool,
    pub relative: bool,
    pub plane: u8,
    pub coordinates: usize,
    pub spindle: Spindle,
    pub mist: bool,
    pub flood: bool,
    /// mm/min.
    pub feed: f64,
    pub speed: f64,
    pub tool: f64,
    /// The G92 offset, mm.
    pub shift: Position,
    /// Where the parser has got to, mm, machine coordinates.
    pub position: Position,
}

impl Modal {
    pub(super) fn at(position: Position) -> Self {
        Self {
            motion: Motion::Seek,
            inches: false,
            relative: false,
            plane: 17,
            coordinates: 0,
            spindle: Spindle::Off,
            mist: false,
            flood: false,
            feed: 0.0,
            speed: 0.0,
            tool: 0.0,
            shift: [0.0; 3],
            position,
        }
    }
}

impl Firmware {
    pub(super) fn work_offset(&self) -> Position {
        let base = self.offsets[self.modal.coordinates];
        std::array::from_fn(|axis| base[axis] + self.modal.shift[axis])
    }

    /// The parser: an error code (and nothing has changed), or the modal state
    /// is the new one and the actions are what remains.
    pub(super) fn plan_line(&mut self, line: &str, jog: bool) -> Result<VecDeque<Action>, u8> {
        let block = gcode::parse(line)?;
        let mut modal = self.modal.clone();
        let mut actions = VecDeque::new();
        // A jog: nothing but a move.
        if jog {
            if block.not_for_jog {
                return Err(16);
            }
            if block.speed.is_some() || block.tool.is_some() {
                return Err(36);
            }
            if !block.has_axes() {
                return Err(26);
            }
            let scale = unit(block.inches.unwrap_or(modal.inches));
            let Some(feed) = block.feed.filter(|&feed| feed > 0.0) else {
                return Err(22);
            };
            let to = self.target(&block, &modal);
            if self.config.settings.soft_limits && self.outside(to) {
                return Err(15);
            }
            // A jog changes no mode, only the position.
            self.modal.position = to;
            actions.push_back(Action::Move {
                to,
                speed: feed * scale / 60.0,
                jog: true,
            });
            return Ok(actions);
        }
        // Modes, and whether they allow the motion.
        modal.inches = block.inches.unwrap_or(modal.inches);
        modal.relative = block.relative.unwrap_or(modal.relative);
        modal.plane = block.plane.unwrap_or(modal.plane);
        modal.motion = block.motion.unwrap_or(modal.motion);
        modal.tool = block.tool.unwrap_or(modal.tool);
        modal.feed = block
            .feed
            .map_or(modal.feed, |feed| feed * unit(modal.inches));
        let moves = block.has_axes()
            && !matches!(block.once, Some(Once::SetOffset { .. } | Once::ShiftOrigin));
        if moves {
            match modal.motion {
                Motion::None => return Err(31),
                Motion::Feed if modal.feed == 0.0 => return Err(22),
                _ if matches!(block.once, Some(Once::Dwell | Once::ClearShift)) => return Err(24),
                _ => {}
            }
        }
        if block.machine_coordinates && modal.motion == Motion::None {
            return Err(30);
        }

        // Spindle, coolant, dwell.
        let speed = block.speed.unwrap_or(modal.speed);
        let spindle = block.spindle.unwrap_or(modal.spindle);
        let lit = spindle != Spindle::Off;
        if spindle != modal.spindle || (lit && speed != modal.speed) {
            if !self.config.settings.laser_mode {
                actions.push_back(Action::Synchronise);
            }
            actions.push_back(Action::Spindle(spindle, speed));
        }
        modal.speed = speed;
        modal.spindle = spindle;
        if let Some(coolant) = block.coolant {
            Self::apply_coolant(&mut modal.mist, &mut modal.flood, coolant);
            actions.push_back(Action::Synchronise);
            actions.push_back(Action::Coolant {
                mist: modal.mist,
                flood: modal.flood,
            });
        }
        if block.once == Some(Once::Dwell) {
            actions.push_back(Action::Synchronise);
            actions.push_back(Action::Dwell(block.p.unwrap_or(0.0)));
        }
        // Offsets of the coordinates.
        let mut new_offset = None;
        if let Some(coordinates) = block.coordinates {
            modal.coordinates = coordinates;
            self.refresh.wco_changed();
        }
        match block.once {
            Some(Once::SetOffset { from_position }) => {
                let index = match block.p.map_or(0, |p| p as usize) {
                    0 => modal.coordinates,
                    p => p - 1,
                };
                let mut offset = self.offsets[index];
                for (axis, value) in block.axes.iter().enumerate() {
                    if let Some(value) = value {
                        let value = value * unit(modal.inches);
                        offset[axis] = if from_position {
                            modal.position[axis] - modal.shift[axis] - value
                        } else {
                            value
                        };
                    }
                }
                new_offset = Some((index, offset));
            }
            Some(Once::ShiftOrigin) => {
                let base = self.offsets[modal.coordinates];
                for (axis, value) in block.axes.iter().enumerate() {
                    if let Some(value) = value {
                        modal.shift[axis] =
                            modal.position[axis] - base[axis] - value * unit(modal.inches);
                    }
                }
                self.refresh.wco_changed();
            }
            Some(Once::ClearShift) => {
                modal.shift = [0.0; 3];
                self.refresh.wco_changed();
            }
            _ => {}
        }
        if let Some((index, offset)) = new_offset {
            self.offsets[index] = offset;
            self.refresh.wco_changed();
        }
        // The motion.
        if moves {
            let to = self.target(&block, &modal);
            modal.position = to;
            let speed = match modal.motion {
                Motion::Seek => f64::INFINITY,
                _ => modal.feed / 60.0,
            };
            if self.config.settings.soft_limits && self.outside(to) {
                actions.push_back(Action::SoftLimit);
            } else {
                actions.push_back(Action::Move {
                    to,
                    speed,
                    jog: false,
                });
            }
        }
        // The program's flow.
        match block.program {
            Some(Program::Pause) => {
                actions.push_back(Action::Synchronise);
                actions.push_back(Action::Pause);
            }
            Some(Program::End(_)) => {
                modal.motion = Motion::Feed;
                modal.plane = 17;
                modal.relative = false;
                modal.coordinates = 0;
                modal.spindle = Spindle::Off;
                (modal.mist, modal.flood) = (false, false);
                actions.push_back(Action::Synchronise);
                actions.push_back(Action::ProgramEnd);
            }
            None => {}
        }
        if self.mode == Mode::Check {
            actions.retain(|action| matches!(action, Action::SoftLimit));
        }
        self.modal = modal;
        Ok(actions)
    }

    /// Machine coordinates, on a whole step, of where a block wants to go.
    pub(super) fn target(&self, block: &Block, modal: &Modal) -> Position {
        let scale = unit(block.inches.unwrap_or(modal.inches));
        let relative = block.relative.unwrap_or(modal.relative);
        let base = self.offsets[modal.coordinates];
        std::array::from_fn(|axis| {
            let Some(value) = block.axes[axis] else {
                return modal.position[axis];
            };
            let value = value * scale;
            let target = if block.machine_coordinates {
                value
            } else if relative {
                modal.position[axis] + value
            } else {
                value + base[axis] + modal.shift[axis]
            };
            let steps = self.config.settings.steps_per_mm[axis];
            if steps > 0.0 {
                (target * steps).round() / steps
            } else {
                target
            }
        })
    }

    pub(super) fn outside(&self, to: Position) -> bool {
        let settings = &self.config.settings;
        (0..3).any(|axis| {
            let travel = settings.max_travel[axis];
            let (low, high) = if self.config.zero_at_home && settings.homes_down(axis) {
                (0.0, travel)
            } else {
                (-travel, 0.0)
            };
            !(low..=high).contains(&to[axis])
        })
    }
}

/// Millimetres per unit.
fn unit(inches: bool) -> f64 {
    if inches { 25.4 } else { 1.0 }
}
