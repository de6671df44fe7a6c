//! What holds of every rig file that is made of answers.

use std::path::Path;

use proptest::prelude::*;

use super::question::Kind;
use super::*;
use crate::config::camera::offered;
use crate::config::lab::LabConfig;
use crate::config::stage::StageDriver;
use crate::config::view::SurfaceSpec;
use crate::config::{CameraDriver, Origin, ResolvedRig};
use crate::device::Mosaic;
use crate::geometry::Shape;
use crate::transport::Projection;

const FILE: &str = "bench.toml";

/// The cameras and stages that are tried together: `camera`, its address, its driver's name.
const CAMERAS: [(&str, Option<&str>); 5] = [
    ("v4l /dev/v4l/by-id/usb-Mono_C4711-video-index0", None),
    ("v4l", Some("/dev/video0")),
    ("gphoto2 port=usb:001,005", None),
    ("command", Some("./photo.sh {exposure_s} {output}")),
    ("folder", Some("incoming \"frames\"")),
];
const STAGES: [(&str, &str); 6] = [
    ("grbl", "rotary"),
    ("grbl", "arc"),
    ("grbl", "gantry"),
    ("zaber", "gantry"),
    ("dmx", ""),
    ("manual", ""),
];

fn answers(pairs: &[(&str, &str)]) -> Answers {
    let mut answers = Answers::default();
    for (key, value) in pairs {
        answers.set(key, (*value).into());
    }
    answers
}

fn bench((camera, address): (&str, Option<&str>), (stage, mechanism): (&str, &str)) -> Answers {
    let mut answers = answers(&[("camera", camera), ("stage", stage)]);
    if let Some(address) = address {
        answers.set("camera_address", address.into());
    }
    if !mechanism.is_empty() {
        answers.set("mechanism", mechanism.into());
    }
    if stage != "manual" {
        answers.set("port", "/dev/ttyUSB0".into());
    }
    if stage == "zaber" {
        answers.set("first_scale", Answer::Number(2016.0));
        answers.set("second_scale", "-2016".into());
    }
    answers
}

fn made(answers: &Answers) -> Result<Written, DraftError> {
    let found = Found::default();
    write(&questions(&found), &found, answers, Path::new(FILE))
}

/// Every stage with every camera: the file is one that the reader takes, and says what was
/// answered.
#[test]
fn every_stage_with_every_camera_gives_a_rig_file() {
    for camera in CAMERAS {
        for stage in STAGES {
            let written = made(&bench(camera, stage))
                .unwrap_or_else(|error| panic!("{camera:?} {stage:?}: {error}"));
            let rig = &written.rig;
            assert_eq!(rig.text, written.text);
            assert_eq!(rig.stage.driver_name(), stage.0, "{camera:?}");
            let driver = camera.0.split(' ').next().unwrap();
            let (name, address) = match &rig.camera.driver {
                CameraDriver::V4l { device, .. } => ("v4l", device.clone()),
                CameraDriver::Described { driver, setting } => {
                    (driver.name, setting.to_string_lossy().into_owned())
                }
                CameraDriver::Simulated => panic!("simulated"),
            };
            assert_eq!(name, driver);
            let wanted = camera
                .1
                .or(camera.0.split_once(' ').map(|(_, address)| address));
            assert_eq!(address, wanted.unwrap(), "{stage:?}");
            assert_eq!(rig.camera.resolution_px, [1920, 1200]);
            // A lamp whose distance the mechanism states is as far away as was answered.
            assert_eq!(rig.geometry.light.distance_mm, Some(400.0), "{stage:?}");
            assert_eq!(rig.stage.measures.len(), 3);
            assert!(rig.fit.refine_bench == Some(true) && rig.uncertainty.common_intensity == 1.0);
            let lines = written.text.lines().count();
            assert!(lines > 80, "{lines} lines:\n{}", written.text);
        }
    }
}

/// Sessions of every driver can be read, whether or not this build can open its cameras; those
/// for practice alone are marked wherever they are offered, and have 8 bits.
#[test]
fn drivers_are_known_without_their_features_and_marked_where_they_only_practise() {
    let text = made(&bench(CAMERAS[0], STAGES[0])).unwrap().text;
    for name in ["genicam", "webcam"] {
        let text = text.replace("\"v4l\"", &format!("{name:?}"));
        let address = text.replace("/dev/v4l/by-id/usb-Mono_C4711-video-index0", "C4711");
        let rig = RigConfig::parse(FILE, Path::new(""), &address);
        assert!(rig.is_ok(), "{name}: {:?}", rig.err());
        if !offered().any(|driver| driver.name == name && driver.only_practice) {
            continue;
        }
        let mut answers = bench((name, Some("/dev/video0")), STAGES[0]);
        let error = made(&answers).unwrap_err().to_string();
        assert!(
            error.contains("bit_depth") && error.contains("8 with a webcam"),
            "{error}"
        );
        answers.set("bit_depth", Answer::Number(8.0));
        let text = made(&answers).unwrap().text;
        assert!(text.contains("8 bits, not for measurement"), "{text}");
    }
}

/// A key without a comment says nothing to the person who opens the file.
#[test]
fn every_table_and_key_is_explained() {
    for stage in STAGES {
        let text = made(&bench(CAMERAS[0], stage)).unwrap().text;
        let mut explained = false;
        for line in text.lines() {
            match line {
                "" => {}
                _ if line.starts_with("# ") => explained = true,
                // Of repeated tables the first is explained.
                _ if line.starts_with("[[") => explained = true,
                _ if line.starts_with('[') => explained = false,
                _ if line.starts_with("kind") || line.starts_with("radius_mm") => explained = true,
                _ => assert!(explained, "{line} in:\n{text}"),
            }
        }
    }
}

/// What is commented out in a capture's table is what holds without it.
#[test]
fn commented_choices_of_a_capture_are_the_defaults() {
    let written = made(&bench(CAMERAS[0], STAGES[0])).unwrap();
    let (before, rest) = written.text.split_once("\n[capture]\n").unwrap();
    let (capture, after) = rest.split_once("\n[").unwrap();
    let is_key = |line: &str| {
        line.split_once(" = ")
            .is_some_and(|(key, _)| !key.contains(' '))
    };
    let stated = capture.lines().map(|line| match line.strip_prefix("# ") {
        Some(key) if is_key(key) => key,
        _ => line,
    });
    let stated: Vec<&str> = stated.collect();
    let text = format!("{before}\n[capture]\n{}\n[{after}", stated.join("\n"));
    assert_ne!(text, written.text);
    let rig = RigConfig::parse(FILE, Path::new(""), &text).unwrap();
    assert_eq!(rig.capture, written.rig.capture);
}

#[test]
fn who_measures_and_in_what_room_is_asked_for_where_it_will_be_stated() {
    let mut bench = bench(CAMERAS[0], STAGES[0]);
    assert_eq!(made(&bench).unwrap().rig.lab, LabConfig::default());
    bench.set("lab", "yes".into());
    assert!(made(&bench).is_err());
    for (key, value) in [
        ("organisation", "Institute of Optics"),
        ("laboratory", "D-K-1"),
        ("operator", "A. Miller"),
        ("contact", "B. Jones"),
        ("city", "Espoo"),
        ("room_temperature_c", "22.5"),
        ("room_humidity_percent", "45"),
    ] {
        bench.set(key, value.into());
    }
    let lab = made(&bench).unwrap().rig.lab;
    assert_eq!(lab.contact.as_deref(), Some("B. Jones"));
    let room = [lab.room_temperature_c, lab.room_humidity_percent];
    assert_eq!(room, [Some(22.5), Some(45.0)]);
    // Nothing that a certificate names is left unasked.
    assert_eq!(lab.not_stated(), [""; 0]);
}

#[test]
fn lens_sample_and_lamp_are_as_answered() {
    let mut bench = bench(CAMERAS[0], ("manual", ""));
    for (key, value) in [
        ("lens", "focal-length"),
        ("focal_mm", "50"),
        ("pixel_um", "5"),
        ("f_number", "8"),
        ("camera_distance_mm", "550"),
        ("width_px", "1000"),
        ("height_px", "500"),
        ("mosaic", "rggb"),
        ("sample_shape", "tetrahedron"),
        ("sample_radius_mm", "12"),
        ("sample_depth_mm", "8.5"),
        ("lights", "0,40;90, 45.5"),
        ("lamp", "white"),
        ("housing", "no"),
        ("lamp_distance_mm", "321.5"),
        ("warm_up_s", "0"),
    ] {
        bench.set(key, value.into());
    }
    let rig = made(&bench).unwrap().rig;
    let Projection::Perspective { fov_rad } = rig.geometry.camera.projection else {
        panic!("{:?}", rig.geometry.camera.projection);
    };
    // The image of a thin lens at 550 mm stands 55 mm behind it: 5 mm of sensor see 50 mm.
    let expected = 2.0 * (25.0f64 / 550.0).atan();
    assert!((fov_rad - expected).abs() < 1e-6, "{fov_rad} {expected}");
    // A pupil of 6.25 mm diameter.
    let na = (3.125f64 / 550.0).atan().sin();
    assert!((rig.geometry.camera.object_na - na).abs() < 1e-6);
    assert_eq!(rig.camera.mosaic, Mosaic::Rggb);
    assert_eq!(rig.geometry.camera_body, None);
    assert!(matches!(
        rig.geometry.sample.surface,
        SurfaceSpec::Shape(Shape::Tetrahedron {
            radius_mm: 12.0,
            depth_mm: 8.5
        })
    ));
    let StageDriver::Manual(manual) = &rig.stage.driver else {
        panic!("not manual");
    };
    assert_eq!((manual.channels, manual.lights.directions.len()), (1, 2));
    assert_eq!(manual.lights.directions[1].elevation_deg, 45.5);
    assert_eq!(rig.geometry.light.distance_mm, Some(321.5));
    assert_eq!(rig.capture.lamp_warm_up.0, 0.0);
}

/// A camera 60° from the axis of a cap, away from azimuth 0: lamps there are 120° from it
/// at the horizon.
#[test]
fn a_tilted_camera_and_its_samples_are_as_answered() {
    let mut bench = bench(CAMERAS[0], STAGES[0]);
    for (key, value) in [("camera_tilt_deg", "60"), ("sample_shape", "cap")] {
        bench.set(key, value.into());
    }
    let rig = made(&bench).unwrap().rig;
    let coaxial = rig.geometry.coaxial();
    let expected = glam::DVec3::new(-(3f64.sqrt()), 0.0, 1.0) / 2.0;
    assert!((coaxial - expected).length() < 1e-4, "{coaxial}");
    let SurfaceSpec::Shape(Shape::Cap { opening_deg, .. }) = rig.geometry.sample.surface else {
        panic!("{:?}", rig.geometry.sample.surface);
    };
    assert_eq!(opening_deg, 60.0);
    bench.set("sample_shape", "ridge".into());
    let ridge = made(&bench).unwrap().rig.geometry.sample.surface;
    assert!(matches!(ridge, SurfaceSpec::Shape(Shape::Ridge { .. })));
}

/// The serial number of a camera that is connected stands in the file.
#[test]
fn a_camera_that_is_connected_is_the_default() {
    let choice = |value: &str| Choice {
        value: value.to_owned(),
        label: String::new(),
    };
    let found = Found {
        cameras: vec![found::FoundChoice {
            choice: choice("v4l /dev/v4l/by-id/usb-Mono"),
            serial: "C \"4711\"".to_owned(),
        }],
        ports: vec![choice("/dev/serial/by-id/usb-Arduino")],
    };
    let written = write(
        &questions(&found),
        &found,
        &Answers::default(),
        Path::new(FILE),
    )
    .unwrap();
    assert_eq!(written.rig.camera.serial.as_deref(), Some("C \"4711\""));
    assert_eq!(
        written.rig.stage.port(),
        Some("/dev/serial/by-id/usb-Arduino")
    );
}

#[test]
fn bad_answers_are_named_with_value_and_range() {
    // Answers, and what is said of them.
    const CASES: &str = r#"
name = My Bench | `name` is My Bench, but must be 1 to 40 of a-z, 0-9 and -
width_px = 12.5 | `width_px` is 12.5, but must be a whole number from 16 to 16384 (pixels)
width_px = wide | `width_px` is wide, but must be a whole number
warm_up_s = -1 | `warm_up_s` is -1, but must be a number from 0 to 7200 (s)
housing = maybe | `housing` is maybe, but must be yes or no
mosaic = xtrans | `mosaic` is xtrans, but must be one of none, rggb
camera = nikon D850 | `camera` is nikon D850, but must be v4l,
colour = red | there is no question `colour`; known: name, camera
camera = command; camera_address = photo | `camera.command` is "photo", but must be a program
port = COM3 | `port` is COM3, but must be the path of a serial port
azimuth_max_deg = -175 | `azimuth_max_deg` is -175, but must be at least `azimuth_min_deg` (-170)
sample_radius_mm = 12 | `sample_radius_mm` is 12, but must be such that the sample (12 mm from its middle) is within 11.25 mm
sample_shape = groove; groove_width_mm = 30 | `groove_width_mm` is 30, but must be less than twice the radius (9 mm)
mosaic = rggb; height_px = 1201 | `mosaic` is rggb, but must be none, because 1920 and 1201
grbl_red_on = M3! | `grbl_red_on` is M3!, but must be controller commands
stage = zaber | the answer `first_scale` is missing
stage = zaber; first_scale = 0; second_scale = 1 | `first_scale` is 0, but must be away from 0
stage = manual; lights = 30 | `lights` is 30, but must be directions
stage = dmx; dmx_first = 490 | `dmx_first` is 490, but must be at most 483
lens = focal-length; focal_mm = 200 | `camera_distance_mm` is 200, but must be above the focal length
"#;
    for case in CASES.trim().lines() {
        let (changes, expected) = case.split_once(" | ").unwrap();
        let mut bench = bench(CAMERAS[0], ("grbl", "rotary"));
        bench.set("sample_radius_mm", Answer::Number(9.0));
        for change in changes.split("; ") {
            let (key, value) = change.split_once(" = ").unwrap();
            bench.set(key, value.into());
        }
        let error = made(&bench).unwrap_err().to_string();
        assert!(error.contains(expected), "{changes:?}: {error}");
    }
}

/// A relation is checked as soon as its answers are there.
#[test]
fn a_broken_relation_is_named_at_once() {
    let questions = questions(&Found::default());
    let mut so_far = answers(&[
        ("stage", "grbl"),
        ("mechanism", "rotary"),
        ("azimuth_min_deg", "10"),
    ]);
    assert_eq!(check_so_far(&questions, &so_far), Ok(()));
    so_far.set("azimuth_max_deg", Answer::Number(5.0));
    let error = check_so_far(&questions, &so_far).unwrap_err();
    assert_eq!(error.key(), "azimuth_max_deg");
}

#[test]
fn the_steps_are_in_order_and_name_the_file() {
    let found = Found::default();
    let answers = bench(CAMERAS[0], ("grbl", "rotary"));
    let steps = |file: &str| {
        write(&questions(&found), &found, &answers, Path::new(file))
            .unwrap()
            .next
    };
    let order = |what: &str| {
        let steps = steps("rig.toml");
        steps
            .iter()
            .position(|step| step.command.contains(what))
            .unwrap_or_else(|| panic!("{what}"))
    };
    let wanted = [
        "doctor",
        "stage home",
        "calibrate sensor",
        "calibrate flat",
        "calibrate lamp",
        "calibrate camera",
        "calibrate lights",
        "calibrate white",
        "--dry-run",
    ];
    assert!(
        wanted
            .windows(2)
            .all(|pair| order(pair[0]) < order(pair[1]))
    );
    assert!(
        steps("rig.toml")
            .iter()
            .all(|step| !step.command.contains("--rig"))
    );
    assert!(
        steps("my bench.toml")
            .iter()
            .all(|step| step.command.ends_with("--rig 'my bench.toml'"))
    );
    let by_hand = bench(CAMERAS[0], ("manual", ""));
    let by_hand = write(&questions(&found), &found, &by_hand, Path::new(FILE)).unwrap();
    assert!(
        by_hand
            .next
            .iter()
            .all(|step| !step.command.contains("stage home"))
    );
}

/// A question's condition names an earlier one, so that a list can be gone through in order.
#[test]
fn conditions_name_earlier_questions() {
    let questions = questions(&Found::default());
    for (i, question) in questions.iter().enumerate() {
        assert!(
            questions[..i].iter().all(|other| other.key != question.key),
            "{}",
            question.key
        );
        assert!(
            !question.title.is_empty() && !question.help.is_empty(),
            "{}",
            question.key
        );
        if let Some(when) = &question.when {
            let other = questions[..i].iter().find(|other| other.key == when.key);
            let other = other.unwrap_or_else(|| panic!("{}", question.key));
            for value in &when.is {
                assert_eq!(other.checked(value).as_ref(), Ok(value), "{}", question.key);
            }
        }
        if let Some(default) = &question.default {
            assert_eq!(
                question.checked(default).as_ref(),
                Ok(default),
                "{}",
                question.key
            );
        }
    }
}

/// An answer within the range of each question that is asked.
fn any_answers() -> impl Strategy<Value = Answers> {
    let questions = questions(&Found::default());
    let each: Vec<_> = questions
        .iter()
        .map(|question| {
            let default = question.default.clone();
            let answer = match question.kind {
                Kind::Number => {
                    let (least, most) = (question.least.unwrap(), question.most.unwrap());
                    // Near the default as well, where relations mostly hold.
                    let typical = default.as_ref().and_then(Answer::number).unwrap_or(100.0);
                    let whole = question.whole;
                    let rounded = move |n: f64| Answer::Number(if whole { n.round() } else { n });
                    prop_oneof![
                        3 => (0.7f64..1.4).prop_map(move |part| rounded((typical * part).clamp(least, most))),
                        1 => (least..=most).prop_map(rounded),
                    ]
                    .boxed()
                }
                Kind::Choice if !question.choices.is_empty() => {
                    let values: Vec<_> = question.choices.iter().map(|choice| choice.value.clone()).collect();
                    prop::sample::select(values).prop_map(Answer::Text).boxed()
                }
                Kind::YesNo => any::<bool>().prop_map(Answer::Flag).boxed(),
                _ => {
                    let text = match question.key {
                        "camera_address" => "port = any; f-number = f/8",
                        "port" => "/dev/ttyUSB0",
                        "sample_mesh" => "bowl \"1\".ply",
                        _ => "",
                    };
                    Just(default.unwrap_or(text.into())).boxed()
                }
            };
            (Just(question.key), answer)
        })
        .collect();
    each.prop_map(|pairs| {
        let mut answers = Answers::default();
        for (key, answer) in pairs {
            answers.set(key, answer);
        }
        answers
    })
}

proptest! {
    /// Whatever is answered within the ranges, the file is read as it was meant, or the answer
    /// that stands against it is named; the reader of rig files is the last to refuse only an
    /// address that the camera's driver does not take.
    #[test]
    fn answers_in_range_make_a_rig_file(answers in any_answers()) {
        match made(&answers) {
            Ok(written) => {
                let again = RigConfig::parse(FILE, Path::new(""), &written.text).unwrap();
                prop_assert_eq!(&again, &written.rig);
                let complete = completion::complete(&questions(&Found::default()), &answers).unwrap();
                prop_assert_eq!(again.camera.resolution_px[0], complete.whole("width_px").unwrap());
                prop_assert_eq!(again.camera.bit_depth, complete.whole("bit_depth").unwrap());
                let distance = complete.number("lamp_distance_mm").unwrap();
                let read = again.geometry.light.distance_mm.unwrap();
                prop_assert!((read - distance).abs() < 1e-5, "{} {}", read, distance);
                let resolved = ResolvedRig { config: again, origin: Origin::Argument, file: FILE.into(), folder: None };
                prop_assert!(!resolved.config.is_simulated());
            }
            Err(DraftError::Answer(AnswerError::Invalid { key, .. })) => {
                prop_assert!(answers.get(key).is_some(), "{}", key);
            }
            Err(DraftError::Config(error)) => {
                prop_assert!(error.to_string().contains("`camera."), "{}", error);
            }
            Err(other) => return Err(TestCaseError::fail(other.to_string())),
        }
    }
}
