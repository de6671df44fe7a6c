//! `rig capture` and `rig session` as a user runs them, on the simulated rig.

mod small_bench;

use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::Arc;

use rig::brdf::Dictionary;
use rig::capture::reach::StageReach;
use rig::config::RigConfig;
use rig::inverse::{Captured, CellOptions, FitOptions, fit, intervals};
use rig::radiance_image::exr;
use rig::session::commit::SystemDisk;
use rig::session::{
    Event, NewSession, Session, SessionState, SessionWriter, fit_record, layout, verify,
};
use rig::units::StageAngles;
use tempfile::TempDir;

/// A measured material, whose table takes its time, and one that does not.
const BUNDLED: &str = "material = \"nbrdf:dark-red-paint\"";
const QUICK: &str = "brdf = { mixture = [ { weight = 1.0, lambertian = { albedo = 0.8 } } ] }";

/// A folder to work in, with a rig file of the small simulated bench whose truth is
/// rendered quickly; `change` is applied to its text.
fn workplace(change: impl FnOnce(String) -> String) -> TempDir {
    let folder = quick_bench(&small_bench::rig_file(), change);
    small_bench::put_records(folder.path());
    folder
}

/// The same with the camera that the program ships.
fn shipped_workplace(change: impl FnOnce(String) -> String) -> TempDir {
    quick_bench(include_str!("../rig-configs/simulated.toml"), change)
}

fn quick_bench(text: &str, change: impl FnOnce(String) -> String) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let (before, simulation) = text.split_once("[simulation]").unwrap();
    let quick = [
        ("samples_per_pixel = ", "samples_per_pixel = 2"),
        ("max_reflections = ", "max_reflections = 2"),
        ("segments = ", "segments = 32"),
        ("timing = ", "timing = \"instant\""),
        ("material = ", QUICK),
        ("timing = ", "timing = \"instant\""),
    ];
    let simulation = quick
        .iter()
        .fold(simulation.to_owned(), |text, (key, quick)| {
            let (before, rest) = text.split_once(&format!("\n{key}")).expect(key);
            let (_, after) = rest.split_once('\n').expect(key);
            format!("{before}\n{quick}\n{after}")
        });
    let text = format!("{before}[simulation]{simulation}");
    std::fs::write(folder.path().join("rig.toml"), change(text)).unwrap();
    folder
}

/// The rig file with this beside the sample.
fn with_body(text: &str, body: &str) -> String {
    let next = "[geometry.sample_from_stage]";
    text.replace(next, &format!("[[geometry.body]]\n{body}\n{next}"))
}

fn rig(folder: &TempDir, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rig"));
    command
        .args(arguments)
        .current_dir(folder.path())
        .env_remove("RIG_CONFIG")
        .env_remove("RUST_BACKTRACE");
    command
}

fn run(folder: &TempDir, arguments: &[&str]) -> Output {
    rig(folder, arguments).output().unwrap()
}

fn text(bytes: &[u8]) -> &str {
    str::from_utf8(bytes).unwrap()
}

/// One line that states the fact, a hint, exit code 1, nothing else.
fn assert_refused(output: &Output, fact: &str) {
    let stderr = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    let lines: Vec<&str> = stderr.trim_end().lines().collect();
    let error = lines
        .iter()
        .find(|line| line.starts_with("error: "))
        .unwrap_or(&"");
    assert!(error.contains(fact), "{stderr}");
    assert!(lines.last().unwrap().starts_with("hint: "), "{stderr}");
    assert!(
        !stderr.contains("panicked") && !stderr.contains("internal error"),
        "{stderr}"
    );
}

fn no_session(folder: &TempDir) {
    let sessions = folder.path().join("sessions");
    let any = std::fs::read_dir(sessions).map_or(0, |entries| entries.count());
    assert_eq!(any, 0);
}

/// The path that stdout ends with.
fn session_of(folder: &TempDir, output: &Output) -> PathBuf {
    folder
        .path()
        .join(text(&output.stdout).lines().last().unwrap())
}

#[test]
fn a_capture_is_complete_verified_and_listed() {
    let folder = shipped_workplace(|text| text.replace(QUICK, BUNDLED));
    let output = run(
        &folder,
        &["capture", "--lights", "2", "--no-fit", "--sample", "cup"],
    );
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let root = session_of(&folder, &output);
    let session = Session::open(&root).unwrap();
    assert_eq!(session.state(), SessionState::Complete);
    let record = session.record();
    assert!(record.simulated);
    assert_eq!(record.sample, "cup");
    assert_eq!(
        record.true_material.as_deref(),
        Some("nbrdf:dark-red-paint")
    );
    assert!(
        record
            .calibration
            .iter()
            .any(|copy| copy.id.starts_with("sensor/"))
    );
    for light in 0..2 {
        let bytes = session.read_file(&layout::radiance_file(light)).unwrap();
        let path = Path::new("radiance.exr");
        let image = rig::radiance_image::exr::decode(&bytes, path)
            .unwrap()
            .image;
        assert_eq!((image.width, image.height), (640, 480));
        let lit = image.mean.iter().filter(|mean| mean[0] > 0.01).count();
        assert!(lit > 30_000, "light {light}: {lit} pixels are lit");
    }
    let root = root.to_str().unwrap();
    assert_eq!(
        run(&folder, &["session", "verify", root]).status.code(),
        Some(0)
    );
    let list = run(&folder, &["session", "list", "--json"]);
    let list: serde_json::Value = serde_json::from_slice(&list.stdout).unwrap();
    assert_eq!(list[0]["lights_finished"], 2);
    assert_eq!(list[0]["complete"], true);
    // A complete session resumes to itself.
    let again = run(&folder, &["capture", "--resume", root, "--no-fit"]);
    assert_eq!(again.status.code(), Some(0), "{}", text(&again.stderr));

    // One flipped bit is found, named, and a resume refuses to go on.
    let frame = Path::new(root).join("raw/L000_E00_R00_light.png");
    let mut bytes = std::fs::read(&frame).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 4;
    std::fs::write(&frame, bytes).unwrap();
    assert_refused(
        &run(&folder, &["session", "verify", root]),
        "L000_E00_R00_light.png",
    );
    assert_refused(&run(&folder, &["capture", "--resume", root]), "SHA-256");
    let journal = Path::new(root).join(layout::JOURNAL_FILE);
    let mut bytes = std::fs::read(&journal).unwrap();
    bytes[200] ^= 1;
    std::fs::write(&journal, bytes).unwrap();
    assert_refused(&run(&folder, &["session", "verify", root]), "line 1");
}

/// A colour camera under a white lamp: a cell of its filters becomes one pixel of the
/// images, and the fit's camera has as many.
#[test]
fn a_colour_camera_is_captured_and_fitted() {
    let white = "\n[[stage.lamp]]\nmeasures = \"RGB\"\non = \"M3 S1000; M7; M8\"\n\n";
    let folder = workplace(|text| {
        let (before, lamps) = text.split_once("\n[[stage.lamp]]").unwrap();
        let (_, geometry) = lamps
            .split_once("[[stage.lamp]]\nmeasures = \"B\"")
            .unwrap();
        let (_, geometry) = geometry.split_once("\n\n").unwrap();
        let text = format!("{before}{white}{geometry}");
        text.replace("\nmosaic = \"none\"", "\nmosaic = \"grbg\"")
            .replace("\nsamples_per_pixel = 160", "\nsamples_per_pixel = 32")
            .replace("\nsamples_per_pixel = 2\n", "\nsamples_per_pixel = 128\n")
            .replace("\nmax_reflections = 2\n", "\nmax_reflections = 16\n")
    });
    let output = run(&folder, &["capture", "--lights", "2"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let session = Session::open(&session_of(&folder, &output)).unwrap();
    let bytes = session.read_file(&layout::radiance_file(0)).unwrap();
    let image = rig::radiance_image::exr::decode(&bytes, Path::new("radiance.exr"))
        .unwrap()
        .image;
    assert_eq!((image.width, image.height), (32, 32));
    let fit = session.read_file("fits/0/fit.toml").unwrap();
    let fit: toml::Table = toml::from_str(text(&fit)).unwrap();
    let error = fit["score"]["environment_error"]["estimate"]["overall"].as_float();
    assert!(error.unwrap() < 0.08, "{error:?}");
}

/// The rig file's mesh goes into the session, so that the session can be moved, and the
/// mesh be changed, before the fit.
#[test]
fn a_session_is_fitted_with_the_mesh_it_was_captured_with() {
    let folder = workplace(|text| {
        let (before, shape) = text.split_once("[geometry.sample.shape]").unwrap();
        let (_, after) = shape.split_once("\n[").unwrap();
        let table = "[geometry.sample]\n";
        let with_mesh = before.replace(table, &format!("{table}mesh = \"meshes/bowl.ply\"\n"));
        format!("{with_mesh}[{after}")
    });
    let at = folder.path();
    let meshes = at.join("meshes");
    std::fs::create_dir(&meshes).unwrap();
    let mesh = meshes.join("bowl.ply");
    let made = run(
        &folder,
        &[
            "shape",
            "bowl",
            "--radius",
            "10",
            "--segments",
            "24",
            "--out",
            "meshes/bowl.ply",
        ],
    );
    assert!(made.status.success(), "{}", text(&made.stderr));
    let captured = run(&folder, &["capture", "--lights", "1", "--no-fit"]);
    assert!(captured.status.success(), "{}", text(&captured.stderr));
    let moved = at.join("moved");
    std::fs::rename(session_of(&folder, &captured), &moved).unwrap();
    std::fs::remove_file(mesh).unwrap();
    let fitted = run(
        &folder,
        &["fit", "moved", "--spp", "4", "--max-reflections", "2"],
    );
    assert!(fitted.status.success(), "{}", text(&fitted.stderr));
    assert!(verify::verify(&moved).unwrap().is_intact());
}

/// The session of a bench whose lamp nobody measured, as no simulated one is: the record of its
/// fit says what the albedo rests on.
#[test]
fn a_scale_that_nobody_measured_is_remarked_on() {
    let folder = shipped_workplace(|text| text);
    let captured = run(&folder, &["capture", "--lights", "1", "--no-fit"]);
    assert!(captured.status.success(), "{}", text(&captured.stderr));
    let root = session_of(&folder, &captured);
    let fit = |root: &Path| {
        let fitted = run(
            &folder,
            &["fit", root.to_str().unwrap(), "--spp", "64", "--json"],
        );
        assert!(fitted.status.success(), "{}", text(&fitted.stderr));
        let told: serde_json::Value = serde_json::from_slice(&fitted.stdout).unwrap();
        (told["remarks"].clone(), text(&fitted.stderr).to_owned())
    };
    assert_eq!(
        fit(&root).0,
        serde_json::json!([]),
        "a simulated lamp is known"
    );

    let root = retold(&root, |config| {
        config.remove("simulation");
        config["camera"]["driver"] = "v4l".into();
        config["stage"]["driver"] = "grbl".into();
        for (table, key, path) in [
            ("camera", "device", "/dev/video0"),
            ("stage", "port", "/dev/ttyACM0"),
        ] {
            let table = config[table].as_table_mut().unwrap();
            table.insert(key.to_owned(), path.into());
        }
    });
    let (remarks, stderr) = fit(&root);
    let [remark] = &remarks.as_array().unwrap()[..] else {
        panic!("{remarks}");
    };
    let remark = remark.as_str().unwrap();
    assert!(
        remark.starts_with("no record of the irradiance"),
        "{remark}"
    );
    assert!(stderr.contains(remark), "{stderr}");
}

/// A session with the same frames of a bench with another configuration.
fn retold(root: &Path, change: impl FnOnce(&mut toml::Table)) -> PathBuf {
    let told = Session::open(root).unwrap();
    let mut record = told.record().clone();
    let mut config = toml::from_str(&record.config).unwrap();
    change(&mut config);
    record.config = toml::to_string(&config).unwrap();
    record.simulated = false;
    let new = NewSession {
        parent: root.parent().unwrap(),
        created: jiff::Timestamp::UNIX_EPOCH,
        short_id: "retold",
        record: &record,
        calibration: &[],
    };
    let mut writer = SessionWriter::create(Arc::new(SystemDisk), &new).unwrap();
    let mut frames = told.frames();
    for step in &told.journal().records {
        match &step.event {
            Event::Start { .. } | Event::Stop => {}
            Event::Frame { .. } => {
                let (frame, sidecar) = told.read_frame(&frames.next().unwrap()).unwrap();
                writer.commit_frame(&frame, &sidecar).unwrap();
            }
            Event::File { file } if file.path == layout::MANIFEST_FILE => {}
            Event::File { file } => {
                let bytes = told.read_file(&file.path).unwrap();
                writer.commit_file(&file.path, &bytes).unwrap();
            }
            event => writer.record(event.clone()).unwrap(),
        }
    }
    writer.finish().unwrap();
    writer.root().to_owned()
}

/// Four bright walls around the bowl, outside the view. The simulated bench has them, the fit
/// knows them from the session's copies, and a fit that is not told takes their light for the
/// sample's.
#[test]
fn a_holder_is_captured_and_known_to_the_fit() {
    const HOLDER: &str = "mesh = \"holder.obj\"\n\
        brdf = { dictionary = \"holder.json\", weights = \"holder.csv\" }";
    const WALLS: &str = "v -12 -12 0\nv 12 -12 0\nv 12 12 0\nv -12 12 0\n\
        v -12 -12 8\nv 12 -12 8\nv 12 12 8\nv -12 12 8\n\
        f 1 4 8 5\nf 4 3 7 8\nf 3 2 6 7\nf 2 1 5 6\n";
    let folder = workplace(|text| {
        with_body(&text, HOLDER)
            .replace("samples_per_pixel = 2\n", "samples_per_pixel = 64\n")
            .replace("max_reflections = 2\n", "max_reflections = 6\n")
    });
    let at = folder.path();
    let atoms = r#"{ "atoms": [ { "type": "lambertian", "albedo": 0.9 } ] }"#;
    let files = [
        ("holder.obj", WALLS),
        ("holder.json", atoms),
        (
            "holder.csv",
            "atom,kind,weight_r,weight_g,weight_b\n0,lambertian,1,1,1\n",
        ),
    ];
    for (name, content) in files {
        std::fs::write(at.join(name), content).unwrap();
    }
    // From above and from one side, so that the walls are lit and shade little of the bowl.
    let lights = ["--light", "0,90", "--light", "0,45", "--no-fit"];
    let captured = run(&folder, &[&["capture"][..], &lights].concat());
    assert!(captured.status.success(), "{}", text(&captured.stderr));
    let moved = at.join("moved");
    std::fs::rename(session_of(&folder, &captured), &moved).unwrap();
    for (name, _) in files {
        std::fs::remove_file(at.join(name)).unwrap();
    }
    let fitted = run(&folder, &["fit", "moved", "--spp", "64"]);
    assert!(fitted.status.success(), "{}", text(&fitted.stderr));
    assert!(verify::verify(&moved).unwrap().is_intact());
    let record = fit_record::read(&moved.join("fits/0")).unwrap();
    let halves = &record.table.theta_h_deg;
    let at_40_deg = halves.iter().position(|&h| h >= 40.0).unwrap();
    let known = record.table.cell(at_40_deg, 0).unwrap().value[1];

    let session = Session::open(&moved).unwrap();
    let mut config = RigConfig::load(&at.join("rig.toml")).unwrap();
    config.geometry.bodies.clear();
    let lights = &session.record().plan.lights;
    let images: Vec<_> = (0..lights.len() as u32)
        .map(|light| exr::read(&moved.join(layout::radiance_file(light))).unwrap())
        .map(|file| file.image)
        .collect();
    let mut options = FitOptions::default();
    options.cache.samples_per_cell = 64;
    let scene = config.geometry.scene(lights).unwrap();
    let dictionary = Arc::new(Dictionary::rig26());
    let images = Captured::new(&scene, &images, &CellOptions::default()).unwrap();
    let fit = fit(&scene, &images, &dictionary, &options, &mut |_| {}).unwrap();
    let untold = intervals::table(&fit.material, &[], &[halves[at_40_deg]], &[0.0])[0].value[1];

    let errors = [known, untold].map(|f| f / (0.8 / std::f64::consts::PI) - 1.0);
    println!(
        "holder known: {:+.4}, not told: {:+.4}",
        errors[0], errors[1]
    );
    // Without, gloss and departures have to explain the walls' light.
    assert!(errors[0].abs() < 0.02, "{errors:?}");
    assert!(errors[1].abs() > 0.04, "{errors:?}");
}

#[test]
fn the_best_lights_are_planned_within_the_limits() {
    let folder = tempfile::tempdir().unwrap();
    let words = ["capture", "--lights", "best:3", "--dry-run", "--json"];
    let output = run(&folder, &words);
    assert!(output.status.success());
    let plan: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let lights = plan["lights"].as_array().unwrap();
    assert_eq!(lights.len(), 3);
    for (index, light) in lights.iter().enumerate() {
        let elevation_deg = light["elevation_deg"].as_f64().unwrap();
        assert!((45.0..=90.0).contains(&elevation_deg), "{light}");
        assert!(!lights[..index].contains(light), "{light} twice");
    }
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("best of 60 directions"), "{said}");
}

#[test]
fn a_dry_run_prints_the_plan_and_touches_nothing() {
    let folder = workplace(|text| text);
    let output = run(&folder, &["capture", "--lights", "4", "--dry-run"]);
    assert_eq!(output.status.code(), Some(0));
    assert!(text(&output.stdout).contains("light 0: azimuth 0.000°, elevation 45.000°"));
    let output = run(
        &folder,
        &["capture", "--lights", "4", "--dry-run", "--json"],
    );
    let plan: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(plan["lights"].as_array().unwrap().len(), 4);
    assert!(plan["estimated_s"].as_f64().unwrap() > 1.0);
    assert!(plan["estimated_bytes"].as_f64().unwrap() > 4.0 * 64.0 * 64.0 * 2.0);
    no_session(&folder);
}

#[test]
fn bad_input_is_refused_before_anything_moves() {
    let folder = workplace(|text| text);
    std::fs::write(folder.path().join("file"), "").unwrap();
    for (arguments, fact) in [
        (&["capture"][..], "--lights"),
        (&["capture", "--lights", "none"], "--lights"),
        (&["capture", "--lights", "99999"], "the stage reaches"),
        (
            &["capture", "--light", "0,10"],
            "outside the stage's limits",
        ),
        (&["capture", "--light", "0"], "--light"),
        (
            &["capture", "--light", "0,60", "--light", "0,60"],
            "--light names the direction",
        ),
        (
            &["capture", "--light", "10,60", "--light", "370,60"],
            "--light names one direction twice",
        ),
        (
            &["capture", "--light", "0,90", "--light", "120,90"],
            "--light names one direction twice",
        ),
        (
            &["capture", "--lights", "1", "--sample", "../x"],
            "sample name",
        ),
        (&["capture", "--lights", "1", "--out", "file/x"], "file"),
        (
            &["capture", "--lights", "1", "--rig", "none.toml"],
            "none.toml",
        ),
        (&["capture", "--resume", "nowhere"], "nowhere"),
        (&["capture", "--resume", "."], "is not a session"),
        (&["session", "verify", "nowhere"], "nowhere"),
        (&["session", "list", "nowhere"], "nowhere"),
    ] {
        let output = run(&folder, arguments);
        assert_refused(&output, fact);
        assert_eq!(text(&output.stdout), "", "{arguments:?}");
        no_session(&folder);
    }
    let red = "mesh = \"holder.stl\"\nbrdf = { mixture = [ { weight = [1.0, 0.5, 0.5], lambertian = { albedo = 0.5 } }, \
        { weight = [0.0, 0.5, 0.5], black = {} } ] }";
    let coloured = workplace(|text| with_body(&text, red));
    let capture = ["capture", "--lights", "1"];
    assert_refused(&run(&coloured, &capture), "holder.stl");
    let made = [
        "shape",
        "tetrahedron",
        "--radius",
        "3",
        "--depth",
        "2",
        "--out",
        "holder.stl",
    ];
    assert!(run(&coloured, &made).status.success());
    assert_refused(&run(&coloured, &capture), "geometry.body[0] is coloured");
    no_session(&coloured);
    let crowded =
        workplace(|text| text.replace("disk_reserve_mb = 200", "disk_reserve_mb = 1000000"));
    let free = rig::session::commit::free_bytes(crowded.path()).unwrap();
    if free < 1_000_000 << 20 {
        assert_refused(&run(&crowded, &["capture", "--lights", "1"]), "bytes free");
    }
}

/// The pit of a tetrahedron as an OBJ file, each corner moved, its facets seen from above or,
/// inside out, from below.
fn pit(corner: impl Fn([f64; 3]) -> [f64; 3], inside_out: bool) -> String {
    let corners = [
        [10.0, 0.0, 0.0],
        [-5.0, 8.66, 0.0],
        [-5.0, -8.66, 0.0],
        [0.0, 0.0, -5.0],
    ];
    let mut obj = String::new();
    for [x, y, z] in corners.map(corner) {
        obj += &format!("v {x} {y} {z}\n");
    }
    for [a, b] in [[1, 2], [2, 3], [3, 1]] {
        let [a, b] = if inside_out { [b, a] } else { [a, b] };
        obj += &format!("f {a} {b} 4\n");
    }
    obj
}

/// What no capture can come of is refused by the doctor, by a dry run and by a capture, before
/// anything moves, with the sample's place and a remedy that is this case's.
#[test]
fn scenes_that_make_no_sense_are_refused_before_anything_moves() {
    let upright = |c: [f64; 3]| c;
    let scaled = |by: f64| move |c: [f64; 3]| c.map(|x| by * x);
    let out = "the sample is outside the camera's view: ";
    let back = "the sample's surface faces away from the camera: 0.0%";
    let small = "the sample is too small in the image: it covers 0.0 pixels";
    let dark = "reaches 0.0% of what the camera sees of the sample: 100% is turned away from it";
    let cases = [
        (
            "aside",
            pit(|[x, y, z]| [x + 30.0, y, z], false),
            out,
            "look_at_mm",
        ),
        (
            "nearly aside",
            pit(|[x, y, z]| [x, y + 18.0, z], false),
            out,
            "look_at_mm",
        ),
        (
            "behind the camera",
            pit(|[x, y, z]| [x, y, z + 300.0], false),
            out,
            "position_mm",
        ),
        (
            "micrometres",
            pit(scaled(1000.0), false),
            out,
            "mesh_unit = \"um\" in [geometry.sample]",
        ),
        (
            "metres",
            pit(scaled(0.001), false),
            small,
            "mesh_unit = \"m\" in [geometry.sample]",
        ),
        (
            "a grain",
            pit(scaled(0.1), false),
            "it covers 1",
            "the field of view of [geometry.camera]",
        ),
        (
            "upside down",
            pit(|[x, y, z]| [x, -y, -z], false),
            back,
            "upside down, which mesh_to_sample mends",
        ),
        (
            "inside out",
            pit(upright, true),
            back,
            "inside out, which flip_facets = true mends",
        ),
        (
            "lit from below",
            pit(|[x, y, z]| [x, y, 0.5 * z], false),
            dark,
            "[geometry.sample_from_stage]",
        ),
    ];
    for (name, mesh, fact, remedy) in cases {
        let folder = workplace(|text| {
            let (before, rest) = text.split_once("[geometry.sample.shape]").unwrap();
            let (_, after) = rest.split_once("[geometry.sample_from_stage]").unwrap();
            let before = before.replace("# mesh = \"bowl.ply\"", "mesh = \"pit.obj\"");
            let before = before.replace("shading = \"smooth\"", "shading = \"flat\"");
            let from_below = match name {
                "lit from below" => {
                    after.replacen("rotation_deg = [0.0,", "rotation_deg = [180.0,", 1)
                }
                _ => after.to_owned(),
            };
            format!("{before}[geometry.sample_from_stage]{from_below}")
        });
        std::fs::write(folder.path().join("pit.obj"), mesh).unwrap();
        let doctor = run(&folder, &["doctor"]);
        let said = text(&doctor.stdout);
        assert_eq!(doctor.status.code(), Some(1), "{name}: {said}");
        let view = said
            .lines()
            .find(|line| line.starts_with("FAILED   view"))
            .expect(said);
        let fact_there = match fact == dark {
            true => "none of 16 lights spread over the stage's reach",
            false => fact,
        };
        assert!(
            view.contains(fact_there) && said.contains(remedy),
            "{name}: {said}"
        );
        for command in [
            &["capture", "--lights", "2", "--dry-run"][..],
            &["capture", "--lights", "2"],
        ] {
            let output = run(&folder, command);
            assert_refused(&output, fact);
            let said = text(&output.stderr);
            assert!(said.contains(remedy), "{name}: {said}");
            assert!(
                fact == dark || said.contains("the field of view is 22.0 × 22.0 mm"),
                "{name}: {said}"
            );
            assert_eq!(text(&output.stdout), "", "{name}");
            no_session(&folder);
        }
    }
}

/// Shipped rig files describe benches that can exist: sample, lights and depth of field are
/// as they should be, and plans have lights within reach, each once, past the camera's body.
#[test]
fn shipped_benches_are_sound_and_plan_lights_that_nothing_blocks() {
    let folder = tempfile::tempdir().unwrap();
    for (name, file) in rig::config::BUILT_IN {
        let config = RigConfig::parse(name, Path::new(""), file).unwrap();
        assert_eq!(config.geometry.camera_body.is_none(), config.is_simulated());
        let doctor = run(&folder, &["doctor", "--rig", name, "--json"]);
        let found: serde_json::Value = serde_json::from_slice(&doctor.stdout).unwrap();
        for check in ["view", "light paths", "depth of field"] {
            let checks = found["checks"].as_array().unwrap();
            let check = checks.iter().find(|c| c["name"] == check).unwrap();
            assert_eq!(check["verdict"], "ok", "{name}: {check}");
        }
        let reach = StageReach::of_rig(&config).unwrap();
        let mut longest = Vec::new();
        for count in ["8", "4", "1"] {
            let words = [
                "capture",
                "--rig",
                name,
                "--lights",
                count,
                "--dry-run",
                "--json",
            ];
            let output = run(&folder, &words);
            let plan: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
            let lights: Vec<StageAngles> = serde_json::from_value(plan["lights"].clone()).unwrap();
            assert_eq!(lights.len().to_string(), count, "{name}");
            reach.check(&lights).unwrap();
            for (number, light) in lights.iter().enumerate() {
                assert!(!lights[..number].contains(light), "{name}: {light} twice");
            }
            if longest.is_empty() {
                longest.clone_from(&lights);
            }
            assert_eq!(lights, longest[..lights.len()], "{name}");
        }
        let elevations = longest.iter().map(|light| light.elevation_deg);
        let [low, high] = [f64::min, f64::max].map(|of| elevations.clone().reduce(of).unwrap());
        assert!(
            (25.0..=90.0).contains(&low) && high - low > 15.0,
            "{name}: {low} to {high}"
        );
    }
}

/// A light from which the camera's body, or the lamp itself, hides the sample is named with
/// what is in the way and the nearest direction that is free.
#[test]
fn a_light_that_the_camera_blocks_is_refused() {
    let with_body = |body: &'static str| {
        move |text: String| {
            let key = "point_spread_px = 0.0";
            assert!(text.contains(key));
            text.replacen(key, &format!("{key}\nbody = {{ {body} }}"), 1)
        }
    };
    let telescope = "radius_mm = 30.0, length_mm = 100.0";
    // (30 + 10) mm aside at 200 mm: 11.3° from the axis. A front 50 mm farther down: 14.9°.
    // A lamp of 2° radius: 2° more.
    let lower = "radius_mm = 30.0, length_mm = 100.0, front_mm = 50.0";
    type Change = Box<dyn Fn(String) -> String>;
    let cases: [(&str, Change, &str, &str, &str); 5] = [
        (
            "coaxial",
            Box::new(with_body(telescope)),
            "10,90",
            "the camera's body keeps the light from 100% of the sample in view",
            "the nearest free direction is azimuth 10.000°, elevation 78.5°",
        ),
        (
            "at the edge",
            Box::new(with_body(telescope)),
            "-20,79",
            "the camera's body keeps the light from",
            "the nearest free direction is azimuth -20.000°, elevation 78.5°",
        ),
        (
            "a lower front",
            Box::new(with_body(lower)),
            "0,76",
            "the camera's body keeps the light from",
            "the nearest free direction is azimuth 0.000°, elevation 75.0°",
        ),
        (
            "a wide lamp",
            Box::new(move |text: String| {
                let text = with_body(telescope)(text);
                let key = "angular_radius_deg = ";
                let (before, rest) = text.split_once(&format!("\n{key}")).unwrap();
                let (_, after) = rest.split_once('\n').unwrap();
                format!("{before}\n{key}2.0\n{after}")
            }),
            "0,78.5",
            "the camera's body keeps the light from",
            "the nearest free direction is azimuth 0.000°, elevation 76.5°",
        ),
        (
            "a lamp in front of the lens",
            Box::new(move |text: String| {
                let text = with_body(telescope)(text);
                text.replacen(
                    "[geometry.light]",
                    "[geometry.light]\ndistance_mm = 100.0",
                    1,
                )
                .replacen(
                    "\nangular_radius_deg = ",
                    "\n# angular_radius_deg = ",
                    1,
                )
            }),
            "0,88",
            "the lamp stands in front of the camera, in its view",
            "the nearest free direction is azimuth 0.000°, elevation 83.5°",
        ),
    ];
    for (name, change, light, fact, free) in cases {
        let folder = workplace(change);
        let words = ["capture", "--light", "0,50", "--light", light, "--dry-run"];
        let output = run(&folder, &words);
        assert_refused(&output, fact);
        let said = text(&output.stderr);
        assert!(said.contains("light 1 (azimuth"), "{name}: {said}");
        let free = free.trim_end_matches('°');
        assert!(
            said.contains(free) && said.contains("--lights N"),
            "{name}: {said}"
        );
        let plan = run(&folder, &["capture", "--lights", "12", "--dry-run"]);
        assert_eq!(
            plan.status.code(),
            Some(0),
            "{name}: {}",
            text(&plan.stderr)
        );
        let doctor = run(&folder, &["doctor"]);
        let said = text(&doctor.stdout);
        assert!(said.contains("plans leave them out"), "{name}: {said}");
    }
}

/// A sample that is partly in view is a remark; one that is wholly in view is none.
#[test]
fn a_sample_partly_in_view_is_remarked() {
    let dry = ["capture", "--lights", "2", "--dry-run"];
    let whole = run(&workplace(|text| text), &dry);
    assert_eq!(text(&whole.stderr), "");
    let folder = workplace(|text| {
        text.replace("look_at_mm = [0.0,", "look_at_mm = [6.0,")
            .replace("position_mm = [0.0,", "position_mm = [6.0,")
    });
    let cut = run(&folder, &dry);
    assert_eq!(cut.status.code(), Some(0));
    let said = text(&cut.stderr);
    assert!(
        said.contains("warning: the sample is only partly in view: 8"),
        "{said}"
    );
}

/// A plan needs no calibration; what it then estimates is marked.
#[test]
fn a_dry_run_without_records_marks_its_estimates() {
    let folder = workplace(|text| text.replace("name = \"simulated\"", "name = \"new-bench\""));
    let dry = ["capture", "--lights", "2", "--dry-run"];
    let output = run(&folder, &dry);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let mark = "estimated for a usual sensor, no sensor record: run `rig calibrate sensor`";
    assert!(
        text(&output.stdout).contains(mark),
        "{}",
        text(&output.stdout)
    );
    let output = run(&folder, &[&dry[..], &["--json"]].concat());
    let plan: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(plan["estimated"], mark);
    assert!(plan["sensor_record"].is_null());
    assert!(plan["estimated_s"].as_f64().unwrap() > 1.0);
    assert_refused(
        &run(&folder, &["capture", "--lights", "2"]),
        "there is no sensor record",
    );
    no_session(&folder);
    let known = run(&workplace(|text| text), &[&dry[..], &["--json"]].concat());
    let plan: serde_json::Value = serde_json::from_slice(&known.stdout).unwrap();
    assert_eq!(plan["sensor_record"], "20261121T020000Z-sensor");
    assert!(plan.get("estimated").is_none());
}

/// The simulated bench's stage with other mechanics.
fn with_mechanism(text: &str, mechanism: &str) -> String {
    let (before, rest) = text.split_once("[stage.azimuth]").unwrap();
    let (_, after) = rest.split_once("[[stage.lamp]]").unwrap();
    let before = before.replace("approach_deg = 2.0\n", "");
    let (keys, axes) = mechanism.split_once("[stage").unwrap();
    let before = before.replace("lamp_off = ", &format!("{keys}\nlamp_off = "));
    format!("{before}[stage{axes}\n[[stage.lamp]]{after}")
}

const ARC: &str = r#"mechanism = "arc"
radius_mm = 300.0
centre_height_mm = -40.0
[stage.azimuth]
axis = "X"
offset_deg = -180.0
min_deg = -180.0
max_deg = 180.0
[stage.elevation]
axis = "Y"
min_deg = 40.0
max_deg = 90.0"#;

const GANTRY: &str = r#"mechanism = "gantry"
height_mm = 350.0
approach_mm = 2.0
[stage.x]
axis = "X"
offset_mm = -300.0
min_mm = -300.0
max_mm = 300.0
[stage.y]
axis = "Y"
offset_mm = -300.0
min_mm = -300.0
max_mm = 300.0"#;

#[test]
fn a_capture_on_an_arc_with_turntable_and_on_a_gantry() {
    for mechanism in [ARC, GANTRY] {
        let folder = workplace(|text| with_mechanism(&text, mechanism));
        let lights = [
            "capture", "--light", "20,80", "--light", "-130,60", "--no-fit",
        ];
        let output = run(&folder, &lights);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        let session = Session::open(&session_of(&folder, &output)).unwrap();
        assert_eq!(session.state(), SessionState::Complete);
        for entry in session.frames() {
            let (_, sidecar) = session.read_frame(&entry).unwrap();
            let (is, target) = (sidecar.stage_position, sidecar.stage_target);
            let off = is.to_light().angle_between(target.to_light());
            assert!(off.to_degrees() < 0.05, "{is} for {target}");
        }
        let beyond = run(&folder, &["capture", "--light", "0,20", "--no-fit"]);
        assert_refused(&beyond, "outside the stage's limits");
    }
}

/// Every number as `N`, so that a text shows its words.
fn without_numbers(text: &str) -> String {
    let mut shown = String::new();
    let mut chars = text.chars().peekable();
    while let Some(c) = chars.next() {
        if !c.is_ascii_digit() {
            shown.push(c);
            continue;
        }
        while chars.next_if(|c| c.is_ascii_digit() || *c == '.').is_some() {}
        shown.push('N');
    }
    shown
}

/// A colour camera under a white lamp from its calibration to the report: with
/// `RIG_CAMERA=full` the five megapixels of the rig file, else an eighth of them along each side.
#[test]
fn a_bayer_camera_is_calibrated_captured_fitted_and_reported() {
    let full = std::env::var("RIG_CAMERA").is_ok_and(|which| which == "full");
    let mut bench = include_str!("../rig-configs/simulated-5mp-bayer.toml").to_owned();
    // A pixel of the image for each cell of four filters.
    let mut size = [1296, 972];
    if !full {
        size = [162, 122];
        let changes = [
            ("[2592, 1944]", "[324, 244]"),
            ("samples_per_pixel = 384", "samples_per_pixel = 32"),
        ];
        for (key, small) in changes {
            assert!(bench.contains(key), "{key}");
            bench = bench.replacen(key, small, 1);
        }
    }
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("rig.toml"), bench).unwrap();
    for what in [
        "calibrate sensor --frames 4",
        "calibrate flat --frames 4 --radiance 0.4 --radiance-std 0.001",
        "capture --lights 2",
    ] {
        let begun = std::time::Instant::now();
        let words: Vec<&str> = what.split(' ').collect();
        let done = run(&folder, &words);
        assert!(done.status.success(), "{what}: {}", text(&done.stderr));
        println!("{what}: {:.1} s", begun.elapsed().as_secs_f64());
    }
    let sessions = std::fs::read_dir(folder.path().join("sessions")).unwrap();
    let root = sessions.flatten().next().unwrap().path();
    assert!(verify::verify(&root).unwrap().is_intact());
    let image = exr::read(&root.join(layout::radiance_file(1)))
        .unwrap()
        .image;
    assert_eq!([image.width, image.height], size);
    let record = fit_record::read(&root.join("fits/0")).unwrap();
    assert_ne!(record.verdict(), fit_record::Verdict::NotToBeTrusted);
    assert!(root.join("report.html").is_file());
}

/// A new user's first run, as `make demo` makes it: no warning, the best verdict, and these
/// words alone.
#[test]
fn the_first_run_is_clean() {
    let home = tempfile::tempdir().unwrap();
    let done = rig(&home, &["demo"]).output().unwrap();
    let stderr = String::from_utf8(done.stderr).unwrap();
    assert!(done.status.success(), "{stderr}");
    let root = PathBuf::from(String::from_utf8(done.stdout).unwrap().trim_end());
    let name = root.file_name().unwrap().to_str().unwrap();
    let words = without_numbers(&stderr.replace(name, "SESSION"));
    insta::assert_snapshot!(words, @r"
    captured in N s
    N times the devices' N s (camera N s, stage N s, settling N s), N times exposures (N s), motion and settling alone
    the material departs from every mixture of rigN, N times as much as measured materials usually do; its f in table.csv and in exports to merl, rgl and pbrt allows for it, weights and an export to mitsuba are the closest mixture
    verdict: The fit explains the images
    fit: sessions/SESSION/fits/N
    report: sessions/SESSION/report.html
    ");
    let fits = home.path().join(&root).join("fits/0");
    let record = fit_record::read(&fits).unwrap();
    assert_eq!(record.verdict(), fit_record::Verdict::Explains);
    assert_eq!(record.warnings, []);
    let report = std::fs::read_to_string(home.path().join(root).join("report.html")).unwrap();
    assert!(report.contains("✓</span> The fit explains the images</h2>"));
}
