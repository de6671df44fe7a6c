//! The questions, in the order in which they are asked.

use std::borrow::Cow;
use std::ops::RangeInclusive;

use super::answer::Answer;
use super::found::{Found, marked};
use super::question::{Choice, Kind, Question, TextRule, When};
use crate::config::camera::offered;
use crate::config::lab;

/// Stages with axes, with serial ports, and with fixed lights.
pub(super) const WITH_AXES: [&str; 2] = ["grbl", "zaber"];
const ON_A_PORT: [&str; 3] = ["grbl", "zaber", "dmx"];
const FIXED: [&str; 2] = ["dmx", "manual"];
const WITH_RADIUS: [&str; 6] = ["bowl", "ridge", "cap", "sphere", "tetrahedron", "groove"];

const NAME: TextRule = TextRule {
    allowed: "1 to 40 of a-z, 0-9 and -, because it names a folder",
    accepts: |text| {
        let allowed = |b: u8| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'-';
        (1..=40).contains(&text.len()) && text.bytes().all(allowed)
    },
};
const CAMERA: TextRule = TextRule {
    allowed: "a driver and the camera's address, such as `v4l /dev/video0`",
    accepts: |text| match text.split_once(' ') {
        Some((name, address)) => {
            offered().any(|driver| driver.name == name && (driver.accepts)(address.as_ref()))
        }
        None => false,
    },
};
const PORT: TextRule = TextRule {
    allowed: "the path of a serial port, such as /dev/serial/by-id/…",
    accepts: |text| text.starts_with('/'),
};
const GRBL_COMMANDS: TextRule = TextRule {
    allowed: "controller commands separated by `;`, printable ASCII without ? ! ~ $, at most 80 characters each",
    accepts: |text| {
        let valid = |command: &str| {
            (1..=80).contains(&command.len())
                && command
                    .bytes()
                    .all(|b| (b' '..=b'~').contains(&b) && !b"?!~$".contains(&b))
        };
        text.split(';').all(|command| valid(command.trim()))
    },
};
const ZABER_AXIS: TextRule = TextRule {
    allowed: "device/axis, numbers from 1 to 99 and from 1 to 9",
    accepts: is_zaber_place,
};
const ZABER_SWITCH: TextRule = TextRule {
    allowed: "`output device/number` or `lamp device/axis`",
    accepts: |text| match text.split_once(' ') {
        Some(("output" | "lamp", place)) => is_zaber_place(place),
        _ => false,
    },
};
const DIRECTIONS: TextRule = TextRule {
    allowed: "directions as `azimuth,elevation`, degrees from -360 to 360 and from -90 to 90, with `;` between",
    accepts: |text| directions(text).is_some(),
};

const LINE: TextRule = TextRule {
    allowed: lab::LINE,
    accepts: |text| lab::line(text).is_some(),
};

fn is_zaber_place(text: &str) -> bool {
    let within = |part: &str, most: u32| part.parse().is_ok_and(|n: u32| (1..=most).contains(&n));
    text.split_once('/')
        .is_some_and(|(device, axis)| within(device, 99) && within(axis, 9))
}

/// The directions that a text lists: azimuth and elevation, degrees; 1 to 512 of them.
pub(super) fn directions(text: &str) -> Option<Vec<[f64; 2]>> {
    let parts = text.split(';').filter(|part| !part.trim().is_empty());
    let directions: Option<Vec<[f64; 2]>> = parts
        .map(|part| {
            let (azimuth, elevation) = part.split_once(',')?;
            let azimuth: f64 = azimuth.trim().parse().ok()?;
            let elevation: f64 = elevation.trim().parse().ok()?;
            let valid = (-360.0..=360.0).contains(&azimuth) && (-90.0..=90.0).contains(&elevation);
            valid.then_some([azimuth, elevation])
        })
        .collect();
    directions.filter(|directions| (1..=512).contains(&directions.len()))
}

/// All questions, with what is connected as choices.
pub fn questions(found: &Found) -> Vec<Question> {
    let mut all = vec![
        text("name", "Name of the bench", NAME)
            .default("bench")
            .help("names the folder of its calibration records, calibration/NAME"),
    ];
    all.extend(of_the_camera(found));
    all.extend(of_the_lens());
    all.extend(of_the_sample());
    all.extend(of_the_stage(found));
    all.extend(of_the_axes());
    all.extend(of_the_lamp());
    all.extend(of_the_lab());
    all
}

fn of_the_camera(found: &Found) -> Vec<Question> {
    let mut cameras: Vec<Choice> = found
        .cameras
        .iter()
        .map(|found| found.choice.clone())
        .collect();
    // Those that are not connected now: then a text is asked for.
    cameras.extend(offered().map(|driver| Choice {
        value: driver.name.to_owned(),
        label: marked(driver.offer, driver.only_practice),
    }));
    let names: Vec<&str> = offered().map(|driver| driver.name).collect();
    let addresses = offered().map(|driver| format!("{}: {}", driver.name, driver.allowed));
    let addresses = addresses.collect::<Vec<_>>().join("; ");
    let mut camera =
        choice("camera", "Camera", cameras).help("as `rig devices` lists them; none is opened now");
    camera.others = true;
    camera.text = Some(CAMERA);
    camera.default = camera
        .choices
        .first()
        .map(|first| Answer::Text(first.value.clone()));
    vec![
        camera,
        any_text("camera_address", "Address of the camera")
            .help(addresses)
            .when("camera", &names),
        whole("width_px", "Width of a frame", "pixels", [16.0, 16384.0])
            .default(1920.0)
            .help("from the data sheet, or the region of interest that the camera is set to"),
        whole("height_px", "Height of a frame", "pixels", [16.0, 16384.0])
            .default(1200.0)
            .help("from the data sheet, or the region of interest that the camera is set to"),
        whole(
            "bit_depth",
            "Significant bits of a raw count",
            "bits",
            [8.0, 16.0],
        )
        .default(12.0)
        .help("machine-vision cameras have 10 or 12, still cameras mostly 14, webcams 8"),
        choice(
            "mosaic",
            "Colour filters over the sensor",
            listed(&[
                ("none", "none: a monochrome camera"),
                ("rggb", "red, green / green, blue"),
                ("grbg", "green, red / blue, green"),
                ("gbrg", "green, blue / red, green"),
                ("bggr", "blue, green / green, red"),
            ]),
        )
        .default("none")
        .help("a monochrome sensor under narrow-band lamps measures colour best"),
    ]
}

fn of_the_lens() -> Vec<Question> {
    vec![
        choice(
            "lens",
            "Lens",
            listed(&[
                ("telecentric", "telecentric: the magnification is the same at every distance"),
                ("focal-length", "ordinary, with a known focal length"),
                ("field-of-view", "ordinary, with a field of view that was measured with a ruler"),
            ]),
        )
        .default("telecentric")
        .help("how wide the image sees; `rig calibrate camera` measures it later"),
        number("field_width_mm", "Width of the field of view at the sample", "mm", [0.1, 5000.0])
            .default(36.0)
            .help("telecentric: width of the sensor over the magnification; else measured with a ruler in the sample's position")
            .when("lens", &["telecentric", "field-of-view"]),
        number("focal_mm", "Focal length", "mm", [1.0, 1000.0])
            .default(50.0)
            .help("printed on the lens")
            .when("lens", &["focal-length"]),
        number("pixel_um", "Pixel pitch of the sensor", "µm", [0.5, 50.0])
            .default(3.45)
            .help("from the camera's data sheet; the field of view follows from it")
            .when("lens", &["focal-length"]),
        number("f_number", "Aperture, f-number", "", [0.7, 64.0])
            .default(8.0)
            .help("the depth of field follows from it")
            .when("lens", &["focal-length"]),
        number("camera_distance_mm", "Distance from the lens to the sample", "mm", [10.0, 10000.0])
            .default(200.0)
            .help("telecentric: from its front; else from the entrance pupil, roughly the middle of the lens"),
        number("camera_tilt_deg", "Angle of the camera's axis from the sample's", "°", [0.0, 80.0])
            .default(0.0)
            .help("0 straight above, where a bowl is seen; 55 for a ridge, 60 for a cap, opposite azimuth 0"),
        yes_no("housing", "Do lens or camera stand in the lamp's way from some directions?")
            .default(true)
            .help("no where the light comes through the lens or from a ring around it"),
        number("housing_diameter_mm", "Diameter of lens and camera", "mm", [1.0, 1000.0])
            .default(50.0)
            .help("plans leave out the directions that it blocks")
            .when("housing", &[true]),
        number("housing_length_mm", "Length of lens and camera together", "mm", [1.0, 5000.0])
            .default(220.0)
            .help("from the front of the lens to the end of the camera")
            .when("housing", &[true]),
    ]
}

fn of_the_sample() -> Vec<Question> {
    vec![
        choice(
            "sample_shape",
            "Shape of the sample",
            listed(&[
                ("bowl", "bowl: a hollow hemisphere"),
                ("ridge", "ridge: a hump within a moat, for a tilted camera"),
                ("cap", "cap: a dome, convex, for a tilted camera"),
                ("sphere", "sphere on a post, for lamps that go behind it"),
                ("tetrahedron", "three-sided hollow corner"),
                ("groove", "groove: a round channel along a circle"),
                ("mesh", "another: a mesh file (PLY, OBJ, STL)"),
            ]),
        )
        .default("bowl")
        .help("a concave one shows its interreflections, from which one light says more"),
        number(
            "sample_radius_mm",
            "Radius of the sample",
            "mm",
            [0.01, 1000.0],
        )
        .default(10.0)
        .help("of the opening or rim, the sphere (of a cap, too), the corners about the axis, or the groove's circle")
        .when("sample_shape", &WITH_RADIUS),
        number(
            "sample_opening_deg",
            "Angle from the cap's axis to its rim",
            "°",
            [5.0, 170.0],
        )
        .default(60.0)
        .help("as the sphere's centre sees it: 90 is half a sphere")
        .when("sample_shape", &["cap"]),
        number(
            "sample_depth_mm",
            "Depth of the corner below its opening",
            "mm",
            [0.01, 1000.0],
        )
        .default(7.07)
        .help("a right-angled corner is radius/√2 deep")
        .when("sample_shape", &["tetrahedron"]),
        number(
            "groove_width_mm",
            "Width of the groove",
            "mm",
            [0.01, 1000.0],
        )
        .default(5.0)
        .help("rim to rim, less than twice the radius")
        .when("sample_shape", &["groove"]),
        any_text("sample_mesh", "Mesh file of the sample")
            .help("relative to the rig file; `rig shape --inspect FILE` shows what it holds")
            .when("sample_shape", &["mesh"]),
        choice(
            "mesh_unit",
            "Unit of the mesh's coordinates",
            listed(&[
                ("mm", "mm"),
                ("cm", "cm"),
                ("m", "m"),
                ("um", "µm"),
                ("in", "inch"),
                ("ft", "foot"),
            ]),
        )
        .default("mm")
        .help("mesh files do not state it")
        .when("sample_shape", &["mesh"]),
    ]
}

fn of_the_stage(found: &Found) -> Vec<Question> {
    let mut port = match found.ports.is_empty() {
        true => text("port", "Serial port of the stage", PORT),
        false => choice("port", "Serial port of the stage", found.ports.clone()),
    };
    port.others = true;
    port.text = Some(PORT);
    port.default = found
        .ports
        .first()
        .map(|first| Answer::Text(first.value.clone()));
    vec![
        choice(
            "stage",
            "Stage that brings the light",
            listed(&[
                ("grbl", "two axes on a GRBL 1.1 controller"),
                ("zaber", "two axes on Zaber devices"),
                ("dmx", "a dome of lights on DMX512"),
                ("manual", "a person places and switches the light"),
            ]),
        )
        .default("grbl")
        .help("what moves or switches the lamp"),
        port.help("names below /dev/serial/by-id survive replugging; it is not opened now")
            .when("stage", &ON_A_PORT),
        number("lamp_distance_mm", "Distance from the lamp to the sample", "mm", [10.0, 10000.0])
            .default(400.0)
            .help("the arm's or the arc's radius, the gantry's height, the dome's radius"),
        text("lights", "Directions of the lights", DIRECTIONS)
            .default("0,30; 60,30; 120,30; 180,30; -120,30; -60,30; 30,60; 120,60; -150,60; -60,60")
            .help("azimuth,elevation in the order of the lights' numbers; 90 is straight above the sample")
            .when("stage", &FIXED),
        whole("dmx_first", "DMX address of the first light", "", [1.0, 512.0])
            .default(1.0)
            .help("the others follow, one address for each channel of the lamp")
            .when("stage", &["dmx"]),
    ]
}

fn of_the_axes() -> Vec<Question> {
    let rotary = &["rotary", "arc"];
    let angle = |key, title, default: f64, help| {
        number(key, title, "degrees", [-360.0, 360.0])
            .default(default)
            .help(help)
            .when("mechanism", rotary)
    };
    let length = |key, title, default: f64, help| {
        number(key, title, "mm", [-10000.0, 10000.0])
            .default(default)
            .help(help)
            .when("mechanism", &["gantry"])
    };
    const SWITCH: &str = "checked on the whole plan before anything moves";
    const HOME: &str = "where the axis stands at position 0, which homing finds";
    vec![
        choice(
            "mechanism",
            "What the two axes do",
            listed(&[
                ("rotary", "azimuth and elevation of an arm that swings about the sample"),
                ("arc", "a turntable that carries an arc on which the lamp climbs"),
                ("gantry", "x and y of a lamp in a plane above the sample"),
            ]),
        )
        .default("rotary")
        .help("from it follow direction and distance of the lamp")
        .when("stage", &WITH_AXES),
        angle("azimuth_min_deg", "Smallest azimuth", -170.0, SWITCH),
        angle("azimuth_max_deg", "Largest azimuth", 170.0, SWITCH),
        angle("azimuth_home_deg", "Azimuth after homing", -170.0, HOME),
        angle("elevation_min_deg", "Smallest elevation", 15.0, "90° is straight above the sample; keep clear of camera and holder"),
        angle("elevation_max_deg", "Largest elevation", 88.0, SWITCH),
        angle("elevation_home_deg", "Elevation after homing", 15.0, HOME),
        length("x_min_mm", "Smallest x", -490.0, SWITCH),
        length("x_max_mm", "Largest x", 490.0, SWITCH),
        length("x_home_mm", "x after homing", -490.0, HOME),
        length("y_min_mm", "Smallest y", -490.0, SWITCH),
        length("y_max_mm", "Largest y", 490.0, SWITCH),
        length("y_home_mm", "y after homing", -490.0, HOME),
        text("first_device", "Zaber device and axis of the azimuth, or of x", ZABER_AXIS)
            .default("1/1")
            .help("its number on the chain, and the axis on it")
            .when("stage", &["zaber"]),
        text("second_device", "Zaber device and axis of the elevation, or of y", ZABER_AXIS)
            .default("1/2")
            .help("its number on the chain, and the axis on it")
            .when("stage", &["zaber"]),
        number("first_scale", "Microsteps per degree (or mm) of the first axis", "", [-1e7, 1e7])
            .help("from the data sheet: microsteps per turn / 360, or per mm; negative turns the other way")
            .when("stage", &["zaber"]),
        number("second_scale", "Microsteps per degree (or mm) of the second axis", "", [-1e7, 1e7])
            .help("from the data sheet: microsteps per turn / 360, or per mm; negative turns the other way")
            .when("stage", &["zaber"]),
    ]
}

fn of_the_lamp() -> Vec<Question> {
    let channels = |key, stages: &[&'static str]| {
        choice(
            key,
            "Channels of the lamp",
            listed(&[
                ("rgb", "three, lit one after another: red, green, blue"),
                (
                    "white",
                    "one, white: it measures R, G and B at once, under a colour camera",
                ),
            ]),
        )
        .default("rgb")
        .help("three narrow-band LEDs under a monochrome camera measure colour best")
        .when("stage", stages)
    };
    let mut all = vec![channels("lamp", &FIXED)];
    // Each controller has its own words for a switch.
    let grbl = ["M3 S1000", "M7", "M8"];
    let zaber = ["output 1/1", "output 1/2", "output 1/3"];
    type Row = (
        &'static str,
        [&'static str; 3],
        &'static str,
        TextRule,
        [&'static str; 3],
        &'static str,
    );
    let rows: [Row; 2] = [
        (
            "grbl_lamp",
            ["grbl_red_on", "grbl_green_on", "grbl_blue_on"],
            "grbl",
            GRBL_COMMANDS,
            grbl,
            "M3 S… is the spindle's pin (full duty: a dimmed lamp flickers), M7 and M8 are the coolant's",
        ),
        (
            "zaber_lamp",
            ["zaber_red_on", "zaber_green_on", "zaber_blue_on"],
            "zaber",
            ZABER_SWITCH,
            zaber,
            "`output 1/2` is output 2 of device 1, `lamp 2/3` lamp 3 of the illuminator that is device 2",
        ),
    ];
    for (lamp, keys, stage, rule, defaults, help) in rows {
        all.push(channels(lamp, &[stage]));
        let titles = [
            "What turns on the red channel, or the white one",
            "What turns on the green channel",
            "What turns on the blue channel",
        ];
        for i in 0..3 {
            let question = text(keys[i], titles[i], rule)
                .default(defaults[i])
                .help(help);
            all.push(match i {
                0 => question.when("stage", &[stage]),
                _ => question.when(lamp, &["rgb"]),
            });
        }
    }
    all.push(
        text("grbl_off", "What turns every channel off", GRBL_COMMANDS)
            .default("M5; M9")
            .help("sent at every stop and after every failure")
            .when("stage", &["grbl"]),
    );
    all.push(
        number(
            "warm_up_s",
            "Wait with the lamp on before the first light",
            "s",
            [0.0, 7200.0],
        )
        .default(900.0)
        .help("LEDs need 600 to 1200 s to be stable within 1%; `rig calibrate lamp` measures it"),
    );
    all
}

fn of_the_lab() -> Vec<Question> {
    let range = |range: RangeInclusive<f64>| [*range.start(), *range.end()];
    let line = |key, title| text(key, title, LINE);
    let mut all = vec![
        line("organisation", "Company, institute or university").help("certificates head with it"),
        line("laboratory", "Laboratory").help("a name, or an accreditation number"),
        line("operator", "Who works at the bench").help("signs the certificate"),
        line("contact", "Whom to ask about a result").help("a name"),
        line("city", "City of the laboratory").help("certificates state where they were made"),
        number(
            "room_temperature_c",
            "Temperature of the room",
            "°C",
            range(lab::ROOM_TEMPERATURE_C),
        )
        .help("as it usually is during a measurement"),
        number(
            "room_humidity_percent",
            "Relative humidity of the room",
            "%",
            range(lab::ROOM_HUMIDITY_PERCENT),
        )
        .help("as it usually is during a measurement"),
    ];
    all = all.into_iter().map(|q| q.when("lab", &[true])).collect();
    let first = yes_no("lab", "Will you state results to others, as certificates?")
        .default(false)
        .help("yes asks who measures and in what room; [lab] of the file takes it later, too");
    all.insert(0, first);
    all
}

fn listed(values: &[(&str, &str)]) -> Vec<Choice> {
    let choice = |&(value, label): &(&str, &str)| Choice {
        value: value.to_owned(),
        label: label.to_owned(),
    };
    values.iter().map(choice).collect()
}

fn asked(key: &'static str, title: &'static str, kind: Kind) -> Question {
    Question {
        key,
        title,
        help: Cow::Borrowed(""),
        kind,
        unit: None,
        whole: false,
        choices: Vec::new(),
        others: false,
        default: None,
        least: None,
        most: None,
        when: None,
        text: None,
    }
}

fn choice(key: &'static str, title: &'static str, choices: Vec<Choice>) -> Question {
    Question {
        choices,
        ..asked(key, title, Kind::Choice)
    }
}

fn text(key: &'static str, title: &'static str, rule: TextRule) -> Question {
    Question {
        text: Some(rule),
        ..asked(key, title, Kind::Text)
    }
}

fn any_text(key: &'static str, title: &'static str) -> Question {
    asked(key, title, Kind::Text)
}

fn yes_no(key: &'static str, title: &'static str) -> Question {
    asked(key, title, Kind::YesNo)
}

fn number(
    key: &'static str,
    title: &'static str,
    unit: &'static str,
    [least, most]: [f64; 2],
) -> Question {
    Question {
        unit: (!unit.is_empty()).then_some(unit),
        least: Some(least),
        most: Some(most),
        ..asked(key, title, Kind::Number)
    }
}

fn whole(key: &'static str, title: &'static str, unit: &'static str, range: [f64; 2]) -> Question {
    Question {
        whole: true,
        ..number(key, title, unit, range)
    }
}

impl Question {
    fn help(self, help: impl Into<Cow<'static, str>>) -> Self {
        Self {
            help: help.into(),
            ..self
        }
    }

    fn default(self, answer: impl Into<Answer>) -> Self {
        Self {
            default: Some(answer.into()),
            ..self
        }
    }

    fn when<T: Clone + Into<Answer>>(self, key: &'static str, is: &[T]) -> Self {
        let is = is.iter().cloned().map(Into::into).collect();
        Self {
            when: Some(When { key, is }),
            ..self
        }
    }
}
