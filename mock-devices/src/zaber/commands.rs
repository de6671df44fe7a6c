//! What the devices do with a command.

use super::axis::Task;
use super::chain::Chain;
use super::message::Command;

/// Relative flux is set in thousandths of its maximum.
const FLUX_MAX: f64 = 1000.0;

type Outcome = Result<String, &'static str>;

fn done() -> Outcome {
    Ok("0".to_owned())
}

impl Chain {
    pub(super) fn obey(&mut self, device: u8, command: &Command, now_s: f64) {
        let words: Vec<&str> = command.words.iter().map(String::as_str).collect();
        let last_axis = if device == 1 { 2 } else { 3 };
        let outcome = if command.axis > last_axis {
            Err("BADAXIS")
        } else if device == 1 {
            self.controller(command.axis, &words, now_s)
        } else {
            self.illuminator(command.axis, &words, now_s)
        };
        self.reply(device, command, outcome);
    }

    fn controller(&mut self, axis: u8, words: &[&str], now_s: f64) -> Outcome {
        let indices = self.axes_of(1, axis);
        match words {
            [] => done(),
            ["home"] => {
                for index in indices {
                    let to = self.sensor(index);
                    self.start(index, Task::Home, to, now_s);
                }
                done()
            }
            ["move", how, rest @ ..] => {
                let mut targets = Vec::new();
                for index in indices {
                    targets.push((index, self.target(index, how, rest, now_s)?));
                }
                for (index, to) in targets {
                    self.start(index, Task::Move, to, now_s);
                }
                done()
            }
            ["stop" | "estop"] => {
                for index in indices {
                    let moved = self.halt(index, now_s);
                    self.axes[index].interrupted |= moved;
                }
                done()
            }
            // Limit, direction, action, whether the position is updated there.
            ["tools", "gotolimit", "home", "neg", _, "0"] => {
                for index in indices {
                    let to = self.sensor(index);
                    self.start(index, Task::FindSensor, to, now_s);
                }
                done()
            }
            ["driver", word @ ("disable" | "enable")] => {
                for index in indices {
                    self.axes[index].disabled = *word == "disable";
                }
                done()
            }
            ["io", _, ..] if axis != 0 => Err("DEVICEONLY"),
            ["io", "set", "do", port, state] => {
                let output = port.parse::<usize>().ok().and_then(|n| n.checked_sub(1));
                let output = output
                    .filter(|&n| n < self.outputs.len())
                    .ok_or("BADDATA")?;
                self.outputs[output] = match *state {
                    "0" => false,
                    "1" => true,
                    "t" => !self.outputs[output],
                    _ => return Err("BADDATA"),
                };
                self.light(now_s);
                done()
            }
            ["io", "get", "do"] => Ok(self.outputs.map(|on| u8::from(on).to_string()).join(" ")),
            ["io", "get", "do", port] => {
                let output = port.parse::<usize>().ok().and_then(|n| n.checked_sub(1));
                let on = output.and_then(|n| self.outputs.get(n)).ok_or("BADDATA")?;
                Ok(u8::from(*on).to_string())
            }
            ["io", "info"] => Ok("0 4 0 0".to_owned()),
            ["warnings", rest @ ..] => {
                let mut flags = Vec::new();
                for &index in &indices {
                    flags.extend(self.axes[index].flags());
                    if rest == ["clear"] {
                        self.axes[index].interrupted = false;
                        self.axes[index].stalled = false;
                    }
                }
                flags.dedup();
                let list: String = flags.iter().map(|flag| format!(" {flag}")).collect();
                Ok(format!("{:02}{list}", flags.len()))
            }
            ["system", "reset"] => {
                self.power_up();
                done()
            }
            ["get", name] => self.get(axis, name, now_s),
            ["set", name, value] => self.set(axis, name, value),
            _ => Err("BADCOMMAND"),
        }
    }

    fn target(
        &self,
        index: usize,
        how: &str,
        rest: &[&str],
        now_s: f64,
    ) -> Result<f64, &'static str> {
        let axis = &self.axes[index];
        if axis.disabled {
            return Err("DRIVERDISABLED");
        }
        let value = |rest: &[&str]| match rest {
            [text] => text.parse::<i64>().map_err(|_| "BADDATA"),
            _ => Err("BADDATA"),
        };
        let microsteps = match how {
            "abs" => value(rest)?,
            "rel" => value(rest)?.saturating_add(axis.microsteps(now_s)),
            "min" => 0,
            "max" => axis.limit_max,
            _ => return Err("BADCOMMAND"),
        };
        if !(0..=axis.limit_max).contains(&microsteps) {
            return Err("BADDATA");
        }
        Ok(microsteps as f64 / axis.microsteps_per_unit)
    }

    fn get(&self, axis: u8, name: &str, now_s: f64) -> Outcome {
        if let Some(value) = self.common(1, name) {
            return Ok(value);
        }
        let of_axis = |index: usize| -> Option<String> {
            let axis = &self.axes[index];
            Some(match name {
                "pos" => axis.microsteps(now_s).to_string(),
                "limit.min" | "limit.home.pos" => "0".to_owned(),
                "limit.max" => axis.limit_max.to_string(),
                "maxspeed" => axis.max_speed.to_string(),
                "accel" => axis.accel.to_string(),
                "driver.enabled" => u8::from(!axis.disabled).to_string(),
                "peripheral.id" | "peripheralid" => "43211".to_owned(),
                "peripheral.serial" => (70_001 + index).to_string(),
                "resolution" => "64".to_owned(),
                _ => return None,
            })
        };
        let values: Option<Vec<String>> = self.axes_of(1, axis).into_iter().map(of_axis).collect();
        values.map(|values| values.join(" ")).ok_or("BADCOMMAND")
    }

    /// Settings that every device has.
    fn common(&self, device: u8, name: &str) -> Option<String> {
        Some(match (name, device) {
            ("version", _) => "7.38".to_owned(),
            ("version.build", _) => "14623".to_owned(),
            ("deviceid" | "device.id", 1) => "30342".to_owned(),
            ("deviceid" | "device.id", _) => "30332".to_owned(),
            ("system.serial", _) => (60_000 + u32::from(device)).to_string(),
            ("system.axiscount", 1) => "2".to_owned(),
            ("system.axiscount", _) => "3".to_owned(),
            ("system.access", _) => "1".to_owned(),
            ("comm.address", _) => device.to_string(),
            ("comm.alert", _) => u8::from(self.alerts).to_string(),
            ("comm.checksum", _) => u8::from(self.checksums).to_string(),
            ("comm.packet.size.max", _) => "80".to_owned(),
            ("comm.word.size.max", _) => "50".to_owned(),
            ("comm.command.packets.max", _) => "1".to_owned(),
            _ => return None,
        })
    }

    /// Settings of the whole chain; `None` is no such setting.
    fn set_common(&mut self, name: &str, value: &str) -> Option<Outcome> {
        let flag = match name {
            "comm.alert" => &mut self.alerts,
            "comm.checksum" => &mut self.checksums,
            _ => return None,
        };
        *flag = match value {
            "0" => false,
            "1" => true,
            _ => return Some(Err("BADDATA")),
        };
        Some(done())
    }

    fn set(&mut self, axis: u8, name: &str, value: &str) -> Outcome {
        if let Some(outcome) = self.set_common(name, value) {
            return outcome;
        }
        let value: i64 = value.parse().map_err(|_| "BADDATA")?;
        let allowed = 1..=i64::from(u32::MAX);
        for index in self.axes_of(1, axis) {
            let axis = &mut self.axes[index];
            match name {
                "maxspeed" if allowed.contains(&value) => axis.max_speed = value,
                "accel" if allowed.contains(&value) => axis.accel = value,
                "maxspeed" | "accel" => return Err("BADDATA"),
                _ => return Err("BADCOMMAND"),
            }
        }
        done()
    }

    fn illuminator(&mut self, axis: u8, words: &[&str], now_s: f64) -> Outcome {
        let lamps = match axis {
            0 => 0..3,
            axis => usize::from(axis) - 1..usize::from(axis),
        };
        match words {
            [] | ["stop" | "estop" | "home"] => done(),
            ["warnings", ..] => Ok("00".to_owned()),
            ["lamp", state @ ("on" | "off")] => {
                self.lamps[lamps].fill(*state == "on");
                self.light(now_s);
                done()
            }
            ["get", "lamp.status"] => Ok(joined(&self.lamps[lamps], |&on| 1 + i64::from(on))),
            ["get", "lamp.flux"] => Ok(joined(&self.flux[lamps], |&flux| {
                (flux * FLUX_MAX).round() as i64
            })),
            ["get", "lamp.flux.max"] => Ok(joined(&self.flux[lamps], |_| FLUX_MAX as i64)),
            ["set", "lamp.flux", value] => {
                let value: f64 = value.parse().map_err(|_| "BADDATA")?;
                if !(0.0..=FLUX_MAX).contains(&value) {
                    return Err("BADDATA");
                }
                self.flux[lamps].fill(value / FLUX_MAX);
                self.light(now_s);
                done()
            }
            ["get", name] => self.common(2, name).ok_or("BADCOMMAND"),
            ["set", name, value] => self.set_common(name, value).unwrap_or(Err("BADCOMMAND")),
            _ => Err("BADCOMMAND"),
        }
    }
}

fn joined<T>(values: &[T], number: impl Fn(&T) -> i64) -> String {
    let words: Vec<_> = values.iter().map(|v| number(v).to_string()).collect();
    words.join(" ")
}

#[cfg(test)]
mod tests {
    use super::super::ZaberConfig;
    use super::super::axis::SPEED_UNIT;
    use super::*;
    use crate::bench::{Bench, BenchConfig};
    use crate::clock::Clock;
    use crate::pty::Board;
    use proptest::prelude::*;

    fn chain() -> (Chain, Clock) {
        let clock = Clock::manual();
        let bench = Bench::new(BenchConfig::default(), clock.clone());
        (Chain::new(ZaberConfig::default(), bench), clock)
    }

    fn ask(chain: &mut Chain, clock: &Clock, line: &str) -> String {
        let mut answer = chain.step(clock.now_s());
        answer.extend(chain.receive(format!("{line}\n").as_bytes(), clock.now_s()));
        String::from_utf8(answer).unwrap()
    }

    /// Replies worded as in the protocol manual's examples.
    #[test]
    fn replies_have_the_protocols_form() {
        let (mut chain, clock) = chain();
        for (line, reply) in [
            ("/", "@01 0 OK IDLE WR 0\r\n"),
            ("/1 0 07 get system.axiscount", "@01 0 07 OK IDLE WR 2\r\n"),
            ("/1 1 8 move abs -1", "@01 1 08 RJ IDLE WR BADDATA\r\n"),
            ("/1 3 home", "@01 3 RJ IDLE -- BADAXIS\r\n"),
            ("/1 1 io set do 1 1", "@01 1 RJ IDLE WR DEVICEONLY\r\n"),
            ("/1 dance", "@01 0 RJ IDLE WR BADCOMMAND\r\n"),
            ("/1 warnings", "@01 0 OK IDLE WR 01 WR\r\n"),
            ("/2 home", ""),
            ("/1 get pos:00", ""),
            ("/1 set comm.checksum 1", "@01 0 OK IDLE WR 0:3E\r\n"),
        ] {
            assert_eq!(ask(&mut chain, &clock, line), reply, "{line}");
        }
    }

    #[test]
    fn a_move_takes_the_time_of_its_trapezoid_at_the_set_speed() {
        let (mut chain, clock) = chain();
        ask(&mut chain, &clock, "/1 home");
        clock.advance(1.0);
        assert_eq!(ask(&mut chain, &clock, "/1"), "@01 0 OK IDLE -- 0\r\n");
        // 10 units/s in data of the protocol, on 1000 microsteps per unit.
        let speed = (10.0 * 1000.0 * SPEED_UNIT).round();
        ask(&mut chain, &clock, &format!("/1 1 set maxspeed {speed}"));
        assert!(ask(&mut chain, &clock, "/1 1 move abs 20000").contains("BUSY"));
        // 20 / 10 + 10 / 200 s.
        clock.advance(2.04);
        assert!(ask(&mut chain, &clock, "/1 1").contains("BUSY"));
        assert!(ask(&mut chain, &clock, "/1 2").contains("IDLE"));
        clock.advance(0.02);
        assert!(ask(&mut chain, &clock, "/1 1 get pos").ends_with("IDLE -- 20000\r\n"));
        assert!((chain.bench.motor_position()[0] - 20.0).abs() < 1e-6);
    }

    #[test]
    fn lost_steps_show_at_the_sensor_and_homing_removes_them() {
        let (mut chain, clock) = chain();
        ask(&mut chain, &clock, "/1 home");
        clock.advance(1.0);
        ask(&mut chain, &clock, "/1 1 move abs 20000");
        clock.advance(5.0);
        ask(&mut chain, &clock, "/1");
        chain.bench.push_stage([0.7, 0.0, 0.0]);
        ask(&mut chain, &clock, "/1 1 tools gotolimit home neg 2 0");
        clock.advance(5.0);
        assert!(ask(&mut chain, &clock, "/1 1 get pos").ends_with("-- -700\r\n"));
        assert!(
            chain.bench.motor_position()[0].abs() < 1e-6,
            "at the sensor"
        );
        ask(&mut chain, &clock, "/1 1 home");
        clock.advance(5.0);
        assert!(ask(&mut chain, &clock, "/1 1 get pos").ends_with("-- 0\r\n"));
    }

    proptest! {
        #[test]
        fn no_bytes_break_it(
            chunks in prop::collection::vec(
                (prop_oneof![
                    prop::collection::vec(any::<u8>(), 0..40),
                    "/[0-3]? ?[0-3]? ?(move|home|get|set|io|lamp|tools|warnings|stop)? ?[a-z.]{0,9} ?-?[0-9]{0,19}\n"
                        .prop_map(String::into_bytes),
                ], 0.0..3.0_f64),
                0..30,
            ),
        ) {
            let (mut chain, clock) = chain();
            for (bytes, seconds) in chunks {
                chain.receive(&bytes, clock.now_s());
                clock.advance(seconds);
                chain.step(clock.now_s());
            }
            chain.receive(b"\n/1 set comm.checksum 0\n", clock.now_s());
            prop_assert!(ask(&mut chain, &clock, "/1").starts_with("@01 0 OK"));
        }
    }
}
