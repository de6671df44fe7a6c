//! The calibrations that a page guides through: what each puts before the camera, whose frames
//! it takes, what it is told, and what command carries it out. One row each; nothing else of
//! the console knows one by name, but for the drawings.

use serde::Serialize;

/// A calibration.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Guide {
    /// `rig calibrate KIND`.
    pub kind: &'static str,
    /// What it measures.
    pub title: &'static str,
    /// How the target is placed, and the light.
    pub place: &'static [&'static str],
    /// Where its images come from.
    #[serde(flatten)]
    pub frames: Frames,
    /// What it is told.
    pub values: &'static [Asked],
    /// The simulated bench that has the target; `None` where every simulated one has.
    pub rehearsal: Option<&'static str>,
    /// Whether a live frame can be looked at for the target.
    pub can_check: bool,
}

/// Where the images come from.
#[derive(Clone, Copy, Debug, Serialize)]
#[serde(tag = "frames", rename_all = "kebab-case")]
pub enum Frames {
    /// The command takes them itself.
    Own,
    /// Sessions that are captured for it.
    Sessions {
        /// Their sample's name.
        sample: &'static str,
        /// How many lights, or directions: AZIMUTH,ELEVATION.
        lights: &'static str,
        /// Likewise at its rehearsal.
        lights_rehearsed: &'static str,
        /// Whether there may be several, the target placed anew for each.
        several: bool,
    },
}

/// A value that the operator states.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Asked {
    /// The option without its hyphens.
    pub key: &'static str,
    /// In a form, with its unit.
    pub label: &'static str,
    /// What it may be.
    #[serde(flatten)]
    pub form: Form,
    /// Whether the command needs it.
    pub required: bool,
    /// What it is at the rehearsal; empty: not stated.
    pub rehearsed: &'static str,
}

/// What a value may be.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(tag = "form", rename_all = "kebab-case")]
pub enum Form {
    /// A number in this range.
    Number {
        /// Least.
        least: f64,
        /// Most.
        most: f64,
    },
    /// Numbers with commas in between.
    Numbers {
        /// How many; 0: any number.
        count: usize,
    },
    /// Parts of the image: X,Y,WIDTH,HEIGHT each, with spaces in between.
    Regions,
    /// A line of text.
    Text,
}

const fn number(
    key: &'static str,
    label: &'static str,
    range: [f64; 2],
    rehearsed: &'static str,
) -> Asked {
    let [least, most] = range;
    let form = Form::Number { least, most };
    Asked {
        key,
        label,
        form,
        required: false,
        rehearsed,
    }
}

const fn other(
    key: &'static str,
    label: &'static str,
    form: Form,
    rehearsed: &'static str,
) -> Asked {
    Asked {
        key,
        label,
        form,
        required: false,
        rehearsed,
    }
}

const fn needed(asked: Asked) -> Asked {
    Asked {
        required: true,
        ..asked
    }
}

/// All, in the order in which each finds what it needs.
pub const GUIDES: &[Guide] = &[
    Guide {
        kind: "sensor",
        title: "Sensor",
        place: &[
            "Point the camera at a steady, even light: an integrating sphere, or a lit diffuser in front of the lens.",
            "It must saturate the sensor within two seconds, but not in its shortest exposure.",
        ],
        frames: Frames::Own,
        values: &[],
        rehearsal: None,
        can_check: true,
    },
    Guide {
        kind: "flat",
        title: "Flat field and scale",
        place: &[
            "Leave the even light of the sensor’s calibration where it is. A record of the sensor must be in force.",
            "If the light has a certificate of its radiance, state it: that gives the absolute scale.",
        ],
        frames: Frames::Own,
        values: &[
            number(
                "radiance",
                "Certified radiance, W/(m² sr)",
                [1e-9, 1e9],
                "0.4",
            ),
            number(
                "radiance-std",
                "Its standard uncertainty, W/(m² sr)",
                [0.0, 1e9],
                "0.004",
            ),
        ],
        rehearsal: None,
        can_check: true,
    },
    Guide {
        kind: "lamp",
        title: "Lamp",
        place: &[
            "Let the lamp cool down. Put a white card in the sample’s place, and cover all other light.",
            "The stage homes and aims the lamp steeply. Touch nothing while its level is followed.",
        ],
        frames: Frames::Own,
        values: &[number(
            "minutes",
            "How long it is watched, minutes",
            [2.0, 240.0],
            "30",
        )],
        rehearsal: None,
        can_check: false,
    },
    Guide {
        kind: "camera",
        title: "Lens",
        place: &[
            "Show a flat checkerboard with a plain border, evenly lit; squares of 10 pixels or more.",
            "Take six views or more, tilted by 20° to 40° in several directions, whose corners reach the image’s. Before a telecentric lens lay it flat; one view will do.",
        ],
        frames: Frames::Sessions {
            sample: "board",
            lights: "1",
            lights_rehearsed: "0,90",
            several: true,
        },
        values: &[
            needed(other(
                "squares",
                "Squares along its two sides, as 10,7",
                Form::Numbers { count: 2 },
                "10,8",
            )),
            needed(number("square", "Side of a square, mm", [1e-3, 1e3], "2.5")),
            number("square-std", "Its standard uncertainty, mm", [0.0, 1e2], ""),
            number(
                "datum",
                "The view, from 1, whose board lies at the sample’s place",
                [1.0, 1e3],
                "1",
            ),
        ],
        rehearsal: Some("rehearsal-board"),
        can_check: true,
    },
    Guide {
        kind: "focus",
        title: "Focus and sharpness",
        place: &[
            "Put a straight, sharp edge between dark and bright across the camera’s axis, turned by 5° to 15° against the pixels’ rows or columns, evenly lit.",
            "Take one view at each of three heights or more over the sample’s depth; or show several edges in one view, and name the part of the image that each is in.",
        ],
        frames: Frames::Sessions {
            sample: "edge",
            lights: "1",
            lights_rehearsed: "0,90",
            several: true,
        },
        values: &[
            needed(other(
                "heights",
                "Heights above the sample’s datum in the order of the views, mm, as -8,-4,0",
                Form::Numbers { count: 0 },
                "-9,-1,6",
            )),
            number(
                "height-std",
                "Their common standard uncertainty, mm",
                [0.0, 100.0],
                "",
            ),
            other(
                "region",
                "Where the edges are: X,Y,WIDTH,HEIGHT in pixels, one after the other",
                Form::Regions,
                "14,20,26,80 65,20,26,80 117,20,26,80",
            ),
        ],
        rehearsal: Some("rehearsal-edge"),
        can_check: true,
    },
    Guide {
        kind: "glare",
        title: "Glare",
        place: &[
            "Let a white card fill the image, evenly lit, without other light. It has a hole a third as wide as the image’s shorter side, and one a tenth.",
            "Behind each hole stands a deep box that is black inside.",
        ],
        frames: Frames::Own,
        values: &[other(
            "trap",
            "Inside the holes: X,Y,WIDTH,HEIGHT in pixels, one after the other",
            Form::Regions,
            "",
        )],
        rehearsal: None,
        can_check: true,
    },
    Guide {
        kind: "lights",
        title: "Light directions",
        place: &[
            "Put a glossy ball of known radius in the sample’s place, its middle at the datum, before a background that is clearly darker or brighter than its rim: a polished ball halfway in a hole of a white card.",
            "Cover windows and screens, which it would mirror.",
        ],
        frames: Frames::Sessions {
            sample: "sphere",
            lights: "12",
            lights_rehearsed: "8",
            several: false,
        },
        values: &[
            needed(number(
                "radius",
                "Radius of the ball, mm",
                [1e-3, 1e4],
                "10",
            )),
            number(
                "height",
                "Height of its middle above the datum, mm",
                [-1e4, 1e4],
                "",
            ),
            number(
                "spheres",
                "How many equal balls there are: 1, or 2, which also give the lamp’s distance",
                [1.0, 2.0],
                "",
            ),
        ],
        rehearsal: Some("rehearsal-ball"),
        can_check: true,
    },
    Guide {
        kind: "white",
        title: "Irradiance",
        place: &[
            "Put a diffuse white standard of certified reflectance in the sample’s place, level.",
            "State the certificate’s radiance factor as a fraction; an expanded uncertainty is usually two standard ones.",
        ],
        frames: Frames::Sessions {
            sample: "white",
            lights: "8",
            lights_rehearsed: "8",
            several: false,
        },
        values: &[
            needed(number(
                "reflectance",
                "Radiance factor, 0.02 to 1.2",
                [0.02, 1.2],
                "0.98",
            )),
            needed(number(
                "reflectance-std",
                "Its standard uncertainty",
                [0.0, 1.0],
                "0.005",
            )),
            other(
                "certificate",
                "Number, laboratory and date of the certificate",
                Form::Text,
                "",
            ),
            number(
                "height",
                "Height of its surface above the datum, mm",
                [-1e4, 1e4],
                "",
            ),
            other(
                "region",
                "Where it is in the image, if not all over it: X,Y,WIDTH,HEIGHT in pixels",
                Form::Regions,
                "",
            ),
        ],
        rehearsal: Some("rehearsal-tile"),
        can_check: true,
    },
    Guide {
        kind: "pose",
        title: "Pose of the sample",
        place: &[
            "Seat the sample as it will be measured; its outline in the live picture is where the rig file has it.",
            "Use a session that is there, if the sample still lies as it did.",
        ],
        frames: Frames::Sessions {
            sample: "pose",
            lights: "4",
            lights_rehearsed: "4",
            several: false,
        },
        values: &[],
        rehearsal: Some("rehearsal-corner"),
        can_check: false,
    },
];

/// The one of this kind.
pub fn guide(kind: &str) -> Option<&'static Guide> {
    GUIDES.iter().find(|guide| guide.kind == kind)
}

impl Asked {
    /// The texts of the option, one for each time that it is given; none where nothing is stated.
    ///
    /// # Errors
    /// What it must be.
    pub fn options(&self, text: &str) -> Result<Vec<String>, String> {
        let text = text.trim();
        if text.is_empty() {
            return match self.required {
                true => Err("must be stated".to_owned()),
                false => Ok(Vec::new()),
            };
        }
        let numbers = |text: &str| -> Option<Vec<f64>> {
            let each = text.split(',').map(|part| part.trim().parse::<f64>());
            each.map(|number| number.ok().filter(|n| n.is_finite()))
                .collect()
        };
        match self.form {
            Form::Number { least, most } => match text.parse::<f64>() {
                Ok(value) if (least..=most).contains(&value) => Ok(vec![text.to_owned()]),
                _ => Err(format!("must be a number from {least} to {most}")),
            },
            Form::Numbers { count } => match numbers(text) {
                Some(found) if count == 0 || found.len() == count => Ok(vec![text.to_owned()]),
                _ if count == 0 => Err("must be numbers with commas in between".to_owned()),
                _ => Err(format!("must be {count} numbers with a comma in between")),
            },
            Form::Regions => {
                let words: Vec<_> = text.split_whitespace().map(str::to_owned).collect();
                match words.len() <= MOST_REGIONS && words.iter().all(|word| region(word).is_some())
                {
                    true => Ok(words),
                    false => Err(format!(
                        "must be four whole numbers with commas, X,Y,WIDTH,HEIGHT, up to {MOST_REGIONS} times with spaces in between"
                    )),
                }
            }
            Form::Text if text.chars().count() <= 200 && !text.contains(char::is_control) => {
                Ok(vec![text.to_owned()])
            }
            Form::Text => Err("must be at most 200 characters on one line".to_owned()),
        }
    }
}

/// Parts of the image that may be named.
const MOST_REGIONS: usize = 20;

/// First column, first row, columns and rows.
pub fn region(text: &str) -> Option<[usize; 4]> {
    let numbers: Option<Vec<usize>> = text.split(',').map(|part| part.parse().ok()).collect();
    numbers?.try_into().ok()
}
