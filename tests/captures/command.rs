//! `rig capture` and `rig session` as a user runs them, on the simulated rig.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::command_support::{
    assert_refused, rig, run, session_of, shipped_workplace, text, with_body, words, workplace,
};
use rig::brdf::Dictionary;
use rig::cells::{Captured, CellOptions};
use rig::config::RigConfig;
use rig::inverse::{FitOptions, fit, intervals};
use rig::radiance_image::exr;
use rig::session::commit::SystemDisk;
use rig::session::{
    Event, NewSession, Session, SessionState, SessionWriter, fit_record, layout, verify,
};

/// A measured material, whose table takes its time, and one that does not.
const BUNDLED: &str = "material = \"nbrdf:dark-red-paint\"";
const QUICK: &str = "brdf = { mixture = [ { weight = 1.0, lambertian = { albedo = 0.8 } } ] }";

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
    let list = run(&folder, &["catalogue", "--json"]);
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
    let fit: toml::Table = toml::from_str(&text(&fit)).unwrap();
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
        &words("shape bowl --radius 10 --segments 24 --out meshes/bowl.ply"),
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
    assert!(moved.join("report.html").is_file());
}

/// The session of a bench whose lamp nobody measured, as no simulated one is: the record of its
/// fit says what the albedo rests on.
#[test]
fn a_scale_that_nobody_measured_is_remarked_on() {
    let folder = workplace(|text| text);
    let captured = run(&folder, &["capture", "--lights", "1", "--no-fit"]);
    assert!(captured.status.success(), "{}", text(&captured.stderr));
    let root = session_of(&folder, &captured);
    let fit = |root: &Path| {
        let fitted = run(&folder, &["fit", root.to_str().unwrap(), "--json"]);
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
    let fit = fit(&scene, &images, &dictionary, &options).unwrap();
    let untold =
        intervals::table(&fit.material, &[], &[halves[at_40_deg]], &[0.0], 90.0)[0].value[1];

    let errors = [known, untold].map(|f| f / (0.8 / std::f64::consts::PI) - 1.0);
    println!(
        "holder known: {:+.4}, not told: {:+.4}",
        errors[0], errors[1]
    );
    // Without, gloss and discrepancies have to explain the walls' light.
    assert!(errors[0].abs() < 0.02, "{errors:?}");
    assert!(errors[1].abs() > 0.04, "{errors:?}");
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
    let mut bench = include_str!("../../rig-configs/simulated-5mp-bayer.toml").to_owned();
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
    of this the devices took N s: camera N s (exposures N s), stage N s, settling N s
    verdict: The fit explains the images
    fit: sessions/SESSION/fits/N
    report: sessions/SESSION/report.html
    next: `rig validate sessions/SESSION` fits a part of the lights and predicts the rest, within a minute or two
    ");
    let fits = home.path().join(&root).join("fits/0");
    let record = fit_record::read(&fits).unwrap();
    assert_eq!(record.verdict(), fit_record::Verdict::Explains);
    assert_eq!(record.warnings, []);
    let report = std::fs::read_to_string(home.path().join(root).join("report.html")).unwrap();
    assert!(report.contains("✓</span> The fit explains the images</h2>"));
}
