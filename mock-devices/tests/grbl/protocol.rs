//! What the simulated controller says, byte for byte, over a real terminal.

use crate::host::{BANNER, Host, UNLOCK, connect, homed, unlocked};
use mock_devices::bench::BenchConfig;
use mock_devices::clock::Clock;
use mock_devices::grbl::{GrblConfig, GrblSimulator};

/// (name, lines sent, lines expected), each on a fresh unlocked board.
const EXCHANGES: &[(&str, &str, &[&str])] = &[
    ("empty line", "", &["ok"]),
    ("comments and spaces", "g0 (there) x 1 ; go", &["ok"]),
    ("letter missing", "12", &["error:1"]),
    ("number missing", "G0X", &["error:2"]),
    ("unknown $ command", "$Q", &["error:2"]),
    ("$ with rest", "$$1", &["error:3"]),
    ("negative setting", "$110=-5", &["error:4"]),
    ("homing not enabled", "$H", &["error:5"]),
    ("step pulse too short", "$0=2", &["error:6"]),
    ("soft limits without homing", "$20=1", &["error:10"]),
    ("unknown setting", "$99=1", &["error:3"]),
    ("setting without value", "$110=", &["error:2"]),
    ("setting stored", "$110=700", &["ok"]),
    ("unsupported G", "G38.2X1F1", &["error:20"]),
    ("two of a group", "G0G1X1", &["error:21"]),
    ("feed never set", "G1X1", &["error:22"]),
    ("no integer", "M3.5", &["error:23"]),
    ("word repeated", "X1X2", &["error:25"]),
    ("dwell without P", "G4", &["error:28"]),
    ("G59.1", "G59.1", &["error:29"]),
    ("axis words without motion", "G80X1", &["error:31"]),
    ("leftover word", "G0X1P1", &["error:36"]),
    ("jog without =", "$JX1F1", &["error:3"]),
    ("jog with M", "$J=X1F1M3", &["error:16"]),
    ("jog with G1", "$J=G1X1F1", &["error:16"]),
    ("jog without feed", "$J=X1", &["error:22"]),
    ("jog without axis", "$J=F1", &["error:26"]),
    ("jog", "$J=G91X1F600", &["ok"]),
    ("program end", "M2", &["[MSG:Pgm End]", "ok"]),
    ("unlock when not locked", "$X", &["ok"]),
    (
        "help",
        "$",
        &[
            "[HLP:$$ $# $G $I $N $x=val $Nx=line $J=line $SLP $C $X $H ~ ! ? ctrl-x]",
            "ok",
        ],
    ),
    (
        "modes",
        "$G",
        &["[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0]", "ok"],
    ),
    (
        "build",
        "$I",
        &["[VER:1.1h.20190830:]", "[OPT:VMZ,15,128]", "ok"],
    ),
    ("startup lines", "$N", &["$N0=", "$N1=", "ok"]),
    ("check mode", "$C", &["[MSG:Enabled]", "ok"]),
    ("sleep", "$SLP", &["ok", "[MSG:Sleeping]"]),
];

#[test]
fn every_line_gets_its_answer() {
    for &(name, sent, expected) in EXCHANGES {
        let (_simulator, mut host) = unlocked(Clock::instant());
        host.send(format!("{sent}\r\n"));
        // CR and LF each end a line: the empty one between them is "ok" too,
        // but not for a board that sleeps.
        let mut expected = expected.to_vec();
        if name != "sleep" {
            expected.push("ok");
        }
        let lines = host.lines(expected.len());
        assert_eq!(lines, expected, "{name}: sent {sent:?}");
        assert!(host.rest().is_empty(), "{name}: no more than that");
    }
}

#[test]
fn settings_are_listed_as_stored() {
    let (_simulator, mut host) = unlocked(Clock::instant());
    host.exchange("$110=1234.5", &["ok"]);
    host.exchange("$32=1", &["ok"]);
    host.send("$$\n");
    let lines = host.lines(35);
    assert_eq!(lines.last().map(String::as_str), Some("ok"));
    for expected in [
        "$0=10",
        "$10=1",
        "$11=0.010",
        "$20=0",
        "$22=0",
        "$30=1000",
        "$32=1",
        "$110=1234.500",
        "$132=200.000",
    ] {
        assert!(lines.iter().any(|line| line == expected), "{expected}");
    }
}

#[test]
fn modes_follow_the_lines() {
    let (_simulator, mut host) = unlocked(Clock::instant());
    host.exchange("G91 G20 G1 F10 X0.1 M3 S250", &["ok"]);
    host.exchange("M8", &["ok"]);
    host.exchange("M7", &["ok"]);
    host.exchange(
        "$G",
        &["[GC:G1 G54 G17 G20 G91 G94 M3 M7 M8 T0 F10 S250]", "ok"],
    );
    // A refused line changes nothing; a jog neither.
    host.exchange("G90 G21 G2 X1", &["error:20"]);
    host.exchange("$J=G90 G21 X0 F100", &["ok"]);
    host.exchange("G4P0", &["error:9"]);
    host.state();
    host.exchange("G4P0", &["ok"]);
    host.exchange(
        "$G",
        &["[GC:G1 G54 G17 G20 G91 G94 M3 M7 M8 T0 F10 S250]", "ok"],
    );
    host.send([0x18]);
    host.expect_banner(false);
    host.exchange("$G", &["[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0]", "ok"]);
}

#[test]
fn a_board_that_homes_starts_locked() {
    let (simulator, mut host) = connect(
        GrblConfig::default(),
        BenchConfig::default(),
        Clock::instant(),
    );
    assert_eq!(host.state(), "Alarm");
    host.exchange("G0X1", &["error:9"]);
    host.exchange("$J=X1F1", &["error:8"]);
    host.exchange("$X", &["[MSG:Caution: Unlocked]", "ok"]);
    assert_eq!(host.state(), "Idle");
    assert!(!simulator.bench().is_homed(), "unlocked is not homed");
    host.exchange("G0X1", &["ok"]);
}

#[test]
fn reports_carry_offsets_then_overrides_then_neither() {
    let (_simulator, mut host) = unlocked(Clock::instant());
    let first = host.status();
    assert_eq!(
        first,
        [
            "Idle",
            "MPos:0.000,0.000,0.000",
            "FS:0,0",
            "WCO:0.000,0.000,0.000"
        ]
    );
    assert_eq!(host.status()[3], "Ov:100,100,100");
    for _ in 0..8 {
        assert_eq!(host.status().len(), 3);
    }
    assert!(host.status()[3].starts_with("WCO:"), "every tenth report");
    // A changed offset is reported at once.
    host.exchange("G92 X5", &["ok"]);
    assert_eq!(host.status()[3], "WCO:-5.000,0.000,0.000");
    host.exchange("$10=2", &["ok"]);
    let status = host.status();
    assert_eq!(status[1], "WPos:5.000,0.000,0.000");
    assert_eq!(status[2], "Bf:15,128");
    host.exchange("$13=1", &["ok"]);
    assert_eq!(host.status()[1], "WPos:0.1969,0.0000,0.0000");
}

#[test]
fn work_coordinates_shift_targets() {
    let (_simulator, mut host) = unlocked(Clock::instant());
    host.exchange("G10 L2 P2 X10 Y-5", &["ok"]);
    host.exchange("G55", &["ok"]);
    host.exchange("G0 X1 Y1", &["ok"]);
    host.exchange("G4 P0", &["ok"]);
    assert_eq!(host.machine_position(), [11.0, -4.0, 0.0]);
    host.exchange("G53 G0 X0", &["ok"]);
    host.exchange("G91 X0.5", &["ok"]);
    host.exchange("G4 P0", &["ok"]);
    assert_eq!(host.machine_position(), [0.5, -4.0, 0.0]);
    host.exchange("G10 L20 P2 X0", &["ok"]);
    host.send("$#\n");
    let lines = host.lines(12);
    assert!(
        lines.contains(&"[G55:0.500,-5.000,0.000]".to_owned()),
        "{lines:?}"
    );
}

#[test]
fn the_lamp_follows_spindle_and_coolant() {
    let (simulator, mut host) = unlocked(Clock::instant());
    host.status();
    let drive = || simulator.bench().lamp_drive();
    host.exchange("M3 S500", &["ok"]);
    assert_eq!(drive(), [0.5, 0.0, 0.0]);
    host.exchange("M8", &["ok"]);
    host.exchange("M7", &["ok"]);
    assert_eq!(drive(), [0.5, 1.0, 1.0]);
    let status = host.status();
    assert_eq!(status[2], "FS:0,500");
    assert_eq!(status[4], "A:SFM");
    host.exchange("S5000", &["ok"]);
    assert_eq!(drive()[0], 1.0, "no more than full power");
    host.exchange("M4", &["ok"]);
    host.exchange("M9", &["ok"]);
    assert_eq!(drive(), [1.0, 0.0, 0.0]);
    host.exchange("M5", &["ok"]);
    assert_eq!(drive(), [0.0; 3]);
    // A reset turns everything off, too.
    host.exchange("M3 S1000 M8", &["ok"]);
    host.send([0x18]);
    host.expect_banner(false);
    assert_eq!(drive(), [0.0; 3]);
}

#[test]
fn a_long_line_is_refused_whole() {
    let (_simulator, mut host) = unlocked(Clock::instant());
    host.exchange(&format!("G0X{}", "1".repeat(76)), &["ok"]);
    host.exchange(&format!("G0X{}", "1".repeat(77)), &["error:11"]);
    // Spaces and comments do not count.
    host.exchange(
        &format!("G0X2{}({})", " ".repeat(60), "c".repeat(50)),
        &["ok"],
    );
}

#[test]
fn the_receive_buffer_holds_128_bytes() {
    let clock = Clock::manual();
    let (simulator, mut host) = unlocked(clock.clone());
    host.send("G4P1\n");
    assert!(host.rest().is_empty(), "a dwell is acknowledged at its end");
    // 32 lines of 4 bytes fit, the other 8 are lost.
    for _ in 0..40 {
        host.send("M5 \n");
    }
    host.taken_by(&simulator);
    clock.advance(1.0);
    assert_eq!(host.lines(1 + 32).len(), 1 + 32);
    assert!(host.rest().is_empty());
}

#[test]
fn acknowledged_when_planned_withheld_when_the_queue_is_full() {
    let clock = Clock::manual();
    let (_simulator, mut host) = unlocked(clock.clone());
    for i in 1..=16 {
        host.send(format!("G0X{}\n", 10 * i));
    }
    assert_eq!(
        host.lines(15).len(),
        15,
        "ok is for acceptance, not arrival"
    );
    assert!(host.rest().is_empty(), "the sixteenth waits");
    assert_eq!(host.state(), "Run");
    clock.advance(1.0);
    assert_eq!(host.lines(1), ["ok"], "a place has become free");
}

#[test]
fn startup_lines_run_at_each_start() {
    let (_simulator, mut host) = unlocked(Clock::instant());
    host.exchange("$N0=G20", &["ok"]);
    host.exchange("$N1=G2", &["error:20"]);
    host.exchange("$N", &["$N0=G20", "$N1=", "ok"]);
    host.send([0x18]);
    assert_eq!(host.lines(3), [BANNER[0], BANNER[1], ">G20:ok"]);
    assert!(host.rest().is_empty());
}

#[test]
fn check_mode_parses_without_moving_and_ends_in_a_reset() {
    let (simulator, mut host) = unlocked(Clock::instant());
    host.exchange("$C", &["[MSG:Enabled]", "ok"]);
    assert_eq!(host.state(), "Check");
    host.exchange("G0X10 M3 S1000", &["ok"]);
    host.exchange("G2", &["error:20"]);
    assert_eq!(simulator.bench().motor_position(), [0.0; 3]);
    assert_eq!(simulator.bench().lamp_drive(), [0.0; 3]);
    host.exchange("$C", &["[MSG:Disabled]", "ok", BANNER[0], BANNER[1]]);
    assert_eq!(host.state(), "Idle");
}

#[test]
fn only_a_reset_ends_sleep_and_it_ends_locked() {
    let (_simulator, mut host) = unlocked(Clock::instant());
    host.exchange("$SLP", &["ok", "[MSG:Sleeping]"]);
    assert_eq!(host.state(), "Sleep");
    host.send("G0X1\n");
    assert!(host.rest().is_empty());
    host.send([0x18]);
    host.expect_banner(true);
    assert_eq!(host.state(), "Alarm");
}

#[test]
fn unknown_extended_bytes_are_thrown_away() {
    let (_simulator, mut host) = unlocked(Clock::instant());
    host.send([b'G', 0x90, b'0', 0xff, 0x85, b'X', 0x84, b'1', b'\n']);
    assert_eq!(host.line().as_deref(), Some("ok"));
    assert!(host.rest().is_empty());
}

#[test]
fn opening_restarts_the_board_or_not() {
    let (simulator, mut host) = unlocked(Clock::instant());
    host.exchange("G0X7 M3 S1000", &["ok"]);
    host.exchange("G4P0", &["ok"]);
    close(host, &simulator);
    let mut host = Host::open(&simulator);
    host.expect_banner(false);
    assert_eq!(host.machine_position(), [0.0; 3], "it has forgotten");
    assert_eq!(
        simulator.bench().motor_position()[0],
        7.0,
        "the stage stands"
    );
    assert_eq!(simulator.bench().lamp_drive(), [0.0; 3]);

    let mut config = GrblConfig {
        reset_on_open: false,
        ..GrblConfig::default()
    };
    config.settings.homing = false;
    let (simulator, mut host) = connect(config, BenchConfig::default(), Clock::instant());
    host.exchange("G0X7 M3 S1000", &["ok"]);
    host.exchange("G4P0", &["ok"]);
    close(host, &simulator);
    let mut host = Host::open(&simulator);
    assert_eq!(
        host.machine_position(),
        [7.0, 0.0, 0.0],
        "no banner, no reset"
    );
    assert_eq!(simulator.bench().lamp_drive()[0], 1.0, "no watchdog either");
}

/// Closes the port and returns when the board has noticed.
fn close(host: Host, simulator: &GrblSimulator) {
    drop(host);
    while simulator.is_open() {
        std::thread::yield_now();
    }
}

#[test]
fn a_move_beyond_the_travel_alarms_until_reset() {
    let (simulator, mut host) = homed(Clock::instant());
    host.exchange("M3 S1000", &["ok"]);
    host.send("G0 X-1\n");
    assert_eq!(host.lines(2), ["ALARM:2", "[MSG:Reset to continue]"]);
    assert_eq!(simulator.bench().alarm(), Some(2));
    assert_eq!(simulator.bench().lamp_drive(), [0.0; 3], "the lamp is off");
    host.send("?$X\n");
    assert!(host.rest().is_empty(), "deaf to all but a reset");
    host.send([0x18]);
    assert_eq!(host.lines(4), ["ok", BANNER[0], BANNER[1], UNLOCK]);
    host.exchange("$X", &["[MSG:Caution: Unlocked]", "ok"]);
    assert_eq!(host.machine_position(), [0.0; 3], "the position is kept");
    assert!(simulator.bench().is_homed());
    // A jog beyond the travel is only refused.
    host.exchange("$J=X-1 F600", &["error:15"]);
    host.exchange("G0 X360 Y90", &["ok"]);
}
