//! Controllers that speak other than stock GRBL 1.1: older and newer firmware, builds of
//! others, settings and inputs that stop a stage. The program as a person runs it, on a
//! pseudo-terminal. docs/stages.md sums them up.

use std::path::Path;
use std::process::Output;

use mock_devices::grbl::{Dialect, DialectSimulator};

use crate::command_support::{self, cases, words};

use command_support::{assert_fails, rig_file_on_port, text};

fn run(args: &[&str]) -> Output {
    command_support::run(Path::new("."), args)
}

/// A rig file for a stage on this port.
fn rig_file(port: &Path) -> (tempfile::TempDir, String) {
    let built_in = include_str!("../../rig-configs/grbl-arm-v4l2.toml");
    rig_file_on_port(built_in, port.to_str().unwrap())
}

/// Controllers as the reports of `gnea/grbl`, `grblHAL`, `bdring/FluidNC` and their senders have
/// them, the repositories and numbers with each; what is asked of them; a text of the output, or
/// one of the fact and one of the hint. A controller is a [`dialect`] with other fields.
const DEVIATIONS: &str = r"
    # Own banners (Universal-G-Code-Sender, LongMill, grblHAL, uCNC) and a port that is stopped.
    grbl; banner=ArcBench 1.1h ['$' for help] | stop | stopped |
    grbl; banner=Grbl-Mega-5X 1.1t ['$' for help] | stop | stopped |
    grbl; banner=grblHAL 1.1f ['$' or '$HELP' for help] | stop | stopped |
    old | stop | stopped |
    # LaserWeb/lw.comm-server#22, zeevy/grblcontroller#169, gnea/grbl#635.
    old | status | GRBL 0.9j, and GRBL 1.1 or later is needed | older versions don't report outputs
    old; version=[0.8c.20130906:] | home | GRBL 0.8c | older versions don't report outputs
    # arkypita/LaserGRBL#667, cprezzi/grbl-LPC#39, grbl/grbl#1267.
    door | home | the safety door input is open | close the safety door
    door | status | (Door:1) | tie it to its idle level
    door; state=Door:0; after=Door:0; reads | home | (Door:0) | close the safety door
    door; state=Door:0; reads | lamp off | held |
    door; state=Door:0; after=Idle; reads | home | idle |
    grbl; state=Hold:0 | home | idle |
    grbl; state=Sleep; after=Alarm | home | idle |
    grbl; state=Hold:0; deaf | status | (Hold:0) | see why it was held
    grbl; state=Sleep; deaf | status | (Sleep) | resets it and wakes it
    # grbl/grbl#1185, zeevy/grblcontroller#121, grblHAL/LPC176x#9.
    grbl; homing=error:5 | home | homing is not enabled ($22=0) | set $22=1
    fluidnc; homing=error:18 | home | no axis is set to be homed | under `homing:` of each axis
    grbl; settings=$32=1 | status | ($32=1) | set $32=0
    grbl; settings=$32=2 | status | idle |
    grbl; settings=$13=1 | status | inches ($13=1) | set $13=0
    # A lamp that nobody lit, on a build that never says so.
    silent lamp | home | idle |
    silent lamp | lamp off | off |
    # bdring/FluidNC: other numbers, messages first, settings with names.
    fluidnc | home | idle |
    fluidnc; state=Alarm; after=Alarm; banner=Grbl 3.7 [FluidNC v3.7.13 '$' for help], [MSG:INFO: ALARM: Unhomed], ALARM:14 | home | idle |
    fluidnc; homing=[MSG:INFO: ALARM: Hard Stop], ALARM:13 | home | alarm 13: a limit switch was hit | move it off the switch by hand
    fluidnc; homing=ALARM:12 | home | both limit switches of an axis are closed | its polarity ($5)
    fluidnc; homing=ALARM:11 | home | a control or limit input is active | release the emergency stop
    fluidnc; homing=ALARM:14 | home | alarm 14: homing is required | the stage is free to move, then
    fluidnc; state=ConfigAlarm; after=ConfigAlarm | home | its configuration is faulty | the controller's configuration file
    # Homing that fails, in numbers and in words; an alarm that says nothing.
    grbl; homing=ALARM:8, error:9 | home | could not get off the limit switch | the pull-off ($27)
    grbl; homing=ALARM: Hard limit | home | alarm: Hard limit | move it off the switch by hand
    grbl; homing=ALARM:3 | home | alarm 3 | what the stage hit or lost
    grbl; homing=error: Unsupported command | home | error: Unsupported command | commands in the rig file that this firmware has
    grbl; homing=error:8 | home | unless the machine is idle | against what the device accepts
    grbl; homing=error:50 | home | error 50: the emergency stop is active | or what else closes an input
    grbl; homing=error:13 | home | the safety door input is open | close the safety door
    # Lines of their own, echoes, fields without a value, line ends of one byte.
    grbl; version=[VER:1.1f.20200721:], OLF:231, DTB:2021 05 28; settings=$0=10, $33=on, $N0=, $32=0 | home | idle |
    echoing | home | idle |
    unknown fields | home | idle |
    carriage returns | home | idle |
    line feeds | home | idle |
    work positions | status | have no position | set $10=1
    no numbers | home | have no position | set $10=1
    one axis | status | have 1 axes, and axis Y is needed | name axes that the controller has
";

/// A dialect by its name in the table.
fn dialect(name: &str) -> Dialect {
    let grbl = Dialect::GRBL;
    let reporting = |report| Dialect { report, ..grbl };
    let ending = |line_end| Dialect { line_end, ..grbl };
    match name {
        "grbl" => grbl,
        "fluidnc" => Dialect {
            banner: &[
                "",
                "[MSG:INFO: FluidNC v3.7.13]",
                "Grbl 3.7 [FluidNC v3.7.13 (wifi) '$' for help]",
            ],
            version: &[
                "[VER:3.7 FluidNC v3.7.13:]",
                "[OPT:MPHS]",
                "[MSG: Machine: Arc]",
            ],
            settings: &[
                "$10=1",
                "$13=0",
                "$32=0",
                "$/axes/x/steps_per_mm=80.000",
                "$N0=",
            ],
            homing: &["[MSG:DBG: Homing Cycle X]", "[MSG:Homed:X]", "ok"],
            ..grbl
        },
        "old" => Dialect {
            report: "<STATE,MPos:0.000,0.000,0.000,WPos:0.000,0.000,0.000",
            version: &["[0.9j.20160316:]"],
            banner: &["", "Grbl 0.9j ['$' for help]"],
            ..grbl
        },
        "door" => Dialect {
            state: "Door:1",
            state_after_reset: "Door:1",
            reads_lines: false,
            ..grbl
        },
        "silent lamp" => Dialect {
            outputs: "",
            ..grbl
        },
        "echoing" => Dialect {
            echoes: true,
            ..grbl
        },
        "carriage returns" => ending("\r"),
        "line feeds" => ending("\n"),
        "unknown fields" => reporting("<STATE|MPos:0.000,0.000,0.000|FS:0,0|Pn:XY|H|"),
        "work positions" => reporting("<STATE|WPos:0.000,0.000,0.000|FS:0,0"),
        "no numbers" => reporting("<STATE|MPos:nan,0.000,0.000|FS:0,0"),
        "one axis" => reporting("<STATE|MPos:0.000|FS:0,0"),
        _ => panic!("no dialect {name}"),
    }
}

/// A dialect and what differs from it, as the table has them.
fn varied(cell: &'static str) -> Dialect {
    let mut parts = cell.split("; ");
    let mut dialect = dialect(parts.next().unwrap());
    let listed = |texts: &'static str| -> &'static [&'static str] {
        texts.split(", ").collect::<Vec<_>>().leak()
    };
    for part in parts {
        match part.split_once('=').unwrap_or((part, "")) {
            ("banner", lines) => dialect.banner = listed(lines),
            ("version", lines) => dialect.version = listed(lines),
            ("settings", lines) => dialect.settings = listed(lines),
            ("homing", lines) => dialect.homing = listed(lines),
            ("state", state) => dialect.state = state,
            ("after", state) => dialect.state_after_reset = state,
            ("reads", _) => dialect.reads_lines = true,
            ("deaf", _) => dialect.reads_lines = false,
            _ => panic!("{part} of {cell}"),
        }
    }
    dialect
}

/// Whatever a controller deviates in, it works, or the message names it; nobody is sent to
/// the emergency stop, and no guardian raises an alarm, where nothing moves or shines.
#[test]
fn controllers_that_deviate_work_or_are_named() {
    let rows = DEVIATIONS.trim().lines().map(str::trim);
    let rows: Vec<_> = rows.filter(|row| !row.starts_with('#')).collect();
    let failures: Vec<String> = std::thread::scope(|scope| {
        let running: Vec<_> = rows
            .chunks(rows.len().div_ceil(4))
            .map(|part| scope.spawn(|| part.iter().filter_map(|row| failure(row)).collect()))
            .collect();
        let done = running.into_iter().map(|thread| thread.join().unwrap());
        done.flat_map(|failures: Vec<String>| failures).collect()
    });
    assert!(failures.is_empty(), "\n{}", failures.join("\n"));
}

fn failure(row: &'static str) -> Option<String> {
    let [controller, command, said, hint] = cases(row).next().unwrap();
    let simulator = DialectSimulator::spawn(varied(controller)).unwrap();
    let port = simulator.path().display().to_string();
    let output = run(&[&["stage"], &words(command)[..], &["--port", &port]].concat());
    let (stdout, stderr) = (text(&output.stdout), text(&output.stderr));
    let line = |start| {
        stderr
            .lines()
            .find(|line| line.starts_with(start))
            .unwrap_or("")
    };
    let is_right = match hint {
        "" => output.status.success() && stdout.contains(said) && stderr.is_empty(),
        _ => {
            output.status.code() == Some(1)
                && line("error: ").contains(said)
                && line("hint: ").contains(hint)
                && !stderr.contains("use the emergency stop")
                && !stderr.contains("guardian")
        }
    };
    (!is_right || !simulator.outputs().is_empty()).then(|| format!("{row}:\n{stdout}{stderr}"))
}

/// What answers in another language is named, in either direction.
#[test]
fn who_answers_on_a_port_is_named() {
    let saying = |report| {
        DialectSimulator::spawn(Dialect {
            report,
            ..Dialect::GRBL
        })
        .unwrap()
    };
    for [report, fact, hint] in cases(
        r#"
        @01 0 OK IDLE -- 0 | that is a Zaber device | driver = "zaber"
        echo:Unknown command: "?" | that is a 3D printer's firmware | this firmware is not supported
        {"r":{},"f":[1,0,10]} | that is TinyG | this firmware is not supported
        Brownout detector was triggered | its supply voltage falls ("Brownout | see to its power supply
        rst:0x10 (RTCWDT_RTC_RESET),boot:0x13 | it restarts instead of answering ("rst:0x10 | is not that of this board
    "#,
    ) {
        let simulator = saying(report);
        let (_folder, file) = rig_file(simulator.path());
        let output = run(&["stage", "status", "--rig", &file]);
        assert_fails(&output, 1, fact, hint);
    }
    // Those that answer whole lines alone.
    for (answers, fact) in [
        (
            &["// Unknown command:\"????\"", "ok"][..],
            "that is Klipper",
        ),
        (
            &["Error: Bad command: ????", "ok"],
            "that is RepRapFirmware",
        ),
        (&["ok"], "answered \"ok\": that is a 3D printer's firmware"),
    ] {
        let simulator = DialectSimulator::spawn(Dialect {
            report: "",
            banner: &[],
            refusals: Vec::leak(vec![("", answers)]),
            ..Dialect::GRBL
        })
        .unwrap();
        let port = simulator.path().display().to_string();
        let output = run(&["stage", "status", "--port", &port]);
        assert_fails(&output, 1, fact, "this firmware is not supported");
    }
    for address in ["socket://127.0.0.1:23", "127.0.0.1:23"] {
        let output = run(&["stage", "status", "--port", address]);
        assert_fails(
            &output,
            1,
            "is an address on a network",
            "socat makes a port of it",
        );
    }
    let refusals: &[(&str, &[&str])] = &[("/", &["error:2"])];
    let grbl = DialectSimulator::spawn(Dialect {
        refusals,
        ..Dialect::GRBL
    })
    .unwrap();
    let port = grbl.path().display().to_string();
    let output = run(&["stage", "status", "--driver", "zaber", "--port", &port]);
    assert_fails(&output, 1, "that is a GRBL controller", "driver = \"grbl\"");
}

/// What the firmware says after a command that it took counts.
#[test]
fn a_restart_or_a_dark_lamp_is_noticed() {
    let of = |refusals| {
        DialectSimulator::spawn(Dialect {
            refusals,
            ..Dialect::GRBL
        })
        .unwrap()
    };
    let restarts = of(&[("G21", &["", "Grbl 1.1h ['$' for help]"])]);
    let (_folder, file) = rig_file(restarts.path());
    let target = ["--azimuth", "10", "--elevation", "45", "--rig", &file];
    let moved = run(&[&["stage", "move", "--quiet"], &target[..]].concat());
    assert_fails(
        &moved,
        1,
        "has not been homed",
        "run `rig stage home` first",
    );
    let stays_dark = of(&[("M3", &["ok"])]);
    let (_folder, file) = rig_file(stays_dark.path());
    let lamp = run(&words(&format!(
        "stage lamp 0 --home --seconds 0 --quiet --rig {file}"
    )));
    assert_fails(
        &lamp,
        1,
        "was commanded",
        "the device has another range or step",
    );
}

/// Where the firmware's travel is shorter than the rig file's, the alarm says so.
#[test]
fn an_alarm_of_a_soft_limit_points_to_the_limits() {
    let refusals: &[(&str, &[&str])] = &[("G21", &["ALARM:2"]), ("M7", &["error:20"])];
    let simulator = DialectSimulator::spawn(Dialect {
        refusals,
        ..Dialect::GRBL
    })
    .unwrap();
    let (_folder, file) = rig_file(simulator.path());
    let target = ["--azimuth", "10", "--elevation", "45", "--rig", &file];
    let moved = run(&[&["stage", "move", "--quiet"], &target[..]].concat());
    let said = text(&moved.stderr);
    assert!(
        said.contains("alarm 2") && said.contains("correct whichever is wrong"),
        "{said}"
    );
    // An output that the build lacks.
    let lamp = run(&words(&format!(
        "stage lamp 1 --home --seconds 0 --quiet --rig {file}"
    )));
    let said = text(&lamp.stderr);
    assert!(
        said.contains("error 20") && said.contains("ENABLE_M7"),
        "{said}"
    );
    assert!(!said.contains("emergency stop"), "{said}");
}
