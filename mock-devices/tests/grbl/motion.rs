//! How the simulated controller moves, in virtual time.

use crate::host::{BANNER, UNLOCK, connect, homed, unlocked};
use mock_devices::bench::{BenchConfig, StageErrors};
use mock_devices::clock::Clock;
use mock_devices::grbl::GrblConfig;

/// Default X axis: 60 units/s, 120 units/s².
const SPEED: f64 = 60.0;
const ACCELERATION: f64 = 120.0;

fn duration_s(distance: f64, speed: f64) -> f64 {
    if distance >= speed * speed / ACCELERATION {
        distance / speed + speed / ACCELERATION
    } else {
        2.0 * (distance / ACCELERATION).sqrt()
    }
}

#[test]
fn moves_take_the_time_of_the_trapezoid() {
    // (line, distance, speed): seek, feed, short (never at full speed), a jog.
    for (line, distance, speed) in [
        ("G0 X90", 90.0, SPEED),
        ("G1 X90 F1800", 90.0, 30.0),
        ("G0 X0.5", 0.5, SPEED),
        ("G1 X-45 F999999", 45.0, SPEED),
        ("$J=X12 F600", 12.0, 10.0),
    ] {
        let clock = Clock::manual();
        let (simulator, mut host) = unlocked(clock.clone());
        host.exchange(line, &["ok"]);
        let moving = if line.starts_with('$') { "Jog" } else { "Run" };
        let total_s = duration_s(distance, speed);
        clock.advance(0.5 * total_s);
        let status = host.status();
        assert_eq!(status[0], moving, "{line}");
        let halfway = simulator.bench().motor_position()[0].abs();
        assert!((halfway - 0.5 * distance).abs() < 1e-9, "{line}: {halfway}");
        let peak = 60.0 * speed.min((ACCELERATION * distance).sqrt());
        assert_eq!(status[2], format!("FS:{peak:.0},0"), "{line}");
        clock.advance(0.5 * total_s - 1e-4);
        assert_eq!(host.state(), moving, "{line}");
        clock.advance(2e-4);
        assert_eq!(host.state(), "Idle", "{line}");
        let reached = host.machine_position()[0].abs();
        assert!((reached - distance).abs() < 1e-9, "{line}: {reached}");
    }
}

#[test]
fn a_diagonal_moves_as_fast_as_its_slowest_axis_allows() {
    let clock = Clock::manual();
    let (_simulator, mut host) = unlocked(clock.clone());
    // Along (0.6, 0.8): X allows 100 units/s, Y 37.5; X 200 units/s², Y 75.
    host.exchange("G0 X60 Y80", &["ok"]);
    let total_s = 100.0 / 37.5 + 37.5 / 75.0;
    clock.advance(total_s - 1e-4);
    assert_eq!(host.state(), "Run");
    clock.advance(2e-4);
    assert_eq!(host.state(), "Idle");
}

#[test]
fn hold_and_resume() {
    let clock = Clock::manual();
    let (_simulator, mut host) = unlocked(clock.clone());
    host.exchange("G0 X90", &["ok"]);
    clock.advance(1.0);
    host.send("!");
    assert_eq!(host.state(), "Hold:1");
    // Held, lines wait.
    host.send("G0 X0\n");
    assert!(host.rest().is_empty());
    clock.advance(0.5 + 1e-6);
    assert_eq!(host.state(), "Hold:0");
    // 45 units after 1 s, and v²/2a = 15 more.
    assert_eq!(host.machine_position()[0], 60.0);
    clock.advance(100.0);
    assert_eq!(host.machine_position()[0], 60.0);
    host.send("~");
    assert_eq!(host.line().as_deref(), Some("ok"));
    assert_eq!(host.state(), "Run");
    clock.advance(100.0);
    assert_eq!(host.machine_position()[0], 0.0, "both moves were made");
}

#[test]
fn a_program_pause_waits_for_the_end_of_the_motion_and_for_a_resume() {
    let clock = Clock::manual();
    let (simulator, mut host) = unlocked(clock.clone());
    host.exchange("G0 X90", &["ok"]);
    host.send("M0\n");
    assert_eq!(host.state(), "Run");
    clock.advance(10.0);
    while host.state() == "Idle" {} // until the M0 has had its turn
    assert_eq!(host.state(), "Hold:0");
    assert!((simulator.bench().motor_position()[0] - 90.0).abs() < 1e-9);
    host.send("~");
    assert_eq!(host.line().as_deref(), Some("ok"));
    assert_eq!(host.state(), "Idle");
}

#[test]
fn a_reset_keeps_the_position_only_at_rest() {
    let clock = Clock::manual();
    let (simulator, mut host) = homed(clock.clone());
    host.exchange("G0 X90", &["ok"]);
    clock.advance(1.0);
    host.send("!");
    host.state();
    clock.advance(1.0);
    assert_eq!(host.state(), "Hold:0");
    host.send([0x18]);
    host.expect_banner(false);
    assert_eq!(host.state(), "Idle");
    assert!(simulator.bench().is_homed());
    assert_eq!(simulator.bench().alarm(), None);

    host.exchange("G0 X0", &["ok"]);
    host.send("M8\n");
    host.taken_by(&simulator);
    clock.advance(0.5);
    host.send([0x18]);
    // The M8 that waited for the end of the motion returns, unexecuted.
    assert_eq!(host.lines(2), ["ALARM:3", "ok"]);
    assert!(host.rest().is_empty(), "the restart takes a moment");
    clock.advance(0.5);
    assert_eq!(host.lines(3), [BANNER[0], BANNER[1], UNLOCK]);
    assert_eq!(host.state(), "Alarm");
    assert_eq!(simulator.bench().alarm(), Some(3));
    assert!(!simulator.bench().is_homed());
    assert_eq!(simulator.bench().lamp_drive(), [0.0; 3]);
    let stopped = simulator.bench().motor_position();
    clock.advance(10.0);
    assert_eq!(simulator.bench().motor_position(), stopped);
}

#[test]
fn jogs_are_cancelled_by_0x85_and_by_a_hold_moves_only_by_a_hold() {
    for byte in [0x85, b'!'] {
        let clock = Clock::manual();
        let (_simulator, mut host) = unlocked(clock.clone());
        host.exchange("$J=X90 F3600", &["ok"]);
        host.exchange("$J=X180 F3600", &["ok"]);
        clock.advance(1.0);
        host.send([byte]);
        assert_eq!(host.state(), "Jog");
        clock.advance(0.5 + 1e-6);
        assert_eq!(host.state(), "Idle", "both jogs are forgotten");
        assert_eq!(host.machine_position()[0], 60.0);
        // The parser knows where it stands.
        host.exchange("G91 G0 X1", &["ok"]);
        clock.advance(10.0);
        assert_eq!(host.machine_position()[0], 61.0);
    }
    let clock = Clock::manual();
    let (_simulator, mut host) = unlocked(clock.clone());
    host.exchange("G0 X90", &["ok"]);
    clock.advance(1.0);
    host.send([0x85]);
    assert_eq!(host.state(), "Run", "0x85 cancels only jogs");
}

#[test]
fn lines_during_motion() {
    let clock = Clock::manual();
    let (simulator, mut host) = unlocked(clock.clone());
    host.exchange("G0 X90", &["ok"]);
    for (line, answer) in [
        ("$$", "error:8"),
        ("$#", "error:8"),
        ("$110=5", "error:8"),
        ("$J=X1F1", "error:8"),
        ("$C", "error:8"),
    ] {
        host.exchange(line, &[answer]);
    }
    // The lamp waits for the end of the motion, and so does its ok.
    host.send("M3 S1000\n");
    assert!(host.rest().is_empty());
    assert_eq!(simulator.bench().lamp_drive(), [0.0; 3]);
    clock.advance(100.0);
    assert_eq!(host.line().as_deref(), Some("ok"));
    assert_eq!(simulator.bench().lamp_drive()[0], 1.0);
    host.exchange("$J=X0F100", &["ok"]);
    host.exchange("G0X1", &["error:9"]);
}

#[test]
fn homing_finds_the_switches_wherever_the_stage_stood() {
    for start_mm in [[0.0; 3], [200.0, 45.0, 0.0], [-0.5, 80.0, 0.0]] {
        let bench = BenchConfig {
            start_mm,
            ..BenchConfig::default()
        };
        let clock = Clock::manual();
        let config = GrblConfig {
            boot_s: 0.0,
            ..GrblConfig::default()
        };
        let (simulator, mut host) = connect(config, bench, clock.clone());
        assert_eq!(host.machine_position(), [0.0; 3], "it does not know");
        host.send("$H\n?");
        host.taken_by(&simulator);
        assert!(host.rest().is_empty(), "silent while it homes");
        // Each axis: to the switch 1 unit beyond zero at 30 units/s, three legs of
        // 1 unit at 2 units/s, four pauses of 25 ms.
        let leg = |distance: f64, speed: f64, acceleration: f64| {
            if distance >= speed * speed / acceleration {
                distance / speed + speed / acceleration
            } else {
                2.0 * (distance / acceleration).sqrt()
            }
        };
        let axis = |at: f64, acceleration: f64| {
            leg(at + 1.0, 30.0, acceleration) + 3.0 * leg(1.0, 2.0, acceleration) + 0.1
        };
        let total_s = axis(start_mm[0], 120.0) + axis(start_mm[1], 60.0);
        clock.advance(total_s - 1e-3);
        assert!(host.rest().is_empty(), "from {start_mm:?}");
        clock.advance(2e-3);
        let lines = host.lines(2);
        assert!(lines[0].starts_with("<Home|"), "{lines:?}");
        assert_eq!(lines[1], "ok");
        assert_eq!(host.state(), "Idle");
        assert_eq!(host.machine_position(), [0.0; 3]);
        let motor = simulator.bench().motor_position();
        assert!(motor[0].abs() < 1e-9 && motor[1].abs() < 1e-9, "{motor:?}");
        assert!(simulator.bench().is_homed());
        let angles = simulator.bench().stage_angles_deg();
        assert!((angles[0] + 180.0).abs() < 1e-9 && angles[1].abs() < 1e-9);
    }
}

#[test]
fn machine_space_is_negative_unless_zero_is_at_home() {
    let config = GrblConfig {
        zero_at_home: false,
        ..GrblConfig::default()
    };
    let (_simulator, mut host) = connect(config, BenchConfig::default(), Clock::instant());
    host.exchange("$H", &["ok"]);
    assert_eq!(host.machine_position(), [-359.0, -89.0, 0.0]);
    host.exchange("G0 X0 Y0", &["ok"]);
    host.exchange("G4 P0", &["ok"]);
    host.send("G0 X1\n");
    assert_eq!(host.line().as_deref(), Some("ALARM:2"));
}

#[test]
fn homing_gives_up_beyond_one_and_a_half_travels_and_on_reset() {
    let far = BenchConfig {
        start_mm: [600.0, 0.0, 0.0],
        ..BenchConfig::default()
    };
    let (simulator, mut host) = connect(GrblConfig::default(), far, Clock::instant());
    host.exchange("$H", &["ALARM:9", "ok", BANNER[0], BANNER[1], UNLOCK]);
    assert!(!simulator.bench().is_homed());

    let clock = Clock::manual();
    let config = GrblConfig {
        boot_s: 0.0,
        ..GrblConfig::default()
    };
    let (simulator, mut host) = connect(config, BenchConfig::default(), clock.clone());
    host.send("$H\n");
    host.taken_by(&simulator);
    clock.advance(0.5);
    host.send([0x18]);
    assert_eq!(host.lines(2), ["ALARM:6", "ok"]);
    clock.advance(0.5);
    host.expect_banner(true);
    assert_eq!(simulator.bench().alarm(), Some(6));
}

#[test]
fn a_target_beyond_the_travel_first_stops_what_moves() {
    let clock = Clock::manual();
    let (simulator, mut host) = homed(clock.clone());
    host.exchange("G0 X90", &["ok"]);
    clock.advance(1.0);
    host.send("G0 X400\n");
    assert_eq!(host.state(), "Hold:1");
    clock.advance(1.0);
    assert_eq!(host.lines(2), ["ALARM:2", "[MSG:Reset to continue]"]);
    assert!((simulator.bench().motor_position()[0] - 60.0).abs() < 1e-6);
}

#[test]
fn a_switch_reached_in_motion_is_a_hard_limit() {
    let mut config = GrblConfig {
        boot_s: 0.0,
        ..GrblConfig::default()
    };
    config.settings.hard_limits = true;
    let (simulator, mut host) = connect(
        config,
        BenchConfig {
            start_mm: [5.0, 5.0, 0.0],
            ..BenchConfig::default()
        },
        Clock::manual(),
    );
    let clock = simulator.bench().clock().clone();
    host.exchange("$X", &["[MSG:Caution: Unlocked]", "ok"]);
    host.exchange("$20=0", &["ok"]);
    host.exchange("G0 X-20", &["ok"]);
    clock.advance(2.0);
    assert_eq!(host.lines(2), ["ALARM:1", "[MSG:Reset to continue]"]);
    assert_eq!(simulator.bench().alarm(), Some(1));
    let stopped = simulator.bench().motor_position()[0];
    assert!(stopped <= -1.0);
    clock.advance(5.0);
    assert_eq!(simulator.bench().motor_position()[0], stopped);
}

#[test]
fn the_true_stage_errs_as_configured() {
    let errors = StageErrors {
        azimuth_offset_deg: 0.3,
        elevation_offset_deg: -0.2,
        backlash_mm: [0.05, 0.1, 0.0],
        ..StageErrors::default()
    };
    let bench = BenchConfig {
        errors,
        ..BenchConfig::default()
    };
    let (simulator, mut host) = connect(GrblConfig::default(), bench, Clock::instant());
    host.exchange("$H", &["ok"]);
    let mut go = |line: &str| {
        host.exchange(line, &["ok"]);
        host.exchange("G4 P0", &["ok"]);
        simulator.bench().stage_angles_deg()
    };
    let close = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).abs() < 1e-9 && (a[1] - b[1]).abs() < 1e-9;
    let up = go("G0 X100 Y50");
    assert!(close(up, [-79.7, 49.8]), "{up:?}");
    let beyond = go("G0 X110 Y60");
    assert!(close(beyond, [-69.7, 59.8]), "{beyond:?}");
    let down = go("G0 X100 Y50");
    assert!(close(down, [-79.65, 49.9]), "from above it lags: {down:?}");
    // Within the play nothing turns.
    let inside = go("G0 X100.04 Y50.09");
    assert!(close(inside, [-79.65, 49.9]), "{inside:?}");
}

#[test]
fn positioning_errors_repeat_and_repeatability_errors_do_not() {
    let stage = |positioning_mm, repeatability_mm, seed| {
        let bench = BenchConfig {
            errors: StageErrors {
                positioning_mm,
                repeatability_mm,
                ..StageErrors::default()
            },
            seed,
            ..BenchConfig::default()
        };
        let (simulator, mut host) = connect(GrblConfig::default(), bench, Clock::instant());
        host.exchange("$H", &["ok"]);
        let mut visits = Vec::new();
        for line in ["G0 X100 Y40", "G0 X0 Y0", "G0 X100 Y40"] {
            host.exchange(line, &["ok"]);
            host.exchange("G4 P0", &["ok"]);
            visits.push(simulator.bench().stage_angles_deg());
            // A stay without light is no visit.
            host.exchange("M3 S1000", &["ok"]);
            host.exchange("M5", &["ok"]);
        }
        visits
    };
    let fixed = stage(0.02, 0.0, 1);
    assert_eq!(fixed[0], fixed[2]);
    assert_ne!(fixed[0], [-80.0, 40.0]);
    assert_eq!(fixed, stage(0.02, 0.0, 1), "the same seed, the same stage");
    assert_ne!(fixed, stage(0.02, 0.0, 2));
    let loose = stage(0.0, 0.02, 1);
    assert_ne!(loose[0], loose[2]);
    assert!((loose[0][0] + 80.0).abs() < 0.12);
}

#[test]
fn in_real_time_a_move_takes_its_time() {
    let (_simulator, mut host) = unlocked(Clock::real_time());
    let begun = std::time::Instant::now();
    host.exchange("G0 X0.3", &["ok"]);
    assert_eq!(host.state(), "Run");
    host.exchange("G4 P0", &["ok"]);
    // 2 √(0.3/120) = 0.1 s.
    assert!(begun.elapsed().as_secs_f64() >= 0.0999);
}

#[test]
fn on_the_instant_clock_a_tour_takes_no_wall_time() {
    let wall = std::time::Instant::now();
    let (simulator, mut host) = homed(Clock::instant());
    for i in 1..=50 {
        host.exchange(&format!("G0 X{} Y{}", i * 7 % 360, i), &["ok"]);
        let first = host.state();
        assert!(first == "Run", "{first}");
        assert_eq!(host.state(), "Idle");
    }
    assert!(simulator.bench().clock().now_s() > 20.0);
    assert!(wall.elapsed().as_secs() < 10);
}
