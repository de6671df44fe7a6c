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

/// A controller, what is asked of it, and what must come of that: a text of the output, or
/// texts of the fact and of the hint.
struct Deviation {
    dialect: Dialect,
    command: &'static [&'static str],
    says: Result<&'static str, (&'static str, &'static str)>,
}

const HOME: &[&str] = &["home"];
const STATUS: &[&str] = &["status"];
const LAMP_OFF: &[&str] = &["lamp", "off"];
const STOP: &[&str] = &["stop"];

/// As the reports of `gnea/grbl`, `grblHAL`, `bdring/FluidNC` and their senders have it; the
/// repositories and numbers stand with each.
fn deviations() -> Vec<Deviation> {
    let grbl = Dialect::GRBL;
    let works = |dialect: Dialect, command, said| Deviation {
        dialect,
        command,
        says: Ok(said),
    };
    let fails = |dialect: Dialect, command, fact, hint| Deviation {
        dialect,
        command,
        says: Err((fact, hint)),
    };
    let banner = |banner| Dialect {
        banner,
        ..grbl.clone()
    };
    let fluidnc = Dialect {
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
        ..grbl.clone()
    };
    let old = Dialect {
        report: "<STATE,MPos:0.000,0.000,0.000,WPos:0.000,0.000,0.000",
        version: &["[0.9j.20160316:]"],
        banner: &["", "Grbl 0.9j ['$' for help]"],
        ..grbl.clone()
    };
    let door = Dialect {
        state: "Door:1",
        state_after_reset: "Door:1",
        reads_lines: false,
        ..grbl.clone()
    };
    let silent_lamp = Dialect {
        outputs: "",
        ..grbl.clone()
    };
    vec![
        // Own banners (Universal-G-Code-Sender, LongMill, grblHAL, uCNC) and a port that is stopped.
        works(banner(&["ArcBench 1.1h ['$' for help]"]), STOP, "stopped"),
        works(
            banner(&["Grbl-Mega-5X 1.1t ['$' for help]"]),
            STOP,
            "stopped",
        ),
        works(
            banner(&["grblHAL 1.1f ['$' or '$HELP' for help]"]),
            STOP,
            "stopped",
        ),
        works(old.clone(), STOP, "stopped"),
        // LaserWeb/lw.comm-server#22, zeevy/grblcontroller#169, gnea/grbl#635.
        fails(
            old.clone(),
            STATUS,
            "GRBL 0.9j, and GRBL 1.1 or later is needed",
            "older versions don't report outputs",
        ),
        fails(
            Dialect {
                version: &["[0.8c.20130906:]"],
                ..old.clone()
            },
            HOME,
            "GRBL 0.8c",
            "older versions don't report outputs",
        ),
        // arkypita/LaserGRBL#667, cprezzi/grbl-LPC#39, grbl/grbl#1267.
        fails(
            door.clone(),
            HOME,
            "the safety door input is open",
            "close the safety door",
        ),
        fails(door.clone(), STATUS, "(Door:1)", "tie it to its idle level"),
        fails(
            Dialect {
                state: "Door:0",
                state_after_reset: "Door:0",
                reads_lines: true,
                ..door.clone()
            },
            HOME,
            "(Door:0)",
            "close the safety door",
        ),
        works(
            Dialect {
                state: "Door:0",
                reads_lines: true,
                ..door.clone()
            },
            LAMP_OFF,
            "held",
        ),
        works(
            Dialect {
                state: "Door:0",
                reads_lines: true,
                state_after_reset: "Idle",
                ..door
            },
            HOME,
            "idle",
        ),
        works(
            Dialect {
                state: "Hold:0",
                ..grbl.clone()
            },
            HOME,
            "idle",
        ),
        works(
            Dialect {
                state: "Sleep",
                state_after_reset: "Alarm",
                ..grbl.clone()
            },
            HOME,
            "idle",
        ),
        fails(
            Dialect {
                state: "Hold:0",
                reads_lines: false,
                ..grbl.clone()
            },
            STATUS,
            "(Hold:0)",
            "see why it was held",
        ),
        fails(
            Dialect {
                state: "Sleep",
                reads_lines: false,
                ..grbl.clone()
            },
            STATUS,
            "(Sleep)",
            "resets it and wakes it",
        ),
        // grbl/grbl#1185, zeevy/grblcontroller#121, grblHAL/LPC176x#9.
        fails(
            Dialect {
                homing: &["error:5"],
                ..grbl.clone()
            },
            HOME,
            "homing is not enabled ($22=0)",
            "set $22=1",
        ),
        fails(
            Dialect {
                homing: &["error:18"],
                ..fluidnc.clone()
            },
            HOME,
            "no axis is set to be homed",
            "under `homing:` of each axis",
        ),
        fails(
            Dialect {
                settings: &["$32=1"],
                ..grbl.clone()
            },
            STATUS,
            "($32=1)",
            "set $32=0",
        ),
        works(
            Dialect {
                settings: &["$32=2"],
                ..grbl.clone()
            },
            STATUS,
            "idle",
        ),
        fails(
            Dialect {
                settings: &["$13=1"],
                ..grbl.clone()
            },
            STATUS,
            "inches ($13=1)",
            "set $13=0",
        ),
        // A lamp that nobody lit, on a build that never says so.
        works(silent_lamp.clone(), HOME, "idle"),
        works(silent_lamp, LAMP_OFF, "off"),
        // bdring/FluidNC: other numbers, messages first, settings with names.
        works(fluidnc.clone(), HOME, "idle"),
        works(
            Dialect {
                state: "Alarm",
                state_after_reset: "Alarm",
                banner: &[
                    "Grbl 3.7 [FluidNC v3.7.13 '$' for help]",
                    "[MSG:INFO: ALARM: Unhomed]",
                    "ALARM:14",
                ],
                ..fluidnc.clone()
            },
            HOME,
            "idle",
        ),
        fails(
            Dialect {
                homing: &["[MSG:INFO: ALARM: Hard Stop]", "ALARM:13"],
                ..fluidnc.clone()
            },
            HOME,
            "alarm 13: a limit switch was hit",
            "move it off the switch by hand",
        ),
        fails(
            Dialect {
                homing: &["ALARM:12"],
                ..fluidnc.clone()
            },
            HOME,
            "both limit switches of an axis are closed",
            "its polarity ($5)",
        ),
        fails(
            Dialect {
                homing: &["ALARM:11"],
                ..fluidnc.clone()
            },
            HOME,
            "a control or limit input is active",
            "release the emergency stop",
        ),
        fails(
            Dialect {
                homing: &["ALARM:14"],
                ..fluidnc.clone()
            },
            HOME,
            "alarm 14: homing is required",
            "the stage is free to move, then",
        ),
        fails(
            Dialect {
                state: "ConfigAlarm",
                state_after_reset: "ConfigAlarm",
                ..fluidnc
            },
            HOME,
            "its configuration is faulty",
            "the controller's configuration file",
        ),
        // Homing that fails, in numbers and in words; an alarm that says nothing.
        fails(
            Dialect {
                homing: &["ALARM:8", "error:9"],
                ..grbl.clone()
            },
            HOME,
            "could not get off the limit switch",
            "the pull-off ($27)",
        ),
        fails(
            Dialect {
                homing: &["ALARM: Hard limit"],
                ..grbl.clone()
            },
            HOME,
            "alarm: Hard limit",
            "move it off the switch by hand",
        ),
        fails(
            Dialect {
                homing: &["ALARM:3"],
                ..grbl.clone()
            },
            HOME,
            "alarm 3",
            "what the stage hit or lost",
        ),
        fails(
            Dialect {
                homing: &["error: Unsupported command"],
                ..grbl.clone()
            },
            HOME,
            "error: Unsupported command",
            "commands in the rig file that this firmware has",
        ),
        fails(
            Dialect {
                homing: &["error:8"],
                ..grbl.clone()
            },
            HOME,
            "unless the machine is idle",
            "against what the device accepts",
        ),
        fails(
            Dialect {
                homing: &["error:50"],
                ..grbl.clone()
            },
            HOME,
            "error 50: the emergency stop is active",
            "or what else closes an input",
        ),
        fails(
            Dialect {
                homing: &["error:13"],
                ..grbl.clone()
            },
            HOME,
            "the safety door input is open",
            "close the safety door",
        ),
        // Lines of their own, echoes, fields without a value, carriage returns alone.
        works(
            Dialect {
                version: &["[VER:1.1f.20200721:]", "OLF:231", "DTB:2021 05 28"],
                settings: &["$0=10", "$33=on", "$N0=", "$32=0"],
                ..grbl.clone()
            },
            HOME,
            "idle",
        ),
        works(
            Dialect {
                echoes: true,
                ..grbl.clone()
            },
            HOME,
            "idle",
        ),
        works(
            Dialect {
                report: "<STATE|MPos:0.000,0.000,0.000|FS:0,0|Pn:XY|H|",
                ..grbl.clone()
            },
            HOME,
            "idle",
        ),
        works(
            Dialect {
                line_end: "\r",
                ..grbl.clone()
            },
            HOME,
            "idle",
        ),
        works(
            Dialect {
                line_end: "\n",
                ..grbl.clone()
            },
            HOME,
            "idle",
        ),
        fails(
            Dialect {
                report: "<STATE|WPos:0.000,0.000,0.000|FS:0,0",
                ..grbl.clone()
            },
            STATUS,
            "have no position",
            "set $10=1",
        ),
        fails(
            Dialect {
                report: "<STATE|MPos:nan,0.000,0.000|FS:0,0",
                ..grbl.clone()
            },
            HOME,
            "have no position",
            "set $10=1",
        ),
        fails(
            Dialect {
                report: "<STATE|MPos:0.000|FS:0,0",
                ..grbl
            },
            STATUS,
            "have 1 axes, and axis Y is needed",
            "name axes that the controller has",
        ),
    ]
}

/// Whatever a controller deviates in, it works, or the message names it; nobody is sent to
/// the emergency stop, and no guardian raises an alarm, where nothing moves or shines.
#[test]
fn controllers_that_deviate_work_or_are_named() {
    let all = deviations();
    let failures: Vec<String> = std::thread::scope(|scope| {
        let parts: Vec<_> = all.chunks(all.len().div_ceil(4)).collect();
        let running: Vec<_> = parts
            .into_iter()
            .map(|part| scope.spawn(|| part.iter().filter_map(Deviation::failure).collect()))
            .collect();
        let done = running.into_iter().map(|thread| thread.join().unwrap());
        done.flat_map(|failures: Vec<String>| failures).collect()
    });
    assert!(failures.is_empty(), "\n{}", failures.join("\n"));
}

impl Deviation {
    fn failure(&self) -> Option<String> {
        let simulator = DialectSimulator::spawn(self.dialect.clone()).unwrap();
        let port = simulator.path().display().to_string();
        let output = run(&[&["stage"], self.command, &["--port", &port]].concat());
        let (stdout, stderr) = (text(&output.stdout), text(&output.stderr));
        let line = |start| {
            stderr
                .lines()
                .find(|line| line.starts_with(start))
                .unwrap_or("")
        };
        let is_right = match self.says {
            Ok(said) => output.status.success() && stdout.contains(said) && stderr.is_empty(),
            Err((fact, hint)) => {
                output.status.code() == Some(1)
                    && line("error: ").contains(fact)
                    && line("hint: ").contains(hint)
                    && !stderr.contains("use the emergency stop")
                    && !stderr.contains("guardian")
            }
        };
        (!is_right || !simulator.outputs().is_empty()).then(|| {
            format!(
                "{:?} of {:?}:\n{stdout}{stderr}",
                self.command, self.dialect
            )
        })
    }
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
