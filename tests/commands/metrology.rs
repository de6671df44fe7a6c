//! What states results to others: the universal BRDF JSON and the certificate.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Command, Output};

use crate::command_support::{self, cases, run as rig, stderr, words};
use crate::fitted_session::{LAB, fit, session};
use rig::brdf::HalfDifference;
use rig::report::certificate::{CertificateRequest, certificate};
use rig::session::fit_record::{self, FitImages, Grade, Warning};
use serde_json::Value;

#[track_caller]
fn assert_fails(output: &Output, fact: &str, hint: &str) {
    command_support::assert_fails(output, 1, fact, hint);
}

fn column(document: &Value, path: &str) -> Vec<f64> {
    let values = document.pointer(path).unwrap().as_array().unwrap().iter();
    values.map(|value| value.as_f64().unwrap()).collect()
}

/// However the program ends, its browser ends with all that it has started, and its files go.
#[test]
fn nothing_of_a_browser_stays() {
    use rustix::process::{Pid, Signal, kill_process};
    let home = tempfile::tempdir().unwrap();
    let at = |name: &str| home.path().join(name);
    let root = session(home.path(), &fit(false), LAB, true);
    for folder in ["bin", "tmp"] {
        std::fs::create_dir(at(folder)).unwrap();
    }
    let start = |script: &str| {
        let here = home.path().display();
        let script = format!("#!/bin/sh\nHERE={here}\n{script}\n");
        std::fs::write(at("bin/chromium"), script).unwrap();
        let mode = std::os::unix::fs::PermissionsExt::from_mode(0o755);
        std::fs::set_permissions(at("bin/chromium"), mode).unwrap();
        Command::new(env!("CARGO_BIN_EXE_rig"))
            .args(words(&format!(
                "report {} --certificate --out c.pdf",
                root.display()
            )))
            .current_dir(home.path())
            .env("PATH", format!("{here}/bin:/usr/bin:/bin"))
            .env("TMPDIR", at("tmp"))
            .stderr(std::process::Stdio::piped())
            .spawn()
            .unwrap()
    };
    let wait = |what: &str, is_so: &dyn Fn() -> bool| {
        let began = std::time::Instant::now();
        while !is_so() {
            assert!(began.elapsed().as_secs() < 60, "{what}");
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
    };
    let is_over = |pid: &str| {
        let state = std::fs::read_to_string(format!("/proc/{pid}/stat"));
        state.map_or(true, |state| state.contains(") Z "))
    };
    let is_clear = || std::fs::read_dir(at("tmp")).unwrap().next().is_none();

    for signal in [Signal::INT, Signal::TERM, Signal::HUP, Signal::KILL] {
        let mut child = start("sleep 300 & echo $$ $! > $HERE/new; mv $HERE/new $HERE/pids; wait");
        wait("started", &|| at("pids").exists());
        let pids = std::fs::read_to_string(at("pids")).unwrap();
        std::fs::remove_file(at("pids")).unwrap();
        kill_process(Pid::from_child(&child), signal).unwrap();
        assert!(!child.wait().unwrap().success());
        wait("ended", &|| pids.split_whitespace().all(is_over));
        wait("cleared", &is_clear);
    }
    for [act, fact] in cases(
        "
        mkfifo $file | its file cannot be read: it is a named pipe
        ln -s /dev/zero $file | its file cannot be read: it is a device
        echo none > $file | what it wrote is none
        exit 3 | it failed (exit status: 3)
        : | it wrote no file
    ",
    ) {
        let options = "for a in \"$@\"; do case $a in --print-to-pdf=*) file=${a#*=};; esac; done";
        let output = start(&format!("{options}\n{act}"))
            .wait_with_output()
            .unwrap();
        assert_fails(&output, fact, "write a .html file instead");
        assert!(is_clear() && !at("c.pdf").exists(), "{act}");
    }
}

/// Every row is a constrained cell of the fit's table, at directions that have its angles.
#[test]
fn the_universal_json_holds_the_constrained_cells() {
    let home = tempfile::tempdir().unwrap();
    let record = fit(false);
    let root = session(home.path(), &record, LAB, true);
    let done = rig(
        home.path(),
        &["export", root.to_str().unwrap(), "--format", "birdf"],
    );
    assert!(done.status.success(), "{}", stderr(&done));
    assert_eq!(
        (done.stdout.as_slice(), stderr(&done).as_str()),
        (&b"red-plastic.birdf.json\n"[..], "")
    );
    let bytes = std::fs::read(home.path().join("red-plastic.birdf.json")).unwrap();
    let document: Value = serde_json::from_slice(&bytes).unwrap();

    // The values.
    let [theta_i, phi_i, theta_r, phi_r, f, u] =
        ["theta_i", "phi_i", "theta_r", "phi_r", "BRDF", "uBRDF"]
            .map(|name| column(&document, &format!("/data/{name}/values")));
    let adhoc = |name: &str| format!("/data/adhoc_variables/{name}/values");
    let [low, high] = ["interval_lower", "interval_upper"].map(|n| column(&document, &adhoc(n)));
    let channels = document.pointer(&adhoc("channel")).unwrap();
    let mut seen = BTreeMap::new();
    for n in 0..f.len() {
        let direction = |theta_deg: f64, phi_deg: f64| {
            let (sin, cos) = theta_deg.to_radians().sin_cos();
            let (sin_phi, cos_phi) = phi_deg.to_radians().sin_cos();
            glam::DVec3::new(sin * cos_phi, sin * sin_phi, cos)
        };
        assert!(theta_i[n] < 90.0 && phi_r[n] < 360.0);
        let angles = HalfDifference::from_directions(
            direction(theta_i[n], phi_i[n]),
            direction(theta_r[n], phi_r[n]),
        );
        let [h, d] = [angles.theta_h_rad, angles.theta_d_rad].map(f64::to_degrees);
        let cell = record.table.nearest(h, d).unwrap();
        assert!(cell.constrained, "{h} {d}");
        let channel = channels[n].as_str().unwrap();
        let c = ["R", "G", "B"]
            .iter()
            .position(|name| *name == channel)
            .unwrap();
        assert_eq!(
            [f[n], low[n], high[n]],
            [cell.value[c], cell.lower[c], cell.upper[c]]
        );
        // Half the interval's width.
        assert!((u[n] / (0.125 * f[n]) - 1.0).abs() < 1e-12);
        *seen.entry(channel.to_owned()).or_insert(0) += 1;
    }
    let constrained = record
        .table
        .cells
        .iter()
        .filter(|cell| cell.constrained)
        .count();
    assert_eq!(
        seen,
        ["B", "G", "R"]
            .map(|name| (name.to_owned(), constrained))
            .into()
    );

    // What it says of itself.
    let text = |path: &str| document.pointer(path).unwrap().as_str().unwrap().to_owned();
    assert_eq!(text("/metadata/method"), "measurement");
    assert_eq!(
        text("/metadata/provenance/organization"),
        "Institute of Optics"
    );
    assert!(text("/data/BRDF/comments").contains("G: 510 nm to 550 nm"));
    assert!(
        text("/data/uBRDF/comments").contains("was not measured"),
        "paper42"
    );
    assert!(text("/metadata/adhoc_section/traceability").contains("reflectance 0.985 ± 0.004"));
    let sensors = "/metadata/instrumentation/detection_system/sensors/0/name";
    assert_eq!(text(sensors), "bench");
    let area = "/metadata/instrumentation/illumination_system/beam/dimensions/area";
    let area = &document.pointer(area).unwrap();
    assert!((area["value"].as_f64().unwrap() - 29.3 * 22.0).abs() < 1e-9);
    assert_eq!(area["unit"], "mm^2");
    assert!(!String::from_utf8(bytes).unwrap().contains("SIMULATED"));
}

#[test]
fn a_simulation_is_one_and_what_is_not_stated_is_named() {
    let home = tempfile::tempdir().unwrap();
    let root = session(home.path(), &fit(true), "[lab]\ncity = \"Espoo\"\n", true);
    let done = rig(
        home.path(),
        &words(&format!(
            "export {} --format birdf --out x.json",
            root.display()
        )),
    );
    let said = stderr(&done);
    assert!(
        said.contains("simulated bench") && said.contains("organisation, contact"),
        "{said}"
    );
    let bytes = std::fs::read(home.path().join("x.json")).unwrap();
    let document: Value = serde_json::from_slice(&bytes).unwrap();
    let metadata = &document["metadata"];
    assert_eq!(metadata["method"], "simulation");
    assert_eq!(metadata["instrumentation"], "NA");
    assert!(
        metadata["description"]
            .as_str()
            .unwrap()
            .starts_with("SIMULATED")
    );
    assert_eq!(metadata["provenance"]["organization"], "not stated");
    assert_eq!(metadata["provenance"]["location"]["city"], "Espoo");
    assert!(
        metadata["comments"]
            .as_str()
            .unwrap()
            .contains("does not state: organisation")
    );
}

#[test]
fn what_was_not_measured_is_not_exported() {
    let home = tempfile::tempdir().unwrap();
    let mut nothing = fit(false);
    nothing
        .table
        .cells
        .iter_mut()
        .for_each(|cell| cell.constrained = false);
    let root = session(home.path(), &nothing, LAB, true);
    let failed = rig(
        home.path(),
        &["export", root.to_str().unwrap(), "--format", "birdf"],
    );
    let hint = "capture the sample under more lights";
    assert_fails(&failed, "the images constrain no cell", hint);
    fit_record::write(&home.path().join("fit"), &fit(false), &FitImages::default()).unwrap();
    let failed = rig(home.path(), &["export", "fit", "--format", "birdf"]);
    assert_fails(
        &failed,
        "fit is a fit outside a session",
        "`rig fit SESSION`",
    );
    let failed = rig(
        home.path(),
        &["export", "fit", "--format", "birdf", "--out", "a.brdf"],
    );
    assert_fails(&failed, "ends in .json", "name it a.json");
    assert!(!home.path().join("red-plastic.birdf.json").exists());
}

/// Shown numbers with the exact ones behind them, of the elements of a class or without one.
fn cells(html: &str, class: &str) -> Vec<(f64, f64)> {
    let mut found = Vec::new();
    for piece in html.split("<td").skip(1) {
        let Some((attributes, rest)) = piece.split_once('>') else {
            continue;
        };
        let Some((_, exact)) = attributes.split_once("data-exact=\"") else {
            continue;
        };
        if attributes.contains(&format!("class=\"{class}")) == class.is_empty() {
            continue;
        }
        let exact = exact.split('"').next().unwrap().parse().unwrap();
        let shown = rest.split('<').next().unwrap();
        let shown = shown.replace('−', "-").parse().unwrap();
        found.push((shown, exact));
    }
    found
}

#[test]
fn a_certificates_figures_are_the_fits_and_its_squares_add() {
    let home = tempfile::tempdir().unwrap();
    let record = fit(false);
    let root = session(home.path(), &record, LAB, true);
    let done = rig(
        home.path(),
        &words(&format!(
            "report {} --certificate --out c.html",
            root.display()
        )),
    );
    assert!(done.status.success(), "{}", stderr(&done));
    let html = std::fs::read_to_string(home.path().join("c.html")).unwrap();
    let html = html.replace("&#x2f;", "/");

    // The budget.
    let budget = record.budget.as_ref().unwrap();
    let combined = cells(&html, "combined");
    let exact: Vec<f64> = budget.row.iter().map(|row| row.relative_std).collect();
    assert_eq!(combined.iter().map(|c| c.1).collect::<Vec<_>>(), exact);
    let contributions = cells(&html, "contribution");
    assert_eq!(contributions.len(), 6);
    for (n, &(shown_total, total)) in combined.iter().enumerate() {
        assert!(
            (shown_total / (100.0 * total) - 1.0).abs() < 5e-2,
            "two digits"
        );
        let column = || contributions.iter().skip(n).step_by(2);
        let squares: f64 = column().map(|c| c.1 * c.1).sum();
        assert!((squares.sqrt() / total - 1.0).abs() < 1e-12);
        // Also the printed ones, within their rounding.
        let printed: f64 = column().map(|c| c.0 * c.0).sum();
        assert!((printed.sqrt() / shown_total - 1.0).abs() < 6e-2);
    }

    // What a reader must find.
    for said in [
        "Institute of Optics",
        "Reflectometry &lt;1&gt;",
        "Operator: A. Miller",
        "Contact: B. Jones",
        "reflectometry@example.org",
        "https://example.org/reflectometry",
        "Long Street 8, 02150 Espoo, Finland",
        "temperature 22.5 °C, relative humidity 45%",
        "R: 605 nm to 640 nm",
        "400 nm to 1000 nm",
        "lamp 9 W",
        "hollow hemisphere",
        "standard uncertainty 1.00%",
        "The stated coverage of 95.0% is not shown",
        "fits/0/fit.toml",
        "page 2 of 2",
        "approved by",
    ] {
        assert!(html.contains(said), "{said}");
    }
    let constrained = record
        .table
        .cells
        .iter()
        .filter(|cell| cell.constrained)
        .count();
    assert!(html.contains(&format!("constrain {constrained} of 70 cells")));
    let sum = rig::checksum::sha256_hex(&std::fs::read(root.join("fits/0/fit.toml")).unwrap());
    assert!(html.contains(&sum));
    assert!(!html.contains("SIMULATED"));
    // Whatever a rig file states stays text, and no other file is needed.
    assert!(!html.contains("<1>") && !html.contains("src=") && !html.contains("@import"));
}

#[test]
fn scatter_between_sessions_enters_a_certificate() {
    let home = tempfile::tempdir().unwrap();
    let sessions = home.path();
    let mut repeat = fit(false);
    repeat.budget.as_mut().unwrap().row[0].value *= 1.1;
    let repeated = session(sessions, &repeat, LAB, true);
    std::fs::rename(repeated, sessions.join("repeat")).unwrap();
    let root = session(sessions, &fit(false), LAB, true);
    let request = CertificateRequest {
        session: root.clone(),
        fit: None,
        repeats: Some(sessions.to_owned()),
    };
    let html = certificate(&request).unwrap();
    assert!(html.contains("reproducibility over 2 sessions"));
    // The values x and 1.1 x have a variance of 2 (0.05 / 1.05)²; the fits state 0.3 u² of it, as
    // capture noise and pose.
    let stated = 0.041_234_567_8f64;
    let between = (2.0 * (0.05f64 / 1.05).powi(2) - 0.3 * stated.powi(2)).sqrt();
    let total = cells(&html, "combined")[0].1;
    assert!((total - stated.hypot(between)).abs() < 1e-12, "{total}");

    // One session alone, and no folder.
    std::fs::remove_dir_all(sessions.join("repeat")).unwrap();
    let root = root.to_str().unwrap();
    let certify = |folder: &str| {
        rig(
            sessions,
            &["report", root, "--certificate", "--repeats", folder],
        )
    };
    assert_fails(
        &certify("."),
        "a spread needs 2 at least",
        "`rig catalogue DIR --repeats SAMPLE` shows which sessions count",
    );
    assert_fails(
        &certify("none"),
        "none: No such file",
        "--repeats takes the folder that holds the sessions",
    );
}

#[test]
fn an_export_is_called_after_its_sample() {
    let home = tempfile::tempdir().unwrap();
    let root = session(home.path(), &fit(false), LAB, true);
    let export = |more: &[&str]| {
        let done = rig(
            home.path(),
            &[&["export", root.to_str().unwrap()], more].concat(),
        );
        assert!(done.status.success(), "{}", stderr(&done));
        String::from_utf8(done.stdout).unwrap()
    };
    assert_eq!(export(&["--format", "json"]), "red-plastic.json\n");
    let none = rig(&root, &words("export . --format json --fit 7"));
    assert_fails(&none, ". has no fit 7", "leave --fit out");
    let made = export(&["--format", "blender", "--out", "a.py"]);
    assert_eq!(made, "a.py\na.py.png\n");
    let name = |file: &str| {
        let script = std::fs::read_to_string(home.path().join(file)).unwrap();
        let line = script.lines().find_map(|line| line.strip_prefix("NAME = "));
        line.unwrap().to_owned()
    };
    assert_eq!(name("a.py"), "\"red-plastic\"");
    export(&["--format", "blender", "--name", "wall paint"]);
    assert_eq!(name("red-plastic.py"), "\"wall paint\"");
}

#[test]
fn the_catalogue_is_a_table_for_spreadsheets() {
    let home = tempfile::tempdir().unwrap();
    session(home.path(), &fit(false), LAB, true);
    let done = rig(home.path(), &["catalogue", ".", "--csv"]);
    assert!(done.status.success(), "{}", stderr(&done));
    let table = String::from_utf8(done.stdout).unwrap();
    let [names, row] = table.lines().collect::<Vec<_>>()[..] else {
        panic!("{table}");
    };
    assert!(names.starts_with("session,sample,material,true_material,comment,began_utc,"));
    assert!(
        row.contains(",red-plastic,\"red paint, batch 12\",,,2026-11-21T"),
        "{row}"
    );
    assert!(
        row.ends_with(",yes,no,no,0,paper42,explains,1.0,,"),
        "{row}"
    );
}

#[test]
fn a_simulated_certificate_says_so_on_both_pages() {
    let home = tempfile::tempdir().unwrap();
    let mut record = fit(true);
    for row in &mut record.budget.as_mut().unwrap().row {
        row.share = vec![0.3, 0.0, 0.7];
    }
    let lab = "[lab]\nroom_temperature_c = 22.5\n";
    let root = session(home.path(), &record, lab, true);
    let arguments = [
        "report",
        root.to_str().unwrap(),
        "--certificate",
        "--out",
        "c.html",
    ];
    let done = rig(home.path(), &arguments);
    assert!(done.status.success());
    let said = stderr(&done);
    assert!(
        said.contains("contact, city, room_humidity_percent; state them in [lab]"),
        "{said}"
    );
    let html = std::fs::read_to_string(home.path().join("c.html")).unwrap();
    assert_eq!(html.matches("SIMULATED – NOT A MEASUREMENT").count(), 2);
    // What is not known is said, and never 0.
    for said in [
        "in [lab] of the rig file: organisation, laboratory, operator, contact, city, room_humidity_percent</span>",
        "temperature 22.5 °C, relative humidity not stated",
        "<td>pose</td><td class=\"text\">B</td><td>1</td><td class=\"none\" colspan=\"2\">not evaluated</td>",
        "took it as exactly known: pose. An error of it is not in U; the bench was taken as exact.",
    ] {
        assert!(html.contains(said), "{said}");
    }
    assert!(!html.contains(">0<"));
    // Result and budget are of the same angles.
    for angles in [["0°", "15°"], ["40°", "45°"]] {
        let row = format!("<td>{}</td><td>{}</td>", angles[0], angles[1]);
        assert!(html.contains(&row) && html.contains(&format!("<th>{}</th>", angles.join(", "))));
    }
}

#[test]
fn nobody_signs_what_is_not_to_be_trusted() {
    let home = tempfile::tempdir().unwrap();
    let made = |name: &str, change: &dyn Fn(&mut fit_record::FitRecord), complete| {
        let mut record = fit(false);
        change(&mut record);
        session(&home.path().join(name), &record, LAB, complete)
    };
    let certified = |root: &Path| {
        rig(
            home.path(),
            &words(&format!(
                "report {} --certificate --out c.html",
                root.display()
            )),
        )
    };
    let distrusted = made(
        "distrusted",
        &|record| {
            record.warnings = vec![Warning {
                what: "these images show another sample".to_owned(),
                likely_cause: "exchanged images".to_owned(),
                grade: Grade::Distrust,
            }];
        },
        true,
    );
    let trusted = "made of a fit that explains its images";
    assert_fails(
        &certified(&distrusted),
        "is not to be trusted: these images show another sample",
        trusted,
    );
    let incomplete = made("incomplete", &|_| {}, false);
    let verify = "`rig session verify SESSION` lists what is wrong";
    assert_fails(
        &certified(&incomplete),
        "the capture is not complete",
        verify,
    );
    let damaged = made("damaged", &|_| {}, true);
    let frame = damaged.join("raw/L000_E00_R00_light.png");
    std::fs::write(frame, "x").unwrap();
    assert_fails(&certified(&damaged), "not as it was captured", verify);
    let without = made("without", &|record| record.budget = None, true);
    assert_fails(
        &certified(&without),
        "has no budget",
        "a new fit, with a budget",
    );

    // Other files than pages, and fits that are not there.
    let whole = made("whole", &|_| {}, true);
    let whole = whole.to_str().unwrap();
    let asked = |more: &[&str]| {
        rig(
            home.path(),
            &[&["report", whole, "--certificate"], more].concat(),
        )
    };
    assert_fails(
        &asked(&["--out", "c.doc"]),
        "a certificate ends in .html or .pdf",
        "certificate.pdf",
    );
    assert_fails(
        &asked(&["--out", "c.html", "--fit", "7"]),
        "has no fit 7",
        "leave --fit out",
    );
    let no_path = Command::new(env!("CARGO_BIN_EXE_rig"))
        .args(["report", whole, "--certificate", "--out", "c.pdf"])
        .env("PATH", home.path())
        .output()
        .unwrap();
    assert_fails(
        &no_path,
        "no browser that prints was found",
        "print it from any browser",
    );
    assert!(!home.path().join("c.html").exists() && !home.path().join("c.pdf").exists());
}
