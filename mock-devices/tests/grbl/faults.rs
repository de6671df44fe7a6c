//! What goes wrong when it is told to.

use crate::host::{BANNER, UNLOCK, connect, homed, unlocked};
use mock_devices::bench::BenchConfig;
use mock_devices::clock::Clock;
use mock_devices::grbl::{Fault, GrblConfig, GrblSimulator, Trigger};

#[test]
fn answers_are_lost_garbled_cut_or_doubled() {
    let (simulator, mut host) = unlocked(Clock::instant());
    let faults = simulator.faults();
    let line = || Trigger::Line("G4".to_owned());

    faults.inject_times(line(), Fault::NoReply, 1);
    host.send("G4P0\n");
    assert!(host.rest().is_empty());
    host.exchange("G4P0", &["ok"]);

    faults.inject_times(line(), Fault::Garbled, 1);
    host.send("G4P0\n");
    let garbled = host.line().unwrap();
    assert_ne!(garbled, "ok");
    host.exchange("M5", &["ok"]);

    faults.inject_times(line(), Fault::Truncated { keep: 1 }, 1);
    host.send("G4P0\n");
    assert_eq!(host.fragment(), "o");

    faults.inject_times(line(), Fault::Duplicated, 1);
    host.exchange("G4P0", &["ok", "ok"]);
    assert!(host.rest().is_empty());
}

#[test]
fn a_late_answer_comes_late_and_nothing_overtakes_it() {
    let clock = Clock::manual();
    let (simulator, mut host) = unlocked(clock.clone());
    simulator
        .faults()
        .inject_times(Trigger::StatusQuery, Fault::Delayed { seconds: 3.0 }, 1);
    host.send("?");
    host.taken_by(&simulator);
    host.send("M5\n");
    clock.advance(2.9);
    assert!(host.rest().is_empty());
    clock.advance(0.2);
    let lines = host.lines(2);
    assert!(lines[0].starts_with("<Idle"));
    assert_eq!(lines[1], "ok");
}

#[test]
fn it_stops_answering_queries_or_altogether() {
    let (simulator, mut host) = unlocked(Clock::instant());
    let faults = simulator.faults();
    faults.inject(Trigger::StatusQuery, Fault::NoReply);
    host.send("???");
    assert!(host.rest().is_empty());
    host.exchange("M5", &["ok"]);
    faults.inject(Trigger::Always, Fault::NoReply);
    host.send("M5\n$I\n?");
    host.send([0x18]);
    assert!(host.rest().is_empty());
    faults.clear();
    assert_eq!(host.state(), "Idle");
}

#[test]
fn the_banner_can_be_missing_or_garbage() {
    for (fault, expected) in [(Fault::NoReply, 1), (Fault::Garbled, 3)] {
        let simulator = GrblSimulator::spawn(
            GrblConfig::default(),
            mock_devices::bench::Bench::new(BenchConfig::default(), Clock::instant()),
        )
        .unwrap();
        simulator.faults().inject(Trigger::Banner, fault.clone());
        let mut host = crate::host::Host::open(&simulator);
        let lines = host.lines(expected);
        assert!(
            !lines.iter().any(|line| line.starts_with("Grbl")),
            "{lines:?}"
        );
        // The message after the banner is another answer, and intact.
        assert_eq!(lines.last().map(String::as_str), Some(UNLOCK));
    }
}

#[test]
fn the_board_restarts_in_mid_move() {
    // On the instant clock as well, the mishap comes before the end of the motion.
    for clock in [Clock::instant(), Clock::manual()] {
        let (simulator, mut host) = homed(clock.clone());
        simulator
            .faults()
            .inject(Trigger::InMotion { after_s: 1.0 }, Fault::Reset);
        host.exchange("M3 S1000", &["ok"]);
        host.exchange("G0 X90", &["ok"]);
        host.send("?");
        assert!(host.line().unwrap().starts_with("<Run"));
        clock.advance(if clock.is_instant() { 0.0 } else { 1.0 });
        assert_eq!(host.lines(3), [BANNER[0], BANNER[1], UNLOCK]);
        let motor = simulator.bench().motor_position()[0];
        assert!((motor - 45.0).abs() < 1e-6, "{motor}");
        assert_eq!(host.machine_position(), [0.0; 3], "it has forgotten");
        assert!(!simulator.bench().is_homed());
        assert_eq!(simulator.bench().lamp_drive(), [0.0; 3]);
        // Homing puts it right.
        host.send("$H\n");
        while host.rest().is_empty() {
            clock.advance(60.0);
        }
        assert!(simulator.bench().motor_position()[0].abs() < 1e-9);
    }
}

#[test]
fn alarms_on_demand() {
    let (simulator, mut host) = homed(Clock::instant());
    simulator
        .faults()
        .inject(Trigger::InMotion { after_s: 0.5 }, Fault::Alarm(1));
    host.exchange("G0 X90", &["ok"]);
    host.send("?");
    assert_eq!(
        host.lines(3)[1..],
        ["ALARM:1", "[MSG:Reset to continue]"],
        "a hard limit"
    );
    host.send([0x18]);
    host.expect_banner(true);

    simulator
        .faults()
        .inject(Trigger::InMotion { after_s: 0.5 }, Fault::Alarm(8));
    host.exchange("$H", &["ALARM:8", "ok", BANNER[0], BANNER[1], UNLOCK]);
    assert!(!simulator.bench().is_homed());
    host.exchange("$H", &["ok"]);
    assert!(simulator.bench().is_homed());

    simulator
        .faults()
        .inject(Trigger::Line("M3".to_owned()), Fault::Alarm(3));
    host.send("M3 S1\n");
    assert_eq!(
        host.lines(5),
        ["ok", "ALARM:3", BANNER[0], BANNER[1], UNLOCK]
    );
}

#[test]
fn a_dead_lamp_is_driven_but_dark() {
    let (simulator, mut host) = unlocked(Clock::instant());
    let bench = simulator.bench().clone();
    bench.set_lamp_dead(0, true);
    host.exchange("M3 S1000", &["ok"]);
    host.exchange("M8", &["ok"]);
    assert_eq!(bench.lamp_drive(), [1.0, 1.0, 0.0]);
    assert_eq!(bench.illumination().channels, [0.0, 1.0, 0.0]);
}

#[test]
fn the_port_goes_away() {
    let by_hand: fn(&GrblSimulator) = GrblSimulator::unplug;
    let by_fault: fn(&GrblSimulator) = |simulator| {
        simulator.faults().inject(Trigger::Always, Fault::Unplug);
        while simulator.path().exists() {
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
    };
    for pull in [by_hand, by_fault] {
        let (simulator, mut host) = unlocked(Clock::instant());
        host.exchange("M3 S1000", &["ok"]);
        pull(&simulator);
        assert!(host.read_some(1000).is_err(), "reading fails");
        assert!(host.try_send("?").is_err(), "writing fails");
        assert!(!simulator.path().exists());
        assert_eq!(simulator.bench().lamp_drive()[0], 1.0, "the board lives on");
    }
    let (simulator, mut host) = unlocked(Clock::instant());
    let path = simulator.path().to_owned();
    drop(simulator);
    assert!(host.read_some(1000).is_err());
    assert!(!path.exists());
}

#[test]
fn a_watchdog_turns_the_lamp_off_when_the_host_is_silent() {
    let clock = Clock::manual();
    let mut config = GrblConfig {
        boot_s: 0.0,
        host_watchdog_s: Some(3.0),
        ..GrblConfig::default()
    };
    config.settings.homing = false;
    let (simulator, mut host) = connect(config, BenchConfig::default(), clock.clone());
    host.exchange(
        "$I",
        &[
            "[VER:1.1h.20190830:host-watchdog=3]",
            "[OPT:VMZ,15,128]",
            "ok",
        ],
    );
    host.exchange("M3 S1000", &["ok"]);
    for _ in 0..3 {
        clock.advance(2.9);
        assert_eq!(host.state(), "Idle");
        assert_eq!(simulator.bench().lamp_drive()[0], 1.0);
    }
    clock.advance(3.1);
    host.expect_banner(false);
    assert_eq!(simulator.bench().lamp_drive(), [0.0; 3]);
}
