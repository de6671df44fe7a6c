//! The `[camera]` table of a rig file: the device, not where it stands.

use std::ffi::{OsStr, OsString};

use super::ConfigError;
use super::reader::Section;
use crate::device::controls::TemperatureControl;
use crate::device::described::Driver;
use crate::device::described_drivers::DRIVERS;
use crate::device::pixel_format::{FORMAT_NAME, fourcc_of_name};
use crate::device::{Mosaic, controls};
use crate::units::Seconds;

/// A camera as the rig file describes it.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraConfig {
    /// Which driver, and what it needs to find the device.
    pub driver: CameraDriver,
    /// The serial number that the device must have; `None`: any.
    pub serial: Option<String>,
    /// Width and height of a frame, pixels.
    pub resolution_px: [u32; 2],
    /// Significant bits of a raw count.
    pub bit_depth: u32,
    /// Colour filters over the sensor.
    pub mosaic: Mosaic,
    /// Analogue gain, a factor; 1 is the camera's lowest.
    pub gain: f64,
    /// Shortest and longest exposure that may be requested.
    pub exposure_range: [Seconds; 2],
    /// Smallest step of the exposure.
    pub exposure_step: Seconds,
    /// Frames that still have the old settings after a change.
    pub settings_latency_frames: u32,
    /// How long a frame may take beyond its exposure.
    pub frame_timeout: Seconds,
    /// How long an unplugged camera is waited for during a capture; 0: not at all.
    pub return_timeout: Seconds,
    /// Further Video4Linux controls, by id, and their values.
    pub controls: Vec<(u32, i64)>,
    /// The Video4Linux control that says the sensor's temperature.
    pub temperature: Option<TemperatureControl>,
}

/// Which driver a camera needs.
#[derive(Clone, Debug, PartialEq)]
pub enum CameraDriver {
    /// The simulated sensor.
    Simulated,
    /// Video4Linux.
    V4l {
        /// Path, best below `/dev/v4l/by-id`.
        device: String,
        /// Pixel format, four characters as the driver names it; `None`: the
        /// deepest raw one.
        format: Option<[u8; 4]>,
    },
    /// A camera that cannot be queried, see [`crate::device::described`].
    Described {
        /// Its driver.
        driver: &'static Driver,
        /// The value of the driver's own key.
        setting: OsString,
    },
}

/// A driver that a new rig file may name: all but the simulated one.
#[derive(Clone, Copy)]
pub(super) struct Offered {
    /// Value of `camera.driver`.
    pub name: &'static str,
    /// What it is, while no camera of it is connected.
    pub offer: &'static str,
    /// Whether its frames are for practice, not for measurement.
    pub only_practice: bool,
    /// The key that says which camera.
    pub key: &'static str,
    pub allowed: &'static str,
    /// Whether the key may be this.
    pub accepts: fn(&OsStr) -> bool,
}

/// Video4Linux, whose further keys have defaults.
pub(super) const V4L: Offered = Offered {
    name: "v4l",
    offer: "a Video4Linux camera that is not connected now",
    only_practice: false,
    key: "device",
    allowed: "a path such as /dev/v4l/by-id/NAME",
    accepts: |text| !text.to_string_lossy().trim().is_empty(),
};

/// The drivers that a new rig file may name.
pub(super) fn offered() -> impl Iterator<Item = Offered> {
    let built = DRIVERS.iter().filter(|driver| !driver.offer.is_empty());
    let described = built.map(|driver| Offered {
        name: driver.name,
        offer: driver.offer,
        only_practice: driver.only_practice,
        key: driver.key,
        allowed: driver.allowed,
        accepts: driver.accepts,
    });
    std::iter::once(V4L).chain(described)
}

#[derive(Clone, Copy)]
enum Kind {
    Simulated,
    V4l,
    Described(&'static Driver),
}

impl CameraConfig {
    /// Reads the `[camera]` table.
    pub fn read(mut table: Section) -> Result<Self, ConfigError> {
        // The driver and its own keys.
        let described = DRIVERS
            .iter()
            .map(|driver| (driver.name, Kind::Described(driver)));
        let mut drivers = vec![(V4L.name, Kind::V4l)];
        drivers.extend(described);
        drivers.push(("simulated", Kind::Simulated));
        let kind = table.choice("driver", &drivers)?.required()?;
        let mut wanted_controls = Vec::new();
        let mut return_timeout = Seconds(0.0);
        let mut temperature = None;
        let driver = match kind {
            Kind::Simulated => CameraDriver::Simulated,
            Kind::V4l => {
                wanted_controls = table
                    .parsed("controls", CONTROLS, parse_controls)?
                    .or(Vec::new());
                return_timeout = Seconds(table.number("return_timeout_s", 0.0..=3600.0)?.or(30.0));
                let unit_c = table.number("temperature_unit_c", 1e-6..=1e3)?.or(1.0);
                let name = table.text("temperature_control")?.optional();
                temperature = name.map(|name| TemperatureControl { name, unit_c });
                CameraDriver::V4l {
                    device: table.text(V4L.key)?.required()?,
                    format: table
                        .parsed("format", FORMAT_NAME, fourcc_of_name)?
                        .optional(),
                }
            }
            Kind::Described(driver) => {
                let accepted = |text: &str| {
                    let text: &OsStr = text.as_ref();
                    (driver.accepts)(text).then(|| text.to_owned())
                };
                let setting = match driver.is_path {
                    true => {
                        let path = table.path(driver.key)?.required()?;
                        if !(driver.accepts)(path.as_os_str()) {
                            return Err(table.conflict(driver.key, path.display(), driver.allowed));
                        }
                        path.into_os_string()
                    }
                    false => table
                        .parsed(driver.key, driver.allowed, accepted)?
                        .required()?,
                };
                CameraDriver::Described { driver, setting }
            }
        };
        // Exposures. A frame that is requested with its settings has no older ones.
        let latency_frames = match kind {
            Kind::Described(_) => 0,
            Kind::V4l | Kind::Simulated => 3,
        };
        let shortest_ms = table.number("shortest_ms", 1e-3..=1e6)?.or(0.05);
        let longest_ms = table.number("longest_ms", 1e-3..=1e6)?.or(2000.0);
        if shortest_ms > longest_ms {
            let allowed = format!("at least shortest_ms ({shortest_ms})");
            return Err(table.conflict("longest_ms", longest_ms, &allowed));
        }
        // The rest.
        let ms = |value: f64| Seconds(value * 1e-3);
        let camera = Self {
            driver,
            serial: table.text("serial")?.optional(),
            resolution_px: table.resolution("resolution_px")?.required()?,
            bit_depth: table.integer("bit_depth", 8..=16)?.required()? as u32,
            mosaic: table
                .choice(
                    "mosaic",
                    &[
                        ("none", Mosaic::None),
                        ("rggb", Mosaic::Rggb),
                        ("grbg", Mosaic::Grbg),
                        ("gbrg", Mosaic::Gbrg),
                        ("bggr", Mosaic::Bggr),
                    ],
                )?
                .or(Mosaic::None),
            gain: table.number("gain", 1.0..=1000.0)?.or(1.0),
            exposure_range: [ms(shortest_ms), ms(longest_ms)],
            exposure_step: ms(table.number("step_ms", 1e-6..=1000.0)?.or(0.1)),
            settings_latency_frames: table
                .integer("settings_latency_frames", 0..=32)?
                .or(latency_frames) as u32,
            frame_timeout: Seconds(table.number("frame_timeout_s", 0.1..=600.0)?.or(5.0)),
            return_timeout,
            controls: wanted_controls,
            temperature,
        };
        let [width, height] = camera.resolution_px;
        if camera.mosaic != Mosaic::None && (width % 2 == 1 || height % 2 == 1) {
            let allowed = "even numbers, because of the colour filters";
            return Err(table.conflict("resolution_px", format!("[{width}, {height}]"), allowed));
        }
        table.finish()?;
        Ok(camera)
    }
}

const CONTROLS: &str = "`name = value` with names that rig-configs/simulated.toml lists or numbers such as 0x009a090a, `;` between them";

fn parse_controls(text: &str) -> Option<Vec<(u32, i64)>> {
    text.split(';')
        .filter(|part| !part.trim().is_empty())
        .map(|part| {
            let (name, value) = part.split_once('=')?;
            Some((controls::id_of(name.trim())?, value.trim().parse().ok()?))
        })
        .collect()
}
