//! The commented rig file of a bench.

use std::fmt::Display;

use super::answered::{Axes, Camera, Draft, Lab, Lamp, Lens, Sample, Stage};
use super::found;

impl Draft {
    /// The rig file, with a comment for every key.
    pub(super) fn text(&self) -> String {
        let mut out = Lines::default();
        self.head(&mut out);
        self.camera(&mut out);
        self.stage(&mut out);
        self.geometry(&mut out);
        self.procedure(&mut out);
        lab(&mut out, self.lab.as_ref());
        out.0
    }

    fn head(&self, out: &mut Lines) {
        out.remark(&format!(
            "Bench {}, written by `rig init`. Change what is not so, then check it with\n    rig doctor\nLengths are millimetres. Directions and positions are in the sample frame: origin on the\nsample's datum, +z towards the camera. Keys in comments are set to their defaults; those of\nother drivers stand in simulated.toml of the program's folder rig-configs.",
            self.name
        ));
        out.table("[rig]");
        out.key(
            "name",
            quoted(&self.name),
            "Name of the bench and of its folder of records, calibration/NAME.",
        );
    }

    fn camera(&self, out: &mut Lines) {
        out.table("[camera]");
        let Camera {
            driver,
            key,
            only_practice,
            address,
        } = &self.camera;
        let marked = found::marked("What speaks to the camera", *only_practice);
        out.key("driver", quoted(driver), &format!("{marked}."));
        out.key(key, quoted(address), "Which camera.");
        match &self.serial {
            Some(serial) => out.key("serial", quoted(serial), "Serial number that it must have: another camera has another calibration."),
            None => out.absent("serial", "\"12345678\"", "Serial number that it must have (default: any). Set it: another camera has another\ncalibration."),
        }
        let [width, height] = self.resolution_px;
        out.key(
            "resolution_px",
            format!("[{width}, {height}]"),
            "Width and height of a frame (pixels).",
        );
        out.key(
            "bit_depth",
            self.bit_depth,
            "Significant bits of a raw count.",
        );
        out.key(
            "mosaic",
            quoted(&self.mosaic),
            "Colour filters over the sensor.",
        );
        out.key("gain", "1.0", "Analogue gain (factor): 1 has the least noise per electron. A calibration belongs to one gain.");
        out.absent("shortest_ms", "0.05", "Shortest and longest exposure (ms), and the step between exposures. The driver's own\nlimits narrow them, where it has any; `rig camera info` shows them.");
        out.absent_more("longest_ms", "2000.0");
        out.absent_more("step_ms", "0.1");
        out.absent("settings_latency_frames", "3", "Frames that still have the old settings after a change. Raise it if a capture complains\nthat a setting came late.");
        let timeout = "How long a frame may take beyond its exposure (s).";
        match self.camera.driver {
            "gphoto2" => out.key("frame_timeout_s", "30.0", timeout),
            _ => out.absent("frame_timeout_s", "5.0", timeout),
        }
    }

    fn stage(&self, out: &mut Lines) {
        out.table("[stage]");
        let (driver, port) = match &self.stage {
            Stage::Grbl { port, .. } => ("grbl", Some(port)),
            Stage::Zaber { port, .. } => ("zaber", Some(port)),
            Stage::Dome { port, .. } => ("dmx", Some(port)),
            Stage::Manual { .. } => ("manual", None),
        };
        out.key("driver", quoted(driver), "What brings the light.");
        if let Some(port) = port {
            out.key(
                "port",
                quoted(port),
                "The serial port. Names below /dev/serial/by-id survive replugging.",
            );
            out.absent("baud", "115200", "Bits per second.");
        }
        match &self.stage {
            Stage::Grbl { axes, .. } => {
                self.mechanism(out, axes);
                out.key("feed_per_min", "1800.0", "Speed of a move (degrees or mm per minute). Slow at first; raise it when nothing is lost.");
                out.absent("position_tolerance_deg", "0.05", "How far the reported position may be from the commanded one (degrees). Half a step of the\ncoarser motor is a good value.");
                if let Some(off) = &self.lamp.off {
                    out.key(
                        "lamp_off",
                        quoted(off),
                        "Turns every channel off: sent at every stop and after every failure.",
                    );
                }
                let names = [quoted("X"), quoted("Y")];
                two_axes(
                    out,
                    axes,
                    &names,
                    &[1.0, 1.0],
                    "Axis units per degree or mm: set the controller ($100, $101) so that it is 1; negative\nturns the other way.",
                );
            }
            Stage::Zaber {
                axes,
                devices,
                scales,
                ..
            } => {
                self.mechanism(out, axes);
                out.absent(
                    "speed_per_s",
                    "20.0",
                    "Speed of an axis (degrees or mm per second), for estimates of time alone.",
                );
                out.absent(
                    "position_tolerance_deg",
                    "0.05",
                    "How far the reported position may be from the commanded one (degrees).",
                );
                let names = [quoted(&devices[0]), quoted(&devices[1])];
                two_axes(
                    out,
                    axes,
                    &names,
                    scales,
                    "Microsteps per degree or mm; negative turns the other way.",
                );
            }
            Stage::Dome {
                lights, dmx_first, ..
            } => {
                out.absent(
                    "level",
                    "255",
                    "Drive of a lit light (1 to 255). Full drive: a dimmed lamp flickers.",
                );
                fixed_lights(out, lights, Some((*dmx_first, self.lamp.channels)));
            }
            Stage::Manual { lights } => fixed_lights(out, lights, None),
        }
        lamp(out, &self.lamp);
    }

    fn mechanism(&self, out: &mut Lines, axes: &Axes) {
        let distance = number(self.lamp_distance_mm);
        out.key(
            "mechanism",
            quoted(axes.mechanism),
            "What the two axes do with the lamp.",
        );
        match axes.mechanism {
            "arc" => {
                out.key(
                    "radius_mm",
                    distance,
                    "Radius of the arc on which the lamp climbs.",
                );
                out.absent(
                    "centre_height_mm",
                    "0.0",
                    "Height of the arc's centre above the stage's.",
                );
            }
            "gantry" => out.key(
                "height_mm",
                distance,
                "Height of the lamp above the stage's centre.",
            ),
            _ => {}
        }
        let key = match axes.mechanism {
            "gantry" => "approach_mm",
            _ => "approach_deg",
        };
        out.key(
            key,
            "2.0",
            "Every target is approached from this far below it, against backlash (0 turns it off).",
        );
    }

    fn geometry(&self, out: &mut Lines) {
        out.table("[geometry.camera]");
        match self.lens {
            Lens::Telecentric {
                extent_mm: [width, height],
            } => {
                out.key("model", quoted("orthographic"), "A telecentric lens.");
                out.key(
                    "extent_mm",
                    format!("[{}, {}]", number(width), number(height)),
                    "Field of view, width and height. `rig calibrate camera` measures it.",
                );
            }
            Lens::Perspective { fov_deg, .. } => {
                out.key("model", quoted("perspective"), "An ordinary lens.");
                out.key(
                    "fov_deg",
                    number(fov_deg),
                    "Full horizontal angle of view (degrees). `rig calibrate camera` measures it.",
                );
            }
        }
        let (position, remark) = match self.camera_tilt_deg {
            0.0 => (
                format!("[0.0, 0.0, {}]", number(self.camera_distance_mm)),
                "Where the lens is: straight above the sample. It is sharp at the datum unless focus_mm\nsays otherwise.",
            ),
            tilt_deg => {
                let (sin, cos) = tilt_deg.to_radians().sin_cos();
                // Hundredths of a millimetre, which a tape does not reach.
                let [x, z] = [-sin, cos]
                    .map(|part| (100.0 * part * self.camera_distance_mm).round() / 100.0);
                (
                    format!("[{}, 0.0, {}]", number(x), number(z)),
                    "Where the lens is, tilted away from azimuth 0. It is sharp at the datum unless focus_mm\nsays otherwise.",
                )
            }
        };
        out.key("position_mm", position, remark);
        out.key(
            "look_at_mm",
            "[0.0, 0.0, 0.0]",
            "The point in the middle of the image.",
        );
        out.key(
            "up",
            match self.camera_tilt_deg {
                0.0 => "[0.0, 1.0, 0.0]",
                _ => "[0.0, 0.0, 1.0]",
            },
            "The direction that is up in the image.",
        );
        match self.lens {
            Lens::Perspective { object_na: Some(na), .. } => out.key("object_na", number(na), "Numerical aperture on the sample's side, from the f-number. `rig calibrate focus` measures\nit."),
            _ => out.absent("object_na", "0.0", "Numerical aperture on the sample's side (0: a pinhole, all is sharp). `rig calibrate focus`\nmeasures it, with focus and point spread."),
        }
        out.absent(
            "point_spread_px",
            "0.5",
            "Blur in focus, standard deviation (pixels); real lenses have 0.3 to 1.",
        );
        if let Some([diameter, length]) = self.housing_mm {
            out.table("[geometry.camera.body]");
            out.key(
                "radius_mm",
                number(0.5 * diameter),
                "Lens and camera as a cylinder: directions that it blocks are left out of plans.",
            );
            out.key(
                "length_mm",
                number(length),
                "From the front of the lens to the end of the camera.",
            );
        }
        sample(out, &self.sample);
        out.table("[geometry.sample_from_stage]");
        out.key("rotation_deg", "[0.0, 0.0, 0.0]", "How the stage's axes are turned against the sample (degrees). `rig calibrate lights` measures\nit.");
        out.key(
            "translation_mm",
            "[0.0, 0.0, 0.0]",
            "Where the stage's centre is, seen from the sample's datum.",
        );
        out.table("[geometry.light]");
        let states_distance = match &self.stage {
            Stage::Grbl { axes, .. } | Stage::Zaber { axes, .. } => axes.mechanism == "rotary",
            Stage::Dome { .. } | Stage::Manual { .. } => true,
        };
        if states_distance {
            out.key(
                "distance_mm",
                number(self.lamp_distance_mm),
                "From the lamp to the stage's centre.",
            );
        }
        out.key("irradiance_w_m2", "[1.0, 1.0, 1.0]", "Irradiance at the sample across the light, R, G, B (W/m²). Unknown so far: radiances are\nrelative until `rig calibrate white` has measured it.");
    }

    fn procedure(&self, out: &mut Lines) {
        out.table("[capture]");
        out.key("lamp_warm_up_s", number(self.warm_up_s), "Wait with the lamp on before the first light (s). `rig calibrate lamp` says how long it needs.");
        out.absent(
            "snr",
            "20.0",
            "Signal over noise that the darkest parts of the sample must reach.",
        );
        out.absent(
            "settle_s",
            "0.3",
            "Wait after a move (s). Raise it if images show shaking.",
        );
        if matches!(self.stage, Stage::Manual { .. }) {
            out.key("ambient", "false", "Whether the room's light is subtracted: then the lamp is switched off and on at every\nexposure. false: darken the room.");
            out.key(
                "max_frames",
                "2",
                "Most frames averaged at one exposure: a hand tires.",
            );
        }
        out.absent("dark_frames", "8", "Dark frames at each exposure.");
        out.absent(
            "disk_reserve_mb",
            "500",
            "Free space that must remain on the disk (MB).",
        );
        out.table("[fit]");
        out.key("refine_bench", "true", "Light directions, intensities, pose and stray light are refined with the material, within\n[uncertainty]: a real bench is never known exactly.");
        out.table("[uncertainty]");
        out.key("light_deg", "1.0", "Direction of each light (degrees), by ruler and protractor. Records of `rig calibrate lights`\nbring their own, and so do the others.");
        out.key("intensity", "0.02", "Each light's intensity, relative.");
        out.key(
            "common_intensity",
            "1.0",
            "The scale common to all lights, relative: unknown until `rig calibrate white`.",
        );
        out.key(
            "rotation_deg",
            "1.0",
            "The sample's orientation about each axis (degrees).",
        );
        out.key(
            "translation_mm",
            "0.5",
            "The sample's position along each axis.",
        );
    }
}

fn lab(out: &mut Lines, lab: Option<&Lab>) {
    out.table("[lab]");
    out.remark("Who measures, and the room (°C, % relative humidity): certificates state it. It is captured\nwith the session: state it before you measure. More keys stand in simulated.toml.");
    let keys = ["organisation", "laboratory", "operator", "contact"];
    let room = ["room_temperature_c", "room_humidity_percent"];
    match lab {
        Some(lab) => {
            for (key, text) in keys.iter().zip(&lab.who) {
                out.more(key, quoted(text));
            }
            out.more(room[0], number(lab.room_temperature_c));
            out.more(room[1], number(lab.room_humidity_percent));
        }
        None => {
            for key in keys {
                out.absent_more(key, "\"\"");
            }
            out.absent_more(room[0], "23.0");
            out.absent_more(room[1], "50.0");
        }
    }
}

fn two_axes(out: &mut Lines, axes: &Axes, names: &[String; 2], scales: &[f64; 2], of_scale: &str) {
    let (tables, unit, word) = match axes.mechanism {
        "gantry" => (["x", "y"], "mm", "coordinate (mm)"),
        _ => (["azimuth", "elevation"], "deg", "angle (degrees)"),
    };
    for i in 0..2 {
        let [min, max, home] = axes.limits[i];
        out.table(&format!("[stage.{}]", tables[i]));
        out.key("axis", &names[i], "What the controller calls the axis.");
        out.key("scale", number(scales[i]), of_scale);
        out.key(
            &format!("offset_{unit}"),
            number(home),
            &format!("The {word} at position 0, which homing finds."),
        );
        out.key(
            &format!("min_{unit}"),
            number(min),
            &format!(
                "Smallest and largest {word}; checked on the whole plan before anything moves."
            ),
        );
        out.more(&format!("max_{unit}"), number(max));
    }
}

fn fixed_lights(out: &mut Lines, lights: &[[f64; 2]], dmx: Option<(u32, usize)>) {
    for (i, [azimuth, elevation]) in lights.iter().enumerate() {
        out.table("[[stage.light]]");
        let remark = match i {
            0 => {
                "Directions as seen from the sample (degrees), in the order of the lights' numbers."
            }
            _ => "",
        };
        out.key("azimuth_deg", number(*azimuth), remark);
        out.more("elevation_deg", number(*elevation));
        if let Some((first, channels)) = dmx {
            let address = first as usize + i * channels;
            let remark = match i {
                0 => "DMX address of the first colour channel.",
                _ => "",
            };
            out.key("dmx_address", address, remark);
        }
    }
}

fn lamp(out: &mut Lines, lamp: &Lamp) {
    let measures: &[&str] = match lamp.channels {
        3 => &["R", "G", "B"],
        _ => &["RGB"],
    };
    for (i, measures) in measures.iter().enumerate() {
        out.table("[[stage.lamp]]");
        let [measured, switched] = match i {
            0 => [
                "The colours that frames under this channel measure.",
                "What turns it on, at full duty.",
            ],
            _ => ["", ""],
        };
        out.key("measures", quoted(measures), measured);
        match lamp.on.get(i) {
            Some(on) => out.key("on", quoted(on), switched),
            None => out.key("channel", i, ""),
        }
    }
}

fn sample(out: &mut Lines, sample: &Sample) {
    out.table("[geometry.sample]");
    match sample {
        Sample::Mesh { file, unit } => {
            out.key(
                "mesh",
                quoted(file),
                "The sample's surface, relative to this file.",
            );
            out.key("mesh_unit", quoted(unit), "Unit of its coordinates.");
            out.absent(
                "mesh_to_sample",
                "{ rotate_deg = [0, 0, 0], translate_mm = [0, 0, 0] }",
                "How the mesh's axes become the sample's; `rig shape --inspect FILE` suggests it.",
            );
        }
        Sample::Shape {
            kind,
            radius_mm,
            opening_deg,
            depth_mm,
            width_mm,
        } => {
            out.key(
                "shading",
                quoted(if kind == "tetrahedron" {
                    "flat"
                } else {
                    "smooth"
                }),
                "Which normals shade: \"smooth\" hides the facets of a round shape.",
            );
            out.absent("slope_error_deg", "0.5", "How far the sample as made deviates from its drawing: rms angle of the normal (degrees) and\nrms height (mm), both or neither. They widen the intervals of the result.");
            out.absent_more("form_error_mm", "0.02");
            out.table("[geometry.sample.shape]");
            out.key("kind", quoted(kind), "");
            out.key("radius_mm", number(*radius_mm), "");
            if let Some(opening) = opening_deg {
                out.key(
                    "opening_deg",
                    number(*opening),
                    "From its axis to its rim, as the sphere's centre sees it.",
                );
            }
            if let Some(depth) = depth_mm {
                out.key(
                    "depth_mm",
                    number(*depth),
                    "Of the corner below its opening.",
                );
            }
            if let Some(width) = width_mm {
                out.key("width_mm", number(*width), "Rim to rim.");
            }
            if kind != "tetrahedron" {
                out.key("segments", "256", "Facets around.");
            }
        }
    }
}

/// A text of TOML.
fn quoted(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}

/// A number as TOML reads it, to a millionth.
fn number(value: f64) -> String {
    format!("{:?}", (value * 1e6).round() / 1e6 + 0.0)
}

/// Lines of a rig file.
#[derive(Default)]
struct Lines(String);

impl Lines {
    fn remark(&mut self, text: &str) {
        for line in text.lines() {
            self.0 += &format!("# {line}\n");
        }
    }

    fn table(&mut self, header: &str) {
        self.0 += &format!("\n{header}\n");
    }

    fn key(&mut self, key: &str, value: impl Display, remark: &str) {
        self.remark(remark);
        self.more(key, value);
    }

    /// A key that the remark of the one before explains, too.
    fn more(&mut self, key: &str, value: impl Display) {
        self.0 += &format!("{key} = {value}\n");
    }

    /// A key that is left to its default.
    fn absent(&mut self, key: &str, value: &str, remark: &str) {
        self.remark(remark);
        self.absent_more(key, value);
    }

    fn absent_more(&mut self, key: &str, value: &str) {
        self.0 += &format!("# {key} = {value}\n");
    }
}
