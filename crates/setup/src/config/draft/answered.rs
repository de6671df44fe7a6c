//! A bench as the answers describe it.

use super::answer::{AnswerError, Answers};
use super::found::Found;
use super::table::directions;
use crate::config::camera::offered;

/// A bench, from answers that are complete and fit each other.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs)]
pub struct Draft {
    pub name: String,
    pub camera: Camera,
    /// The camera's serial number, where it shows one.
    pub serial: Option<String>,
    /// Width and height of a frame, pixels.
    pub resolution_px: [u32; 2],
    /// Significant bits of a count.
    pub bit_depth: u32,
    /// Colour filters, as rig files name them.
    pub mosaic: String,
    pub lens: Lens,
    /// From the lens to the sample's datum, mm.
    pub camera_distance_mm: f64,
    /// Angle of its axis from the sample's, degrees.
    pub camera_tilt_deg: f64,
    /// Diameter and length of lens and camera, mm; `None` where they block no light.
    pub housing_mm: Option<[f64; 2]>,
    pub sample: Sample,
    /// What brings the light.
    pub stage: Stage,
    /// From the lamp to the sample, mm.
    pub lamp_distance_mm: f64,
    pub lamp: Lamp,
    /// Wait with the lamp on before the first light, s.
    pub warm_up_s: f64,
    /// Who measures, where certificates are to state it.
    pub lab: Option<Lab>,
}

/// Who measures, and in what room.
#[derive(Clone, Debug, PartialEq)]
pub struct Lab {
    /// Organisation, laboratory, operator, contact.
    pub who: [String; 4],
    /// Temperature of the room, °C.
    pub room_temperature_c: f64,
    /// Its relative humidity, %.
    pub room_humidity_percent: f64,
}

/// The camera, as rig files name it.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Its driver.
    pub driver: &'static str,
    /// The driver's key that says which camera.
    pub key: &'static str,
    /// Whether its frames are for practice, not for measurement.
    pub only_practice: bool,
    /// What stands there.
    pub address: String,
}

/// How the camera sees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Lens {
    /// A telecentric one.
    Telecentric {
        /// Width and height of the field, mm.
        extent_mm: [f64; 2],
    },
    /// One in perspective.
    Perspective {
        /// Full horizontal angle of view, degrees.
        fov_deg: f64,
        /// Numerical aperture on the sample's side, where it is known.
        object_na: Option<f64>,
    },
}

/// The sample's shape.
#[derive(Clone, Debug, PartialEq)]
pub enum Sample {
    /// By its parameters.
    Shape {
        /// As rig files name it.
        kind: String,
        /// Radius, mm.
        radius_mm: f64,
        /// Opening of a cap, degrees.
        opening_deg: Option<f64>,
        /// Depth of a tetrahedron, mm.
        depth_mm: Option<f64>,
        /// Width of a groove, mm.
        width_mm: Option<f64>,
    },
    /// A mesh file.
    Mesh {
        /// Its path, relative to the rig file.
        file: String,
        /// Unit of its coordinates.
        unit: String,
    },
}

/// The stage.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs)]
pub enum Stage {
    /// On a GRBL controller.
    Grbl {
        /// Its serial port.
        port: String,
        axes: Axes,
    },
    /// On Zaber devices.
    Zaber {
        /// Their serial port.
        port: String,
        axes: Axes,
        /// Device and axis of each.
        devices: [String; 2],
        /// Microsteps per degree or mm of each.
        scales: [f64; 2],
    },
    /// A dome on DMX.
    Dome {
        /// Its serial port.
        port: String,
        /// Directions, degrees.
        lights: Vec<[f64; 2]>,
        /// DMX address of the first light.
        dmx_first: u32,
    },
    /// By hand.
    Manual {
        /// Directions, degrees.
        lights: Vec<[f64; 2]>,
    },
}

/// Two axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axes {
    /// What they do with the lamp, as rig files name it.
    pub mechanism: &'static str,
    /// Smallest, largest, and that after homing, of each, degrees or mm.
    pub limits: [[f64; 3]; 2],
}

/// The lamp's switches. Channels are red, green and blue, or one that is white.
#[derive(Clone, Debug, PartialEq)]
pub struct Lamp {
    /// How many channels: 3 or 1.
    pub channels: usize,
    /// What turns each on; empty where the stage's protocol says it.
    pub on: Vec<String>,
    /// What turns all off, where that is a command of its own.
    pub off: Option<String>,
}

/// Full horizontal angle of view of a lens in perspective, degrees; `None` while answers are
/// not there.
///
/// A thin lens of focal length f that is sharp at distance d has its image f d / (d - f)
/// behind it; the field is the sensor's width times d over that.
pub fn field_of_view(answers: &Answers) -> Option<f64> {
    let distance_mm = answers.number("camera_distance_mm")?;
    let [width_mm, _] = field_mm(answers)?;
    Some(2.0 * (0.5 * width_mm / distance_mm).atan().to_degrees())
}

/// Width and height of the field of view at the sample, mm.
pub fn field_mm(answers: &Answers) -> Option<[f64; 2]> {
    let [width_px, height_px] = [answers.whole("width_px")?, answers.whole("height_px")?];
    let width_mm = match answers.text("lens")? {
        "focal-length" => {
            let distance_mm = answers.number("camera_distance_mm")?;
            let focal_mm = answers.number("focal_mm")?;
            let sensor_mm = f64::from(width_px) * answers.number("pixel_um")? * 1e-3;
            sensor_mm * (distance_mm - focal_mm) / focal_mm
        }
        _ => answers.number("field_width_mm")?,
    };
    Some([
        width_mm,
        width_mm * f64::from(height_px) / f64::from(width_px),
    ])
}

impl Draft {
    /// The bench of complete answers.
    ///
    /// # Errors
    /// [`AnswerError::Missing`] where they are not complete.
    pub fn of(answers: &Answers, found: &Found) -> Result<Self, AnswerError> {
        let take = Take(answers);
        let choice = take.text("camera")?;
        let (name, address) = match choice.split_once(' ') {
            Some((name, address)) => (name, address.to_owned()),
            None => (choice.as_str(), take.text("camera_address")?),
        };
        let driver = offered().find(|driver| driver.name == name);
        let driver = driver.ok_or_else(|| Take::missing("camera"))?;
        let camera = Camera {
            driver: driver.name,
            key: driver.key,
            only_practice: driver.only_practice,
            address,
        };
        let housing_mm = match answers.is_yes("housing") {
            true => Some([
                take.number("housing_diameter_mm")?,
                take.number("housing_length_mm")?,
            ]),
            false => None,
        };
        Ok(Self {
            name: take.text("name")?,
            serial: found.serial_of(&choice).map(str::to_owned),
            camera,
            resolution_px: [take.whole("width_px")?, take.whole("height_px")?],
            bit_depth: take.whole("bit_depth")?,
            mosaic: take.text("mosaic")?,
            lens: take.lens()?,
            camera_distance_mm: take.number("camera_distance_mm")?,
            camera_tilt_deg: take.number("camera_tilt_deg")?,
            housing_mm,
            sample: take.sample()?,
            stage: take.stage()?,
            lamp_distance_mm: take.number("lamp_distance_mm")?,
            lamp: take.lamp()?,
            warm_up_s: take.number("warm_up_s")?,
            lab: take.lab()?,
        })
    }
}

/// Complete answers, by kind.
struct Take<'a>(&'a Answers);

impl Take<'_> {
    fn missing(key: &'static str) -> AnswerError {
        AnswerError::Missing {
            key,
            allowed: "given".to_owned(),
        }
    }

    fn number(&self, key: &'static str) -> Result<f64, AnswerError> {
        self.0.number(key).ok_or_else(|| Self::missing(key))
    }

    fn whole(&self, key: &'static str) -> Result<u32, AnswerError> {
        self.0.whole(key).ok_or_else(|| Self::missing(key))
    }

    fn text(&self, key: &'static str) -> Result<String, AnswerError> {
        let text = self.0.text(key).map(str::to_owned);
        text.ok_or_else(|| Self::missing(key))
    }

    fn lens(&self) -> Result<Lens, AnswerError> {
        let field = || field_mm(self.0).ok_or_else(|| Self::missing("field_width_mm"));
        Ok(match self.text("lens")?.as_str() {
            "telecentric" => Lens::Telecentric {
                extent_mm: field()?,
            },
            _ => {
                let fov_deg = field_of_view(self.0);
                let distance_mm = self.number("camera_distance_mm")?;
                // The aperture's radius, as the sample sees it.
                let object_na = self.0.number("focal_mm").zip(self.0.number("f_number"));
                let object_na = object_na.map(|(focal, f_number)| {
                    (0.5 * focal / f_number / distance_mm)
                        .atan()
                        .sin()
                        .min(0.95)
                });
                Lens::Perspective {
                    fov_deg: fov_deg.ok_or_else(|| Self::missing("field_width_mm"))?,
                    object_na,
                }
            }
        })
    }

    fn sample(&self) -> Result<Sample, AnswerError> {
        let kind = self.text("sample_shape")?;
        Ok(match kind.as_str() {
            "mesh" => Sample::Mesh {
                file: self.text("sample_mesh")?,
                unit: self.text("mesh_unit")?,
            },
            _ => Sample::Shape {
                kind,
                radius_mm: self.number("sample_radius_mm")?,
                opening_deg: self.0.number("sample_opening_deg"),
                depth_mm: self.0.number("sample_depth_mm"),
                width_mm: self.0.number("groove_width_mm"),
            },
        })
    }

    fn stage(&self) -> Result<Stage, AnswerError> {
        let lights = || {
            let text = self.text("lights")?;
            directions(&text).ok_or_else(|| Self::missing("lights"))
        };
        Ok(match self.text("stage")?.as_str() {
            "grbl" => Stage::Grbl {
                port: self.text("port")?,
                axes: self.axes()?,
            },
            "zaber" => Stage::Zaber {
                port: self.text("port")?,
                axes: self.axes()?,
                devices: [self.text("first_device")?, self.text("second_device")?],
                scales: [self.number("first_scale")?, self.number("second_scale")?],
            },
            "manual" => Stage::Manual { lights: lights()? },
            _ => Stage::Dome {
                port: self.text("port")?,
                lights: lights()?,
                dmx_first: self.whole("dmx_first")?,
            },
        })
    }

    fn axes(&self) -> Result<Axes, AnswerError> {
        let three = |keys: [&'static str; 3]| -> Result<[f64; 3], AnswerError> {
            Ok([
                self.number(keys[0])?,
                self.number(keys[1])?,
                self.number(keys[2])?,
            ])
        };
        let angles = [
            ["azimuth_min_deg", "azimuth_max_deg", "azimuth_home_deg"],
            [
                "elevation_min_deg",
                "elevation_max_deg",
                "elevation_home_deg",
            ],
        ];
        let lengths = [
            ["x_min_mm", "x_max_mm", "x_home_mm"],
            ["y_min_mm", "y_max_mm", "y_home_mm"],
        ];
        let (mechanism, [first, second]) = match self.text("mechanism")?.as_str() {
            "gantry" => ("gantry", lengths),
            "arc" => ("arc", angles),
            _ => ("rotary", angles),
        };
        Ok(Axes {
            mechanism,
            limits: [three(first)?, three(second)?],
        })
    }

    fn lab(&self) -> Result<Option<Lab>, AnswerError> {
        if !self.0.is_yes("lab") {
            return Ok(None);
        }
        Ok(Some(Lab {
            who: [
                self.text("organisation")?,
                self.text("laboratory")?,
                self.text("operator")?,
                self.text("contact")?,
            ],
            room_temperature_c: self.number("room_temperature_c")?,
            room_humidity_percent: self.number("room_humidity_percent")?,
        }))
    }

    fn lamp(&self) -> Result<Lamp, AnswerError> {
        let (lamp, switches): (_, &[&'static str]) = match self.text("stage")?.as_str() {
            "grbl" => (
                "grbl_lamp",
                &["grbl_red_on", "grbl_green_on", "grbl_blue_on"],
            ),
            "zaber" => (
                "zaber_lamp",
                &["zaber_red_on", "zaber_green_on", "zaber_blue_on"],
            ),
            _ => ("lamp", &[]),
        };
        let channels = match self.text(lamp)?.as_str() {
            "rgb" => 3,
            _ => 1,
        };
        let on: Result<Vec<_>, _> = switches
            .iter()
            .take(channels)
            .map(|&key| self.text(key))
            .collect();
        Ok(Lamp {
            channels,
            on: on?,
            off: self.0.text("grbl_off").map(str::to_owned),
        })
    }
}
