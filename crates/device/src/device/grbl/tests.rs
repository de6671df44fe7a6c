//! The driver against simulated firmware on a pseudo-terminal.

use std::time::{Duration, Instant};

use mock_devices::clock::Clock;
use mock_devices::grbl::{Fault, GrblSimulator, Trigger};

use super::*;
use crate::device::simulated::SimulatedBench;
use crate::device::simulated::tests::{simulated, stage_config};
use crate::device::{DeviceError, LampChannel, LampState, LightStage, StageActivity};
use crate::units::StageAngles;

fn angles(azimuth_deg: f64, elevation_deg: f64) -> StageAngles {
    StageAngles::new(azimuth_deg, elevation_deg)
}

/// A bench on the instant clock with a homed stage.
fn homed() -> (SimulatedBench, GrblStage) {
    let bench = simulated(Clock::instant(), stage_config());
    let mut stage = bench.open_stage().unwrap();
    stage.home().unwrap();
    (bench, stage)
}

/// The same where silence is short.
fn homed_and_hasty() -> (SimulatedBench, GrblStage) {
    let config = GrblConfig {
        reply_timeout: Seconds(0.4),
        ..stage_config()
    };
    let bench = simulated(Clock::instant(), config);
    let mut stage = bench.open_stage().unwrap();
    stage.home().unwrap();
    (bench, stage)
}

fn assert_there(bench: &SimulatedBench, expected: [f64; 2]) {
    let truth = bench.bench().stage_angles_deg();
    for (is, wanted) in truth.iter().zip(expected) {
        assert!((is - wanted).abs() < 0.011, "{truth:?} is not {expected:?}");
    }
}

/// Its position is unknown until it is homed.
fn moves_once_homed(stage: &mut dyn LightStage) {
    assert!(matches!(
        stage.move_to(angles(0.0, 45.0)),
        Err(DeviceError::NotHomed { .. })
    ));
    stage.home().unwrap();
    stage.move_to(angles(0.0, 45.0)).unwrap();
}

#[test]
fn connecting_identifies_the_firmware_and_moves_nothing() {
    let bench = simulated(Clock::instant(), stage_config());
    let before = bench.bench().motor_position();
    let mut stage = bench.open_stage().unwrap();
    assert_eq!(bench.bench().motor_position(), before);
    assert_eq!(stage.info().driver, "grbl");
    assert!(
        stage.info().firmware.starts_with("1.1"),
        "{:?}",
        stage.info()
    );
    assert!(!stage.info().has_watchdog);
    let status = stage.status().unwrap();
    assert_eq!(status.activity, StageActivity::Alarm, "locked until homed");
    assert_eq!(status.position, None);
    assert_eq!(status.lamp, Some(LampState::Off));
    let refused = stage.move_to(angles(0.0, 45.0)).unwrap_err();
    assert!(matches!(refused, DeviceError::NotHomed { .. }), "{refused}");
    let locked = stage.set_lamp(LampState::On(LampChannel(0))).unwrap_err();
    assert!(matches!(locked, DeviceError::Alarm { .. }), "{locked}");
}

#[test]
fn homing_and_moves_arrive_where_they_say() {
    let (bench, mut stage) = homed();
    let status = stage.status().unwrap();
    assert_eq!(status.activity, StageActivity::Idle);
    assert!(status.position.is_some());
    for (azimuth_deg, elevation_deg) in [(0.0, 90.0), (-120.5, 30.25), (179.0, 3.0), (0.0, 45.0)] {
        let target = angles(azimuth_deg, elevation_deg);
        let reached = stage.move_to(target).unwrap();
        assert!(
            (reached.azimuth_deg - azimuth_deg).abs() < 0.011,
            "{reached}"
        );
        assert!((reached.elevation_deg - elevation_deg).abs() < 0.011);
        assert_there(&bench, [azimuth_deg, elevation_deg]);
    }
    // 270° is the same as −90°, and the answer is in the caller's words.
    let reached = stage.move_to(angles(270.0, 45.0)).unwrap();
    assert!((reached.azimuth_deg - 270.0).abs() < 0.011, "{reached}");
    assert_there(&bench, [-90.0, 45.0]);
}

/// With 1.5° of play in both axes, a target is reached from either side alike,
/// which it isn't without the approach.
#[test]
fn the_approach_takes_up_the_play() {
    let play_deg = 1.5;
    let spread = |approach_deg: f64| {
        let mut config = stage_config();
        config.kinematics.approach = approach_deg;
        let mut bench = simulated(Clock::instant(), config).config().clone();
        bench.errors.backlash_mm = [play_deg; 3];
        let bench = SimulatedBench::start(bench).unwrap();
        let mut stage = bench.open_stage().unwrap();
        stage.home().unwrap();
        let mut truth_from = |azimuth_deg, elevation_deg| {
            stage.move_to(angles(azimuth_deg, elevation_deg)).unwrap();
            stage.move_to(angles(10.0, 40.0)).unwrap();
            bench.bench().stage_angles_deg()
        };
        let below = truth_from(-60.0, 20.0);
        let above = truth_from(60.0, 80.0);
        (above[0] - below[0]).abs().max((above[1] - below[1]).abs())
    };
    assert!(spread(2.0) < 1e-6);
    assert!((spread(0.0) - play_deg).abs() < 1e-6);
}

#[test]
fn every_lamp_channel_is_read_back() {
    let (bench, mut stage) = homed();
    for channel in 0..3 {
        let state = LampState::On(LampChannel(channel));
        assert_eq!(stage.set_lamp(state).unwrap(), state);
        let mut drive = [0.0; 3];
        drive[usize::from(channel)] = 1.0;
        assert_eq!(bench.bench().lamp_drive(), drive);
        assert_eq!(stage.status().unwrap().lamp, Some(state));
    }
    assert_eq!(stage.set_lamp(LampState::Off).unwrap(), LampState::Off);
    assert_eq!(bench.bench().lamp_drive(), [0.0; 3]);
    let missing = stage.set_lamp(LampState::On(LampChannel(3))).unwrap_err();
    assert!(missing.to_string().contains("3 channels"), "{missing}");
}

#[test]
fn a_lamp_that_does_not_follow_is_told() {
    let mut config = stage_config();
    config.lamp_on[0] = vec!["M3 S5000".to_owned()]; // the firmware limits to S1000
    let bench = simulated(Clock::instant(), config);
    let mut stage = bench.open_stage().unwrap();
    stage.home().unwrap();
    let error = stage.set_lamp(LampState::On(LampChannel(0))).unwrap_err();
    assert!(matches!(error, DeviceError::NotApplied { .. }), "{error}");
    let said = error.to_string();
    let words = [
        "spindle (M3) on at S1000",
        "spindle (M3) on at S5000 (M5; M9; M3 S5000)",
    ];
    assert!(words.iter().all(|words| said.contains(words)), "{said}");
    drop(stage);
    assert_eq!(bench.bench().lamp_drive(), [0.0; 3]);
}

#[test]
fn dropping_the_driver_turns_the_lamp_off() {
    let (bench, mut stage) = homed();
    stage.set_lamp(LampState::On(LampChannel(1))).unwrap();
    drop(stage);
    assert_eq!(bench.bench().lamp_drive(), [0.0; 3]);
}

/// Alarm 4 (a probe) locks the controller with its outputs as they are.
#[test]
fn the_lamp_of_a_locked_controller_goes_off() {
    let bench = simulated(Clock::instant(), stage_config());
    let mut stage = bench.open_stage().unwrap();
    assert_eq!(stage.set_lamp(LampState::Off).unwrap(), LampState::Off);
    stage.home().unwrap();
    stage.set_lamp(LampState::On(LampChannel(0))).unwrap();
    bench
        .stage_faults()
        .inject(Trigger::Line("G4".to_owned()), Fault::Alarm(4));
    let _ = stage.command("G4 P0", Duration::from_secs(1));
    assert_eq!(stage.set_lamp(LampState::Off).unwrap(), LampState::Off);
    assert_eq!(bench.bench().lamp_drive(), [0.0; 3]);
    stage.home().unwrap();
}

#[test]
fn a_target_outside_the_limits_moves_nothing() {
    let (bench, mut stage) = homed();
    let before = bench.bench().motor_position();
    let error = stage.move_to(angles(0.0, -10.0)).unwrap_err();
    assert!(matches!(error, DeviceError::OutOfReach { .. }), "{error}");
    assert_eq!(bench.bench().motor_position(), before);
    assert!(stage.move_to(angles(0.0, 10.0)).is_ok());
}

/// The rig file allows more than the firmware's travel: its soft limit raises
/// alarm 2, after which it is deaf; homing recovers.
#[test]
fn the_firmwares_soft_limit_is_an_alarm_and_homing_recovers() {
    let bench = simulated(Clock::instant(), stage_config());
    let mut config = bench.stage_config();
    config.kinematics.second.max = 120.0;
    let mut stage = GrblStage::open(config).unwrap();
    stage.home().unwrap();
    stage.set_lamp(LampState::On(LampChannel(0))).unwrap();
    let error = stage.move_to(angles(0.0, 110.0)).unwrap_err();
    assert!(
        matches!(&error, DeviceError::Alarm { reason, .. } if reason.contains("soft limit")),
        "{error}"
    );
    let error = stage.move_to(angles(0.0, 45.0)).unwrap_err();
    assert!(
        matches!(&error, DeviceError::NotHomed { since, .. } if since.contains("alarm 2")),
        "{error}"
    );
    stage.home().unwrap();
    stage.move_to(angles(0.0, 45.0)).unwrap();
    assert_there(&bench, [0.0, 45.0]);
}

#[test]
fn a_limit_switch_in_motion_is_an_alarm_with_its_meaning() {
    let (bench, mut stage) = homed();
    bench
        .stage_faults()
        .inject(Trigger::InMotion { after_s: 0.5 }, Fault::Alarm(1));
    let error = stage.move_to(angles(90.0, 45.0)).unwrap_err();
    assert!(
        matches!(&error, DeviceError::Alarm { reason, .. } if reason.contains("limit switch")),
        "{error}"
    );
    moves_once_homed(&mut stage);
}

#[test]
fn homing_that_fails_leaves_the_position_unknown() {
    let (bench, mut stage) = homed();
    bench
        .stage_faults()
        .inject(Trigger::InMotion { after_s: 0.1 }, Fault::Alarm(8));
    let error = stage.home().unwrap_err();
    assert!(matches!(error, DeviceError::Alarm { .. }), "{error}");
    assert!(matches!(
        stage.move_to(angles(0.0, 45.0)),
        Err(DeviceError::NotHomed { .. })
    ));
    stage.home().unwrap();
    assert!(stage.status().unwrap().position.is_some());
}

#[test]
fn a_restart_in_mid_move_makes_the_position_unknown() {
    let (bench, mut stage) = homed();
    bench
        .stage_faults()
        .inject(Trigger::InMotion { after_s: 0.5 }, Fault::Reset);
    let error = stage.move_to(angles(90.0, 45.0)).unwrap_err();
    assert!(
        matches!(&error, DeviceError::NotHomed { since, .. } if since.contains("restarted")),
        "{error}"
    );
    assert!(matches!(
        stage.move_to(angles(0.0, 45.0)),
        Err(DeviceError::NotHomed { .. })
    ));
    assert_eq!(stage.status().unwrap().position, None);
    stage.home().unwrap();
    stage.move_to(angles(0.0, 45.0)).unwrap();
    assert_there(&bench, [0.0, 45.0]);
}

#[test]
fn silence_ends_in_time_and_makes_the_position_unknown() {
    let (bench, mut stage) = homed_and_hasty();
    bench.stage_faults().inject(Trigger::Always, Fault::NoReply);
    let begin = Instant::now();
    let error = stage.move_to(angles(0.0, 45.0)).unwrap_err();
    assert!(matches!(error, DeviceError::NoReply { .. }), "{error}");
    assert!(begin.elapsed() < Duration::from_secs(2));
    bench.stage_faults().clear();
    moves_once_homed(&mut stage);
}

#[test]
fn a_lost_or_damaged_status_report_is_asked_for_again() {
    let (bench, mut stage) = homed_and_hasty();
    let faults = bench.stage_faults();
    faults.inject_times(Trigger::StatusQuery, Fault::Garbled, 1);
    faults.inject_times(Trigger::StatusQuery, Fault::NoReply, 1);
    stage.move_to(angles(0.0, 45.0)).unwrap();
    assert_there(&bench, [0.0, 45.0]);
}

#[test]
fn garbage_is_told_as_what_was_heard() {
    let (bench, mut stage) = homed_and_hasty();
    bench
        .stage_faults()
        .inject(Trigger::Line("G21".to_owned()), Fault::Garbled);
    let error = stage.move_to(angles(0.0, 45.0)).unwrap_err();
    assert!(matches!(error, DeviceError::Garbled { .. }), "{error}");
    assert!(matches!(
        stage.move_to(angles(0.0, 45.0)),
        Err(DeviceError::NotHomed { .. })
    ));
}

#[test]
fn connecting_to_silence_or_garbage_is_told() {
    // Garbage must arrive in time, on a busy machine too.
    for (fault, silent, connect_s) in [(Fault::NoReply, true, 0.3), (Fault::Garbled, false, 3.0)] {
        let config = GrblConfig {
            connect_timeout: Seconds(connect_s),
            reply_timeout: Seconds(connect_s / 3.0),
            ..stage_config()
        };
        let bench = simulated(Clock::instant(), config);
        bench.stage_faults().inject(Trigger::Always, fault);
        let Err(error) = bench.open_stage() else {
            panic!("silent {silent}: it connected");
        };
        let expected = match &error {
            DeviceError::NoReply { .. } => silent,
            DeviceError::Garbled { .. } => !silent,
            _ => false,
        };
        assert!(expected, "silent {silent}: {error}");
    }
}

#[test]
fn laser_mode_is_refused() {
    let bench = simulated(Clock::instant(), stage_config());
    let mut firmware = mock_devices::grbl::GrblConfig::default();
    firmware.settings.laser_mode = true;
    let simulator = GrblSimulator::spawn(firmware, bench.bench().clone()).unwrap();
    let config = GrblConfig {
        port: simulator.path().display().to_string(),
        ..stage_config()
    };
    let Err(error) = GrblStage::open(config) else {
        panic!("laser mode was accepted");
    };
    assert!(error.to_string().contains("$32=1"), "{error}");
}

/// Another banner, settings that are no numbers, alarm states with codes, more
/// fields in reports: everything that matters goes as with GRBL 1.1.
#[test]
fn grblhal_is_driven_alike() {
    let bench = simulated(Clock::instant(), stage_config());
    let firmware = mock_devices::grbl::GrblConfig {
        hal: true,
        ..Default::default()
    };
    let simulator = GrblSimulator::spawn(firmware, bench.bench().clone()).unwrap();
    let config = GrblConfig {
        port: simulator.path().display().to_string(),
        ..stage_config()
    };
    let mut stage = GrblStage::open(config).unwrap();
    assert!(
        stage.info().firmware.starts_with("1.1f"),
        "{:?}",
        stage.info()
    );
    assert_eq!(stage.status().unwrap().activity, StageActivity::Alarm);
    stage.home().unwrap();
    stage.move_to(angles(33.0, 44.0)).unwrap();
    assert_there(&bench, [33.0, 44.0]);
    let lit = LampState::On(LampChannel(1));
    assert_eq!(stage.set_lamp(lit).unwrap(), lit);
    assert_eq!(simulator.bench().lamp_drive(), [0.0, 1.0, 0.0]);
    let mut handle = stage.stop_handle().unwrap();
    handle.stop().unwrap();
    assert_eq!(simulator.bench().lamp_drive(), [0.0; 3]);
    assert!(matches!(
        stage.move_to(angles(0.0, 45.0)),
        Err(DeviceError::NotHomed { .. })
    ));
}

/// Work positions ($10=0), with an offset left behind by another program.
#[test]
fn work_positions_and_a_foreign_offset_do_not_mislead() {
    let bench = simulated(Clock::instant(), stage_config());
    let mut firmware = mock_devices::grbl::GrblConfig::default();
    firmware.settings.status_mask = 0;
    let simulator = GrblSimulator::spawn(firmware, bench.bench().clone()).unwrap();
    let config = GrblConfig {
        port: simulator.path().display().to_string(),
        ..stage_config()
    };
    let mut stage = GrblStage::open(config).unwrap();
    stage.home().unwrap();
    stage
        .command("G10 L2 P1 X17 Y-4", Duration::from_secs(1))
        .unwrap();
    stage.move_to(angles(33.0, 44.0)).unwrap();
    assert_there(&bench, [33.0, 44.0]);
}

#[test]
fn a_port_that_is_held_gone_or_unplugged() {
    let (bench, mut stage) = homed();
    let Err(busy) = bench.open_stage() else {
        panic!("two drivers on one port");
    };
    assert!(matches!(busy, DeviceError::Busy { .. }), "{busy}");
    bench.unplug_stage();
    let gone = stage.move_to(angles(0.0, 45.0)).unwrap_err();
    assert!(matches!(gone, DeviceError::Disconnected { .. }), "{gone}");
    drop(stage);
    let Err(missing) = bench.open_stage() else {
        panic!("opened a port that is gone");
    };
    assert!(matches!(missing, DeviceError::NotFound { .. }), "{missing}");
}

/// The driver's thread waits in a move of 200°; time stands still meanwhile.
#[test]
fn a_stop_handle_ends_a_move_of_another_thread() {
    let clock = Clock::manual();
    let bench = simulated(clock.clone(), stage_config());
    let connected = with_running_clock(&clock, || bench.open_stage());
    let mut stage = connected.unwrap();
    with_running_clock(&clock, || stage.home()).unwrap();
    with_running_clock(&clock, || stage.set_lamp(LampState::On(LampChannel(0)))).unwrap();
    let mut handle = stage.stop_handle().unwrap();
    let start = bench.bench().motor_position();
    let driver = std::thread::spawn(move || {
        let outcome = stage.move_to(angles(20.0, 45.0));
        (stage, outcome)
    });
    // Somewhere in mid-move.
    while bench.bench().motor_position()[0] - start[0] < 20.0 {
        clock.advance(0.01);
        std::thread::yield_now();
    }
    with_running_clock(&clock, || handle.stop()).unwrap();
    let (mut stage, outcome) = with_running_clock(&clock, || driver.join()).unwrap();
    let error = outcome.unwrap_err();
    assert!(
        matches!(&error, DeviceError::NotHomed { since, .. } if since.contains("stopped"))
            || matches!(&error, DeviceError::Alarm { .. }),
        "{error}"
    );
    assert_eq!(bench.bench().lamp_drive(), [0.0; 3]);
    let stopped_at = bench.bench().motor_position();
    assert!(stopped_at[0] - start[0] < 150.0, "{stopped_at:?}");
    clock.advance(60.0);
    assert_eq!(bench.bench().motor_position(), stopped_at);
    let error = stage.move_to(angles(0.0, 45.0)).unwrap_err();
    assert!(
        matches!(&error, DeviceError::NotHomed { since, .. } if since.contains("stopped")),
        "{error}"
    );
}

/// Runs something while another thread advances the clock.
fn with_running_clock<T: Send>(clock: &Clock, run: impl FnOnce() -> T + Send) -> T {
    let done = std::sync::atomic::AtomicBool::new(false);
    std::thread::scope(|scope| {
        let ticker = scope.spawn(|| {
            while !done.load(std::sync::atomic::Ordering::Acquire) {
                clock.advance(0.05);
                std::thread::sleep(Duration::from_millis(1));
            }
        });
        let outcome = run();
        done.store(true, std::sync::atomic::Ordering::Release);
        ticker.join().unwrap();
        outcome
    })
}

#[test]
fn an_idle_stage_is_stopped_too_and_a_handle_outlives_its_driver() {
    let (bench, mut stage) = homed();
    stage.set_lamp(LampState::On(LampChannel(2))).unwrap();
    let mut handle = stage.stop_handle().unwrap();
    handle.stop().unwrap();
    assert_eq!(bench.bench().lamp_drive(), [0.0; 3]);
    assert!(matches!(
        stage.move_to(angles(0.0, 45.0)),
        Err(DeviceError::NotHomed { .. })
    ));
    drop(stage);
    handle.stop().unwrap();
    // The handle holds no port.
    bench.open_stage().unwrap();
}

#[test]
fn a_port_is_stopped_without_a_driver() {
    let bench = simulated(Clock::instant(), stage_config());
    let port = bench.stage_config().port;
    stop_port(&port, 115_200, Duration::from_secs(5)).unwrap();
    assert_eq!(bench.bench().lamp_drive(), [0.0; 3]);
}
