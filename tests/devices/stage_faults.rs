//! What goes wrong between a light stage and its driver, row by row: faults of
//! the line through a byte proxy, faults of the firmware and the stage in the
//! simulators. The table in docs/faults.md is made of these rows.

use std::time::Duration;

use mock_devices::bench::{Bench, BenchConfig};
use mock_devices::clock::Clock;
use mock_devices::grbl::{Fault, GrblSimulator, Trigger};
use mock_devices::proxy::{Damage, Proxy};
use mock_devices::zaber::ZaberSimulator;
use rig::device::grbl::{GrblConfig, GrblStage};
use rig::device::kinematics::{AxisMap, Mechanism, TwoAxes};
use rig::device::zaber::{LampSwitch, ZaberConfig, ZaberStage};
use rig::device::{DeviceError, LampChannel, LampState, LightStage};
use rig::units::{Seconds, StageAngles};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Protocol {
    Grbl,
    Zaber,
}

const PROTOCOLS: [Protocol; 2] = [Protocol::Grbl, Protocol::Zaber];

/// What must come of a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Outcome {
    /// The command ends as if nothing had been.
    GoesOn,
    NoReply,
    Garbled,
    Restarted,
    Alarm,
    Disconnected,
    NotApplied,
    /// The stage reports a lamp that is on.
    NotSeen,
    Measured,
    CannotTell,
    /// There is no such fault.
    None,
}

impl Outcome {
    /// As the documentation has it.
    fn words(self) -> &'static str {
        match self {
            Self::GoesOn => "goes on",
            Self::NoReply => "error: no reply; then unknown position",
            Self::Garbled => "error: garbled; then unknown position",
            Self::Restarted => "error: not homed; unknown position",
            Self::Alarm => "error: alarm with its cause; unknown position",
            Self::Disconnected => "error: disconnected; a new connection moves nothing",
            Self::NotApplied => "error: the lamp read back as dark",
            Self::NotSeen => "not seen by the stage; the images stay dark, which ends the capture",
            Self::Measured => {
                "found and measured when the reference is checked: after its last light a capture is marked as suspect"
            }
            Self::CannotTell => "not seen: the check of the reference says that it cannot tell",
            Self::None => "–",
        }
    }

    /// Whether it leaves the position unknown.
    fn unhomes(self) -> bool {
        matches!(
            self,
            Self::NoReply | Self::Garbled | Self::Restarted | Self::Alarm
        )
    }
}

/// What is done to the stage.
#[derive(Clone, Copy, Debug)]
enum Cause {
    /// To this many lines of the device, or to all.
    Line(Damage, Option<u32>),
    RestartInMotion,
    FirmwareAlarm,
    Stall,
    LostSteps,
    DarkLamp,
    PortGone,
}

/// A fault, its cause, and what comes of it in the order of [`PROTOCOLS`].
struct Row(&'static str, Cause, [Outcome; 2]);

const ROWS: &[Row] = {
    use Cause::*;
    use Damage::*;
    use Outcome::*;
    &[
        Row("one reply is lost", Line(Drop, Some(1)), [GoesOn; 2]),
        Row("no reply any more", Line(Drop, Option::None), [NoReply; 2]),
        Row(
            "replies are slow, within the time-out",
            Line(Delay(Duration::from_millis(40)), Option::None),
            [GoesOn; 2],
        ),
        Row("one reply is cut", Line(Truncate(2), Some(1)), [GoesOn; 2]),
        Row(
            "every reply is cut",
            Line(Truncate(2), Option::None),
            [NoReply; 2],
        ),
        Row("one reply is garbled", Line(Garble, Some(1)), [GoesOn; 2]),
        Row(
            "every reply is garbled",
            Line(Garble, Option::None),
            [Garbled; 2],
        ),
        Row(
            "every reply comes twice",
            Line(Duplicate, Option::None),
            [GoesOn; 2],
        ),
        Row(
            "the controller restarts in mid-move",
            RestartInMotion,
            [Restarted; 2],
        ),
        Row(
            "the firmware raises an alarm in mid-move",
            FirmwareAlarm,
            [Alarm, Outcome::None],
        ),
        Row("a motor stalls", Stall, [Outcome::None, Alarm]),
        Row("steps are lost", LostSteps, [CannotTell, Measured]),
        Row("the lamp does not light", DarkLamp, [NotSeen, NotApplied]),
        Row(
            "the port goes away and comes back",
            PortGone,
            [Disconnected; 2],
        ),
    ]
};

const START: [f64; 2] = [0.0, 80.0];
const TARGET: [f64; 2] = [60.0, 45.0];
const REPLY_TIMEOUT: Seconds = Seconds(0.9);

fn angles([azimuth_deg, elevation_deg]: [f64; 2]) -> StageAngles {
    StageAngles::new(azimuth_deg, elevation_deg)
}

fn axes(scale: f64) -> TwoAxes {
    let map = |min, max| AxisMap {
        scale,
        offset: min,
        min,
        max,
    };
    TwoAxes {
        mechanism: Mechanism::Rotary,
        first: map(-180.0, 180.0),
        second: map(0.0, 90.0),
        approach: 2.0,
    }
}

enum Simulator {
    Grbl(GrblSimulator),
    Zaber(ZaberSimulator),
}

/// A simulated stage behind a cable that can fail.
struct Bed {
    protocol: Protocol,
    simulator: Simulator,
    bench: Bench,
    proxy: Proxy,
}

impl Bed {
    fn new(protocol: Protocol) -> Self {
        let bench = Bench::new(BenchConfig::default(), Clock::instant());
        let simulator = match protocol {
            Protocol::Grbl => {
                let mut config = mock_devices::grbl::GrblConfig::default();
                config.settings.homing_pull_off = 0.0;
                config.settings.max_travel = [360.0, 90.0, 1.0];
                Simulator::Grbl(GrblSimulator::spawn(config, bench.clone()).unwrap())
            }
            Protocol::Zaber => {
                let config = mock_devices::zaber::ZaberConfig::default();
                Simulator::Zaber(ZaberSimulator::spawn(config, bench.clone()).unwrap())
            }
        };
        let path = match &simulator {
            Simulator::Grbl(simulator) => simulator.path(),
            Simulator::Zaber(simulator) => simulator.path(),
        };
        Self {
            proxy: Proxy::to(path).unwrap(),
            protocol,
            simulator,
            bench,
        }
    }

    fn connect(&self) -> Box<dyn LightStage> {
        let port = self.proxy.path().display().to_string();
        match self.protocol {
            Protocol::Grbl => {
                let config = GrblConfig {
                    kinematics: axes(1.0),
                    lamp_on: vec![vec!["M3 S1000".to_owned()]],
                    reply_timeout: REPLY_TIMEOUT,
                    ..GrblConfig::of_port(&port, 115_200)
                };
                Box::new(GrblStage::open(config).unwrap())
            }
            Protocol::Zaber => {
                let config = ZaberConfig {
                    kinematics: axes(1000.0),
                    lamp: vec![LampSwitch::Output {
                        device: 1,
                        output: 1,
                    }],
                    reply_timeout: REPLY_TIMEOUT,
                    ..ZaberConfig::of_port(&port, 115_200)
                };
                Box::new(ZaberStage::open(config).unwrap())
            }
        }
    }

    /// Connected, homed, at the start with its lamp off.
    fn ready(&self) -> Box<dyn LightStage> {
        let mut stage = self.connect();
        stage.home().unwrap();
        stage.move_to(angles(START)).unwrap();
        stage
    }

    fn strike(&self, cause: Cause) {
        match (cause, &self.simulator) {
            (Cause::Line(damage, None), _) => self.proxy.damage("", damage),
            (Cause::Line(damage, Some(times)), _) => self.proxy.damage_times("", damage, times),
            (Cause::RestartInMotion, Simulator::Grbl(firmware)) => firmware
                .faults()
                .inject(Trigger::InMotion { after_s: 0.2 }, Fault::Reset),
            (Cause::RestartInMotion, Simulator::Zaber(devices)) => {
                devices.power_cycle_in_motion(0.2);
            }
            (Cause::FirmwareAlarm, Simulator::Grbl(firmware)) => firmware
                .faults()
                .inject(Trigger::InMotion { after_s: 0.2 }, Fault::Alarm(1)),
            (Cause::Stall, Simulator::Zaber(devices)) => devices.jam_in_motion(0.2),
            (Cause::LostSteps, _) => self.bench.push_stage([0.6, 0.0, 0.0]),
            (Cause::DarkLamp, Simulator::Grbl(_)) => self.bench.set_lamp_dead(0, true),
            (Cause::DarkLamp, Simulator::Zaber(devices)) => devices.break_output(0),
            (Cause::PortGone, _) => self.proxy.unplug(),
            (cause, _) => panic!("{:?} knows no {cause:?}", self.protocol),
        }
    }

    fn assert_at_target(&self) {
        let truth = self.bench.stage_angles_deg();
        for (is, wanted) in truth.iter().zip(TARGET) {
            assert!((is - wanted).abs() < 0.02, "{:?}: {truth:?}", self.protocol);
        }
    }
}

const LIT: LampState = LampState::On(LampChannel(0));

/// What a capture does for a light.
fn light_up(stage: &mut dyn LightStage) -> Result<(), DeviceError> {
    stage.move_to(angles(TARGET))?;
    stage.set_lamp(LIT)?;
    stage.set_lamp(LampState::Off)?;
    Ok(())
}

fn kind(error: &DeviceError) -> Option<Outcome> {
    Some(match error {
        DeviceError::NoReply { .. } => Outcome::NoReply,
        DeviceError::Garbled { .. } => Outcome::Garbled,
        DeviceError::NotHomed { .. } => Outcome::Restarted,
        DeviceError::Alarm { .. } => Outcome::Alarm,
        DeviceError::Disconnected { .. } => Outcome::Disconnected,
        DeviceError::NotApplied { .. } => Outcome::NotApplied,
        _ => return None,
    })
}

fn run(row: &Row, protocol: Protocol, expected: Outcome) {
    let name = format!("{} ({protocol:?})", row.0);
    let bed = Bed::new(protocol);
    let mut stage = bed.ready();
    bed.strike(row.1);
    if matches!(row.1, Cause::LostSteps) {
        let check = stage.check_reference().unwrap();
        match expected {
            Outcome::Measured => {
                let off = check.expect(&name).off;
                assert!(
                    (off[0] + 0.6).abs() < 0.01 && off[1].abs() < 0.01,
                    "{name}: {off:?}"
                );
            }
            _ => assert_eq!(check, None, "{name}"),
        }
        return;
    }
    let outcome = light_up(&mut *stage);
    match (&outcome, expected) {
        (Ok(()), Outcome::GoesOn) => bed.assert_at_target(),
        (Ok(()), Outcome::NotSeen) => {
            stage.set_lamp(LIT).unwrap();
            assert_eq!(bed.bench.illumination().channels, [0.0; 3], "{name}");
        }
        (Err(error), expected) => assert_eq!(kind(error), Some(expected), "{name}: {error}"),
        (Ok(()), _) => panic!("{name}: it went on"),
    }
    if expected.unhomes() {
        bed.proxy.clear();
        let refused = light_up(&mut *stage).unwrap_err();
        let locked = matches!(
            refused,
            DeviceError::NotHomed { .. } | DeviceError::Alarm { .. }
        );
        assert!(locked, "{name}: {refused}");
    }
    if expected == Outcome::Disconnected {
        let before = bed.bench.motor_position();
        drop(stage);
        bed.proxy.plug_in().unwrap();
        stage = bed.connect();
        let refused = light_up(&mut *stage).unwrap_err();
        assert!(
            matches!(refused, DeviceError::NotHomed { .. }),
            "{name}: {refused}"
        );
        assert_eq!(bed.bench.motor_position(), before, "{name}");
    }
    if matches!(expected, Outcome::NotApplied | Outcome::NotSeen) {
        drop(stage);
    } else {
        // Whatever it was, homing puts it right.
        stage
            .home()
            .unwrap_or_else(|error| panic!("{name}: {error}"));
        light_up(&mut *stage).unwrap_or_else(|error| panic!("{name}: {error}"));
        bed.assert_at_target();
        drop(stage);
    }
    assert_eq!(bed.bench.lamp_drive(), [0.0; 3], "{name}: the lamp is off");
}

fn run_all(protocol: Protocol) {
    let column = PROTOCOLS.iter().position(|&p| p == protocol).unwrap();
    for row in ROWS {
        if row.2[column] != Outcome::None {
            run(row, protocol, row.2[column]);
        }
    }
}

#[test]
fn grbl() {
    run_all(Protocol::Grbl);
}

#[test]
fn zaber() {
    run_all(Protocol::Zaber);
}

#[test]
fn the_documented_table_is_this_one() {
    let mut table = "| fault | GRBL | Zaber |\n|---|---|---|\n".to_owned();
    for row in ROWS {
        let cells = row.2.map(Outcome::words).join(" | ");
        table += &format!("| {} | {cells} |\n", row.0);
    }
    let documented = include_str!("../../docs/faults.md");
    assert!(
        documented.contains(&table),
        "docs/faults.md has another table under `Light stage`; it should be\n{table}"
    );
}
