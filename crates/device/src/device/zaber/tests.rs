//! The driver against simulated devices on a pseudo-terminal.

use std::time::{Duration, Instant};

use mock_devices::bench::{AngleAxis, Axis, Bench, BenchConfig, Kinematics};
use mock_devices::clock::Clock;
use mock_devices::zaber::{LampWiring, ZaberSimulator};

use super::*;
use crate::device::kinematics::{AxisMap, Mechanism};
use crate::device::{DeviceError, LampChannel, LampState, LightStage, StageActivity, guardian};
use crate::units::StageAngles;

fn angles(azimuth_deg: f64, elevation_deg: f64) -> StageAngles {
    StageAngles::new(azimuth_deg, elevation_deg)
}

/// −180° to 180° and 0° to 90°, 1000 microsteps per degree.
fn simulator(clock: Clock, lamp: LampWiring) -> ZaberSimulator {
    let axis = |axis, offset_deg| AngleAxis {
        axis,
        deg_per_mm: 1.0,
        offset_deg,
    };
    let bench = BenchConfig {
        kinematics: Kinematics {
            azimuth: axis(Axis::X, -180.0),
            elevation: axis(Axis::Y, 0.0),
            ..Kinematics::default()
        },
        start_mm: [31.0, 17.0, 0.0],
        ..BenchConfig::default()
    };
    let config = mock_devices::zaber::ZaberConfig {
        lamp,
        alerts: true,
        ..Default::default()
    };
    ZaberSimulator::spawn(config, Bench::new(bench, clock)).unwrap()
}

fn config(simulator: &ZaberSimulator, lamp: LampWiring) -> ZaberConfig {
    let map = |min, max| AxisMap {
        scale: 1000.0,
        offset: min,
        min,
        max,
    };
    ZaberConfig {
        kinematics: TwoAxes {
            mechanism: Mechanism::Rotary,
            first: map(-180.0, 180.0),
            second: map(0.0, 90.0),
            approach: 2.0,
        },
        lamp: (1..=3)
            .map(|n| match lamp {
                LampWiring::Outputs => LampSwitch::Output {
                    device: 1,
                    output: n,
                },
                LampWiring::Illuminator => {
                    LampSwitch::Illuminator(AxisAddress { device: 2, axis: n })
                }
            })
            .collect(),
        ..ZaberConfig::of_port(&simulator.path().display().to_string(), 115_200)
    }
}

fn homed(lamp: LampWiring) -> (ZaberSimulator, ZaberStage) {
    let simulator = simulator(Clock::instant(), lamp);
    let mut stage = ZaberStage::open(config(&simulator, lamp)).unwrap();
    stage.home().unwrap();
    (simulator, stage)
}

fn assert_there(simulator: &ZaberSimulator, expected: [f64; 2]) {
    let truth = simulator.bench().stage_angles_deg();
    for (is, wanted) in truth.iter().zip(expected) {
        assert!((is - wanted).abs() < 0.002, "{truth:?} is not {expected:?}");
    }
}

#[test]
fn connecting_identifies_the_devices_and_moves_nothing() {
    let simulator = simulator(Clock::instant(), LampWiring::Outputs);
    let before = simulator.bench().motor_position();
    let mut stage = ZaberStage::open(config(&simulator, LampWiring::Outputs)).unwrap();
    assert_eq!(stage.info().driver, "zaber");
    assert_eq!(stage.info().firmware, "7.38 (serial number 60001)");
    let status = stage.status().unwrap();
    assert_eq!(status.activity, StageActivity::Alarm, "not homed");
    assert_eq!(status.position, None);
    assert_eq!(status.lamp, Some(LampState::Off));
    let refused = stage.move_to(angles(0.0, 45.0)).unwrap_err();
    assert!(matches!(refused, DeviceError::NotHomed { .. }), "{refused}");
    assert_eq!(simulator.bench().motor_position(), before);
}

#[test]
fn homing_and_moves_arrive_where_they_say() {
    let (simulator, mut stage) = homed(LampWiring::Outputs);
    assert_there(&simulator, [-180.0, 0.0]);
    assert_eq!(stage.status().unwrap().activity, StageActivity::Idle);
    for (azimuth_deg, elevation_deg) in [(0.0, 90.0), (-120.5, 30.25), (179.0, 3.0)] {
        let reached = stage.move_to(angles(azimuth_deg, elevation_deg)).unwrap();
        assert!(
            (reached.azimuth_deg - azimuth_deg).abs() < 0.002,
            "{reached}"
        );
        assert!((reached.elevation_deg - elevation_deg).abs() < 0.002);
        assert_there(&simulator, [azimuth_deg, elevation_deg]);
    }
    let reached = stage.move_to(angles(270.0, 45.0)).unwrap();
    assert!((reached.azimuth_deg - 270.0).abs() < 0.002, "{reached}");
    let outside = stage.move_to(angles(0.0, -10.0)).unwrap_err();
    assert!(
        matches!(outside, DeviceError::OutOfReach { .. }),
        "{outside}"
    );
    assert_there(&simulator, [-90.0, 45.0]);
}

#[test]
fn every_lamp_channel_is_read_back() {
    for wiring in [LampWiring::Outputs, LampWiring::Illuminator] {
        let (simulator, mut stage) = homed(wiring);
        for channel in 0..3 {
            let state = LampState::On(LampChannel(channel));
            assert_eq!(stage.set_lamp(state).unwrap(), state);
            let mut drive = [0.0; 3];
            drive[usize::from(channel)] = 1.0;
            assert_eq!(simulator.bench().lamp_drive(), drive, "{wiring:?}");
            assert_eq!(stage.status().unwrap().lamp, Some(state));
        }
        simulator.break_output(0);
        let dark = stage.set_lamp(LampState::On(LampChannel(0))).unwrap_err();
        assert!(matches!(dark, DeviceError::NotApplied { .. }), "{dark}");
        stage.set_lamp(LampState::On(LampChannel(1))).unwrap();
        drop(stage);
        assert_eq!(simulator.bench().lamp_drive(), [0.0; 3], "{wiring:?}");
    }
}

/// The guardian's end of a socket whose other end is gone.
fn closed_socket() -> std::os::unix::net::UnixStream {
    std::os::unix::net::UnixStream::pair().unwrap().0
}

/// The driver's process is gone, and its port is all that is left.
#[test]
fn a_guardian_stops_axes_and_lamp_over_the_open_port() {
    for wiring in [LampWiring::Outputs, LampWiring::Illuminator] {
        let (simulator, mut stage) = homed(wiring);
        stage.set_lamp(LampState::On(LampChannel(1))).unwrap();
        let stop = stage.port_stop().unwrap().unwrap();
        let watch = guardian::stand_guard(closed_socket(), stop.port, &stop.exchanges, &mut |_| {});
        assert!(matches!(watch, guardian::Watch::Acted(Ok(()))), "{watch:?}");
        assert_eq!(simulator.bench().lamp_drive(), [0.0; 3], "{wiring:?}");
        drop(stage);
    }
}

#[test]
fn limits_beyond_the_devices_travel_are_refused_at_once() {
    let simulator = simulator(Clock::instant(), LampWiring::Outputs);
    let mut config = config(&simulator, LampWiring::Outputs);
    config.kinematics.first.max = 181.0;
    let Err(error) = ZaberStage::open(config) else {
        panic!("accepted");
    };
    assert!(error.to_string().contains("361000"), "{error}");
}

#[test]
fn a_stall_is_an_alarm_and_homing_recovers() {
    let (simulator, mut stage) = homed(LampWiring::Outputs);
    simulator.jam_in_motion(0.5);
    let error = stage.move_to(angles(90.0, 45.0)).unwrap_err();
    assert!(
        matches!(&error, DeviceError::Alarm { reason, .. } if reason.contains("stalled")),
        "{error}"
    );
    let error = stage.move_to(angles(0.0, 45.0)).unwrap_err();
    assert!(matches!(error, DeviceError::Alarm { .. }), "{error}");
    assert_eq!(stage.status().unwrap().position, None);
    stage.home().unwrap();
    stage.move_to(angles(0.0, 45.0)).unwrap();
    assert_there(&simulator, [0.0, 45.0]);
}

#[test]
fn a_restart_in_mid_move_makes_the_position_unknown() {
    let (simulator, mut stage) = homed(LampWiring::Outputs);
    stage.set_lamp(LampState::On(LampChannel(0))).unwrap();
    simulator.power_cycle_in_motion(0.5);
    let error = stage.move_to(angles(90.0, 45.0)).unwrap_err();
    assert!(
        matches!(&error, DeviceError::NotHomed { since, .. } if since.contains("no reference")),
        "{error}"
    );
    assert_eq!(stage.status().unwrap().lamp, Some(LampState::Off));
    stage.home().unwrap();
    stage.move_to(angles(0.0, 45.0)).unwrap();
    assert_there(&simulator, [0.0, 45.0]);
}

#[test]
fn lost_steps_are_measured_at_the_sensor() {
    let (simulator, mut stage) = homed(LampWiring::Outputs);
    stage.move_to(angles(0.0, 45.0)).unwrap();
    let check = stage.check_reference().unwrap().unwrap();
    assert!(check.off.iter().all(|off| off.abs() < 0.002), "{check:?}");
    stage.move_to(angles(0.0, 45.0)).unwrap();
    simulator.lose_steps([-0.75, 0.25]);
    let check = stage.check_reference().unwrap().unwrap();
    assert!((check.off[0] - 0.75).abs() < 0.002, "{check:?}");
    assert!((check.off[1] + 0.25).abs() < 0.002, "{check:?}");
}

/// The driver's thread waits in a move; time stands still meanwhile.
#[test]
fn a_stop_handle_ends_a_move_of_another_thread() {
    let clock = Clock::manual();
    let simulator = simulator(clock.clone(), LampWiring::Outputs);
    let mut stage = ZaberStage::open(config(&simulator, LampWiring::Outputs)).unwrap();
    let ticking = std::sync::atomic::AtomicBool::new(true);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            while ticking.load(std::sync::atomic::Ordering::Acquire) {
                clock.advance(0.1);
                std::thread::sleep(Duration::from_millis(1));
            }
        });
        stage.home().unwrap();
        ticking.store(false, std::sync::atomic::Ordering::Release);
    });
    stage.set_lamp(LampState::On(LampChannel(0))).unwrap();
    let mut handle = stage.stop_handle().unwrap();
    let driver = std::thread::spawn(move || {
        let outcome = stage.move_to(angles(20.0, 45.0));
        (stage, outcome)
    });
    while simulator.bench().motor_position()[0] < 20.0 {
        clock.advance(0.01);
        std::thread::sleep(Duration::from_millis(1));
    }
    let begin = Instant::now();
    handle.stop().unwrap();
    assert!(begin.elapsed() < Duration::from_secs(3));
    assert_eq!(simulator.bench().lamp_drive(), [0.0; 3]);
    let stopped_at = simulator.bench().motor_position();
    let (mut stage, outcome) = driver.join().unwrap();
    assert!(
        matches!(&outcome, Err(DeviceError::NotHomed { since, .. }) if since.contains("stopped")),
        "{outcome:?}"
    );
    clock.advance(60.0);
    assert_eq!(simulator.bench().motor_position(), stopped_at);
    assert!(matches!(
        stage.move_to(angles(0.0, 45.0)),
        Err(DeviceError::NotHomed { .. })
    ));
    drop(stage);
    handle.stop().unwrap();
    stop_port(&config(&simulator, LampWiring::Outputs)).unwrap();
}
